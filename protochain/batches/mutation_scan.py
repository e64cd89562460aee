"""All mutations of some sites, in this process or several. The table is complete after each mutant."""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from protochain.batches.batch_settings import run_settings
from protochain.batches.cluster import Processes, load_shared, reason, run_jobs, shared_file
from protochain.chains.setup import Setup
from protochain.core.checkpoints import checkpoint, write_checkpoint
from protochain.core.checks import at_least, check_arguments, optional, text
from protochain.core.errors import Argument, ProtochainError
from protochain.core.interrupts import held_interrupts
from protochain.core.lazy_pandas import pd
from protochain.core.storage import write_atomically
from protochain.energies.decomposed import residues_of
from protochain.relaxation.mutations import COLUMNS, mutate_at, mutation_label, protocol
from protochain.relaxation.relax_settings import RelaxSettings
from protochain.relaxation.result import Relaxation
from protochain.results.run_folder import checkpoint_of, refuse_earlier
from protochain.structure import Structure
from protochain.structure.molecule.residues import LETTERS, STANDARD
from protochain.structure.substitute import thread_sequence

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ALL = "all"
Rows = list[dict[str, Any]]
_SITE = ("chain", "residue", "wild", "mutant")
_MOST = 15.0  # kJ/mol at which the colours of the heat map saturate, about 3.6 kcal/mol.


Mutant = tuple[Mapping[str, Any], Mapping[int, str] | str, Path | None]
"""First columns of its row, new residues or a sequence, and a file to write."""


@dataclass(frozen=True)
class MutantJob:
    """Mutants for a process."""

    task: Path  # Pickled structure and settings.
    mutants: Sequence[Mutant]

    def run(self, threads: int) -> Iterator[dict[str, Any]]:
        """Build and relax each mutant. Mutants with the same moving residues share the wild type."""
        structure, relaxing, setup = load_shared(self.task)
        relaxations: dict[tuple[Any, ...], Relaxation] = {}
        for mutant in self.mutants:
            first_columns, change, output = mutant
            try:
                names = thread_sequence(structure, change) if isinstance(change, str) else change
                if not names:  # The first record of ProteinMPNN is the input. A residue becomes itself.
                    amino = (r for r, name in enumerate(structure.residue_name.tolist()) if name in STANDARD)
                    names = {r: str(structure.residue_name[r]) for r in itertools.islice(amino, 1)}
                mutation = mutate_at(structure, names, relaxing, replace(setup, threads=threads), relaxations)
                if output and mutation.mutant.is_usable:
                    mutation.save(output)
                yield {**first_columns, **mutation.record()}
            except Exception as error:
                yield _failed_row(structure, mutant, *reason(error))

    def lost(self, finished_rows: Sequence[Any], status: str, message: str, seconds: float) -> Rows:
        """Rows of the missing mutants, if the process ended."""
        structure = load_shared(self.task)[0]
        missing = self.mutants[len(finished_rows) :]
        return [_failed_row(structure, mutant, status, message) for mutant in missing]


def _failed_row(structure: Structure, mutant: Mutant, status: str, message: str) -> dict[str, Any]:
    first_columns, change, _ = mutant
    row = {**first_columns, **dict.fromkeys(column.key for column in COLUMNS), "structure": structure.name}
    if not isinstance(change, str):
        row["mutations"] = ",".join(mutation_label(structure, r, name) for r, name in change.items())
    return row | {"status": status, "message": message}


def mutate_designs(
    structure: Structure, outputs: Mapping[Path, tuple[str, str]], relaxing: RelaxSettings, setup: Setup,
    table: Path, processes: Processes, watch: Callable[[int, int], None],
) -> Rows:  # fmt: skip
    """Write a mutant for each design (name, sequence) by its file, and the table of all, in their order."""
    rows: Rows = []
    names = [name for name, _ in outputs.values()]
    with shared_file((structure, relaxing, setup)) as task:
        mutants = [({"record": name}, letters, path.absolute()) for path, (name, letters) in outputs.items()]
        for _, rows_of_job in run_jobs([MutantJob(task, [mutant]) for mutant in mutants], processes):
            rows = sorted([*rows, *rows_of_job], key=lambda row: names.index(row["record"]))
            write_atomically(table, partial(pd.DataFrame(rows).to_csv, index=False))
            watch(len(rows), len(mutants))
    return rows


