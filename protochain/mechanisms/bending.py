"""Mechanisms of which some bodies bend by shapes: the equations of motion of a model, and its start."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.checks import brief
from protochain.core.errors import MechanicsError
from protochain.mechanics.motion import Phase
from protochain.mechanics.multibody import Frames
from protochain.mechanisms.elements import Conservative, Gravity
from protochain.mechanisms.flexible import Flexible, Shapes
from protochain.mechanisms.flexible.dynamics import pull_back
from protochain.mechanisms.flexible.equations import BendingSystem
from protochain.mechanisms.model import Model


def bending(model: Model, shapes: Mapping[str, Shapes]) -> tuple[BendingSystem, Phase]:
    """Let bodies of a mechanism bend.

    Parameters
    ----------
    model : Model
        The mechanism as built. Bodies that bend have mass and inertia of their shapes.
    shapes : mapping of str to Shapes
        Shapes of bodies by name, in the bodies' own axes, as of :func:`assumed_modes`. A body whose hinge is
        on one of these rides on the section that is nearest to the hinge.

    Returns
    -------
    BendingSystem, Phase
        Equations of motion, for ``step`` of Runge-Kutta, Dormand-Prince and Rosenbrock, and the start, with
        all bodies straight. Loads may be added by ``dataclasses.replace(system, loads=...)``. For Hamilton's
        equations, ``flexible.canonical_rates(system.flexible, at.q, at.p, at.torque)``.

    Raises
    ------
    MechanicsError
        If the body is unknown. If the mechanism has loops, or loads, dampers, events and contacts that
        lose energy, which see rigid bodies. While it moves, if an element acts on a body that bends: let it
        act on a rigid one, fixed to a section.
    """
    bodies, tree = model.bodies, model.tree
    if bodies.joints is not None:
        raise MechanicsError(
            "flexible bodies do not support closed loops; close them by springs "
            "between rigid bodies that are fixed to their sections"
        )
    if model.loads or model.events or model.memories:
        raise MechanicsError(
            "loads, dampers, friction and events apply to rigid bodies only; remove them, and set loads of "
            "flexible bodies by dataclasses.replace(system, loads=...)"
        )
    shapes_of: list[Shapes | None] = [None] * tree.n_bodies
    for name, sections in shapes.items():
        b = bodies.number(name, "bending")
        if b < 0 or not isinstance(sections, Shapes):
            raise MechanicsError(
                f'bending: "{name}": {brief(sections)}: give Shapes of a body, as assumed_modes()'
            )
        shapes_of[b] = _rotate(sections, bodies.turn[b].T)
    section = np.full(tree.n_bodies, -1)
    for b, p in enumerate(tree.parent):
        carrier = shapes_of[p] if p >= 0 else None
        if carrier is not None:
            section[b] = np.argmin(np.linalg.norm(carrier.place - tree.offset[b], axis=1))
    flexible = Flexible(tree, tuple(shapes_of), section)
    gravity = [part.acceleration for part in model.conservative if isinstance(part, Gravity)]
    parts = [part for part in model.conservative if not isinstance(part, Gravity)]
    forces = _Forces(model, flexible, sum(gravity, np.zeros(3)), parts)
    system = BendingSystem(tree, forces, drive=model.drive, flexible=flexible)
    straight = np.zeros(flexible.n_v - tree.n_v)
    return system, system.at(np.append(model.q, straight), np.append(model.qd, straight))


@dataclass(frozen=True, eq=False)
class _Forces:
    """Potential of a model's elements, which act on rigid bodies, and of the weight of all nodes."""

    model: Model
    flexible: Flexible
    gravity: Floats
    parts: Sequence[Conservative]

    def __call__(self, q: Floats, bent: Any) -> tuple[float, Floats]:
        """Energy and torques (n_v,)."""
        flexible, tree = self.flexible, self.flexible.tree
        mass, body = flexible.sections.mass, flexible.node_start[:-1]
        wrenches, torques = np.zeros((tree.n_bodies, 6)), np.zeros(tree.n_v)
        frames = Frames(bent.rotation[body], bent.origin[body])
        energy = -float(mass @ (bent.origin @ self.gravity))
        for part in self.parts:
            energy += part.add(q[: tree.n_q], frames, wrenches, torques)
        for b in np.flatnonzero(np.any(wrenches, axis=1)):
            if flexible.shapes[b] is not None:
                raise MechanicsError(
                    f'a load acts on "{self.model.bodies.names[b]}", which is flexible; fix a body to its '
                    "section by a hinge of kind fixed, and apply the load there"
                )
        nodes = np.concatenate([np.zeros((len(mass), 3)), mass[:, None] * self.gravity], axis=1)
        nodes[body] += wrenches
        pulled = pull_back(flexible, bent, nodes)
        pulled[: tree.n_v] += torques
        return energy, pulled


def _rotate(shapes: Shapes, turn: Floats) -> Shapes:
    """Shapes along other axes: vectors v become turn v."""
    return Shapes(
        shapes.place @ turn.T, shapes.mass, turn @ shapes.inertia @ turn.T,
        np.einsum("ij,njk->nik", turn, shapes.moves), np.einsum("ij,njk->nik", turn, shapes.turns),
        np.einsum("ij,njkl->nikl", turn, shapes.shortening), shapes.stiffness,
    )  # fmt: skip
