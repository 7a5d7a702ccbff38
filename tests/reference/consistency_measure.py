"""The plain twin of consistency/visibility.py and measure.py: MC (1) and (2) from their definition, in O(K^2)."""

import math

import numpy as np

from mapmend.geometry.se2 import compose, transform_points


def laser_pose(geometry, pose):
    return compose(np.asarray(pose, dtype=np.float64), np.array(geometry.T_robot_laser))


def end_points(ranges, geometry, pose, config):
    """The end points of a scan in the map, in any order."""
    found = []
    for reading, bearing in zip(ranges, geometry.bearings_rad(), strict=True):
        if config.min_range_m <= reading < geometry.max_range_m and reading <= config.max_range_m:
            found.append((float(reading) * math.cos(bearing), float(reading) * math.sin(bearing)))
    return transform_points(laser_pose(geometry, pose), np.array(found).reshape(-1, 2))


def visibility_polygon(ranges, geometry, pose, config):
    """Its corners in the map, in order."""
    bearings = geometry.bearings_rad()
    turn = abs(bearings[-1] - bearings[0]) if len(bearings) else 0.0
    step = abs(geometry.angle_increment_rad)
    corners = []
    for k, (reading, bearing) in enumerate(zip(ranges, bearings, strict=True)):
        if k * step > 2.0 * math.pi - 1e-6 * step:
            break  # looks again where the first beams look
        reach = 0.0
        if config.min_range_m <= reading < geometry.max_range_m:
            reach = min(float(reading), config.max_range_m)
        corners.append((reach * math.cos(bearing), reach * math.sin(bearing)))
    if len(bearings) < 3 or turn + 1.5 * step < 2.0 * math.pi:
        corners.append((0.0, 0.0))
    return transform_points(laser_pose(geometry, pose), np.array(corners).reshape(-1, 2))


def is_inside(point, polygon):
    """By the number of sides that a line from the point to the right crosses."""
    inside = False
    for (x0, y0), (x1, y1) in sides(polygon):
        if (y0 > point[1]) != (y1 > point[1]) and point[0] < x0 + (point[1] - y0) * (x1 - x0) / (y1 - y0):
            inside = not inside
    return inside


def sides(polygon):
    return zip(polygon, np.roll(polygon, -1, axis=0), strict=True)


def distance_to_side(point, begin, end):
    along = end - begin
    length2 = float(along @ along)
    share = min(max(float((point - begin) @ along) / length2, 0.0), 1.0) if length2 > 0.0 else 0.0
    return float(np.hypot(*(point - begin - share * along)))


def inconsistency_distances(points, polygon):
    """MC (1) of the points that lie inside."""
    return [min(distance_to_side(p, a, b) for a, b in sides(polygon)) for p in points if is_inside(p, polygon)]


def pair_measure(scans, poses, i, j, config):
    """n_ij and M_ij, MC (2), and all the distances."""
    distances = []
    for a, b in ((i, j), (j, i)):
        polygon = visibility_polygon(scans.ranges_of(a), scans.geometry_of(a), poses[a], config)
        points = end_points(scans.ranges_of(b), scans.geometry_of(b), poses[b], config)
        distances += inconsistency_distances(points, polygon) if len(polygon) else []
    distances = [d for d in distances if d > 0.0]
    return len(distances), sum(distances), distances


def overlapping_pairs(boxes):
    """All pairs of boxes that overlap, i < j."""
    found = []
    for i in range(len(boxes)):
        for j in range(i + 1, len(boxes)):
            a, b = boxes[i], boxes[j]
            if all(a[k] <= b[k + 2] and b[k] <= a[k + 2] for k in (0, 1)):
                found.append((i, j))
    return found
