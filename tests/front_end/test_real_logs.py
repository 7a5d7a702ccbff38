"""The public recordings: accuracy over all relations, and the long loops of fr-clinic."""

import numpy as np
import pytest

from mapmend.config import Config
from mapmend.evaluation.relations import relation_errors
from mapmend.front_end.builder import FrontEnd
from mapmend.geometry import se2
from mapmend.io.carmen import read_carmen
from mapmend.io.relations import read_relations
from mapmend.lab.altered_logs import turned
from tests.real_data import data_path


@pytest.mark.parametrize(
    ("name", "translation_m", "rotation_deg", "total"), [("intel", 0.018, 0.35, 2984), ("fr079", 0.036, 0.60, 1685)]
)
def test_all_relations_are_met(name, translation_m, rotation_deg, total):
    log = read_carmen(data_path(f"logs/{name}.clf.bz2"))
    true = read_relations(data_path(f"relations/{name}.relations"))
    poses = FrontEnd(log.scans.geometries, Config()).run(log).scan_poses()
    errors = relation_errors(log.stamps_s, poses, true.t1_s, true.t2_s, true.relative_poses)
    assert (errors.used, errors.total) == (total, total)
    assert errors.translation_mean_m <= translation_m
    assert errors.rotation_mean_deg <= rotation_deg


@pytest.mark.slow
@pytest.mark.parametrize("turn_rad", [0.0, 0.8, 1.2])
def test_fr_clinic_comes_back_to_its_start_whichever_way_the_grid_lies(turn_rad):
    """1.4 km outdoors: the odometry ends 11 m away, matching alone up to 60 m; the robot stood 2 m beside its start.

    The first 300 scans are a street that is driven again in the middle of the log and, the other way, at its end.
    """
    log = turned(read_carmen(data_path("logs/fr-clinic.clf.bz2")), turn_rad)
    graph = FrontEnd(log.scans.geometries, Config()).run(log)
    end = se2.compose((0.0, 0.0, -turn_rad), graph.scan_poses()[-1])
    assert np.hypot(end[0] + 0.4, end[1] - 2.0) < 1.5
    loops = np.array([(graph.hung.node_scan[e.anchor], graph.hung.node_scan[e.node]) for e in graph.loops])
    assert np.count_nonzero(loops[:, 0] < 300) >= 10
    assert np.count_nonzero((loops[:, 0] < 3000) & (loops[:, 1] >= len(log) - 800)) >= 2
