"""The front end as a whole, on simulated drives whose truth is known, spoilt in the ways that robots spoil logs."""

from dataclasses import replace

import numpy as np
import pytest

from mapmend.config import Config
from mapmend.errors import MapmendError
from mapmend.front_end.builder import FrontEnd
from mapmend.geometry import se2
from mapmend.lab.altered_logs import with_people
from mapmend.matching.uncertainty import Uncertainty
from mapmend.scan_graph.motion import odometry_covariance
from mapmend.simulation import OdometryModel, SlipEvent, World, corridor_loop, simulate
from mapmend.slam import build_map
from tests.front_end.logs import (
    BENT,
    NOISY,
    SHORT_SIGHTED,
    WITHOUT_LOOPS,
    drive,
    empty_log,
    errors_of,
    mapped,
    with_steps,
)
from tests.grid.contents import Contents

# Building 1: 110 m of driving, round once and more, six rooms.
BUILDING = 1


def test_a_drive_with_bent_odometry_is_mapped_to_centimetres():
    simulation = drive(BUILDING, None, BENT)
    odometry = errors_of(simulation, simulation.log.odometry)
    found = errors_of(simulation, mapped(simulation.log).graph.scan_poses())
    assert odometry.translation_rmse_m > 5.0
    assert found.translation_rmse_m < 0.04
    assert found.translation_max_m < 0.12
    assert found.rotation_mean_deg < 0.3


def test_loops_take_out_the_drift_that_matching_leaves():
    """Readings with 3 cm of noise: over seven buildings, neither odometry nor matching alone meets the threshold."""
    with_loops, without = [], []
    for building in range(1, 8):
        simulation = drive(building, NOISY, BENT)
        closed = mapped(simulation.log)
        with_loops.append(errors_of(simulation, closed.graph.scan_poses()).translation_rmse_m)
        matched = mapped(simulation.log, WITHOUT_LOOPS).graph.scan_poses()
        without.append(errors_of(simulation, matched).translation_rmse_m)
        assert len(closed.graph.loops) >= 10
    assert np.mean(with_loops) < 0.05
    assert np.mean(with_loops) < 0.75 * np.mean(without)


def test_no_loop_edge_joins_places_that_are_apart():
    """The error of every edge is within the possible bend of its local grid."""
    for building in (1, 2, 3):
        simulation = drive(building, SHORT_SIGHTED, BENT)
        graph = mapped(simulation.log).graph
        truth = simulation.truth[graph.hung.node_scan]
        for edge in graph.loops:
            off = se2.between(edge.T_anchor_node, se2.between(truth[edge.anchor], truth[edge.node]))
            assert np.hypot(off[0], off[1]) < 0.25
            assert abs(off[2]) < 0.08


def test_the_same_log_gives_the_same_bytes():
    simulation = drive(2, SHORT_SIGHTED, BENT)
    first, second = mapped(simulation.log), mapped(simulation.log)
    assert first.graph.scan_poses().tobytes() == second.graph.scan_poses().tobytes()
    a, b = first.graph.pose_graph(), second.graph.pose_graph()
    assert a.edges.tobytes() == b.edges.tobytes()
    assert a.information.tobytes() == b.information.tobytes()


def test_a_log_without_odometry_is_followed_by_its_scans():
    simulation = drive(BUILDING)
    config = replace(Config(), motion=replace(Config().motion, use_odometry=False))
    log = replace(simulation.log, odometry=np.zeros_like(simulation.log.odometry))
    assert errors_of(simulation, mapped(log, config).graph.scan_poses()).translation_rmse_m < 0.1


def test_odometry_that_says_backward_for_a_second_is_not_believed():
    simulation = drive(BUILDING)

    def lie(steps):
        for begin in range(100, len(steps) - 5, 200):
            steps[begin : begin + 5, 0] *= -1.0

    log = with_steps(simulation.log, lie)
    assert errors_of(simulation, log.odometry).translation_rmse_m > 1.0
    found = errors_of(simulation, mapped(log).graph.scan_poses())
    assert found.translation_rmse_m < 0.06
    assert found.translation_max_m < 0.2


