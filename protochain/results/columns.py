"""Columns of records, for terminal, CSV, JSON and pages, with the columns that all results share."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from operator import attrgetter
from typing import Any

import numpy as np

from protochain.core.lazy_pandas import pd
from protochain.structure.molecule.repairs import far_molecules, lost_atoms, n_lost

UNITS = {
    "_kj_mol_rad": "kJ/mol/rad", "_kj_mol_rad2": "kJ/mol/rad^2",
    "_kj_mol_nm2": "kJ/mol/nm^2", "_kj_mol_nm": "kJ/mol/nm", "_kj_mol": "kJ/mol",
    "_kj_mol_per_residue": "kJ/mol per residue", "_angstrom": "angstrom", "_angstrom2": "angstrom^2",
    "_degrees": "degrees", "_nm": "nm", "_ps": "ps", "_fs": "fs", "_k": "K", "_amu": "amu",
}  # fmt: skip
"""Endings of names that are units."""

_SPELLED = {
    "ca": "C-alpha", "rmsd": "RMSD", "rms": "RMS", "tm": "TM", "ramachandran": "Ramachandran", "cmap": "CMAP",
    "lennard-jones": "Lennard-Jones", "coulomb": "Coulomb", "born": "Born",
}  # fmt: skip


Kind = Any
"""``str``, ``float | None``, ``list[str]``, ``dict[str, int]``, an enumeration, a dataclass, a TypedDict. A
mapping name -> kind is an object with exactly these names, and ``[kind]`` a list of a kind."""


def kind_of(name: str) -> Kind:
    """Kind by name: a number or null with a unit or ``seconds``, a count with ``n_``, else text."""
    if name.startswith("seconds") or any(name.endswith(unit) for unit in UNITS):
        return float | None
    return int if name.startswith("n_") else str


@dataclass(frozen=True)
class Column:
    """A column of the record."""

    key: str  # Name in JSON and CSV, with its unit.
    value: Callable[[Any], Any]  # Function of the recorded result.
    heading: str = ""  # Heading in short tables, which skip columns without one.
    short: str = ""  # Heading if all columns must fit into 80 characters.
    width: int = 8  # Characters of a number there.
    kind: Kind = None  # Kind of values, for schemas and for reading tables, by default from the key.
    is_term: bool = False  # Whether it is a term of the energy, which takes a sum over single pairs.

    def __post_init__(self) -> None:
        object.__setattr__(self, "kind", self.kind or kind_of(self.key))

    def short_text(self, value: Any) -> str:
        """Value as the short table prints it, with two decimals or as many as fit into its width."""
        if not isinstance(value, float):
            return "-" if value is None else str(value)
        forms: tuple[str, ...] = (".2f", ".1f", ".0f", ".1e", ".0e")
        if 0.0 < abs(value) < 0.005 and self.unit.startswith("kJ/mol/"):
            forms = forms[3:]  # Residuals may be small.
        texts = [format(value, form) for form in forms]
        return next((text for text in texts if len(text) <= self.width), texts[-1])

    @property
    def unit(self) -> str:
        """Unit, from the ending of the key."""
        return next((unit for ending, unit in UNITS.items() if self.key.endswith(ending)), "")

    @property
    def title(self) -> str:
        """Heading with its unit, for short tables."""
        return f"{self.heading}, {self.unit}" if self.unit else self.heading


def heading(name: str) -> str:
    """Heading from a column's name: ``energy_end_kj_mol`` is ``energy end, kJ/mol``."""
    ending = next((ending for ending in UNITS if name.endswith(ending)), "")
    parts = name.removesuffix(ending).replace("lennard_jones", "lennard-jones").split("_")
    words = " ".join(_SPELLED.get(word, word) for word in parts)
    # No comma after a number: within 10 kJ/mol.
    return words + (" " if words[-1].isdigit() else ", ") + UNITS[ending] if ending else words


def record(columns: Iterable[Column], result: Any, terms: bool = True) -> dict[str, Any]:
    """Flat record of a result, with None for values that are not finite, on request without energy terms."""
    shown = columns if terms else [column for column in columns if not column.is_term]
    return {column.key: _finite(column.value(result)) for column in shown}


def largest(values: Any) -> float | None:
    """Largest of the values (n,), None without values."""
    return float(np.max(values)) if len(values) else None


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not np.isfinite(value) else value


def flat(value: Any) -> Any:
    """Value of a record as a cell of a table: lists and counts as text. Lists of objects stay lists."""
    if isinstance(value, dict):
        return "; ".join(f"{count} {name}" for name, count in value.items())
    is_plain = isinstance(value, list) and not any(isinstance(item, dict) for item in value)
    return "; ".join(map(str, value)) if is_plain else value


