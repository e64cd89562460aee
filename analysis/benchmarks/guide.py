"""The mechanisms of the guide, as its page has them, against other programs.

    python analysis/benchmarks/guide.py [-o DIR] [--quick]

Runs the code of analysis/docs/mechanisms.md and compares where bodies are at the end: the double pendulum and
the four-bar with scipy's DOP853 of their equations in absolute angles, the ball and the slider-crank with
scipy's of Coulomb's friction, the platform with MuJoCo, of the test extra, the others with closed forms.
Lines are those of the code, with imports.
"""

import argparse
import contextlib
import io
import re
from collections.abc import Callable, Iterator
from typing import Any

import made
import mujoco
import numpy as np
import pandas as pd
from made import DOCS
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

G = 9.81
EXACT = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-12}


def blocks() -> dict[str, str]:
    """Code of the page by what it makes."""
    found = re.findall(
        r"^```python\n(.*?)^```$", (DOCS / "mechanisms.md").read_text(), re.MULTILINE | re.DOTALL
    )
    marks = {
        "double pendulum": '"upper", "lower"', "four-bar": '"rocker"', "platform": '"plate"',
        "ball with spin": "lankarani_nikravesh(", "slider-crank": '"rubs"', "Geneva drive": '"in slot"',
        "quarter car": '"strut"', "gyroscope": '"top"', "PD arm": '"shoulder"',
    }  # fmt: skip
    return {name: next(code for code in found if mark in code) for name, mark in marks.items()}


def ran(code: str) -> Any:
    """Run code; return its last run."""
    space: dict[str, Any] = {}
    with contextlib.redirect_stdout(io.StringIO()):
        exec(code, space)
    return space["run"]


def pendulum(until: float) -> np.ndarray:
    """Angles of both rods of the double pendulum, by Lagrange's equations of their absolute angles."""
    rest = float(np.hypot(1.0 + 2.0 * np.sin(0.5), 2.0 * np.cos(0.5) - 1.0))

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        (a, b), w = y[:2], y[2:]
        c, s = np.cos(a - b), np.sin(a - b)
        mass = np.array([[4 / 3, 0.5 * c], [0.5 * c, 1 / 3]])
        right = np.array(
            [-0.5 * s * w[1] ** 2 - 1.5 * G * np.sin(a), 0.5 * s * w[0] ** 2 - 0.5 * G * np.sin(b)]
        )
        # Turned about y, a rod along -z points to (-sin, -cos).
        tip = -np.array([np.sin(a) + np.sin(b), np.cos(a) + np.cos(b)])
        along = np.array([[-np.cos(a), np.sin(a)], [-np.cos(b), np.sin(b)]])
        way = np.array([1.0, -1.0]) - tip
        length = np.hypot(*way)
        pull = 40.0 * (length - rest) + 0.5 * (-(along.T @ w) @ way) / length
        motor = 2.0 * abs(w[0])
        right += along @ (pull * way / length) + [-0.1 * w[0] - motor, motor]
        return np.array([*w, *np.linalg.solve(mass, right)])

    end = solve_ivp(rates, (0.0, until), [0.5, 0.5, 0.0, 0.0], **EXACT).y[:2, -1]
    return np.array([end[0], end[1] - end[0]])


def four_bar(until: float, start: np.ndarray, speeds: np.ndarray) -> np.ndarray:
    """Angles of crank, coupler and rocker: absolute angles, with the forces that close the loop."""
    lengths, signs = np.array([1.0, 2.0, 1.0]), np.array([1.0, 1.0, -1.0])
    inertia = lengths**3 / 3.0

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        angle, w = y[:3], y[3:]
        c, s = np.cos(angle), np.sin(angle)
        # The crank carries the coupler.
        mass = np.diag([inertia[0] + 2.0, *inertia[1:]])
        mass[0, 1] = mass[1, 0] = 2.0 * np.cos(angle[0] - angle[1])
        turn = 2.0 * np.sin(angle[0] - angle[1])
        right = np.array([-turn * w[1] ** 2, turn * w[0] ** 2, 0.0])
        right -= G * c * (0.5 * lengths**2 + [2.0, 0.0, 0.0])
        loop = signs * lengths * np.array([-s, c])
        bend = signs * lengths * np.array([c, s]) @ w**2
        whole = np.block([[mass, loop.T], [loop, np.zeros((2, 2))]])
        return np.array([*w, *np.linalg.solve(whole, [*right, *bend])[:3]])

    return np.asarray(solve_ivp(rates, (0.0, until), [*start, *speeds], **EXACT).y[:3, -1])


