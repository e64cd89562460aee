"""Cases and how they are judged: checks against oracles, extremes, what is left out; a scene is made of them.

A scene is a module with ``run(quick) -> Scene``. :func:`check` holds a value against its oracle,
:func:`extreme` judges a call that may be refused, :func:`left_out` computes one answer twice.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Literal, Protocol, TypeVar

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from bench.cost import Work, in_turn, timed
from protochain.core.arrays import Floats
from protochain.core.errors import Argument, Fault, ProtochainError
from protochain.core.storage import json_text
from protochain.results.figures import Figure, draw_lines
from protochain.results.provenance import made
from protochain.results.tables import save, table_of

Kind = Literal["relative", "absolute"]


class Outcome(StrEnum):
    """How a case ended."""

    RIGHT = "right"
    REFUSED = "refused"
    WRONG = "wrong"


class Bounded(Protocol):
    """What a case found: an error, and the largest that is allowed."""

    @property
    def error(self) -> float:
        """Size of the error; NaN is wrong."""

    @property
    def bound(self) -> float:
        """Largest that is allowed."""


Refusal = Fault | Argument | None
"""What a refusal is about, or an argument that it names; None where an answer is expected."""
_Found = TypeVar("_Found", bound=Bounded)
_Result = TypeVar("_Result")


def within(error: float, bound: float) -> Outcome:
    """Right or wrong, which NaN is, too."""
    return Outcome.RIGHT if error <= bound else Outcome.WRONG


def judged(call: Callable[[], _Found], refusal: Refusal = None) -> tuple[Outcome, _Found | None, str]:
    """Run a case: how it ended, what it found, and the words of a refusal or why else it is wrong.

    A ProtochainError of one line is a refusal, which is right if ``refusal`` is what it is about. Wrong are
    errors above the bound, NaN, a refusal where an answer is expected, an answer or another refusal where
    one is, and exceptions of any other kind.
    """
    try:
        # Extreme numbers overflow on the way; what comes of it is judged. BLAS on one thread, as in runs.
        with np.errstate(all="ignore"), threadpool_limits(1, "blas"):
            found = call()
    except ProtochainError as error:
        said = str(error)
        if refusal is None:
            return Outcome.WRONG, None, f"refused where an answer is expected: {said}"
        if refusal not in (error.fault, *error.args) or len(said.splitlines()) != 1:
            return Outcome.WRONG, None, f"refused, not for {refusal}: {said}"
        return Outcome.REFUSED, None, said
    except Exception as error:  # whatever it is, the case is wrong and the others go on
        return Outcome.WRONG, None, f"{type(error).__name__}: {error}"
    if refusal is not None:
        return Outcome.WRONG, found, f"an answer where a refusal is expected: {refusal}"
    return within(found.error, found.bound), found, ""


@dataclass(frozen=True)
class Check:
    """A value beside what it should be.

    name: What is checked, with its unit if it has one.
    value, oracle: What came out, and what should.
    error, bound: Error and the largest that is allowed; NaN is wrong.
    source: Where the oracle comes from.
    kind: Whether the error is ``relative`` to the oracle or ``absolute``.
    """

    name: str
    value: float
    oracle: float
    error: float
    bound: float
    source: str
    kind: Kind = "relative"

    @property
    def right(self) -> bool:
        """Whether the error is within its bound."""
        return within(self.error, self.bound) is Outcome.RIGHT


@dataclass(frozen=True)
class Extreme:
    """How an extreme case ended.

    name: The case.
    outcome: ``right``, ``refused`` where that is expected, or ``wrong``.
    detail: Error, bound and oracle, or the words of the refusal.
    """

    name: str
    outcome: Outcome
    detail: str

    @property
    def right(self) -> bool:
        """Whether it is not wrong."""
        return self.outcome != Outcome.WRONG


@dataclass(frozen=True)
class LeftOut:
    """Something that the scene does not need, and did not compute.

    what: What is left out.
    ratio: How many times as long it takes with it.
    difference, bound: How much the answer differs, and by how much it may.
    """

    what: str
    ratio: float
    difference: float
    bound: float

    @property
    def right(self) -> bool:
        """Whether the answer is the same, within the bound."""
        return within(self.difference, self.bound) is Outcome.RIGHT


@dataclass(frozen=True, eq=False)
class Scene:
    """What a scene has found.

    name, title: Name, as in the command, and one line on what it is.
    checks: Values against oracles.
    work: Columns ``method``, ``setting``, ``seconds`` and ``error``: :func:`work_table`.
    extremes: Stiff and extreme cases.
    left_out: What was not computed.
    tables: More tables by name, for notebooks: traces, sweeps.
    error_of: What the error of ``work`` is, with its unit: the axis of the picture.
    """

    name: str
    title: str
    checks: tuple[Check, ...]
    work: pd.DataFrame
    extremes: tuple[Extreme, ...] = ()
    left_out: tuple[LeftOut, ...] = ()
    tables: Mapping[str, pd.DataFrame] = field(default_factory=dict)
    error_of: str = "relative error"

    @property
    def wrong(self) -> tuple[str, ...]:
        """Names of the checks, extremes and answers with something left out that are wrong."""
        return (
            *(each.name for each in self.checks if not each.right),
            *(each.name for each in self.extremes if not each.right),
            *(each.what for each in self.left_out if not each.right),
        )

    def frames(self) -> dict[str, pd.DataFrame]:
        """All tables by the names of their files: checks, work, extremes, left_out, and the scene's own."""
        checks, left_out = table_of(self.checks, Check), table_of(self.left_out, LeftOut)
        for table, rows in ((checks, self.checks), (left_out, self.left_out)):
            table["verdict"] = ["right" if row.right else "wrong" for row in rows]
        own = {"checks": checks, "work": self.work, "extremes": table_of(self.extremes, Extreme)}
        return {**own, "left_out": left_out, **self.tables}


