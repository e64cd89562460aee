"""Result of a minimisation: final structure, trace, and a record for tables and JSON."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from protochain.arrays import Floats, Watcher
from protochain.chain import Chain
from protochain.energies.protocol import Energy
from protochain.markup import facts
from protochain.minimisers.recipes import Recipe
from protochain.minimisers.record import record
from protochain.minimisers.restraints import Hold
from protochain.minimisers.verdict import Judgement, Status
from protochain.structure import Structure, save
from protochain.structure.superpose import rmsd_angstrom

if TYPE_CHECKING:
    import pandas as pd
    from scipy.optimize import OptimizeResult

TRACE_COLUMNS = (
    "iteration",
    "evaluations",
    "seconds",
    "energy_kj_mol",
    "max_torque_kj_mol_rad",
    "ca_rmsd_angstrom",
)


@dataclass
class Recorder:
    """Collect a trace row at each iteration; RMSDs are computed after the clock has stopped."""

    structure: Structure
    watch: Watcher | None = None
    rows: list[dict[str, float]] = field(default_factory=list)
    alphas: list[Floats] = field(default_factory=list)
    started: float = field(default_factory=perf_counter)

    def __call__(self, x: Floats, energy: float, max_torque: float, evaluations: int) -> None:
        """Record a point; the largest torque is NaN where all atoms move."""
        row = {
            "iteration": len(self.rows),
            "evaluations": evaluations,
            "seconds": perf_counter() - self.started,
            "energy_kj_mol": energy,
            "max_torque_kj_mol_rad": max_torque,
        }
        self.rows.append(row)
        self.alphas.append(x[self.structure.alpha_carbons])
        if self.watch:
            self.watch(row, x)

    def trace(self) -> "pd.DataFrame":
        """Trace, with the columns ``TRACE_COLUMNS``."""
        # Imported after the run: the import takes longer than minimising a small protein.
        import pandas as pd

        start = self.structure.positions[self.structure.alpha_carbons]
        rows = [
            {**row, "ca_rmsd_angstrom": rmsd_angstrom(alphas, start) if np.isfinite(alphas).all() else np.nan}
            for row, alphas in zip(self.rows, self.alphas, strict=True)
        ]
        return pd.DataFrame(rows, columns=list(TRACE_COLUMNS))


@dataclass(frozen=True, eq=False)
class Solution:
    """Result of a minimisation, judged in double precision.

    Parameters
    ----------
    recipe : Recipe
        The method.
    chain : Chain
        Chain at the start.
    energy_function : Energy
        With all terms.
    constant_terms : mapping of str to int
        Numbers, by kind, of terms and pairs left out of the run because they are constant in this chain.
    q : (n_q,) float
        Coordinates at the end; those of the chain rebuilt there if all atoms moved.
    x : (na, 3) float, nm
        Positions at the end.
    energy : float, kJ/mol
        By the engine of the run; ``end.energy`` is the judge's.
    status : Status
        How the run ended, as judged.
    message : str
        Status and residual in words.
    n_iterations, n_evaluations : int
        Iterations, and energy evaluations, of the run.
    seconds : float
        Wall time of the run, without preparation and judgement.
    trace : pandas.DataFrame
        One row per iteration, with columns ``TRACE_COLUMNS``.
    start, end : Judgement
        Energy and residuals in double precision.
    ca_rmsd_angstrom : float
        Between start and end, after superposition.
    tolerance : float
        Residual at convergence.
    hold : Hold
        Restraints to the start.
    seed : int
        Of random methods.
    """

    recipe: Recipe
    chain: Chain
    energy_function: Energy
    constant_terms: Mapping[str, int]
    q: Floats
    x: Floats
    energy: float
    status: Status
    message: str
    n_iterations: int
    n_evaluations: int
    seconds: float
    trace: "pd.DataFrame"
    start: Judgement
    end: Judgement
    ca_rmsd_angstrom: float
    tolerance: float
    hold: Hold
    seed: int

    @property
    def structure(self) -> Structure:
        """Structure at the end."""
        return self.chain.structure.with_positions(self.x)

    @property
    def method(self) -> str:
        """Name of the method."""
        return self.recipe.name

    @property
    def keeps_geometry(self) -> bool:
        """Whether only hinges turned.

        Bond lengths and angles are then untouched, except opened ones and where rings and disulfides close.
        """
        return self.recipe.keeps_geometry

    @property
    def is_usable(self) -> bool:
        """Whether the end has a finite energy."""
        return bool(np.isfinite(self.end.energy))

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
        e = self.energy_function
        yield f"PROTOCHAIN {version('protochain')}, METHOD {self.method}, STATUS {self.status}"
        yield f"WITH OPENMM {version('openmm')}, GEMMI {version('gemmi')}, PDBFIXER {version('pdbfixer')}"
        yield f"FORCE FIELD {e.forcefield}, SOLVENT {e.solvent}, ENGINE {e.engine}"
        yield f"ENERGY {self.end.energy:.4f} KJ/MOL BEFORE ROUNDING, AT THE START {self.start.energy:.4f}"
        yield "ENERGIES BY THE OPENMM REFERENCE PLATFORM"
        # Coordinates alone do not tell which alternate location was kept.
        yield from (line for line in self.chain.structure.repairs if "alternate location" in line)

    def record(self) -> dict[str, Any]:
        """Flat record behind JSON, CSV and pages; None where a value is not finite."""
        return record(self)

    def __repr__(self) -> str:
        return (
            f"<Solution {self.method}: {self.status}, "
            f"{self.start.energy:.2f} -> {self.end.energy:.2f} kJ/mol, "
            f"{self.n_evaluations} evaluations, C-alpha RMSD {self.ca_rmsd_angstrom:.3f} angstrom>"
        )

    def _repr_html_(self) -> str:
        return facts(
            f"{self.chain.structure.name} by {self.method}",
            {
                "status": self.message,
                "energy": f"{self.start.energy:.2f} to {self.end.energy:.2f} kJ/mol",
                "largest torque": f"{self.start.max_torque:.3g} to {self.end.max_torque:.3g} kJ/mol/rad",
                "RMS force": f"{self.start.rms_force:.3g} to {self.end.rms_force:.3g} kJ/mol/nm",
                "C-alpha RMSD to the start": f"{self.ca_rmsd_angstrom:.3f} angstrom",
                "work": f"{self.n_evaluations} evaluations, {self.seconds:.2f} s",
            },
        )
