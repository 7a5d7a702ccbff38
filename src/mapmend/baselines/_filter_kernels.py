"""Kernels of the particle filter's proposal: arrays in, arrays out. Their plain twins are in tests/reference."""

from __future__ import annotations

import math

import numpy as np

from mapmend.baselines._map_kernels import nearest_surface
from mapmend.grid._kernels import cell_at
from mapmend.kernel_cache import kernel
from mapmend.matching._surface_kernels import CLUTTER_WEIGHT, COHERENT, ONE_SIDED, OTHER_SIDE, wrap

# Samples are this many standard deviations from the mode along each axis of the posterior, on both sides, and at the
# mode: of all lattices of 27, this one has the smallest error in the variance of a Gaussian (7 % too low).
SAMPLE_STD = math.sqrt(3.0)
SAMPLES = 27


@kernel
def _counterpart(table, frame, cells, x, y, nx, ny, size):
    """The surface nearest to a point with this normal (map axes): its cell, -1 in seen space, -2 in space never
    seen."""
    surface, _, evidence, nearest = cells
    row, column = int(math.floor(y / size)), int(math.floor(x / size))
    cell = cell_at(table, frame, row, column)
    if cell < 0:
        return -2
    source = nearest_surface(table, frame, nearest, cell, row, column)
    if source < 0:
        return -1 if evidence[cell] != 0 else -2
    mx, my = surface[source, 2], surface[source, 3]
    if mx * mx + my * my > COHERENT and surface[source, 4] > ONE_SIDED and nx * mx + ny * my < OTHER_SIDE:
        return -1  # the other side of a wall
    return source


@kernel
def match_scan(table, frame, cells, points, pose, prior, settings, normal):
    """Gauss-Newton of one scan on one particle's map: ``pose`` (3,) is the start, and written. Returns the score.

    ``prior`` = (x, y, theta, standard deviation of the translation m, of the rotation rad), from the odometry.
    ``settings`` = (cell size, reach m, half-weight distance m, standard deviation of a distance m, iterations,
    convergence m, first widening). ``normal`` (6,): written, the normal matrix at the end, without the prior. The score
    is the share of the points that end within half the reach of a surface.
    """
    surface = cells[0]
    size, reach, last = settings[0], settings[1], int(settings[4])
    prior_xy = (settings[3] / prior[3]) ** 2
    prior_t = (settings[3] / prior[4]) ** 2
    converged = False
    for iteration in range(last + 1):
        x, y, theta = pose[0], pose[1], pose[2]
        cos, sin = math.cos(theta), math.sin(theta)
        widen = 1.0 + (settings[6] - 1.0) * 0.5**iteration if not converged else 1.0
        sigma2, gate = (settings[2] * widen) ** 2, (reach * widen) ** 2
        hxx, hxy, hxt, hyy, hyt, htt = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        bx, by, bt = 0.0, 0.0, 0.0
        matched = 0
        for k in range(points.shape[0]):
            rx = cos * points[k, 0] - sin * points[k, 1]
            ry = sin * points[k, 0] + cos * points[k, 1]
            qx, qy = x + rx, y + ry
            sx = cos * points[k, 2] - sin * points[k, 3]
            sy = sin * points[k, 2] + cos * points[k, 3]
            source = _counterpart(table, frame, cells, qx, qy, sx, sy, size)
            if source < 0:
                continue
            dx, dy = qx - surface[source, 0], qy - surface[source, 1]
            d2 = dx * dx + dy * dy
            if d2 > gate:
                continue
            if d2 < 0.25 * reach * reach:
                matched += 1
            nx, ny = surface[source, 2], surface[source, 3]
            coherence = nx * nx + ny * ny
            if coherence > COHERENT:
                length = math.sqrt(coherence)
                nx, ny = nx / length, ny / length
                e = nx * dx + ny * dy
                w = 1.0 / (1.0 + e * e / sigma2)
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
            elif points[k, 4] > 0.0:
                w = CLUTTER_WEIGHT / (1.0 + d2 / sigma2)
                hxx += w
                hxt += -w * ry
                hyy += w
                hyt += w * rx
                htt += w * (rx * rx + ry * ry)
                bx += w * dx
                by += w * dy
                bt += w * (-ry * dx + rx * dy)
        if iteration == last or converged:
            break
        axx, ayy, att = hxx + prior_xy, hyy + prior_xy, htt + prior_t
        gx = bx + prior_xy * (x - prior[0])
        gy = by + prior_xy * (y - prior[1])
        gt = bt + prior_t * wrap(theta - prior[2])
        cxx, cxy, cxt = ayy * att - hyt * hyt, hxt * hyt - hxy * att, hxy * hyt - hxt * ayy
        determinant = axx * cxx + hxy * cxy + hxt * cxt
        if not determinant > 1e-30:
            break
        cyy, cyt, ctt = axx * att - hxt * hxt, hxy * hxt - axx * hyt, axx * ayy - hxy * hxy
        step_x = -(cxx * gx + cxy * gy + cxt * gt) / determinant
        step_y = -(cxy * gx + cyy * gy + cyt * gt) / determinant
        step_t = -(cxt * gx + cyt * gy + ctt * gt) / determinant
        pose[0], pose[1], pose[2] = x + step_x, y + step_y, theta + step_t
        converged = widen < 1.2 and abs(step_x) + abs(step_y) + 3.0 * abs(step_t) < settings[5]
    normal[0], normal[1], normal[2], normal[3], normal[4], normal[5] = hxx, hxy, hxt, hyy, hyt, htt
    return matched / max(points.shape[0], 1)


