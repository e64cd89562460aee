"""Comparison of methods: solutions from one start, as tables, figures, files and one self-contained page."""

import json
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from protochain.chains.chain import Chain
from protochain.comparison import plots
from protochain.comparison.colourings import colourings
from protochain.comparison.deviation import deviation
from protochain.comparison.differences import Differences, concatenate, of_ends, totals_of
from protochain.comparison.folder import FIGURES, clear
from protochain.comparison.quality import quality
from protochain.comparison.work import at_equal_cost, spreads, work_to_reach
from protochain.core.arrays import Floats
from protochain.core.errors import Argument, ProtochainError, WriteError
from protochain.core.settings import document_fields
from protochain.core.storage import json_text, write_atomically, write_text
from protochain.energies import Energy
from protochain.minimisers import Solution
from protochain.minimisers.record import short_columns
from protochain.minimisers.solution import TRACE_COLUMNS, alpha_residues
from protochain.minimisers.starts import lowest_solution
from protochain.results.columns import energies_by_term, flat
from protochain.results.figures import data_url
from protochain.results.page import render
from protochain.results.provenance import of_run
from protochain.results.viewer import View, scene
from protochain.structure import Structure, ca_rmsd, save
from protochain.structure.molecule.repairs import loss_lines
from protochain.structure.superpose import displacements
from protochain.structure.write import common_suffix
from protochain.validation.ramachandran import ramachandran

_PACKAGES = ("openmm", "gemmi", "numpy", "scipy", "numba", "mdtraj", "MDAnalysis", "tmtools", "pandas")

_LEAST_OF_TM = 30  # Fewest residues for a TM-score, whose scale is meant for longer chains.


