"""The plain twins of igo/_kernels.py."""

import math

import numpy as np

from tests.reference.matching import CLUTTER_WEIGHT, COHERENT, associations, moved


def shared_normals(contents, points, pose, axis, cell_size_m, reach_m, half_m):
    """The terms ``w (s . a)(g . a)`` of the matched points, one by one."""
    there, terms = moved(pose, points), []
    for k, surface in associations(contents, points, pose, cell_size_m, reach_m):
        d, g = there[k, :2] - surface[:2], np.array(surface[2:4])
        if g @ g > COHERENT:
            g = g / np.linalg.norm(g)
            terms.append((there[k, 2:4] @ axis) * (g @ axis) / (1.0 + (d @ g) ** 2 / half_m**2))
        elif points[k, 4]:
            terms.append(CLUTTER_WEIGHT / (1.0 + math.hypot(*d) ** 2 / half_m**2))
    return np.array(terms)


def fits(contents, points, pose, cell_size_m, reach_m):
    """How well each point fits: Tukey's biweight of its distance to the surface that it finds, else 0."""
    there, values = moved(pose, points), np.zeros(len(points))
    for k, surface in associations(contents, points, pose, cell_size_m, reach_m):
        d, g = there[k, :2] - surface[:2], np.array(surface[2:4])
        away = abs(d @ g) / np.linalg.norm(g) if g @ g > COHERENT else math.hypot(*d)
        values[k] = (1.0 - (away / reach_m) ** 2) ** 2
    return values
