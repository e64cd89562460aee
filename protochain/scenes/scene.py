"""What a scene is: checks against oracles, error against run time, extremes, and what it left out.

A scene is a module with ``run(quick) -> Scene``. The helpers below make its parts: :func:`check` of a value
and its oracle, :func:`extreme` of a call that may be refused, :func:`left_out` of two calls, :func:`timed`,
:func:`work_table` and :func:`exponent`.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from time import process_time
from typing import Literal, NamedTuple, TypeVar

import numpy as np
import pandas as pd

from protochain.arrays import Floats
from protochain.errors import ProtochainError

Kind = Literal["relative", "absolute"]
Outcome = Literal["right", "refused", "wrong"]
_Result = TypeVar("_Result")


@dataclass(frozen=True)
class Check:
    """A value beside what it should be.

    Parameters
    ----------
    name : str
        What is checked, with its unit if it has one.
    value, oracle : float
        What came out, and what should.
    error, bound : float
        Error and the largest that is allowed; NaN is wrong.
    source : str
        Where the oracle comes from.
    kind : str
        Whether the error is ``relative`` to the oracle or ``absolute``.
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
        # Not "not error > bound": NaN is wrong.
        return bool(self.error <= self.bound)


@dataclass(frozen=True)
class Extreme:
    """How an extreme case ended.

    Parameters
    ----------
    name : str
        The case.
    outcome : str
        ``right``, ``refused`` where that is expected, or ``wrong``.
    detail : str
        Error, bound and oracle, or the words of the refusal.
    """

    name: str
    outcome: Outcome
    detail: str

    @property
    def right(self) -> bool:
        """Whether it is not wrong."""
        return self.outcome != "wrong"


@dataclass(frozen=True)
class LeftOut:
    """Something that the scene does not need, and did not compute.

    Parameters
    ----------
    what : str
        What is left out.
    ratio : float
        How many times as long it takes with it.
    difference, bound : float
        How much the answer differs, and by how much it may.
    """

    what: str
    ratio: float
    difference: float
    bound: float

    @property
    def right(self) -> bool:
        """Whether the answer is the same, within the bound."""
        return bool(self.difference <= self.bound)


class Work(NamedTuple):
    """A setting of a method: a point of the picture of error against run time.

    Parameters
    ----------
    method, setting : str
        A line of the picture, and a place on it.
    seconds : float
        Processor seconds, on one thread.
    error : float
        As the scene defines it.
    """

    method: str
    setting: str
    seconds: float
    error: float


