"""The machine: boom, stick and bucket on drives, the frame on the ground, and the way of its edge."""

from collections.abc import Callable

import numpy as np
from scipy.interpolate import CubicSpline

from bench.soil.parts import Motion, Plates
from protochain.core.arrays import Floats
from protochain.mechanics import multibody
from protochain.mechanisms import Mechanism, Model

GRAVITY = (0.0, 0.0, -9.81)
PIN = (0.0, 0.0, 0.45)
"""m. Where the boom is hinged to the frame."""
BOOM, STICK = 0.6, 0.5
"""m. Lengths."""
EDGE = np.array([-0.07, 0.0, -0.1])
"""m. Cutting edge in the bucket's axes; it opens towards z, and the machine is on the side of -x."""
HINGES: dict[str, tuple[str, tuple[float, float, float]]] = {
    "boom": ("world", PIN),
    "stick": ("boom", (BOOM, 0.0, 0.0)),
    "bucket": ("stick", (STICK, 0.0, 0.0)),
}
"""Parent and place of each body's hinge; all turn about y, which lowers what is on the side of x."""
BODIES = {
    "boom": (4.0, (0.5 * BOOM, 0.0, 0.0), (0.005, 0.12, 0.12)),
    "stick": (2.0, (0.5 * STICK, 0.0, 0.0), (0.002, 0.042, 0.042)),
    "bucket": (1.5, (0.02, 0.0, -0.06), (0.006, 0.005, 0.006)),
}
"""Mass (kg), centre of mass (m) and moments of inertia (kg m^2) of each."""
THICK = 0.003
"""m. Half the thickness of the bucket's plates."""

Path = Callable[[float], tuple[Floats, Floats, Floats]]
"""Time -> angles, rates and accelerations (3,) of the hinges."""


def backhoe(path: Path | None = None, angles: Floats | None = None) -> Mechanism:
    """Build the machine: driven along a path, or free from given angles (3,)."""
    machine = Mechanism(GRAVITY)
    q = path(0.0)[0] if path is not None else np.zeros(3) if angles is None else angles
    for k, (name, (parent, at)) in enumerate(HINGES.items()):
        mass, com, inertia = BODIES[name]
        machine.body(name, mass, com, inertia)
        machine.hinge(name, parent, name, at=at, axis=(0.0, 1.0, 0.0), q=float(q[k]))
        if path is not None:
            machine.drive(name, _one(path, k))
    return machine


def _one(path: Path, k: int) -> Callable[[float], tuple[float, float, float]]:
    """Motion of one hinge."""

    def motion(t: float) -> tuple[float, float, float]:
        q, qd, qdd = path(t)
        return float(q[k]), float(qd[k]), float(qdd[k])

    return motion


def reach(edge: Floats, tilt: float) -> Floats:
    """Angles (3,) of the hinges that bring the cutting edge to a place (x, z), the bucket tilted about y."""
    c, s = np.cos(tilt), np.sin(tilt)
    x, z = edge[0] - (c * EDGE[0] + s * EDGE[2]) - PIN[0], edge[1] - (c * EDGE[2] - s * EDGE[0]) - PIN[2]
    inner = -np.arccos((x * x + z * z - BOOM**2 - STICK**2) / (2.0 * BOOM * STICK))
    outer = np.arctan2(z, x) - np.arctan2(STICK * np.sin(inner), BOOM + STICK * np.cos(inner))
    return np.array([-outer, -inner, tilt + outer + inner])


def digging(level: float, duration: float = 1.0, depth: float = 0.3) -> Path:
    """Way of the bucket through soil as high as ``level``, to a part of it: in, along, up and out."""
    times = duration * np.array([0.0, 0.2, 0.5, 0.75, 1.0])
    # Cubes that are jammed between bucket and floor would be crushed.
    deep = depth * level
    places = [(0.82, 0.02), (0.80, -0.75 * deep), (0.64, -deep), (0.54, -0.25 * deep), (0.52, 0.1)]
    tilts = np.deg2rad([-75.0, -75.0, -50.0, -12.0, 5.0])
    angles = [reach(np.array([x, level + z]), tilt) for (x, z), tilt in zip(places, tilts, strict=True)]
    spline = CubicSpline(times, np.array(angles), bc_type="clamped")
    rates, accelerations = spline.derivative(1), spline.derivative(2)

    def path(t: float) -> tuple[Floats, Floats, Floats]:
        t = min(max(t, 0.0), duration)
        return spline(t), rates(t), accelerations(t)

    return path


def bucket_plates(body: int, model: Model) -> Plates:
    """Bottom, back and sides of the bucket, for the number of its body, in the frame of the tree."""
    own = bucket_shape(body)
    # Its z axis is the hinge's.
    turn = model.bodies.turn[body].T
    return Plates(own.body, own.centre @ turn.T, turn @ own.rotation, own.half)


def bucket_shape(body: int) -> Plates:
    """Bottom, back and sides of the bucket, in its own axes, with a number of the body."""
    length, width, height = -EDGE[0], 0.06, -0.5 * EDGE[2]
    centre = np.array(
        [[0, 0, EDGE[2] - THICK], [length, 0, -height], [0, -width, -height], [0, width, -height]],
        dtype=float,
    )
    half = np.array(
        [[length, width, THICK], [THICK, width, height], [length, THICK, height], [length, THICK, height]]
    )
    return Plates(np.full(4, body), centre, np.tile(np.eye(3), (4, 1, 1)), half)


def motion_of(model: Model, path: Path, times: Floats, still: int = 1) -> Motion:
    """Frames and twists of the machine's bodies at some times, and of others that stand still."""
    tree, nb = model.tree, model.tree.n_bodies
    shape = (len(times), nb + still)
    origin, rotation = np.zeros((*shape, 3)), np.tile(np.eye(3), (*shape, 1, 1))
    twist = np.zeros((*shape, 6))
    for k, t in enumerate(times):
        q, qd, _ = path(float(t))
        frames = multibody.pose(tree, q)
        origin[k, :nb], rotation[k, :nb] = frames.origin, frames.rotation
        twist[k, :nb] = multibody.velocities(tree, frames, qd)
    return Motion(origin, rotation, twist)
