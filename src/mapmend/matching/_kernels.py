"""Kernels of scan matching: arrays in, arrays out. Their plain twins are in tests/reference."""

from __future__ import annotations

import math

import numpy as np

from mapmend.grid._kernels import cell_at
from mapmend.kernel_cache import kernel

# A mean normal at least this long (squared) belongs to one flat surface; shorter ones to corners and clutter.
COHERENT = 0.6
# A post constrains the pose in every direction, but with the discrete mean of a cell, so it counts less. Other points
# on cells without a direction do not count: the far end of the visible part of a wall moves with the robot.
CLUTTER_WEIGHT = 0.3
# Cosine between the normals of a point and of a surface below which they are two sides of a thin wall.
OTHER_SIDE = -0.3
# A surface whose side is at least this was seen from one side only: a point that sees it from behind is another wall.
ONE_SIDED = 0.8


@kernel
def wrap(angle):
    """The angle in [-pi, pi)."""
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@kernel
def match_points(table, frame, arrays, points, start, prior, settings, result):
    """Gauss-Newton of one scan's points on the surfaces of a grid, from the pose ``start``.

    ``prior`` (4, 3): its information along the map's axes, and in the last row the expected pose.
    ``settings`` = (cell size, reach of a match m, distance m at which a point counts half, least standard
    deviation of a distance m, iterations, convergence m, how much wider reach and half-distance are at first).
    ``result``: written: x, y, theta, matched points (within half the reach), points in seen tiles, sum of
    weights, weighted sum of squared distances, and the normal matrix of the last step without the
    prior (xx, xy, xt, yy, yt, tt).
    """
    surface, _, _, nearest = arrays
    size, reach = settings[0], settings[1]
    last = int(settings[4])
    s2 = settings[3] * settings[3]
    x, y, theta = start[0], start[1], start[2]
    total = points.shape[0]
    converged = False
    for iteration in range(last + 1):
        cos, sin = math.cos(theta), math.sin(theta)
        # From the widest reach down to the final one, halved each time: first far, then exact.
        widen = 1.0 + (settings[6] - 1.0) * 0.5**iteration if not converged else 1.0
        sigma = settings[2] * widen
        gate = (reach * widen) ** 2
        counted = 0.25 * reach * reach
        hxx, hxy, hxt, hyy, hyt, htt = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        bx, by, bt = 0.0, 0.0, 0.0
        matched, known, weights, squares = 0, 0, 0.0, 0.0
        for k in range(total):
            rx = cos * points[k, 0] - sin * points[k, 1]
            ry = sin * points[k, 0] + cos * points[k, 1]
            qx, qy = x + rx, y + ry
            cell = cell_at(table, frame, int(math.floor(qy / size)), int(math.floor(qx / size)))
            if cell < 0:
                continue
            known += 1
            source = nearest[cell]
            if source < 0:
                continue
            dx, dy = qx - surface[source, 0], qy - surface[source, 1]
            d2 = dx * dx + dy * dy
            if d2 > gate:
                continue
            nx, ny = surface[source, 2], surface[source, 3]
            coherence = nx * nx + ny * ny
            sx = cos * points[k, 2] - sin * points[k, 3]
            sy = sin * points[k, 2] + cos * points[k, 3]
            if coherence > COHERENT and surface[source, 4] > ONE_SIDED and sx * nx + sy * ny < OTHER_SIDE:
                continue  # the other side of a wall
            if d2 < counted:
                matched += 1
            if coherence > COHERENT:
                length = math.sqrt(coherence)
                nx, ny = nx / length, ny / length
                e = nx * dx + ny * dy
                w = 1.0 / (1.0 + e * e / (sigma * sigma))
                j = -nx * ry + ny * rx
                hxx += w * nx * nx
                hxy += w * nx * ny
                hxt += w * nx * j
                hyy += w * ny * ny
                hyt += w * ny * j
                htt += w * j * j
                bx += w * nx * e
                by += w * ny * e
                bt += w * j * e
                weights += w
                squares += w * e * e
            elif points[k, 4] > 0.0:
                w = CLUTTER_WEIGHT / (1.0 + d2 / (sigma * sigma))
                hxx += w
                hxt += -w * ry
                hyy += w
                hyt += w * rx
                htt += w * (rx * rx + ry * ry)
                bx += w * dx
                by += w * dy
                bt += w * (-ry * dx + rx * dy)
                weights += w
                squares += w * d2
        if iteration == last or converged:
            break
        # Where the surfaces are rough (leaves, people), a distance counts less, and the prior more.
        if weights > 0.0:
            s2 = max(settings[3] * settings[3], squares / weights)
        px, py, pt = x - prior[3, 0], y - prior[3, 1], wrap(theta - prior[3, 2])
        axx, axy, axt = hxx + s2 * prior[0, 0], hxy + s2 * prior[0, 1], hxt + s2 * prior[0, 2]
        ayy, ayt, att = hyy + s2 * prior[1, 1], hyt + s2 * prior[1, 2], htt + s2 * prior[2, 2]
        gx = bx + s2 * (prior[0, 0] * px + prior[0, 1] * py + prior[0, 2] * pt)
        gy = by + s2 * (prior[0, 1] * px + prior[1, 1] * py + prior[1, 2] * pt)
        gt = bt + s2 * (prior[0, 2] * px + prior[1, 2] * py + prior[2, 2] * pt)
        # Cramer's rule on the symmetric 3 x 3 system.
        cxx, cxy, cxt = ayy * att - ayt * ayt, axt * ayt - axy * att, axy * ayt - axt * ayy
        determinant = axx * cxx + axy * cxy + axt * cxt
        if not determinant > 1e-30:
            break
        cyy, cyt, ctt = axx * att - axt * axt, axy * axt - axx * ayt, axx * ayy - axy * axy
        step_x = -(cxx * gx + cxy * gy + cxt * gt) / determinant
        step_y = -(cxy * gx + cyy * gy + cyt * gt) / determinant
        step_t = -(cxt * gx + cyt * gy + ctt * gt) / determinant
        x, y, theta = x + step_x, y + step_y, theta + step_t
        # One more pass at the found pose gives the counts and the normal matrix there.
        converged = widen < 1.2 and abs(step_x) + abs(step_y) + 3.0 * abs(step_t) < settings[5]
    result[0], result[1], result[2] = x, y, theta
    result[3], result[4], result[5], result[6] = matched, known, weights, squares
    result[7], result[8], result[9] = hxx, hxy, hxt
    result[10], result[11], result[12] = hyy, hyt, htt