def ball(until: float) -> np.ndarray:
    """Way, velocity and spin of a ball that slides with backspin and rolls."""

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        # Its lowest point moves at v - r w.
        friction = -0.3 * G * (1.0 if y[1] - 0.1 * y[2] > 0.0 else 0.0)
        return np.array([y[1], friction, -0.1 * friction / 0.004])

    def slip(t: float, y: np.ndarray) -> float:
        return y[1] - 0.1 * y[2]

    slip.terminal = True  # type: ignore[attr-defined]  # as scipy asks
    slides = solve_ivp(rates, (0.0, until), [0.0, 2.0, -30.0], events=slip, **EXACT)
    x, v, w = slides.y[:, -1]
    return np.array([x + v * (until - slides.t[-1]), v, w])


def slider_crank(until: float, start: np.ndarray, speeds: np.ndarray) -> np.ndarray:
    """Absolute angles of crank and rod, and place of the block: friction by a multiplier of the loop."""
    r, mu, creep = 0.4, 0.25, 1e-3

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        (a, b, _), w = y[:3], y[3:]
        mass = np.diag([r**2 / 3.0 + 2.0 * r**2, 2.0 / 3.0, 1.5])
        mass[0, 1] = mass[1, 0] = r * np.cos(a - b)
        turn = r * np.sin(a - b)
        right = np.array([-turn * w[1] ** 2, turn * w[0] ** 2, 0.0])
        right -= G * np.array([2.5 * r * np.cos(a), np.cos(b), 0.0])
        loop = np.array([[-r * np.sin(a), -np.sin(b), -1.0], [r * np.cos(a), np.cos(b), 0.0]])
        bend = np.array([[r * np.cos(a), np.cos(b)], [r * np.sin(a), np.sin(b)]]) @ w[:2] ** 2
        for side in (1.0, -1.0):
            # The rod lifts the block by the second multiplier; the way carries the rest, up or down.
            rub = side * mu * np.tanh(w[2] / creep)
            whole = np.block([[mass, loop.T], [loop, np.zeros((2, 2))]])
            whole[2, 4] -= rub
            found = np.linalg.solve(whole, [*right[:2], -rub * 1.5 * G, *bend])
            if side * (1.5 * G - found[4]) >= 0.0:
                break
        return np.array([*w, *found[:3]])

    exact = {"method": "Radau", "rtol": 1e-10, "atol": 1e-11}
    return np.asarray(solve_ivp(rates, (0.0, until), [*start, *speeds], **exact).y[:3, -1])


def geneva(times: np.ndarray) -> np.ndarray:
    """Rate of the wheel by the crank's, and torque of the drive, in a slot of a Geneva drive of four."""
    k, rate = np.sin(np.pi / 4.0), 2.0 * np.pi
    angle = -np.pi / 4.0 + rate * times
    below = 1.0 - 2.0 * k * np.cos(angle) + k**2
    turns = -k * (np.cos(angle) - k) / below
    quickens = -k * (k**2 - 1.0) * np.sin(angle) / below**2
    # The pin goes round at a constant speed, but turns with the wheel.
    return np.array([turns, (0.3 + 1e-4) * turns * quickens * rate**2])


def quarter_car(run: Any, until: float) -> np.ndarray:
    """Tyre and strut by their transfer functions."""
    waves, sizes = np.array([3.0, 7.0, 16.0, 40.0, 70.0]), np.array([30, 12, 5, 2, 1]) * 1e-3
    out = np.zeros(2)
    for w, size in zip(waves, sizes, strict=True):
        tyre, strut = 180e3 + 100j * w, 18e3 + 1500j * w
        # Of wheel and car in the world, for a road of one.
        whole = np.array([[tyre + strut - 40.0 * w**2, -strut], [-strut, strut - 300.0 * w**2]])
        wheel, car = np.linalg.solve(whole, [tyre, 0.0])
        out += (size * np.exp(1j * w * until) * np.array([wheel - 1.0, car - wheel])).imag
    return out


def sagging() -> np.ndarray:
    """Angles where the arm of a PD controller hangs."""

    def lack(q: np.ndarray) -> np.ndarray:
        first, second = np.cos(q[0]), np.cos(q[0] + q[1])
        return 200.0 * (np.array([0.5, -0.8]) - q) - G * np.array([1.5 * first + 0.5 * second, 0.5 * second])

    return np.asarray(fsolve(lack, [0.5, -0.8], xtol=1e-14))


