"""Simulate a robot whose wheels slip, map its log by each method, and compare with what really happened."""

import sys

import mapmend


def main(seed: int = 1) -> None:
    # Eight metres into the drive the wheels report two metres, of which a half does not happen.
    slippery = mapmend.OdometryModel(slips=(mapmend.SlipEvent(start_m=8.0, length_m=2.0, share=0.5),))
    simulation = mapmend.simulate(mapmend.random_building(seed), odometry=slippery, seed=seed)
    stamps = simulation.log.stamps_s

    for method in ("odometry", "scanmatch", "go"):
        result = mapmend.build_map(simulation.log, method)
        errors = mapmend.trajectory_errors(stamps, result.trajectory.poses, stamps, simulation.truth)
        print(f"{method:10} {errors.translation_rmse_m:7.3f} m {errors.rotation_mean_deg:6.2f} deg")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
