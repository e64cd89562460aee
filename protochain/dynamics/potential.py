"""Potentials of a chain for integrators: its force field, and corrections for rigid bonds."""

from collections.abc import Callable

from protochain.chains.chain import Chain, Pose, place_atoms, pull_back
from protochain.core.arrays import Floats
from protochain.dynamics.closure import Closure
from protochain.mechanics.motion.system import Potential
from protochain.mechanics.multibody import articulated
from protochain.mechanics.multibody.articulated import Articulated
from protochain.mechanics.multibody.operational import gradient_of_log_det


def chain_potential(chain: Chain, energy: Callable[[Floats], tuple[float, Floats]]) -> Potential:
    """Potential of a chain in a force field.

    Parameters
    ----------
    chain : Chain
        Chain of rigid bodies.
    energy : callable
        Force field, or restraints, in Cartesian coordinates.

    Returns
    -------
    callable
        Energy and torques at q.
    """

    def potential(q: Floats, factors: Articulated) -> tuple[float, Floats]:
        x = place_atoms(chain, factors.frames)
        value, forces = energy(x)
        return value, pull_back(chain, Pose(q, factors.frames, x), forces)

    return potential


def fixman(thermal_energy: float, closure: Closure | None = None) -> Potential:
    """Build Fixman's potential, with which rigid bonds and angles sample torsions like stiff springs.

    Parameters
    ----------
    thermal_energy : float, kJ/mol
        Value of kT.
    closure : Closure, optional
        Constraints that close loops.

    Returns
    -------
    callable
        Potential (kT/2) ln det M, to be added to the force field. Without it the density of sampled torsions
        has an additional factor sqrt(det M). With closed loops it is (kT/2) (ln det M + ln det G M^-1 G^T),
        with G the gradients of the distances. The density then equals the density with stiff springs.

    Notes
    -----
    Fixman, PNAS 71:3050 (1974). The torque is by Jain, Kandel, Wagner, Larsen, Vaidehi, J. Chem. Phys.
    139:244103 (2013). O(n), with closed loops O(m n). Each hinge that opens a bond angle would also need
    -kT ln sin(angle). This is omitted, since angles hardly leave their minima.
    """

    def potential(q: Floats, factors: Articulated) -> tuple[float, Floats]:
        half = 0.5 * thermal_energy
        value, gradient = articulated.log_det(factors), gradient_of_log_det(factors)
        if closure is not None:
            of_loops, along = closure.log_det(factors)
            value, gradient = value + of_loops, gradient + along
        return half * value, -half * gradient

    return potential
