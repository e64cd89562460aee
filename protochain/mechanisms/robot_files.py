"""Robots of files: URDF by its text, MJCF as MuJoCo reads it; and MJCF of mechanisms.

Mechanisms, which stand on this, are Any here.
"""

from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from scipy.spatial.transform import Rotation

from protochain.core.arrays import Floats
from protochain.core.checks import shown
from protochain.core.errors import MechanicsError
from protochain.core.storage import regular, write_text
from protochain.mechanisms.assemble import Body, Hinge, quaternion
from protochain.mechanisms.bodies import WORLD
from protochain.mechanisms.closing import Closing
from protochain.mechanisms.elements import Named
from protochain.mechanisms.hinge_friction import HingeFriction
from protochain.mechanisms.linear_springs import Spring
from protochain.mechanisms.stops import Stop
from protochain.mechanisms.torsion import Torsion

_URDF = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic", "fixed": "fixed"}
_MJCF = {0: "free", 1: "ball", 2: "prismatic", 3: "revolute"}
"""MuJoCo's numbers of joints."""


class _Reading:
    """A file on its way into a mechanism; ``left`` is what a mechanism of it has not."""

    def __init__(self, into: Any, source: str | Path, stops: float, leave_out: Collection[str]) -> None:
        self.into, self.stops, self.leave_out = into, stops, leave_out
        self.name = "the text" if _is_text(source) else str(source)
        self.left: dict[str, str] = {}

    def refuse(self, what: str) -> MechanicsError:
        return MechanicsError(f"{self.name}: {what}")

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

    def end(self) -> None:
        """Raise if something is left out that was not to be."""
        more = {kind: where for kind, where in self.left.items() if kind not in self.leave_out}
        if more:
            kinds = ", ".join(f'{kind} ("{where}")' for kind, where in sorted(more.items()))
            raise self.refuse(
                f"it has what a mechanism has not: {kinds}; name the kinds in leave_out to go on without"
            )


def read_urdf(into: Any, source: str | Path, free: bool, stops: float, leave_out: Collection[str]) -> None:
    """Add the links and joints of a URDF; see :meth:`Mechanism.from_urdf`."""
    reading = _Reading(into, source, stops, leave_out)
    root = _root(reading, source, "robot")
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
            reading.left["mimic"] = name
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


def _body(reading: _Reading, name: str, inertial: Element | None) -> Body:
    if inertial is None:
        return Body(name, 0.0)
    com, turn = _origin(reading, inertial.find("origin"))
    moments = inertial.find("inertia")
    xx, xy, xz, yy, yz, zz = (
        _number(reading, moments, f"i{key}") for key in ("xx", "xy", "xz", "yy", "yz", "zz")
    )
    inertia = turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
    return Body(name, _number(reading, inertial.find("mass"), "value"), com, inertia)


def _origin(reading: _Reading, origin: Element | None) -> tuple[Floats, Floats]:
    """Place and axes, as columns, of an origin."""
    at, rpy = (_floats(reading, origin, key, (0.0, 0.0, 0.0)) for key in ("xyz", "rpy"))
    return at, np.asarray(Rotation.from_euler("xyz", rpy).as_matrix())


def _floats(reading: _Reading, of: Element | None, key: str, default: tuple[float, ...]) -> Floats:
    text = None if of is None else of.get(key)
    try:
        found = np.array(default if text is None else text.split(), dtype=float)
    except ValueError:
        found = np.array([np.nan])
    if found.shape != (len(default),) or not np.all(np.isfinite(found)):
        raise reading.refuse(f"{key} {shown(text)} of an {of.tag if of is not None else ''}: give numbers")
    return found


def _number(reading: _Reading, of: Element | None, key: str) -> float:
    return float(_floats(reading, of, key, (0.0,))[0])


def _of(reading: _Reading, joint: Element, end: str) -> str:
    found = joint.find(end)
    if found is None or not found.get("link"):
        raise reading.refuse(f'joint "{joint.get("name")}": it has no {end}; name a link')
    return str(found.get("link"))


