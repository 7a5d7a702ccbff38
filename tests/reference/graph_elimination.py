"""The plain twins of the ordering, the symbolic analysis and the fronts: sets and dense matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.graph.elimination import Fronts

Array = NDArray[np.float64]
Whole = NDArray[np.int64]


def adjacency(ends: Whole, count: int) -> list[set[int]]:
    """The neighbours of every vertex."""
    neighbours: list[set[int]] = [set() for _ in range(count)]
    for i, j in ends:
        if i >= 0 and j >= 0:
            neighbours[i].add(int(j))
            neighbours[j].add(int(i))
    return neighbours


def columns_of_factor(neighbours: list[set[int]], order: Whole) -> list[set[int]]:
    """By place, the places below the diagonal that each column of L has: eliminating a vertex joins its neighbours."""
    places = {int(vertex): place for place, vertex in enumerate(order)}
    left = [{places[w] for w in neighbours[vertex]} for vertex in order]
    columns = []
    for place, around in enumerate(left):
        below = {other for other in around if other > place}
        for other in below:
            left[other] |= below - {other}
        columns.append(below)
    return columns


def minimum_degree_fill(neighbours: list[set[int]]) -> int:
    """How many blocks L has below the diagonal where the vertex of the least degree, exactly counted, goes next."""
    left = {vertex: set(around) for vertex, around in enumerate(neighbours)}
    total = 0
    while left:
        vertex = min(left, key=lambda v: len(left[v]))
        around = left.pop(vertex)
        total += len(around)
        for other in around:
            left[other] |= around - {other}
            left[other].discard(vertex)
    return total


def runs_of(fronts: Fronts) -> list[tuple[list[int], list[int]]]:
    """For each run, its own places and the places of its rows below."""
    firsts, starts = fronts.firsts.astype(int), fronts.row_starts.astype(int)
    return [
        (list(range(firsts[s], firsts[s + 1])), list(fronts.rows[starts[s] : starts[s + 1]].astype(int)))
        for s in range(len(firsts) - 1)
    ]


def dense_panels(fronts: Fronts, numbers: Array) -> Array:
    """The matrix whose columns the panels hold, shape (size, size), by place; zero elsewhere."""
    size = 3 * (len(fronts.block_starts) - 1)
    matrix = np.zeros((size, size))
    for s, (own, below) in enumerate(runs_of(fronts)):
        rows = (3 * np.array(own + below)[:, None] + np.arange(3)).ravel()
        columns = rows[: 3 * len(own)]
        first = int(fronts.panel_starts[s])
        matrix[np.ix_(rows, columns)] = numbers[first : first + len(rows) * len(columns)].reshape(len(columns), -1).T
    return matrix


def dense_lower(fronts: Fronts, numbers: Array) -> Array:
    """L by place: the diagonal of the panels holds the inverses."""
    matrix = dense_panels(fronts, numbers)
    np.fill_diagonal(matrix, 1.0 / np.diag(matrix))
    return matrix


def dense_values(fronts: Fronts, values: Array) -> Array:
    """H by place, shape (size, size), from the blocks that are stored of it."""
    count = len(fronts.block_starts) - 1
    blocks = values.reshape(-1, 3, 3).swapaxes(1, 2)
    matrix = np.zeros((3 * count, 3 * count))
    for own, below in runs_of(fronts):
        front = own + below
        for place in own:
            matrix[3 * place : 3 * place + 3, 3 * place : 3 * place + 3] = blocks[place]
            for b in range(int(fronts.block_starts[place]), int(fronts.block_starts[place + 1])):
                row = front[int(fronts.block_rows[b])]
                matrix[3 * row : 3 * row + 3, 3 * place : 3 * place + 3] = blocks[count + b]
                matrix[3 * place : 3 * place + 3, 3 * row : 3 * row + 3] = blocks[count + b].T
    return matrix
