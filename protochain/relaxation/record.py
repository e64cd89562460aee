"""Columns of a relaxation's record in JSON and CSV. Names are the same as in a solution's record."""

from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from operator import attrgetter
from typing import Any

from protochain.chains.restraint_list import RestraintValue
from protochain.energies.decomposed import TERMS
from protochain.minimisers.record import LIGANDS
from protochain.minimisers.verdict import Status
from protochain.results import columns
from protochain.results.columns import UNITS, Column, entry_of, heading, largest, number
from protochain.validation import MEASURES
from protochain.validation.findings import REMAINS
from protochain.validation.fixed import fixed_counts
from protochain.validation.interface import SCORES
from protochain.validation.ligands import LigandFound, at_both_ends

METHOD = "relax"
_start = attrgetter("start")

COLUMNS = (
    Column("structure", lambda r: r.start.name),
    Column("method", lambda r: METHOD),
    Column("status", lambda r: str(r.status), kind=Status),
    Column("message", lambda r: r.message),
    Column("energy_start_kj_mol", lambda r: r.energy_start),
    Column("energy_end_reference_kj_mol", lambda r: r.energy_end),
    Column("rms_force_end_kj_mol_nm", lambda r: r.rms_force),
    Column("judge", lambda r: r.judge),
    Column("ca_rmsd_angstrom", lambda r: r.ca_rmsd_angstrom),
    Column("ca_rmsd_as_filed_angstrom", lambda r: r.frame.ca_rmsds(r.x)[1]),
    Column("farthest_atom_angstrom", lambda r: r.farthest_angstrom),
    *LIGANDS,
    Column("frame", lambda r: str(r.frame)),
    *columns.of_terms(TERMS),
    *columns.of_measures(MEASURES, "start"),
    *columns.of_measures(MEASURES, "end"),
    *columns.of_remains(REMAINS),
    *columns.of_restraints(RestraintValue),
    Column("overlaps_start", lambda r: len(r.problems_start.overlaps), kind=int),
    Column("overlaps_end", lambda r: r.rounds[r.best].overlaps, kind=int),
    Column("overlaps_beside_start", lambda r: r.problems_start.n_hetero_overlaps, kind=int),
    Column("overlaps_beside_end", lambda r: r.problems_end.n_hetero_overlaps, kind=int),
    Column("ligand_strain_start_kj_mol", lambda r: _strain(r.ligands_start)),
    Column("ligand_strain_end_kj_mol", lambda r: _strain(r.ligands_end)),
    Column("ligands", lambda r: list(map(at_both_ends, r.ligands_start, r.ligands_end, r.ligand_motion))),
    Column("n_rounds", lambda r: len(r.rounds)),
    Column("n_residues_released", lambda r: r.rounds[r.best].released),
    Column("rounds", lambda r: [asdict(entry) for entry in r.rounds]),
    Column("iterations", lambda r: sum(entry.iterations for entry in r.rounds), kind=int),
    Column("evaluations", lambda r: sum(entry.evaluations for entry in r.rounds), kind=int),
    Column("seconds", lambda r: r.seconds),
    Column("timings", lambda r: dict(r.timings), kind=dict[str, float | None]),
    *columns.of_structure(_start),
    Column("n_atoms_moving", lambda r: r.n_atoms_moving),
    Column("move", lambda r: r.move),
    *columns.of_energy(),
    Column("preset", lambda r: "" if r.settings.protocol else r.settings.preset),
    Column("protocol", lambda r: r.settings.protocol),
    Column("bonds_to_hydrogen", lambda r: "free"),
    Column("tolerance", lambda r: r.settings.strength.tolerance, kind=float | None),
    Column("tolerance_unit", lambda r: "kJ/mol/nm"),
    Column("springs_backbone_kj_mol_nm2", lambda r: list(r.settings.strength.backbone), kind=list[float]),
    Column(
        "springs_side_chains_kj_mol_nm2", lambda r: list(r.settings.strength.side_chains), kind=list[float]
    ),
    Column("max_iterations", lambda r: r.settings.max_iterations, kind=int),
    Column("max_outer_iterations", lambda r: r.settings.max_outer_iterations, kind=int),
    Column("exclude", lambda r: r.settings.exclude),
    Column("free_ligands", lambda r: r.settings.free_ligands, kind=bool),
    Column("hydrogens", lambda r: "kept" if r.settings.keep_hydrogens else "stripped"),
    Column("repacked", lambda r: r.settings.repack or bool(r.settings.repack_region), kind=bool),
    Column("repack_region", lambda r: r.settings.repack_region),
    Column("side_chains_turned", lambda r: [*map(str, r.turned)], kind=list[str]),
    Column("stereocentres_corrected", lambda r: [*map(str, r.stereocentres_corrected)], kind=list[str]),
    Column("peptides_turned", lambda r: [*map(str, r.peptides_turned)], kind=list[str]),
    Column("fixed", lambda r: fixed_counts(r.start), kind=dict[str, int]),
    Column("left_out", lambda r: dict(r.start.left_out), kind=dict[str, int]),
    *columns.of_losses(_start),
    Column("threads", lambda r: r.energy_function.threads, kind=int | None),
)
"""In the order of a reader's interest."""

