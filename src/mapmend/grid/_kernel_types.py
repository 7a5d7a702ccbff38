"""What the kernel of the occupancy map takes as one argument. Numba is not needed to make it."""

from __future__ import annotations

from typing import NamedTuple


class MapFrame(NamedTuple):
    """Where an occupancy map is: its lower left corner and the size of its cells; and the usable ranges of beams."""

    left_m: float
    bottom_m: float
    cell_size_m: float
    shortest_m: float
    longest_m: float