def _site(structure: Structure, r: int, letter: str) -> dict[str, Any]:
    residue = structure.residue(r)
    wild = STANDARD[str(structure.residue_name[r])]
    return dict(zip(_SITE, (residue.chain, residue.number, wild, letter), strict=True))


def sites_of(structure: Structure, sites: str, into: str) -> list[tuple[int, str]]:
    """Indices of residues, and their new letters, of ``A:1-50,B:7`` and ``A``, ``AVL`` or ``all``."""
    letters = "".join(sorted(LETTERS)) if text(into, "into") == ALL else into.upper()
    if not letters or not {*letters} <= LETTERS.keys():
        raise ProtochainError(Argument("into"), f" {into!r}: give letters of residues, as A or AVL, or all")
    is_site = np.zeros(structure.n_residues, dtype=bool)
    for part in text(sites, "sites").split(","):
        is_site |= residues_of(structure, part.strip(), "sites")
    letters_of_residues = [STANDARD.get(str(name), "") for name in structure.residue_name]
    is_hetero = np.isin(np.arange(structure.n_residues), structure.atom_residue[structure.kept])
    rows = [
        (r, "".join(letter for letter in dict.fromkeys(letters) if letter != letters_of_residues[r]))
        for r in np.flatnonzero(is_site & ~is_hetero).tolist()
        if letters_of_residues[r]
    ]
    if not any(mutants for _, mutants in rows):
        raise ProtochainError(f"{structure.name}: sites {sites!r} into {into!r}: there is nothing to mutate")
    return [(r, mutants) for r, mutants in rows if mutants]


@check_arguments(workers=optional(at_least(1)))
def scan_mutations(
    source: Any, sites: str, into: str = "A", *, workers: int | None = None, **options: Any
) -> "pd.DataFrame":
    """Mutate each residue of some sites separately, to alanine or to other residues.

    Parameters
    ----------
    source : Structure, path, or anything that :func:`protochain.as_structure` accepts
        Structure to mutate. Relax it first.
    sites : str
        Residues, as ``"A:1-50,B:7"``, chains, or one selection in the language of MDAnalysis.
    into : str
        One-letter codes of the new residues, or ``all`` for the other nineteen.
    workers : int, optional
        Processes. By default, this process runs all mutants.
    **options
        As for :func:`protochain.mutate`.

    Returns
    -------
    pandas.DataFrame
        A row for each mutant: ``chain``, ``residue``, ``wild``, ``mutant``, and the columns of
        :meth:`Mutation.record`. A mutant that cannot be built has a message.

    Raises
    ------
    ProtochainError
        If the structure has no such sites, or an option is invalid.

    Examples
    --------
    >>> pc.scan_mutations("structures/1l2y.pdb", "A:7-8", solvent="vacuum")["mutations"].tolist()
    ['A:L7A', 'A:K8A']
    """
    relaxing, setup = protocol(options, source)
    structure = setup.load(source)
    processes = Processes(workers, threads=setup.threads or 1) if workers else None
    rows = [*rows_of(structure, sites_of(structure, sites, into), relaxing, setup, processes)]
    return pd.DataFrame(sorted(rows, key=_order(structure)))


def rows_of(
    structure: Structure, jobs: Sequence[tuple[int, str]], relaxing: RelaxSettings, setup: Setup,
    processes: Processes | None,
) -> Iterator[dict[str, Any]]:  # fmt: skip
    """Rows of mutants, as they are finished."""
    with shared_file((structure, relaxing, setup)) as path:
        site_jobs = [
            MutantJob(path, [(_site(structure, r, new), {r: LETTERS[new]}, None) for new in letters])
            for r, letters in jobs
        ]
        for _, rows in run_jobs(site_jobs, processes, setup.threads):
            yield from rows


def _order(structure: Structure) -> Callable[[Any], tuple[int, str]]:
    place = {(s.chain, s.number): r for r in range(structure.n_residues) for s in (structure.residue(r),)}
    return lambda row: (place[row["chain"], str(row["residue"])], str(row["mutant"]))


