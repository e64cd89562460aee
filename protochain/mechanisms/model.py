"""A mechanism as built, and its simulation."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from protochain.core.checks import brief
from protochain.core.defaults import BALANCE
from protochain.core.errors import BodyError, Fault, MechanicsError
from protochain.core.settings import document_fields
from protochain.mechanics.motion import DormandPrince, Integrator, Phase, RungeKutta4, StepTooLargeError
from protochain.mechanics.multibody import HingeKind
from protochain.mechanics.multibody.tree import ARMATURE
from protochain.mechanisms.assembly import Assembly, NamedLoad, Row
from protochain.mechanisms.bodies import Bodies
from protochain.mechanisms.closing import closing
from protochain.mechanisms.elements import Acting, Gravity, damping, join_rows
from protochain.mechanisms.event import Event, Happened, march
from protochain.mechanisms.explicit import InOneKernel
from protochain.mechanisms.hinge_friction import friction
from protochain.mechanisms.motors import Driven, check_drive, drive_of
from protochain.mechanisms.run import ROUNDED, Run

_LOOK = 256
"""Rows from one look at the balance of energy to the next."""
_MOST_ROWS = 1e7
"""Rows of a run: of each some hundred bytes at least, and thousands with many bodies."""
_MOST_STEPS = 1e10
"""Steps of a run: of ten microseconds at least, so that these need a day."""
_SAME = 1e-9
"""Difference of times that is none, relative to the time step."""


@document_fields
@dataclass(frozen=True, eq=False)
class Model(Assembly):
    """Mechanism that no later change reaches, made by :meth:`Mechanism.build`."""

    def simulate(
        self,
        until: float,
        time_step: float,
        integrator: Integrator | None = None,
        every: int = 1,
        start: Phase | None = None,
        balance: float = BALANCE,
    ) -> Run:
        """Follow the motion.

        Parameters
        ----------
        until : float
            Time of the end.
        time_step : float
            Longest step.
        integrator : Integrator, optional
            By default ``motion.RungeKutta4``. ``DormandPrince()`` adapts its substeps to a tolerance.
            ``Rosenbrock()`` too, with any damper, however stiff. It damps vibrations below the tolerance.
            ``ImplicitMidpoint()`` conserves their energy, not their phase.
        every : int
            Steps from one row of the result to the next. Events and the end have further rows.
        start : Phase, optional
            Phase from which to go on, as :attr:`Run.end`.
        balance : float
            Largest permitted change of energy without work, relative to the largest in motion.

        Returns
        -------
        Run
            The motion, its table and audit.

        Raises
        ------
        StepTooLargeError
            If the time step is too long for the integrator: energy comes from nothing, or a step has no end.
        MechanicsError
            If an argument, or a result of an element, is not a number.
        """
        start = self.start() if start is None else start
        if not isinstance(start, Phase):
            raise MechanicsError(f"start {brief(start)}: give a phase, as the end of a run")
        for name, value, least in (("until", until, start.time), ("time_step", time_step, 0.0)):
            if not (isinstance(value, int | float | np.floating) and least < value < np.inf):
                raise MechanicsError(f"{name} {brief(value)}: give a finite number above {least:g}")
        if not (isinstance(every, int) and every >= 1):
            raise MechanicsError(f"every {brief(every)}: give a whole number from 1")
        chosen = RungeKutta4() if integrator is None else integrator
        # Of a Protocol there are no instances, but of a class that derives from it.
        if Integrator not in type(chosen).__mro__:
            label = f"{chosen.__name__}, a class" if isinstance(chosen, type) else brief(chosen)
            raise MechanicsError(f"integrator {label}: give one, as RungeKutta4() or DormandPrince(1e-9)")
        if not start.is_finite:
            raise MechanicsError(
                "energy or forces at the start are not finite; check functions of loads and forces"
            )
        if not (isinstance(balance, int | float) and balance > 0.0):
            raise MechanicsError(f"balance {brief(balance)}: give a number above 0, as inf to accept any")
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
    bodies: Bodies, elements: Sequence[Any], drives: Sequence[Driven], events: tuple[Event, ...]
) -> Model:
    """Return a model of bodies and all that acts on them."""
    tree, acting = bodies.tree, {}
    for element in elements:
        part = element.bind(bodies)
        if not isinstance(part, Acting):
            part = Acting()
        if part.conservative is part.load is part.damping is part.friction is None:
            raise element.refusal("its bind() returns an empty Acting; set one field")
        acting[element.name] = part
    weight = [Gravity(tree, bodies.gravity)] if np.any(bodies.gravity) else []
    damped = join_rows(act.damping for act in acting.values() if act.damping)
    loads = [NamedLoad("damping", damping(tree, damped), dissipates=True)] if damped else []
    loads += [
        NamedLoad(name, act.load, act.dissipates, act.hinges) for name, act in acting.items() if act.load
    ]
    is_fixed = np.any((tree.parent < 0) & ((tree.kind != HingeKind.FREE) | (tree.bodies[:, ARMATURE] > 0.0)))
    on_world = bodies.joints is not None and bool(np.any(bodies.joints.body < 0))
    model = Model(
        bodies, bodies.q, bodies.qd,
        (*weight, *join_rows(act.conservative for act in acting.values() if act.conservative)), tuple(loads),
        drive_of(bodies, drives) if drives else None, events,
        not weight and not is_fixed and not on_world and all(act.inside for act in acting.values()),
        tuple(act.memory for act in acting.values() if act.memory),
    )  # fmt: skip
    rubbing = [act.friction for act in acting.values() if act.friction]
    if not rubbing:
        return model
    rubs = NamedLoad("hinge friction", friction(model, rubbing), dissipates=True)
    return replace(model, loads=(*model.loads, rubs))


class UnbalancedError(StepTooLargeError):
    """Energy has come from nothing, or gone nowhere, so that a time step is too long."""


class _Simulation:
    """A run as it comes: its rows, with a look at the energy now and then."""

    def __init__(
        self, model: Model, start: Phase, integrator: Integrator, time_step: float, steps: int, balance: float
    ) -> None:
        self.model, self.start, self.integrator, self.time_step = model, start, integrator, time_step
        self.stride, self.balance = steps, balance
        self.remedy = integrator.remedy
        self.rows: list[Row] = []
        self.kept: list[tuple[Any, ...]] = []
        self.happened: list[Happened] = []

    def run(self, until: float) -> Run:
        """Follow the motion until a time."""
        for memory in self.model.memories:
            memory.begin(self.start)
        self.add(self.start)
        end: Phase | None = None
        # Divergence raises an error, not a warning.
        with np.errstate(over="ignore", invalid="ignore"):
            try:
                watching = self.model.events or self.model.memories
                end = self.with_events(until) if watching else self.without_events(until)
                self.look()
                self.look(self.worst)
            except UnbalancedError:
                raise
            except StepTooLargeError as error:
                self.check_dead_points()
                raise StepTooLargeError(
                    f"{self.after}: {error}; the time step {self.time_step:g} is too long; {self.remedy}",
                    fault=error.fault,
                ) from None
            except MechanicsError as error:
                # Of what has diverged this says more.
                self.look()
                cause = error.by_name(self.model.bodies.names) if isinstance(error, BodyError) else error
                raise MechanicsError(f"{self.after}: {cause}", fault=error.fault) from None
            finally:
                for memory in self.model.memories:
                    memory.end(end)
        return Run(self.model, self.rows, tuple(self.happened), end, self.kept)

    def check_dead_points(self) -> None:
        """Raise if drives would move loops beyond their closure before the next row."""
        system, (time, q, qd, *_) = self.model.system, self.rows[-1]
        bodies, joints = self.model.bodies, self.model.bodies.joints
        if joints is None or self.model.drive is None:
            return
        for _ in range(self.stride):
            time += self.time_step
            closed = closing(bodies, joints, system.driven_to(time, q, qd)[0])
            if closed is None:
                raise MechanicsError(
                    f"{self.after}: the drive moves a loop beyond a dead point, so that it does not close at "
                    f"time {time:g}; end the drive before, or drive a hinge that turns freely",
                    fault=Fault.OPEN,
                )
            q = closed

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

    @property
    def worst(self) -> int:
        """Row whose energy differs most from the energy at the start."""
        run = Run(self.model, self.rows, (), self.start)
        lack = run.total - np.sum(run.work, axis=1) - run.jumps
        return int(np.argmax(np.abs(lack - lack[0])))

    def look(self, row: int = -1) -> None:
        """Look at the energy of a row, by default the latest."""
        time = self.rows[row][0]
        (_, before), (kinetic, after) = (self.unspent(self.rows[k]) for k in (0, row))
        lack = after - before
        if abs(lack) <= self.balance * kinetic < np.inf:
            return
        # Perhaps there was more before: this row may be a turning point.
        run = Run(self.model, self.rows, (), self.start)
        largest = run.in_motion
        # Forces may lose energy in displacements of 30 tolerances of the integrator per step.
        # This counts if bodies creep or rest more than they move, as a block that friction holds on a slope.
        steps = (time - self.start.time) / self.time_step
        work = float(np.sum(self.start.effort * self.model.tree.units))
        lost = 30.0 * getattr(self.integrator, "tolerance", 0.0) * steps * work
        allowed = self.balance * largest + ROUNDED * run.stored_energy + lost
        if not (abs(lack) <= allowed and np.isfinite(lack)):
            raise UnbalancedError(
                f"by time {time:g} the energy has changed by {lack:.3g}, of {largest:.3g} in motion, "
                f"without work: the time step {self.time_step:g} is too long; {self.remedy}"
            )

    def unspent(self, row: Row) -> tuple[float, float]:
        """Kinetic energy, and the constant energy: energy less work and the energy given by events."""
        _, _, qd, p, potential, work, jumps = row
        kinetic = 0.5 * float(p @ qd)
        return kinetic, kinetic + potential - float(np.sum(work)) - jumps

    def without_events(self, until: float) -> Phase:
        """March as :func:`march` does, many steps in one kernel if possible."""
        system, step, h, stride = self.model.system, self.integrator.step, self.time_step, self.stride
        at, count, look = self.start, 0, stride * _LOOK
        # Rounding of times adds up to less than a step: until near the end nothing need be compared.
        n = int((until - at.time) / h) - 2
        if isinstance(system, InOneKernel) and isinstance(self.integrator, RungeKutta4 | DormandPrince):
            while count < n:
                rows, at, n_taken = system.march(self.integrator, at, h, min(look, n - count), stride)
                self.rows += rows
                count += n_taken
                if n_taken < look:
                    break
                self.look()
        while (left := until - at.time) > _SAME * h:
            at = step(system, at, h if left > (1.0 + _SAME) * h else left)
            count += 1
            if count % stride == 0:
                self.add(at)
        if count % stride:
            self.add(at)
        return at

    def with_events(self, until: float) -> Phase:
        """Take steps until events, whose phases have rows, too."""
        model, at, count = self.model, self.start, 0
        watched = [event.watch(model.state, self.happened) for event in model.events]
        for memory in model.memories:
            memory.settle(at)
        for at, event in march(model.system, self.integrator, self.start, until, self.time_step, watched):
            for memory in model.memories:
                memory.settle(at)
            count += event is None
            if event is not None or count % self.stride == 0:
                self.add(at)
        if self.rows[-1][0] != at.time:
            self.add(at)
        return at
