"""Energy that a caller requests: an Energy, a result, the name of a calculator, or a callable."""

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from protochain.core.checks import refuse_class
from protochain.core.errors import ProtochainError
from protochain.energies.calculators import CALCULATORS
from protochain.energies.custom import CustomEnergy, check_forces
from protochain.energies.factory import energy, has_energy
from protochain.energies.protocol import Energy, check_is_of
from protochain.structure.molecule.model import Structure


def as_energy(given: Any, structure: Structure, source: Any = None, **arguments: Any) -> Energy:
    """Return the energy that a caller requests.

    Parameters
    ----------
    given : Energy, result, str, callable or None
        Energy of this structure, result with it, name of a calculator of :func:`protochain.energy`, or
        callable as for :class:`CustomEnergy`. The default is the energy of the source, if it has one, as a
        result has, or else of the default force field.
    structure : Structure
        Structure whose energy it is.
    source : Any
        Structure argument of the caller.
    **arguments
        Arguments of :func:`protochain.energy` from the caller. They replace the arguments of the source.

    Returns
    -------
    Energy
        The given energy, or an energy that wraps the callable.

    Raises
    ------
    ProtochainError
        If the value is neither, was built for other atoms, or does not return an energy and its forces.
    """
    if given is None:
        given = energy(source if has_energy(source) else structure, **arguments)
    if isinstance(given, str) and given in CALCULATORS:
        given = energy(source if has_energy(source) else structure, calculator=given, **arguments)
    given = given.energy_function if has_energy(given) else given
    if hasattr(given, "without_constants"):
        check_is_of(given, structure)
        return given
    refuse_class(given, "energy")
    if not callable(given):
        raise ProtochainError(
            f"energy {given!r}: give pc.energy(structure), a callable x -> (energy, forces), or one of "
            f"{', '.join(CALCULATORS)}"
        )
    custom = CustomEnergy(given)
    check_forces(given, structure.positions, f"energy {custom.name}")
    return custom


@dataclass(frozen=True)
class _Atoms:
    """Key of a cached energy: equal for structures with the same atoms and bonds, as decoys and frames."""

    fingerprint: str
    structure: Structure = field(compare=False)


def cached_energy(structure: Structure, **settings: Any) -> Energy:
    """Build an energy, or reuse one built in this process for the same atoms with the same settings."""
    return _built(_Atoms(structure.fingerprint, structure), tuple(sorted(settings.items())))


@lru_cache(maxsize=8)
def _built(atoms: _Atoms, settings: tuple[tuple[str, Any], ...]) -> Energy:
    return energy(atoms.structure, **dict(settings))
