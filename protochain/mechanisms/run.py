"""A motion as it was carried out: its rows, table, and audit of energy, work and momentum."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from protochain import multibody
from protochain.arrays import Floats, read_only
from protochain.checks import shown
from protochain.defaults import BALANCE
from protochain.errors import MechanicsError
from protochain.motion import Integrator, Phase, Rosenbrock, StepTooLargeError, march
from protochain.multibody.newton_euler import momenta_of_bodies

if TYPE_CHECKING:
    import pandas as pd

    from protochain.mechanisms.model import Model

_LOOK = 64
"""Rows from one look at the balance of energy to the next."""
_SAME = 1e-9
"""Difference of times that is none, relative to the time step."""
_REMEDY = "take a shorter one, DormandPrince(), or for stiff springs and dampers Rosenbrock()"


class Happened(NamedTuple):
    """An event that has happened, and the energy that it gave, negative if it took some."""

    time: float
    name: str
    energy: float


class Audit(NamedTuple):
    """What does not add up, each relative to the largest of its kind in the run.

    Parameters
    ----------
    energy : float
        Largest change of energy that is neither work nor an event's, of the largest energy in motion.
    momentum, spin : float or None
        Largest change of momentum, and of that about the origin, of the sum of those of the bodies; None if
        something acts from outside.
    """

    energy: float
    momentum: float | None
    spin: float | None


class Row(NamedTuple):
    """A phase without its factors, and the energy that events have given until then."""

    time: float
    q: Floats
    qd: Floats
    p: Floats
    potential: float
    work: Floats
    jumps: float

    @property
    def kinetic(self) -> float:
        """Kinetic energy."""
        return 0.5 * float(self.p @ self.qd)

    @property
    def unspent(self) -> float:
        """Energy less work and what events have given, which does not change."""
        return self.kinetic + self.potential - float(np.sum(self.work)) - self.jumps


@dataclass(frozen=True, eq=False)
class Run:
    """Motion of a mechanism; its arrays are made when they are first asked for.

    Parameters
    ----------
    model : Model
        The mechanism.
    rows : sequence of tuples
        The fields of :class:`Row`, row by row.
    events : tuple of Happened
        What has happened.
    end : Phase
        Phase at the end, from which :meth:`Model.simulate` can go on.
    """

    model: "Model"
    rows: Sequence[tuple[Any, ...]]
    events: tuple[Happened, ...]
    end: Phase

    @cached_property
    def time(self) -> Floats:
        """(n,) float: times of the rows."""
        return read_only([row[0] for row in self.rows])

    @cached_property
    def q(self) -> Floats:
        """(n, n_q) float: coordinates."""
        return read_only([row[1] for row in self.rows])

    @cached_property
    def qd(self) -> Floats:
        """(n, n_v) float: velocities."""
        return read_only([row[2] for row in self.rows])

    @cached_property
    def kinetic(self) -> Floats:
        """(n,) float: kinetic energy."""
        return read_only(0.5 * np.einsum("ij,ij->i", [row[3] for row in self.rows], self.qd))

    @cached_property
    def potential(self) -> Floats:
        """(n,) float: potential energy."""
        return read_only([row[4] for row in self.rows])

    @cached_property
    def work(self) -> Floats:
        """(n, k) float: work since the start of each of ``model.works``."""
        return read_only([row[5] for row in self.rows])

    @cached_property
    def jumps(self) -> Floats:
        """(n,) float: energy given by events since the start."""
        return read_only([row[6] for row in self.rows])

    @property
    def total(self) -> Floats:
        """(n,) float: energy."""
        return self.kinetic + self.potential

    @property
    def dissipation(self) -> Floats:
        """(n,) float: energy that dampers and friction have taken."""
        taking = [k for k, each in enumerate(self.model.loads) if each.dissipates]
        return np.asarray(-np.sum(self.work[:, taking], axis=1))

    @property
    def momenta(self) -> Floats:
        """(n, 2, 3) float: momentum, and angular momentum about the world's origin."""
        return self._momenta[0]

    @cached_property
    def _momenta(self) -> tuple[Floats, Floats]:
        """Both, and the sums of the sizes of those of the bodies, (n, 2)."""
        tree, n = self.model.tree, len(self.time)
        whole, sizes = np.empty((n, 2, 3)), np.empty((n, 2))
        for i, (q, qd) in enumerate(zip(self.q, self.qd, strict=True)):
            frames = multibody.pose(tree, q)
            each = momenta_of_bodies(tree, frames, multibody.velocities(tree, frames, qd))
            both = each[:, 3:], each[:, :3] + np.cross(frames.origin, each[:, 3:])
            whole[i] = [np.sum(one, axis=0) for one in both]
            sizes[i] = [np.sum(np.linalg.norm(one, axis=1)) for one in both]
        return read_only(whole), read_only(sizes)

    @cached_property
    def table(self) -> "pd.DataFrame":
        """One row a time: energies, work of each load, dissipation, momentum and spin about the origin."""
        import pandas as pd

        columns = {
            "time": self.time, "kinetic": self.kinetic, "potential": self.potential, "total": self.total,
        }  # fmt: skip
        columns |= {f"work {name}": self.work[:, k] for k, name in enumerate(self.model.works)}
        columns["dissipation"] = self.dissipation
        columns["events"] = self.jumps
        names = [f"{what} {axis}" for what in ("momentum", "spin") for axis in "xyz"]
        columns |= dict(zip(names, self.momenta.reshape(-1, 6).T, strict=True))
        return pd.DataFrame(columns)

    def audit(self) -> Audit:
        """Say how far energy less work, and momentum, are from constant.

        Returns
        -------
        Audit
            Largest errors, relative.
        """
        lack = self.total - np.sum(self.work, axis=1) - self.jumps
        scale = self.in_motion
        energy = float(np.max(np.abs(lack - lack[0])) / scale) if scale > 0.0 else 0.0
        if not self.model.inside:
            return Audit(energy, None, None)
        whole, sizes = self._momenta
        changes = np.max(np.linalg.norm(whole - whole[0], axis=2), axis=0)
        scales = np.max(sizes, axis=0)
        momentum, spin = np.divide(changes, scales, out=np.zeros(2), where=scales > 0.0)
        return Audit(energy, float(momentum), float(spin))

    @property
    def in_motion(self) -> float:
        """Largest energy that moves: kinetic, that of a change of the potential, of work, of events."""
        parts = self.kinetic, self.potential - self.potential[0], self.work - self.work[0], self.jumps
        return max(float(np.max(np.abs(part), initial=0.0)) for part in parts)


