"""The plain twins of baselines/: a beam's likelihood from a map's contents, and who is drawn when resampling."""

import math

from mapmend.matching._surface_kernels import COHERENT, ONE_SIDED, OTHER_SIDE


def log_likelihood(contents, points, pose, settings):
    """Of one scan, beam by beam; ``contents`` is a `Contents` of the map, ``settings`` as the kernel has them."""
    size, std, worst = settings
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    total = 0.0
    for px, py, pnx, pny, _ in points:
        x, y = pose[0] + cos * px - sin * py, pose[1] + sin * px + cos * py
        nx, ny = cos * pnx - sin * pny, sin * pnx + cos * pny
        cell = (math.floor(y / size), math.floor(x / size))
        if cell not in contents.nearest:
            total += (worst if cell in contents.evidence else math.sqrt(0.5) * worst) ** 2
            continue
        mx, my, snx, sny, side = contents.mean[contents.nearest[cell]]
        flat = snx**2 + sny**2 > COHERENT
        if flat and side > ONE_SIDED and nx * snx + ny * sny < OTHER_SIDE:
            total += worst**2
            continue
        distance = math.hypot(x - mx, y - my)
        if distance < worst and flat:
            distance = abs(snx * (x - mx) + sny * (y - my)) / math.hypot(snx, sny)
        total += min(distance, worst) ** 2
    return -0.5 * total / std**2


def systematic(weights, shift):
    """Row by row: n even steps through the weights laid end to end."""
    drawn, end, row = [], weights[0], 0
    for k in range(len(weights)):
        while end <= (shift + k) / len(weights) * sum(weights) and row < len(weights) - 1:
            row += 1
            end += weights[row]
        drawn.append(row)
    return drawn
