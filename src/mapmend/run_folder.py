"""The RUN folder: trajectory, graph, map, picture, and run.json about them. It appears whole or not at all."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mapmend.config import to_dict
from mapmend.io.g2o import write_g2o
from mapmend.io.nav2 import write_map
from mapmend.io.output import whole_or_nothing
from mapmend.io.own_files import RUN_FILES
from mapmend.io.tum import write_tum
from mapmend.slam import MapResult, stage
from mapmend.trajectory import path_length_m
from mapmend.version import VERSION

if TYPE_CHECKING:
    from mapmend.tuning.tune import TuneResult


def write_run(
    result: MapResult, folder: str | Path, *, source: str = "", seconds: dict[str, float] | None = None
) -> dict[str, Any]:
    """Writes a RUN folder, and returns the content of its run.json; raises OutputError, and then leaves nothing behind.

    Replaces the files of an older RUN in ``folder`` and keeps all others (`mapmend.io.output.whole_or_nothing`).

    ``source``: what was mapped. ``seconds``: of stages outside ``result``. Only ``seconds`` differs between two runs of
    the same log, configuration and seed; ``seconds["write"]`` is the time for all files except run.json itself.
    """
    from mapmend.view.map_picture import draw_run

    spent = {**(seconds or {}), **result.seconds}
    with whole_or_nothing(folder, RUN_FILES) as output:
        place = output.path
        with stage("write", spent):
            write_tum(place / "trajectory.tum", result.trajectory.stamps_s, result.trajectory.poses)
            write_g2o(place / "graph.g2o", result.graph)
            write_map(place, result.occupancy)
            draw_run(result).save(place / "map.png", compress_level=2)
        return output.write_run_json(run_json(replace(result, seconds=spent), source))


def run_json(result: MapResult, source: str = "") -> dict[str, Any]:
    """The content of run.json without the list of files: enough to repeat the run, and its results."""
    rows, columns = result.occupancy.image.shape
    mended = {} if result.mended is None else {"mended": result.mended.to_json()}
    return {
        "mapmend": VERSION,
        "method": result.method,
        "seed": result.config.seed,
        "log": Path(source).name,
        "counts": result.counts,
        "chi2_initial": result.chi2_initial,
        "chi2_final": result.chi2_final,
        **mended,
        "key_nodes": result.graph.ids[result.key_nodes].tolist(),
        "path_m": path_length_m(result.trajectory.poses),
        "extent_m": np.ptp(result.trajectory.poses[:, :2], axis=0).tolist(),
        "map": {"rows": rows, "columns": columns, "resolution_m": result.occupancy.resolution_m},
        "tuning": _tuning(result.tuning),
        "alignment": None if result.alignment is None else asdict(result.alignment),
        "configuration": to_dict(result.config),
        "seconds": {name: round(value, 3) for name, value in result.seconds.items()},
    }


def _tuning(result: TuneResult | None) -> dict[str, Any] | None:
    """How the loops were weighed, and whether the map is consistent."""
    if result is None:
        return None
    return {
        "kernel": result.kernel,
        "phi": result.phi,
        "measure": result.measure_m,
        "switched_off": len(result.switched_off),
        "consistent": result.consistent,
        "p_value": result.check.p_value,
    }
