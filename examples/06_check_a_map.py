"""Check whether a map can be trusted, and where not: ... 06_check_a_map.py GRAPH"""

import sys

import mapmend


def main(path: str) -> None:
    graph = mapmend.read_graph(path)
    result = mapmend.check(graph, threads=2)
    print(f"{'consistent' if result.consistent else 'INCONSISTENT'}, p = {result.p_value:.3g}")
    print(f"{result.scans.failed.sum()} of {len(graph)} scans contradict the others")
    for region in result.regions[:3]:
        x, y = region.place_m
        print(f"near ({x:.1f}, {y:.1f}): {len(region.scans)} scans, {region.failures} pairs")


if __name__ == "__main__":
    main(sys.argv[1])
