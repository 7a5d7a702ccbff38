"""ROS bags without ROS: containers through rosbags, messages decoded here; laser, odometry and frames to a log."""