def read_mjcf(into: Any, source: str | Path, stops: float, leave_out: Collection[str]) -> None:
    """Add the bodies and joints of an MJCF; see :meth:`Mechanism.from_mjcf`."""
    try:
        import mujoco
    except ImportError:
        raise MechanicsError(
            "MJCF is read by MuJoCo, which is not installed: pip install 'protochain[robots]'; or give a URDF"
        ) from None
    reading = _Reading(into, source, stops, leave_out)
    _root(reading, source, "mujoco")
    kind = mujoco.MjModel
    try:
        m = kind.from_xml_string(source) if _is_text(source) else kind.from_xml_path(str(source))
    except ValueError as error:
        raise reading.refuse(f"MuJoCo does not read it: {' '.join(str(error).split())}") from None
    into.set_gravity(m.opt.gravity)

    def name(of: Any, i: int, what: str) -> str:
        return mujoco.mj_id2name(m, of, i) or f"{what} {i}"

    bodies = [WORLD, *(name(mujoco.mjtObj.mjOBJ_BODY, b, "body") for b in range(1, m.nbody))]
    for b in range(1, m.nbody):
        turn, own = _matrix(m.body_iquat[b]), range(m.body_jntadr[b], m.body_jntadr[b] + m.body_jntnum[b])
        inertia = turn @ np.diag(m.body_inertia[b]) @ turn.T
        at, rotation = m.body_pos[b], _matrix(m.body_quat[b])
        mass: dict[str, Any] = {"mass": m.body_mass[b], "com": m.body_ipos[b], "inertia": inertia}
        if m.body_gravcomp[b]:
            reading.left["gravcomp"] = bodies[b]
        joints = [(name(mujoco.mjtObj.mjOBJ_JOINT, j, "joint"), j, _MJCF[int(m.jnt_type[j])]) for j in own]
        if joints and joints[0][2] == "free":
            into.body(bodies[b], **mass, position=at, rotation=rotation)
            continue
        into.body(bodies[b], **mass)
        parent, above, turned, last = bodies[m.body_parentid[b]], at, rotation, np.zeros(3)
        for k, (called, j, sort) in enumerate(joints):
            anchor, axis = m.jnt_pos[j], m.jnt_axis[j]
            ends = k == len(joints) - 1 and not np.any(anchor)
            child = bodies[b] if ends else f"{bodies[b]}: {called}"
            if not ends:
                into.body(child, 0.0)
            q0 = 0.0 if sort == "ball" else float(m.qpos0[m.jnt_qposadr[j]])
            place = above + turned @ (anchor - last)
            back = np.eye(3)
            if sort == "revolute":
                back = Rotation.from_rotvec(-q0 * axis).as_matrix()
            elif sort == "prismatic":
                place = place - q0 * turned @ axis
            own_q = np.degrees(q0) if into.degrees and sort == "revolute" else q0
            start = {"q": own_q} if q0 else {}
            into.hinge(called, parent, child, sort, place, turned @ axis, turned @ back, **start)
            parent, above, turned, last = child, np.zeros(3), np.eye(3), anchor
            _resist(reading, m, called, j, sort)
        if parent != bodies[b]:
            into.hinge(
                f"{bodies[b]}: seat", parent, bodies[b], "fixed", above - turned @ last, rotation=turned
            )
    _close(reading, mujoco, m, bodies)
    for what, has in (
        ("tendons", m.ntendon), ("flex", m.nflex), ("fluid", m.opt.density or m.opt.viscosity or None),
        ("armature", np.any(m.dof_armature)),
    ):  # fmt: skip
        if has:
            reading.left[what] = "see there"
    reading.end()


