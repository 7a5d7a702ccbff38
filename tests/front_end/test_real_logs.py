"""The public recordings: accuracy over all relations, and the long loops of fr-clinic."""

import numpy as np
import pytest

from mapmend.config import Config
from mapmend.evaluation.relations import relation_errors
from mapmend.front_end.builder import FrontEnd
from mapmend.io.carmen import read_carmen
from mapmend.io.relations import read_relations
from tests.real_data import data_path


@pytest.mark.parametrize(
    ("name", "translation_m", "rotation_deg", "total"), [("intel", 0.018, 0.35, 2984), ("fr079", 0.036, 0.60, 1685)]
)
def test_all_relations_are_met(name, translation_m, rotation_deg, total):
    log = read_carmen(data_path(f"logs/{name}.clf.bz2"))
    true = read_relations(data_path(f"relations/{name}.relations"))
    poses = FrontEnd(log, Config()).run().scan_poses()
    errors = relation_errors(log.stamps_s, poses, true.t1_s, true.t2_s, true.relative_poses)
    assert (errors.used, errors.total) == (total, total)
    assert errors.translation_mean_m <= translation_m
    assert errors.rotation_mean_deg <= rotation_deg


@pytest.fixture(scope="module")
def fr_clinic():
    """Its front end after the whole log, and the scans that loop edges join, shape (loops, 2)."""
    log = read_carmen(data_path("logs/fr-clinic.clf.bz2"))
    state = FrontEnd(log, Config()).run()
    return state, np.array([(state.node_scan[e.anchor], state.node_scan[e.node]) for e in state.loops])


@pytest.mark.slow
def test_fr_clinic_comes_back_to_its_start(fr_clinic):
    """1.4 km outdoors: the odometry ends at (2.1, -10.9), the robot stood some metres from where it began."""
    state, loops = fr_clinic
    end = state.scan_poses()[-1]
    assert np.hypot(end[0] + 0.4, end[1] - 2.0) < 3.0
    # The start's street, the first 300 scans, is driven again in the middle of the log.
    assert np.count_nonzero(loops[:, 0] < 300) >= 10
    assert np.count_nonzero(loops[:, 1] >= len(state.log) - 800) >= 10


@pytest.mark.slow
def test_the_end_of_fr_clinic_is_held_to_its_beginning(fr_clinic):
    """Back in the start's street, the last 800 scans get loop edges to the first 300."""
    state, loops = fr_clinic
    assert np.count_nonzero((loops[:, 0] < 300) & (loops[:, 1] >= len(state.log) - 800)) >= 10
