"""An omission: one answer computed with everything, and with what is not needed left out.

The two are held against each other at several points and timed in turn, by CPU time and the least of many,
so that what else the machine does strikes neither. What was left out is counted from the energy's own lists
and by the calls into the mechanics of trees.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from math import ceil
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from bench.cases import Outcome, within
from bench.cost import cpu_seconds, in_turn
from protochain.core.arrays import Floats
from protochain.core.errors import ProtochainError
from protochain.energies import Energy, energy
from protochain.energies.native import NativeEnergy
from protochain.structure import Structure

SAME = 1e-12
"""Largest error of an answer, relative to the sums that it comes from."""
COUNTS = ("terms", "pairs", "bodies", "sweeps", "lists", "imports")
"""What may be left out: terms of bonds, angles, torsions and exceptions; pairs of atoms that the tiles visit,
once for each pass over them; rigid bodies; calls of the mechanics of trees; entries of lists of close pairs;
modules loaded."""
Answer = tuple[float | Floats, ...]
Call = Callable[[Any], Answer]
Counted = Callable[[], Mapping[str, int]]


@dataclass(frozen=True)
class Both:
    """Two ways to one answer.

    everything, less: Point -> answer.
    points: Where the answers are compared; they are timed at the first.
    sizes: Point -> what the error of each part of the answer is relative to.
    counts: Counts of each way, taken after an evaluation.
    what: What is left out, in words.
    """

    everything: Call
    less: Call
    points: Sequence[Any]
    sizes: Callable[[Any], tuple[float, ...]]
    counts: tuple[Counted, Counted] = (dict, dict)
    what: str = ""


@dataclass(frozen=True, eq=False)
class Material:
    """What omissions are tried on.

    path: File that it came from, which may hold waters.
    """

    structure: Structure
    path: Path | None = None

    @cached_property
    def _energies(self) -> dict[str, NativeEnergy]:
        return {}

    def energy(self, solvent: str) -> NativeEnergy:
        """Native energy on one thread."""
        if solvent not in self._energies:
            self._energies[solvent] = native(energy(self.structure, solvent=solvent, threads=1))
        return self._energies[solvent]


def native(made: Energy) -> NativeEnergy:
    """Energy by native kernels."""
    if not isinstance(made, NativeEnergy):
        raise ProtochainError(f"omissions: needs the native engine, and the energy is by {made.engine}")
    return made


@dataclass(frozen=True)
class Omission:
    """One representative run.

    name, against: What runs, and what "everything" is.
    make: Material -> both ways; None if the material has not what it takes.
    in_quick: Whether ``--quick`` has it.
    """

    name: str
    against: str
    make: Callable[[Material], Both | None]
    in_quick: bool = True


@dataclass(frozen=True)
class Row:
    """A line of ``omissions.csv``."""

    scene: str
    against: str
    structure: str
    atoms: int
    verdict: Outcome
    error: float = np.nan
    bound: float = SAME
    proof: str = ""
    everything_ms: float = field(default=np.nan, compare=False)
    left_out_ms: float = field(default=np.nan, compare=False)
    ratio: float = field(default=np.nan, compare=False)
    terms: int = 0
    pairs: int = 0
    bodies: int = 0
    sweeps: int = 0
    lists: int = 0
    imports: int = 0
    message: str = ""


def run_omission(omission: Omission, material: Material, seconds: float) -> Row | None:
    """Compute both ways, compare, count and time; None if the material has not what it takes."""
    named: dict[str, Any] = {
        "scene": omission.name, "against": omission.against, "structure": material.structure.name,
        "atoms": material.structure.n_atoms,
    }  # fmt: skip
    try:
        both = omission.make(material)
        if both is None:
            return None
        error, counted = _compared(both)
        ways = [partial(call, both.points[0]) for call in (both.everything, both.less)]
        # Some in a row, as runs do: after the other call, caches hold what that one used.
        all_of_it, less = in_turn(ways, seconds, min(ceil(1 + seconds), 3), 4, cpu_seconds)
    except Exception as failure:  # whatever it is, the cell is wrong and the others go on
        return Row(**named, verdict=Outcome.WRONG, message=f"{type(failure).__name__}: {failure}")
    proof = "bits" if error == 0.0 else f"{SAME:g} at {len(both.points)} point{'s' * (len(both.points) > 1)}"
    return Row(
        **named, verdict=within(error, SAME), error=error, proof=proof, everything_ms=1e3 * all_of_it.least,
        left_out_ms=1e3 * less.least, ratio=all_of_it.least / less.least, **counted, message=both.what,
    )  # fmt: skip


def difference(a: Answer, b: Answer, sizes: Sequence[float]) -> float:
    """Largest difference of the parts of two answers, each relative to its size; NaN if any is."""
    if [np.shape(part) for part in a] != [np.shape(part) for part in b] or len(a) != len(sizes):
        raise ProtochainError("omissions: answers of different shapes")
    each = [
        float(np.max(np.abs(np.subtract(one, other)), initial=0.0)) / size
        for one, other, size in zip(a, b, sizes, strict=True)
    ]
    return float(np.max(each))


def _compared(both: Both) -> tuple[float, dict[str, Any]]:
    """Largest error at all points; counts of everything minus those with things left out, at the first."""
    first, counted, answers = both.points[0], [], []
    for call, count in zip((both.everything, both.less), both.counts, strict=True):
        # The first call may derive what later ones use again: its sweeps are no part of an evaluation.
        answers.append(call(first))
        sweeps = calls_of("protochain.mechanics.multibody", partial(call, first))
        counted.append({"sweeps": sweeps, **count()})
    errors = [difference(answers[0], answers[1], both.sizes(first))]
    errors += [difference(both.everything(at), both.less(at), both.sizes(at)) for at in both.points[1:]]
    more, fewer = counted
    # Not max of Python, which may pass over NaN.
    return float(np.max(errors)), {name: more.get(name, 0) - fewer.get(name, 0) for name in COUNTS}


def calls_of(package: str, call: Callable[[], object]) -> int:
    """Number of calls into functions of a package from outside it, during a call."""
    found = 0

    def note(frame: FrameType, event: str, _: object) -> None:
        nonlocal found
        if event == "call" and _is_of(frame, package):
            # Functions of modules, not properties.
            inside = frame.f_back is not None and _is_of(frame.f_back, package)
            found += not inside and frame.f_code.co_name in frame.f_globals

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        call()
    finally:
        sys.setprofile(before)
    return found


def _is_of(frame: FrameType, package: str) -> bool:
    return str(frame.f_globals.get("__name__", "")).startswith(package)
