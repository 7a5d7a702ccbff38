"""Let the scans say which loops to trust: ... 07_tune_a_kernel.py GRAPH BEST.g2o"""

import sys

import numpy as np

import mapmend


def main(path: str, best: str) -> None:
    graph = mapmend.read_graph(path)
    result = mapmend.tune(graph, threads=2)
    print(f"phi = {result.phi:.4g}: scans contradict each other by {result.measure_m:.3f} m a pair")
    for phi, measure_m in zip(result.curve_phi[::16], result.curve_m[::16], strict=True):
        print(f"  phi = {phi:6.3f}: {measure_m:.3f} m")
    off = result.switched_off
    print(f"switched off {len(off)} of {np.count_nonzero(graph.is_loop)} loops; consistent: {result.consistent}")
    mapmend.write_graph(best, result.graph)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
