"""A motion as it was carried out: its rows, table, and audit of energy, work and momentum."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from protochain import multibody
from protochain.arrays import Floats, read_only
from protochain.checks import shown
from protochain.errors import MechanicsError
from protochain.motion import Integrator, Phase, Rosenbrock, StepTooLargeError, march
from protochain.multibody.newton_euler import momenta_of_bodies

if TYPE_CHECKING:
    import pandas as pd

    from protochain.mechanisms.model import Model

_LOOK = 256
"""Rows from one look at the balance of energy to the next."""
_SAME = 1e-9
"""Difference of times that is none, relative to the time step."""
_REMEDY = "take a shorter one, DormandPrince(), or for stiff dampers Rosenbrock()"


class Happened(NamedTuple):
    """An event that has happened.

    Parameters
    ----------
    time : float
        When.
    name : str
        Its name.
    energy : float
        Kinetic energy that its jump gave, negative if it took some.
    """

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
        something acts from outside, as the jump of an event that does not pass may.
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

    def unspent(self, counted: NDArray[np.bool_]) -> float:
        """Energy less work (k,), where counted, and what events have given: it does not change."""
        return self.kinetic + self.potential - float(self.work @ counted) - self.jumps


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
        return np.asarray(0.0 - np.sum(self.work[:, taking], axis=1))

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
        scale = self.in_motion(np.ones(self.work.shape[1], dtype=bool))
        energy = float(np.max(np.abs(lack - lack[0])) / scale) if scale > 0.0 else 0.0
        strikes = {each.name for each in self.model.events if not each.passes}
        if not self.model.inside or any(event.name in strikes for event in self.events):
            return Audit(energy, None, None)
        whole, sizes = self._momenta
        changes = np.max(np.linalg.norm(whole - whole[0], axis=2), axis=0)
        scales = np.max(sizes, axis=0)
        momentum, spin = np.divide(changes, scales, out=np.zeros(2), where=scales > 0.0)
        return Audit(energy, float(momentum), float(spin))

    def in_motion(self, counted: NDArray[np.bool_]) -> float:
        """Largest energy that moves: kinetic, that of a change of the potential, of work (k,), of events."""
        work = (self.work - self.work[0])[:, counted]
        parts = self.kinetic, self.potential - self.potential[0], work, self.jumps
        return max(float(np.max(np.abs(part), initial=0.0)) for part in parts)


class _Rows:
    """Rows of a run as they come, with a look at the energy now and then."""

    def __init__(
        self, model: "Model", start: Phase, integrator: Integrator, time_step: float, balance: float
    ) -> None:
        self.model, self.start, self.time_step, self.balance = model, start, time_step, balance
        # What stiff dampers take in a step of Rosenbrock's method is right, but not the integral of the
        # power at its ends. They can but take, so that there the energy must not rise.
        taking = np.array([each.dissipates for each in model.loads], dtype=bool)
        self.rising_only = isinstance(integrator, Rosenbrock) and bool(np.any(taking))
        self.counted = np.ones(len(start.work), dtype=bool)
        self.counted[: len(taking)] = ~(taking & self.rising_only)
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
        lack = row.unspent(self.counted) - first.unspent(self.counted)
        wrong = lack if self.rising_only else abs(lack)
        if wrong <= self.balance * row.kinetic < np.inf:
            return
        # Perhaps there was more before: this row may be a turning point.
        largest = self.run([], self.start).in_motion(self.counted)
        floor = 1e3 * np.finfo(float).eps * abs(row.potential)
        if not (wrong <= self.balance * largest + floor and np.isfinite(lack)):
            raise StepTooLargeError(
                f"by time {row.time:g} the energy has changed by {lack:.3g}, of {largest:.3g} in motion, "
                f"without work: the time step {self.time_step:g} is too long; {_REMEDY}"
            )

    def run(self, gains: list[tuple[float, str, float]], end: Phase) -> Run:
        """Return the run."""
        return Run(self.model, self.rows, tuple(Happened(*gain) for gain in gains), end)


def carry_out(
    model: "Model", until: float, time_step: float, integrator: Integrator, every: int, start: Phase,
    balance: float,
) -> Run:  # fmt: skip
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
    if not (isinstance(balance, int | float) and balance > 0.0):
        raise MechanicsError(f"balance {shown(balance)}: give a number above 0, as inf to accept any")
    if model.drive is not None:
        for when in (start.time + 0.37 * time_step, start.time + 0.61 * (until - start.time)):
            _check_drive(model, when, 1e-4 * time_step)
    gains: list[tuple[float, str, float]] = []
    rows = _Rows(model, start, integrator, time_step, balance)
    rows.add(start)
    end: Phase | None = None
    try:
        # What diverges is refused below, not warned of.
        with np.errstate(over="ignore", invalid="ignore"):
            if model.events or model.memories:
                end = _with_events(rows, integrator, until, every, gains)
            else:
                end = _without_events(rows, integrator, until, every)
            rows.look()
    except StepTooLargeError as error:
        if _REMEDY in str(error):
            raise
        raise StepTooLargeError(
            f"after time {rows.rows[-1][0]:g}: {error}; the time step {time_step:g} is too long; {_REMEDY}"
        ) from None
    except MechanicsError as error:
        # Of what has diverged this says more.
        with np.errstate(over="ignore", invalid="ignore"):
            rows.look()
        raise MechanicsError(f"after time {rows.rows[-1][0]:g}: {model.said(str(error))}") from None
    finally:
        for memory in model.memories:
            memory.end(end)
    return rows.run(gains, end)


def _check_drive(model: "Model", time: float, nudge: float) -> None:
    """Raise if a drive's rates and accelerations are not the derivatives of its coordinates and rates."""
    assert model.drive is not None
    before, at, after = (np.array(model.drive(t)) for t in (time - nudge, time, time + nudge))
    change = (after[:2] - before[:2]) / (2.0 * nudge)
    # A hundredth, and what the differences are rounded by: a start from rest cancels terms of order one.
    units = model.tree.units[model.tree.driven_v]
    rounded = (1e-12 * np.abs(at[:2]) + 1e-13 * units) / nudge
    allowed = 0.01 * np.maximum(np.abs(change), np.abs(at[1:])) + rounded
    if np.any(np.abs(change - at[1:]) > allowed):
        of, k = (int(i) for i in np.argwhere(np.abs(change - at[1:]) > allowed)[0])
        driven = [h for h, b in model.bodies.hinges.items() if model.tree.v_start[b] in model.tree.driven_v]
        name = sorted(driven, key=model.bodies.hinge)[k]
        what, rate = ("coordinate", "rate") if of == 0 else ("rate", "acceleration")
        raise MechanicsError(
            f'drive of hinge "{name}": at time {time:g} its {what} changes by {change[of, k]:g} per time, '
            f"but its {rate} is {at[of + 1, k]:g}; give the derivative"
        )