def platform(until: float, step: float) -> np.ndarray:
    """Where MuJoCo has the plate."""
    legs, ties = "", ""
    for k in range(6):
        angles = np.pi / 3 * k + (-1) ** k * np.array([0.2, -0.2])
        foot, top = (
            np.array([r * np.cos(a), r * np.sin(a), 0]) for r, a in zip((1.0, 0.5), angles, strict=True)
        )
        along = np.add(top, (0, 0, 1)) - foot
        side = np.cross(along, (0, 0, 1))

        def text(vector: np.ndarray) -> str:
            return " ".join(f"{x:.17g}" for x in vector)

        across, stiffness = text(np.cross(side, along)), 2000 + 100 * k
        legs += f"""<body pos="{text(foot)}"><joint axis="{text(side)}"/><joint axis="{across}"/>
          <inertial pos="{text(0.3 * along)}" mass="1" diaginertia="0.05 0.05 0.05"/>
          <body name="rod{k}" pos="{text(along)}">
            <joint type="slide" axis="{text(along)}" stiffness="{stiffness}"/>
            <inertial pos="{text(-0.2 * along)}" mass="0.5" diaginertia="0.02 0.02 0.02"/></body></body>"""
        ties += f"""<connect body1="rod{k}" body2="plate" anchor="0 0 0" solref="{2 * step} 1"
          solimp="0.9999 0.9999 0.001"/>"""
    model = mujoco.MjModel.from_xml_string(f"""<mujoco>
      <option timestep="{step}" gravity="0 0 {-G}" integrator="RK4"><flag contact="disable"/></option>
      <worldbody>{legs}<body name="plate" pos="0 0 1"><freejoint/>
        <inertial pos="0 0 0" mass="10" diaginertia="0.4 0.4 0.8"/></body></worldbody>
      <equality>{ties}</equality></mujoco>""")
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, round(until / step))
    return np.array(data.body("plate").xpos)


def measured(quick: bool) -> Iterator[tuple[str, Any, np.ndarray, np.ndarray, str]]:
    """Name, run, what it found at the end, what another program found, and which."""
    codes = blocks()
    run = ran(codes["double pendulum"])
    yield "double pendulum", run, run.q[-1], pendulum(run.time[-1]), "scipy, DOP853: angles, rad"
    run = ran(codes["four-bar"])
    sums: Callable[[np.ndarray], np.ndarray] = lambda q: np.array([q[0], q[0] + q[1], q[2]])  # noqa: E731
    exact = four_bar(run.time[-1], sums(run.q[0]), sums(run.qd[0]))
    yield "four-bar", run, sums(run.q[-1]), exact, "scipy, DOP853, loop by its forces: angles, rad"
    run = ran(codes["ball with spin"])
    state = run.model.state(run.end)
    found = np.array([state.point("ball")[0], state.velocity("ball")[0], state.spin("ball")[1]])
    yield "ball with spin", run, found, ball(run.time[-1]), "scipy, Coulomb's friction: m, m/s, rad/s"
    run = ran(codes["platform"])
    found = run.model.state(run.end).point("plate")
    exact = platform(run.time[-1], 1e-4 if quick else 2e-5)
    yield "platform", run, found, exact, "MuJoCo, Runge-Kutta 4: place of the plate, m"
    run = ran(codes["slider-crank"])
    sums = lambda q: np.array([q[0], q[0] + q[1], q[2]])  # noqa: E731
    exact = slider_crank(run.time[-1], sums(run.q[0]), sums(run.qd[0]))
    yield "slider-crank", run, sums(run.q[-1]), exact, "scipy, Coulomb's friction: rad, m"
    run = ran(codes["Geneva drive"])
    found = np.array([run.motion["wheel rate"] / 360.0, run.motion["drive drive"]])
    yield "Geneva drive", run, found, geneva(run.time), "closed form: rates, torques, N m"
    run = ran(codes["quarter car"])
    found = run.motion[["tyre", "strut"]].to_numpy()[-1]
    yield "quarter car", run, found, quarter_car(run, run.time[-1]), "transfer functions: m"
    run = ran(codes["gyroscope"])
    turned = 3.0 * run.time[-1] - 0.5 * np.pi
    exact = np.array([np.sin(0.6) * np.cos(turned), np.sin(0.6) * np.sin(turned), np.cos(0.6)])
    axis = run.model.state(run.end).rotation("top")[:, 2]
    yield "gyroscope", run, axis, exact, "steady precession: direction of its axis"
    run = ran(codes["PD arm"])
    yield "PD arm", run, run.q[-1], sagging(), "scipy, fsolve of the balance: angles, rad"


def parser() -> argparse.ArgumentParser:
    return made.parser(__doc__ or "")


def main() -> None:
    options = parser().parse_args()
    codes = blocks()
    rows = []
    for name, run, found, exact, program in measured(options.quick):
        rows.append(
            {"mechanism": name, "lines": len([line for line in codes[name].splitlines() if line]),
             "against": program, "error": float(np.max(np.abs(found - exact))),
             "largest": float(np.max(np.abs(exact))), "energy": run.audit().energy}
        )  # fmt: skip
        print(rows[-1], flush=True)
    if options.output:
        made.write(pd.DataFrame(rows), options.output / "guide.csv")


if __name__ == "__main__":
    main()
