"""The back end beside GTSAM's, and the optima published for public graphs.

GTSAM's error is the logarithm of ours. The two agree for zero residuals and differ in their second order: chi2 by the
third order, and the Jacobians, and so the covariances, by the first (half the residual angle, some 0.01 rad on these
graphs). So covariances are compared with a tight tolerance on the same graphs with residuals of zero, and with a loose
one on the graphs as they are.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mapmend.geometry import se2
from mapmend.graph.marginals import marginals, relative_covariances
from mapmend.graph.optimizer import optimize
from mapmend.graph.pose_graph import PoseGraph
from mapmend.graph.starts import starting_poses
from tests.graph.graphs import consistent, perturbed, random_graph, read_public_graph

gtsam = pytest.importorskip("gtsam")

PRIOR_SIGMA = 1e-6


class Twin:
    """The same graph optimized by GTSAM, its first pose held by a tight prior."""

    def __init__(self, graph: PoseGraph) -> None:
        self.factors, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for k, pose in enumerate(graph.poses):
            start.insert(k, gtsam.Pose2(*pose))
        for (i, j), measurement, information in zip(graph.edges, graph.measurements, graph.information, strict=True):
            model = gtsam.noiseModel.Gaussian.Information(information)
            self.factors.add(gtsam.BetweenFactorPose2(int(i), int(j), gtsam.Pose2(*measurement), model))
        prior = gtsam.noiseModel.Isotropic.Sigma(3, PRIOR_SIGMA)
        self.factors.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*graph.poses[0]), prior))
        parameters = gtsam.GaussNewtonParams()
        parameters.setRelativeErrorTol(1e-12)
        parameters.setAbsoluteErrorTol(1e-12)
        self.values = gtsam.GaussNewtonOptimizer(self.factors, start, parameters).optimize()
        self.chi2 = 2.0 * self.factors.error(self.values)
        found = [self.values.atPose2(k) for k in range(len(graph))]
        self.poses = np.array([[pose.x(), pose.y(), pose.theta()] for pose in found])
        self.marginals = gtsam.Marginals(self.factors, self.values)

    def covariance(self, node: int) -> NDArray[np.float64]:
        return self.marginals.marginalCovariance(int(node))

    def joint(self, first: int, second: int) -> NDArray[np.float64]:
        """The covariance of two nodes together, shape (6, 6)."""
        keys = [int(first), int(second)]
        joint = self.marginals.jointMarginalCovariance(keys)
        return np.block([[joint.at(a, b) for b in keys] for a in keys])


def largest_relative_difference(ours, theirs) -> float:
    return float(np.abs(ours - theirs).max() / np.abs(theirs).max())


def compare(graph: PoseGraph, nodes, chi2_tolerance: float, covariance_tolerance: float) -> float:
    """Optima and marginals beside GTSAM's; our chi2."""
    result, twin = optimize(graph), Twin(graph)
    covariances = marginals(result.factorization)
    difference = result.poses - twin.poses
    difference[:, 2] = se2.wrap_angle(difference[:, 2])
    assert np.abs(difference).max() < 2e-3
    assert result.chi2_final == pytest.approx(twin.chi2, rel=chi2_tolerance, abs=1e-8)
    for node in nodes:
        assert largest_relative_difference(covariances[node], twin.covariance(node)) < covariance_tolerance
    return result.chi2_final


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("noise", [1.0, 0.1, 0.01, 0.0])
def test_random_graphs_agree_the_better_the_smaller_the_residuals(seed, noise):
    graph = perturbed(random_graph(seed, nodes=40, loops=30, noise=noise), seed, 0.02)
    compare(graph, range(1, 40), chi2_tolerance=5e-3 * noise, covariance_tolerance=2e-2 * noise + 1e-5)


def test_relative_covariances():
    graph = consistent(random_graph(11, nodes=40, loops=30))
    result, twin = optimize(graph), Twin(graph)
    ours = relative_covariances(result.factorization, graph.poses, marginals(result.factorization), 35)
    for other in (1, 5, 20, 34, 39):
        carry = np.hstack((-se2.adjoint(se2.between(graph.poses[35], graph.poses[other])), np.eye(3)))
        assert largest_relative_difference(ours[other], carry @ twin.joint(other, 35) @ carry.T) < 1e-6


# chi2: 137.913 is published for M3500; that of intel is this repository's own, as GTSAM confirms it.
@pytest.mark.parametrize(("name", "chi2", "tolerance"), [("intel", 546.461, 2e-3), ("M3500", 137.913, 1e-2)])
def test_public_graphs(name, chi2, tolerance):
    graph = read_public_graph(name)
    nodes = range(1, len(graph), 17)
    assert compare(graph, nodes, chi2_tolerance=2e-5, covariance_tolerance=tolerance) == pytest.approx(chi2, abs=1e-3)
    solved = consistent(graph.with_poses(optimize(graph).poses))
    compare(solved, nodes, chi2_tolerance=0.0, covariance_tolerance=1e-5)


@pytest.mark.parametrize(("name", "chi2"), [("intel", 546.461), ("M3500", 137.913), ("ringCity", 262.818)])
def test_the_optimum_is_found_from_odometry(name, chi2):
    graph = read_public_graph(name)
    poses = graph.poses.copy()
    steps = {int(i): k for k, (i, j) in reversed(list(enumerate(graph.edges))) if j == i + 1}
    for k in range(len(poses) - 1):
        poses[k + 1] = se2.compose(poses[k], graph.measurements[steps[k]])
    result = optimize(graph.with_poses(poses))
    assert result.converged
    assert result.chi2_final == pytest.approx(chi2, abs=1e-3)


def test_gtsam_stays_where_rotations_first_lead_m3500a():
    graph = read_public_graph("M3500a")
    result = optimize(graph.with_poses(starting_poses(graph, "chordal")))
    twin = Twin(graph.with_poses(result.poses))
    # With larger residuals, the difference of its logarithm grows: 912.19 against 912.12.
    assert result.chi2_final < twin.chi2 < 1.0002 * result.chi2_final