@kernel
def score_points(table, frame, arrays, points, pose, settings, result):
    """Compares points with a grid at a pose; writes how many are matched, contradicted, and in cells never seen.

    ``settings`` = (cell size, reach of a match m, reach of doubt m). A point is contradicted if it is in free space
    that was seen, farther than the reach of doubt from any surface. Between the two reaches it is neither matched nor
    contradicted.
    """
    surface, _, evidence, nearest = arrays
    size = settings[0]
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    matched, contradicted, unseen = 0, 0, 0
    for k in range(points.shape[0]):
        x = pose[0] + cos * points[k, 0] - sin * points[k, 1]
        y = pose[1] + sin * points[k, 0] + cos * points[k, 1]
        cell = cell_at(table, frame, int(math.floor(y / size)), int(math.floor(x / size)))
        if cell < 0:
            unseen += 1
            continue
        source = nearest[cell]
        distance = 1e18
        if source >= 0:
            nx, ny = surface[source, 2], surface[source, 3]
            sx = cos * points[k, 2] - sin * points[k, 3]
            sy = sin * points[k, 2] + cos * points[k, 3]
            known_side = nx * nx + ny * ny > COHERENT and surface[source, 4] > ONE_SIDED
            if not known_side or sx * nx + sy * ny >= OTHER_SIDE:
                distance = math.sqrt((x - surface[source, 0]) ** 2 + (y - surface[source, 1]) ** 2)
        if distance < settings[1]:
            matched += 1
        elif distance > settings[2]:
            if evidence[cell] == 0:
                unseen += 1
            else:
                contradicted += 1
    result[0], result[1], result[2] = matched, contradicted, unseen


