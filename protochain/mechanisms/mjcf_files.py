"""Models of MJCF files, as MuJoCo compiles them.

Mechanisms, which stand on this, are Any here.
"""

import math
from collections.abc import Collection
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from protochain.core.arrays import Floats
from protochain.core.errors import MechanicsError
from protochain.mechanisms.assemble import Body, NominalBody
from protochain.mechanisms.bodies import WORLD
from protochain.mechanisms.robot_files import Reading, is_text, root_of

_JOINTS = {0: "free", 1: "ball", 2: "prismatic", 3: "revolute"}
"""MuJoCo's numbers of joints."""


def read_mjcf(into: Any, source: str | Path, stops: float, leave_out: Collection[str]) -> None:
    """Add the bodies and joints of an MJCF. See :meth:`Mechanism.from_mjcf`."""
    try:
        import mujoco
    except ImportError:
        raise MechanicsError(
            "reading MJCF requires MuJoCo: pip install 'protochain[robots]', or give a URDF"
        ) from None
    reading = Reading(into, source, stops, leave_out)
    folder = Path() if is_text(source) else Path(source).parent
    _check_files(reading, root_of(reading, source, "mujoco"), folder)
    kind = mujoco.MjModel
    try:
        m = kind.from_xml_string(source) if is_text(source) else kind.from_xml_path(str(source))
    except (ValueError, RuntimeError, MemoryError) as error:
        # The extension raises RuntimeError for exceptions of C++, as of memory that it does not get.
        raise reading.refuse(f"MuJoCo cannot read it: {' '.join(str(error).split())}") from None
    _Compiled(reading, mujoco, m).read()


_MOST_PARTS = 20_000
"""Elements that counts may add to the elements of the file: MuJoCo needs minutes for so many."""
_MOST_CELLS = 100_000_000
"""Cells of a height field or texture, or numbers that a user adds to each part."""


def _check_files(reading: Reading, root: Element, folder: Path) -> None:
    """Refuse files that MuJoCo must not open, and parts without bound, before MuJoCo sees the model."""
    models, folders, home = [(root, folder)], {folder}, folder.resolve()
    opened = set[Path]()
    # The list grows by included files, whose names start from the folder of the first file or from theirs.
    for model, place in models:
        for element in model.iter():
            folders |= {folder / element.get(name, "") for name in ("meshdir", "texturedir", "assetdir")}
            names = {value for name, value in element.items() if name.startswith("file")}
            paths = {(start / name).resolve() for start in (folder, place) for name in names}
            if element.tag not in ("include", "model"):
                continue
            for path in paths - opened:
                opened.add(path)
                if home not in path.parents:
                    raise reading.refuse(f"it includes {path}, which is outside its folder; copy it there")
                if path.exists():
                    models.append((root_of(reading, path), path.parent))
    elements = [element for model, _ in models for element in model.iter()]
    for element in elements:
        names = {value for name, value in element.items() if name.startswith("file")}
        for path in {start / part for start in folders for name in names for part in (name, Path(name).name)}:
            if path.exists() and not path.is_file():
                raise reading.refuse(f"{path} is not a regular file; give a regular file")
        numbers = [_product(element, name) for name in element.attrib if name.startswith("nuser")]
        cells = max(_product(element, "nrow", "ncol"), _product(element, "width", "height"), *numbers, 0.0)
        if cells > _MOST_CELLS:
            raise reading.refuse(f"<{element.tag}> has more than {_MOST_CELLS} cells; lower its size")
    # Every attached file may be attached in each of the others.
    attached = 1 + sum(element.tag == "attach" for element in elements)
    if attached * sum(_n_parts(model) for model, _ in models) > attached * len(elements) + _MOST_PARTS:
        raise reading.refuse(f"its counts add more than {_MOST_PARTS} parts; lower them")


def _n_parts(element: Element) -> float:
    """Number of elements that an element becomes, with its children."""
    return max(1.0, _product(element, "count")) * (1 + sum(map(_n_parts, element)))


def _product(element: Element, *names: str) -> float:
    """Product of all numbers in these attributes, 1 without them. MuJoCo refuses text without a number."""
    words = [word for name in names for word in element.get(name, "").split()]
    with suppress(ValueError):
        return math.prod(map(float, words))
    return 1.0


