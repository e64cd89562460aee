"""Closed loops: a four-bar by joints, by a stiff bushing and by MuJoCo, and what rows of loops cost.

    python analysis/benchmarks/loops.py [-o DIR] [--quick]

loops.csv: error of the angles after a second against processor seconds, all in one run; ``times_mujoco``:
seconds by those of MuJoCo at that error, on a line through its points. loops_costs.csv: seconds of
accelerations by the number of loops in a row. MuJoCo comes with the test extra.
"""

import argparse
from functools import partial
from itertools import pairwise

import made
import mujoco
import numpy as np
import pandas as pd

from bench import in_turn
from bench.scenes import run
from protochain.mechanics.motion import DormandPrince
from protochain.mechanisms import Mechanism, Model

OURS = "joint, Dormand-Prince"
UNTIL, G = 1.0, 9.81


def four_bar() -> Model:
    """Four-bar of the scene ``loops``: a kilogram per metre, the crank upright, at 3 rad/s."""
    m = Mechanism(gravity=(0, 0, -G))
    for name, along in (("crank", (0, 0, 1.0)), ("coupler", (2.0, 0, 0.5)), ("rocker", (0, 0, 1.5))):
        length = float(np.linalg.norm(along))
        m.body(name, length, com=np.multiply(0.5, along), inertia=length**3 / 12.0)
    m.hinge("A", "world", "crank", axis=(0, 1, 0), qd=3.0)
    m.hinge("B", "crank", "coupler", axis=(0, 1, 0), at=(0, 0, 1.0))
    m.hinge("D", "world", "rocker", axis=(0, 1, 0), at=(2.0, 0, 0))
    m.close("C", ("coupler", (2.0, 0, 0.5)), ("rocker", (0, 0, 1.5)), "revolute", axis=(0, 1, 0))
    return m.build()


def by_mujoco(step: float) -> np.ndarray:
    """Angles of the four-bar after a second; its loop is held by a constraint as stiff as the step allows."""

    def body(length: float) -> str:
        return f'mass="{length}" diaginertia="{" ".join([str(length**3 / 12.0)] * 3)}"'

    model = mujoco.MjModel.from_xml_string(f"""<mujoco>
      <option timestep="{step}" gravity="0 0 {-G}" integrator="RK4"><flag contact="disable"/></option>
      <worldbody>
        <body><joint axis="0 1 0"/><inertial pos="0 0 0.5" {body(1.0)}/>
          <body name="coupler" pos="0 0 1"><joint axis="0 1 0"/>
            <inertial pos="1 0 0.25" {body(np.hypot(2.0, 0.5))}/></body></body>
        <body name="rocker" pos="2 0 0"><joint axis="0 1 0"/><inertial pos="0 0 0.75" {body(1.5)}/></body>
      </worldbody>
      <equality><connect body1="coupler" body2="rocker" anchor="2 0 0.5" solref="{2 * step} 1"
        solimp="0.9999 0.9999 0.001"/></equality></mujoco>""")
    data = mujoco.MjData(model)
    data.qvel[:] = 3.0, -3.0, 2.0
    mujoco.mj_step(model, data, round(UNTIL / step))
    return np.array(data.qpos)


def peers(quick: bool) -> pd.DataFrame:
    """Points of MuJoCo, and of joints again beside them, in turn."""
    model = four_bar()
    exact = model.simulate(UNTIL, UNTIL, DormandPrince(1e-12)).q[-1]
    steps = (4e-3, 1e-3) if quick else (8e-3, 4e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5)
    tolerances = (1e-6, 1e-8) if quick else (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)
    calls = {("MuJoCo, Runge-Kutta 4", f"{step:g} s"): partial(by_mujoco, step) for step in steps}
    calls |= {
        (OURS, f"{tolerance:g}"): lambda tolerance=tolerance: model.simulate(
            UNTIL, UNTIL, DormandPrince(tolerance)
        ).q[-1]
        for tolerance in tolerances
    }
    timed = in_turn(list(calls.values()), turns=3 if quick else 9)
    rows = [
        {"method": method, "setting": setting, "seconds": each.least,
         "error": float(np.max(np.abs(each.result - exact)))}
        for (method, setting), each in zip(calls, timed, strict=True)
    ]  # fmt: skip
    return pd.DataFrame(rows)


def beside(points: pd.DataFrame) -> pd.Series:
    """Seconds by those of MuJoCo at the same error, on a line through its points in logarithms."""
    its = points[points["method"].str.startswith("MuJoCo")].sort_values("seconds")
    # Only points that are better than all quicker ones: others nobody would take.
    front = its[its["error"] < its["error"].cummin().shift(fill_value=np.inf)]
    line = list(pairwise(np.log(front[["error", "seconds"]].to_numpy())))

    def at(error: float) -> float:
        for (e0, s0), (e1, s1) in line:
            if e1 <= np.log(error) <= e0:
                return float(np.exp(s0 + (s1 - s0) * (np.log(error) - e0) / (e1 - e0)))
        return float("nan")

    return points["seconds"] / points["error"].map(at)


def parser() -> argparse.ArgumentParser:
    return made.parser(__doc__ or "")


def main() -> None:
    options = parser().parse_args()
    scene = run("loops", options.quick)
    points = peers(options.quick)
    both = pd.concat([scene.work[scene.work["method"] != OURS], points], ignore_index=True)
    both["times_mujoco"] = beside(both)
    print(both.to_string(index=False), scene.tables["costs"].to_string(index=False), sep="\n")
    if options.output:
        made.write(both, options.output / "loops.csv")
        made.write(scene.tables["costs"], options.output / "loops_costs.csv")


if __name__ == "__main__":
    main()
