"""The public recordings: accuracy of igo over all relations, slipping wheels, and the long loops of fr-clinic."""

import numpy as np
import pytest

from mapmend.config import Config
from mapmend.evaluation.relations import relation_errors
from mapmend.front_end.builder import FrontEnd
from mapmend.igo.iterate import iterate
from mapmend.io.carmen import read_carmen
from mapmend.io.relations import read_relations
from mapmend.lab.slip import SlipModel, slip_log
from tests.real_data import data_path


def relation_error_m(log, relations, poses):
    """The mean translation error over all relations."""
    errors = relation_errors(log.stamps_s, poses, relations.t1_s, relations.t2_s, relations.relative_poses)
    assert errors.used == errors.total
    return errors.translation_mean_m, errors.rotation_mean_deg


@pytest.mark.slow
@pytest.mark.parametrize(("name", "translation_m", "rotation_deg"), [("intel", 0.018, 0.40), ("fr079", 0.034, 0.50)])
def test_a_clean_log_is_mapped_as_well_as_before_at_most_a_millimetre_worse(name, translation_m, rotation_deg):
    log = read_carmen(data_path(f"logs/{name}.clf.bz2"))
    true = read_relations(data_path(f"relations/{name}.relations"))
    graph = FrontEnd(log.scans.geometries, Config()).run(log)
    before_m, _ = relation_error_m(log, true, graph.scan_poses())
    rounds = iterate(graph).rounds
    after_m, after_deg = relation_error_m(log, true, graph.scan_poses())
    assert after_m <= min(translation_m, before_m + 0.001)
    assert after_deg <= rotation_deg
    assert len(rounds) < 2 or rounds[1].matched <= rounds[0].matched / 4


@pytest.mark.slow
def test_where_wheels_slipped_the_error_is_less_than_half():
    """30 slips of 90 % over 2 m along intel: some matches fell into a wrong basin with a score that is not doubtful."""
    clean = read_carmen(data_path("logs/intel.clf.bz2"))
    true = read_relations(data_path("relations/intel.relations"))
    log = slip_log(clean, SlipModel("along", count=30, share=0.9, length_m=2.0), 0).log
    graph = FrontEnd(log.scans.geometries, Config()).run(log)
    before_m, _ = relation_error_m(log, true, graph.scan_poses())
    iterate(graph)
    after_m, _ = relation_error_m(log, true, graph.scan_poses())
    assert before_m > 0.05
    assert after_m < 0.5 * before_m


@pytest.mark.slow
def test_the_loops_that_close_fr_clinic_the_long_way_round_stay():
    """In the end the robot was 2 m beside its start; the loops that show this join nodes 800 m of path apart."""
    log = read_carmen(data_path("logs/fr-clinic.clf.bz2"))
    graph = FrontEnd(log.scans.geometries, Config()).run(log)
    iterate(graph)
    end = graph.scan_poses()[-1]
    assert np.hypot(end[0] + 0.4, end[1] - 2.0) < 1.5
    loops = np.array([(graph.hung.node_scan[e.anchor], graph.hung.node_scan[e.node]) for e in graph.loops])
    assert np.count_nonzero((loops[:, 0] < 3000) & (loops[:, 1] >= len(log) - 800)) >= 2
