"""The rival measure against its plain twin, and what it says of right and wrong maps."""

import numpy as np

from mapmend.config import ConsistencyConfig
from mapmend.consistency.visibility import view_scans
from mapmend.geometry import se2
from mapmend.lab.haehnel import CELL_M, count_over_grids, log_likelihoods
from tests.consistency.scenes import room_graph
from tests.reference import lab_haehnel as plain

CONFIG = ConsistencyConfig()


def test_counts_are_those_of_the_plain_grid():
    graph = room_graph(10)
    views = view_scans(graph.scans, CONFIG).placed(graph.poses)
    pairs = np.array([(0, 3), (0, 8), (2, 5)])
    seen = views.scans
    rays = seen.beams.rays[0, : seen.beams.counts[0]]
    for (i, j), got in zip(pairs, count_over_grids(views, pairs), strict=True):
        begin = seen.polygons.offsets[i]
        reaches = np.hypot(*seen.polygons.corners[:2, begin : begin + len(rays)])
        ends = [seen.points.xy[seen.points.offsets[k] : seen.points.offsets[k + 1]] for k in (i, j)]
        cells = plain.grid_of(reaches, rays, ends[0], CELL_M)
        placed = se2.transform_points(se2.between(graph.poses[i], graph.poses[j]), ends[1])
        assert got.tolist() == list(plain.counts_over(cells, placed, CELL_M))


def test_a_double_wall_is_less_likely():
    graph = room_graph(40)
    views = view_scans(graph.scans, CONFIG)
    right = log_likelihoods(views.placed(graph.poses))
    poses = graph.poses.copy()
    poses[20:, 0] += 0.4
    wrong = log_likelihoods(views.placed(poses), threads=2)
    assert wrong.mean.mean() < right.mean.mean() - 0.1
    assert right.mean.max() <= np.log(0.9) + 1e-12
