"""Systems with bodies that bend, for the integrators of any equations of motion."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from protochain.core.arrays import Floats, read_only
from protochain.core.errors import MechanicsError
from protochain.mechanics.motion.system import Equations, Load
from protochain.mechanics.multibody.rotations import displacement_rates
from protochain.mechanisms.flexible import dynamics as flexible_dynamics
from protochain.mechanisms.flexible.flexible import Bent, Flexible, bend, elastic, integrate


@dataclass(frozen=True, eq=False)
class BendingSystem(Equations):
    """Bodies of which some bend, in a potential in addition to their elastic energy, under loads.

    ``flexible.Flexible`` defines coordinates and freedoms. Potentials and
    loads get ``flexible.Bent`` for factors and frames, and loads may give wrenches
    (nn, 6) on all nodes. Runge-Kutta and Rosenbrock methods accept it.
    """

    flexible: Flexible = field(kw_only=True)  # Bodies, on the hinges of ``tree``.

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.flexible.tree is not self.tree:
            raise MechanicsError("give bodies that bend, on the tree of the system")

    @property
    def n_v(self) -> int:
        """Number of freedoms."""
        return self.flexible.n_v

    @cached_property
    def units(self) -> Floats:
        """(n_v,) float: units. For amplitudes, a section moves by the tree's size, or turns by a radian."""
        return read_only(np.concatenate([self.tree.units, self._of_shapes]))

    @cached_property
    def coordinate_units(self) -> Floats:
        """(n_q,) float: as :attr:`units`, of each coordinate."""
        return read_only(np.concatenate([self.tree.coordinate_units, self._of_shapes]))

    @cached_property
    def _of_shapes(self) -> Floats:
        amounts = [
            np.maximum(np.abs(s.moves).max(axis=(0, 1)) / self.tree.size, np.abs(s.turns).max(axis=(0, 1)))
            for s in self.flexible.shapes
            if s is not None
        ]
        return 1.0 / np.concatenate([np.zeros(0), *amounts])

    def factors(self, q: Floats) -> Any:
        """Frames of all nodes at q (n_q,)."""
        return bend(self.flexible, q)

    def forces(self, time: float, q: Floats, qd: Floats, factors: Any) -> tuple[float, Floats, Floats | None]:
        """Potential and elastic energy, torques (n_v,) of these and the loads, and of each load alone."""
        potential, torque, loads = super().forces(time, q, qd, factors)
        energy, bending = elastic(self.flexible, q)
        return potential + energy, torque + bending, loads

    def momenta(self, factors: Any, qd: Floats) -> Floats:
        """Momenta (n_v,) of velocities."""
        return flexible_dynamics.multiply_mass(self.flexible, factors, qd)

    def along(self, load: Load, time: float, q: Floats, qd: Floats, factors: Any) -> Floats:
        """Torques (n_v,) of a load."""
        bent: Bent = factors
        wrenches, torques = load.applied(time, q, qd, factors)
        out = np.zeros(self.n_v)
        if wrenches is not None:
            out = flexible_dynamics.pull_back(self.flexible, bent, wrenches)
        return out if torques is None else out + torques

    def forward_dynamics(self, q: Floats, qd: Floats, tau: Floats) -> Floats:
        """Accelerations (n_v,) under torques, with the prescribed ones at driven hinges."""
        return flexible_dynamics.forward_dynamics(self.flexible, q, qd, tau)

    def inverse_dynamics(self, q: Floats, qd: Floats, qdd: Floats) -> Floats:
        """Torques (n_v,) of accelerations."""
        return flexible_dynamics.inverse_dynamics(self.flexible, q, qd, qdd)

    def integrate(self, q: Floats, move: Floats) -> Floats:
        """Coordinates (n_q,) after a displacement (n_v,)."""
        return integrate(self.flexible, q, move)

    def displacement_rates(self, move: Floats, qd: Floats) -> Floats:
        """Rates (n_v,) of a displacement, for velocities at its end."""
        rigid, out = self.tree.n_v, qd.copy()
        out[:rigid] = displacement_rates(self.tree, move[:rigid], qd[:rigid])
        return out
