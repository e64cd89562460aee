"""What every energy offers."""

from typing import Any, Protocol

from protochain.arrays import Floats


class Energy(Protocol):
    """A potential energy of atom positions, whichever engine computes it."""

    @property
    def engine(self) -> str:
        """Engine that computes it: ``openmm``."""

    @property
    def reason(self) -> str:
        """Which kernels run, and why, in a sentence."""

    @property
    def system(self) -> Any:
        """The OpenMM System it evaluates."""

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
    def reference(self) -> "Energy":
        """The same energy on OpenMM's Reference platform: double precision, the judge of every result."""

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the System."""

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy in kJ/mol and forces (na, 3) in kJ/mol/nm at positions x (na, 3) in nm."""