def _resist(reading: _Reading, m: Any, name: str, j: int, sort: str) -> None:
    """Add spring, damper, friction and stops of a joint."""
    v, q = int(m.jnt_dofadr[j]), int(m.jnt_qposadr[j])
    stiffness, damping, friction = (
        float(x) for x in (m.jnt_stiffness[j], m.dof_damping[v], m.dof_frictionloss[v])
    )
    curved = np.any(getattr(m, "jnt_stiffnesspoly", np.zeros((m.njnt, 1)))[j])
    if curved or np.any(getattr(m, "dof_dampingpoly", np.zeros((m.nv, 1)))[v]):
        reading.left["polynomials"] = name
    if sort == "ball":
        if stiffness or damping or friction or m.jnt_limited[j]:
            reading.left["resistance of balls"] = name
        return
    scale = np.degrees(1.0) if reading.into.degrees and sort == "revolute" else 1.0
    if stiffness:
        reading.into.torsion(f"{name}: spring", name, stiffness, float(scale * m.qpos_spring[q]))
    low, high = scale * m.jnt_range[j]
    reading.resists(name, damping, friction, (float(low), float(high)) if m.jnt_limited[j] else None)


def _close(reading: _Reading, mujoco: Any, m: Any, bodies: list[str]) -> None:
    """Close the loops of equality constraints."""
    kinds = {int(mujoco.mjtEq.mjEQ_CONNECT): "spherical", int(mujoco.mjtEq.mjEQ_WELD): "rigid"}
    for i in range(m.neq):
        name = mujoco.mj_id2name(m, mujoco.mjtObj.mjOBJ_EQUALITY, i) or f"equality {i}"
        kind, of_bodies = kinds.get(int(m.eq_type[i])), m.eq_objtype[i] == mujoco.mjtObj.mjOBJ_BODY
        if kind is None or not of_bodies or not m.eq_active0[i]:
            reading.left["equality"] = name
            continue
        a, b = (bodies[k] for k in (m.eq_obj1id[i], m.eq_obj2id[i]))
        first, second = (3, 0) if kind == "rigid" else (0, 3)
        ends = m.eq_data[i, first : first + 3], m.eq_data[i, second : second + 3]
        reading.into.close(name, (a, ends[0]), (b, ends[1]), kind)


def _matrix(quat: Floats) -> Floats:
    return np.asarray(Rotation.from_quat(np.roll(quat, -1)).as_matrix())


def _is_text(source: Any) -> bool:
    return isinstance(source, str) and source.lstrip().startswith("<")


def _root(reading: _Reading, source: str | Path, tag: str) -> Element:
    """Root of an XML file, or of a text."""
    if not isinstance(source, str | Path):
        raise MechanicsError(f"source {shown(source)}: give the name of a file, or its text")
    try:
        text = source if _is_text(source) else regular(Path(source)).read_text(encoding="utf-8")
        root = ElementTree.fromstring(str(text))
    except OSError as error:
        raise reading.refuse(f"{error.strerror or error}; give the name of a file") from None
    except (ElementTree.ParseError, UnicodeDecodeError, ValueError) as error:
        raise reading.refuse(f"it is no XML: {error}; give a file as robots have it") from None
    if root.tag != tag:
        raise reading.refuse(f"its root is <{root.tag}>, not <{tag}>; see from_urdf and from_mjcf")
    return root


def _text(values: Any) -> str:
    return " ".join(f"{x:.17g}" for x in np.ravel(values))


