"""Descents with a robust kernel on some edges: by weights, and by switches as additional variables."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mapmend.graph.descent import LEAST_DAMPING, Descent
from mapmend.graph.pose_graph import Float, PoseGraph
from mapmend.graph.robust import Kernel, Switchable
from mapmend.graph.system import Linearization, System


class KernelDescent(Descent):
    """Some edges cost ``rho(c)`` and weigh ``w(c)``: iteratively reweighted least squares."""

    first_damping = LEAST_DAMPING

    def __init__(
        self, system: System, graph: PoseGraph, information: Float, kernel: Kernel, doubted: NDArray[np.bool_]
    ) -> None:
        self.kernel = kernel
        self.doubted = doubted
        super().__init__(system, graph, information)

    def take(self, step: Float, whatever: bool) -> bool:
        poses = self.system.move(self.poses, step)
        chi2 = self._errors(poses)[1]
        cost = self._cost(chi2)
        if not self._is_better(cost, whatever):
            return False
        self.poses, self.edge_chi2 = poses, chi2
        self._weigh(cost)
        return True

    def weights(self) -> Float:
        weights = np.ones(len(self.edge_chi2))
        weights[self.doubted] = self.kernel.weight(self.edge_chi2[self.doubted])
        return weights

    def use(self, kernel: Kernel) -> None:
        """The same poses under another kernel."""
        self.kernel = kernel
        self._weigh(self._cost(self.edge_chi2))

    def restart(self, poses: Float) -> None:
        """The same kernel at other poses, shape (n, 3)."""
        self.poses = poses
        self._begin()

    def part(self, kept: NDArray[np.bool_]) -> KernelDescent:
        """The same kernel and poses with only the edges ``kept``, shape (m,); they must still connect every node."""
        graph = replace(self.graph.with_edges(kept), poses=self.poses, measurements=self.measurements[kept])
        return KernelDescent(System(graph), graph, self.information[kept], self.kernel, self.doubted[kept])

    def _begin(self) -> None:
        self.edge_chi2 = self._errors(self.poses)[1]
        self._weigh(self._cost(self.edge_chi2))

    def _cost(self, chi2: Float) -> float:
        return float(chi2[~self.doubted].sum() + self.kernel.cost(chi2[self.doubted]).sum())

    def _weigh(self, cost: float) -> None:
        weighted = self.information * self.weights()[:, None, None]
        self.chi2 = float(self.edge_chi2.sum())
        self.cost, self.here = cost, self.system.linearize(self.poses, self.measurements, weighted)


class SwitchDescent(Descent):
    """One switch s for each doubted edge, moved together with the poses (Suenderhauf and Protzel 2012).

    The residuals of an edge are ``s sqrt(Omega) e`` and ``sqrt(Xi) (1 - s)`` with Xi = phi. A switch is connected only
    to its own edge and its prior, so it is eliminated exactly: with ``r = Omega e``, the Schur complement leaves the
    edge the information ``s^2 (Omega - r r^T / (c + Xi))`` in H and the gradient ``s Xi / (c + Xi) J^T r``. The pattern
    remains that of the graph, and once the poses' step is known, each switch's own follows from it.
    """

    first_damping = LEAST_DAMPING

    def __init__(
        self, system: System, graph: PoseGraph, information: Float, kernel: Switchable, doubted: NDArray[np.bool_]
    ) -> None:
        self.kernel = kernel
        self.doubted = doubted
        self.switches = np.ones(int(doubted.sum()))
        super().__init__(system, graph, information)

    def propose(self, damping: float) -> tuple[Float, float]:
        """The poses' part of the step; the gain is that of poses and switches together."""
        step, gain = super().propose(damping)
        return step, gain + float((self.slope**2 / self.stiffness).sum())

    def take(self, step: Float, whatever: bool) -> bool:
        poses = self.system.move(self.poses, step)
        switches = self.switches + self._switch_steps(step)
        errors, chi2 = self._errors(poses)
        cost = self._cost(switches, chi2)
        if not self._is_better(cost, whatever):
            return False
        self.poses, self.switches = poses, switches
        self._eliminate(errors, chi2, cost)
        return True

    def weights(self) -> Float:
        weights = np.ones(len(self.measurements))
        weights[self.doubted] = self.switches**2
        return weights

    def _begin(self) -> None:
        errors, chi2 = self._errors(self.poses)
        self._eliminate(errors, chi2, self._cost(self.switches, chi2))

    def _cost(self, switches: Float, chi2: Float) -> float:
        return float(chi2[~self.doubted].sum() + self.kernel.cost_at(switches, chi2[self.doubted]).sum())

    def _eliminate(self, errors: Float, chi2: Float, cost: float) -> None:
        """The normal equations of the poses alone."""
        self.chi2 = float(chi2.sum())
        s, xi = self.switches, self.kernel.phi
        omega, c = self.information[self.doubted], chi2[self.doubted]
        self.pull = np.einsum("mij,mj->mi", omega, errors[self.doubted])
        self.stiffness = c + xi
        curved, pulled = self.information.copy(), self.information.copy()
        outer = self.pull[:, :, None] * self.pull[:, None, :]
        curved[self.doubted] = (s**2)[:, None, None] * (omega - outer / self.stiffness[:, None, None])
        pulled[self.doubted] = (s * xi / self.stiffness)[:, None, None] * omega
        self.slope = s * c - xi * (1.0 - s)
        values = self.system.linearize(self.poses, self.measurements, curved).values
        gradient = self.system.linearize(self.poses, self.measurements, pulled).gradient
        self.cost, self.here = cost, Linearization(cost, values, gradient)

    def _switch_steps(self, step: Float) -> Float:
        """The switches' part of the joint step: ``-(g_s + H_sx d) / H_ss`` of each."""
        motions = np.zeros_like(self.poses)
        motions[self.system.nodes] = step.reshape(-1, 3)
        along = np.einsum("mi,mi->m", self.pull, self._error_changes(motions))
        return -(self.slope + self.switches * along) / self.stiffness

    def _error_changes(self, motions: Float) -> Float:
        """``J d`` of the doubted edges, shape (k, 3), for motions (n, 3) of the nodes in their own frames."""
        i, j = self.system.edges[self.doubted].T
        turn_m = self.measurements[self.doubted, 2]
        turn_i, turn_ij = self.poses[i, 2], self.poses[j, 2] - self.poses[i, 2]
        lever = _turned(self.poses[j, :2] - self.poses[i, :2], -turn_i)
        swept = np.stack((-lever[:, 1], lever[:, 0]), axis=1) * motions[i, 2:]
        shift = _turned(motions[j, :2], turn_ij) - motions[i, :2] - swept
        return np.column_stack((_turned(shift, -turn_m), motions[j, 2] - motions[i, 2]))


def _turned(vectors: Float, angles: Float) -> Float:
    """Vectors (k, 2) turned by angles (k,)."""
    cos, sin = np.cos(angles), np.sin(angles)
    return np.stack((cos * vectors[:, 0] - sin * vectors[:, 1], sin * vectors[:, 0] + cos * vectors[:, 1]), axis=1)
