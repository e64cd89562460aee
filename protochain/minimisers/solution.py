"""Result of a minimisation: final structure, trace, and a record for tables and JSON."""

import warnings
from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from protochain.chains.chain import Chain
from protochain.chains.frame import Frame
from protochain.chains.restraint_list import RestraintValue, ViolationsAtEnd
from protochain.core.arrays import Floats, Integers, Value, Watcher, read_only
from protochain.core.errors import StrayWarning
from protochain.core.lazy_pandas import pd
from protochain.core.markup import facts
from protochain.core.settings import document_fields
from protochain.energies.decomposed import terms_at
from protochain.energies.protocol import Energy
from protochain.minimisers.recipes import Recipe
from protochain.minimisers.record import COLUMNS
from protochain.minimisers.restraints import Hold
from protochain.minimisers.start_warnings import describe_rmsd
from protochain.minimisers.verdict import Judgement, Status
from protochain.results.columns import record
from protochain.results.provenance import remarks
from protochain.structure import Structure, save
from protochain.structure.superpose import displacements, rmsd_angstrom
from protochain.validation import measures
from protochain.validation.findings import remains
from protochain.validation.ligands import describe_motion, ligand_motion, sdf_properties

if TYPE_CHECKING:
    from scipy.optimize import OptimizeResult

N_FRAMES = 50  # Number of stored positions of a run, so that memory does not grow with it.

SIZES = ("rms_torque_kj_mol_rad", "max_torque_kj_mol_rad", "rms_force_kj_mol_nm", "max_force_kj_mol_nm")
"""Torques if hinges turn, or forces if all atoms move, restraints included. The others are missing."""
TRACE_COLUMNS = ("iteration", "evaluations", "seconds", "energy_kj_mol", *SIZES, "ca_rmsd_angstrom")


def alpha_residues(structure: Structure) -> "pd.DataFrame":
    """Chain, residue (number and insertion code) and name of each C-alpha."""
    at = structure.atom_residue[structure.alpha_carbons]
    number = np.char.add(structure.residue_number[at], structure.residue_insertion_code[at])
    columns = {"chain": structure.residue_chain[at], "residue": number, "name": structure.residue_name[at]}
    return pd.DataFrame(columns)


@dataclass
class Recorder:
    """Collect a trace row at each iteration. RMSDs and superpositions are computed when they are read."""

    structure: Structure
    frame: Frame
    watch: Watcher | None = None
    rows: list[dict[str, float]] = field(default_factory=list)
    frames: dict[int, Floats] = field(default_factory=dict)
    interval: int = 1
    last: Floats | None = None
    alphas: list[Floats] = field(default_factory=list)
    started: float = field(default_factory=perf_counter)

    def __call__(self, x: Floats, energy: float, sizes: Mapping[str, float], evaluations: int) -> None:
        """Record a point, with the sizes of its torques or forces. The others are NaN."""
        row = {
            "iteration": len(self.rows),
            "evaluations": evaluations,
            "seconds": perf_counter() - self.started,
            "energy_kj_mol": energy,
            **{name: sizes.get(name, np.nan) for name in SIZES},
        }
        self.rows.append(row)
        self.alphas.append(x[self.structure.alpha_carbons])
        self._frame(len(self.rows) - 1, x)
        if self.watch:
            # The command line's watcher needs none: superposition would cost a tenth of a short run.
            needs_positions = getattr(self.watch, "wants_positions", True)
            self.watch(row, self.frame(x) if needs_positions else x)

    def at_stage(self, name: str, evaluations: int) -> None:
        """Report the stage to the watcher's method ``at_stage``, if it has one, recorded or not."""
        if callback := getattr(self.watch, "at_stage", None):
            callback(name, evaluations)

    def warn(self, line: str) -> None:
        """Report an urgent message to the watcher's method ``at_warning``, or issue a warning."""
        if callback := getattr(self.watch, "at_warning", None):
            callback(line)
        else:
            warnings.warn(line, StrayWarning, stacklevel=2)

    def _frame(self, row: int, x: Floats) -> None:
        """Store the positions of every n-th row, fewer as the run grows longer, and of the last row."""
        self.last = x
        if row % self.interval == 0:
            self.frames[row] = x
        if len(self.frames) > N_FRAMES:
            self.interval *= 2
            self.frames = {k: positions for k, positions in self.frames.items() if k % self.interval == 0}

    def recorded_frames(self) -> dict[int, Floats]:
        """Positions by their row of the trace, including the last, as the run went."""
        return self.frames if self.last is None else self.frames | {len(self.rows) - 1: self.last}


