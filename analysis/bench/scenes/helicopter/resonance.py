"""Ground resonance: rigid blades that lag on a hub that slides on springs, simulated and in closed form.

Hammond, J. Am. Helicopter Soc. 19(4):14 (1974), in SI units. The blades move the hub by the first Fourier
components of their lag, sum z_b = z_c cos psi_b + z_s sin psi_b, of which there are two, whatever the number
of blades: in these the equations have constant coefficients, and their eigenvalues are exact.
"""

from dataclasses import dataclass

import numpy as np

from protochain.core.arrays import Floats
from protochain.mechanics.motion import Phase
from protochain.mechanisms import Mechanism, Model

RPM = 2.0 * np.pi / 60.0


@dataclass(frozen=True)
class Rotor:
    """A rotor with hinges of lag on a hub that slides.

    blades: Number of blades.
    mass, first, second: Mass of a blade, and its first and second moment about the hinge of lag.
    offset: Distance of the hinges from the shaft.
    lag_damping: Of the dampers at the hinges.
    hub_mass, hub_damping: Along x and y.
    hub_stiffness: Along both.
    """

    blades: int = 4
    mass: float = 94.9
    first: float = 289.1
    second: float = 1084.7
    offset: float = 0.3048
    lag_damping: float = 4067.5
    hub_mass: tuple[float, float] = (8026.6, 3283.6)
    hub_damping: tuple[float, float] = (51078.7, 25539.35)
    hub_stiffness: float = 1240481.8


HAMMOND = Rotor()


def eigenvalues(rotor: Rotor, rate: float) -> tuple[Floats, Floats]:
    """Eigenvalues (8,) and eigenvectors (8, 8), as columns, of (x, y, z_c, z_s) and their rates."""
    n, s, i = 0.5 * rotor.blades, rotor.first, rotor.second
    c, w = rotor.lag_damping, rate
    whole = np.array(rotor.hub_mass) + rotor.blades * rotor.mass
    m = np.diag([*whole, i, i])
    m[0, 3], m[1, 2] = -n * s, n * s
    m[2, 1], m[3, 0] = s, -s
    d = np.diag([*rotor.hub_damping, c, c])
    d[2, 3], d[3, 2] = 2.0 * i * w, -2.0 * i * w
    own = w * w * (rotor.offset * s - i)
    k = np.diag([rotor.hub_stiffness, rotor.hub_stiffness, own, own])
    k[2, 3], k[3, 2] = c * w, -c * w
    a = np.block([[np.zeros((4, 4)), np.eye(4)], [-np.linalg.solve(m, k), -np.linalg.solve(m, d)]])
    values, vectors = np.linalg.eig(a)
    return values, vectors


def build(rotor: Rotor, rate: float) -> Model:
    """Build the rotor: a slide along x, one along y, a driven shaft, and blades on hinges."""
    m = Mechanism()
    along_x, along_y = rotor.hub_mass
    # What moves along y moves along x, too.
    for name, parent, axis, mass in (
        ("x", "world", (1, 0, 0), along_x - along_y), ("y", "slide x", (0, 1, 0), along_y),
    ):  # fmt: skip
        m.body(f"slide {name}", mass)
        m.hinge(name, parent=parent, child=f"slide {name}", kind="prismatic", axis=axis)
    for name, damping in zip("xy", rotor.hub_damping, strict=True):
        m.torsion(f"hub {name}", name, stiffness=rotor.hub_stiffness, damping=damping)
    m.body("shaft", 0.0)
    m.hinge("shaft", parent="slide y", child="shaft")
    m.drive("shaft", lambda t: (rate * t, rate, 0.0))
    arm = rotor.first / rotor.mass
    own = rotor.second - rotor.first * arm
    for k in range(rotor.blades):
        c, s = np.cos(2.0 * np.pi * k / rotor.blades), np.sin(2.0 * np.pi * k / rotor.blades)
        m.body(f"blade {k}", rotor.mass, com=(arm, 0, 0), inertia=(0.0, own, own))
        m.hinge(
            f"lag {k}", parent="shaft", child=f"blade {k}", at=(rotor.offset * c, rotor.offset * s, 0),
            rotation=[[c, -s, 0], [s, c, 0], [0, 0, 1]],
        )  # fmt: skip
        if rotor.lag_damping:
            m.torsion(f"damper {k}", f"lag {k}", damping=rotor.lag_damping)
    return m.build()