def test_wheels_that_slip_and_spin_are_not_believed():
    odometry = OdometryModel(slips=(SlipEvent(20.0, 1.5, 0.6), SlipEvent(50.0, 1.0, 1.0), SlipEvent(70.0, 2.0, 0.5)))
    simulation = drive(BUILDING, None, odometry)
    assert errors_of(simulation, simulation.log.odometry).translation_rmse_m > 1.0
    found = errors_of(simulation, mapped(simulation.log).graph.scan_poses())
    assert found.translation_rmse_m < 0.06
    assert found.translation_max_m < 0.2


def test_people_in_a_tenth_of_the_beams_do_not_matter():
    simulation = drive(BUILDING)
    log = with_people(simulation.log, 0.1, seed=1)
    found = errors_of(simulation, mapped(log).graph.scan_poses())
    assert found.translation_rmse_m < 0.06
    assert found.translation_max_m < 0.2


def test_scans_without_returns_are_bridged_by_odometry():
    simulation = drive(BUILDING)
    log, n = simulation.log, simulation.log.scans.geometries[0].beam_count
    ranges = log.scans.ranges_m.copy()
    for begin in (200, 700, 1100):
        ranges[begin * n : (begin + 8) * n] = np.inf
    log = replace(log, scans=replace(log.scans, ranges_m=ranges))
    assert errors_of(simulation, mapped(log).graph.scan_poses()).translation_rmse_m < 0.06


def test_exact_odometry_along_a_bare_corridor_stays_exact():
    world = corridor_loop()
    simulation = simulate(
        World(world.walls, "corridor", np.array([(17.0, 1.0), (17.0, 20.0)])), None, OdometryModel.exact(), 2
    )
    driven = np.ptp(simulation.truth[:, 1])
    assert driven > 18.9
    assert mapped(simulation.log).graph.scan_poses()[-1, 0] == pytest.approx(driven, abs=0.15)


def test_a_loop_of_bare_corridors_is_as_long_as_it_is():
    """Along each corridor only the odometry observes the motion; the corners and the closed loop give the rest."""
    simulation = simulate(corridor_loop())
    found = errors_of(simulation, mapped(simulation.log).graph.scan_poses())
    assert found.translation_rmse_m < 0.15


@pytest.mark.parametrize("scale", [1.0, 1.03])
def test_along_a_bare_corridor_the_odometry_decides(scale):
    """The walls do not observe the motion along them: the reported motion stays, even if it is 3 % too long."""
    world = corridor_loop()
    route = np.array([(17.0, 1.0), (17.0, 20.0)])
    odometry = replace(OdometryModel.exact(), translation_scale=scale)
    simulation = simulate(World(world.walls, "corridor", route), None, odometry, 2)
    poses = mapped(simulation.log).graph.scan_poses()
    driven, reported = np.ptp(simulation.truth[:, 1]), simulation.log.odometry[-1, 0]
    # Its two ends can be matched.
    assert driven - 0.3 < poses[-1, 0] < reported + 0.3


def test_along_a_bare_corridor_the_walls_keep_the_robot_straight():
    world = corridor_loop()
    route = np.array([(17.0, 1.0), (17.0, 20.0)])
    simulation = simulate(World(world.walls, "corridor", route), None, BENT, 2)
    assert np.abs(simulation.log.odometry[:, 1]).max() > 1.0
    poses = mapped(simulation.log).graph.scan_poses()
    assert np.abs(poses[:, 1]).max() < 0.15
    assert np.abs(poses[:, 2]).max() < 0.05


