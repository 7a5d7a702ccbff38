"""Measure a RUN and the raw odometry of its log against a reference: ... 04_evaluate.py RUN LOG REFERENCE.tum"""

import sys

import mapmend


def main(run_folder: str, log_path: str, reference_path: str) -> None:
    reference = mapmend.read_trajectory(reference_path)
    log = mapmend.read_log(log_path)
    trajectory = mapmend.read_trajectory(run_folder)

    for name, stamps, poses in (
        ("odometry", log.stamps_s, log.odometry),
        ("run", trajectory.stamps_s, trajectory.poses),
    ):
        absolute = mapmend.trajectory_errors(stamps, poses, reference.stamps_s, reference.poses)
        relative = mapmend.relative_errors(stamps, poses, reference.stamps_s, reference.poses, distance_m=1.0)
        print(
            f"{name:10} {absolute.translation_rmse_m:.3f} m after alignment, "
            f"{relative.translation_rmse_m:.3f} m and {relative.rotation_mean_deg:.2f} deg over each metre"
        )


if __name__ == "__main__":
    main(*sys.argv[1:4])
