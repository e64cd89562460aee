"""Interface of all energies."""

from collections.abc import Mapping
from typing import Any, Protocol

from protochain.core.arrays import Floats, Integers
from protochain.core.checks import brief
from protochain.core.errors import ProtochainError, refusal
from protochain.structure.molecule.model import Structure


class Energy(Protocol):
    """Potential energy of atom positions, by any engine."""

    @property
    def engine(self) -> str:
        """Name of the engine: ``native``, ``openmm`` or ``custom``."""

    @property
    def device(self) -> str:
        """Device in use: ``cpu``, or ``cuda``, ``hip`` or ``opencl`` by an OpenMM platform."""

    @property
    def reason(self) -> str:
        """Kernels, precision and threads in use, and the reason for them."""

    @property
    def system(self) -> Any:
        """OpenMM System of the energy, None for a custom energy."""

    @property
    def atoms(self) -> str:
        """Fingerprint of its structure, empty if the caller provided a System or a callable."""

    @property
    def forcefield(self) -> str:
        """Name of the force field."""

    @property
    def solvent(self) -> str:
        """Name of the solvent model."""

    @property
    def settings(self) -> Mapping[str, Any]:
        """Arguments of :func:`protochain.energy` that it was built with, empty for a callable."""

    @property
    def threads(self) -> int:
        """Number of threads."""

    @property
    def is_exact(self) -> bool:
        """Whether it computes in double precision, so that the reference is not more accurate."""

    @property
    def left_out(self) -> Mapping[str, int]:
        """Numbers of constant terms and pairs that are omitted, by kind."""

    def without_constants(self, groups: Integers, x: Floats) -> "Energy":
        """Omit terms that are constant if groups of atoms (na, k) stay as rigid as at x."""

    @property
    def reference(self) -> "Energy":
        """The same energy on OpenMM's Reference platform, in double precision. A callable returns itself."""

    @property
    def exact(self) -> "Energy":
        """The same energy in double precision, all pairs one by one: itself, or its reference."""

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the System, or of the name of a callable."""

    @property
    def lists_at(self) -> Floats | None:
        """Positions (na, 3) in nm at which its neighbour lists were built, None without lists."""

    def list_at(self, x: Floats) -> None:
        """Build its neighbour lists at positions x (na, 3) in nm."""

    def parts(self, x: Floats) -> tuple[dict[str, float], Floats]:
        """Energies in kJ/mol by kind, or by force of the System, and forces (na, 3) in kJ/mol/nm, at x in nm.

        Energies with the same name are added.
        """

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy in kJ/mol and forces (na, 3) in kJ/mol/nm at positions x (na, 3) in nm."""


def an_energy(value: Any, name: str) -> Energy:
    """Return an Energy unchanged. One method identifies it: a check of all would compute the properties."""
    if hasattr(value, "without_constants"):
        return value
    raise refusal(name, brief(value), "give an Energy, as of protochain.energy(structure)")


def check_is_of(energy: Energy, structure: Structure) -> None:
    """Refuse an energy that was built for another structure, even one with as many atoms."""
    if energy.atoms and energy.atoms != structure.fingerprint:
        raise ProtochainError(
            f"the energy was built for other atoms than those of {structure.name}; give pc.energy(structure)"
        )
