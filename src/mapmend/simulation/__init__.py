"""Buildings, robots and their ground truth."""
