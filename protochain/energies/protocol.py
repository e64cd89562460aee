"""What every energy offers."""

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

from protochain.arrays import Floats, Integers
from protochain.errors import ProtochainError
from protochain.structure.model import Structure


@runtime_checkable
class Energy(Protocol):
    """A potential energy of atom positions, whichever engine computes it."""

    @property
    def engine(self) -> str:
        """Engine that computes it: ``native``, ``openmm`` or ``custom``."""

    @property
    def reason(self) -> str:
        """Which kernels run, and why, in a sentence."""

    @property
    def system(self) -> Any:
        """The OpenMM System it evaluates."""

    @property
    def atoms(self) -> str:
        """Fingerprint of the structure it was built for; empty if its System was given."""

    @property
    def forcefield(self) -> str:
        """Name of the force field."""

    @property
    def solvent(self) -> str:
        """Name of the solvent model."""

    @property
    def threads(self) -> int:
        """Threads it computes on."""

    @property
    def is_exact(self) -> bool:
        """Whether it computes in double precision, so that nothing is gained by going on elsewhere."""

    @property
    def left_out(self) -> Mapping[str, int]:
        """Terms and pairs that are constant and left out, by kind."""

    def without_constants(self, groups: Integers, x: Floats) -> "Energy":
        """Leave out what keeps its value while groups of atoms (na, k) stay rigid as they are at x."""

    @property
    def reference(self) -> "Energy":
        """The same energy on OpenMM's Reference platform: double precision, the judge of every result."""

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the System."""

    @property
    def lists_at(self) -> Floats | None:
        """Positions (na, 3) in nm that its neighbour lists were made at, if it keeps any of its own."""

    def list_at(self, x: Floats) -> None:
        """Make its neighbour lists as they are at positions x (na, 3), as after computing there first."""

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy in kJ/mol and forces (na, 3) in kJ/mol/nm at positions x (na, 3) in nm."""


def check_is_of(energy: Energy, structure: Structure) -> None:
    """Refuse an energy that was built for another molecule, whose atoms may be as many.

    Raises
    ------
    ProtochainError
        Naming the mend.
    """
    if energy.atoms and energy.atoms != structure.fingerprint:
        raise ProtochainError(
            f"the energy was built for other atoms than those of {structure.name}; give pc.energy(structure)"
        )
