"""Cost of a compiled step of an arm of seven links with each kind of load, against the arm without loads.

    python analysis/benchmarks/loads.py [-o DIR] [--quick]

loads_costs.csv: microseconds of a step of Runge-Kutta 4 of 0.1 ms, the lowest of several runs in turn,
and the ratio to a step of the plain arm. Functions of time of motors and drives are the user's, in Python.
Their values at all stages are computed before the steps, and are part of the cost.
"""

import argparse
import math
from collections.abc import Callable
from functools import partial

import made
import pandas as pd

from bench import in_turn
from protochain.mechanics.motion import RungeKutta4
from protochain.mechanisms import Mechanism

LINKS, STEP = 7, 1e-4


def arm(ball: bool = False) -> Mechanism:
    """Seven links in gravity on hinges across each other, the fourth on a ball joint if wanted."""
    m = Mechanism(gravity=(0, 0, -9.81))
    for k in range(LINKS):
        m.body(f"link{k}", 1.0, com=(0, 0.01, 0.15), inertia=(0.01, 0.012, 0.004))
        parent, at = (f"link{k - 1}", (0, 0, 0.3)) if k else ("world", (0, 0, 0))
        if ball and k == 3:
            m.hinge("h3", parent, "link3", "ball", at=at, q=(0.3, 0.1, -0.2))
        else:
            m.hinge(f"h{k}", parent, f"link{k}", axis=(k % 2, 1 - k % 2, 0), at=at, q=0.1 + 0.05 * k)
    return m


def swing(k: int) -> Callable[[float], tuple[float, float, float]]:
    """Motion that begins where a hinge of the arm is."""

    def motion(time: float) -> tuple[float, float, float]:
        s, c = math.sin(2.0 * time), math.cos(2.0 * time)
        return 0.1 + 0.05 * k + 0.2 * (1.0 - c), 0.4 * s, 0.8 * c

    return motion


def bush(m: Mechanism) -> None:
    m.bushing("b", ("link0", (0, 0, 0.3)), ("world", (0, 0, 0.3)), [1.0] * 3 + [20.0] * 3, 0.1)


def stop(m: Mechanism) -> None:
    for k in range(LINKS):
        m.stop(f"s{k}", f"h{k}", -0.5, 0.5, stiffness=100.0, damping=1.0)


def rub(m: Mechanism, coefficient: float = 0.0) -> None:
    for k in range(LINKS):
        m.friction(f"f{k}", f"h{k}", torque=0.02, coefficient=coefficient, radius=0.02, speed=0.05)


def follow(m: Mechanism, feed_forward: bool = False) -> None:
    m.motor("motor", {f"h{k}": swing(k) for k in range(LINKS)}, 50.0, 5.0, feed_forward)


def drive(m: Mechanism) -> None:
    for k in range(LINKS):
        m.drive(f"h{k}", swing(k))


LOADS: dict[str, Callable[[Mechanism], None]] = {
    "no load": lambda m: None, "bushing": bush, "7 stops": stop, "7 frictions": rub,
    "7 frictions by the forces of hinges": lambda m: rub(m, 0.1), "motors of 7 hinges": follow,
    "motors of 7 hinges with feed-forward": lambda m: follow(m, True), "7 drives": drive,
}  # fmt: skip


def parser() -> argparse.ArgumentParser:
    return made.parser(__doc__ or "")


def main() -> None:
    options = parser().parse_args()
    steps = 200 if options.quick else 4000
    models = {}
    for name, load in LOADS.items():
        mechanism = arm()
        load(mechanism)
        models[name] = mechanism.build()
    models["a ball joint"] = arm(ball=True).build()
    calls = [
        partial(model.simulate, steps * STEP, STEP, RungeKutta4(), every=steps) for model in models.values()
    ]
    timed = in_turn(calls, turns=3 if options.quick else 9)
    plain = timed[0].least
    table = pd.DataFrame([
        {"load": name, "us_per_step": 1e6 * run.least / steps, "ratio": run.least / plain}
        for name, run in zip(models, timed, strict=True)
    ])  # fmt: skip
    print(table.to_string(index=False))
    if options.output:
        made.write(table.round(3), options.output / "loads_costs.csv")


if __name__ == "__main__":
    main()
