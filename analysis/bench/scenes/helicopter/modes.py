"""Mechanisms whose hinges move together, in a few shapes: beams of segments in their lowest modes.

The velocities are those of the shapes, qd = B a', and so are the forces: with M qdd + c = tau of all hinges,
B^T M B a'' = B^T (tau - c). The shapes are of angles, so that a beam that bends is shortened as it must be,
and its elastic energy stays exact. No high frequency is left that would ask for short steps.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve, eigh

from protochain.core.arrays import Floats, read_only
from protochain.core.checks import brief
from protochain.core.errors import MechanicsError
from protochain.mechanics import multibody
from protochain.mechanics.motion import Equations, Phase
from protochain.mechanics.multibody.articulated import Articulated
from protochain.mechanisms.elements import Sum
from protochain.mechanisms.hinge_springs import Torsions
from protochain.mechanisms.linear_springs import STIFFNESS
from protochain.mechanisms.model import Model

_PARALLEL = 1e-9
"""Largest part of the start's velocities that no shape has, of their size."""


@dataclass(frozen=True, eq=False)
class ReducedSystem(Equations):
    """Equations of motion along some directions only.

    directions (n_v, k): Columns that span the velocities, none of them of driven hinges.
    """

    directions: Floats = field(kw_only=True)

    def accelerations(
        self,
        time: float,
        q: Floats,
        qd: Floats,
        torque: Floats,
        loads: Floats | None,
        factors: Articulated,
    ) -> tuple[Floats, Floats | None]:
        """Accelerations (n_v,) under torques (n_v,); the loads, the torques of the drive as their last."""
        tree, b = self.tree, self.directions
        given = np.zeros(tree.n_v)
        if self.drive is not None:
            given[tree.driven_v] = self._drive(time)[2]
        lacking = torque - multibody.inverse_dynamics(tree, q, qd, given)
        mass = multibody.mass_matrix(tree, factors.frames) @ b
        try:
            factor = cho_factor(b.T @ mass, check_finite=False)
        except LinAlgError:
            raise MechanicsError("the mass matrix is not positive definite") from None
        amplitude = cho_solve(factor, b.T @ lacking, check_finite=False)
        qdd = given + b @ amplitude
        if self.drive is None:
            return qdd, loads
        driving = np.zeros(tree.n_v)
        driving[tree.driven_v] = (mass @ amplitude - lacking)[tree.driven_v]
        return qdd, np.vstack([driving] if loads is None else [*loads[: len(self.loads)], driving])


@dataclass(frozen=True, eq=False)
class ReducedModel(Model):
    """Model that moves along some directions only, made by :func:`in_modes`; its other fields are a model's.

    shapes (n_v, k): Directions.
    """

    shapes: Floats = field(kw_only=True)

    def directions_at(self, at: Phase) -> Floats:
        """(n_v, k) float: directions in which it can move, as columns, the same at each phase."""
        return self.shapes

    @cached_property
    def system(self) -> Equations:
        """The mechanism as integrators see it."""
        loads = tuple(each.load for each in self.loads)
        potential = Sum(self.tree, self.conservative)
        return ReducedSystem(self.tree, potential, loads=loads, drive=self.drive, directions=self.shapes)


def in_modes(model: Model, groups: Iterable[tuple[Sequence[str], int]]) -> ReducedModel:
    """Let groups of hinges move in their lowest modes only."""
    if model.bodies.joints is not None:
        raise MechanicsError("loops do not close on bodies that bend in modes; take add_beam()")
    tree = model.tree
    springs = _stiffness(model)
    mass = multibody.mass_matrix(tree, multibody.pose(tree, model.q))
    left, columns = list(tree.undriven_v), []
    for hinges, count in groups:
        freedoms = [model.bodies.freedom(name)[1] for name in hinges]
        for name, freedom in zip(hinges, freedoms, strict=True):
            if freedom not in left:
                raise MechanicsError(f'hinge "{name}" cannot be in a group: it is driven, or in another')
            if springs[freedom] == 0.0:
                raise MechanicsError(f'hinge "{name}" has no spring, and so no mode; give it a torsion')
            left.remove(freedom)
        if not isinstance(count, int) or not 0 <= count <= len(hinges):
            raise MechanicsError(
                f'{brief(count)} modes of {len(hinges)} hinges, the first "{hinges[0]}": give a whole number '
                f"from 0 to {len(hinges)}"
            )
        if count:
            found = eigh(np.diag(springs[freedoms]), mass[np.ix_(freedoms, freedoms)])[1][:, :count]
            shapes = np.zeros((tree.n_v, count))
            shapes[freedoms] = found
            columns.append(shapes)
    shapes = np.hstack([np.eye(tree.n_v)[:, left], *columns])
    own = model.qd.copy()
    own[tree.driven_v] = 0.0
    across = own - shapes @ np.linalg.lstsq(shapes, own, rcond=None)[0]
    if np.max(np.abs(across), initial=0.0) > _PARALLEL * np.max(np.abs(own), initial=0.0):
        raise MechanicsError("at the start hinges move otherwise than in their modes; take more of them")
    given: dict[str, Any] = {each.name: getattr(model, each.name) for each in fields(Model)}
    return ReducedModel(**given, shapes=read_only(shapes))


def _stiffness(model: Model) -> Floats:
    """(n_v,) float: stiffness of the springs on the hinges."""
    out = np.zeros(model.tree.n_v)
    for part in model.conservative:
        if isinstance(part, Torsions):
            np.add.at(out, part.freedoms, part.constants[:, STIFFNESS])
    return out