class _Compiled:
    """A model of MuJoCo's on its way into a mechanism."""

    def __init__(self, reading: Reading, mujoco: Any, m: Any) -> None:
        self.reading, self.into, self.mujoco, self.m = reading, reading.into, mujoco, m

    def read(self) -> None:
        """Add all parts, and list the unsupported ones."""
        m = self.m
        self.into.set_gravity(np.zeros(3) if self.is_off("GRAVITY") else m.opt.gravity)
        for b in range(1, m.nbody):
            self.add_body(b)
        for i in range(m.neq):
            self.close_loop(i)
        for t in range(m.ntendon):
            self.note_tendon(t)
        self.note_the_rest()
        self.reading.end()

    def is_off(self, *flags: str) -> bool:
        """Whether any of these flags of the options is disabled."""
        bits = (getattr(self.mujoco.mjtDisableBit, f"mjDSBL_{flag}", 0) for flag in flags)
        return any(self.m.opt.disableflags & int(bit) for bit in bits)

    def name(self, kind: str, i: int) -> str:
        """Name of an object, or its kind and number."""
        number = getattr(self.mujoco.mjtObj, f"mjOBJ_{kind.upper()}")
        return self.mujoco.mj_id2name(self.m, number, i) or f"{kind} {i}"

    @cached_property
    def bodies(self) -> list[str]:
        """Names of the bodies."""
        return [WORLD, *(self.name("body", b) for b in range(1, self.m.nbody))]

    def values(self, name: str, i: int) -> Floats:
        """An entry of an array that versions of MuJoCo may lack. The default is zero."""
        return np.asarray(getattr(self.m, name)[i] if hasattr(self.m, name) else 0.0)

    def by_actuators(self, name: str, joint: bool, i: int) -> float:
        """Sum of what actuators add to a joint or tendon by the squares of their gears."""
        m, kinds = self.m, self.mujoco.mjtTrn
        trns = (kinds.mjTRN_JOINT, kinds.mjTRN_JOINTINPARENT) if joint else (kinds.mjTRN_TENDON,)
        added = 0.0
        for k in range(len(m.actuator_trntype)):
            if int(m.actuator_trntype[k]) in map(int, trns) and int(m.actuator_trnid[k, 0]) == i:
                row = m.actuator_outadr[k] if hasattr(m, "actuator_outadr") else k
                added += float(np.max(np.abs(self.values(name, k))) * m.actuator_gear[row, 0] ** 2)
        return added

    def add_body(self, b: int) -> None:
        """Add a body with its joints, and massless bodies between several joints."""
        m, name = self.m, self.bodies[b]
        if m.body_gravcomp[b] and not self.is_off("GRAVITY"):
            self.reading.left.setdefault("gravcomp", name)
        turn = _matrix(m.body_iquat[b])
        inertia = turn @ np.diag(m.body_inertia[b]) @ turn.T
        mass: dict[str, Any] = {"mass": m.body_mass[b], "com": m.body_ipos[b], "inertia": inertia}
        # A bound on inertia is one of bodies without mass, too.
        kind = Body if m.body_mass[b] or not np.any(inertia) else NominalBody
        at, rotation = m.body_pos[b], _matrix(m.body_quat[b])
        joints = range(m.body_jntadr[b], m.body_jntadr[b] + m.body_jntnum[b])
        if len(joints) and _JOINTS[int(m.jnt_type[joints[0]])] == "free":
            rotor = self.armature(joints[0])
            self.into.add(kind(name, **mass, position=at, rotation=rotation, armature=rotor))
            q = m.qpos_spring[m.jnt_qposadr[joints[0]] :]
            self.resist_all(joints[0], (name, (0, 0, 0)), (WORLD, q[:3]), _matrix(q[3:7]).T)
            return
        self.into.add(kind(name, **mass))
        parent, above, turned, last = self.bodies[m.body_parentid[b]], at, rotation, np.zeros(3)
        for j in joints:
            joint_name, sort = self.name("joint", j), _JOINTS[int(m.jnt_type[j])]
            anchor, axis = m.jnt_pos[j], m.jnt_axis[j]
            ends = j == joints[-1] and not np.any(anchor)
            child = name if ends else f"{name}: {joint_name}"
            if not ends:
                self.into.body(child, 0.0)
            # A hinge begins at its reference, where the body is as the file has it.
            q0 = 0.0 if sort == "ball" else float(m.qpos0[m.jnt_qposadr[j]])
            place = above + turned @ (anchor - last)
            back = np.eye(3)
            if sort == "revolute":
                back = Rotation.from_rotvec(-q0 * axis).as_matrix()
            elif sort == "prismatic":
                place = place - q0 * turned @ axis
            start = {"q": np.degrees(q0) if self.into.degrees and sort == "revolute" else q0} if q0 else {}
            self.into.hinge(
                joint_name, parent, child, sort, place, turned @ axis, turned @ back,
                armature=self.armature(j), **start,
            )  # fmt: skip
            if sort == "ball":
                self.resist_all(j, (child, (0, 0, 0)), (parent, place), turned.T)
            else:
                self.resist(j, joint_name, sort)
            parent, above, turned, last = child, np.zeros(3), np.eye(3), anchor
        if parent != name:
            seat = above - turned @ last
            self.into.hinge(f"{name}: seat", parent, name, "fixed", seat, rotation=turned)

    def armature(self, j: int) -> float:
        """Armature of a joint and of its actuators."""
        if "armature" in self.reading.leave_out:
            return 0.0
        added = self.by_actuators("actuator_armature", True, j)
        return float(self.m.dof_armature[self.m.jnt_dofadr[j]]) + added

    def resistance(self, j: int) -> tuple[float, float, float]:
        """Stiffness, damping and friction of a joint, as flags have them."""
        m, v = self.m, int(self.m.jnt_dofadr[j])
        name = self.name("joint", j)
        stiffness = 0.0 if self.is_off("SPRING", "PASSIVE") else float(m.jnt_stiffness[j])
        damping = float(m.dof_damping[v]) + self.by_actuators("actuator_damping", True, j)
        bends = bool(np.any(self.values("jnt_stiffnesspoly", j)))
        curved = bends and not self.is_off("SPRING", "PASSIVE")
        if self.is_off("DAMPER", "PASSIVE"):
            damping = 0.0
        elif np.any(self.values("dof_dampingpoly", v)) or self.by_actuators("actuator_dampingpoly", True, j):
            curved = True
        if curved:
            self.reading.left.setdefault("polynomials", name)
        if stiffness and self.values("jnt_springyield", j):
            self.reading.left.setdefault("springyield", name)
        off = self.is_off("FRICTIONLOSS", "CONSTRAINT")
        return stiffness, damping, 0.0 if off else float(m.dof_frictionloss[v])

    def is_limited(self, j: int) -> bool:
        """Whether a joint has limits, as flags have them."""
        return bool(self.m.jnt_limited[j]) and not self.is_off("LIMIT", "CONSTRAINT")

    def resist(self, j: int, name: str, sort: str) -> None:
        """Add spring, damper, friction and stops of a hinge or slide."""
        stiffness, damping, friction = self.resistance(j)
        scale = np.degrees(1.0) if self.into.degrees and sort == "revolute" else 1.0
        if stiffness:
            rest_angle = float(scale * self.m.qpos_spring[self.m.jnt_qposadr[j]])
            self.into.torsion(f"{name}: spring", name, stiffness, rest_angle)
        low, high = (float(scale * x) for x in self.m.jnt_range[j])
        self.reading.resists(name, damping, friction, (low, high) if self.is_limited(j) else None)

    def resist_all(self, j: int, a: Any, b: Any, rotation: Floats) -> None:
        """Add spring and damper of a ball or of a free body. Its friction and limits are unsupported."""
        stiffness, damping, friction = self.resistance(j)
        name, ball = self.name("joint", j), b[0] != WORLD or self.m.jnt_type[j] == 1
        if friction or (self.is_limited(j) and self.reading.stops):
            kind = "resistance of balls" if ball else "friction of free bodies"
            self.reading.left.setdefault(kind, name)
        elif self.is_limited(j):
            self.reading.unused.setdefault("limits", name)
        if stiffness or damping:
            per_axis = np.repeat([1.0, 0.0 if ball else 1.0], 3)
            self.into.bushing(f"{name}: spring", a, b, stiffness * per_axis, damping * per_axis, rotation)

    def close_loop(self, i: int) -> None:
        """Close the loop of an equality constraint."""
        m, obj, eq = self.m, self.mujoco.mjtObj, self.mujoco.mjtEq
        kinds = {int(eq.mjEQ_CONNECT): "spherical", int(eq.mjEQ_WELD): "rigid"}
        name, kind, data = self.name("equality", i), kinds.get(int(m.eq_type[i])), m.eq_data[i]
        if not m.eq_active0[i] or self.is_off("EQUALITY", "CONSTRAINT"):
            self.reading.unused.setdefault("inactive equality", name)
            return
        if kind is None:
            self.reading.left.setdefault("equality", name)
            return
        ends: Any = [m.eq_obj1id[i], m.eq_obj2id[i]]
        if m.eq_objtype[i] == obj.mjOBJ_SITE:
            points = [m.site_pos[k] for k in ends]
            axes_a, axes_b = (_matrix(m.site_quat[k]) for k in ends)
            rotation, ends = axes_a @ axes_b.T, [m.site_bodyid[k] for k in ends]
        else:
            points = [data[3:6], data[:3]] if kind == "rigid" else [data[:3], data[3:6]]
            rotation = _matrix(data[6:10]) if kind == "rigid" else np.eye(3)
        a, b = ((self.bodies[k], point) for k, point in zip(ends, points, strict=True))
        self.into.close(name, a, b, kind, rotation=rotation if kind == "rigid" else None)

    def note_tendon(self, t: int) -> None:
        """Note a tendon: what pulls at it is refused, one for actuators is not."""
        m = self.m
        acts: list[Any] = []
        if not self.is_off("SPRING", "PASSIVE"):
            acts += [m.tendon_stiffness[t], self.values("tendon_stiffnesspoly", t)]
        if not self.is_off("DAMPER", "PASSIVE"):
            acts += [m.tendon_damping[t], self.values("tendon_dampingpoly", t)]
            acts += [self.by_actuators(f"actuator_damping{ends}", False, t) for ends in ("", "poly")]
        if not self.is_off("FRICTIONLOSS", "CONSTRAINT"):
            acts.append(m.tendon_frictionloss[t])
        acts += [self.values("tendon_armature", t), self.by_actuators("actuator_armature", False, t)]
        limited = m.tendon_limited[t] and not self.is_off("LIMIT", "CONSTRAINT")
        acting = any(np.any(values) for values in acts) or (limited and self.reading.stops)
        into = self.reading.left if acting else self.reading.unused
        into.setdefault("tendons", self.name("tendon", t))
        if limited:
            self.reading.unused.setdefault("limits", self.name("tendon", t))

    def note_the_rest(self) -> None:
        """List other unsupported parts of a file."""
        m, left, unused = self.m, self.reading.left, self.reading.unused
        plugins = np.flatnonzero(np.asarray(m.body_plugin) >= 0)
        for kind, has, where in (
            ("flex", m.nflex, "flex 0"),
            ("fluid", m.opt.density or m.opt.viscosity, "option"),
            ("plugins", len(plugins), self.bodies[plugins[0]] if len(plugins) else ""),
        ):
            if has:
                left.setdefault(kind, where)
        touching = np.flatnonzero(m.geom_contype | m.geom_conaffinity)
        if self.is_off("CONTACT", "CONSTRAINT"):
            touching = touching[:0]
        sleeps = int(getattr(self.mujoco.mjtEnableBit, "mjENBL_SLEEP", 0)) & m.opt.enableflags
        for kind, first in (
            ("contacts", self.name("geom", int(touching[0])) if len(touching) else ""),
            ("contacts", "pair 0" if m.npair else ""),
            ("actuators", self.name("actuator", 0) if len(m.actuator_trntype) else ""),
            ("sensors", self.name("sensor", 0) if m.nsensor else ""),
            ("keyframes", self.name("key", 0) if m.nkey else ""),
            ("mocap", self.bodies[int(np.argmax(m.body_mocapid))] if m.nmocap else ""),
            ("sleep", "option" if sleeps else ""),
        ):
            if first:
                unused.setdefault(kind, first)


def _matrix(quat: Floats) -> Floats:
    return np.asarray(Rotation.from_quat(np.roll(quat, -1)).as_matrix())
