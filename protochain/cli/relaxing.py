"""Printed text of ``protochain relax``: the plan, then the improvements."""

import textwrap
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

import numpy as np

from protochain.cli.lines import Kind, energy_text, is_verbose, residues_shown, table_of_two, tell
from protochain.cli.options import describe_move, print_changes, print_files, print_lost, print_violations
from protochain.core import defaults
from protochain.core.lazy_pandas import pd
from protochain.core.markup import abridge, plural
from protochain.core.timings import part

if TYPE_CHECKING:
    from protochain.core.arrays import Watcher
    from protochain.energies import Energy
    from protochain.relaxation import Relaxation
    from protochain.structure import Structure

_EVALUATIONS = 90  # Usual evaluations of a relaxation.
_WIDTH = 80  # Characters of the narrowest terminal.
_LIGANDS = 3  # Listed ligands, with the largest motion.
_SHOWN = 10  # Listed structures that failed or are not converged.
_SHOW_FROM = 5.0  # s. Shorter runs do not show a bar, whose library loads slowly.


@part("measuring")
def print_plan(source: Path, structure: "Structure", energy: "Energy", move: str = defaults.MOVE) -> float:
    """Print the plan for a file and its expected time. Return the time in seconds."""
    from protochain.relaxation.problems import Problems

    x = structure.positions
    energy(x)  # Loads kernels.
    began = monotonic()
    energy(x)
    seconds = _EVALUATIONS * (monotonic() - began)
    at = Problems(structure, x)
    n, n_hetero = len(at.overlaps), at.n_hetero_overlaps
    inverted = plural(len(at.inversions), "inverted stereocentre")
    as_d = structure.mirrored[structure.atom_residue[at.inversions]].all()
    advice = "" if as_d else " (name D-amino acids as DAL ...)"
    rings = ["threaded rings, to be freed first: " + abridge([*map(str, at.rings)], 2)] if at.rings else []
    inverted_line = [f"{inverted}, to be corrected{advice}"] if len(at.inversions) else []
    twisted = plural(len(at.peptides), "twisted peptide bond")
    duration = f"about {max(seconds, 1.0):.0f} s"
    lines = [
        *describe_move(structure, move),
        f"{n or 'no'} pair{'s' * (n != 1)} of atoms overlap{'s' * (n == 1)}"
        + (f", {n_hetero} of them with hetero molecules" if n_hetero else ""),
        str(at.violations),
        *rings,
        *inverted_line,
        *([f"{twisted}, to be turned to trans or cis"] if len(at.peptides) else []),
        *_breaks(structure),
        duration,
    ]
    short = [*describe_move(structure, move), duration]
    warnings = [] if is_verbose() else [*rings, *(inverted_line if advice else ())]
    print_changes(source, structure, lines if is_verbose() else short, warnings)
    return seconds


def _breaks(structure: "Structure") -> list[str]:
    protein_residues = np.unique(structure.atom_residue[~structure.kept])
    _, first = np.unique(structure.residue_chain_index[protein_residues], return_index=True)
    n = len(first) - len({*structure.residue_chain[protein_residues[first]].tolist()})
    line = f"{plural(n, 'chain break')}, which {'stay as they are' if n > 1 else 'stays as it is'}"
    return [line] if n > 0 else []


def progress(seconds: float) -> "AbstractContextManager[Watcher | None]":
    """Show stage, energy and evaluations of a long run."""
    if seconds < _SHOW_FROM:
        return nullcontext()
    from protochain.cli.terminal import evaluations_progress

    return evaluations_progress("relax")


