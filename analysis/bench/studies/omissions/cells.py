"""An omission: one answer computed with everything, and with what is not needed left out.

The two are held against each other at several points and timed in turn, by CPU time and the least of many,
so that what else the machine does strikes neither. What was left out is counted from the energy's own lists
and by the calls into the mechanics of trees.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import ceil
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from bench.cases import Found, judged, left_out
from bench.cost import cpu_seconds
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
class TwoWays:
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
    make: Callable[[Material], TwoWays | None]
    in_quick: bool = True


COLUMNS = (
    "scene", "against", "structure", "atoms", "verdict", "error", "bound", "proof", "everything_ms",
    "left_out_ms", "ratio", *COUNTS, "message",
)  # fmt: skip
"""Of ``omissions.csv``."""


def run_omission(omission: Omission, material: Material, seconds: float) -> Found | None:
    """Compute both ways, compare, count and time; None if the material has not what it takes."""
    made: list[TwoWays | None] = []

    def case() -> Found:
        made.append(omission.make(material))
        return _compared(made[0], seconds) if made[0] else Found()

    found = judged(omission.name, case)
    if made == [None]:
        return None
    more = {
        "scene": omission.name, "against": omission.against, "structure": material.structure.name,
        "atoms": material.structure.n_atoms, "proof": found.source, "everything_ms": 1e3 * found.whole,
        "left_out_ms": 1e3 * found.seconds, **dict.fromkeys(COUNTS, 0), **found.more,
    }  # fmt: skip
    return replace(found, bound=SAME, more=more)


def difference(a: Answer, b: Answer, sizes: Sequence[float]) -> float:
    """Largest difference of the parts of two answers, each relative to its size; NaN if any is."""
    if [np.shape(part) for part in a] != [np.shape(part) for part in b] or len(a) != len(sizes):
        raise ProtochainError("omissions: answers of different shapes")
    each = [
        float(np.max(np.abs(np.subtract(one, other)), initial=0.0)) / size
        for one, other, size in zip(a, b, sizes, strict=True)
    ]
    return float(np.max(each))


def _compared(both: TwoWays, seconds: float) -> Found:
    """Largest error at all points; counts of everything minus those with things left out, at the first."""
    first, counted, answers = both.points[0], [], []
    for call, count in zip((both.everything, both.less), both.counts, strict=True):
        # The first call may derive what later ones use again: its sweeps are no part of an evaluation.
        answers.append(call(first))
        sweeps = calls_of("protochain.mechanics.multibody", partial(call, first))
        counted.append({"sweeps": sweeps, **count()})
    errors = [difference(answers[0], answers[1], both.sizes(first))]
    errors += [difference(both.everything(at), both.less(at), both.sizes(at)) for at in both.points[1:]]
    # Not max of Python, which may pass over NaN.
    error = float(np.max(errors))
    # Some in a row, as runs do: after the other call, caches hold what that one used.
    found = left_out(
        "", partial(both.everything, first), partial(both.less, first), SAME,
        min(ceil(1 + seconds), 3), lambda *_: error, seconds, 4, cpu_seconds,
    )  # fmt: skip
    proof = "bits" if error == 0.0 else f"{SAME:g} at {len(both.points)} point{'s' * (len(both.points) > 1)}"
    more, fewer = counted
    counts = {name: more.get(name, 0) - fewer.get(name, 0) for name in COUNTS}
    return replace(found, source=proof, message=both.what, more=counts)


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