def fourier(rotor: Rotor, angle: Floats | float) -> tuple[Floats, Floats]:
    """Sines and cosines (..., blades) of the blades' azimuths, when the shaft stands at an angle."""
    azimuth = np.asarray(angle)[..., None] + 2.0 * np.pi * np.arange(rotor.blades) / rotor.blades
    return np.cos(azimuth), np.sin(azimuth)


def start(model: Model, rotor: Rotor, rate: float, state: Floats) -> Phase:
    """Phase of the model at (x, y, z_c, z_s) and their rates, (8,), with the shaft at angle zero."""
    cosine, sine = fourier(rotor, 0.0)
    x, y, zc, zs, xd, yd, zcd, zsd = state
    lag = zc * cosine + zs * sine
    lag_rate = (zcd + rate * zs) * cosine + (zsd - rate * zc) * sine
    q, qd = model.q.copy(), model.qd.copy()
    for name, place, speed in (
        ("x", x, xd), ("y", y, yd), *((f"lag {k}", lag[k], lag_rate[k]) for k in range(rotor.blades)),
    ):  # fmt: skip
        at, rate_at = model.bodies.freedom(name)
        q[at], qd[rate_at] = place, speed
    return model.system.at(q, qd)


def states(model: Model, rotor: Rotor, rate: float, q: Floats, qd: Floats) -> Floats:
    """(n, 8) float: x, y, z_c, z_s and their rates, of coordinates (n, n_q) and velocities (n, n_v)."""
    places = {name: model.bodies.freedom(name) for name in model.bodies.hinges}
    angle = q[:, places["shaft"][0]]
    lag = q[:, [places[f"lag {k}"][0] for k in range(rotor.blades)]]
    lag_rate = qd[:, [places[f"lag {k}"][1] for k in range(rotor.blades)]]
    cosine, sine = fourier(rotor, angle)
    share = 2.0 / rotor.blades
    zc, zs = share * np.sum(lag * cosine, axis=1), share * np.sum(lag * sine, axis=1)
    zcd = share * np.sum(lag_rate * cosine, axis=1) - rate * zs
    zsd = share * np.sum(lag_rate * sine, axis=1) + rate * zc
    x, y = q[:, places["x"][0]], q[:, places["y"][0]]
    xd, yd = qd[:, places["x"][1]], qd[:, places["y"][1]]
    return np.column_stack([x, y, zc, zs, xd, yd, zcd, zsd])


def simulated(rotor: Rotor, rate: float, turns: int, steps: int = 64, size: float = 1e-4) -> Floats:
    """Follow the least stable mode; return times, and the sizes of (x, y, z_c, z_s): (n, 2)."""
    values, vectors = eigenvalues(rotor, rate)
    # One of a pair: its state turns in a plane, and grows in it.
    worst = vectors[:, np.argmax(values.real)]
    model = build(rotor, rate)
    first = start(model, rotor, rate, size * worst.real / np.linalg.norm(worst.real[:4]))
    run = model.simulate(2.0 * np.pi * turns / rate, 2.0 * np.pi / (rate * steps), start=first)
    found = states(model, rotor, rate, run.q, run.qd)
    # In these both components of the pair count alike, and the turning leaves no trace.
    dual = np.linalg.inv(vectors)[np.argmax(values.real)]
    return np.column_stack([run.time, np.abs(found @ dual)])


def growth(trace: Floats) -> float:
    """Rate of growth of sizes (n, 2), by least squares of their logarithms."""
    return float(np.polyfit(trace[:, 0], np.log(trace[:, 1]), 1)[0])


def multipliers(rotor: Rotor, rate: float, steps: int = 64, size: float = 1e-6) -> Floats:
    """Rates of growth (8,), ascending, of all motions, of the simulated mechanism alone.

    The states after a turn by one blade, of small states along each of the axes, are the columns of Floquet's
    matrix: where blades have taken each other's places, the disc sees the same again. Steps are of a turn.
    """
    model, columns, steps = build(rotor, rate), [], steps // rotor.blades
    time = 2.0 * np.pi / (rate * rotor.blades)
    for one in np.eye(8):
        ends = []
        for sign in (size, -size):
            first = start(model, rotor, rate, sign * one)
            run = model.simulate(time, time / steps, every=steps, start=first)
            ends.append(states(model, rotor, rate, run.q[-1:], run.qd[-1:])[0])
        columns.append((ends[0] - ends[1]) / (2.0 * size))
    return np.sort(np.log(np.abs(np.linalg.eigvals(np.array(columns).T))) / time)
