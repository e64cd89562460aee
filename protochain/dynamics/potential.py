"""Potential of a chain in a force field, as integrators see it."""

from protochain.chain import Chain, Pose, place_atoms, pull_back
from protochain.core.arrays import Floats
from protochain.energies.protocol import Energy
from protochain.mechanics.motion.system import Potential
from protochain.mechanics.multibody.articulated import Articulated


def chain_potential(chain: Chain, energy: Energy) -> Potential:
    """Potential of a chain in a force field.

    Parameters
    ----------
    chain : Chain
        Chain of rigid bodies.
    energy : Energy
        Force field in Cartesian coordinates.

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
