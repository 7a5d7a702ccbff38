"""The plain twin of lab/haehnel.py: a grid as a dictionary, a cell at a time."""

import math


def grid_of(reaches, rays, ends, cell_m):
    """Cells that a scan saw free or occupied, in the laser's frame."""
    cells = {}
    for reach, (x, y) in zip(reaches, rays, strict=True):
        for step in range(int(reach / (0.5 * cell_m))):
            way = step * 0.5 * cell_m
            cells[math.floor(way * x / cell_m), math.floor(way * y / cell_m)] = "free"
    for x, y in ends:
        cells[math.floor(x / cell_m), math.floor(y / cell_m)] = "occupied"
    return cells


def counts_over(cells, points, cell_m):
    """How many points fall on free and on occupied cells."""
    found = [cells.get((math.floor(x / cell_m), math.floor(y / cell_m))) for x, y in points]
    return found.count("free"), found.count("occupied")
