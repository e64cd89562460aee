"""A scene: one answer computed with everything, and with what is not needed left out.

The two are held against each other at several points and timed in turn, by CPU time and the least of many,
so that what else the machine does strikes neither. What was left out is counted from the energy's own lists
and by the calls into the mechanics of trees.
"""

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from time import perf_counter, process_time
from types import FrameType
from typing import Any

import numpy as np

from protochain.arrays import Floats
from protochain.energies import Energy, energy
from protochain.energies.native import NativeEnergy
from protochain.errors import ProtochainError
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

    Parameters
    ----------
    everything, less : callable
        Point -> answer.
    points : sequence
        Where the answers are compared; they are timed at the first.
    sizes : callable
        Point -> what the error of each part of the answer is relative to.
    counts : tuple of callables, optional
        Counts of each way, taken after an evaluation.
    what : str
        What is left out, in words.
    """

    everything: Call
    less: Call
    points: Sequence[Any]
    sizes: Callable[[Any], tuple[float, ...]]
    counts: tuple[Counted, Counted] = (dict, dict)
    what: str = ""


@dataclass(frozen=True, eq=False)
class Material:
    """What scenes are made of.

    Parameters
    ----------
    structure : Structure
    path : Path, optional
        File that it came from, which may hold waters.
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
    """Energy by native kernels.

    Raises
    ------
    ProtochainError
        If another engine was chosen for it.
    """
    if not isinstance(made, NativeEnergy):
        raise ProtochainError(f"scenes: needs the native engine, and the energy is by {made.engine}")
    return made


@dataclass(frozen=True)
class Scene:
    """One representative run.

    Parameters
    ----------
    name, against : str
        What runs, and what "everything" is.
    make : callable
        Material -> both ways; None if the material has not what the scene needs.
    in_quick : bool
        Whether ``--quick`` has it.
    """

    name: str
    against: str
    make: Callable[[Material], Both | None]
    in_quick: bool = True


@dataclass(frozen=True)
class Row:
    """Result of a scene: a line of ``scenes.csv``."""

    scene: str
    against: str
    structure: str
    atoms: int
    verdict: str
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


def run_scene(scene: Scene, material: Material, seconds: float) -> Row | None:
    """Compute both ways, compare, count and time; None if the material has not what the scene needs."""
    named: dict[str, Any] = {
        "scene": scene.name, "against": scene.against, "structure": material.structure.name,
        "atoms": material.structure.n_atoms,
    }  # fmt: skip
    try:
        both = scene.make(material)
        if both is None:
            return None
        error, counted = _compared(both)
        counts: dict[str, Any] = dict(counted)
        times = least([lambda: both.everything(both.points[0]), lambda: both.less(both.points[0])], seconds)
    except Exception as failure:  # whatever it is, the cell is wrong and the others go on
        return Row(**named, verdict="wrong", message=f"{type(failure).__name__}: {failure}")
    everything, less = (1e3 * taken for taken in times)
    # Not "error > bound": NaN is wrong.
    verdict = "right" if error <= SAME else "wrong"
    proof = "bits" if error == 0.0 else f"{SAME:g} at {len(both.points)} point{'s' * (len(both.points) > 1)}"
    return Row(
        **named, verdict=verdict, error=error, proof=proof, everything_ms=everything, left_out_ms=less,
        ratio=everything / less, **counts, message=both.what,
    )  # fmt: skip


def difference(a: Answer, b: Answer, sizes: Sequence[float]) -> float:
    """Largest difference of the parts of two answers, each relative to its size; NaN if any is.

    Raises
    ------
    ProtochainError
        If the answers have not the same shapes.
    """
    if [np.shape(part) for part in a] != [np.shape(part) for part in b] or len(a) != len(sizes):
        raise ProtochainError("scenes: answers of different shapes")
    each = [
        float(np.max(np.abs(np.subtract(one, other)), initial=0.0)) / size
        for one, other, size in zip(a, b, sizes, strict=True)
    ]
    return float(np.max(each))


_IN_A_ROW, _SHORT = 4, 0.1
"""Calls in a row, if they take less than so many seconds."""


def least(calls: Sequence[Callable[[], object]], seconds: float) -> list[float]:
    """Least CPU time of each call in s, taken in turn for so many seconds, or up to three times."""
    best, turns, began = [np.inf] * len(calls), 0, perf_counter()
    while turns < min(1 + seconds, 3) or perf_counter() - began < seconds:
        for i, call in enumerate(calls):
            # Some in a row, as runs do: after the other call, caches hold what that one used.
            for _ in range(_IN_A_ROW if best[i] < _SHORT else 1):
                start = cpu_seconds()
                call()
                best[i] = min(best[i], cpu_seconds() - start)
        turns += 1
    return best


def cpu_seconds() -> float:
    """CPU time of this process and of those that it has waited for."""
    spent = os.times()
    return process_time() + spent.children_user + spent.children_system


def _compared(both: Both) -> tuple[float, dict[str, int]]:
    """Largest error at all points; counts of everything minus those with things left out, at the first."""
    first, counted, answers = both.points[0], [], []
    for call, count in zip((both.everything, both.less), both.counts, strict=True):
        # The first call may derive what later ones use again: its sweeps are no part of an evaluation.
        answers.append(call(first))
        sweeps = calls_of("protochain.multibody", partial(call, first))
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
