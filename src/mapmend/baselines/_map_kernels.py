"""Kernels of the particles' maps: arrays in, arrays out. Their plain twins are in tests/reference.

Scans are inserted by the kernel of the surface grid (grid/_kernels.py), into tiles that a particle does not share.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapmend.grid._kernels import REACH, TILE, TILE_CELLS, Tiles
from mapmend.kernel_cache import kernel

# Beams are followed in steps of this many cells to find the tiles that they touch. If a step cuts the corner of a tile,
# nothing is written there.
STRIDE_CELLS = 8


class SharedTiles(NamedTuple):
    """All particles' maps, in one pool of tiles; the arrays are those of `Tiles`.

    ``tables[p, row, column]`` names the tile of particle p, or -1; ``frame`` = (unused, first tile row, first tile
    column). Particles share a tile until one of them writes to it: ``references[tile]`` counts them, and ``free`` is a
    stack of unused tiles, its height in ``free[-1]``.
    """

    tables: NDArray[np.int32]
    frame: NDArray[np.int64]
    surface: NDArray[np.float32]
    returns: NDArray[np.uint8]
    evidence: NDArray[np.int8]
    nearest: NDArray[np.uint8]
    references: NDArray[np.int32]
    free: NDArray[np.int64]
    cell_size_m: float


@kernel
def map_of(shared, p):
    """The map of particle p."""
    return Tiles(
        shared.tables[p],
        shared.frame,
        shared.surface,
        shared.returns,
        shared.evidence,
        shared.nearest,
        shared.references,
        shared.cell_size_m,
    )


@kernel
def _own(shared, p, row, column):
    """Gives particle p a tile of its own at a position where it has none or shares it; False if no tile is left."""
    tables, references, free = shared.tables, shared.references, shared.free
    old = tables[p, row, column]
    if free[-1] == 0:
        return False
    free[-1] -= 1
    new = free[free[-1]]
    surface, returns, evidence, nearest = shared.surface, shared.returns, shared.evidence, shared.nearest
    first, end = new * TILE_CELLS, (new + 1) * TILE_CELLS
    if old < 0:
        surface[first:end] = 0.0
        returns[first:end] = 0
        evidence[first:end] = 0
        nearest[first:end] = 0
    else:
        source, last = old * TILE_CELLS, (old + 1) * TILE_CELLS
        surface[first:end] = surface[source:last]
        returns[first:end] = returns[source:last]
        evidence[first:end] = evidence[source:last]
        nearest[first:end] = nearest[source:last]
        references[old] -= 1
    references[new] = 1
    tables[p, row, column] = new
    return True


@kernel
def claim_tiles(shared, points, origin, poses, clearing):
    """Gives every particle the tiles that a scan at its pose will write to; False if the pool is too small.

    ``origin``: the laser's position on the robot; ``clearing``: a `Clearing`. Claimed tiles stay claimed: after a
    False, enlarge the pool and call again.
    """
    tables, references, frame, size = shared.tables, shared.references, shared.frame, shared.cell_size_m
    margin = size * (REACH + 1)
    span = size * TILE
    for p in range(poses.shape[0]):
        cos, sin = math.cos(poses[p, 2]), math.sin(poses[p, 2])
        ox = poses[p, 0] + cos * origin[0] - sin * origin[1]
        oy = poses[p, 1] + sin * origin[0] + cos * origin[1]
        for k in range(points.shape[0]):
            x = poses[p, 0] + cos * points[k, 0] - sin * points[k, 1]
            y = poses[p, 1] + sin * points[k, 0] + cos * points[k, 1]
            low_r, high_r = int(math.floor((y - margin) / span)), int(math.floor((y + margin) / span))
            low_c, high_c = int(math.floor((x - margin) / span)), int(math.floor((x + margin) / span))
            for r in range(low_r, high_r + 1):
                for c in range(low_c, high_c + 1):
                    row, column = r - frame[1], c - frame[2]
                    tile = tables[p, row, column]
                    if (tile < 0 or references[tile] != 1) and not _own(shared, p, row, column):
                        return False
            if (k - clearing.first) % clearing.stride != 0:
                continue
            steps = int(math.hypot(x - ox, y - oy) / (size * STRIDE_CELLS)) + 1
            for s in range(steps):
                row = int(math.floor((oy + (y - oy) * s / steps) / span)) - frame[1]
                column = int(math.floor((ox + (x - ox) * s / steps) / span)) - frame[2]
                tile = tables[p, row, column]
                if (tile < 0 or references[tile] != 1) and not _own(shared, p, row, column):
                    return False
    return True