@document_fields
@dataclass(frozen=True, eq=False)
class Comparison:
    """Minimisations of one structure by several methods.

    Raises
    ------
    ProtochainError
        If the solutions are not of one energy function or one start.

    Examples
    --------
    >>> pc.compare("structures/ala10.pdb", ["lbfgs", "md"]).table["method"].tolist()
    ['lbfgs', 'md']
    """

    structure: Structure  # The common start.
    # One per method, all with the same energy function, for tables, plots and files.
    solutions: tuple[Solution, ...]
    # Facts about the input (path, seconds of preparation), added to every record.
    origin: Mapping[str, Any] = field(default_factory=dict)
    # Structure to measure the ends against, for example an experimental one. Its sequence may differ.
    reference: Structure | None = None
    repeats: tuple[Solution, ...] = ()  # Further runs of the methods that do not repeat exactly.

    def __post_init__(self) -> None:
        runs = self.solutions + self.repeats
        if len({s.energy_function.fingerprint for s in runs}) > 1:
            raise ProtochainError(
                "solutions of different energy functions cannot be compared; use one for all"
            )
        if any(s.chain.structure is not self.structure for s in runs):
            raise ProtochainError("solutions of different starts cannot be compared; use one for all")

    @cached_property
    def best(self) -> Solution:
        """Solution of lowest energy, which other calls use. Solutions with changed isomers come last."""
        return lowest_solution(self.solutions)

    @property
    def chain(self) -> Chain:
        """Chain of the best solution."""
        return self.best.chain

    @property
    def energy_function(self) -> Energy:
        """Energy function of all solutions."""
        return self.best.energy_function

    @property
    def frames(self) -> Floats:
        """(n, na, 3) float, nm: positions at the end of each solution, in the order of ``table``."""
        return np.array([solution.x for solution in self.solutions])

    @cached_property
    def table(self) -> pd.DataFrame:
        """One row per method: the columns of the JSON record, lists and counts as text."""
        return pd.DataFrame([{key: flat(value) for key, value in row.items()} for row in self.records()])

    def records(self) -> list[dict[str, Any]]:
        """JSON record of each solution, with its origin and the name of its file, or None."""
        return [
            {**s.record(), **self.origin, "message": self.message(s), "output": self.file_of(s)}
            for s in self.solutions
        ]

    def file_of(self, solution: Solution) -> str | None:
        """Name of a solution's file, or None if its end is not better than the start."""
        return f"{self.structure.name}.{solution.method}{self.suffix}" if solution.is_usable else None

    def message(self, solution: Solution) -> str:
        """Message of a solution, with a note if it has no file."""
        none = "; no result is better than the start: no structure is written"
        return solution.message + ("" if solution.is_usable else none)

    @cached_property
    def traces(self) -> pd.DataFrame:
        """All trace rows, with columns ``structure`` and ``method`` before ``TRACE_COLUMNS``."""
        parts = [s.trace.assign(structure=self.structure.name, method=s.method) for s in self.solutions]
        return pd.concat(parts, ignore_index=True)[["structure", "method", *TRACE_COLUMNS]]

    @cached_property
    def rmsd(self) -> pd.DataFrame:
        """Pairwise C-alpha RMSD in angstrom between the start and every end, superposed."""
        ends = {"start": self.structure.positions} | {s.method: s.x for s in self.solutions}
        return pd.DataFrame(
            [[ca_rmsd(self.structure, a, b) for b in ends.values()] for a in ends.values()],
            index=list(ends),
            columns=list(ends),
        )

    @cached_property
    def quality(self) -> pd.DataFrame:
        """Measures of :func:`protochain.comparison.quality.quality`: one row for the start and for each end.

        With a reference also ``reference_rmsd_angstrom``, ``reference_tm_score``, ``reference_coverage``.
        """
        rows = {}
        for name, end in self.ends().items():
            rows[name] = quality(end, self.structure, self.solutions[0].chain)
            if self.reference is not None:
                off = deviation(self.reference, end)
                rows[name] |= {
                    "reference_rmsd_angstrom": off.rmsd,
                    "reference_tm_score": off.tm_score,
                    "reference_coverage": off.match.coverage,
                }
        return pd.DataFrame.from_dict(rows, orient="index").rename_axis("structure")

    @cached_property
    def displacements(self) -> pd.DataFrame:
        """Displacement of each C-alpha in angstrom, superposed: rows are residues, columns methods."""
        table = alpha_residues(self.structure)
        for solution in self.solutions:
            table[solution.method] = displacements(self.structure, solution.x, self.structure.positions)
        return table

    @cached_property
    def differences(self) -> dict[str, Differences]:
        """Changes by each method: :func:`protochain.differences` of the start and each end."""
        return of_ends(self.ends())

    @cached_property
    def equal_cost(self) -> pd.DataFrame:
        """Lowest energy so far at equal evaluations and at equal seconds."""
        return at_equal_cost(self.traces)

    @cached_property
    def work(self) -> pd.DataFrame:
        """Cost to reach 100, 10 and 1 kJ/mol above the lowest end with the same degrees of freedom."""
        lowest: dict[bool, float] = {}
        for s in self.solutions + self.repeats:
            lowest[s.keeps_geometry] = min(lowest.get(s.keeps_geometry, s.end.energy), s.end.energy)
        return work_to_reach(self.traces, {s.method: lowest[s.keeps_geometry] for s in self.solutions})

    @cached_property
    def spread(self) -> pd.DataFrame:
        """Spread of the runs of each method. A method that repeats exactly has one run."""
        return spreads(self.solutions, self.repeats)

    def view(self) -> View:
        """Interactive view of the superposed start and ends, for notebooks, without any server."""
        return View(self.ends())

    def ends(self) -> dict[str, Structure]:
        """Structures of the start and the ends, with keys ``start`` and the methods."""
        return {"start": self.structure} | {s.method: s.structure for s in self.solutions}

    @property
    def _groups(self) -> dict[str, list[str]]:
        """Methods whose energies are comparable: those with the same degrees of freedom."""
        return {
            "torsions only": [s.method for s in self.solutions if s.keeps_geometry],
            "all atoms free": [s.method for s in self.solutions if not s.keeps_geometry],
        }

    def plot_energy(self, ax: Any = None) -> Figure:
        """Energy against evaluations and seconds. ``ax``: Axes to draw in, one for each panel, or one."""
        return plots.plot_energy(self.traces, self._groups, self.structure.name, ax)

    def plot_work_precision(self, ax: Any = None) -> Figure:
        """Energy above the lowest end with the same degrees of freedom, against evaluations and seconds."""
        return plots.plot_work_precision(self.traces, self.work, self._groups, self.structure.name, ax)

    def plot_torque(self, ax: Any = None) -> Figure:
        """Largest torque against evaluations and seconds, for runs in torsions."""
        return plots.plot_torque(self.traces, self.structure.name, ax)

    def plot_rmsd(self, ax: Any = None) -> Figure:
        """C-alpha RMSD to the start along each run, and between all ends."""
        return plots.plot_rmsd(self.traces, self.rmsd, self.structure.name, ax)

    def plot_displacement(self, ax: Any = None) -> Figure:
        """Displacement of each C-alpha, one line per method."""
        return plots.plot_displacement(self.displacements, self.structure.name, ax)

    def plot_differences(self, ax: Any = None) -> Figure:
        """Change of each residue's torsions, and displacement of its C-alpha, one line per method."""
        changes = {name: difference.residues for name, difference in self.differences.items()}
        return plots.plot_differences(changes, self.structure.name, ax)

    def plot_ramachandran(self, ax: Any = None) -> Figure:
        """Ramachandran plots of the start and of every end."""
        results = {name: ramachandran(end) for name, end in self.ends().items()}
        angles = {name: np.column_stack([result.phi, result.psi]) for name, result in results.items()}
        return plots.plot_ramachandran(angles, self.structure.name, ax)

    def summary(self) -> dict[str, Any]:
        """Records, RMSDs, versions and command line, to check or repeat the comparison."""
        first = self.solutions[0]
        e = first.energy_function
        return {
            "structure": self.structure.name,
            **self.origin,
            "engine_reason": e.reason,
            "system_sha256": e.fingerprint,
            "judge": first.judge,
            "seed": first.seed,
            "threads": e.threads,
            **of_run(*_PACKAGES),
            "results": self.records(),
            "ca_rmsd_angstrom": self.rmsd.to_dict(),
            "quality": _as_json(self.quality, "index"),
            "work": _as_json(self.work, "records"),
            "spread": _as_json(self.spread, "records"),
            "repeats": [s.record() for s in self.repeats],
        }

    def report(self, directory: str | Path) -> Path:
        """Write tables, plots, final structures and ``report.html``.

        Parameters
        ----------
        directory : path-like
            Created if needed. The files of an earlier comparison there are deleted first.

        Returns
        -------
        Path
            Path of the page.
        """
        folder = Path(directory)
        try:
            clear(folder)
            return _write_files(self, folder)
        except WriteError as error:
            existing = sorted(path.name for path in folder.glob("*") if not path.name.startswith("."))
            saved = f"{folder}: {', '.join(existing)}" if existing else "nothing"
            raise error.with_saved(saved, "run again with ", Argument("force", True)) from error

    def write_page(self, path: Path) -> None:
        """Write only the page, one HTML file, as for a single run."""
        write_text(path, _page(self, self.summary(), _figures(self)))

    @cached_property
    def suffix(self) -> str:
        """File suffix: PDB if it can represent all structures, otherwise mmCIF."""
        return common_suffix(self.ends().values())

    def __repr__(self) -> str:
        return f"<Comparison of {', '.join(s.method for s in self.solutions)} on {self.structure.name}>"

    def _repr_html_(self) -> str:
        columns = short_columns(self.table.to_dict("records"))
        return self.table[[column.key for column in columns]].to_html(index=False)