def test_a_scan_at_nearly_the_same_heading_is_not_inserted_again():
    """Whichever way round the angles are counted."""
    log = drive(BUILDING).log
    front_end = FrontEnd(log.scans.geometries, Config())
    points = front_end.graph.points.project(log.scans.ranges_of(0), 0)
    front_end._insert(points, 0, np.array([0.0, 0.0, np.pi - 0.01]))
    before = Contents(front_end._global.grid)
    for heading in (0.01 - np.pi, np.pi + 0.01, 3.0 * np.pi, -np.pi):
        front_end._insert(points, 0, np.array([0.0, 0.0, heading]))
        assert Contents(front_end._global.grid) == before
    front_end._insert(points, 0, np.array([0.0, 0.0, 0.1 - np.pi]))
    assert Contents(front_end._global.grid) != before


@pytest.mark.parametrize("n", [1, 2, 30])
def test_a_log_of_scans_without_any_return_stands_still(n):
    graph = mapped(empty_log(n)).graph
    assert len(graph) == 1
    np.testing.assert_array_equal(graph.scan_poses(), np.zeros((n, 3)))


def test_every_scan_hangs_on_a_node_before_it():
    simulation = drive(BUILDING)
    hung = mapped(simulation.log).graph.hung
    scans = np.arange(len(simulation.log))
    assert np.all(hung.node_scan[hung.node] <= scans)
    assert np.all(np.diff(hung.node) >= 0)
    assert np.array_equal(hung.node[hung.node_scan], np.arange(len(hung.node_scan)))


def test_nodes_lie_as_far_apart_as_configured():
    simulation = drive(BUILDING)
    config = Config()
    edges = mapped(simulation.log, WITHOUT_LOOPS).graph.chains.edges[1:]
    far = np.hypot(edges[:, 0], edges[:, 1]) >= config.key_nodes.node_every_m - 1e-9
    assert np.all(far | (np.abs(edges[:, 2]) >= config.key_nodes.node_every_rad - 1e-9))


def test_edges_carry_symmetric_positive_information():
    information = mapped(drive(BUILDING).log).graph.pose_graph().information
    np.testing.assert_allclose(information, np.swapaxes(information, -1, -2), rtol=1e-6)
    assert np.all(np.linalg.eigvalsh(0.5 * (information + np.swapaxes(information, -1, -2))) > 0.0)


def edge_of(score, stiffness, inserted=4):
    """Covariance and drift of an edge of 0.3 m between two matches alike, and the odometry's covariance."""
    front_end = FrontEnd(drive(BUILDING).log.scans.geometries, Config())
    front_end._motion_since_node = np.array([0.3, 0.0, 0.0])
    uncertainty = Uncertainty(
        1.5e-4 * np.diag(1.0 / np.array(stiffness)), 4e-5 * np.diag(1.0 / np.array(stiffness)), 1e-4, 0.03
    )
    front_end._covariance_at_node = uncertainty.covariance
    front_end._inserted_since_node = inserted
    odometry = odometry_covariance(front_end._motion_since_node, front_end.config.motion)
    return (*front_end._edge_covariance(uncertainty, score), odometry)


