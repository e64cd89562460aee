"""A mechanism as built, and its simulation."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from protochain.arrays import Floats
from protochain.defaults import BALANCE
from protochain.errors import MechanicsError
from protochain.mechanisms.assemble import by_name
from protochain.mechanisms.bodies import Bodies, State
from protochain.mechanisms.elements import Conservative, Memory, Sum
from protochain.mechanisms.parts import Happening
from protochain.mechanisms.run import Run, carry_out
from protochain.motion import Drive, Event, Integrator, Load, Phase, RungeKutta4, System
from protochain.multibody import Tree


@dataclass(frozen=True, eq=False)
class Counted:
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
    loads : tuple of Counted
        Loads by name.
    drive : callable, optional
        Time -> coordinates, rates and accelerations of the driven hinges, in the order of the tree.
    events : tuple of Happening
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
    loads: tuple[Counted, ...] = ()
    drive: Drive | None = None
    events: tuple[Happening, ...] = ()
    inside: bool = False
    memories: tuple[Memory, ...] = ()

    @property
    def tree(self) -> Tree:
        """Rigid bodies."""
        return self.bodies.tree

    @property
    def directions(self) -> Floats:
        """(n_v, k) float: directions in which it can move, as columns: of all hinges that are not driven."""
        return np.eye(self.tree.n_v)[:, self.tree.undriven_v]

    @cached_property
    def system(self) -> System:
        """The mechanism as integrators see it."""
        more: dict[str, Any] = {} if self.drive is None else {"drive": self.drive}
        if self.loads:
            more["loads"] = tuple(each.load for each in self.loads)
        return System(self.tree, Sum(self.tree, self.conservative), **more)

    @property
    def works(self) -> tuple[str, ...]:
        """Names of what does work, in the order of ``Phase.work``."""
        return (*(each.name for each in self.loads), *(("drives",) if self.drive is not None else ()))

    def start(self) -> Phase:
        """Phase at the start.

        Raises
        ------
        MechanicsError
            If the pose is singular, or what an element gives is no number.
        """
        try:
            return self.system.at(self.q, self.qd)
        except MechanicsError as error:
            raise MechanicsError(self.said(str(error))) from None

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
    ) -> Run:
        """Follow the motion.

        Parameters
        ----------
        until : float
            Time of the end.
        time_step : float
            Longest step.
        integrator : Integrator, optional
            By default :class:`protochain.motion.RungeKutta4`. ``DormandPrince()`` keeps a tolerance;
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
        integrator, start = integrator or RungeKutta4(), start or self.start()
        return carry_out(self, until, time_step, integrator, every, start, balance)

    def said(self, message: str) -> str:
        """Return a message with the names of bodies in place of their numbers."""
        return by_name(message, self.bodies.names)

    def watched(self, gains: list[tuple[float, str, float]]) -> tuple[Event, ...]:
        """Return events for :func:`protochain.motion.march`, which add time, name and gain to a list."""
        return tuple(self._event(happening, gains) for happening in self.events)

    def _event(self, happening: Happening, gains: list[tuple[float, str, float]]) -> Event:
        said = f'event "{happening.name}"'

        def value(at: Phase) -> float:
            found = float(happening.value(self.state(at)))
            if np.isnan(found):
                raise MechanicsError(f"{said}: its value is not a number at time {at.time:g}")
            return found

        def jump(system: System, at: Phase) -> Phase:
            qd = happening.jump(self.state(at))
            after = at
            if qd is not None:
                qd = np.array(qd, dtype=float)
                if qd.shape != (self.tree.n_v,) or not np.all(np.isfinite(qd)):
                    raise MechanicsError(
                        f"{said}: its jump must give {self.tree.n_v} finite velocities, or None to go on"
                    )
                after = system.with_velocities(at, qd)
            gains.append((at.time, happening.name, after.kinetic - at.kinetic))
            return after

        return Event(happening.name, value, jump, happening.passes)