def _without_events(rows: _Rows, integrator: Integrator, until: float, every: int) -> Phase:
    """Steps as :func:`protochain.motion.march` takes them, in a loop that costs a hundredth of a step."""
    system, step, h, append = rows.model.system, integrator.step, rows.time_step, rows.rows.append
    at, count, look = rows.start, 0, every * _LOOK
    # Rounding of times adds up to less than a step: until near the end nothing need be compared.
    for count in range(1, int((until - at.time) / h) - 1):
        at = step(system, at, h)
        if count % every == 0:
            append((at.time, at.q, at.qd, at.p, at.potential, at.work, 0.0))
            if count % look == 0:
                rows.look()
    while (left := until - at.time) > _SAME * h:
        at = step(system, at, h if left > (1.0 + _SAME) * h else left)
        count += 1
        if count % every == 0:
            rows.add(at)
    if count % every:
        rows.add(at)
    return at


def _with_events(
    rows: _Rows, integrator: Integrator, until: float, every: int, gains: list[tuple[float, str, float]]
) -> Phase:
    model, at, count, events = rows.model, rows.start, 0, rows.model.watched(gains)
    for memory in model.memories:
        memory.begin(at)
        memory.settle(at)
    for at, event in march(model.system, integrator, rows.start, until, rows.time_step, events):
        for memory in model.memories:
            memory.settle(at)
        count += event is None
        if event is not None or count % every == 0:
            rows.add(at, sum(gain for _, _, gain in gains))
    if rows.rows[-1][0] != at.time:
        rows.add(at, sum(gain for _, _, gain in gains))
    return at