@kernel
def log_likelihood(table, frame, cells, points, pose, settings):
    """log p(z | m, x) of a scan at a pose, up to a constant: Gaussian in each beam's distance, floored.

    ``settings`` = (cell size, standard deviation of a distance m, distance m beyond which the cost does not grow).
    A beam that ends where the map has seen nothing counts half of the worst.
    """
    surface = cells[0]
    size = settings[0]
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    worst = settings[2] * settings[2]
    total = 0.0
    for k in range(points.shape[0]):
        x = pose[0] + cos * points[k, 0] - sin * points[k, 1]
        y = pose[1] + sin * points[k, 0] + cos * points[k, 1]
        nx = cos * points[k, 2] - sin * points[k, 3]
        ny = sin * points[k, 2] + cos * points[k, 3]
        source = _counterpart(table, frame, cells, x, y, nx, ny, size)
        if source == -2:
            total += 0.5 * worst
            continue
        if source < 0:
            total += worst
            continue
        dx, dy = x - surface[source, 0], y - surface[source, 1]
        d2 = dx * dx + dy * dy
        if d2 < worst:
            mx, my = surface[source, 2], surface[source, 3]
            coherence = mx * mx + my * my
            if coherence > COHERENT:
                d2 = (mx * dx + my * dy) ** 2 / coherence
        total += min(d2, worst)
    return -0.5 * total / (settings[1] * settings[1])


@kernel
def _log_prior(pose, prior):
    """log p(x | x', u), up to a constant that all particles share."""
    dx, dy, dt = pose[0] - prior[0], pose[1] - prior[1], wrap(pose[2] - prior[2])
    return -0.5 * ((dx * dx + dy * dy) / (prior[3] * prior[3]) + dt * dt / (prior[4] * prior[4]))


@kernel
def _cholesky(a, lower):
    """The lower factor of a symmetric positive definite 3 x 3 matrix; the product of its diagonal."""
    for i in range(3):
        for j in range(i + 1):
            total = a[i, j]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            if i == j:
                lower[i, i] = math.sqrt(max(total, 1e-18))
            else:
                lower[i, j] = total / lower[j, j]
                lower[j, i] = 0.0
    return lower[0, 0] * lower[1, 1] * lower[2, 2]


