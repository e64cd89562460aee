"""Output of the commands, from the columns and types that they use."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NotRequired, get_type_hints

from protochain.batches import table
from protochain.batches.frame_files import FIRST
from protochain.batches.frame_tasks import EnergyFrames
from protochain.chains.restraint_list import RestraintValue
from protochain.chains.setup import Setup
from protochain.comparison import deviation as of_deviation
from protochain.comparison import folder as of_comparison
from protochain.comparison import modes_folder as of_modes
from protochain.comparison.differences import TORSIONS
from protochain.comparison.docking import DOCKING, QUALITY
from protochain.comparison.work import SPREAD_COLUMNS, WITHIN
from protochain.dynamics import simulation
from protochain.dynamics.simulate_settings import SimulationSettings
from protochain.energies.decomposed import TERMS
from protochain.minimisers import record as of_minimising
from protochain.minimisers.solution import TRACE_COLUMNS
from protochain.minimisers.verdict import Status
from protochain.relaxation import mutations as of_mutations
from protochain.relaxation import record as of_relaxing
from protochain.relaxation.poses import COLUMNS as OF_POSE
from protochain.relaxation.rounds import Round
from protochain.results.columns import Column, Kind, kind_of, number
from protochain.results.schema import OTHERS, Contract, cell
from protochain.searching.search_settings import SearchSettings
from protochain.validation import MEASURES
from protochain.validation.findings import RESIDUE_COLUMNS
from protochain.validation.interface import CONFIDENCES, MAKEUP, RESIDUES, SCORES
from protochain.validation.ligands import LIGAND_COLUMNS, LIGAND_ENDS
from protochain.validation.likeness import LIKENESS
from protochain.validation.nucleic import NUCLEOTIDE_COLUMNS

Kinds = dict[str, Kind]


_OTHERS = {
    name: kind
    for kind, names in (
        (int, """
            iteration start overlaps heavy_atoms_added atoms_added clashes contacts domain
            rotamers_changed rigid_domains hydrogen_bonds_kept hydrogen_bonds_gained hydrogen_bonds_lost
            salt_bridges_kept salt_bridges_gained salt_bridges_lost mode side step steps output_frame
            minimum cluster walker evaluations_of_walker
            """),
        (float | None, """
            contacts_kept phi psi omega chi1 chi2 chi3 chi4 frequency_per_cm
            eigenvalue_per_ps2 collectivity residual overlap cumulative_overlap log_det_hessian
            ramachandran_percent secondary_structure_kept tm_score_to_start reference_tm_score
            reference_coverage at total acceptance helix_share helix_share_error exchanges slope
            slope_error share share_error
            """),
        (bool, "violation rotamer_outlier pucker_outlier interrupted"),
        (list[str], "confidences not_written command inverted files"),
        (int | None, "round_trips model"),
        (bool | None, "posebusters_passed"),
        (list[str] | None, "posebusters_failed"),
        (dict[str, str], "versions"),
        (list[float], "temperatures_k"),
    )
    for name in names.split()
}  # fmt: skip
"""Kinds of names in rows without columns, if the name does not show the kind."""
_ENDS = ("start", "end")
_OF_RELAXING = (*of_relaxing.COLUMNS, *of_relaxing.INTERFACE_COLUMNS)
_KNOWN: Kinds = {
    **_OTHERS,
    **{
        column.key: column.kind
        for columns in (of_minimising.COLUMNS, _OF_RELAXING, of_modes.COLUMNS, of_deviation.COLUMNS)
        for column in columns
    },
    **{
        key: number(measure)
        for key, measure in {**MEASURES, **SCORES, **MAKEUP, **CONFIDENCES, **DOCKING}.items()
    },
    **dict.fromkeys((*LIKENESS, *TERMS), float | None),
    **OF_POSE,
}
_OF_LIGANDS = (_OTHERS.get(key) or kind_of(key) for key in LIGAND_COLUMNS[4:] for _ in _ENDS)
_KNOWN |= zip(LIGAND_ENDS, _OF_LIGANDS, strict=False)  # The names of its last columns have units.
"""Kinds of names of columns and measures, which have a kind."""


def _row(names: str | Iterable[str | Column], **further: Kind) -> Kinds:
    columns = names.split() if isinstance(names, str) else names
    kinds = (
        (entry, _KNOWN.get(entry) or kind_of(entry)) if isinstance(entry, str) else (entry.key, entry.kind)
        for entry in columns
    )
    return dict(kinds) | further


def _optional(kinds: Kinds) -> Kinds:
    return {name: NotRequired[kind] for name, kind in kinds.items()}


def _cells(*kinds: Kinds) -> Kinds:
    """Columns of a table, whose cells may be empty."""
    return {name: cell(kind) for columns in kinds for name, kind in columns.items()}


_ORIGIN = _row("input output seconds_preparation")
_WRITTEN = _optional(_row("report ligands_written confidences not_written"))
_RUN = _row("command python versions")
_FAILED = _row("file message")
_SOLUTION = _row(of_minimising.COLUMNS)
_INTERFACE = _optional(_row(of_relaxing.INTERFACE_COLUMNS))
_RESIDUE = _row("chain residue name")

_START = _row(
    "start energy_start_kj_mol energy_end_reference_kj_mol ca_rmsd_angstrom evaluations seconds",
    status=Status,
)
_STARTS = _row(
    "n_starts energy_lowest_kj_mol energy_first_quartile_kj_mol energy_median_kj_mol "
    "energy_third_quartile_kj_mol energy_highest_kj_mol n_within_1_kj_mol_of_lowest"
)
_MINIMISED = {
    **_SOLUTION, **_ORIGIN, **_WRITTEN,
    **_optional({"model": int, "starts": [_START], "starts_summary": _STARTS}),
}  # fmt: skip
_RELAXED = {
    **_row(
        of_relaxing.COLUMNS, rounds=list[Round],
        ligands=[_row([*LIGAND_COLUMNS[:4], *LIGAND_ENDS])],
    ),
    **_INTERFACE, **_ORIGIN, **_WRITTEN,
}  # fmt: skip


def _frames(columns: Iterable[str | Column], optional: Iterable[str | Column] = ()) -> Kinds:
    """Columns of a table of frames. Unusable frames have empty cells."""
    task_columns = {**_row(columns), **_optional(_row(optional))}
    first = {**_row(FIRST, frame=int), **_optional(_row(FIRST[-1:]))}
    return _cells(first, task_columns, _row("seconds"), _optional(_row("output_frame")))


_TRACE = _row(TRACE_COLUMNS)
_BATCH: Kinds = {
    **_row("n_structures table n_rows"), "status": dict[str, int], "lost_atoms": dict[str, str],
    "far_molecules": dict[str, str], **_RUN, "settings": dict[str, Any],
}  # fmt: skip
_BATCH_TABLES = {"traces.csv": (_cells(_row(table.TRACE_COLUMNS)),)}
_BATCH_FILES = ("energy.png", "rmsd.png", "seconds.png")
_STRUCTURE = r"\.(pdb|cif)(\.(gz|bz2|xz|zst))?$"
_BATCH_MORE = (r"^poses\.csv$", r"^pages/(.+\.html|viewer\.js)$", _STRUCTURE, r"\.(json|npz)$")


def _of_batch(columns: Iterable[str], optional_columns: Iterable[str]) -> Kinds:
    """Columns of a batch. ``optional_columns`` depend on methods and on an interface."""
    return _cells(_row(columns), _optional(_row(optional_columns)))


_BOTH = [name for name in table.COLUMNS if name in table.RELAXED_COLUMNS]
_FURTHER = (*table.OF_INTERFACE, *table.OF_POSES)
_ALL = dict.fromkeys((*table.COLUMNS, *table.RELAXED_COLUMNS, *_FURTHER))
_EITHER = [name for name in _ALL if name not in _BOTH]

_QUALITY = {
    **_row(
        "radius_of_gyration_angstrom ca_rmsd_to_start_angstrom tm_score_to_start secondary_structure_kept"
    ),
    **_row(["overlaps", "hydrogen_bonds", *MEASURES], hydrogen_bonds=int),
    **_row("bond_length_change_rms_angstrom bond_angle_change_rms_degrees"),
    **_optional(_row("reference_rmsd_angstrom reference_tm_score reference_coverage")),
}
_WORK = _row(
    ["method", "lowest_kj_mol"]
    + [f"{cost}_within_{near:g}_kj_mol" for cost in ("evaluations", "seconds") for near in WITHIN]
)
_SPREAD = _row(SPREAD_COLUMNS)
_COMPARED = {**_SOLUTION, **_ORIGIN, "output": str | None}
_COMPARISON = {
    **_row("structure input output seconds_preparation engine_reason system_sha256 judge seed threads"),
    **_RUN, "results": [_COMPARED], "ca_rmsd_angstrom": {OTHERS: {OTHERS: float | None}},
    "quality": {OTHERS: _QUALITY}, "work": [_WORK], "spread": [_SPREAD], "repeats": [_SOLUTION],
}  # fmt: skip
_TOTALS = {
    **_row("rotamers_changed hydrogen_bonds_kept hydrogen_bonds_gained hydrogen_bonds_lost"),
    **_row("salt_bridges_kept salt_bridges_gained salt_bridges_lost contacts_kept ca_rmsd_angstrom"),
    **_row("rigid_domains"), OTHERS: float | None,
}  # fmt: skip
_CHANGED = {
    **_RESIDUE, **_row(["secondary_structure", "domain", *TORSIONS]),
    **_row("torsions_degrees rotamer_before rotamer_after ca_moved_angstrom"),
}  # fmt: skip
_BOND = _row("kind change first second")

_SETTINGS = {
    {"restraints": "restraint", **simulation.RECORD_NAMES}.get(name, name): kind
    for name, kind in get_type_hints(SimulationSettings).items()
} | {"pull": str | None, "hinge_springs": list[str] | None, "restraint": list[str] | None}  # fmt: skip
_SIMULATED = {
    **_row(simulation.RECORD), **_SETTINGS,
    **_optional(_row(simulation.PULL_COLUMNS)), **_ORIGIN,
}  # fmt: skip
_LOG = {
    **_row("step time_ps kinetic_kj_mol potential_kj_mol total_kj_mol conserved_kj_mol temperature_k"),
    **_row("ca_rmsd_angstrom"),
    **_optional(_row("fixman_kj_mol hinge_springs_kj_mol restraints_kj_mol dampers_kj_mol")),
    **_optional(_row("closure_error_nm pull_distance_nm")),
    **_optional(_row("pull_extension_nm pull_force_kj_mol_nm pull_work_kj_mol")),
}
_MODES = {
    **_row(of_modes.COLUMNS), **_ORIGIN,
    **_row("temperature_k entropy_kj_mol_k entropy_classical_kj_mol_k log_det_hessian first"),
    **_optional(_row("other cumulative_overlap")),
}  # fmt: skip
_MODE = _row("mode frequency_per_cm eigenvalue_per_ps2 collectivity residual")
_FLUCTUATION = _row(
    "ca_fluctuation_angstrom ca_b_factor_angstrom2 b_factor_angstrom2 ca_b_factor_in_file_angstrom2"
)

_CLUSTER = {"cluster": int, "frames": int, "medoid": int, "distance_mean": float, "message": str}
_CLUSTERED = {"frame": int, "cluster": int, "medoid": bool, "distance_to_medoid": float}
_FLUCTUATING = _row("ca_fluctuation_angstrom") | _optional(_row("ca_fluctuation_after_angstrom"))

_SEARCHED = {
    **_row("structure energy_lowest_kj_mol n_minima n_walks_at_lowest agreement evaluations steps"),
    **_row("acceptance round_trips seconds"),
    **_row("interrupted temperature_lowest_k temperature_highest_k temperatures_k n_hinges hinges"),
    **_row("forcefield solvent engine device engine_reason"), **_RUN,
    **{k: v for k, v in get_type_hints(SearchSettings).items() if k not in ("temperatures", "restraints")},
    "restraint": list[str] | None,
}  # fmt: skip
_MINIMUM = _row(
    "minimum energy_kj_mol above_lowest_kj_mol ca_rmsd_to_lowest_angstrom cluster conformer helix_share "
    "free_energy_kj_mol free_energy_rigid_kj_mol walker evaluations_of_walker"
)
_POPULATION = _row(
    "temperature_k energy_kj_mol energy_error_kj_mol helix_share helix_share_error exchanges slope "
    "slope_error"
)

_VALIDATED = {
    **_row("file structure model n_chains n_residues n_atoms heavy_atoms_added"), **_row(MEASURES),
    **_optional(_row([*LIKENESS, "chain_mapping"])), **_row("added message"),
}  # fmt: skip
_LISTED = {
    "findings": list[str], "ligands": [_row(LIGAND_COLUMNS)], "nucleotides": [_row(NUCLEOTIDE_COLUMNS)],
    **_optional({"changes": _TOTALS, "bonds_changed": [_BOND]}),
}  # fmt: skip
_MODEL = {"file": str | None, "model": int | None}
_OF_FRAMES_SCORED = ["interface", *SCORES, *MAKEUP, *RESIDUES]
_SCORED = {
    **_row(["file", "structure", *_OF_FRAMES_SCORED, *CONFIDENCES, "message"]), **_optional(_row(DOCKING))
}  # fmt: skip
_SHARES = {
    **_row("side chain residue name energy_kj_mol interaction_kj_mol desolvation_kj_mol"),
    **_row("buried_area_angstrom2 contacts hydrogen_bonds salt_bridges clashes unsatisfied_polar_atoms"),
    **_row("file interface"),
}
_ENERGIES = _row([*TERMS, "total"])
_SIDES = _row("chain_1 residue_1 name_1 chain_2 residue_2 name_2")
_BY = ({"of": str, **_ENERGIES}, {**_RESIDUE, **_ENERGIES}, {**_SIDES, **_ENERGIES})
_MEASURED = _cells(
    _optional(_row(["reference", "file", "model", *of_deviation.COLUMNS, *QUALITY, "message"])),
    _row("reference file model message"),
)
_WHOLE = EnergyFrames(Setup()).columns
_PARTS = EnergyFrames(Setup(), "A,B").columns


def _names(paths: Iterable[Path]) -> tuple[str, ...]:
    return tuple(path.name for path in paths)


_ENERGIES_TOLD = _row("input by between unit solvent forcefield rows files", between=str | None)
_FINDINGS_TOLD = _row("reference results files", reference=str | None)
_SCORES_TOLD = _row(
    "interface rank solvent forcefield results files", interface=list[str] | None, rank=str | None
)
_DEVIATIONS_TOLD = _row("reference align measure results files")
_FRAMES_TOLD = _row(
    "counts csv frames input interrupted output report topology trajectory written",
    counts=dict[str, int], frames=int, output=str | None, report=str | None, topology=str | None, written=int,
)  # fmt: skip
_FACTS = {
    **_row("hinges input left_out loops lost_atoms n_atoms n_bodies n_chains n_hinges n_q n_residues n_v"),
    **_row("overlaps violations repairs seconds_chain seconds_import seconds_preparation"),
    **_optional(_row("engine engine_reason threads constant_terms seconds_energy", seconds_energy=float)),
    **_optional(_row("device devices breaks", devices=list[str], breaks=list[str])),
    "hinges": dict[str, int], "loops": list[str], "overlaps": list[str], "violations": list[str],
    **dict.fromkeys(("seconds_chain", "seconds_import", "seconds_preparation"), float),
}  # fmt: skip


_MUTANT = _cells(_row("chain residue wild mutant"), _row(of_mutations.COLUMNS))
_MUTATIONS_TOLD = _row("input sites into results files", results=[_MUTANT])
_DESIGN = _cells(_row("record"), _row(of_mutations.COLUMNS))
_DESIGNS_TOLD = _row("input results files", results=[_DESIGN])
_SCANNED = _row("input n_points lowest files", lowest={OTHERS: float})
_POSE = {name.removeprefix("pose_"): kind for name, kind in OF_POSE.items()}
_RESTRAINTS = {"--restraint-csv": (_cells(get_type_hints(RestraintValue)),)}
CONTRACTS: Mapping[str, Contract] = {
    "minimise": Contract(
        (_MINIMISED, {"models": [_MINIMISED]}), {"--trace": (_cells(_TRACE),), **_RESTRAINTS}
    ),
    "relax": Contract(
        (_RELAXED, _FRAMES_TOLD, _BATCH),
        {
            "relaxed.csv": (_of_batch(table.RELAXED_COLUMNS, _FURTHER),), **_BATCH_TABLES,
            "poses.csv": (_cells(_row("structure status message"), _POSE),),
            "--trajectory": (_frames(of_relaxing.OF_FRAMES, of_relaxing.INTERFACE_COLUMNS),), **_RESTRAINTS,
        },
        (*_names(table.files_of(Path(), "relaxed")), *_BATCH_FILES), _BATCH_MORE,
    ),
    "compare": Contract(
        (_COMPARISON,),
        {
            "summary.csv": (_cells(_COMPARED),),
            "equal_cost.csv": (_cells(_row("cost at"), {OTHERS: float}),),
            "work.csv": (_cells(_WORK),), "spread.csv": (_cells(_SPREAD),),
            "displacement.csv": (_cells(_RESIDUE, {OTHERS: float}),),
            "traces.csv": (_cells(_row("structure method"), _TRACE),),
            "differences.csv": (_cells(_row("method"), _TOTALS),),
            "residue_differences.csv": (_cells(_row("method"), _CHANGED),),
            "bonds_changed.csv": (_cells(_row("method"), _BOND),),
            "quality.csv": (_cells(_row("structure"), _QUALITY),),
        },
        ("report.html", *of_comparison.names()), (_STRUCTURE,),
    ),
    "batch": Contract(
        (_BATCH, {"structures": [_row("input methods structure", methods=list[str])]}),
        {"summary.csv": (_of_batch(_BOTH, _EITHER),), **_BATCH_TABLES},
        (*_names(table.files_of(Path())), *_BATCH_FILES), _BATCH_MORE,
    ),
    "simulate": Contract(
        (_SIMULATED,), {"log.csv": (_cells(_LOG),)},
        ("log.csv", "summary.json", "checkpoint.npz", "report.html"),
        (r"^trajectory\.(dcd|xtc)$", r"^last\.(pdb|cif)$"),
    ),
    "modes": Contract(
        (_MODES,),
        {
            "modes.csv": (_cells(_MODE, _optional(_row("overlap cumulative_overlap"))),),
            "fluctuations.csv": (_cells(_RESIDUE, _FLUCTUATION),),
        },
        ("modes.csv", "summary.json", "report.html"),
        (r"^fluctuations\.csv$", r"^minimum\.(pdb|cif)", r"^mode-\d+\.(dcd|xtc)$"),
    ),
    "ensemble": Contract(
        (_row("input by results files", results=[_CLUSTER]),),
        {"--csv": (_cells(_CLUSTERED),), "--residues": (_cells(_RESIDUE, _FLUCTUATING),)},
        (), (_STRUCTURE,),
    ),
    "search": Contract(
        (_SEARCHED,),
        {
            "minima.csv": (_cells(_MINIMUM),), "populations.csv": (_cells(_POPULATION),),
            "conformers.csv": (_cells(_row("temperature_k conformer share share_error")),),
        },
        ("minima.csv", "energy-rmsd.png", "summary.json", "report.html"),
        (r"^(populations|conformers)\.csv$", r"^minima/minimum-\d+\.pdb$", r"\.npz$"),
    ),
    "validate": Contract(
        (_FINDINGS_TOLD | {"results": [{**_VALIDATED, **_LISTED}, _FAILED]}, _FRAMES_TOLD),
        {
            "--csv": (_cells(_optional(_VALIDATED), _row("file message")),),
            "--residues": (_cells(_row(RESIDUE_COLUMNS), _optional(_row("lddt")), _MODEL),),
            "--changes": (_cells(_CHANGED, _MODEL),),
            "--trajectory": (_frames(MEASURES, LIKENESS),),
        },
    ),
    "score": Contract(
        (_SCORES_TOLD | {"results": [_SCORED, _FAILED]}, _FRAMES_TOLD),
        {
            "--csv": (_cells(_optional(_SCORED), _row("file message")),), "--residues": (_cells(_SHARES),),
            "--trajectory": (_frames(_OF_FRAMES_SCORED, DOCKING),),
        },
    ),
    "energy": Contract(
        (*(_ENERGIES_TOLD | {"rows": [kind]} for kind in _BY), _FRAMES_TOLD),
        {"--output": tuple(map(_cells, _BY)), "--trajectory": (_frames(_WHOLE), _frames(_PARTS))},
    ),
    "rmsd": Contract(
        (_DEVIATIONS_TOLD | {"results": [_MEASURED]}, _FRAMES_TOLD),
        {"--output": (_MEASURED,), "--trajectory": (_frames(of_deviation.COLUMNS),)},
    ),
    "mutate": Contract(
        (_row(of_mutations.COLUMNS) | _ORIGIN, _MUTATIONS_TOLD, _DESIGNS_TOLD),
        {"--scan": (_MUTANT,), "--sequence": (_DESIGN,)},
    ),
    "scan": Contract((_SCANNED,), {"--output": (_cells({OTHERS: float, "status": NotRequired[Status]}),)}),
    "info": Contract((_FACTS,)),
    "build": Contract(
        (_row("n_atoms n_residues output"), {"results": [_row("record n_atoms n_residues output")]})
    ),
}  # fmt: skip
"""Contracts by command."""
