"""One energy for many structures with the same atoms: decoys, models, frames."""

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from protochain.energies.factory import energy
from protochain.energies.protocol import Energy
from protochain.structure.model import Structure


@dataclass(frozen=True)
class _Atoms:
    """A structure as an energy sees it: two with the same atoms and bonds are equal."""

    fingerprint: str
    structure: Structure = field(compare=False)


def shared_energy(structure: Structure, **settings: Any) -> Energy:
    """Build an energy, or give the one that was built for the same atoms with the same settings.

    Parameters
    ----------
    structure : Structure
    **settings
        As of :func:`protochain.energy`.

    Returns
    -------
    Energy
        Of a few kept in this process.
    """
    return _built(_Atoms(structure.fingerprint, structure), tuple(sorted(settings.items())))


@lru_cache(maxsize=8)
def _built(atoms: _Atoms, settings: tuple[tuple[str, Any], ...]) -> Energy:
    return energy(atoms.structure, **dict(settings))
