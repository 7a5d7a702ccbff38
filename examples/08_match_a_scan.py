"""A log from arrays, as a driver gives them, and a scan of it matched on a grid of the scans before it."""

import numpy as np

import mapmend


def main(count: int = 60) -> None:
    # Here the arrays come from a simulation; with a laser of your own, they come from its driver.
    drive = mapmend.simulate(mapmend.random_building(1), seed=3)
    ranges_m = drive.log.scans.ranges_m.reshape(len(drive.log), -1)[:count]
    angles_rad = np.radians(np.arange(-90.0, 90.0))
    log = mapmend.ScanLog.from_arrays(
        ranges_m, angles_rad=angles_rad, max_range_m=8.0, stamps_s=0.2 * np.arange(count), odometry=drive.truth[:count]
    )

    geometry = log.scans.geometries[0]
    grid = mapmend.grid_of(ranges_m[:-1], geometry, log.odometry[:-1])
    start = log.odometry[-1] + (0.08, -0.05, 0.02)  # 8 cm, 5 cm and a degree off
    found = mapmend.match(grid, ranges_m[-1], geometry, start)
    off = found.pose - log.odometry[-1]
    print(f"converged: {found.converged}, score {found.score:.2f}")
    print(f"off by {1e3 * np.hypot(off[0], off[1]):.1f} mm and {np.degrees(abs(off[2])):.3f} deg")
    print("standard deviations along and across the robot [m]:", np.sqrt(np.diag(found.covariance)[:2]).round(4))


if __name__ == "__main__":
    main()
