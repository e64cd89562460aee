"""Mechanisms as MJCF, such that MuJoCo moves them as they move here.

Mechanisms, which stand on this, are Any here.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.errors import MechanicsError
from protochain.core.storage import write_text
from protochain.mechanics.multibody.tree import is_inertia
from protochain.mechanisms.assemble import Body, Hinge, quaternion
from protochain.mechanisms.bodies import WORLD
from protochain.mechanisms.bushing import Bushing
from protochain.mechanisms.closing import Closing
from protochain.mechanisms.elements import Between, Named
from protochain.mechanisms.hinge_friction import HingeFriction
from protochain.mechanisms.hinge_springs import Stop, Torsion
from protochain.mechanisms.linear_springs import Spring

_JOINTS = {"revolute": "hinge", "prismatic": "slide", "ball": "ball"}
_LOOPS = {"spherical": "connect", "rigid": "weld"}
_LEAST = 2e-15
"""Mass and moments of inertia that a moving body has in MJCF at least: twice what MuJoCo asks for."""
_SAME = 1e-12
"""Difference of directions and places that is rounding."""


def mjcf(mechanism: Any, path: str | Path | None = None) -> str:
    """Write bodies, hinges, springs, torsions, constant friction, limits, balls and welds as MJCF.

    MuJoCo has the same mass matrix and accelerations. A body without mass that carries one other becomes
    a joint of that one. One that carries several gets a mass and moments of 2e-15, as MuJoCo needs 1e-15.
    So do moments of rods and points. The largest moment of a flat body is less by 1e-15 of it at most. A
    body whose inertia no body has is one with the bodies that are fixed to it.

    Parameters
    ----------
    path : str or Path, optional
        Where to write it.

    Returns
    -------
    str
        The text. Coordinates begin at zero. MuJoCo's stops and loops are softened as MuJoCo defines.

    Raises
    ------
    MechanicsError
        If an element is of a kind that MJCF does not have, or an inertia one that MuJoCo refuses.
    """
    root = _Writing(mechanism).root
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    if path is not None:
        write_text(Path(path), text)
    return text


class _Placed(NamedTuple):
    """A hinge of a body, as seen from the body that carries its chain of hinges."""

    hinge: Hinge
    at: Floats  # (3,): Place of the hinge.
    axis: Floats  # (3,): Its axis.
    turn: Floats  # (3, 3): Axes of its child, as columns.


class _Writing:
    """A mechanism on its way into MJCF."""

    def __init__(self, mechanism: Any) -> None:
        self.of, self.bodies, self.root = mechanism, mechanism.build().bodies, Element("mujoco")
        SubElement(
            self.root, "compiler", angle="radian", autolimits="true", balanceinertia="false", eulerseq="XYZ"
        )
        SubElement(self.root, "option", gravity=_text(self.bodies.gravity), integrator="RK4")
        self.elements = {WORLD: SubElement(self.root, "worldbody")}
        self.joints: dict[str, Element] = {}  # Of hinges, and of free bodies, by name.
        self.inward = {hinge.child: hinge for hinge in mechanism.parts(Hinge)}
        bodies = _merge_nominal({body.name: body for body in mechanism.parts(Body)}, self.inward)
        carriers = self.carriers(bodies)
        for name in self.bodies.names:
            if name in bodies and name not in carriers:
                self.write_body(bodies[name], carriers)
        self.write_the_rest()

    def carriers(self, bodies: dict[str, Body]) -> set[str]:
        """Bodies without mass that carry one other: bodies of MJCF have several joints instead."""
        children = [hinge.parent for hinge in self.of.parts(Hinge)]
        joined = (part for part in self.of.parts(Between) if not self.is_ball(part))
        ends = {end for part in joined for end, _ in (part.a, part.b)}
        carriers = {
            name
            for name, body in bodies.items()
            if body.mass == 0.0 and not np.any(body.inertia) and children.count(name) == 1
            and name not in ends and name in self.inward
        }  # fmt: skip
        # The coordinates of a ball are along the axes of its child, which the last body has to share.
        for name in self.bodies.names:
            if name in bodies and name not in carriers:
                chain = self.chain(name, carriers)
                for part in chain[:-1]:
                    if part.hinge.kind == "ball" and not np.allclose(part.turn, chain[-1].turn, atol=_SAME):
                        carriers.discard(part.hinge.child)
        return carriers

    def is_ball(self, element: Between) -> bool:
        """Whether an element is a bushing at a ball."""
        hinge = self.inward.get(element.a[0]) if isinstance(element, Bushing) else None
        return hinge is not None and hinge.kind == "ball" and hinge.parent == element.b[0]

    def chain(self, name: str, carriers: set[str]) -> list[_Placed]:
        """Hinges from the next body inward that has an element, at q = 0."""
        hinges = [self.inward[name]] if name in self.inward else []
        while hinges and hinges[0].parent in carriers:
            hinges.insert(0, self.inward[hinges[0].parent])
        at, turn = np.zeros(3), np.eye(3)
        out: list[_Placed] = []
        for hinge in hinges:
            at, axis, turn = at + turn @ hinge.at, turn @ hinge.axis, turn @ hinge.rotation
            out.append(_Placed(hinge, at, axis, turn))
        return out

    def write_body(self, body: Body, carriers: set[str]) -> None:
        """Write a body with its joints."""
        chain, moves = self.chain(body.name, carriers), False
        parent = chain[0].hinge.parent if chain else WORLD
        at, turn = self.bodies.built.point(body.name), body.rotation
        if chain:
            at, turn = chain[-1].at, chain[-1].turn
        turn = np.eye(3) if turn is None else turn
        element = self.elements[body.name] = SubElement(
            self.elements[parent], "body", name=body.name, pos=_text(at), quat=_text(quaternion(turn))
        )
        if not chain:
            self.write_joint(element, body.name, "free", body.armature)
        for hinge, place, axis, _ in chain:
            if hinge.kind == "fixed":
                continue
            if hinge.kind not in _JOINTS:
                raise hinge.refusal(f"MJCF has no {hinge.kind}; remove it")
            moves = True
            joint = self.write_joint(element, hinge.name, _JOINTS[hinge.kind], hinge.armature)
            if place is not at:
                joint.set("pos", _text(turn.T @ (place - at)))
            if hinge.kind != "ball":
                joint.set("axis", _text(turn.T @ axis))
        _weigh(element, body, moves or not chain)

    def write_joint(self, body: Element, name: str, kind: str, armature: float) -> Element:
        """Write a joint of a body."""
        joint = self.joints[name] = SubElement(body, "joint", name=name, type=kind)
        if armature:
            joint.set("armature", _text(armature))
        return joint

    def write_the_rest(self) -> None:
        """Write what acts, and what closes loops."""
        writers: dict[type, Callable[[Any], None]] = {
            Torsion: self.write_torsion, HingeFriction: self.write_friction, Stop: self.write_stop,
            Spring: self.write_spring, Closing: self.write_closing, Bushing: self.write_bushing,
        }  # fmt: skip
        for part in self.of.parts(Named):
            if isinstance(part, Body | Hinge):
                continue
            if type(part) not in writers:
                raise part.refusal("MJCF does not support it; remove it")
            writers[type(part)](part)

    def set_of(self, label: str, joint: str, **values: float) -> None:
        """Set what an element gives to its joint, which nothing else may have set."""
        for key, value in values.items():
            if value and self.joints[joint].get(key) is not None:
                raise MechanicsError(
                    f'{label}: hinge "{joint}" has a {key} already; join them in one element'
                )
            if value:
                self.joints[joint].set(key, _text(value))

    def write_torsion(self, of: Torsion) -> None:
        """Write a spring, a damper, or both."""
        built = float(self.bodies.q[self.bodies.freedom(of.hinge)[0]])
        rest_angle = built if of.rest is None else float(of.rest * self.bodies.unit(of.hinge))
        rest_angle = rest_angle if of.stiffness else 0.0
        self.set_of(of.label, of.hinge, stiffness=of.stiffness, damping=of.damping, springref=rest_angle)

    def write_friction(self, friction: HingeFriction) -> None:
        """Write a constant friction."""
        if friction.coefficient or friction.damping:
            raise friction.refusal("MJCF has constant friction only; move its damping to a torsion")
        self.set_of(friction.label, friction.hinge, frictionloss=friction.torque)

    def write_stop(self, stop: Stop) -> None:
        """Write limits."""
        limits = np.array([stop.low, stop.high]) * self.bodies.unit(stop.hinge)
        self.joints[stop.hinge].set("range", _text(limits))

    def write_site(self, name: str, body: str, at: Any, turn: Floats) -> str:
        """Write a point of a body, with axes as columns. Return its name."""
        SubElement(self.elements[body], "site", name=name, pos=_text(at), quat=_text(quaternion(turn)))
        return name

    def write_spring(self, of: Spring) -> None:
        """Write a spring between two points, as a tendon."""
        built = np.linalg.norm(self.bodies.built.point(*of.a) - self.bodies.built.point(*of.b))
        rest_length = built if of.rest is None else of.rest
        values = {"stiffness": of.stiffness, "damping": of.damping, "springlength": rest_length}
        line = SubElement(
            self.group("tendon"), "spatial", {"name": of.name, **{key: _text(x) for key, x in values.items()}}
        )
        for end, (body, at) in zip("ab", (of.a, of.b), strict=True):
            SubElement(line, "site", site=self.write_site(f"{of.name}: {end}", body, at, np.eye(3)))

    def write_closing(self, joint: Closing) -> None:
        """Close a loop between sites: so it is as it is here, wherever MuJoCo's coordinates begin."""
        if joint.kind not in _LOOPS:
            raise joint.refusal(f"MJCF closes loops by ball and rigid only, not by {joint.kind}; choose one")
        turn = np.eye(3)
        if joint.kind == "rigid":
            built = self.bodies.built.rotation(joint.a[0]).T @ self.bodies.built.rotation(joint.b[0])
            turn = built if joint.rotation is None else joint.rotation
        sites = {
            f"site{k + 1}": self.write_site(f"{joint.name}: {'ab'[k]}", *end, axes)
            for k, (end, axes) in enumerate(((joint.a, turn), (joint.b, np.eye(3))))
        }
        SubElement(self.group("equality"), _LOOPS[joint.kind], {"name": joint.name, **sites})

    def write_bushing(self, of: Bushing) -> None:
        """Write spring and damper of a ball, or of a free body."""
        (a, at), (b, at_b) = of.a, of.b
        hinge, free = self.inward.get(a), a not in self.inward and b == WORLD
        fits, alike = (free or self.is_ball(of)) and not np.any(at), np.repeat([1.0, float(free)], 3)
        if fits:
            place, turn = self.bodies.built.point(a), self.bodies.built.rotation(a)
            if hinge is not None:
                place, turn = hinge.at, hinge.rotation
            rest_rotation = turn.T if of.rotation is None else of.rotation
            fits = np.allclose(at_b, place, atol=_SAME) and np.allclose(rest_rotation, turn.T, atol=_SAME)
        if not (fits and all(np.array_equal(c, c[0] * alike) for c in (of.stiffness, of.damping))):
            raise of.refusal(
                "MJCF supports only isotropic bushings of balls and free bodies, at rest as built; remove it"
            )
        joint: str = a if hinge is None else hinge.name
        self.set_of(of.label, joint, stiffness=float(of.stiffness[0]), damping=float(of.damping[0]))

    def group(self, tag: str) -> Element:
        """Element of the root for tendons, or for equalities."""
        element = self.root.find(tag)
        return SubElement(self.root, tag) if element is None else element


