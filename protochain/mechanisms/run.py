"""A motion as it was carried out: its rows, table, and audit of energy, work and momentum."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

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


@dataclass(frozen=True, eq=False)
class Run:
    """Motion of a mechanism.

    Parameters
    ----------
    model : Model
        The mechanism.
    time : (n,) float
        Times of the rows.
    q, qd : (n, n_q) and (n, n_v) float
        Coordinates and velocities.
    kinetic, potential : (n,) float
        Energies.
    work : (n, k) float
        Work since the start of each of ``model.works``.
    jumps : (n,) float
        Energy given by events since the start.
    events : tuple of Happened
        What has happened.
    end : Phase
        Phase at the end, from which :meth:`Model.simulate` can go on.
    """

    model: "Model"
    time: Floats
    q: Floats
    qd: Floats
    kinetic: Floats
    potential: Floats
    work: Floats
    jumps: Floats
    events: tuple[Happened, ...]
    end: Phase

    @property
    def total(self) -> Floats:
        """(n,) float: energy."""
        return self.kinetic + self.potential

    @cached_property
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

    @property
    def dissipation(self) -> Floats:
        """(n,) float: energy that dampers and friction have taken."""
        taking = [k for k, each in enumerate(self.model.loads) if each.dissipates]
        return np.asarray(-np.sum(self.work[:, taking], axis=1))

    def audit(self) -> Audit:
        """Say how far energy less work, and momentum, are from constant.

        Returns
        -------
        Audit
            Largest errors, relative.
        """
        lack, scale = balance(self.kinetic, self.potential, self.work, self.jumps)
        energy = float(np.max(np.abs(lack)) / scale[-1]) if scale[-1] > 0.0 else 0.0
        if not self.model.inside:
            return Audit(energy, None, None)
        whole, sizes = self._momenta
        changes = np.max(np.linalg.norm(whole - whole[0], axis=2), axis=0)
        scales = np.max(sizes, axis=0)
        momentum, spin = np.divide(changes, scales, out=np.zeros(2), where=scales > 0.0)
        return Audit(energy, float(momentum), float(spin))


def balance(kinetic: Floats, potential: Floats, work: Floats, jumps: Floats) -> tuple[Floats, Floats]:
    """Energy that came from nothing, (n,), and the largest energy in motion until then, (n,)."""
    given = np.sum(work, axis=1) + jumps
    lack = kinetic + potential - given
    sizes = [kinetic, np.abs(potential - potential[0]), np.abs(jumps), *np.abs(work.T)]
    return lack - lack[0], np.maximum.accumulate(np.max(sizes, axis=0))


class _Rows:
    """Rows of a run, as they come."""

    def __init__(self, model: "Model", integrator: Integrator, time_step: float) -> None:
        self.model, self.time_step, self.looked = model, time_step, 0
        self.damps = isinstance(integrator, Rosenbrock)
        self.phases: list[tuple[float, Floats, Floats, Floats, float, Floats | float]] = []
        self.jumps: list[float] = []

    def add(self, at: Phase, jumped: float) -> None:
        """Add a row; look at the energy now and then."""
        self.phases.append((at.time, at.q, at.qd, at.p, at.potential, at.work))
        self.jumps.append(jumped)
        if len(self.phases) - self.looked >= _LOOK:
            self.look()

    def look(self) -> None:
        """Raise StepTooLargeError if energy has come from nothing, or been lost without a damper."""
        self.looked = len(self.phases)
        time, kinetic, potential, work, jumps = self.energies()
        with np.errstate(all="ignore"):
            lack, scale = balance(kinetic, potential, work, jumps)
            floor = 1e3 * np.finfo(float).eps * np.max(np.abs(potential))
            gain = lack if self.damps else np.abs(lack)
            bad = ~(gain <= BALANCE * scale + floor)
        if np.any(bad):
            first = int(np.argmax(bad))
            many = (
                f"{100.0 * lack[first] / scale[first]:.3g} % of" if np.isfinite(lack[first]) else "more than"
            )
            raise StepTooLargeError(
                f"at time {time[first]:g} {many} the energy in motion has come from nothing: "
                f"the time step {self.time_step:g} is too long; {_REMEDY}"
            )

    def energies(self) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """Times, kinetic and potential energies, work of each load, energy of events."""
        time, _, qd, p, potential, work = zip(*self.phases, strict=True)
        with np.errstate(all="ignore"):
            kinetic = 0.5 * np.einsum("ij,ij->i", np.array(qd), np.array(p))
        n, k = len(time), len(self.model.works)
        done = np.array(work, dtype=float).reshape(n, -1) if k else np.zeros((n, 0))
        return np.array(time), kinetic, np.array(potential), done, np.array(self.jumps)

    def finished(self, events: list[tuple[float, str, float]], end: Phase) -> Run:
        """Return the run."""
        self.look()
        time, kinetic, potential, work, jumps = (read_only(values) for values in self.energies())
        q, qd = (read_only([row[k] for row in self.phases]) for k in (1, 2))
        happened = tuple(Happened(*event) for event in events)
        return Run(self.model, time, q, qd, kinetic, potential, work, jumps, happened, end)


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
    if not np.isfinite(start.potential) or not np.isfinite(start.torque).all():
        raise MechanicsError(
            "at the start energy or forces are no numbers; see the functions of loads and forces"
        )
    gains: list[tuple[float, str, float]] = []
    rows, at, count, jumped = _Rows(model, integrator, time_step), start, 0, 0.0
    rows.add(start, jumped)
    try:
        for memory in model.memories:
            memory.begin(start)
            memory.settle(start)
        for at, event in march(model.system, integrator, start, until, time_step, model.watched(gains)):
            for memory in model.memories:
                memory.settle(at)
            if event is None:
                count += 1
                if count % every:
                    continue
            else:
                jumped = sum(gain for _, _, gain in gains)
            rows.add(at, jumped)
    except StepTooLargeError as error:
        raise StepTooLargeError(
            f"after time {at.time:g}: {error}; the step is {time_step:g}: {_REMEDY}"
        ) from None
    except MechanicsError as error:
        rows.look()
        raise MechanicsError(f"after time {at.time:g}: {model.said(str(error))}") from None
    finally:
        for memory in model.memories:
            memory.end(at)
    if count % every:
        rows.add(at, jumped)
    return rows.finished(gains, at)
