"""Ray casting one ray and one wall at a time, by solving the two equations as they stand."""

import math

import numpy as np


def cast_rays(walls, laser_poses, bearings_rad, max_range_m):
    """As ``mapmend.simulation.ray_casting.cast_rays``, slowly, without slack where walls meet."""
    ranges = np.full((len(laser_poses), len(bearings_rad)), np.inf)
    for n, (x, y, theta) in enumerate(laser_poses):
        for b, bearing in enumerate(bearings_rad):
            for wall in walls:
                distance = _hit((x, y), theta + bearing, wall)
                if distance < min(ranges[n, b], max_range_m):
                    ranges[n, b] = distance
    return ranges


def _hit(origin, direction_rad, wall):
    x1, y1, x2, y2 = wall
    # Columns of the unknowns: the ray's direction, and the wall from its end to its beginning.
    matrix = np.array([[math.cos(direction_rad), x1 - x2], [math.sin(direction_rad), y1 - y2]])
    if np.linalg.det(matrix) == 0.0:
        return math.inf
    distance, share = np.linalg.solve(matrix, [x1 - origin[0], y1 - origin[1]])
    return distance if distance > 0.0 and 0.0 <= share <= 1.0 else math.inf