def _merge_nominal(bodies: dict[str, Body], inward: dict[str, Hinge]) -> dict[str, Body]:
    """Bodies. Those of unphysical inertia are merged with all bodies that fixed hinges join to them."""
    out = dict(bodies)
    for body in bodies.values():
        if not out[body.name].nominal:
            continue
        first = body.name
        while first in inward and inward[first].kind == "fixed" and inward[first].parent != WORLD:
            first = inward[first].parent
        # All bodies that are fixed to the first one, with their places in it.
        group: list[tuple[Body, Floats, Floats]] = []
        waiting = [(first, np.zeros(3), np.eye(3))]
        while waiting:
            name, at, turn = waiting.pop()
            group.append((out[name], at, turn))
            waiting += [
                (hinge.child, at + turn @ hinge.at, turn @ hinge.rotation)
                for hinge in inward.values()
                if hinge.parent == name and hinge.kind == "fixed"
            ]
        still = first in inward and inward[first].kind == "fixed"
        one = Body(first, 0.0) if still else _composite(group)
        if not is_inertia(one.inertia[None] + _LEAST * np.eye(3))[0]:
            raise MechanicsError(
                f"{body.label}: MuJoCo requires the triangle inequality, which its inertia and that of "
                "all bodies fixed to it violate; give the inertia of a rigid body"
            )
        out |= {member.name: Body(member.name, 0.0) for member, _, _ in group} | {first: one}
    return out


