"""Columns of a solution's record: the one table behind terminal, CSV, JSON and pages."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np

from protochain.articulate import turned_atoms
from protochain.core import defaults
from protochain.structure.losses import far_molecules, lost_atoms, n_lost
from protochain.validation.findings import MEASURES

UNITS = {
    "_kj_mol_rad": "kJ/mol/rad", "_kj_mol_rad2": "kJ/mol/rad^2",
    "_kj_mol_nm2": "kJ/mol/nm^2", "_kj_mol_nm": "kJ/mol/nm", "_kj_mol": "kJ/mol",
    "_kj_mol_per_residue": "kJ/mol per residue", "_angstrom": "angstrom", "_degrees": "degrees", "_nm": "nm",
    "_ps": "ps", "_fs": "fs", "_k": "K", "_amu": "amu",
}  # fmt: skip
"""Endings of names that are units."""

_SPELLED = {"ca": "C-alpha", "rmsd": "RMSD", "rms": "RMS", "tm": "TM", "ramachandran": "Ramachandran"}


@dataclass(frozen=True)
class Column:
    """A column of the record.

    Parameters
    ----------
    key : str
        Name in JSON and CSV, with its unit.
    value : callable
        Value of a solution.
    heading : str
        Heading in short tables, which leave out columns without one.
    short : str
        Heading where 80 characters must hold all columns.
    width : int
        Characters of a number there.
    """

    key: str
    value: Callable[[Any], Any]
    heading: str = ""
    short: str = ""
    width: int = 8

    def short_text(self, value: Any) -> str:
        """Value as the short table prints it: with two decimals, or as many as its width holds."""
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
    words = " ".join(_SPELLED.get(word, word) for word in name.removesuffix(ending).split("_"))
    # No comma after a number: within 10 kJ/mol.
    return words + (" " if words[-1].isdigit() else ", ") + UNITS[ending] if ending else words


def _of_measure(key: str, when: str) -> Column:
    """Column of what is wrong with the structure at the ``start`` or ``end`` of a run."""

    def value(solution: Any) -> Any:
        return getattr(solution, f"measures_{when}")[key]

    return Column(f"{key}_{when}", value)


COLUMNS = (
    Column("structure", lambda s: s.chain.structure.name),
    Column("method", lambda s: s.method, "method"),
    Column("status", lambda s: str(s.status), "status"),
    Column("message", lambda s: s.message),
    Column("energy_start_kj_mol", lambda s: s.start.energy, "energy at start", "start"),
    Column("energy_end_kj_mol", lambda s: s.energy),
    Column("energy_end_reference_kj_mol", lambda s: s.end.energy, "energy at end", "end"),
    Column("max_torque_end_kj_mol_rad", lambda s: s.end.max_torque, "largest torque", "torque", 6),
    Column("rms_force_end_kj_mol_nm", lambda s: s.end.rms_force, "RMS force", "force", 6),
    Column("lowest_eigenvalue_kj_mol_rad2", lambda s: s.lowest_eigenvalue),
    Column("ca_rmsd_angstrom", lambda s: s.ca_rmsd_angstrom, "C-alpha RMSD", "RMSD", 6),
    Column("ca_rmsd_as_filed_angstrom", lambda s: s.ca_rmsd_as_filed_angstrom),
    Column("frame", lambda s: str(s.frame)),
    *(_of_measure(key, when) for key in MEASURES for when in ("start", "end")),
    Column("iterations", lambda s: s.n_iterations),
    Column("evaluations", lambda s: s.n_evaluations, "evaluations", "evals"),
    Column("seconds", lambda s: s.seconds, "seconds", "time s", 6),
    Column("n_chains", lambda s: s.chain.structure.n_chains),
    Column("n_residues", lambda s: s.chain.structure.n_residues),
    Column("n_atoms", lambda s: s.chain.structure.n_atoms),
    Column("n_bodies", lambda s: s.chain.n_bodies),
    Column("n_hinges", lambda s: s.chain.n_hinges),
    Column("n_atoms_moving", lambda s: _n_moving(s)),
    Column("protochain", lambda s: version("protochain")),
    Column("engine", lambda s: s.energy_function.engine),
    Column("engine_reason", lambda s: s.energy_function.reason),
    Column("forcefield", lambda s: s.energy_function.forcefield),
    Column("solvent", lambda s: s.energy_function.solvent),
    Column("hinges", lambda s: s.chain.opened),
    Column("tolerance", lambda s: s.tolerance),
    Column("tolerance_unit", lambda s: "kJ/mol/rad" if s.keeps_geometry else "kJ/mol/nm"),
    Column("move", lambda s: s.chain.move),
    Column("restraint_kj_mol_nm2", lambda s: s.hold.record()),
    Column("max_rmsd_angstrom", lambda s: s.hold.max_rmsd),
    Column("left_out", lambda s: dict(s.chain.structure.left_out)),
    Column("constant_terms", lambda s: dict(s.constant_terms)),
    Column("lost_atoms", lambda s: lost_atoms(s.chain.structure.losses)),
    Column("n_lost_atoms", lambda s: n_lost(s.chain.structure.losses)),
    Column("far_molecules", lambda s: far_molecules(s.chain.structure.losses)),
    Column("repairs", lambda s: [str(each) for each in s.chain.structure.repairs]),
    Column("seed", lambda s: s.seed),
    Column("threads", lambda s: s.energy_function.threads),
)
"""In the order in which a reader looks at them."""


def _n_moving(solution: Any) -> int:
    """Atoms that its method may move: those beyond hinges, selected ones where all atoms move, or both."""
    chain, recipe = solution.chain, solution.recipe
    if chain.move == defaults.MOVE:  # A fixed root is one's point of view then.
        return int(chain.moving.sum())
    moved = np.zeros(chain.n_atoms, dtype=bool)
    if recipe.in_torsions:
        moved |= turned_atoms(chain)
    if not recipe.keeps_geometry:
        moved |= chain.moving
    return int(moved.sum())


SHOWN = tuple(column for column in COLUMNS if column.heading)
"""Columns of short tables."""


def record(solution: Any) -> dict[str, Any]:
    """Flat record of a solution; None where a value is not finite."""
    values = {column.key: column.value(solution) for column in COLUMNS}
    return {
        key: None if isinstance(value, float) and not np.isfinite(value) else value
        for key, value in values.items()
    }


def flat(value: Any) -> Any:
    """Value of a record as a cell of a table: lists and counts as text."""
    if isinstance(value, dict):
        return "; ".join(f"{count} {name}" for name, count in value.items())
    return "; ".join(map(str, value)) if isinstance(value, list) else value
