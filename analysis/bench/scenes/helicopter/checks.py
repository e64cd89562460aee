"""Ground resonance, landing and flight with rigid blades, frequencies of blades, and energy."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pandas as pd

from bench.cases import Found, check, vanishes
from bench.fits import extrapolated
from bench.scenes.beam.parts import ritz
from bench.scenes.helicopter import landing, resonance
from bench.scenes.helicopter.modes import in_modes
from bench.scenes.helicopter.parts import BLADE, LEGS, MODES, RATE, WEIGHT, groups
from protochain.core.arrays import Floats
from protochain.mechanics.multibody import HingeKind, Tree
from protochain.mechanisms import Mechanism, Model, Run
from protochain.mechanisms.assumed import assumed_modes
from protochain.mechanisms.flexible.dynamics import forward_dynamics
from protochain.mechanisms.flexible.flexible import Flexible, elastic
from protochain.mechanisms.linear import frequencies
from protochain.mechanisms.segments import Beam, add_beam

HAMMOND = "Hammond's equations, 1974"
LINEAR = replace(LEGS, squared=0.0, friction=0.0)
RIGID = replace(landing.RIGID, legs=LINEAR)
THIN = replace(BLADE, polar=1e-5 * BLADE.polar, twist=1e-5 * BLADE.twist)
"""With the frequency of torsion, but next to no rotary inertia in bending, as Euler and Bernoulli have it."""


def ground_resonance(rates: tuple[float, ...], turns: int = 12) -> tuple[pd.DataFrame, list[Found]]:
    """Growth of the least stable motion by the rate of the shaft (rpm), in closed form and simulated.

    The growth of that motion alone is followed over some turns.
    """
    rotor = resonance.HAMMOND
    bare = replace(rotor, lag_damping=0.0)
    rows, found = [], []
    for name, of, rpm, known in (
        ("with all dampers, growth at 250 rpm, 1/s", rotor, 250.0, -0.33),
        ("without lag dampers, growth at 258 rpm, 1/s", bare, 258.0, 1.03),
    ):
        rate = rpm * resonance.RPM
        exact = float(np.max(resonance.eigenvalues(of, rate)[0].real))
        simulated = resonance.growth(resonance.simulated(of, rate, turns))
        found += [
            check(name, exact, known, 0.005, "worked out before", "absolute"),
            check(f"{name}, simulated", simulated, exact, 0.01, HAMMOND),
        ]
    for rpm in rates:
        for damped, of in ((True, rotor), (False, bare)):
            rate = rpm * resonance.RPM
            growths = np.sort(resonance.eigenvalues(of, rate)[0].real)
            # The hub is as quick however slowly the shaft turns.
            turned = resonance.multipliers(of, rate, max(64, round(400.0 * 2.0 * np.pi / rate)))
            rows.append((rpm, damped, growths[-1], turned[-1], np.max(np.abs(turned - growths))))
    table = pd.DataFrame(rows, columns=["rpm", "dampers", "growth", "simulated", "error"])
    label = f"growth of all motions by Floquet, {len(rates)} rates, largest error, 1/s"
    found.append(vanishes(label, float(table["error"].max()), 1e-4, HAMMOND))
    return table, found


def rigid_landing(sinks: tuple[float, ...]) -> Iterator[Found]:
    """Forces of linear legs under rigid blades, against the oscillator, until they leave the ground."""
    for sink in sinks:
        helicopter, run = landing.touchdown(RIGID, sink, 0.3, 1e-3)
        legs = landing.traced(helicopter, run)["legs"].to_numpy()
        air = landing.heave_damping(helicopter)
        k, c = 4.0 * LINEAR.stiffness, 4.0 * LINEAR.damping
        exact = landing.oscillator(run.time, k, c, air, sink, WEIGHT * (1.0 - landing.LIFT))[1]
        yield from _alike(f"rigid, sink {sink:g} m/s", legs, exact, 1e-6, "damped oscillator")
    helicopter, run = landing.touchdown(replace(RIGID, mounts=True), sinks[-1], 0.2, 1e-3)
    legs = landing.traced(helicopter, run)["legs"].to_numpy()
    exact = landing.two_masses(run.time, helicopter, sinks[-1])
    label = f"rigid, on mounts, sink {sinks[-1]:g} m/s"
    yield from _alike(label, legs, exact, 1e-5, "two masses, by the exponential of their matrix")


def _alike(label: str, found: Floats, exact: Floats, bound: float, source: str) -> Iterator[Found]:
    left = np.flatnonzero(exact[1:] <= 0.0)
    on = slice(0, left[0] if len(left) else None)
    most = float(np.max(exact[on]))
    yield check(f"{label}: largest force of the legs, N", float(np.max(found[on])), most, bound, source)
    worst = float(np.max(np.abs(found[on] - exact[on]))) / most
    yield vanishes(f"{label}: force over time, of the largest", worst, bound, source)


def flight() -> Iterator[Found]:
    """Speed after a gust and after a step of the pitch, of a helicopter with rigid blades."""
    for name, wind, change in (("gust", landing.gust, None), ("step of pitch", None, landing.step)):
        helicopter, run = landing.hovering(landing.RIGID, 1.0, 2e-3, wind=wind, change=change)
        climb = float(helicopter.model.state(run.end).velocity("fuselage")[2])
        exact = landing.climbing(helicopter, 1.0, wind, change)
        yield check(f"rigid, {name}: climb after 1 s, m/s", climb, exact, 1e-8, "integral in closed form")


def turning(beam: Beam, cells: int, rate: float, modes: bool = False, bends: str = "yzx") -> Model:
    """Build a blade on a shaft that turns."""
    m = Mechanism()
    blade = add_beam(m, "blade", beam, cells, joint={"axis": (0, 0, 1)}, bends=bends)
    m.drive("blade", lambda t: (rate * t, rate, 0.0))
    return in_modes(m.build(), groups((blade,))) if modes else m.build()


def exactly(beam: Beam, rate: float) -> Floats:
    """(4,) float: frequencies of two modes of flap, of lag and of torsion; bending without rotary inertia."""
    flap, lag = (np.sqrt(k / (beam.mass * beam.length**4)) for k in np.broadcast_to(beam.bending, 2))
    in_plane = lag * np.sqrt(ritz(rate / lag)[0] ** 2 - (rate / lag) ** 2)
    # Rods as round as these twist as if they did not rotate.
    torsion = 0.5 * np.pi * np.sqrt(beam.twist / (beam.polar * beam.length**2))
    return np.array([*(flap * np.array(ritz(rate / flap)[:2])), in_plane, torsion])


def of_segments(beam: Beam, rate: float, cells: int, modes: bool = False) -> Floats:
    """(4,) float: the same four of a blade of segments, those next to the exact ones."""
    found = frequencies(turning(beam, cells, rate, modes))
    return _next_to(exactly(beam, rate), found)


def without_end(beam: Beam, rate: float, cells: int) -> Floats:
    """(4,) float: the same for ever more cells, from two numbers of them."""
    return extrapolated(of_segments(beam, rate, cells), of_segments(beam, rate, 2 * cells))


def frequencies_about(beam: Beam, rate: float, cells: int, axis: str) -> Floats:
    """(cells,) float: frequencies of a blade that bends, or twists, about one axis, without end.

    Only the lowest mean something.
    """
    found = [frequencies(turning(beam, n, rate, bends=axis))[:cells] for n in (cells, 2 * cells)]
    return extrapolated(found[0], found[1])


def _next_to(wanted: Floats, found: Floats) -> Floats:
    return np.array([found[np.argmin(np.abs(found - w))] for w in wanted])


def _assumed(rate: float) -> Floats:
    """Frequencies of a blade as one body with shapes, on a shaft that turns."""
    shapes = assumed_modes(BLADE, MODES["y"], MODES["z"], MODES["x"])
    one = np.zeros((1, 3))
    tree = Tree(
        np.array([-1]), np.array([HingeKind.REVOLUTE]), one, np.eye(3)[None], np.ones(1), one,
        np.eye(3)[None], driven=np.array([True]),
    )  # fmt: skip
    flexible = Flexible(tree, (shapes,), np.array([-1]))
    n = shapes.n_shapes

    def acceleration(place: Floats, speed: Floats) -> Floats:
        q, qd = np.append(0.0, place), np.append(rate, speed)
        torque = elastic(flexible, q)[1]
        torque[0] = 0.0
        return forward_dynamics(flexible, q, qd, torque)[1:]

    step, still = 1e-5, np.zeros(n)
    a = np.zeros((2 * n, 2 * n))
    a[:n, n:] = np.eye(n)
    for k, one_shape in enumerate(step * np.eye(n)):
        a[n:, k] = (acceleration(one_shape, still) - acceleration(-one_shape, still)) / (2.0 * step)
        a[n:, n + k] = (acceleration(still, one_shape) - acceleration(still, -one_shape)) / (2.0 * step)
    found = np.linalg.eigvals(a).imag
    return np.sort(found[found > 0.0])


def blades(cells: int) -> Iterator[Found]:
    """Frequencies of blades at 45 rad/s."""
    names = ("first flap", "second flap", "lag", "torsion")
    found, exact = without_end(THIN, RATE, cells), exactly(THIN, RATE)
    for k, name in enumerate(names):
        label = f"{name} of a thin blade at 45 rad/s, n to infinity"
        source = "pi/2 sqrt(GJ/I l^2)" if name == "torsion" else "Ritz, 40 polynomials"
        yield check(label, found[k], exact[k], 5e-4, source)
    full = without_end(BLADE, RATE, cells)
    same, modes = of_segments(BLADE, RATE, cells), of_segments(BLADE, RATE, cells, modes=True)
    assumed = _next_to(full, _assumed(RATE))
    for k, name in enumerate(names):
        label = f"{name} at 45 rad/s, in modes"
        yield check(f"{label} of {cells} cells", modes[k], same[k], 0.03, f"{cells} cells, free")
        yield check(f"{label} assumed of one body", assumed[k], full[k], 0.03, "segments, n to infinity")


def balance(name: str, run: Run, bound: float) -> Found:
    """Energy less work, which must not change."""
    return vanishes(f"energy that is no work, {name}", run.audit().energy, bound, "the work")
