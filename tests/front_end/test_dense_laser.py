"""A laser of many noisy beams maps no worse than one of few."""

import numpy as np

from mapmend.config import Config
from mapmend.evaluation.trajectory import trajectory_errors
from mapmend.front_end.builder import FrontEnd
from mapmend.scan import LaserGeometry
from mapmend.simulation import LaserModel, random_building, simulate

DENSE = LaserGeometry(1441, -np.pi / 2.0, np.pi / 1440.0, 8.0)


def test_eight_beams_a_degree_with_3_cm_of_noise():
    """With normals between next neighbours: 0.20 m."""
    drive = simulate(random_building(302), LaserModel(DENSE, range_noise_std_m=0.03), None, 302)
    log = drive.log
    poses = FrontEnd(log.scans.geometries, Config()).run(log).scan_poses()
    assert trajectory_errors(log.stamps_s, poses, log.stamps_s, drive.truth).translation_rmse_m < 0.05
