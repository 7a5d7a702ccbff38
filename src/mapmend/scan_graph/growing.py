"""Arrays that grow row by row: a robot's log has no known end."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

_FIRST_ROOM = 64


class GrowingArray:
    """Rows of one shape and type; ``rows`` is the array of those that were appended, a view that may be written to.

    Room is doubled when it runs out, so that n rows cost O(n). A view taken before an append may be an old copy after
    it: take ``rows`` anew.
    """

    def __init__(self, row_shape: Sequence[int] = (), dtype: DTypeLike = np.float64) -> None:
        self._room: NDArray[Any] = np.zeros((_FIRST_ROOM, *row_shape), dtype=dtype)
        self.rows: NDArray[Any] = self._room[:0]

    def __len__(self) -> int:
        return len(self.rows)

    def append(self, row: ArrayLike) -> None:
        """Adds one row."""
        n = len(self.rows)
        if n == len(self._room):
            self._reserve(n + 1)
        self._room[n] = row
        self.rows = self._room[: n + 1]

    def extend(self, rows: NDArray[Any]) -> None:
        """Adds several rows, shape (m, ...)."""
        n = len(self.rows)
        self._reserve(n + len(rows))
        self._room[n : n + len(rows)] = rows
        self.rows = self._room[: n + len(rows)]

    def _reserve(self, n: int) -> None:
        if n <= len(self._room):
            return
        room = np.zeros((max(n, 2 * len(self._room)), *self._room.shape[1:]), dtype=self._room.dtype)
        room[: len(self.rows)] = self.rows
        self._room = room