def run_scan(
    structure: Structure, sites: str, into: str, relaxing: RelaxSettings, setup: Setup, table: Path,
    processes: Processes, resume: bool, watch: Callable[[int, int], None],
) -> tuple["pd.DataFrame", bool]:  # fmt: skip
    """Write a table of mutants as they finish, or resume one. Return it, and whether it was interrupted."""
    jobs, checkpoint_file = sites_of(structure, sites, into), checkpoint_of(table)
    options = {**vars(setup), **vars(relaxing)}
    plain = {name: str(value) for name, value in options.items() if name != "threads"}
    settings = {
        "sites": sites, "into": into, "atoms": structure.fingerprint,
        "start": structure.positions_fingerprint, **run_settings(setup), **plain,
    }  # fmt: skip
    rows: Rows = []
    # Read the finished rows of an interrupted scan.
    if checkpoint_file.exists() and resume:
        remedy = "give another output, or remove ", Argument("resume", True)
        with checkpoint(checkpoint_file, settings, "scan", *remedy):
            pass  # Only to compare the settings.
        if table.exists():
            numbers = [column.key for column in COLUMNS if column.kind is not str]
            read: Any = pd.read_csv(
                table, dtype=dict.fromkeys((*_SITE, "structure"), "str"), keep_default_na=False,
                na_values={name: [""] for name in numbers},
            )  # fmt: skip
            rows = read.to_dict("records")
    elif checkpoint_file.exists():
        raise refuse_earlier(table, "an interrupted scan", "; or remove ", str(checkpoint_file))
    finished, order = {(row["chain"], row["residue"], row["mutant"]) for row in rows}, _order(structure)
    remaining = []
    for r, letters in jobs:
        site = structure.residue(r)
        letters = "".join(letter for letter in letters if (site.chain, site.number, letter) not in finished)
        remaining += [(r, letters)] if letters else []
    total, interrupted = len(rows) + sum(len(letters) for _, letters in remaining), False

    columns = [*_SITE, *(column.key for column in COLUMNS)]

    def keep() -> "pd.DataFrame":
        sorted_table = pd.DataFrame(sorted(rows, key=order), columns=columns)
        write_atomically(table, lambda to: sorted_table.to_csv(to, index=False))
        return sorted_table

    keep()  # Replaces an earlier table, whose rows are not part of this scan.
    write_checkpoint(checkpoint_file, {}, None, settings)
    try:
        for row in rows_of(structure, remaining, relaxing, setup, processes):
            with held_interrupts() as signals:
                rows.append(row)
                keep()
            watch(len(rows), total)
            if signals:
                raise KeyboardInterrupt
    except KeyboardInterrupt:
        interrupted = True
    if not interrupted:
        checkpoint_file.unlink(missing_ok=True)
    return keep(), interrupted


def heat_map(table: "pd.DataFrame") -> "Figure":
    """Heat map of ddg of sites against new residues: red positive, blue negative, grey the wild type."""
    from protochain.results.figures import panels

    sites = list(dict.fromkeys(zip(table["chain"], table["residue"].astype(str), table["wild"], strict=True)))
    letters = sorted({*table["mutant"]})
    values = np.full((len(letters), len(sites)), np.nan)
    for row in table.astype({"ddg_kj_mol": float}).to_dict("records"):
        position = sites.index((row["chain"], str(row["residue"]), row["wild"]))
        values[letters.index(row["mutant"]), position] = row["ddg_kj_mol"]
    figure, (ax,) = panels(None, 1, (2.5 + 0.22 * len(sites), 1.6 + 0.22 * len(letters)))
    n_values = np.isfinite(values).sum()
    ax.set_title(f"{(values > 0.0).sum()} of {n_values} mutants are less stable", loc="left")
    ax.grid(False)
    image = ax.imshow(values, cmap="coolwarm", vmin=-_MOST, vmax=_MOST, aspect="auto")
    ax.set_facecolor("#cccccc")
    names = [f"{chain}:{wild}{number}" for chain, number, wild in sites]
    ax.set_xticks(range(len(sites)), names, rotation=90)
    ax.set_yticks(range(len(letters)), letters)
    figure.colorbar(image, ax=ax, label="kJ/mol", extend="both")
    return figure
