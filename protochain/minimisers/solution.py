"""The result of a minimisation: a value that can be saved, tabled and written as JSON."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from protochain.arrays import Floats
from protochain.chain import Chain
from protochain.energies.protocol import Energy
from protochain.markup import facts
from protochain.minimisers.methods import IN_TORSIONS
from protochain.minimisers.stages import Hold
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

Watcher = Callable[[dict[str, float], Floats], None]
"""Called with each trace row (without RMSD) and the positions it is about."""


@dataclass
class Recorder:
    """Collects one trace row an iteration; RMSDs are measured afterwards, off the clock."""

    structure: Structure
    watch: Watcher | None = None
    rows: list[dict[str, float]] = field(default_factory=list)
    alphas: list[Floats] = field(default_factory=list)
    started: float = field(default_factory=perf_counter)

    def __call__(self, x: Floats, energy: float, max_torque: float, evaluations: int) -> None:
        """Record a point; the largest torque is not a number where all atoms move."""
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
        """Return the trace with ``TRACE_COLUMNS``."""
        # Only here, when the run is over: it takes longer to import than a small protein to minimise.
        import pandas as pd

        start = self.structure.positions[self.structure.alpha_carbons]
        rows = [
            {**row, "ca_rmsd_angstrom": rmsd_angstrom(alphas, start) if np.isfinite(alphas).all() else np.nan}
            for row, alphas in zip(self.rows, self.alphas, strict=True)
        ]
        return pd.DataFrame(rows, columns=list(TRACE_COLUMNS))


@dataclass(frozen=True, eq=False)
class Solution:
    """Where a minimisation ended, and what the judge says of it.

    Parameters
    ----------
    method : str
    chain : Chain
        The chain at the start.
    energy_function : Energy
        With all terms, whatever the positions.
    constant_terms : mapping of str to int
        Terms and pairs that the run left out, by kind: constant in this chain.
    q : (n_q,) float
        Coordinates at the end (of the chain as it then is, for methods that move single atoms).
    x : (na, 3) float, nm
    energy : float, kJ/mol
        As the engine of the run computes it; ``end.energy`` is the judge's.
    status : Status
    message : str
        The status with the number that shows it.
    n_iterations, n_evaluations : int
    seconds : float
        Wall time of the run, without preparation or judging.
    trace : pandas.DataFrame
        A row an iteration: ``TRACE_COLUMNS``.
    start, end : Judgement
    ca_rmsd_angstrom : float
        From start to end, superposed.
    tolerance : float
    hold : Hold
        What kept it near its start.
    seed : int
    """

    method: str
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
        """The structure at the end."""
        return self.chain.structure.with_positions(self.x)

    @property
    def keeps_geometry(self) -> bool:
        """Whether only hinges turned: bond lengths and angles (but for open ones) are the start's."""
        return self.method in IN_TORSIONS

    @property
    def is_usable(self) -> bool:
        """Whether the end has a finite energy at all."""
        return bool(np.isfinite(self.end.energy))

    def to_scipy(self) -> "OptimizeResult":
        """Return what scipy's minimisers return: ``x`` is q, ``fun`` the judge's energy in kJ/mol."""
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
        """Write the final structure, PDB or mmCIF by suffix, with where it came from.

        Raises
        ------
        StructureError
            If the suffix or the structure does not fit a format.
        """
        save(self.structure, path, self.provenance())

    def provenance(self) -> Iterable[str]:
        """Lines on how the structure was made."""
        e = self.energy_function
        yield f"PROTOCHAIN {version('protochain')}, METHOD {self.method}, STATUS {self.status}"
        yield f"WITH OPENMM {version('openmm')}, GEMMI {version('gemmi')}, PDBFIXER {version('pdbfixer')}"
        yield f"FORCE FIELD {e.forcefield}, SOLVENT {e.solvent}, ENGINE {e.engine}"
        yield f"ENERGY {self.end.energy:.4f} KJ/MOL BEFORE ROUNDING, AT THE START {self.start.energy:.4f}"
        yield "ENERGIES BY THE OPENMM REFERENCE PLATFORM"
        # Which of several conformations this is, the coordinates do not show.
        yield from (line for line in self.chain.structure.repairs if "alternate location" in line)

    def record(self) -> dict[str, Any]:
        """Return the flat record that JSON, CSV and report all show; what is not a number is None."""
        chain, e, s = self.chain, self.energy_function, self.chain.structure
        record: dict[str, Any] = {
            "protochain": version("protochain"),
            "structure": s.name,
            "method": self.method,
            "engine": e.engine,
            "engine_reason": e.reason,
            "forcefield": e.forcefield,
            "solvent": e.solvent,
            "hinges": chain.opened,
            "n_chains": s.n_chains,
            "n_residues": s.n_residues,
            "n_atoms": s.n_atoms,
            "n_bodies": chain.n_bodies,
            "n_hinges": chain.n_hinges,
            "energy_start_kj_mol": self.start.energy,
            "energy_end_kj_mol": self.energy,
            "energy_end_reference_kj_mol": self.end.energy,
            "max_torque_end_kj_mol_rad": self.end.max_torque,
            "rms_force_end_kj_mol_nm": self.end.rms_force,
            "ca_rmsd_angstrom": self.ca_rmsd_angstrom,
            "tolerance": self.tolerance,
            "tolerance_unit": "kJ/mol/rad" if self.keeps_geometry else "kJ/mol/nm",
            "move": chain.move,
            "restraint_kj_mol_nm2": list(self.hold.restraint),
            "max_rmsd_angstrom": self.hold.max_rmsd,
            "iterations": self.n_iterations,
            "evaluations": self.n_evaluations,
            "seconds": self.seconds,
            "status": str(self.status),
            "message": self.message,
            "left_out": dict(s.left_out),
            "constant_terms": dict(self.constant_terms),
            "repairs": list(s.repairs),
            "seed": self.seed,
            "threads": e.threads,
        }
        return {
            key: None if isinstance(value, float) and not np.isfinite(value) else value
            for key, value in record.items()
        }

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