def frames_of(frame: Frame, frames: Iterable[Floats]) -> NDArray[np.float32]:
    """Positions (n, na, 3) in the frame of results."""
    return read_only([frame(x) for x in frames], np.float32)


def trace_of(structure: Structure, rows: list[dict[str, float]], alphas: list[Floats]) -> "pd.DataFrame":
    """Trace of recorded rows and their C-alphas, with the columns ``TRACE_COLUMNS``."""
    # Imported on use: the import is slower than minimising a small protein.
    start = structure.positions[structure.alpha_carbons]
    full = [
        {**row, "ca_rmsd_angstrom": rmsd_angstrom(x, start) if np.isfinite(x).all() else np.nan}
        for row, x in zip(rows, alphas, strict=True)
    ]
    return pd.DataFrame(full, columns=list(TRACE_COLUMNS))


class _LazyField:
    """Field whose value may be a function, which is called on first access."""

    def __init__(self, default: Callable[[], Any] | None = None) -> None:
        self.default = default

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, instance: Any, owner: type | None = None) -> Any:
        if instance is None and self.default is None:
            raise AttributeError(self.name)  # For the dataclass: a field without default.
        if instance is None:
            return self.default
        value = vars(instance)[self.name]
        if callable(value):
            value = vars(instance)[self.name] = value()
        return value

    def __set__(self, instance: Any, value: Any) -> None:
        vars(instance)[self.name] = value


class RunEnds(ViolationsAtEnd, Value):
    """Base of results of runs: terms and measures of start and end, and the motion between them."""

    energy_function: Energy
    frame: Frame
    x: Floats

    @property
    @abstractmethod
    def _structure_at_start(self) -> Structure:
        """Structure at the start."""

    @property
    def terms_start(self) -> dict[str, float]:
        """Energy of each of ``protochain.energies.decomposed.TERMS`` at the start, kJ/mol.

        Empty for a callable, a System that the native engine cannot compute, or over 20,000 atoms.
        """
        return self._terms[1]

    @property
    def terms_end(self) -> dict[str, float]:
        """Energy of each term at the end, kJ/mol."""
        return self._terms[0]

    @cached_property
    def _terms(self) -> tuple[dict[str, float], ...]:
        # The end first: the last evaluation may already have its Born radii.
        start = self._structure_at_start
        return terms_at(self.energy_function, start, self.x, start.positions)

    @cached_property
    def displacements(self) -> "pd.DataFrame":
        """Displacement of each C-alpha from the start, superposed on all C-alphas, a row per residue.

        Columns ``chain``, ``residue`` (number and insertion code), ``name``, ``displacement_angstrom``.
        """
        start = self._structure_at_start
        away = displacements(start, self.x, start.positions)
        return alpha_residues(start).assign(displacement_angstrom=away)

    @cached_property
    def measures_start(self) -> dict[str, Any]:
        """Errors and outliers of the start: :func:`protochain.validation.measures`."""
        return measures(self._structure_at_start)

    @cached_property
    def measures_end(self) -> dict[str, Any]:
        """Errors and outliers of the end."""
        return measures(self._structure_at_start, self.x)

    @cached_property
    def remains_end(self) -> dict[str, list[str]]:
        """Places of remaining problems at the end, by the keys of ``REMAINS``."""
        return remains(self._structure_at_start, self.x)

    @cached_property
    def ligand_motion(self) -> Floats:
        """(n, 2) float, angstrom: RMSD and largest displacement of each ligand, not superposed."""
        return ligand_motion(self.frame.start, self.x)


