"""Interface of all energies."""

from collections.abc import Mapping
from typing import Any, Protocol

from protochain.core.arrays import Floats, Integers
from protochain.core.checks import shown
from protochain.core.errors import ProtochainError, refused
from protochain.structure.molecule.model import Structure


class Energy(Protocol):
    """Potential energy of atom positions, by any engine."""

    @property
    def engine(self) -> str:
        """Name of the engine: ``native``, ``openmm`` or ``custom``."""

    @property
    def device(self) -> str:
        """What it computes on: ``cpu``, or ``cuda``, ``hip`` or ``opencl`` by a platform of OpenMM."""

    @property
    def reason(self) -> str:
        """Kernels, precision and threads in use, and the reason for them."""

    @property
    def system(self) -> Any:
        """OpenMM System that it evaluates; None for a custom energy."""

    @property
    def atoms(self) -> str:
        """Fingerprint of the structure it was built for; empty if a System or callable was given."""

    @property
    def forcefield(self) -> str:
        """Name of the force field."""

    @property
    def solvent(self) -> str:
        """Name of the solvent model."""

    @property
    def settings(self) -> Mapping[str, Any]:
        """Arguments of :func:`protochain.energy` that it was built with; none of a callable."""

    @property
    def threads(self) -> int:
        """Number of threads."""

    @property
    def is_exact(self) -> bool:
        """Whether it computes in double precision, so that the reference would gain nothing."""

    @property
    def left_out(self) -> Mapping[str, int]:
        """Numbers of constant terms and pairs that are left out, by kind."""

    def without_constants(self, groups: Integers, x: Floats) -> "Energy":
        """Leave out terms that are constant while groups of atoms (na, k) stay rigid as they are at x."""

    @property
    def reference(self) -> "Energy":
        """The same energy on OpenMM's Reference platform, in double precision; of a callable, itself."""

    @property
    def exact(self) -> "Energy":
        """The same energy in double precision, all pairs one by one: itself, or its reference."""

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the System, or of the name of a callable."""

    @property
    def lists_at(self) -> Floats | None:
        """Positions (na, 3) in nm at which its neighbour lists were built; None without such lists."""

    def list_at(self, x: Floats) -> None:
        """Build its neighbour lists at positions x (na, 3) in nm."""

    def parts(self, x: Floats) -> tuple[dict[str, float], Floats]:
        """Energies in kJ/mol by kind, or by force of the System, and forces (na, 3) in kJ/mol/nm, at x in nm.

        Energies of equal names are added.
        """

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy in kJ/mol and forces (na, 3) in kJ/mol/nm at positions x (na, 3) in nm."""


def an_energy(value: Any, name: str) -> Energy:
    """Return an Energy as it is, known by a method: what asked for all would compute the properties, too."""
    if hasattr(value, "without_constants"):
        return value
    raise refused(name, shown(value), "give an Energy, as of protochain.energy(structure)")


def check_is_of(energy: Energy, structure: Structure) -> None:
    """Refuse an energy that was built for another structure, even one with as many atoms."""
    if energy.atoms and energy.atoms != structure.fingerprint:
        raise ProtochainError(
            f"the energy was built for other atoms than those of {structure.name}; give pc.energy(structure)"
        )
