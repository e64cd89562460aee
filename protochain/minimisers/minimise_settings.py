"""Settings of a minimisation and of many starts, as calls, commands and batches share them."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from protochain.core import defaults
from protochain.core.checks import anything, at_least, flag, in_range, number, one_of, optional, path
from protochain.core.errors import Angle, Argument, ProtochainError, refusal
from protochain.core.settings import Settings, setting

JUDGES = (defaults.JUDGE, "reference")
"""Judges: our kernels if they support the energy, or always OpenMM's Reference platform."""
TOLERANCE = optional(in_range(number, lambda force: 0 < force <= 1e6, "give a number above 0, at most 1e6"))
"""Check of a tolerance. A bond 2 nm too long pulls by 1e6 kJ/mol/nm. Above this, any start has converged."""


def _not_empty(values: str | list[str]) -> str | tuple[str, ...]:
    """Return the text of a cell, or the values of an option, or the only one."""
    values = [values] if isinstance(values, str) else values
    if not all(value.strip() for value in values):
        raise refusal("restraints", "''", "give strengths, a restraint or a file, or omit it")
    return values[0] if len(values) == 1 else tuple(values)


@dataclass(frozen=True, kw_only=True)
class MinimiseSettings(Settings):
    """Limits and restraints of a minimisation. :func:`protochain.minimise` explains them."""

    tolerance: float | None = setting(
        None,
        "RMS force at convergence if all atoms move [default: 5 kJ/mol/nm, 1 with --starts], "
        "or largest torque [default: 1 kJ/mol/rad].",
        TOLERANCE,
        float,
        doc="Largest torque (kJ/mol/rad) or, if all atoms move, RMS force (kJ/mol/nm) at convergence, "
        "recomputed in double precision. Default: 1 kJ/mol/rad, or 5 kJ/mol/nm. The latter ends nearer to "
        "the start than 1, and 0.5 to 1.6 kJ/mol per residue above the minimum.",
    )
    max_evaluations: int = setting(
        defaults.MAX_EVALUATIONS, "Limit of energy evaluations of each method.", at_least(1), int
    )
    seed: int = setting(
        defaults.SEED, "Seed of stochastic methods.", at_least(0), int,
        doc="Seed of ``anneal`` and ``openmm-md``. The other methods use no random numbers.",
    )  # fmt: skip
    restraints: Any = setting(
        "",
        "Successive springs to the start, kJ/mol/nm^2: '1000 100 0', or a restraint, as 'distance A:3:CA "
        "A:9:CA 0 6 1000', or a file of restraints. Repeat for more.",
        anything,
        list[str],
        option="--restraints --restrain",
        read=_not_empty,
        metavar="K...|LINE|FILE",
        type="float, sequence of float (kJ/mol/nm^2), or callable",
        doc="Springs from the heavy atoms to their initial positions: successive strengths, each until "
        "convergence. A final 0 releases them. A callable maps positions to energy and forces, like "
        "``energy``.",
    )
    max_rmsd: float = setting(math.inf, "Largest C-alpha RMSD to the start, angstrom.", number, float)
    curvature: bool | None = setting(
        None,
        "Whether to leave saddle points [default: in torsions, and in all atoms at tolerances up to 1].",
        optional(flag),
        bool,
        "--curvature/--no-curvature",
        doc="Whether to compute, at the end, the lowest eigenvalue of the Hessian in the moving degrees of "
        "freedom, and to continue from a saddle point (:mod:`protochain.minimisers.saddle`), at 10 to 40 "
        "evaluations. Default: if only hinges turn, and in all atoms at tolerances up to 1 kJ/mol/nm, "
        "except for methods of OpenMM.",
    )
    judge: str = setting(
        defaults.JUDGE,
        "Energies of start and end: auto (native engine, all pairs in double precision) or reference "
        "(OpenMM's Reference platform).",
        one_of(JUDGES),
        doc="Evaluation of start and end: ``reference`` (OpenMM's Reference platform), or ``auto``, the "
        "native engine with all pairs in double precision, or that platform if unsupported.",
    )


@dataclass(frozen=True, kw_only=True)
class CheckpointSettings(Settings):
    """Files of the state of a run, to continue it."""

    checkpoint: str | Path | None = setting(
        None, "File for the state at the end, .npz.", optional(path), Path, type="path-like, optional",
        doc="File (.npz) to write when the run ends, for ``resume``. A warning reports the reason if it "
        "cannot be written.",
    )  # fmt: skip
    resume: str | Path | None = setting(
        None, "Continue from a checkpoint.", optional(path), Path, type="path-like, optional",
        doc="Continue from a checkpoint of a run with the same settings. Counts of evaluations continue, and "
        "steps are bitwise equal to an uninterrupted run.",
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class StartSettings(Settings):
    """Settings of many starts. :func:`protochain.explore` explains them."""

    n_starts: int = setting(
        1,
        "Number of starts with randomly perturbed dihedrals. The best end is written.",
        at_least(1),
        int,
        "--starts",
    )
    spread: float = setting(
        defaults.SPREAD,
        f"Standard deviation of a perturbation, degrees [default: {math.degrees(defaults.SPREAD):.1f}].",
        number,
        float,
        read=math.radians,
        doc="Standard deviation of the perturbation of every hinge, rad.",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.spread < math.inf:
            raise ProtochainError(Argument("spread"), " ", Angle(self.spread), ": give an angle above 0")
        if self.n_starts == 1 and self.spread != defaults.SPREAD:
            remedy = "; give ", Argument("n_starts"), " 2 or more, or omit it"
            raise ProtochainError(Argument("spread"), ": applies to several starts only", *remedy)