@kernel
def _sum_at(level, shift, columns, rows, dx, dy):
    """The sum of a level's bounds under the points moved by (dx, dy) finest cells."""
    total = 0
    height, width = level.shape
    for k in range(columns.shape[0]):
        c, r = (columns[k] + dx) >> shift, (rows[k] + dy) >> shift
        if 0 <= c < width and 0 <= r < height:
            total += level[r, c]
    return total


@kernel
def search_poses(levels, points, centre, thetas, offsets, settings, best):
    """The best-scoring pose of all whole-cell offsets and angles, exactly, by branch and bound from coarse to fine.

    ``levels``: uint8 arrays, the likelihood in cells of 1, 2, 4, 8 ..., each bounding those that it stands for.
    ``points`` (n, 2+): robot frame. ``centre``: x, y in cells of the finest level. ``offsets`` (m, 2) int64: the
    corners of the blocks of whole-cell offsets to look through. ``settings`` = (cell size, score to beat, tie weight,
    prior theta, tie radius in cells and in rad, farthest offset in cells, level whose cells are as wide as the blocks).
    A score is the mean likelihood of the points minus the tie weight times the squared distance from the prior, which
    is at the centre, in units of the tie radii, limited to one. So of scores that differ by less than the noise, the
    pose nearest to the prior wins, and a pose beyond the radius must be better by the whole weight, however far it is.
    ``best``: written: score, dx, dy in cells, theta; the score stays as it was if no pose beats it.
    """
    n = points.shape[0]
    scale = 1.0 / (255.0 * n)
    top = int(settings[7])
    columns = np.empty((thetas.shape[0], n), np.int64)
    rows = np.empty((thetas.shape[0], n), np.int64)
    bounds = np.empty(thetas.shape[0] * offsets.shape[0])
    for t in range(thetas.shape[0]):
        cos, sin = math.cos(thetas[t]), math.sin(thetas[t])
        for k in range(n):
            columns[t, k] = int(math.floor(centre[0] + (cos * points[k, 0] - sin * points[k, 1]) / settings[0]))
            rows[t, k] = int(math.floor(centre[1] + (sin * points[k, 0] + cos * points[k, 1]) / settings[0]))
        for o in range(offsets.shape[0]):
            total = _sum_at(levels[top], top, columns[t], rows[t], offsets[o, 0], offsets[o, 1])
            bounds[t * offsets.shape[0] + o] = total
    best[0] = settings[1]
    promising = np.nonzero(bounds * scale > best[0])[0]
    waiting = np.empty((4 * top + 1, 3), np.int64)
    for place in np.argsort(-bounds[promising]):
        b = promising[place]
        if bounds[b] * scale <= best[0]:
            break
        t, o = b // offsets.shape[0], b % offsets.shape[0]
        turn = (thetas[t] - settings[3]) / settings[5]
        waiting[0, 0], waiting[0, 1], waiting[0, 2] = top, offsets[o, 0], offsets[o, 1]
        count = 1
        while count > 0:
            count -= 1
            level, x, y = waiting[count, 0] - 1, waiting[count, 1], waiting[count, 2]
            for i in range(4):
                dx, dy = x + ((i & 1) << level), y + ((i >> 1) << level)
                if level == 0 and dx * dx + dy * dy > settings[6] * settings[6]:
                    continue
                score = _sum_at(levels[level], level, columns[t], rows[t], dx, dy) * scale
                if score <= best[0]:
                    continue
                if level > 0:
                    waiting[count, 0], waiting[count, 1], waiting[count, 2] = level, dx, dy
                    count += 1
                    continue
                ax, ay = dx / settings[4], dy / settings[4]
                score -= settings[2] * min(ax * ax + ay * ay + turn * turn, 1.0)
                if score > best[0]:
                    best[0], best[1], best[2], best[3] = score, dx, dy, thetas[t]