@dataclass(frozen=True, eq=False)
class Scene:
    """What a scene has found.

    Parameters
    ----------
    name, title : str
        Name, as in the command, and one line on what it is.
    checks : tuple of Check
        Values against oracles.
    work : pandas.DataFrame
        Columns ``method``, ``setting``, ``seconds`` and ``error``: :func:`work_table`.
    extremes : tuple of Extreme
        Stiff and extreme cases.
    left_out : tuple of LeftOut
        What was not computed.
    tables : mapping of str to pandas.DataFrame
        More tables by name, for notebooks: traces, sweeps.
    error_of : str
        What the error of ``work`` is, with its unit: the axis of the picture.
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
        checks = _frame(self.checks, Check)
        left_out = _frame(self.left_out, LeftOut)
        for table, rows in ((checks, self.checks), (left_out, self.left_out)):
            table["verdict"] = ["right" if row.right else "wrong" for row in rows]
        own = {"checks": checks, "work": self.work, "extremes": _frame(self.extremes, Extreme)}
        return {**own, "left_out": left_out, **self.tables}


def _frame(rows: Iterable[Check | Extreme | LeftOut], kind: type) -> pd.DataFrame:
    return pd.DataFrame([asdict(row) for row in rows], columns=list(kind.__annotations__))


def check(
    name: str, value: float, oracle: float, bound: float, source: str, kind: Kind = "relative"
) -> Check:
    """Hold a value against its oracle.

    Parameters
    ----------
    name, value, oracle, bound, source, kind
        As of :class:`Check`.

    Returns
    -------
    Check
        With its error. A relative one of an oracle of zero is infinite, or zero if the value is, too.
    """
    error = abs(float(value) - float(oracle))
    if kind == "relative" and error != 0.0:
        error = error / abs(float(oracle)) if oracle != 0.0 else np.inf
    return Check(name, float(value), float(oracle), float(error), float(bound), source, kind)


def extreme(name: str, call: Callable[[], Check], refusal: str = "") -> Extreme:
    """Run an extreme case: right, refused in the words expected, or wrong.

    Parameters
    ----------
    name : str
        The case.
    call : callable
        -> the :class:`Check` of its answer; a ProtochainError is a refusal.
    refusal : str
        Pattern of the words of the refusal that is expected; without it an answer is.

    Returns
    -------
    Extreme
        Wrong are errors above the bound, NaN, a refusal where an answer is expected, an answer or another
        refusal where one is, and exceptions of any other kind.
    """
    try:
        # Extreme numbers overflow on the way; what comes of it is judged.
        with np.errstate(all="ignore"):
            found = call()
    except ProtochainError as error:
        said = str(error)
        if not refusal:
            return Extreme(name, "wrong", f"refused where an answer is expected: {said}")
        if "\n" in said or not re.search(refusal, said):
            return Extreme(name, "wrong", f"refused otherwise than by {refusal!r}: {said}")
        return Extreme(name, "refused", said)
    except Exception as error:  # whatever it is, the case is wrong and the others go on
        return Extreme(name, "wrong", f"{type(error).__name__}: {error}")
    detail = f"{found.kind} error {found.error:.3g}, bound {found.bound:.3g}: {found.source}"
    if refusal:
        return Extreme(name, "wrong", f"an answer where a refusal is expected ({refusal}); {detail}")
    return Extreme(name, "right" if found.right else "wrong", detail)


def timed(call: Callable[[], _Result], repeats: int = 1) -> tuple[_Result, float]:
    """Result of a call, and its processor seconds: the least of some repeats.

    What is compiled by the first call belongs in no timing: call it before, or give two repeats or more.
    """
    least = np.inf
    for _ in range(repeats):
        began = process_time()
        result = call()
        least = min(least, process_time() - began)
    return result, float(least)


def left_out(
    what: str,
    everything: Callable[[], Floats | float],
    less: Callable[[], Floats | float],
    bound: float,
    repeats: int = 3,
) -> LeftOut:
    """Compute an answer with everything and with less, timed in turn.

    Parameters
    ----------
    what : str
        What is left out.
    everything, less : callable
        -> the answer, a number or an array.
    bound : float
        Largest difference allowed, relative to the largest number of the answer.
    repeats : int
        How often each is called; the least processor seconds count.

    Returns
    -------
    LeftOut
        With the ratio of both times and the relative difference, which is infinite if shapes differ.
    """
    answers: list[Floats] = [np.empty(0), np.empty(0)]
    least = [np.inf, np.inf]
    for _ in range(repeats):
        for k, call in enumerate((everything, less)):
            answer, seconds = timed(call)
            answers[k], least[k] = np.asarray(answer, float), min(least[k], seconds)
    if answers[0].shape != answers[1].shape:
        return LeftOut(what, least[0] / least[1], np.inf, bound)
    difference = float(np.max(np.abs(answers[0] - answers[1]), initial=0.0))
    size = float(np.max(np.abs(answers[0]), initial=0.0))
    return LeftOut(what, least[0] / least[1], difference / size if difference != 0.0 else 0.0, bound)


def work_table(rows: Iterable[Work | tuple[str, str, float, float]]) -> pd.DataFrame:
    """Points of error against run time as the table of a :class:`Scene`."""
    return pd.DataFrame([Work(*row) for row in rows], columns=list(Work._fields))


def exponent(x: Floats | Iterable[float], y: Floats | Iterable[float]) -> float:
    """Exponent p of y ~ x^p, by least squares of the logarithms.

    Parameters
    ----------
    x, y : (k,) float
        For example step and error, or size and seconds; points that are not positive and finite are left out.

    Returns
    -------
    float
        NaN of fewer than two points.
    """
    points = np.column_stack([np.asarray(list(x), float), np.asarray(list(y), float)])
    points = np.log(points[np.all(np.isfinite(points) & (points > 0.0), axis=1)])
    if len(np.unique(points[:, 0])) < 2:
        return float("nan")
    return float(np.polyfit(points[:, 0], points[:, 1], 1)[0])
