"""A mechanism as built, its simulation, and what comes of it: rows, table and audit."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space

from protochain.core.arrays import Floats, read_only
from protochain.core.checks import shown
from protochain.core.defaults import BALANCE
from protochain.core.errors import BodyError, MechanicsError
from protochain.mechanics import multibody
from protochain.mechanics.motion import (
    Drive,
    Equations,
    Integrator,
    Load,
    Phase,
    RungeKutta4,
    StepTooLargeError,
    System,
)
from protochain.mechanics.multibody import HingeKind, Tree
from protochain.mechanics.multibody.newton_euler import momenta_of_bodies
from protochain.mechanisms.bodies import Bodies, State
from protochain.mechanisms.closed_equations import ClosedEquations
from protochain.mechanisms.dissipated import WithDampers
from protochain.mechanisms.drawing import Shape
from protochain.mechanisms.drives import Driven, check_drive, drive_of
from protochain.mechanisms.elements import Acting, Conservative, Gravity, Memory, Sum, damping, joined
from protochain.mechanisms.event import Event, Happened
from protochain.mechanisms.explicit import Acts, CompiledLoops, CompiledSystem
from protochain.mechanisms.march import march
from protochain.mechanisms.pictures import Movie, movie, strip
from protochain.mechanisms.reactions import motion, reactions
from protochain.mechanisms.rosenbrock import Rosenbrock

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import ArrayLike

    from protochain.core.figure import Figure

_LOOK = 256
"""Rows from one look at the balance of energy to the next."""
_MOST_ROWS = 1e7
"""Rows of a run: of each some hundred bytes at least, and thousands with many bodies."""
_MOST_STEPS = 1e10
"""Steps of a run: of ten microseconds at least, so that these take a day."""
_SAME = 1e-9
"""Difference of times that is none, relative to the time step."""


@dataclass(frozen=True, eq=False)
class NamedLoad:
    """A load, whose work is counted under its name."""

    name: str
    load: Load
    dissipates: bool = False


@dataclass(frozen=True, eq=False)
class Model:
    """Mechanism that no later change reaches, made by :meth:`Mechanism.build`.

    Parameters
    ----------
    bodies : Bodies
        Bodies by name, with their tree.
    q, qd : (n_q,) and (n_v,) float
        Coordinates and velocities at the start.
    conservative : tuple of Conservative
        Elements with an energy, by kind.
    loads : tuple of NamedLoad
        Loads by name.
    drive : callable, optional
        Time -> coordinates, rates and accelerations of the driven hinges, in the order of the tree.
    events : tuple of Event
        Events.
    inside : bool
        Whether nothing acts from outside, so that momentum and spin are kept.
    memories : tuple of Memory
        What elements keep from step to step.
    """

    bodies: Bodies
    q: Floats
    qd: Floats
    conservative: tuple[Conservative, ...] = ()
    loads: tuple[NamedLoad, ...] = ()
    drive: Drive | None = None
    events: tuple[Event, ...] = ()
    inside: bool = False
    memories: tuple[Memory, ...] = ()

    @property
    def tree(self) -> Tree:
        """Rigid bodies."""
        return self.bodies.tree

    @property
    def directions(self) -> Floats:
        """(n_v, k) float: directions in which it can move, as columns: of all hinges that are not driven."""
        free = np.eye(self.tree.n_v)[:, self.tree.undriven_v]
        state = self.state()
        if state.loops is None:
            return free
        g = multibody.row_matrix(self.tree, state.frames, state.loops)
        return np.asarray(free @ null_space(g @ free, rcond=1e-9))

    @cached_property
    def system(self) -> Equations:
        """The mechanism as integrators see it."""
        loads = tuple(each.load for each in self.loads)
        potential, joints = Sum(self.tree, self.conservative), self.bodies.joints
        acts = Acts.of(self.conservative) if not loads and self.tree.is_plain else None
        if acts is not None:
            if joints is None:
                return CompiledSystem(self.tree, potential, acts=acts)
            return CompiledLoops(self.tree, potential, joints=joints, acts=acts)
        if joints is None:
            return System(self.tree, potential, loads=loads, drive=self.drive)
        return ClosedEquations(self.tree, potential, loads=loads, drive=self.drive, joints=joints)

    @property
    def works(self) -> tuple[str, ...]:
        """Names of what does work, in the order of ``Phase.work``."""
        return (*(each.name for each in self.loads), *(("drives",) if self.drive is not None else ()))

    @property
    def taking(self) -> NDArray[np.bool_]:
        """(k,) bool: which of the works are of dampers and friction, which can but take energy."""
        kinds = [each.dissipates for each in self.loads]
        return np.array(kinds + [False] * (self.drive is not None), dtype=bool)

    def start(self) -> Phase:
        """Phase at the start.

        Raises
        ------
        MechanicsError
            If the pose is singular, or what an element gives is no number.
        """
        try:
            return self.system.at(self.q, self.qd)
        except BodyError as error:
            raise error.by_name(self.bodies.names) from None

    def state(self, at: Phase | None = None) -> State:
        """State at a phase, by default at the start, from which points and velocities can be had by name."""
        at = self.start() if at is None else at
        state = State(self.bodies, at.time, at.q, at.qd, at.factors.frames)
        # Known already, so that impulses need not factorise again.
        state.__dict__["factors"] = at.factors
        return state

    def simulate(
        self,
        until: float,
        time_step: float,
        integrator: Integrator | None = None,
        every: int = 1,
        start: Phase | None = None,
        balance: float = BALANCE,
    ) -> "Run":
        """Follow the motion.

        Parameters
        ----------
        until : float
            Time of the end.
        time_step : float
            Longest step.
        integrator : Integrator, optional
            By default ``motion.RungeKutta4``. ``DormandPrince()`` keeps a tolerance;
            ``Rosenbrock()`` takes any damper, however stiff, and damps vibrations that its step does not
            resolve; ``ImplicitMidpoint()`` keeps their energy, not their phase.
        every : int
            Steps from one row of the result to the next; events and the end have rows besides.
        start : Phase, optional
            Phase from which to go on, as :attr:`Run.end`.
        balance : float
            Largest change of energy without work, of the largest in motion, that is no error.

        Returns
        -------
        Run
            The motion, its table and audit.

        Raises
        ------
        StepTooLargeError
            If the time step is too long for the integrator: energy comes from nothing, or a step has no end.
        MechanicsError
            If an argument, or what an element gives, is no number.
        """
        start = self.start() if start is None else start
        if not isinstance(start, Phase):
            raise MechanicsError(f"start {shown(start)}: give a phase, as the end of a run")
        for name, value, least in (("until", until, start.time), ("time_step", time_step, 0.0)):
            if not (isinstance(value, int | float | np.floating) and least < value < np.inf):
                raise MechanicsError(f"{name} {shown(value)}: give a finite number above {least:g}")
        if not (isinstance(every, int) and every >= 1):
            raise MechanicsError(f"every {shown(every)}: give a whole number from 1")
        chosen = RungeKutta4() if integrator is None else integrator
        # Of a Protocol there are no instances, but of a class that derives from it.
        if Integrator not in type(chosen).__mro__:
            given = f"{chosen.__name__}, a class" if isinstance(chosen, type) else shown(chosen)
            raise MechanicsError(f"integrator {given}: give one, as RungeKutta4() or DormandPrince(1e-9)")
        if not start.is_finite:
            raise MechanicsError(
                "at the start energy or forces are no numbers; see functions of loads and forces"
            )
        if not (isinstance(balance, int | float) and balance > 0.0):
            raise MechanicsError(f"balance {shown(balance)}: give a number above 0, as inf to accept any")
        if self.drive is not None:
            for when in (start.time + 0.37 * time_step, start.time + 0.61 * (until - start.time)):
                check_drive(self.bodies, self.drive, when, 1e-4 * time_step)
        steps = (until - start.time) / time_step
        if steps > _MOST_STEPS:
            raise MechanicsError(
                f"{steps:.1g} steps take {steps / _MOST_STEPS:.0f} days at least: give a longer time_step, "
                "or an earlier until"
            )
        rows = steps / every
        if rows > _MOST_ROWS:
            raise MechanicsError(
                f"{rows:.1g} rows do not fit in memory: give every from {rows * every / _MOST_ROWS:.0f}, or "
                "a longer time_step"
            )
        return _Simulation(self, start, chosen, time_step, every, balance).run(until)


def model_of(
    bodies: Bodies, gravity: Floats, elements: Sequence[Any], drives: Sequence[Driven],
    events: tuple[Event, ...],
) -> Model:  # fmt: skip
    """Return a model of bodies and all that acts on them."""
    tree, acting = bodies.tree, {}
    for element in elements:
        found = element.bind(bodies)
        parts = (found.conservative, found.load, found.damping) if isinstance(found, Acting) else ()
        if all(part is None for part in parts):
            raise MechanicsError(f"{element.said}: its bind() gives nothing that acts; return Acting(...)")
        acting[element.name] = found
    weight = [Gravity(tree, gravity)] if np.any(gravity) else []
    damped = joined(each.damping for each in acting.values() if each.damping)
    loads = [NamedLoad("damping", damping(tree, damped), dissipates=True)] if damped else []
    loads += [NamedLoad(name, each.load, each.dissipates) for name, each in acting.items() if each.load]
    held = np.any((tree.parent < 0) & (tree.kind != HingeKind.FREE))
    return Model(
        bodies, bodies.q, bodies.qd,
        (*weight, *joined(each.conservative for each in acting.values() if each.conservative)), tuple(loads),
        drive_of(bodies, drives) if drives else None, events,
        not weight and not held and not _on_world(bodies) and all(each.inside for each in acting.values()),
        tuple(each.memory for each in acting.values() if each.memory),
    )  # fmt: skip


def _on_world(bodies: Bodies) -> bool:
    """Whether a loop closes on the world."""
    return bodies.joints is not None and bool(np.any(bodies.joints.body < 0))


class Audit(NamedTuple):
    """What does not add up, each relative to the largest of its kind in the run.

    Parameters
    ----------
    energy : float
        Largest change of energy that is neither work nor an event's, of the largest energy in motion.
    momentum, spin : float or None
        Largest change of momentum, and of that about the origin, of the sum of those of the bodies; None if
        something acts from outside, as the jump of an event that does not pass may.
    gap, parting : float or None
        Largest error of a loop, a cosine or length by the size of the tree, and largest rate of one, by that
        of the fastest hinge; None without loops.
    """

    energy: float
    momentum: float | None
    spin: float | None
    gap: float | None = None
    parting: float | None = None


Row = tuple[float, Floats, Floats, Floats, float, Floats, float]
"""Time, q, qd, p, potential energy and work of a phase, and energy that events have given until then: a plain
tuple, as to make a NamedTuple takes twice as long."""


@dataclass(frozen=True, eq=False)
class Run:
    """Motion of a mechanism; its arrays are made when they are first asked for.

    Parameters
    ----------
    model : Model
        The mechanism.
    rows : sequence of Row
        Phases, without their factors.
    events : tuple of Happened
        What has happened.
    end : Phase
        Phase at the end, from which :meth:`Model.simulate` can go on.
    kept : sequence of tuple
        What the model's memories kept at each row; empty without memories.
    """

    model: Model
    rows: Sequence[Row]
    events: tuple[Happened, ...]
    end: Phase
    kept: Sequence[tuple[Any, ...]] = ()

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
        return np.asarray(0.0 - np.sum(self.work[:, self.model.taking], axis=1))

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

    @cached_property
    def motion(self) -> "pd.DataFrame":
        """One row a time: coordinate and rate of each hinge by its name, and what a drive gives it.

        Drives are torques, or forces of slides.
        """
        return motion(self)

    def reactions(self, name: str) -> "pd.DataFrame":
        """Tell the forces that pass through a hinge, or a joint that closes a loop.

        Parameters
        ----------
        name : str
            Hinge or joint.

        Returns
        -------
        pandas.DataFrame
            A row a time: ``force x`` ... ``moment z``, world axes, on the child of a hinge about its origin,
            on the second body of a joint about its point; torques of springs, motors and drives in it are
            among them. Where joints depend on others, forces are not unique; these are the least.

        Raises
        ------
        MechanicsError
            If there is no such hinge.
        """
        return reactions(self, name)

    def view(
        self,
        path: str | Path | None = None,
        shapes: Sequence[Shape] | None = None,
        title: str = "",
        frames: int = 200,
    ) -> Movie:
        """Show the motion in three dimensions: in a notebook, and as a page that works offline.

        Parameters
        ----------
        path : str or Path, optional
            Where to write the page, as ``"motion.html"``.
        shapes : sequence of Ball, Rod or Block, optional
            What bodies look like; by default rods to where others are joined, the balls of contacts, and for
            bodies without either blocks or balls with their moments of inertia.
        title : str
            Its heading.
        frames : int
            Most poses.

        Returns
        -------
        Movie
            Drag to turn it, scroll to zoom.

        Raises
        ------
        MechanicsError
            If a shape is none or its body not there.
        """
        return movie(self, path, shapes, title, frames)

    def strip(
        self,
        times: "ArrayLike | None" = None,
        shapes: Sequence[Shape] | None = None,
        along: "ArrayLike | None" = None,
    ) -> "Figure":
        """Draw poses beside each other.

        Parameters
        ----------
        times : (n,) array_like, optional
            When; the rows next to these are drawn. By default five, from start to end.
        shapes : sequence of Ball, Rod or Block, optional
            As of :meth:`view`.
        along : (3,) array_like, optional
            Direction in which one looks; by default that in which the motion is flat, or aslant.

        Returns
        -------
        matplotlib.figure.Figure
            Shown by notebooks; ``savefig("strip.svg")`` writes it.

        Raises
        ------
        MechanicsError
            If a time is not of the run, a shape is none, or its body not there.
        """
        return strip(self, times, shapes, along)

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
        loops = self._opened() if self.model.bodies.joints is not None else (None, None)
        strikes = {each.name for each in self.model.events if not each.passes}
        if not self.model.inside or any(event.name in strikes for event in self.events):
            return Audit(energy, None, None, *loops)
        whole, sizes = self._momenta
        changes = np.max(np.linalg.norm(whole - whole[0], axis=2), axis=0)
        scales = np.max(sizes, axis=0)
        momentum, spin = np.divide(changes, scales, out=np.zeros(2), where=scales > 0.0)
        return Audit(energy, float(momentum), float(spin), *loops)

    def _opened(self) -> tuple[float, float]:
        """Largest error of a loop by the size of the tree, and its rate by the fastest freedom."""
        joints, tree = self.model.bodies.joints, self.model.tree
        assert joints is not None
        units = np.where(joints.turns, 1.0, tree.size)
        gap = parting = 0.0
        for q, qd in zip(self.q, self.qd, strict=True):
            frames = multibody.pose(tree, q)
            error, rows = joints.rows(frames)
            rates = multibody.row_matrix(tree, frames, rows) @ qd
            gap = max(gap, float(np.max(np.abs(error) / units)))
            parting = max(parting, float(np.max(np.abs(rates) / units)))
        fastest = float(np.max(np.abs(self.qd) / tree.units, initial=0.0))
        return gap, parting / fastest if fastest > 0.0 else 0.0

    @property
    def in_motion(self) -> float:
        """Largest energy that moves: kinetic, that of a change of the potential, of work, of events."""
        parts = self.kinetic, self.potential - self.potential[0], self.work - self.work[0], self.jumps
        return max(float(np.max(np.abs(part), initial=0.0)) for part in parts)


class UnbalancedError(StepTooLargeError):
    """Energy has come from nothing, or gone nowhere, so that a time step is too long."""


class _Simulation:
    """A run as it comes: its rows, with a look at the energy now and then."""

    def __init__(
        self, model: Model, start: Phase, integrator: Integrator, time_step: float, every: int, balance: float
    ) -> None:
        self.model, self.start, self.integrator, self.time_step = model, start, integrator, time_step
        self.every, self.balance = every, balance
        self.remedy = integrator.remedy
        taking = model.taking
        if isinstance(integrator, Rosenbrock) and np.any(taking):
            self.integrator = WithDampers(integrator, taking)
        self.rows: list[Row] = []
        self.kept: list[tuple[Any, ...]] = []
        self.happened: list[Happened] = []

    def run(self, until: float) -> Run:
        """Follow the motion until a time."""
        for memory in self.model.memories:
            memory.begin(self.start)
        self.add(self.start)
        end: Phase | None = None
        # What diverges is refused, not warned of.
        with np.errstate(over="ignore", invalid="ignore"):
            try:
                watching = self.model.events or self.model.memories
                end = self.with_events(until) if watching else self.without_events(until)
                self.look()
            except UnbalancedError:
                raise
            except StepTooLargeError as error:
                raise StepTooLargeError(
                    f"{self.after}: {error}; the time step {self.time_step:g} is too long; {self.remedy}",
                    fault=error.fault,
                ) from None
            except MechanicsError as error:
                # Of what has diverged this says more.
                self.look()
                named = error.by_name(self.model.bodies.names) if isinstance(error, BodyError) else error
                raise MechanicsError(f"{self.after}: {named}", fault=error.fault) from None
            finally:
                for memory in self.model.memories:
                    memory.end(end)
        return Run(self.model, self.rows, tuple(self.happened), end, self.kept)

    @property
    def after(self) -> str:
        """When something has gone wrong."""
        return f"after time {self.rows[-1][0]:g}"

    def add(self, at: Phase) -> None:
        """Add a row."""
        jumps = sum(event.energy for event in self.happened)
        self.rows.append((at.time, at.q, at.qd, at.p, at.potential, at.work, jumps))
        if self.model.memories:
            self.kept.append(tuple(memory.kept for memory in self.model.memories))
        if len(self.rows) % _LOOK == 0:
            self.look()

    def look(self) -> None:
        """Look at the energy of the latest row."""
        time, *_, potential, _, _ = self.rows[-1]
        (_, before), (kinetic, after) = (self.unspent(self.rows[k]) for k in (0, -1))
        lack = after - before
        if abs(lack) <= self.balance * kinetic < np.inf:
            return
        # Perhaps there was more before: this row may be a turning point.
        largest = Run(self.model, self.rows, (), self.start).in_motion
        # What is held, and does not move, has rounding alone: of its weights times its size.
        size = abs(potential) + np.max(np.abs(self.start.torque * self.model.tree.units), initial=0.0)
        floor = 1e3 * np.finfo(float).eps * size
        if not (abs(lack) <= self.balance * largest + floor and np.isfinite(lack)):
            raise UnbalancedError(
                f"by time {time:g} the energy has changed by {lack:.3g}, of {largest:.3g} in motion, "
                f"without work: the time step {self.time_step:g} is too long; {self.remedy}"
            )

    def unspent(self, row: Row) -> tuple[float, float]:
        """Kinetic energy; energy less work and what events have given: it does not change."""
        _, _, qd, p, potential, work, jumps = row
        kinetic = 0.5 * float(p @ qd)
        return kinetic, kinetic + potential - float(np.sum(work)) - jumps

    def without_events(self, until: float) -> Phase:
        """Take steps as ``mechanisms.march`` does, in a loop that costs a hundredth of a step."""
        system, step, h, every = self.model.system, self.integrator.step, self.time_step, self.every
        append, at, count, look = self.rows.append, self.start, 0, every * _LOOK
        # Rounding of times adds up to less than a step: until near the end nothing need be compared.
        for count in range(1, int((until - at.time) / h) - 1):
            at = step(system, at, h)
            if count % every == 0:
                append((at.time, at.q, at.qd, at.p, at.potential, at.work, 0.0))
                if count % look == 0:
                    self.look()
        while (left := until - at.time) > _SAME * h:
            at = step(system, at, h if left > (1.0 + _SAME) * h else left)
            count += 1
            if count % every == 0:
                self.add(at)
        if count % every:
            self.add(at)
        return at

    def with_events(self, until: float) -> Phase:
        """Take steps until events, whose phases have rows, too."""
        model, at, count = self.model, self.start, 0
        watched = [event.watched(model.state, self.happened) for event in model.events]
        for memory in model.memories:
            memory.settle(at)
        for at, event in march(model.system, self.integrator, self.start, until, self.time_step, watched):
            for memory in model.memories:
                memory.settle(at)
            count += event is None
            if event is not None or count % self.every == 0:
                self.add(at)
        if self.rows[-1][0] != at.time:
            self.add(at)
        return at
