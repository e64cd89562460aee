"""The same prepared start, several methods, one judge."""

import json
import platform
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from protochain import defaults
from protochain.analysis.deviation import deviation
from protochain.analysis.progress import at_equal_cost, work_to_reach
from protochain.analysis.quality import displacement, quality, ramachandran
from protochain.analysis.spread import spreads
from protochain.articulate import as_chain
from protochain.energies import Energy
from protochain.energies import energy as build_energy
from protochain.errors import ProtochainError
from protochain.interrupts import held_interrupts
from protochain.minimisers import METHODS, Solution, Status, minimise
from protochain.minimisers.api import check_settings
from protochain.minimisers.methods import repeats_exactly
from protochain.minimisers.solution import TRACE_COLUMNS, Watcher
from protochain.structure import Structure, as_structure, ca_rmsd
from protochain.structure.write import common_suffix

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from protochain.analysis.viewer import View

_PACKAGES = (
    "protochain", "openmm", "pdbfixer", "gemmi", "numpy", "scipy", "numba", "mdtraj", "MDAnalysis", "tmtools",
    "pandas",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Comparison:
    """What several methods made of one structure.

    Parameters
    ----------
    structure : Structure
        The common start.
    solutions : tuple of Solution
        One a method, all of one energy function: what tables, plots and files show.
    origin : mapping
        What the caller knows of the input (its path, the seconds its preparation took), for every record.
    native : Structure, optional
        What the ends are measured against besides: an experiment's structure, of a sequence that may differ.
    repeats : tuple of Solution
        Further runs of the methods that do not repeat exactly, for ``spread``.

    Raises
    ------
    ProtochainError
        If the solutions are not of one energy function or one start.
    """

    structure: Structure
    solutions: tuple[Solution, ...]
    origin: Mapping[str, Any] = field(default_factory=dict)
    native: Structure | None = None
    repeats: tuple[Solution, ...] = ()

    def __post_init__(self) -> None:
        runs = self.solutions + self.repeats
        if len({s.energy_function.fingerprint for s in runs}) > 1:
            raise ProtochainError(
                "solutions of different energy functions cannot be compared; run them with one"
            )
        if any(s.chain.structure is not self.structure for s in runs):
            raise ProtochainError("solutions of different starts cannot be compared; run them from one")

    @cached_property
    def table(self) -> pd.DataFrame:
        """A row a method: the columns of the JSON record, lists and counts as text."""
        return pd.DataFrame([{key: flat(value) for key, value in row.items()} for row in self.records()])

    def records(self) -> list[dict[str, Any]]:
        """Return the JSON record of each solution, with its origin and the name of its file."""
        return [
            {**s.record(), **self.origin, "output": f"{self.structure.name}.{s.method}{self.suffix}"}
            for s in self.solutions
        ]

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
        """A row for the start and for every end: what :func:`protochain.analysis.quality.quality` measures.

        With a native structure also ``native_rmsd_angstrom``, ``native_tm_score``, ``native_coverage``.
        """
        rows = {}
        for name, end in self.ends().items():
            rows[name] = quality(end, self.structure, self.solutions[0].chain)
            if self.native is not None:
                off = deviation(self.native, end)
                rows[name] |= {
                    "native_rmsd_angstrom": off.rmsd,
                    "native_tm_score": off.tm_score,
                    "native_coverage": off.match.coverage,
                }
        return pd.DataFrame.from_dict(rows, orient="index").rename_axis("structure")

    @cached_property
    def displacements(self) -> pd.DataFrame:
        """Angstrom each C-alpha went, all superposed on the start: a row a residue, a column a method."""
        alpha = self.structure.alpha_carbons
        residues = self.structure.atom_residue[alpha]
        table = pd.DataFrame(
            {
                "chain": self.structure.residue_chain[residues],
                "residue": np.char.add(
                    self.structure.residue_number[residues], self.structure.residue_insertion_code[residues]
                ),
                "name": self.structure.residue_name[residues],
            }
        )
        for solution in self.solutions:
            table[solution.method] = displacement(solution.structure, self.structure)
        return table

    @cached_property
    def progress(self) -> pd.DataFrame:
        """Lowest energy so far at equal evaluations and at equal seconds."""
        return at_equal_cost(self.traces)

    @cached_property
    def work(self) -> pd.DataFrame:
        """Evaluations and seconds to come near the lowest end of all methods with the same freedoms."""
        lowest = {
            s.method: min(
                other.end.energy
                for other in self.solutions + self.repeats
                if other.keeps_geometry == s.keeps_geometry
            )
            for s in self.solutions
        }
        return work_to_reach(self.traces, lowest)

    @cached_property
    def spread(self) -> pd.DataFrame:
        """A row a method: how far its runs lie apart; one stands for all where they repeat exactly."""
        return spreads(self.solutions, self.repeats)

    def view(self) -> "View":
        """Start and ends, superposed, to turn with the mouse in a notebook; no server is asked."""
        from protochain.analysis.viewer import View

        return View(self.ends())

    def ends(self) -> dict[str, Structure]:
        """Start and end structures, by ``start`` and method."""
        return {"start": self.structure} | {s.method: s.structure for s in self.solutions}

    def plot_energy(self) -> "Figure":
        """Energy against evaluations and seconds; above the lowest of all where clashes make it large."""
        from protochain.analysis.plots import plot_energy

        return plot_energy(self.traces, self.structure.name)

    def plot_work_precision(self) -> "Figure":
        """Energy above the lowest end of the same freedoms, against evaluations and seconds."""
        from protochain.analysis.plots import plot_work_precision

        groups = {
            "torsions only": [s.method for s in self.solutions if s.keeps_geometry],
            "all atoms free": [s.method for s in self.solutions if not s.keeps_geometry],
        }
        return plot_work_precision(self.traces, self.work, groups, self.structure.name)

    def plot_torque(self) -> "Figure":
        """Largest torque against evaluations and seconds, of the methods that turn hinges."""
        from protochain.analysis.plots import plot_torque

        return plot_torque(self.traces, self.structure.name)

    def plot_rmsd(self) -> "Figure":
        """C-alpha RMSD to the start along each run, and between all ends."""
        from protochain.analysis.plots import plot_rmsd

        return plot_rmsd(self.traces, self.rmsd, self.structure.name)

    def plot_displacement(self) -> "Figure":
        """How far each C-alpha went, one line a method."""
        from protochain.analysis.plots import plot_displacement

        return plot_displacement(self.displacements, self.structure.name)

    def plot_ramachandran(self) -> "Figure":
        """Phi and psi of every residue, before and after, over where residues usually have them."""
        from protochain.analysis.plots import plot_ramachandran

        angles = {name: ramachandran(end)[1] for name, end in self.ends().items()}
        return plot_ramachandran(angles, self.structure.name)

    def summary(self) -> dict[str, Any]:
        """Everything a reader needs to trust or repeat it: records, RMSDs, versions, command line."""
        first = self.solutions[0]
        e = first.energy_function
        return {
            "structure": self.structure.name,
            **self.origin,
            "engine_reason": e.reason,
            "system_sha256": e.fingerprint,
            "judge": "OpenMM's Reference platform, in double precision",
            "seed": first.seed,
            "threads": e.threads,
            "command": sys.argv,
            "python": platform.python_version(),
            "versions": {name: version(name) for name in _PACKAGES},
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
            Made if it is not there; files of earlier comparisons in it are replaced.

        Returns
        -------
        Path
            The page.
        """
        from protochain.analysis.report import write_report

        return write_report(self, Path(directory))

    @cached_property
    def suffix(self) -> str:
        """PDB where it can hold all structures, else mmCIF."""
        return common_suffix(self.ends().values())

    def __repr__(self) -> str:
        return f"<Comparison of {', '.join(s.method for s in self.solutions)} on {self.structure.name}>"

    def _repr_html_(self) -> str:
        return self.table[list(SHOWN)].to_html(index=False)


SHOWN = {
    "method": "method",
    "status": "status",
    "energy_start_kj_mol": "energy at start, kJ/mol",
    "energy_end_reference_kj_mol": "energy at end, kJ/mol",
    "max_torque_end_kj_mol_rad": "largest torque, kJ/mol/rad",
    "rms_force_end_kj_mol_nm": "RMS force, kJ/mol/nm",
    "ca_rmsd_angstrom": "C-alpha RMSD, angstrom",
    "evaluations": "evaluations",
    "seconds": "seconds",
}
"""Columns of the short table, and how a person reads them."""


@held_interrupts()
def compare(
    structure: Any,
    methods: Sequence[str] = defaults.COMPARED,
    energy: Energy | None = None,
    tolerance: float = defaults.TOLERANCE,
    max_evaluations: int = defaults.MAX_EVALUATIONS,
    seed: int = defaults.SEED,
    *,
    native: Any = None,
    repeats: int = defaults.REPEATS,
    watch: Callable[[str], Watcher] | None = None,
) -> Comparison:
    """Minimise one structure by several methods from the same prepared start.

    Parameters
    ----------
    structure : Chain, Structure, path, or anything that :func:`protochain.as_structure` takes
    methods : sequence of str
        As in :func:`protochain.minimise`.
    energy : Energy, optional
        One energy function for all methods; default: that of :func:`protochain.energy`.
    tolerance, max_evaluations, seed
        As in :func:`protochain.minimise`.
    native : Structure, path, or anything that :func:`protochain.as_structure` takes, optional
        Measure the ends against it too.
    repeats : int
        Runs of each method that does not repeat exactly (it draws random numbers, or OpenMM sums on several
        threads), with seeds that follow; the first is shown, all are in ``Comparison.spread``.
    watch : callable, optional
        Given a method's name, returns the watcher of its run.

    Returns
    -------
    Comparison
        Every end point judged by the OpenMM Reference platform in double precision. An interrupt ends
        the run it meets and leaves out those after it.

    Raises
    ------
    ProtochainError
        If a method is unknown or the input cannot be used.
    """
    chosen = tuple(dict.fromkeys(methods))
    if not chosen:
        raise ProtochainError(f"no methods to compare; choose from {', '.join(METHODS)}")
    if repeats < 1:
        raise ProtochainError(f"repeats {repeats}: give at least 1")
    for method in chosen:
        check_settings(method, tolerance, max_evaluations)
    chain = as_chain(structure)
    known = None if native is None else as_structure(native)
    if energy is None:
        energy = build_energy(chain.structure)
    plan = [
        (method, k) for method in chosen for k in range(1 if repeats_exactly(method, energy) else repeats)
    ]
    solutions: dict[tuple[str, int], Solution] = {}
    for method, k in plan:
        watcher = watch(method) if watch else None
        try:
            solution = minimise(chain, energy, method, tolerance, max_evaluations, seed + k, watch=watcher)
        except KeyboardInterrupt:
            if not solutions:
                raise
            break
        interrupted = solution.status is Status.INTERRUPTED
        if not (interrupted and k):
            solutions[method, k] = solution
        if interrupted:
            break
    return Comparison(
        chain.structure,
        tuple(s for (_, k), s in solutions.items() if k == 0),
        native=known,
        repeats=tuple(s for (_, k), s in solutions.items() if k > 0),
    )


def flat(value: Any) -> Any:
    """Return a value of a record as a cell of a table: lists and counts as text."""
    if isinstance(value, dict):
        return "; ".join(f"{count} {name}" for name, count in value.items())
    return "; ".join(map(str, value)) if isinstance(value, list) else value


def _as_json(table: pd.DataFrame, orient: Any) -> Any:
    """Return a table as JSON has it, what is not a number as None."""
    return json.loads(table.to_json(orient=orient, double_precision=15))