def test_below_the_least_score_an_edge_takes_on_the_odometrys_covariance():
    """IGO (2): by how much the score is below 0.85, as a share of 0.85; all of it adds up along the trajectory."""
    stiffness = (50.0, 60.0, 400.0)
    good, good_drift, odometry = edge_of(0.9, stiffness)
    for score in (0.84, 0.5, 0.0):
        poor, poor_drift, _ = edge_of(score, stiffness)
        np.testing.assert_allclose(poor - good, (0.85 - score) / 0.85 * odometry, rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(poor_drift - good_drift, poor - good, rtol=1e-9, atol=1e-15)


def test_what_matches_tell_cancels_along_the_trajectory_and_what_odometry_tells_adds_up():
    """Across a bare corridor the matches constrain the robot, along it only the odometry does."""
    covariance, drift, odometry = edge_of(1.0, (1e-9, 60.0, 400.0))
    assert covariance[0, 0] == pytest.approx(odometry[0, 0], rel=1e-3)
    assert drift[0, 0] == pytest.approx(covariance[0, 0], rel=1e-3)
    for axis in (1, 2):
        assert covariance[axis, axis] < 0.05 * odometry[axis, axis]
        assert drift[axis, axis] < 0.15 * covariance[axis, axis]
    assert np.all(np.linalg.eigvalsh(covariance - drift) > -1e-12)


def test_the_more_scans_of_a_node_the_grid_takes_over_the_more_adds_up():
    stiffness = (50.0, 60.0, 400.0)
    covariance, _, odometry = edge_of(1.0, stiffness, 0)
    matches = 2.0 * 1.9e-4 / np.array(stiffness)  # about: the second match is carried over 0.3 m
    for inserted in (0, 1, 5, 1000):
        same, drift, _ = edge_of(1.0, stiffness, inserted)
        np.testing.assert_allclose(same, covariance)
        share = 0.5 * (1.0 - (1.0 - 0.03) ** inserted)
        assert drift[0, 0] / covariance[0, 0] == pytest.approx(share + matches[0] / odometry[0, 0], abs=0.01)


def fed(log, config=None):
    """The front end's graph after a log that came scan by scan, as a robot sends it."""
    front_end = FrontEnd(log.scans.geometries, config or Config())
    for k in range(len(log)):
        laser = log.scans.laser_of(k)
        front_end.add_scan(log.scans.ranges_of(k).tolist(), log.stamps_s[k], log.odometry[k].tolist(), laser)
    return front_end.finish()


def test_a_log_that_comes_scan_by_scan_gives_the_bytes_of_the_whole_log():
    log = drive(2, SHORT_SIGHTED, BENT).log
    whole, one_by_one = build_map(log, "go"), fed(log)
    assert one_by_one.scan_poses().tobytes() == whole.trajectory.poses.tobytes()
    graph = one_by_one.pose_graph(with_scans=True)
    for name in ("poses", "edges", "measurements", "information", "is_loop", "stamps_s"):
        assert getattr(graph, name).tobytes() == getattr(whole.graph, name).tobytes(), name
    assert graph.scans.ranges_m.tobytes() == whole.graph.scans.ranges_m.tobytes()


def test_after_every_scan_the_front_end_says_where_the_robot_is():
    simulation = drive(BUILDING)
    log = simulation.log
    front_end = FrontEnd(log.scans.geometries, Config())
    for k in range(300):
        pose = front_end.add_scan(log.scans.ranges_of(k), log.stamps_s[k], log.odometry[k])
        off = se2.between(se2.between(simulation.truth[0], simulation.truth[k]), pose)
        assert np.hypot(off[0], off[1]) < 0.1
        assert len(front_end.graph.hung) == k + 1


def test_a_wrong_scan_is_refused_and_changes_nothing():
    log = drive(BUILDING).log
    front_end = FrontEnd(log.scans.geometries, Config())
    good = log.scans.ranges_of(0)
    front_end.add_scan(good, 0.0, np.zeros(3))
    for ranges, stamp, odometry, laser, message in (
        (good[:-1], 1.0, np.zeros(3), 0, r"ranges_m must have shape \(\d+,\)"),
        (-good, 1.0, np.zeros(3), 0, "ranges must be positive"),
        (good, np.nan, np.zeros(3), 0, "stamp_s must be finite"),
        (good, 1.0, [0.0, np.inf, 0.0], 0, "odometry must be 3 finite numbers"),
        (good, 1.0, [0.0, 0.0], 0, "odometry must be 3 finite numbers"),
        (good, 1.0, None, 0, "without odometry"),
        (good, 1.0, np.zeros(3), 1, "there is no laser 1"),
    ):
        with pytest.raises(MapmendError, match=message):
            front_end.add_scan(ranges, stamp, odometry, laser)
    assert (len(front_end.graph.hung), len(front_end.graph)) == (1, 1)


def test_a_log_of_other_lasers_is_refused():
    """Their mounting differs: each scan would be taken for one of the wrong laser, and the map be wrong in silence."""
    log = drive(BUILDING).log
    front_end = FrontEnd([replace(log.scans.geometries[0], T_robot_laser=(0.0, 0.0, 0.8))], Config())
    with pytest.raises(MapmendError, match="lasers are not those"):
        front_end.run(log)