def _composite(group: list[tuple[Body, Floats, Floats]]) -> Body:
    """One body of several, at places and axes in the first."""
    masses = np.array([body.mass for body, _, _ in group])
    places = np.array([at + turn @ body.com for body, at, turn in group])
    mass, inertia = float(np.sum(masses)), np.zeros((3, 3))
    com = masses @ places / mass if mass else np.zeros(3)
    for (body, _, turn), arm in zip(group, places - com, strict=True):
        inertia += turn @ body.inertia @ turn.T + body.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    first = group[0][0]
    # As its moments may be of no body, they are checked by who asks.
    return Body(first.name, mass, com, inertia, first.position, first.rotation, armature=first.armature)


def _weigh(element: Element, body: Body, moves: bool) -> None:
    """Write mass and moments of inertia, such that they pass MuJoCo's checks."""
    least = _LEAST if moves else 0.0
    moments, axes = np.linalg.eigh(body.inertia)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    moments, mass = np.maximum(moments, least), max(body.mass, least)
    # Of flat bodies the largest is the sum of the others, but for rounding, also that of MuJoCo's reader.
    moments[2] = min(moments[2], (1.0 - 1e-15) * (moments[0] + moments[1]))
    if mass:
        SubElement(
            element, "inertial", pos=_text(body.com), mass=_text(mass), diaginertia=_text(moments),
            quat=_text(quaternion(axes)),
        )  # fmt: skip


def _text(values: Any) -> str:
    return " ".join(f"{x:.17g}" for x in np.ravel(values))