@document_fields
@dataclass(frozen=True, eq=False)
class Solution(RunEnds):
    """Result of a minimisation, judged in double precision.

    Examples
    --------
    >>> r = pc.minimise("structures/ala10.pdb", method="lbfgs")
    >>> str(r.status), r.end.energy < r.start.energy
    ('converged', True)
    """

    recipe: Recipe  # The method.
    chain: Chain  # Chain at the start.
    energy_function: Energy  # With all terms.
    # Numbers, by kind, of terms and pairs that the run skips because they are constant in this chain.
    constant_terms: Mapping[str, int]
    # (n_q,) float: Coordinates at the end, or of the chain rebuilt there if all atoms moved. Their pose
    # equals ``x`` up to one rigid motion of all atoms.
    q: Floats
    x: Floats  # (na, 3) float, nm: Positions at the end, in the frame of the start.
    energy: float  # kJ/mol: By the engine of the run. ``end.energy`` is the judge's.
    status: Status  # How the run ended, as judged.
    ended: str  # Status and residual in words. ``message`` also reports an end far from the start.
    n_iterations: int  # Iterations of the run.
    n_evaluations: int  # Energy evaluations of the run.
    seconds: float  # Wall time of the run, without preparation and judgement.
    if TYPE_CHECKING:
        # A row per iteration, with columns ``TRACE_COLUMNS``. If hinges turn, RMS and largest torque. If all
        # atoms move, RMS of the forces' components and largest force on an atom (its length). Restraints are
        # included. A run converges by its largest torque or RMS force.
        trace: pd.DataFrame
    else:
        trace: Any = _LazyField()
    start: Judgement  # Energy and residuals at the start, in double precision.
    end: Judgement  # Energy and residuals at the end, in double precision.
    judge: str  # Name of the judge that computed them.
    # Whether ``x`` was superposed on the start, and if not, the reason that fixed the run in space.
    frame: Frame
    ca_rmsd_angstrom: float  # Between start and end, after superposition.
    tolerance: float  # Residual at convergence.
    hold: Hold  # Restraints to the start.
    seed: int  # Of random methods.
    # kJ/mol: Energies at start and end of the restraint at the end, not included in others. None without one.
    restraints: tuple[float, float] | None = None
    # Values and violations of the listed restraints at the end.
    restraint_values: tuple[RestraintValue, ...] = ()
    # s: Wall times by part of the call, which add up to the whole, and ``serial_share_of_loop``: share of the
    # loop on a single thread, None if OpenMM computes.
    timings: Mapping[str, float | None] = field(default_factory=dict)
    # kJ/mol/rad^2 or kJ/mol/nm^2: Of the Hessian at the end, in torsions or in the positions of all atoms.
    # None if not computed.
    lowest_eigenvalue: float | None = None
    # (n,) int: Rows of the trace of ``frames``: equidistant from the first row, and the last row.
    frame_rows: Integers = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    if TYPE_CHECKING:
        # (n, na, 3) float32, nm: Positions at these rows, up to fifty, for ``pc.to_mdtraj(solution,
        # solution.frames)``.
        frames: NDArray[np.float32] = np.empty((0, 0, 3), dtype=np.float32)
    else:
        frames: Any = _LazyField(lambda: np.empty((0, 0, 3), dtype=np.float32))

    @property
    def structure(self) -> Structure:
        """Structure at the end."""
        return self.chain.structure.with_positions(self.x)

    @property
    def _structure_at_start(self) -> Structure:
        return self.chain.structure

    @property
    def ligand_properties(self) -> list[dict[str, str]]:
        """SDF fields of the ligands, as :func:`protochain.save_ligands` writes them."""
        s, energy = self.frame.start, self.end.energy
        return sdf_properties(s, self.x, self.ligand_motion, energy, str(self.status))

    @cached_property
    def message(self) -> str:
        """Status and residual in words, and the distance from the start above 2 angstrom (C-alpha RMSD)."""
        turned = self.frame.start is not self.chain.structure
        far = describe_rmsd(self.ca_rmsd_angstrom, self.recipe, self.frame.start, turned)
        return f"{self.ended}; {far}" if far else self.ended

    @property
    def method(self) -> str:
        """Name of the method."""
        return self.recipe.name

    @property
    def keeps_geometry(self) -> bool:
        """Whether only hinges turned.

        Bond lengths and angles are then constant, except opened ones and at closures of rings and disulfides.
        """
        return self.recipe.keeps_geometry

    @property
    def ca_rmsd_as_filed_angstrom(self) -> float:
        """Between start and end without superposition. It is larger only if the run was fixed in space."""
        return self.frame.ca_rmsds(self.x)[1]

    @property
    def is_usable(self) -> bool:
        """Whether the end has a finite energy, below the start energy unless forces are within tolerance."""
        before, after = self.restraints or (0.0, 0.0)  # They count in the energy that was minimised.
        lower = self.end.energy + after < self.start.energy + before
        improved = self.status in (Status.CONVERGED, Status.VIOLATIONS) or lower
        return bool(np.isfinite(self.end.energy) and improved)

    def to_scipy(self) -> "OptimizeResult":
        """Convert to scipy's result: ``x`` is q, ``fun`` the judge's energy in kJ/mol."""
        from scipy.optimize import OptimizeResult

        result: Any = OptimizeResult()
        result.update(
            x=self.q,
            fun=self.end.energy,
            success=self.status is Status.CONVERGED,
            status=list(Status).index(self.status),
            message=self.message,
            nit=self.n_iterations,
            nfev=self.n_evaluations,
            njev=self.n_evaluations,
        )
        return result

    def save(self, path: str | Path) -> None:
        """Write the final structure with its provenance, as PDB or mmCIF by suffix.

        Raises
        ------
        StructureError
            If the suffix is unknown, or the format cannot hold the structure.
        """
        save(self.structure, path, self.provenance())

    def provenance(self) -> Iterable[str]:
        """Provenance of the structure, as remarks for its file."""
        return remarks(
            self, self.method, (self.start.energy, self.end.energy), self.judge,
            (self.ca_rmsd_angstrom, self.ca_rmsd_as_filed_angstrom),
        )  # fmt: skip

    def record(self, terms: bool = True) -> dict[str, Any]:
        """Flat record for JSON, CSV and pages, with None for values that are not finite.

        Without ``terms`` it lacks the energies of single terms, which take longest.
        """
        return record(COLUMNS, self, terms)

    def ends(self) -> dict[str, Structure]:
        """Structures of start and end, under the keys ``start`` and the method."""
        return {"start": self.chain.structure, self.method: self.structure}

    def __repr__(self) -> str:
        return (
            f"<Solution {self.method}: {self.status}, "
            f"{self.start.energy:.2f} -> {self.end.energy:.2f} kJ/mol, "
            f"{self.n_evaluations} evaluations, "
            f"C-alpha RMSD {self.ca_rmsd_angstrom:.3f} angstrom{describe_motion(self.ligand_motion)}>"
        )

    def _repr_html_(self) -> str:
        return facts(
            f"{self.chain.structure.name} by {self.method}",
            {
                "status": self.message,
                "energy": f"{self.start.energy:.2f} to {self.end.energy:.2f} kJ/mol",
                "largest torque": f"{self.start.max_torque:.3g} to {self.end.max_torque:.3g} kJ/mol/rad",
                "RMS force": f"{self.start.rms_force:.3g} to {self.end.rms_force:.3g} kJ/mol/nm",
                "C-alpha RMSD to the start": (
                    f"{self.ca_rmsd_angstrom:.3f} angstrom{describe_motion(self.ligand_motion)}"
                ),
                "work": f"{self.n_evaluations} evaluations, {self.seconds:.2f} s",
            },
        )