def print_relaxed(result: "Relaxation", record: dict[str, Any]) -> None:
    """Print the violations before and after, the motion, and the written files."""
    from protochain.relaxation.record import ENERGY, before_and_after
    from protochain.structure.molecule.repairs import summarise
    from protochain.validation.findings import describe_remains

    rows = {name: (before, after) for name, before, after in before_and_after(record)}
    energies = record["energy_start_kj_mol"], record["energy_end_reference_kj_mol"]
    rows[ENERGY] = energy_text(rows[ENERGY][0], energies[0]), energy_text(rows[ENERGY][1], energies[1])
    table_of_two([(name, *values) for name, values in rows.items()])
    rounds, rmsd = record["n_rounds"], record["ca_rmsd_angstrom"]
    summary = (
        f"farthest atom moved by {record['farthest_atom_angstrom']:.2f} angstrom; "
        f"{rounds} round{'s' * (rounds > 1)}, {record['evaluations']} evaluations, {record['seconds']:.1f} s"
    )
    summary = summary if rmsd is None else f"C-alpha RMSD to the input {rmsd:.2f} angstrom, {summary}"
    motion = [
        f"{m['name']} {m['chain']}:{m['residue']} RMSD {m['rmsd_angstrom']:.2f}, largest displacement "
        f"{m['displacement_max_angstrom']:.2f} angstrom"
        for m in sorted(record["ligands"], key=lambda m: -m["displacement_max_angstrom"])
    ]
    lines = [summary, *([f"ligands: {abridge(motion, _LIGANDS)}"] if motion else [])]
    lines += _posebusters(record["ligands"]) if result.settings.posebusters else []
    details = []
    if record["repacked"]:
        repacked = summarise(result.turned) or ("no side chain improves",)
        details.append(f"repacked first: {'; '.join(repacked)}")
    if repairs := (*result.stereocentres_corrected, *result.peptides_turned):
        details.append("; ".join(summarise(repairs)))
    _print_wrapped(Kind.RESULT, lines)
    _print_wrapped(Kind.MORE, details)
    _print_wrapped(Kind.VERDICT, [record["message"]])
    _print_wrapped(Kind.RESULT, describe_remains(record, residues_shown()))
    print_violations(record)
    print_lost([record])
    tell(Kind.WRITTEN, f"written: {'standard output' if record['output'] == '-' else record['output']}")
    print_files(*record.get("confidences", ()), record.get("ligands_written"), record.get("report"))


def _posebusters(ligands: list[dict[str, Any]]) -> list[str]:
    """Summary of PoseBusters' tests, a line."""
    from protochain.structure.molecule.residues import Residue

    before, after = ([m[f"posebusters_passed_{when}"] for m in ligands] for when in ("start", "end"))
    if not ligands or None in after:
        reason = "PoseBusters is not installed" if ligands else "no ligand has known chemistry"
        return [f"PoseBusters' tests: not run, {reason}"]
    failed = [
        f"{Residue(m['chain'], m['residue'], m['name'])} fails {', '.join(m['posebusters_failed_end'])}"
        for m in ligands if not m["posebusters_passed_end"]
    ]  # fmt: skip
    n = plural(len(ligands), "ligand")
    passing = f"PoseBusters' tests: {sum(before)} of {n} passed before, {sum(after)} after"
    return ["; ".join([passing, *([abridge(failed, _LIGANDS)] if failed else [])])]


def _print_wrapped(kind: Kind, lines: list[str]) -> None:
    tell(kind, *(row for line in lines for row in textwrap.wrap(line, _WIDTH)))


def print_folder(table: "pd.DataFrame", folder: Path) -> None:
    """Print the number of each status, remaining violations, and the written files."""
    from protochain.cli.terminal import count_violations, ligands_moved

    usable = table[table["output"].notna()]
    counts = ", ".join(f"{n} {status}" for status, n in table["status"].value_counts().items())
    tell(Kind.VERDICT, f"{plural(len(table), 'structure')}: {counts}")
    if "pose_valid" in table:
        n_valid = int(table["pose_valid"].fillna(value=False).sum())
        tested = table["pose_sanitization"].notna().any()
        tests = "PoseBusters' tests pass" if tested else "no clashes, stereo as in their file"
        valid = f"{'is' if n_valid == 1 else 'are'} valid"
        tell(Kind.VERDICT, f"{n_valid} of {plural(len(table), 'pose')} {valid}: {tests}")
    if len(usable):
        rmsd, seconds = usable["ca_rmsd_angstrom"].median(), usable["seconds"].median()
        medians = f"medians: C-alpha RMSD {rmsd:.2f} angstrom, {seconds:.1f} s{ligands_moved(usable)}"
        tell(Kind.RESULT, f"{count_violations(usable)}; {medians}")
    overlapping = usable[usable["overlaps_beside_start"] > 0]
    if len(overlapping):
        names = [
            f"{row.structure} ({row.overlaps_beside_start:.0f} pairs, {row.overlaps_beside_end:.0f} left)"
            for row in overlapping.head(_SHOWN).itertuples()
        ]
        ending = f" and {len(overlapping) - _SHOWN} more, in the table" if len(overlapping) > _SHOWN else ""
        text = "structures overlapped with hetero molecules"
        tell(Kind.RESULT, f"{len(overlapping)} of {len(table)} {text}: {', '.join(names)}{ending}")
    unconverged = table[~table["status"].isin(("converged", "measured"))]
    for row in unconverged.head(_SHOWN).itertuples():
        tell(Kind.RESULT, f"{row.structure}: {row.message}")
    if len(unconverged) > _SHOWN:
        tell(Kind.RESULT, f"and {len(unconverged) - _SHOWN} more, in the table")
    print_lost(table.to_dict("records"))
    poses = ", poses.csv" * ("pose_valid" in table)
    written = f"{folder / 'relaxed.csv'}{poses}, the structures, and report.html in one folder"
    tell(Kind.WRITTEN, f"written: {written}")
