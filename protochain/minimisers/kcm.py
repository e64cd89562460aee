"""The kineto-static compliance method."""

from dataclasses import dataclass

from protochain.minimisers.problem import Evaluation, Problem


@dataclass(frozen=True)
class Standing:
    """State of a method without memory: where it stands."""

    at: Evaluation


@dataclass(frozen=True)
class KCM:
    """Turn every hinge in proportion to its torque, the one with the largest by exactly ``max_angle``.

    theta_{k+1} = theta_k + h tau_k / max|tau_k|: Kazerounian, Latif, Alvarado, J. Mech. Des. 127:712
    (2005). No masses, no velocities, no line search: as published. With h fixed it descends fast and then
    circles the minimum at a distance of about h.

    Parameters
    ----------
    max_angle : float, rad
        h. The default lowers the energy of every sample; half of it is slower everywhere, and twice as
        much first raises the energy of packed proteins of a hundred residues and more, where a small
        turn in mid-chain moves much.
    """

    max_angle: float = 0.0005

    def init(self, at: Evaluation) -> Standing:
        """Stand at the start."""
        return Standing(at)

    def step(self, problem: Problem, state: Standing) -> Standing:
        """Turn by the normalised torques."""
        direction = state.at.torque / state.at.max_torque
        return Standing(problem.evaluate(problem.move(state.at.q, self.max_angle * direction)))
