"""Columns of a relaxation's record, named as those of a solution: the one table behind JSON and CSV."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from functools import partial
from importlib.metadata import version
from types import MappingProxyType
from typing import Any

from protochain.contacts import overlaps
from protochain.core.arrays import Floats
from protochain.structure.losses import far_molecules, lost_atoms, n_lost
from protochain.validation import MEASURES
from protochain.validation.fixed import fixed_counts

METHOD = "relax"

_Value = Callable[[Any], Any]


def _of_measures(when: str) -> Iterator[tuple[str, _Value]]:
    for key in MEASURES:
        yield f"{key}_{when}", partial(_measure, key, when)


def _measure(key: str, when: str, relaxation: Any) -> Any:
    return getattr(relaxation, f"measures_{when}")[key]


COLUMNS: Mapping[str, _Value] = MappingProxyType({
    "structure": lambda r: r.start.name,
    "method": lambda r: METHOD,
    "status": lambda r: str(r.status),
    "message": lambda r: r.message,
    "energy_start_kj_mol": lambda r: r.energy_start,
    "energy_end_reference_kj_mol": lambda r: r.energy_end,
    "rms_force_end_kj_mol_nm": lambda r: r.rms_force,
    "judge": lambda r: r.judge,
    "ca_rmsd_angstrom": lambda r: r.ca_rmsd_angstrom,
    "ca_rmsd_as_filed_angstrom": lambda r: r.frame.ca_rmsds(r.x)[1],
    "farthest_atom_angstrom": lambda r: r.farthest_angstrom,
    "frame": lambda r: str(r.frame),
    **dict(_of_measures("start")),
    **dict(_of_measures("end")),
    "overlaps_start": lambda r: len(overlaps(r.start, r.start.positions)),
    "overlaps_end": lambda r: r.rounds[r.best].overlaps,
    "overlaps_beside_start": lambda r: _beside(r, r.start.positions),
    "overlaps_beside_end": lambda r: _beside(r, r.x),
    "n_rounds": lambda r: len(r.rounds),
    "n_residues_let_go": lambda r: r.rounds[r.best].let_go,
    "rounds": lambda r: [asdict(each) for each in r.rounds],
    "iterations": lambda r: sum(each.iterations for each in r.rounds),
    "evaluations": lambda r: sum(each.evaluations for each in r.rounds),
    "seconds": lambda r: r.seconds,
    "n_chains": lambda r: r.start.n_chains,
    "n_residues": lambda r: r.start.n_residues,
    "n_atoms": lambda r: r.start.n_atoms,
    "n_atoms_moving": lambda r: r.n_atoms_moving,
    "move": lambda r: r.move,
    "protochain": lambda r: version("protochain"),
    "engine": lambda r: r.energy_function.engine,
    "engine_reason": lambda r: r.energy_function.reason,
    "forcefield": lambda r: r.energy_function.forcefield,
    "solvent": lambda r: r.energy_function.solvent,
    "preset": lambda r: "" if r.settings.protocol else r.settings.preset,
    "protocol": lambda r: r.settings.protocol,
    "bonds_to_hydrogen": lambda r: "free",
    "tolerance": lambda r: r.settings.strength.tolerance,
    "tolerance_unit": lambda r: "kJ/mol/nm",
    "springs_backbone_kj_mol_nm2": lambda r: list(r.settings.strength.backbone),
    "springs_side_chains_kj_mol_nm2": lambda r: list(r.settings.strength.side_chains),
    "max_iterations": lambda r: r.settings.max_iterations,
    "max_outer_iterations": lambda r: r.settings.max_outer_iterations,
    "exclude": lambda r: r.settings.exclude,
    "hydrogens": lambda r: "kept" if r.settings.keep_hydrogens else "stripped",
    "repacked": lambda r: r.settings.repack,
    "side_chains_turned": lambda r: [str(each) for each in r.turned],
    "hands_turned": lambda r: [str(each) for each in r.hands_turned],
    "peptides_turned": lambda r: [str(each) for each in r.peptides_turned],
    "fixed": lambda r: fixed_counts(r.start),
    "left_out": lambda r: dict(r.start.left_out),
    "lost_atoms": lambda r: lost_atoms(r.start.losses),
    "n_lost_atoms": lambda r: n_lost(r.start.losses),
    "far_molecules": lambda r: far_molecules(r.start.losses),
    "repairs": lambda r: [str(each) for each in r.start.repairs],
    "threads": lambda r: r.energy_function.threads,
})  # fmt: skip
"""In the order in which a reader looks at them."""


def _beside(relaxation: Any, x: Floats) -> int:
    """Pairs of an atom of the protein and one beside it that overlap."""
    return sum(each.beside for each in overlaps(relaxation.start, x))


def before_and_after(record: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Return what is compared in words, before and after; measures that are 0 in both are left out."""
    rows = [(measure.what, record[f"{key}_start"], record[f"{key}_end"]) for key, measure in MEASURES.items()]
    rows.append(
        ("overlaps with molecules beside the protein", record["overlaps_beside_start"],
         record["overlaps_beside_end"])
    )  # fmt: skip
    rows = [row for row in rows if not {row[1], row[2]} <= {0, None}]
    rows.append(("overlapping pairs of atoms", record["overlaps_start"], record["overlaps_end"]))
    rows.append(("energy, kJ/mol", record["energy_start_kj_mol"], record["energy_end_reference_kj_mol"]))
    return [(what, _said(before), _said(after)) for what, before, after in rows]


def _said(value: Any) -> str:
    if not isinstance(value, float):
        return "-" if value is None else str(value)
    return f"{value:.3g}" if abs(value) >= _LARGE else f"{value:.1f}"


_LARGE = 1e7
"""Numbers from which on are written with an exponent: energies of overlapping atoms."""