def plot_work(scene: Scene) -> Figure:
    """Draw error against seconds, a line for each method."""
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    ax = figure.subplots()
    draw_lines(ax, scene.work, "seconds", least=1e-17)
    ax.set(xlabel="processor seconds", ylabel=scene.error_of, title=scene.title)
    return figure


def write(scene: Scene, folder: Path) -> dict[str, str]:
    """Write the tables of a scene, ``work.png`` and ``made.json`` to a folder; return what is in the last."""
    record = made("1", ("numpy", "scipy", "numba"))
    tables = {f"{name}.csv": table for name, table in scene.frames().items()}
    save(folder, {**tables, "work.png": plot_work(scene), "made.json": json_text(record)})
    return record


def check(
    name: str, value: float, oracle: float, bound: float, source: str, kind: Kind = "relative"
) -> Check:
    """Hold a value against its oracle: the parts of a :class:`Check`, but its error.

    A relative one of an oracle of zero is infinite, or zero if the value is, too.
    """
    error = abs(float(value) - float(oracle))
    if kind == "relative" and error != 0.0:
        error = error / abs(float(oracle)) if oracle != 0.0 else np.inf
    return Check(name, float(value), float(oracle), float(error), float(bound), source, kind)


def vanishes(name: str, error: float, bound: float, source: str) -> Check:
    """Hold an error, by its size, against nothing: :func:`check` of zero, absolute."""
    return check(name, error, 0.0, bound, source, "absolute")


def extreme(name: str, call: Callable[[], Check], refusal: Refusal = None) -> Extreme:
    """Run an extreme case, as :func:`judged` does; with error, bound and source of an answer."""
    outcome, found, said = judged(call, refusal)
    told = f"{found.kind} error {found.error:.3g}, bound {found.bound:.3g}: {found.source}" if found else ""
    return Extreme(name, outcome, "; ".join(filter(None, (said, told))))


def tried(
    method: str,
    setting: str,
    call: Callable[[], _Result],
    error: Callable[[_Result], float],
    repeats: int = 1,
) -> Work:
    """Time a setting of a method, by the least of some repeats: a point of error against run time.

    ``error`` is of the result; where the call is refused it is infinite, and there is no time.
    """
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            found, seconds = timed(call, repeats)
    except ProtochainError:
        return method, setting, np.nan, np.inf
    return method, setting, seconds, float(error(found))


def left_out(
    what: str,
    everything: Callable[[], Floats | float],
    less: Callable[[], Floats | float],
    bound: float,
    repeats: int = 3,
) -> LeftOut:
    """Compute an answer, a number or an array, with everything and with less: both in turn, so many times.

    The difference is relative to the largest number of the answer, and infinite if shapes differ; of times
    the least count.
    """
    full, short = in_turn((everything, less), turns=repeats)
    a, b, ratio = np.asarray(full.result, float), np.asarray(short.result, float), full.least / short.least
    if a.shape != b.shape:
        return LeftOut(what, ratio, np.inf, bound)
    difference = float(np.max(np.abs(a - b), initial=0.0))
    size = float(np.max(np.abs(a), initial=0.0))
    return LeftOut(what, ratio, difference / size if difference != 0.0 else 0.0, bound)
