"""Kernels of the particle filter's proposal: arrays in, arrays out. Their plain twins are in tests/reference."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapmend.baselines._map_kernels import map_of
from mapmend.grid._kernels import cell_at, nearest_surface
from mapmend.kernel_cache import kernel
from mapmend.matching._kernels import MatchSettings, match_points
from mapmend.matching._surface_kernels import is_from_behind, squared_distance, wrap

# Samples are this many standard deviations from the mode along each axis of the posterior, on both sides, and at the
# mode: of all lattices of 27, this one has the smallest error in the variance of a Gaussian (7 % too low).
SAMPLE_STD = math.sqrt(3.0)
SAMPLES = 27


class Likelihood(NamedTuple):
    """The observation model: the standard deviation of a beam's distance, and the distance at which it is cut off."""

    std_m: float
    worst_m: float


class ProposalSettings(NamedTuple):
    """``minimum_score``: a scan that scores less was not matched. ``match``: how it is matched."""

    minimum_score: float
    match: MatchSettings
    likelihood: Likelihood


class Proposal(NamedTuple):
    """A Gaussian: its mean (3,) and covariance (3, 3), and the logarithm of the evidence eta."""

    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    log_evidence: float


class Particles(NamedTuple):
    """A range of particles.

    ``poses`` (n, 3): the start of the match; written: the new pose. Written too: ``log_weights`` (n,), the logarithm of
    the factor of each weight; ``covariances`` (n, 3, 3) of the proposals; ``scores`` (n,) of the matches.
    """

    poses: NDArray[np.float64]
    log_weights: NDArray[np.float64]
    covariances: NDArray[np.float64]
    scores: NDArray[np.float64]


@kernel
def log_likelihood(tiles, points, pose, likelihood):
    """log p(z | m, x) of a scan at a pose, up to a constant: Gaussian in each beam's distance, with a lower limit.

    ``likelihood``: a `Likelihood`. A beam that ends where the map has seen nothing counts half of the worst; but the
    worst, where it ends behind a thin wall: the map knows that wall.
    """
    table, frame, references, nearest = tiles.table, tiles.frame, tiles.references, tiles.nearest
    surface, evidence, size = tiles.surface, tiles.evidence, tiles.cell_size_m
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    worst = likelihood.worst_m * likelihood.worst_m
    total = 0.0
    for k in range(points.shape[0]):
        x = pose[0] + cos * points[k, 0] - sin * points[k, 1]
        y = pose[1] + sin * points[k, 0] + cos * points[k, 1]
        row, column = int(math.floor(y / size)), int(math.floor(x / size))
        cell = cell_at(table, frame, row, column)
        if cell < 0:
            total += 0.5 * worst
            continue
        source = nearest_surface(table, frame, nearest, references, cell, row, column)
        if source < 0:
            total += worst if evidence[cell] != 0 else 0.5 * worst
            continue
        nx = cos * points[k, 2] - sin * points[k, 3]
        ny = sin * points[k, 2] + cos * points[k, 3]
        mx, my = surface[source, 2], surface[source, 3]
        dx, dy = x - surface[source, 0], y - surface[source, 1]
        if dx * dx + dy * dy < worst and not is_from_behind(mx, my, surface[source, 4], nx, ny):
            total += min(squared_distance(mx, my, dx, dy), worst)
        else:
            total += worst
    return -0.5 * total / (likelihood.std_m * likelihood.std_m)


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
def fit_proposal(tiles, points, prior, mode, information, likelihood):
    """The Gaussian of Grisetti et al. (2007), eqs. (15) to (19), about the mode of a particle's posterior.

    ``prior`` = (x, y, theta, standard deviation of the translation m, of the rotation rad): of the odometry.
    ``information`` (3, 3): of the posterior at ``mode``, from the matcher; the 27 samples are spread by its inverse, so
    that they cover the posterior, even if it is narrow.
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
        logs[k] = log_likelihood(tiles, points, x, likelihood) + _log_prior(x, prior)
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
        for j in range(3):
            entry = 0.0
            for k in range(SAMPLES):
                entry += logs[k] * (drawn[k, i] - mean[i]) * (drawn[k, j] - mean[j])
            covariance[i, j] = entry / total
    for i in range(3):
        mean[i] += mode[i]
    # The samples stand for the cells of a lattice: eta is their sum times a cell's volume.
    evidence = best + math.log(total) + math.log(volume) + 3.0 * math.log(SAMPLE_STD)
    return Proposal(mean, covariance, evidence)


@kernel
def propose(shared, first, points, particles, priors, settings, normals):
    """Moves a range of particles by the improved proposal and weighs them. Grisetti et al. (2007), Algorithm 1.

    ``first``: the first particle's number; ``particles``: `Particles`; ``priors`` (n, 5): as in `fit_proposal`;
    ``settings``: `ProposalSettings`; ``normals`` (n, 3): standard normal draws, one row for each particle.
    """
    variance = settings.likelihood.std_m * settings.likelihood.std_m
    prior, factor = np.zeros((4, 3)), np.empty((3, 3))
    for n in range(priors.shape[0]):
        tiles = map_of(shared, first + n)
        pose = particles.poses[n]
        std_m, std_rad = priors[n, 3], priors[n, 4]
        prior[0, 0], prior[1, 1], prior[2, 2] = 1.0 / (std_m * std_m), 1.0 / (std_m * std_m), 1.0 / (std_rad * std_rad)
        prior[3] = priors[n, :3]
        found = match_points(tiles, points, pose, prior, settings.match)
        particles.scores[n] = found.matched / max(points.shape[0], 1)
        if particles.scores[n] < settings.minimum_score:
            # No match: the motion model draws, and the observation weighs.
            for i in range(3):
                std = std_m if i < 2 else std_rad
                pose[i] = priors[n, i] + std * normals[n, i]
                for j in range(3):
                    particles.covariances[n, i, j] = std * std if i == j else 0.0
            likelihood = log_likelihood(tiles, points, pose, settings.likelihood)
            constant = 1.5 * math.log(2.0 * math.pi) + 2.0 * math.log(std_m) + math.log(std_rad)
            particles.log_weights[n] = likelihood + constant
            continue
        information = found.normal_matrix / variance + prior[:3]
        proposal = fit_proposal(tiles, points, priors[n], found.pose, information, settings.likelihood)
        _cholesky(proposal.covariance, factor)
        for i in range(3):
            pose[i] = proposal.mean[i]
            for j in range(i + 1):
                pose[i] += factor[i, j] * normals[n, j]
        particles.log_weights[n] = proposal.log_evidence
        particles.covariances[n] = proposal.covariance
