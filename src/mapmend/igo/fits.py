"""How well a scan fits a grid at a pose, and whether it fits better at another by more than noise."""

from __future__ import annotations

from mapmend.config import Config
from mapmend.grid.surface import SurfaceGrid
from mapmend.igo import _kernels
from mapmend.igo.observed import Float

# Fits closer than this many standard deviations are ties: the errors of neighbouring beams are dependent, so three and
# not two.
TIE = 3.0


class Fits:
    """Fits of scans, 0 to 1: unlike the score, a fit depends on how near the beams end to their surfaces.

    The score counts beams within half the reach: a pose that is off by less, or off along a corridor with few niches,
    scores as well as the right one. Fits are compared beam by beam: beams that fit at both poses, or at neither, add no
    noise to the difference.
    """

    def __init__(self, config: Config) -> None:
        self._reach_m = float(config.match.reach_m)

    def fit(self, grid: SurfaceGrid, points: Float, pose: Float) -> float:
        """The mean fit of ``points`` (n, 5) at a pose (3,); 0 for none."""
        return float(_kernels.compare_fits(grid.tiles, points, pose, pose, self._reach_m).fit)

    def gain(self, grid: SurfaceGrid, points: Float, new: Float, old: Float) -> tuple[float, float]:
        """The gain in fit of ``points`` (n, 5) at a new pose (3,) over an old one, and its noise."""
        found = _kernels.compare_fits(grid.tiles, points, new, old, self._reach_m)
        return found.gain, found.noise
