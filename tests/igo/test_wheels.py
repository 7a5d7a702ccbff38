"""What a log shows of its wheels, and slip that a closed loop shows."""

import numpy as np

from mapmend.commands.demo import demo_drive
from mapmend.config import Config
from mapmend.front_end.builder import FrontEnd
from mapmend.igo.iterate import iterate
from mapmend.igo.wheels import learn_wheels
from tests.front_end.logs import errors_of


def test_wheels_are_as_right_as_they_are_but_for_slip():
    rng = np.random.default_rng(0)
    true = np.full(200, 0.3)
    reported = true / 1.02 + 0.02 * np.sqrt(0.3) * rng.standard_normal(200)
    reported[50:60] *= 1.6
    wheels = learn_wheels(true, reported)
    assert abs(wheels.scale_off - 0.02) < 0.005
    assert abs(wheels.std_after_1_m - 0.02) < 0.005
    assert wheels.have_slipped(10.0, 9.0)
    assert not wheels.have_slipped(10.0, 9.8)
    assert not wheels.have_slipped(10.0, 11.0)
    assert learn_wheels(true[:5], reported[:5]) is None


def test_the_corridor_where_wheels_slipped_takes_the_loops_error():
    """Wheels report too much and never too little: of two opposite corridors, the one that is too long is wrong."""
    simulation = demo_drive(2)
    graph = FrontEnd(simulation.log.scans.geometries, Config()).run(simulation.log)
    go = errors_of(simulation, graph.scan_poses()).translation_rmse_m
    iterate(graph)
    assert errors_of(simulation, graph.scan_poses()).translation_rmse_m < 0.6 * go
