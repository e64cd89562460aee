"""Frame of results: the frame of the start, unless a run is fixed in space."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from protochain.chains.chain import Chain
from protochain.core.arrays import Floats, freeze
from protochain.energies.protocol import Energy
from protochain.structure.molecule.model import Structure
from protochain.structure.superpose import deviation_angstrom, motion, rmsd_angstrom

_TURN = Rotation.from_rotvec([0.4, -0.7, 0.5]).as_matrix()
_SHIFTS = np.array([[0.3, 0.2, -0.4], [6.0, 4.0, -8.0]])
"""A rotation and two shifts (nm) that change energies of external fields, such as maps and distant walls."""
_UNCHANGED = 1e-6  # Relative change of an energy by the rounding of moved coordinates.


@dataclass(frozen=True, eq=False)
class Frame:
    """Frame in which positions leave a run."""

    # A free run drifts, because its energy does not depend on the place. Its positions are superposed on the
    # start by one rigid motion of all atoms, which changes no distance. A run that is fixed in space is not
    # superposed.

    start: Structure  # Structure to superpose on.
    held_by: str = ""  # Cause of the fixed position, empty for a free run.
    superpose: bool = True  # False for the positions of the run itself.

    def __call__(self, x: Floats) -> Floats:
        """Positions (na, 3) of the run in this frame."""
        if self.held_by or not (self.superpose and np.isfinite(x).all()):
            return x
        alpha = self.start.alpha_carbons
        # Two points do not determine a rotation.
        fitted = alpha if len(alpha) > 2 else np.arange(len(x))
        turn, shift = motion(x[fitted], self.start.positions[fitted])
        return freeze(x @ turn.T + shift)

    def ca_rmsds(self, x: Floats) -> tuple[float, float]:
        """C-alpha RMSDs to the start in angstrom, with and without superposition."""
        alpha = self.start.alpha_carbons
        pair = x[alpha], self.start.positions[alpha]
        return rmsd_angstrom(*pair), deviation_angstrom(*pair)

    def __str__(self) -> str:
        free = "superposed on the start" if self.superpose else "as the run went"
        return f"held by {self.held_by}" if self.held_by else free


def frame_of(chain: Chain, energy: Energy, held_by: str = "") -> Frame:
    """Frame of a run's results. ``held_by``, fixed atoms or the energy of all terms can fix it in space."""
    if not chain.moving.all():
        held_by = "atoms that stand still"
    # Force fields are translation-invariant. A System or callable of the caller need not be.
    elif not held_by and depends_on_place(energy, chain.structure.positions):
        held_by = "its energy"
    return Frame(chain.structure, held_by)


def depends_on_place(energy: Energy, x: Floats) -> bool:
    """Whether the energy changes when all atoms move as one, which force fields with atoms never do."""
    if energy.atoms:
        return False
    value, forces = energy.exact(x)
    # The forces show terms that are much larger than their sum.
    scale = abs(value) + float(np.linalg.norm(forces)) + 1.0
    moved = (energy.exact(x @ _TURN.T + shift)[0] for shift in _SHIFTS)
    # NaN, as outside a map, is a change.
    return not all(abs(energy_there - value) <= _UNCHANGED * scale for energy_there in moved)
