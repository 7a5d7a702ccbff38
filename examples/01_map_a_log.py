"""Map a log and look at the result: python examples/01_map_a_log.py LOG RUN"""

import sys

import mapmend


def main(log_path: str, run_folder: str) -> None:
    log = mapmend.read_log(log_path)
    result = mapmend.build_map(log)
    mapmend.write_run(result, run_folder, source=log_path)

    print(f"{result.counts['scans']} scans, {result.counts['nodes']} nodes, {result.counts['loop_edges']} loop edges")
    print(f"chi2 {result.chi2_initial:.1f} by odometry edges alone, {result.chi2_final:.1f} optimized")
    rows, columns = result.occupancy.image.shape
    print(f"map of {columns} x {rows} cells of {result.occupancy.resolution_m} m: {run_folder}/map.png")


if __name__ == "__main__":
    main(*sys.argv[1:3])
