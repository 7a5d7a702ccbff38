"""How right are maps of simulated buildings that no setting was chosen on, and how bad is the worst of them?

Each building is driven three times: with the wheels as they are, with wheels that turn 0.02 rad too far a metre and
count 3 % too much, and among people who stand in three beams of ten, anew in every scan.
"""

from __future__ import annotations

import argparse

import numpy as np
from _measure import markdown

from mapmend.config import Config
from mapmend.evaluation.altered_logs import with_people
from mapmend.evaluation.trajectory import TrajectoryErrors, trajectory_errors
from mapmend.front_end.builder import FrontEnd
from mapmend.simulation import OdometryModel, random_building, simulate

BENT = OdometryModel(rotation_bias_radpm=0.02, translation_scale=1.03)
DRIVES = {"as they are": (None, 0.0), "bent odometry": (BENT, 0.0), "people": (None, 0.3)}
HEAD = ("drive", "buildings", "median error [m]", "worst [m]", "in building", "largest of any scan [m]", "loops")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=24, metavar="N", help="buildings (default: 24)")
    parser.add_argument("--first", type=int, default=100, metavar="SEED", help="of the first (default: 100)")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.seeds)
    rows = []
    for name, (odometry, share) in DRIVES.items():
        measured = [drive(seed, odometry, share) for seed in seeds]
        errors = np.array([one.translation_rmse_m for one, _ in measured])
        worst = int(np.argmax(errors))
        largest = max(one.translation_max_m for one, _ in measured)
        loops = sum(count for _, count in measured)
        cells = (f"{np.median(errors):.3f}", f"{errors[worst]:.3f}", str(seeds[worst]), f"{largest:.3f}", str(loops))
        rows.append((name, str(len(seeds)), *cells))
    print(markdown(HEAD, rows))


def drive(seed: int, odometry: OdometryModel | None, share: float) -> tuple[TrajectoryErrors, int]:
    """The absolute trajectory error of a drive through a building, mapped with defaults, and how many loops closed."""
    simulation = simulate(random_building(seed), None, odometry, seed)
    log = with_people(simulation.log, share, seed)
    state = FrontEnd(log, Config()).run()
    return trajectory_errors(log.stamps_s, state.scan_poses(), log.stamps_s, simulation.truth), len(state.loops)


if __name__ == "__main__":
    main()
