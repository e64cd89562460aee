"""Claims and how they are judged, points of error against time, and the tables of both.

A case is a call that returns a :class:`Found`, made by :func:`check` or :func:`vanishes`, or is refused;
:func:`judged` runs it. :func:`left_out` computes one answer twice, :func:`tried` gives a :class:`Point`.
Scenes and studies differ in what they try, not in what they find.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, Literal, TypeVar

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from bench.cost import in_turn, timed
from bench.lines import draw_lines
from bench.page import Section, write_report
from bench.provenance import made
from protochain.core.arrays import Floats
from protochain.core.errors import Argument, Fault, ProtochainError
from protochain.core.storage import json_text
from protochain.results.figures import Figure, outside
from protochain.results.tables import save

Kind = Literal["relative", "absolute", ""]
"""Of an error; none where it has a unit or measure of its own."""
Refusal = Fault | Argument | None
"""What a refusal is about, or an argument that it names; None where an answer is expected."""
_Result = TypeVar("_Result")


class Outcome(StrEnum):
    """How a case ended."""

    RIGHT = "right"
    REFUSED = "refused"
    WRONG = "wrong"


@dataclass(frozen=True)
class Found:
    """A claim, and how it ended.

    error, bound: Error and the largest that is allowed; NaN is wrong, and the bound of what has no answer.
    source: What the answer was held against.
    message: Anything else worth a line; the words of a refusal.
    name: What is claimed, with its unit if it has one.
    value, oracle: What came out, and what should.
    kind: Whether the error is ``relative`` to the oracle or ``absolute``.
    outcome: How it ended, where error and bound do not decide that.
    seconds, whole: Seconds that it took, and with what is left out of it.
    more: Other columns of its table, by name.
    """

    error: float = np.nan
    bound: float = np.nan
    source: str = ""
    message: str = ""
    name: str = ""
    value: float = np.nan
    oracle: float = np.nan
    kind: Kind = ""
    outcome: Outcome | None = None
    seconds: float = field(default=np.nan, compare=False)
    whole: float = field(default=np.nan, compare=False)
    more: Mapping[str, Any] = field(default_factory=dict)

    @property
    def verdict(self) -> Outcome:
        """How it ended."""
        return self.outcome or (Outcome.RIGHT if self.error <= self.bound else Outcome.WRONG)

    @property
    def right(self) -> bool:
        """Whether it is not wrong."""
        return self.verdict is not Outcome.WRONG

    @property
    def ratio(self) -> float:
        """How many times as long it takes with what is left out."""
        return self.whole / self.seconds

    @property
    def detail(self) -> str:
        """Words of a refusal, or why else it is wrong; error, bound and source of an answer."""
        answer = f"{self.kind} error {self.error:.3g}, bound {self.bound:.3g}: {self.source}"
        return "; ".join(filter(None, (self.message, "" if np.isnan(self.bound) else answer.strip())))


@dataclass(frozen=True)
class Point:
    """One setting of one method: what it costs, and how far off it is.

    method, setting: A line of a panel, and a place on it.
    seconds: Processor seconds, on one thread.
    error: In the unit.
    case: System or quantity: a panel of the picture.
    unit: Unit of the error; ``1`` where it is relative.
    source: What the result was compared with.
    evaluations: Of the energy, or of whatever the method counts; NaN where there is nothing to count.
    n: Size of the system: bodies, freedoms or atoms.
    """

    method: str
    setting: str
    seconds: float
    error: float
    case: str = ""
    unit: str = "1"
    source: str = ""
    evaluations: float = np.nan
    n: int = 0


CHECKS = ("name", "value", "oracle", "error", "bound", "source", "kind", "verdict")
EXTREMES = {"name": "name", "outcome": "verdict", "detail": "detail"}
LEFT_OUT = {"what": "name", "ratio": "ratio", "difference": "error", "bound": "bound", "verdict": "verdict"}
WORK = ("method", "setting", "seconds", "error")
CURVES = ("case", "method", "setting", "error", "unit", "source", "seconds", "evaluations", "n")
"""Columns of tables; where one has another name than its field, with that."""


def table(values: Iterable[Found | Point], columns: Sequence[str] | Mapping[str, str]) -> pd.DataFrame:
    """Values as a table of these columns, each a field or one of ``more``."""
    names = columns if isinstance(columns, Mapping) else dict(zip(columns, columns, strict=True))
    rows = [[_cell(value, name) for name in names.values()] for value in values]
    return pd.DataFrame(rows, columns=list(names))


def _cell(value: Found | Point, name: str) -> Any:
    more = value.more if isinstance(value, Found) else {}
    return more[name] if name in more else getattr(value, name)


def judged(name: str, call: Callable[[], Found], refusal: Refusal = None) -> Found:
    """Run a case: what it found, with its name, and its seconds unless it has counted them itself.

    A ProtochainError of one line is a refusal, which is right if ``refusal`` is what it is about. Wrong are
    errors above the bound, NaN, a refusal where an answer is expected, an answer or another refusal where
    one is, and exceptions of any other kind.
    """
    began = perf_counter()
    found = replace(_run(call, refusal), name=name)
    return found if found.seconds >= 0.0 else replace(found, seconds=perf_counter() - began)


def _run(call: Callable[[], Found], refusal: Refusal) -> Found:
    """Result of a call, or what it raised."""
    try:
        # Extreme numbers overflow on the way; what comes of it is judged. BLAS on one thread, as in runs.
        with np.errstate(all="ignore"), threadpool_limits(1, "blas"):
            found = call()
    except ProtochainError as error:
        words = str(error)
        if refusal is None:
            return Found(message=f"refused where an answer is expected: {words}")
        if refusal not in (error.fault, *error.args) or len(words.splitlines()) != 1:
            return Found(message=f"refused, not for {refusal}: {words}")
        return Found(message=words, outcome=Outcome.REFUSED)
    except Exception as error:  # whatever it is, the case is wrong and the others go on
        return Found(message=f"{type(error).__name__}: {error}")
    if refusal is None:
        return found
    words = "; ".join(filter(None, (f"an answer where a refusal is expected: {refusal}", found.message)))
    return replace(found, message=words, outcome=Outcome.WRONG)


def check(
    name: str, value: float, oracle: float, bound: float, source: str, kind: Kind = "relative"
) -> Found:
    """Hold a value against its oracle.

    A relative error of an oracle of zero is infinite, or zero if the value is, too.
    """
    error = abs(float(value) - float(oracle))
    if kind == "relative" and error != 0.0:
        error = error / abs(float(oracle)) if oracle != 0.0 else np.inf
    return Found(float(error), float(bound), source, "", name, float(value), float(oracle), kind)


def vanishes(name: str, error: float, bound: float, source: str) -> Found:
    """Hold an error, by its size, against nothing: :func:`check` of zero, absolute."""
    return check(name, error, 0.0, bound, source, "absolute")


def relative(everything: Floats | float, less: Floats | float) -> float:
    """Largest difference of two answers, relative to the largest number; infinite if shapes differ."""
    a, b = np.asarray(everything, float), np.asarray(less, float)
    if a.shape != b.shape:
        return np.inf
    difference = float(np.max(np.abs(a - b), initial=0.0))
    return difference / float(np.max(np.abs(a), initial=0.0)) if difference != 0.0 else 0.0


def left_out(
    name: str,
    everything: Callable[[], _Result],
    less: Callable[[], _Result],
    bound: float,
    repeats: int = 3,
    error: Callable[[_Result, _Result], float] = relative,  # type: ignore[assignment]  # of numbers and arrays
    seconds: float = 0.0,
    row: int = 1,
    clock: Callable[[], float] = process_time,
) -> Found:
    """Compute an answer with everything and with less, in turn (:func:`in_turn`); the least times count."""
    full, short = in_turn((everything, less), seconds, repeats, row, clock)
    difference = error(full.result, short.result)
    return Found(difference, bound, name=name, seconds=short.least, whole=full.least)


def tried(
    method: str,
    setting: str,
    call: Callable[[], _Result],
    error: Callable[[_Result], float],
    repeats: int = 1,
) -> Point:
    """Time a setting of a method, by the least of some repeats.

    ``error`` is of the result; where the call is refused it is infinite, and there is no time.
    """
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            found, seconds = timed(call, repeats)
    except ProtochainError:
        return Point(method, setting, np.nan, np.inf)
    return Point(method, setting, seconds, float(error(found)))


@dataclass(frozen=True, eq=False)
class Scene:
    """What a scene has found.

    name, title: Name, as in the command, and one line on what it is.
    checks: Values against oracles.
    points: Error against time.
    extremes: Stiff and extreme cases.
    left_out: What was not computed.
    tables: More tables by name, for notebooks: traces, sweeps.
    error_of: What the error of the points is, with its unit: the axis of the picture.
    """

    name: str
    title: str
    checks: Sequence[Found]
    points: Sequence[Point]
    extremes: Sequence[Found] = ()
    left_out: Sequence[Found] = ()
    tables: Mapping[str, pd.DataFrame] = field(default_factory=dict)
    error_of: str = "relative error"

    @property
    def work(self) -> pd.DataFrame:
        """The points as a table."""
        return table(self.points, WORK)

    @property
    def wrong(self) -> tuple[str, ...]:
        """Names of the checks, extremes and answers with something left out that are wrong."""
        return tuple(x.name for x in (*self.checks, *self.extremes, *self.left_out) if not x.right)

    def frames(self) -> dict[str, pd.DataFrame]:
        """All tables by the names of their files: checks, work, extremes, left_out, and the scene's own."""
        return {
            "checks": table(self.checks, CHECKS), "work": self.work,
            "extremes": table(self.extremes, EXTREMES), "left_out": table(self.left_out, LEFT_OUT),
            **self.tables,
        }  # fmt: skip


def plot_work(scene: Scene) -> Figure:
    """Draw error against seconds, a line for each method."""
    figure = Figure(figsize=(6, 3.6), layout="constrained")
    ax = figure.subplots()
    draw_lines(ax, scene.work, "seconds", least=1e-17)
    outside([ax])
    ax.set(xlabel="processor seconds", ylabel=scene.error_of, title=scene.title)
    return figure


def write(scene: Scene, folder: Path) -> dict[str, str]:
    """Write tables, ``work.png``, ``report.html`` and ``made.json`` of a scene; return the last."""
    record = made("1", ("numpy", "scipy", "numba"))
    tables = scene.frames()
    files = {f"{name}.csv": own for name, own in tables.items()}
    save(folder, {**files, "work.png": plot_work(scene), "made.json": json_text(record)})
    parts = [
        Section(heading, {key: tables[key]}, picture="work.png" if key == "work" else "")
        for heading, key in (
            ("Values and their oracles", "checks"), ("Error against run time", "work"),
            ("Stiff and extreme cases", "extremes"), ("Left out", "left_out"),
        )
    ]  # fmt: skip
    write_report(folder, scene.title, parts, record)
    return record