_OF_ALL_FRAMES = (
    "structure", "method", "judge", "frame", "ligands", "rounds", "n_chains", "n_residues", "n_atoms",
    "n_atoms_moving", "move", "protochain", "engine", "engine_reason", "forcefield", "solvent",
    "preset", "protocol", "bonds_to_hydrogen", "tolerance", "tolerance_unit", "springs_backbone_kj_mol_nm2",
    "springs_side_chains_kj_mol_nm2", "max_iterations", "max_outer_iterations", "exclude", "free_ligands",
    "hydrogens", "repacked", "fixed", "left_out", "lost_atoms", "n_lost_atoms", "far_molecules", "repairs",
    "threads", "seconds", "timings", "restraint_violations",
)  # fmt: skip
"""Columns that all frames of one ensemble share, and the seconds of rounds alone."""

OF_FRAMES = tuple(column for column in COLUMNS if column.key not in _OF_ALL_FRAMES)
"""Columns of a frame of an ensemble."""


def interface_column(key: str, when: str) -> str:
    """Name of a column, with the unit at its end."""
    ending = next((ending for ending in UNITS if key.endswith(ending)), "")
    return f"interface_{key.removesuffix(ending)}_{when}{ending}"


_SCORES_OF = {when: attrgetter(f"interface_{when}.scores") for when in ("start", "end")}
INTERFACE_COLUMNS = (
    Column("interface", lambda r: r.settings.interface),
    *(
        Column(interface_column(key, when), partial(entry_of, _SCORES_OF[when], key), kind=number(score))
        for key, score in SCORES.items()
        for when in ("start", "end")
    ),
)
"""Further columns if an interface is scored."""


def _strain(ligands: tuple[LigandFound, ...]) -> float | None:
    """Largest strain of a ligand."""
    return largest([ligand.strain_kj_mol for ligand in ligands if ligand.strain_kj_mol is not None])


ENERGY = "energy, kJ/mol"


def before_and_after(record: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Return rows of measures before and after, as text. Measures that are 0 in both are skipped."""
    rows = [(measure.what, record[f"{key}_start"], record[f"{key}_end"]) for key, measure in MEASURES.items()]
    rows.append(
        ("overlaps with molecules kept with the protein", record["overlaps_beside_start"],
         record["overlaps_beside_end"])
    )  # fmt: skip
    before, after = (record.get(f"ligand_strain_{when}_kj_mol") for when in ("start", "end"))
    rows.append(("largest strain of a ligand, kJ/mol", before, after))
    rows = [row for row in rows if not {row[1], row[2]} <= {0, None}]
    rows.append(("overlapping pairs of atoms", record["overlaps_start"], record["overlaps_end"]))
    rows.append((ENERGY, record["energy_start_kj_mol"], record["energy_end_reference_kj_mol"]))
    texts = [(label, _format(before), _format(after)) for label, before, after in rows]
    if "interface" in record:
        for key in _COMPARED_SCORES:
            before, after = (_format_score(record[interface_column(key, when)]) for when in ("start", "end"))
            texts.append((f"interface {record['interface']}: {heading(key)}", before, after))
    return texts


_COMPARED_SCORES = (
    "energy_kj_mol", "buried_area_angstrom2", "shape_complementarity", "hydrogen_bonds", "salt_bridges",
    "unsatisfied_polar_atoms", "clashes",
)  # fmt: skip
"""Scores of an interface in the comparison."""


def _format_score(value: Any) -> str:
    return f"{value:.2f}" if isinstance(value, float) and abs(value) < 10.0 else _format(value)


def _format(value: Any) -> str:
    if not isinstance(value, float):
        return "-" if value is None else str(value)
    return f"{value:.3g}" if abs(value) >= _LARGE_VALUE else f"{value:.1f}"


_LARGE_VALUE = 1e7  # Limit above which numbers have exponents: energies of overlapping atoms.