class _Rows:
    """Rows of a run as they come, with a look at the energy now and then."""

    def __init__(self, model: "Model", start: Phase, integrator: Integrator, time_step: float) -> None:
        self.model, self.start, self.time_step = model, start, time_step
        self.damps = isinstance(integrator, Rosenbrock)
        # Plain tuples: to make a NamedTuple takes twice as long.
        self.rows: list[tuple[float, Floats, Floats, Floats, float, Floats, float]] = []

    def add(self, at: Phase, jumps: float = 0.0) -> None:
        """Add a row."""
        self.rows.append((at.time, at.q, at.qd, at.p, at.potential, at.work, jumps))
        if len(self.rows) % _LOOK == 0:
            self.look()

    def look(self) -> None:
        """Look at the energy of the latest row.

        Raises
        ------
        StepTooLargeError
            If much of it has come from nothing, or gone nowhere.
        """
        first, row = Row(*self.rows[0]), Row(*self.rows[-1])
        with np.errstate(all="ignore"):
            lack = row.unspent - first.unspent
            floor = 1e3 * np.finfo(float).eps * abs(row.potential)
            wrong = lack if self.damps else abs(lack)
            if wrong <= BALANCE * row.kinetic + floor:
                return
            # Perhaps there was more before: this row may be a turning point.
            largest = self.run([], self.start).in_motion
        if not wrong <= BALANCE * largest + floor:
            raise StepTooLargeError(
                f"by time {row.time:g} the energy has changed by {lack:.3g}, of {largest:.3g} in motion, "
                f"without work: the time step {self.time_step:g} is too long; {_REMEDY}"
            )

    def run(self, gains: list[tuple[float, str, float]], end: Phase) -> Run:
        """Return the run."""
        return Run(self.model, self.rows, tuple(Happened(*gain) for gain in gains), end)


def carry_out(
    model: "Model", until: float, time_step: float, integrator: Integrator, every: int, start: Phase
) -> Run:
    """Carry out :meth:`Model.simulate`.

    Raises
    ------
    StepTooLargeError
        If the time step is too long for the integrator.
    MechanicsError
        If an argument is none.
    """
    for name, value, least in (("until", until, start.time), ("time_step", time_step, 0.0)):
        if not (isinstance(value, int | float | np.floating) and least < value < np.inf):
            raise MechanicsError(f"{name} {shown(value)}: give a finite number above {least:g}")
    if not (isinstance(every, int) and every >= 1):
        raise MechanicsError(f"every {shown(every)}: give a whole number from 1")
    if not start.is_finite:
        raise MechanicsError(
            "at the start energy or forces are no numbers; see functions of loads and forces"
        )
    rows, gains = _Rows(model, start, integrator, time_step), []
    rows.add(start)
    try:
        if model.events:
            end = _with_events(rows, integrator, until, every, gains)
        else:
            end = _without_events(rows, integrator, until, every)
    except StepTooLargeError as error:
        if _REMEDY in str(error):
            raise
        raise StepTooLargeError(
            f"after time {rows.rows[-1][0]:g}: {error}; the time step {time_step:g} is too long; {_REMEDY}"
        ) from None
    except MechanicsError as error:
        # Of what has diverged this says more.
        rows.look()
        raise MechanicsError(f"after time {rows.rows[-1][0]:g}: {model.said(str(error))}") from None
    rows.look()
    return rows.run(gains, end)


def _without_events(rows: _Rows, integrator: Integrator, until: float, every: int) -> Phase:
    """Steps as :func:`protochain.motion.march` takes them, in a loop that costs a hundredth of a step."""
    system, step, h, append = rows.model.system, integrator.step, rows.time_step, rows.rows.append
    at, count = rows.start, 0
    while (left := until - at.time) > _SAME * h:
        at = step(system, at, h if left > (1.0 + _SAME) * h else left)
        count += 1
        if count % every == 0:
            append((at.time, at.q, at.qd, at.p, at.potential, at.work, 0.0))
            if len(rows.rows) % _LOOK == 0:
                rows.look()
    if count % every:
        rows.add(at)
    return at


def _with_events(
    rows: _Rows, integrator: Integrator, until: float, every: int, gains: list[tuple[float, str, float]]
) -> Phase:
    model, at, count, events = rows.model, rows.start, 0, rows.model.watched(gains)
    for at, event in march(model.system, integrator, rows.start, until, rows.time_step, events):
        count += event is None
        if event is not None or count % every == 0:
            rows.add(at, sum(gain for _, _, gain in gains))
    if rows.rows[-1][0] != at.time:
        rows.add(at, sum(gain for _, _, gain in gains))
    return at
