"""Occupancy maps: a picture of cells, the cell size, and the place of the picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.errors import MapmendError

FREE, OCCUPIED, UNKNOWN = 254, 0, 205
"""Grey values of a cell, those of nav2's map files."""

OCCUPIED_THRESHOLD, FREE_THRESHOLD = 0.65, 0.196
"""The darkness of a cell, from 0 for white to 1 for black: above the first it is occupied for nav2, below the second
free."""

Image = NDArray[np.uint8]


@dataclass(frozen=True)
class OccupancyMap:
    """A picture of cells: uint8, shape (rows, columns), row 0 at the LOWEST y, 254 free, 0 occupied, 205 unknown.

    ``origin``: x, y, yaw of the lower left corner in the map's frame.
    """

    image: Image
    resolution_m: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    occupied_threshold: float = OCCUPIED_THRESHOLD
    free_threshold: float = FREE_THRESHOLD

    def __post_init__(self) -> None:
        if self.image.ndim != 2 or self.image.dtype != np.uint8:
            raise MapmendError(f"image must be uint8 (rows, columns), got {self.image.dtype} {self.image.shape}")
        if not (0.0 < self.resolution_m < np.inf and np.all(np.isfinite(self.origin))):
            raise MapmendError(f"a map needs a positive resolution and a finite origin, got {self.resolution_m}")