def number(measure: Any) -> Kind:
    """Kind of a measure that may be missing."""
    return int | None if measure.whole else float | None


def of_measures(measures: Mapping[str, Any], *whens: str) -> Iterator[Column]:
    """Columns of measures of the structure at the ``start`` or ``end`` of a run."""
    for key, measure in measures.items():
        for when in whens:
            values = attrgetter(f"measures_{when}")
            yield Column(f"{key}_{when}", partial(entry_of, values, key), kind=number(measure))


def entry_of(values: Callable[[Any], Any], key: str, result: Any) -> Any:
    """Entry of the mapping that ``values`` returns for a result, None if it is missing."""
    return values(result).get(key)


def of_remains(keys: Iterable[str]) -> Iterator[Column]:
    """Columns of residues with remaining problems at the end of a run, which a biologist may reject."""
    for key in keys:
        yield Column(key, partial(entry_of, attrgetter("remains_end"), key), kind=list[str])


def of_terms(names: Iterable[str]) -> Iterator[Column]:
    """Columns of the terms of the energy, and of the separate restraints, None if unknown."""
    for name in names:
        for when in ("start", "end"):
            value = partial(entry_of, attrgetter(f"terms_{when}"), name)
            yield Column(f"energy_{name}_{when}_kj_mol", value, is_term=True)
    for k, when in enumerate(("start", "end")):
        yield Column(f"energy_restraints_{when}_kj_mol", partial(_restraints, k))


def _restraints(index: int, result: Any) -> float | None:
    return None if result.restraints is None else float(result.restraints[index])


def of_restraints(kind: Kind) -> Iterator[Column]:
    """Columns of restraints at the end: number and size of violations, None without restraints."""
    yield Column("restraints_violated", _n_violated, kind=int | None)
    for unit in ("angstrom", "degrees"):
        yield Column(f"restraint_violation_{unit}", partial(_largest_violation, unit))
    yield Column("restraint_violations", lambda r: r.violation_rows(), kind=[kind])


def _n_violated(result: Any) -> int | None:
    return sum(value.is_violated for value in result.restraint_values) if result.restraint_values else None


def _largest_violation(unit: str, result: Any) -> float | None:
    return max((value.violation for value in result.restraint_values if value.unit == unit), default=None)


def of_structure(structure: Callable[[Any], Any]) -> Iterator[Column]:
    """Columns of the size of a structure: all atoms, and residues of the protein."""
    yield Column("n_chains", lambda r: structure(r).n_chains)
    yield Column("n_residues", lambda r: structure(r).n_protein_residues)
    yield Column("n_atoms", lambda r: structure(r).n_atoms)


def of_energy() -> Iterator[Column]:
    """Columns of the engine and model of the energy."""
    yield Column("protochain", lambda r: version("protochain"))
    yield Column("engine", lambda r: r.energy_function.engine)
    yield Column("device", lambda r: r.energy_function.device)
    yield Column("engine_reason", lambda r: r.energy_function.reason)
    yield Column("forcefield", lambda r: r.energy_function.forcefield)
    yield Column("solvent", lambda r: r.energy_function.solvent)


def of_losses(structure: Callable[[Any], Any]) -> Iterator[Column]:
    """Columns of atoms lost and repairs made by the preparation."""
    yield Column("lost_atoms", lambda r: lost_atoms(structure(r).losses), kind=list[str])
    yield Column("n_lost_atoms", lambda r: n_lost(structure(r).losses))
    yield Column("far_molecules", lambda r: far_molecules(structure(r).losses), kind=list[str])
    yield Column("repairs", lambda r: [str(repair) for repair in structure(r).repairs], kind=list[str])


def energies_by_term(records: Mapping[str, Mapping[str, Any]]) -> "pd.DataFrame":
    """Energy of each term at the start and at each end, from records by the names of ends."""
    rows = []
    for key in dict.fromkeys(key for record in records.values() for key in record):
        name = key.removeprefix("energy_").removesuffix("_start_kj_mol")
        if key != f"energy_{name}_start_kj_mol":
            continue
        # A run that failed has no numbers.
        start = next((record[key] for record in records.values() if record.get(key) is not None), None)
        ends = {f"{end}_kj_mol": record.get(f"energy_{name}_end_kj_mol") for end, record in records.items()}
        if start or any(ends.values()):
            rows.append({"term": heading(name), "start_kj_mol": start, **ends})
    columns = ["term", "start_kj_mol", *(f"{end}_kj_mol" for end in records)]
    return pd.DataFrame(rows, columns=columns)