def mjcf(of: Any, path: str | Path | None) -> str:
    """MJCF of a mechanism; see :meth:`Mechanism.to_mjcf`."""
    bodies = of.build().bodies
    root = Element("mujoco")
    SubElement(root, "compiler", angle="radian", autolimits="true", balanceinertia="false", eulerseq="XYZ")
    SubElement(root, "option", gravity=_text(bodies.gravity), integrator="RK4")
    parts = {WORLD: SubElement(root, "worldbody")}
    inward = {hinge.child: hinge for hinge in of.parts(Hinge)}
    own: dict[str, Element] = {}
    for name in bodies.names:
        body = next((each for each in of.parts(Body) if each.name == name), None)
        if body is None:
            continue  # Of the axes of a ball.
        hinge = inward.get(name)
        here: dict[str, Any] = {"name": name}
        if hinge is None:
            turn = np.eye(3) if body.rotation is None else body.rotation
            here |= {"pos": _text(bodies.built.point(name)), "quat": _text(quaternion(turn))}
        else:
            here |= {"pos": _text(hinge.at), "quat": _text(quaternion(hinge.rotation))}
        part = parts[name] = SubElement(parts[hinge.parent if hinge else WORLD], "body", here)
        if hinge is None:
            SubElement(part, "freejoint", name=name)
        elif hinge.kind != "fixed":
            kinds = {"revolute": "hinge", "prismatic": "slide", "ball": "ball"}
            if hinge.kind not in kinds:
                raise MechanicsError(f"{hinge.label}: MJCF has no {hinge.kind}; leave it out")
            along = {} if hinge.kind == "ball" else {"axis": _text(hinge.rotation.T @ hinge.axis)}
            own[hinge.name] = SubElement(
                part, "joint", {"name": hinge.name, "type": kinds[hinge.kind], **along}
            )
        if body.mass:
            full = body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
            SubElement(part, "inertial", pos=_text(body.com), mass=_text(body.mass), fullinertia=_text(full))
    writers: dict[type, Callable[[Any], None]] = {
        Torsion: lambda each: _joint_has(own, each, stiffness=each.stiffness, damping=each.damping,
                                         springref=_rest(bodies, each)),
        HingeFriction: lambda each: _joint_has(own, each, frictionloss=_constant(each)),
        Stop: lambda each: own[each.hinge].set("range", _text(np.array([each.low, each.high])
                                                               * bodies.unit(each.hinge))),
        Spring: lambda each: _tendon(root, parts, bodies, each),
        Closing: lambda each: _equality(root, each),
    }  # fmt: skip
    for each in of.parts(Named):
        if isinstance(each, Body | Hinge):
            continue
        if type(each) not in writers:
            raise MechanicsError(f"{each.label}: MJCF does not have it; leave it out")
        writers[type(each)](each)
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    if path is not None:
        write_text(Path(path), text)
    return text


def _joint_has(own: dict[str, Element], of: Any, **values: float) -> None:
    """Set what an element gives to its joint, which nothing else may have set."""
    joint = own[of.hinge]
    for key, value in values.items():
        if value and joint.get(key) is not None:
            raise MechanicsError(
                f'{of.label}: hinge "{of.hinge}" has a {key} already; join them in one element'
            )
        if value:
            joint.set(key, _text(value))


def _rest(bodies: Any, of: Torsion) -> float:
    at = bodies.freedom(of.hinge)[0]
    return float(bodies.q[at]) if of.rest is None else float(of.rest * bodies.unit(of.hinge))


def _constant(of: HingeFriction) -> float:
    if of.coefficient or of.damping:
        raise MechanicsError(f"{of.label}: MJCF has constant friction only; give its damping to a torsion")
    return of.torque


def _tendon(root: Element, parts: dict[str, Element], bodies: Any, of: Spring) -> None:
    tendons = root.find("tendon")
    tendons = SubElement(root, "tendon") if tendons is None else tendons
    built = np.linalg.norm(bodies.built.point(*of.a) - bodies.built.point(*of.b))
    rest = built if of.rest is None else of.rest
    held = {"stiffness": of.stiffness, "damping": of.damping, "springlength": rest}
    line = SubElement(tendons, "spatial", {"name": of.name, **{key: _text(x) for key, x in held.items()}})
    for end, (body, at) in zip("ab", (of.a, of.b), strict=True):
        SubElement(parts[body], "site", name=f"{of.name}: {end}", pos=_text(at))
        SubElement(line, "site", site=f"{of.name}: {end}")


def _equality(root: Element, of: Closing) -> None:
    kinds = {"spherical": "connect", "rigid": "weld"}
    if of.kind not in kinds:
        raise MechanicsError(
            f"{of.label}: MJCF closes loops by balls and welds, not as {of.kind}; give another"
        )
    equalities = root.find("equality")
    equalities = SubElement(root, "equality") if equalities is None else equalities
    (a, at), (b, there) = of.a, of.b
    if b == WORLD or (of.kind == "rigid" and a == WORLD):
        (a, at), (b, there) = (b, there), (a, at)
    where = {"anchor": _text(at if of.kind == "spherical" else there)}
    SubElement(equalities, kinds[of.kind], {"name": of.name, "body1": a, "body2": b, **where})
