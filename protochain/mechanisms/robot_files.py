"""Robots of URDF files, and the common base of the readers of URDF and MJCF.

Mechanisms, which stand on this, are Any here.
"""

import warnings
from collections.abc import Collection
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from protochain.core.arrays import Floats
from protochain.core.checks import brief
from protochain.core.errors import InertiaWarning, MechanicsError
from protochain.core.storage import regular
from protochain.mechanics.multibody.tree import is_inertia
from protochain.mechanisms.assemble import Body, NominalBody
from protochain.mechanisms.bodies import WORLD

_URDF = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic", "fixed": "fixed"}


class Reading:
    """A file, or its text, on its way into a mechanism, and the list of its unsupported parts.

    Limits become stops of stiffness ``stops``, 0 for none. Kinds in ``leave_out`` are skipped.
    """

    def __init__(self, into: Any, source: str | Path, stops: float, leave_out: Collection[str]) -> None:
        self.into, self.stops, self.leave_out = into, stops, leave_out
        self.name = "the text" if is_text(source) else str(source)
        self.left: dict[str, str] = {}  # Kind -> an example, of what changes the motion and is refused.
        self.unused: dict[str, str] = {}  # Kind -> an example, of what does nothing by itself.

    def refuse(self, problem: str) -> MechanicsError:
        """Return the error that names the file."""
        return MechanicsError(f"{self.name}: {problem}")

    def resists(
        self, hinge: str, damping: float, friction: float, limits: tuple[float, float] | None
    ) -> None:
        """Add damper, friction and stops of a joint."""
        if damping:
            self.into.torsion(f"{hinge}: damping", hinge=hinge, damping=damping)
        if friction:
            self.into.friction(f"{hinge}: friction", hinge=hinge, torque=friction)
        if limits is not None and self.stops:
            self.into.stop(f"{hinge}: stop", hinge=hinge, low=limits[0], high=limits[1], stiffness=self.stops)
        elif limits is not None:
            self.unused.setdefault("limits", hinge)

    def end(self) -> None:
        """Raise if a part is skipped without permission."""
        self.into.left_out = {**self.unused, **self.left}
        refused_kinds = {kind: where for kind, where in self.left.items() if kind not in self.leave_out}
        if refused_kinds:
            kinds = ", ".join(f'{kind} ("{where}")' for kind, where in sorted(refused_kinds.items()))
            raise self.refuse(
                f"mechanisms do not support {kinds}; name these kinds in leave_out to skip them"
            )


def read_urdf(into: Any, source: str | Path, free: bool, stops: float, leave_out: Collection[str]) -> None:
    """Add the links and joints of a URDF. See :meth:`Mechanism.from_urdf`."""
    reading = Reading(into, source, stops, leave_out)
    root = root_of(reading, source, "robot")
    joints = root.findall("joint")
    links = {link.get("name", ""): link for link in root.findall("link")}
    children = {_of(reading, joint, "child") for joint in joints}
    # A link called world without mass is the world.
    world = WORLD in links and links[WORLD].find("inertial") is None and WORLD not in children
    for name, link in links.items():
        if not (world and name == WORLD):
            into.add(_body(reading, name, link.find("inertial")))
            if name not in children and not free:
                into.hinge(f"{name}: base", WORLD, name, "fixed")
    for joint in joints:
        name, kind = joint.get("name", ""), joint.get("type", "")
        if kind not in _URDF:
            raise reading.refuse(f'joint "{name}": its type "{kind}" is not {", ".join(_URDF)}; split it')
        if joint.find("mimic") is not None:
            reading.left.setdefault("mimic", name)
        at, rotation = _origin(reading, joint.find("origin"))
        ends = _of(reading, joint, "parent"), _of(reading, joint, "child")
        axis = _floats(reading, joint.find("axis") if kind != "fixed" else None, "xyz", (1.0, 0.0, 0.0))
        into.hinge(name, *ends, _URDF[kind], at, rotation @ axis, rotation)
        dynamics, limit = joint.find("dynamics"), joint.find("limit")
        bounds = kind in ("revolute", "prismatic") and limit is not None
        low, high = (_number(reading, limit, key) for key in ("lower", "upper"))
        if kind != "fixed":
            damping, friction = (_number(reading, dynamics, key) for key in ("damping", "friction"))
            reading.resists(name, damping, friction, (low, high) if bounds else None)
    reading.end()


def _body(reading: Reading, name: str, inertial: Element | None) -> Body:
    if inertial is None:
        return Body(name, 0.0)
    com, turn = _origin(reading, inertial.find("origin"))
    moments = inertial.find("inertia")
    xx, xy, xz, yy, yz, zz = (
        _number(reading, moments, f"i{key}") for key in ("xx", "xy", "xz", "yy", "yz", "zz")
    )
    inertia = turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
    mass = _number(reading, inertial.find("mass"), "value")
    if is_inertia(inertia[None])[0] and (mass or not np.any(inertia)):
        return Body(name, mass, com, inertia)
    error_text = "inertia breaks the triangle inequality" if mass else "inertia has no mass"
    text = f'{reading.name}: link "{name}": its {error_text}, so it is not physical; it is used unchanged'
    warnings.warn(text, InertiaWarning, stacklevel=4)
    return NominalBody(name, mass, com, inertia)


def _origin(reading: Reading, origin: Element | None) -> tuple[Floats, Floats]:
    """Place and axes, as columns, of an origin."""
    at, rpy = (_floats(reading, origin, key, (0.0, 0.0, 0.0)) for key in ("xyz", "rpy"))
    return at, np.asarray(Rotation.from_euler("xyz", rpy).as_matrix())


def _floats(reading: Reading, of: Element | None, key: str, default: tuple[float, ...]) -> Floats:
    text = None if of is None else of.get(key)
    try:
        values = np.array(default if text is None else text.split(), dtype=float)
    except ValueError:
        values = np.array([np.nan])
    if values.shape != (len(default),) or not np.all(np.isfinite(values)):
        raise reading.refuse(f"{key} {brief(text)} of an {of.tag if of is not None else ''}: give numbers")
    return values


def _number(reading: Reading, element: Element | None, key: str) -> float:
    return float(_floats(reading, element, key, (0.0,))[0])


def _of(reading: Reading, joint: Element, end: str) -> str:
    link = joint.find(end)
    if link is None or not link.get("link"):
        raise reading.refuse(f'joint "{joint.get("name")}": it has no {end}; name a link')
    return str(link.get("link"))


def is_text(source: Any) -> bool:
    """Whether a source is the text of a file, not its name."""
    return isinstance(source, str) and source.lstrip().startswith("<")


def root_of(reading: Reading, source: str | Path, tag: str = "") -> Element:
    """Root of an XML file, or of a text, with this tag if one is given."""
    if not isinstance(source, str | Path):
        raise MechanicsError(f"source {brief(source)}: give the name of a file, or its text")
    try:
        text = source if is_text(source) else regular(Path(source)).read_text(encoding="utf-8")
        root = ElementTree.fromstring(str(text))
    except OSError as error:
        raise reading.refuse(f"{error.strerror or error}; give the name of a file") from None
    except (ElementTree.ParseError, UnicodeDecodeError, ValueError) as error:
        raise reading.refuse(f"it is not XML: {error}; give a URDF or MJCF file") from None
    if tag and root.tag != tag:
        raise reading.refuse(f"its root is <{root.tag}>, not <{tag}>; use from_urdf or from_mjcf")
    return root