def _as_json(table: pd.DataFrame, orient: Any) -> Any:
    """Table as JSON values, with None for NaN."""
    return json.loads(table.to_json(orient=orient, double_precision=15))


def _write_files(comparison: Comparison, directory: Path) -> Path:
    name, suffix, summary = comparison.structure.name, comparison.suffix, comparison.summary()
    changes = comparison.differences
    tables = {
        "summary": comparison.table,
        "equal_cost": _with_unit(comparison.equal_cost, 2, "kj_mol"),
        "work": comparison.work,
        "spread": comparison.spread,
        "displacement": _with_unit(comparison.displacements, 3, "angstrom"),
        "traces": comparison.traces,
        "differences": pd.DataFrame([{"method": name, **change.totals} for name, change in changes.items()]),
        "residue_differences": concatenate(changes, "residues"),
        "bonds_changed": concatenate(changes, "bonds"),
    }
    # First, since it names the structures: files of an incomplete comparison can be replaced, too.
    write_text(directory / "summary.json", json_text(summary))
    for stem, table in tables.items():
        write_text(directory / f"{stem}.csv", table.to_csv(index=False))
    write_text(directory / "quality.csv", comparison.quality.to_csv())
    save(comparison.structure, directory / f"{name}.start{suffix}")
    for solution in comparison.solutions:
        file = comparison.file_of(solution)
        if file:
            solution.save(directory / file)
    figures = _figures(comparison)
    for stem, figure in figures.items():
        write_atomically(directory / f"{stem}.png", partial(figure.savefig, dpi=150))
    write_text(directory / "report.html", _page(comparison, summary, figures))
    return directory / "report.html"


def _figures(comparison: Comparison) -> dict[str, Figure]:
    turning = (comparison.traces["max_torque_kj_mol_rad"] > 0.0).any()
    return {name: getattr(comparison, f"plot_{name}")() for name in FIGURES if turning or name != "torque"}


def _page(comparison: Comparison, summary: dict[str, Any], figures: dict[str, Figure]) -> str:
    """Render ``report.html``: verdicts, tables, plots, repairs and provenance in one offline file."""
    of_one, rows = len(comparison.solutions) == 1, comparison.table.to_dict("records")
    ends, first = comparison.ends(), comparison.solutions[0]
    quality = comparison.quality.reset_index()
    if comparison.structure.n_protein_residues < _LEAST_OF_TM:
        quality = quality.drop(columns=[name for name in quality if "tm_score" in str(name)])
    subject = f" by {first.method}" if of_one else ": comparison of minimisers"
    return render(
        "report.html",
        title=f"{comparison.structure.name}{subject}",
        structure=comparison.structure,
        solutions=comparison.solutions,
        message=comparison.message,
        shown=short_columns(rows),
        rows=rows,
        lost=loss_lines(summary["results"]),
        rmsd=comparison.rmsd,
        several=not of_one,
        quality=quality,
        changes=totals_of(comparison.differences),
        bonds_changed=concatenate(comparison.differences, "bonds"),
        terms=energies_by_term({row["method"]: row for row in summary["results"]}),
        equal_cost=comparison.equal_cost,
        work=comparison.work,
        spread=comparison.spread,
        figures={name: data_url(figure) for name, figure in figures.items()},
        summary=summary,
        **scene(ends, colourings(ends, first.energy_function, comparison.differences)),
        command=shlex.join(summary["command"]),
    )


def _with_unit(table: pd.DataFrame, first: int, unit: str) -> pd.DataFrame:
    """Table with the unit appended to the names of its columns of methods, from ``first`` on."""
    return table.rename(columns={name: f"{name}_{unit}" for name in table.columns[first:]})
