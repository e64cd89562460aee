"""Columns of a solution's record, from which terminal, CSV, JSON and pages are written."""

from collections.abc import Iterable, Mapping
from operator import attrgetter
from typing import Any

import numpy as np

from protochain.chains.articulate import turned_atoms
from protochain.chains.restraint_list import RestraintValue
from protochain.core import defaults
from protochain.energies.decomposed import TERMS
from protochain.minimisers.verdict import Status
from protochain.results import columns
from protochain.results.columns import Column, largest
from protochain.validation.findings import MEASURES, REMAINS

_structure = attrgetter("chain.structure")

LIGANDS = (
    Column("ligand_rmsd_angstrom", lambda r: largest(r.ligand_motion[:, 0]), "ligand RMSD", width=6),
    Column("ligand_displacement_max_angstrom", lambda r: largest(r.ligand_motion[:, 1]),
           "ligand displacement", "ligand shift", 6),
)  # fmt: skip
"""Columns of the ligand that moved farthest, also of a relaxation."""
COLUMNS = (
    Column("structure", lambda s: s.chain.structure.name),
    Column("method", lambda s: s.method, "method"),
    Column("status", lambda s: str(s.status), "status", kind=Status),
    Column("message", lambda s: s.message),
    Column("energy_start_kj_mol", lambda s: s.start.energy, "energy at start", "start"),
    Column("energy_end_kj_mol", lambda s: s.energy),
    Column("energy_end_reference_kj_mol", lambda s: s.end.energy, "energy at end", "end"),
    Column("judge", lambda s: s.judge),
    Column("max_torque_end_kj_mol_rad", lambda s: s.end.max_torque, "largest torque", "torque", 6),
    Column("rms_force_end_kj_mol_nm", lambda s: s.end.rms_force, "RMS force", "force", 6),
    Column("lowest_eigenvalue_kj_mol_rad2", lambda s: s.lowest_eigenvalue if s.keeps_geometry else None),
    Column("lowest_eigenvalue_kj_mol_nm2", lambda s: None if s.keeps_geometry else s.lowest_eigenvalue),
    Column("ca_rmsd_angstrom", lambda s: s.ca_rmsd_angstrom, "C-alpha RMSD", "RMSD", 6),
    Column("ca_rmsd_as_filed_angstrom", lambda s: s.ca_rmsd_as_filed_angstrom),
    *LIGANDS,
    Column("frame", lambda s: str(s.frame)),
    *columns.of_terms(TERMS),
    *columns.of_measures(MEASURES, "start", "end"),
    *columns.of_remains(REMAINS),
    *columns.of_restraints(RestraintValue),
    Column("iterations", lambda s: s.n_iterations, kind=int),
    Column("evaluations", lambda s: s.n_evaluations, "evaluations", "evals", kind=int),
    Column("seconds", lambda s: s.seconds, "seconds", "time s", 6),
    Column("timings", lambda s: dict(s.timings), kind=dict[str, float | None]),
    *columns.of_structure(_structure),
    Column("n_bodies", lambda s: s.chain.n_bodies),
    Column("n_hinges", lambda s: s.chain.n_hinges),
    Column("n_atoms_moving", lambda s: _n_moving(s)),
    *columns.of_energy(),
    Column("hinges", lambda s: s.chain.opened),
    Column("root", lambda s: s.chain.root),
    Column("tolerance", lambda s: s.tolerance, kind=float | None),
    Column("tolerance_unit", lambda s: "kJ/mol/rad" if s.keeps_geometry else "kJ/mol/nm"),
    Column("move", lambda s: s.chain.move),
    Column("restraint_kj_mol_nm2", lambda s: s.hold.record(), kind=list[float | str]),
    Column("max_rmsd_angstrom", lambda s: s.hold.max_rmsd),
    Column("left_out", lambda s: dict(s.chain.structure.left_out), kind=dict[str, int]),
    Column("constant_terms", lambda s: dict(s.constant_terms), kind=dict[str, int]),
    *columns.of_losses(_structure),
    Column("seed", lambda s: s.seed, kind=int),
    Column("threads", lambda s: s.energy_function.threads, kind=int | None),
)
"""Columns of a record, in reading order."""
SHORT_COLUMNS = tuple(column for column in COLUMNS if column.heading and column not in LIGANDS)
"""Columns of short tables."""


def _n_moving(solution: Any) -> int:
    """Atoms that its method may move: atoms beyond hinges, selected ones if all atoms move, or both."""
    chain, recipe = solution.chain, solution.recipe
    if chain.move == defaults.MOVE:  # A fixed root then only sets the frame.
        return int(chain.moving.sum())
    moved = np.zeros(chain.n_atoms, dtype=bool)
    if recipe.in_torsions:
        moved |= turned_atoms(chain)
    if not recipe.keeps_geometry:
        moved |= chain.moving
    return int(moved.sum())


def short_columns(
    records: Iterable[Mapping[Any, Any]], columns: Iterable[Column] = SHORT_COLUMNS
) -> tuple[Column, ...]:
    """Columns of a short table of records, with columns of ligands if there are any."""
    rmsds = [record.get(LIGANDS[0].key) for record in records]
    return (*columns, *(LIGANDS if any(value is not None and value == value for value in rmsds) else ()))