@kernel
def fit_proposal(table, frame, cells, points, prior, mode, information, result):
    """The Gaussian of Grisetti et al. (2007), eqs. (15) to (19), about the mode of one particle's posterior.

    ``prior`` = that of `match_scan`, then the settings of `log_likelihood`. ``information`` (3, 3): of the posterior at
    ``mode``, from the matcher; the 27 samples are spread by its inverse, so that they cover the posterior, however
    narrow it is. ``result`` (13,): written, mean, covariance by rows, log of the evidence eta.
    """
    covariance, spread, drawn = np.linalg.inv(information), np.empty((3, 3)), np.empty((SAMPLES, 3))
    logs = np.empty(SAMPLES)
    volume = _cholesky(covariance, spread)
    x = np.empty(3)
    for k in range(SAMPLES):
        for i in range(3):
            x[i] = 0.0
        for j in range(3):
            at = SAMPLE_STD * (k // 3**j % 3 - 1)
            for i in range(3):
                x[i] += spread[i, j] * at
        for i in range(3):
            drawn[k, i] = x[i]
            x[i] += mode[i]
        logs[k] = log_likelihood(table, frame, cells, points, x, prior[5:]) + _log_prior(x, prior)
    best = logs.max()
    total = 0.0
    mean = np.zeros(3)
    for k in range(SAMPLES):
        weight = math.exp(logs[k] - best)
        total += weight
        for i in range(3):
            mean[i] += weight * drawn[k, i]
        logs[k] = weight
    mean /= total
    for i in range(3):
        result[i] = mode[i] + mean[i]
        for j in range(3):
            entry = 0.0
            for k in range(SAMPLES):
                entry += logs[k] * (drawn[k, i] - mean[i]) * (drawn[k, j] - mean[j])
            result[3 + 3 * i + j] = entry / total
    # The samples represent the cells of a lattice: eta is their sum times a cell's volume.
    result[12] = best + math.log(total) + math.log(volume) + 3.0 * math.log(SAMPLE_STD)


@kernel
def propose(tables, frame, cells, points, particles, priors, settings, normals):
    """Moves a range of particles by the improved proposal and weighs them. Grisetti et al. (2007), Algorithm 1.

    ``particles`` (n, 14): x, y, theta (the start of the match; written: the new pose), log of the weight's factor,
    covariance of the proposal by rows, score. ``priors`` (n, 5): as in
    `match_scan`. ``settings`` = (first particle, minimum score, the seven of `match_scan`, standard deviation m and
    worst distance m of `log_likelihood`). ``normals`` (n, 3): standard normal draws, one row for each particle.
    """
    first = int(settings[0])
    pose, normal, result = np.empty(3), np.empty(6), np.empty(13)
    information, factor = np.empty((3, 3)), np.empty((3, 3))
    prior = np.empty(8)
    prior[5], prior[6], prior[7] = settings[2], settings[9], settings[10]
    for n in range(particles.shape[0]):
        table = tables[first + n]
        pose[:] = particles[n, :3]
        prior[:5] = priors[n]
        score = match_scan(table, frame, cells, points, pose, prior, settings[2:9], normal)
        particles[n, 13] = score
        if score < settings[1]:
            # No match: the new pose is drawn from the motion model and weighed by the observation.
            for i in range(3):
                std = prior[3] if i < 2 else prior[4]
                particles[n, i] = prior[i] + std * normals[n, i]
                for j in range(3):
                    particles[n, 4 + 3 * i + j] = std * std if i == j else 0.0
            particles[n, 3] = log_likelihood(table, frame, cells, points, particles[n, :3], prior[5:])
            particles[n, 3] += 1.5 * math.log(2.0 * math.pi) + 2.0 * math.log(prior[3]) + math.log(prior[4])
            continue
        for i in range(3):
            for j in range(3):
                a, b = min(i, j), max(i, j)
                information[i, j] = normal[a * (5 - a) // 2 + b] / (settings[9] * settings[9])
        information[0, 0] += 1.0 / prior[3] ** 2
        information[1, 1] += 1.0 / prior[3] ** 2
        information[2, 2] += 1.0 / prior[4] ** 2
        fit_proposal(table, frame, cells, points, prior, pose, information, result)
        _cholesky(result[3:12].copy().reshape(3, 3), factor)
        for i in range(3):
            particles[n, i] = result[i]
            for j in range(i + 1):
                particles[n, i] += factor[i, j] * normals[n, j]
        particles[n, 3] = result[12]
        particles[n, 4:13] = result[3:12]
