"""Rooms driven through twice by a robot whose odometry drifts, and whose loops may be false."""

from dataclasses import replace

import numpy as np

from mapmend.geometry import se2
from tests.consistency.scenes import room_graph

STEP_STD_M, TURN_RAD = 0.003, 0.004
"""The noise of a step, and how far each turns to the left unseen: 14 degrees in all."""


def doubtful_room(false_loops=3, off_m=0.6, nodes=60):
    """A graph at its true poses, its odometry noisy, its true loops right, and ``false_loops`` loops ``off_m`` off.

    Returns the graph and bool (m,), which edges are false.
    """
    graph = room_graph(nodes)
    first = np.arange(0, nodes // 2 - 6, 3)
    true = np.stack((first, nodes - 1 - first), axis=1)
    first = np.arange(false_loops) + 5
    edges = np.concatenate((graph.edges[: nodes - 1], true, np.stack((first, nodes - 8 - first), axis=1)))
    is_false = np.arange(len(edges)) >= nodes - 1 + len(true)
    is_loop = np.arange(len(edges)) >= nodes - 1
    measured = se2.between(graph.poses[edges[:, 0]], graph.poses[edges[:, 1]])
    measured[is_false, 0] += off_m
    noise = np.random.default_rng(5).standard_normal((len(edges), 3)) * (STEP_STD_M, STEP_STD_M, 0.0)
    measured[~is_loop] += noise[~is_loop] + (0.0, 0.0, TURN_RAD)
    odometry = np.diag((STEP_STD_M, STEP_STD_M, TURN_RAD)) ** 2
    information = np.where(is_loop[:, None, None], np.diag((400.0, 400.0, 2500.0)), np.linalg.inv(odometry))
    return replace(graph, edges=edges, measurements=measured, information=information, is_loop=is_loop), is_false


def room_of_two_valleys():
    """False loops that disagree with each other too, so that M(phi) of DCS has a second minimum at the largest phi."""
    graph, is_false = doubtful_room(10, 0.3)
    measurements = graph.measurements.copy()
    spread = np.random.default_rng(2).uniform(-0.6, 0.6, (10, 3))
    measurements[is_false] += spread * (1.0, 1.0, 0.1)
    return replace(graph, measurements=measurements)


def hopeless_room():
    """A graph with one wrong odometry edge, which no kernel doubts, and with loops that agree with it."""
    graph, _ = doubtful_room(0)
    measurements = graph.measurements.copy()
    measurements[29, :2] += 0.6
    measurements[graph.is_loop, 0] += 0.6
    return replace(graph, measurements=measurements)
