"""A simulated drive as the files that ``simulate`` and ``demo`` write."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mapmend.simulation import Simulation


def write_simulation(simulation: Simulation, place: Path) -> None:
    """log.clf, truth.tum (robot poses in the world) and world.png into a folder."""
    from mapmend.io.carmen import write_carmen
    from mapmend.io.tum import write_tum
    from mapmend.view.figures import draw_world

    write_carmen(place / "log.clf", simulation.log)
    write_tum(place / "truth.tum", simulation.log.stamps_s, simulation.truth)
    draw_world(simulation.world.walls, simulation.truth, place / "world.png", simulation.world.name)
