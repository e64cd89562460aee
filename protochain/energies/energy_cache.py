"""Energies shared by structures with the same atoms: decoys, models, frames."""

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from protochain.energies.factory import energy
from protochain.energies.protocol import Energy
from protochain.structure.molecule.model import Structure


@dataclass(frozen=True)
class _Atoms:
    """Key of a cached energy: equal for structures with the same atoms and bonds."""

    fingerprint: str
    structure: Structure = field(compare=False)


def cached_energy(structure: Structure, **settings: Any) -> Energy:
    """Build an energy, or reuse one built in this process for the same atoms with the same settings."""
    return _built(_Atoms(structure.fingerprint, structure), tuple(sorted(settings.items())))


@lru_cache(maxsize=8)
def _built(atoms: _Atoms, settings: tuple[tuple[str, Any], ...]) -> Energy:
    return energy(atoms.structure, **dict(settings))
