"""The innermost product of the factorization beside NumPy's."""

from __future__ import annotations

import numpy as np
import pytest

from mapmend.graph import _factor_kernels as kernels
from mapmend.graph import _tile_kernels as tiles


def arguments(rows, columns, seed=0):
    generator = np.random.default_rng(seed)
    height, to = rows + 7, 5
    panel, target = generator.normal(size=columns * height + 4), generator.normal(size=to + 3 * (rows + 2))
    # The rows begin at 4 of each column of the panel, the factors at 1.
    places = (
        np.uint64(to),
        np.uint64(rows + 2),
        panel,
        np.uint64(4),
        np.uint64(1),
        np.uint64(height),
        np.uint64(columns),
    )
    expected = target.copy()
    for c in range(3):
        for k in range(columns):
            first = to + c * (rows + 2)
            expected[first : first + rows] -= panel[4 + k * height : 4 + k * height + rows] * panel[1 + k * height + c]
    return target, places, expected


@pytest.mark.parametrize("rows", [3, 9, 12, 15, 21, 24, 27, 39, 48, 99])
@pytest.mark.parametrize("columns", [3, 6, 33])
def test_products_of_blocks_of_any_height(rows, columns):
    target, places, expected = arguments(rows, columns)
    kernels.subtract_blocks(target, *places, np.uint64(rows))
    np.testing.assert_allclose(target, expected, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(("rows", "tile"), [(tiles.TALL, tiles.subtract_tall), (tiles.SHORT, tiles.subtract_short)])
def test_a_tile_that_is_not_compiled_does_the_same(rows, tile):
    target, places, expected = arguments(rows, 6)
    tile(target, *places)
    np.testing.assert_allclose(target, expected, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("columns", [51, 99, 150])
def test_wide_panels_are_factorized_in_parts(columns):
    generator = np.random.default_rng(columns)
    below = 120
    size = columns + below
    factor = np.tril(generator.normal(size=(size, size))) + 20.0 * np.eye(size)
    matrix = factor @ factor.T
    lower = np.ascontiguousarray(np.tril(matrix)[:, :columns].T).ravel()
    diagonal = np.concatenate([matrix[k : k + 3, k : k + 3].T.ravel() for k in range(0, columns, 3)])
    done = kernels.eliminate(diagonal, np.uint64(0), 1e-13, lower, np.uint64(0), np.uint64(columns), np.uint64(size))
    assert done == columns
    got = np.tril(lower.reshape(columns, size).T)
    inside = np.arange(columns)
    got[inside, inside] = 1.0 / got[inside, inside]
    np.testing.assert_allclose(got, factor[:, :columns], rtol=0.0, atol=1e-9)
    update = np.zeros(below * below)
    kernels.subtract_square(
        update, np.uint64(0), np.uint64(below), lower, np.uint64(columns), np.uint64(size), np.uint64(columns)
    )
    expected = -factor[columns:, :columns] @ factor[columns:, :columns].T
    np.testing.assert_allclose(np.tril(update.reshape(below, below).T), np.tril(expected), rtol=0.0, atol=1e-9)
