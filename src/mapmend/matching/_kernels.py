"""Kernels of scan matching: arrays in, arrays out. Their plain twins are in tests/reference."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapmend.grid._kernels import cell_at, nearest_surface
from mapmend.kernel_cache import kernel
from mapmend.matching._surface_kernels import is_from_behind, step, sum_points


class MatchSettings(NamedTuple):
    """How a scan is matched.

    ``reach_m``: of a match; ``half_weight_m``: the distance at which a point counts half; ``distance_std_m``: the least
    standard deviation of a point's distance; ``iterations``: the greatest number of steps; ``convergence_m``: a shorter
    step is the last one; ``widening``: how much wider reach and half-weight distance are at first.
    ``is_roughness_used``: where the surfaces are rough (leaves, people), a distance counts less and the prior more: by
    the variance that the distances have.
    """

    reach_m: float
    half_weight_m: float
    distance_std_m: float
    iterations: int
    convergence_m: float
    widening: float
    is_roughness_used: bool


class Matched(NamedTuple):
    """Where a match ended: its pose (3,), and the sums there.

    ``normal_matrix`` (3, 3): of the last step, without the prior. ``matched``: points within half the reach.
    ``weights``, ``squares``: the sums of the weights and of the weighted squared distances. ``converged``: whether the
    last step was shorter than the limit.
    """

    pose: NDArray[np.float64]
    normal_matrix: NDArray[np.float64]
    matched: int
    weights: float
    squares: float
    converged: bool


class Judged(NamedTuple):
    """How many points a grid confirms, contradicts, and has never seen."""

    matched: int
    contradicted: int
    unseen: int


class SearchSettings(NamedTuple):
    """What a search looks through, and what a pose is worth; see `search_poses`.

    ``tie_radius_cells``, ``tie_radius_rad``: the tie radius. ``reach_cells``: the farthest offset. ``top``: the level
    whose cells are as wide as the blocks.
    """

    cell_size_m: float
    score_to_beat: float
    tie_weight: float
    prior_theta: float
    tie_radius_cells: float
    tie_radius_rad: float
    reach_cells: float
    top: int


class Found(NamedTuple):
    """The best pose of a search: its score, its whole-cell offset, its angle."""

    score: float
    columns: int
    rows: int
    theta: float


@kernel
def match_points(tiles, points, start, prior, settings):
    """Gauss-Newton of one scan's points (n, 5) on the surfaces of a grid, from the pose ``start`` (3,); `Matched`.

    ``prior`` (4, 3): its information along the map's axes, and in the last row the expected pose. ``settings``: a
    `MatchSettings`.
    """
    reach, last = settings.reach_m, settings.iterations
    variance = settings.distance_std_m * settings.distance_std_m
    s2 = variance
    x, y, theta = start[0], start[1], start[2]
    converged = False
    for iteration in range(last + 1):
        # From the widest reach down to the final one, halved each time: first far, then exact.
        widen = 1.0 + (settings.widening - 1.0) * 0.5**iteration if not converged else 1.0
        half = settings.half_weight_m * widen
        sums = sum_points(tiles, points, x, y, theta, (reach * widen) ** 2, 0.25 * reach * reach, half * half)
        if iteration == last or converged:
            break
        if settings.is_roughness_used and sums.weights > 0.0:
            s2 = max(variance, sums.squares / sums.weights)
        is_solved, step_x, step_y, step_t = step(sums, prior, s2, x, y, theta)
        if not is_solved:
            break
        x, y, theta = x + step_x, y + step_y, theta + step_t
        # One more pass at the found pose gives the counts and the normal matrix there.
        converged = widen < 1.2 and abs(step_x) + abs(step_y) + 3.0 * abs(step_t) < settings.convergence_m
    pose, normal = np.empty(3), np.empty((3, 3))
    pose[0], pose[1], pose[2] = x, y, theta
    normal[0, 0], normal[0, 1], normal[0, 2] = sums.xx, sums.xy, sums.xt
    normal[1, 0], normal[1, 1], normal[1, 2] = sums.xy, sums.yy, sums.yt
    normal[2, 0], normal[2, 1], normal[2, 2] = sums.xt, sums.yt, sums.tt
    return Matched(pose, normal, sums.matched, sums.weights, sums.squares, converged)


@kernel
def score_points(tiles, points, pose, reach_m, doubt_m):
    """Compares points (n, 5) with a grid at a pose (3,): `Judged`.

    A point is matched within ``reach_m`` of its surface. It is contradicted if it is in free space that was seen,
    farther than ``doubt_m`` from any surface. Between the two distances it is neither.
    """
    table, frame, references, nearest = tiles.table, tiles.frame, tiles.references, tiles.nearest
    surface, evidence, size = tiles.surface, tiles.evidence, tiles.cell_size_m
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    matched, contradicted, unseen = 0, 0, 0
    for k in range(points.shape[0]):
        x = pose[0] + cos * points[k, 0] - sin * points[k, 1]
        y = pose[1] + sin * points[k, 0] + cos * points[k, 1]
        row, column = int(math.floor(y / size)), int(math.floor(x / size))
        cell = cell_at(table, frame, row, column)
        if cell < 0:
            unseen += 1
            continue
        source = nearest_surface(table, frame, nearest, references, cell, row, column)
        distance = 1e18
        if source >= 0:
            sx = cos * points[k, 2] - sin * points[k, 3]
            sy = sin * points[k, 2] + cos * points[k, 3]
            if not is_from_behind(surface[source, 2], surface[source, 3], surface[source, 4], sx, sy):
                distance = math.sqrt((x - surface[source, 0]) ** 2 + (y - surface[source, 1]) ** 2)
        if distance < reach_m:
            matched += 1
        elif distance > doubt_m:
            if evidence[cell] == 0:
                unseen += 1
            else:
                contradicted += 1
    return Judged(matched, contradicted, unseen)


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
def search_poses(levels, points, centre, thetas, offsets, settings):
    """The best-scoring pose of all whole-cell offsets and angles, exactly, by branch and bound from coarse to fine.

    ``levels``: uint8 arrays, the likelihood in cells of 1, 2, 4, 8 ..., each bounding those that it stands for.
    ``points`` (n, 2+): robot frame. ``centre``: x, y in cells of the finest level. ``offsets`` (m, 2) int64: the
    corners of the blocks of whole-cell offsets to look through. ``settings``: a `SearchSettings`.
    A score is the mean likelihood of the points minus the tie weight times the squared distance from the prior, which
    is at the centre, in units of the tie radii, limited to one. So of scores that differ by less than the noise, the
    pose nearest to the prior wins, and a pose beyond the radius must be better by the whole weight, however far it is.
    Returns what it `Found`; its score is the score to beat if no pose beats it.
    """
    n, size = points.shape[0], settings.cell_size_m
    scale = 1.0 / (255.0 * n)
    top = settings.top
    columns = np.empty((thetas.shape[0], n), np.int64)
    rows = np.empty((thetas.shape[0], n), np.int64)
    bounds = np.empty(thetas.shape[0] * offsets.shape[0])
    for t in range(thetas.shape[0]):
        cos, sin = math.cos(thetas[t]), math.sin(thetas[t])
        for k in range(n):
            columns[t, k] = int(math.floor(centre[0] + (cos * points[k, 0] - sin * points[k, 1]) / size))
            rows[t, k] = int(math.floor(centre[1] + (sin * points[k, 0] + cos * points[k, 1]) / size))
        for o in range(offsets.shape[0]):
            total = _sum_at(levels[top], top, columns[t], rows[t], offsets[o, 0], offsets[o, 1])
            bounds[t * offsets.shape[0] + o] = total
    best, best_x, best_y, best_theta = settings.score_to_beat, 0, 0, settings.prior_theta
    promising = np.nonzero(bounds * scale > best)[0]
    waiting = np.empty((4 * top + 1, 3), np.int64)
    for place in np.argsort(-bounds[promising]):
        b = promising[place]
        if bounds[b] * scale <= best:
            break
        t, o = b // offsets.shape[0], b % offsets.shape[0]
        turn = (thetas[t] - settings.prior_theta) / settings.tie_radius_rad
        waiting[0, 0], waiting[0, 1], waiting[0, 2] = top, offsets[o, 0], offsets[o, 1]
        count = 1
        while count > 0:
            count -= 1
            level, x, y = waiting[count, 0] - 1, waiting[count, 1], waiting[count, 2]
            for i in range(4):
                dx, dy = x + ((i & 1) << level), y + ((i >> 1) << level)
                if level == 0 and dx * dx + dy * dy > settings.reach_cells * settings.reach_cells:
                    continue
                score = _sum_at(levels[level], level, columns[t], rows[t], dx, dy) * scale
                if score <= best:
                    continue
                if level > 0:
                    waiting[count, 0], waiting[count, 1], waiting[count, 2] = level, dx, dy
                    count += 1
                    continue
                ax, ay = dx / settings.tie_radius_cells, dy / settings.tie_radius_cells
                score -= settings.tie_weight * min(ax * ax + ay * ay + turn * turn, 1.0)
                if score > best:
                    best, best_x, best_y, best_theta = score, dx, dy, thetas[t]
    return Found(best, best_x, best_y, best_theta)
