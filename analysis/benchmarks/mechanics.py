"""Forward dynamics and M^-1 tau of serial chains, beside the robotics engines.

    python analysis/benchmarks/mechanics.py [-o DIR] [--quick]

Medians of interleaved calls in one process, from q, qd and tau to accelerations; ratios above one mean that
protochain is faster. Pinocchio comes with the test extra; DART is timed too where dartpy is installed. Chains
of rods, free and damped, are also simulated beside MuJoCo, by the same method and step, from model to end.
"""

import argparse
import json
import os
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import made
import mujoco
import numpy as np
import pandas as pd
import pinocchio as pin

from bench import in_turn
from protochain.mechanics.multibody import HingeKind, Tree, forward_dynamics, pose, random_tree, solve_mass
from protochain.mechanisms import Mechanism

try:
    import dartpy
except ImportError:
    dartpy = None


LONG, SHORT = (100, 1000, 10_000, 100_000), (1, 2, 10, 30, 100, 300, 800)
CHAINS = (1, 2, 10, 30, 100, 300, 1000, 100_000)


def medians(calls: dict[str, Callable[[], object]], seconds: float = 1.0) -> dict[str, float]:
    """Return the median time of each call, taken in turn so that a slow moment of the machine strikes all."""
    for call in calls.values():
        call()
    found = in_turn(list(calls.values()), seconds * len(calls), 5, clock=perf_counter)
    return {name: each.median for name, each in zip(calls, found, strict=True)}


def pinocchio_aba(tree: Tree, q: np.ndarray, qd: np.ndarray, tau: np.ndarray) -> Callable[[], object]:
    """Return a call of pin.aba on the same chain."""
    model, joint = pin.Model(), 0
    for b in range(tree.n_bodies):
        placement = pin.SE3(np.array(tree.placement[b]), np.array(tree.offset[b]))
        joint = model.addJoint(joint, pin.JointModelRZ(), placement, f"joint{b}")
        inertia = pin.Inertia(tree.mass[b], np.array(tree.com[b]), np.array(tree.inertia[b]))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.gravity.setZero()
    data = model.createData()
    return lambda: pin.aba(model, data, q, qd, tau)


def dart_forward(tree: Tree, q: np.ndarray, qd: np.ndarray, tau: np.ndarray) -> Callable[[], object]:
    """Return a call of DART's forward dynamics on the same chain."""
    skeleton, body = dartpy.dynamics.Skeleton("chain"), None
    for b in range(tree.n_bodies):
        joint, body = skeleton.createRevoluteJointAndBodyNodePair(body)
        joint.setName(f"joint{b}")
        body.setName(f"body{b}")
        joint.setAxis([0, 0, 1])
        placement = np.eye(4)
        placement[:3, :3], placement[:3, 3] = tree.placement[b], tree.offset[b]
        joint.setTransformFromParentBodyNode(dartpy.math.Isometry3(placement))
        body.setInertia(dartpy.dynamics.Inertia(tree.mass[b], tree.com[b], tree.inertia[b]))
        body.setGravityMode(False)

    def call() -> object:
        skeleton.setPositions(q)
        skeleton.setVelocities(qd)
        skeleton.setForces(tau)
        skeleton.computeForwardDynamics()
        return skeleton.getAccelerations()

    return call


def engines(seconds: float, sizes: tuple[int, ...]) -> pd.DataFrame:
    """Microseconds of each engine."""
    rows = []
    for n in sizes:
        us = {name: 1e6 * taken for name, taken in medians(calls_of(n), seconds).items()}
        names = {"forward": "forward", "solve": "solve", "pin": "pinocchio", "dart": "dart"}
        rows.append({"hinges": n} | {f"{shown}_us": us.get(name) for name, shown in names.items()})
    return pd.DataFrame(rows, dtype=float).astype({"hinges": int})


def calls_of(n: int) -> dict[str, Callable[[], object]]:
    """Return the same computation by each engine that can do it."""
    tree = random_tree(n, n, 0.0, HingeKind.REVOLUTE)
    rng = np.random.default_rng(0)
    q, qd, tau = rng.uniform(-3, 3, n), rng.normal(size=n), rng.normal(size=n)
    frames = pose(tree, q)
    calls: dict[str, Callable[[], object]] = {
        "forward": lambda: forward_dynamics(tree, q, qd, tau),
        "solve": lambda: solve_mass(tree, frames, tau),
    }
    # Pinocchio's Data is O(n^3) in memory: at 800 hinges it does not fit.
    if n <= 400:
        calls["pin"] = pinocchio_aba(tree, q, qd, tau)
    if dartpy:
        calls["dart"] = dart_forward(tree, q, qd, tau)
    return calls


def chain(n: int, damping: float) -> Mechanism:
    """Hanging rods on hinges across each other, with a damper in each if damped."""
    m = Mechanism(gravity=(0.0, 0.0, -9.81))
    for k in range(n):
        m.body(f"b{k}", 1.0, (0.0, 0.0, -0.05), (1e-3, 1e-3, 2e-4))
        above, at = (f"b{k - 1}", (0.0, 0.0, -0.1)) if k else ("world", (0.0, 0.0, 0.0))
        m.hinge(f"h{k}", above, f"b{k}", at=at, axis=(0, 1, 0) if k % 2 else (1, 0, 0), q=0.3 / (1 + k))
        if damping:
            m.torsion(f"d{k}", f"h{k}", damping=damping)
    return m


def simulated(seconds: float, sizes: tuple[int, ...]) -> pd.DataFrame:
    """Microseconds a step of Runge-Kutta's method in simulate() and in MuJoCo; seconds of build()."""
    rows = []
    for n in sizes:
        for damping in (0.0, 0.01):
            made = chain(n, damping)
            began = perf_counter()
            model = made.build()
            built = perf_counter() - began
            steps = max(2, min(2000, 20_000 // n))
            calls: dict[str, Callable[[], object]] = {
                "ours": lambda m=model, k=steps: m.simulate(k * 1e-5, 1e-5, every=k, balance=np.inf)
            }
            if n <= 300:
                # MuJoCo's compiler recurses over bodies.
                other = mujoco.MjModel.from_xml_string(made.to_mjcf())
                other.opt.timestep = 1e-5
                other.opt.disableflags = mujoco.mjtDisableBit.mjDSBL_CONTACT
                calls["mujoco"] = lambda m=other, k=steps: mujoco.mj_step(m, mujoco.MjData(m), k)
            us = {name: 1e6 * taken / steps for name, taken in medians(calls, seconds).items()}
            rows.append(
                {"hinges": n, "damped": bool(damping), "step_us": us["ours"], "mujoco_us": us.get("mujoco"),
                 "build_s": built}
            )  # fmt: skip
            print(rows[-1], flush=True)
    return pd.DataFrame(rows)


def scaling(seconds: float, sizes: tuple[int, ...]) -> pd.DataFrame:
    """Time and memory for each hinge."""
    rows = []
    for n in sizes:
        reader, writer = os.pipe()
        pid = os.fork()
        if pid == 0:
            os.write(writer, json.dumps(of_size(n, seconds)).encode())
            os._exit(0)
        os.close(writer)
        with os.fdopen(reader) as told:
            rows.append(json.loads(told.read()))
        os.waitpid(pid, 0)
    return pd.DataFrame(rows)


def of_size(n: int, seconds: float) -> dict[str, float | None]:
    """One row: run in a process of its own, whose peak memory is then this chain's."""
    small = random_tree(3, 0, 0.0, HingeKind.REVOLUTE)
    forward_dynamics(small, np.zeros(3), np.zeros(3), np.zeros(3))
    rng = np.random.default_rng(0)
    tree = random_tree(n, n, 0.0, HingeKind.REVOLUTE)
    q, qd, tau = rng.uniform(-3, 3, n), rng.normal(size=n), rng.normal(size=n)
    kept = sum(array.nbytes for array in (*vars(tree).values(), q, qd, tau) if isinstance(array, np.ndarray))
    # Linux forgets the peak when told so: what comes after is what forward dynamics needs itself.
    Path("/proc/self/clear_refs").write_text("5")
    before = memory("VmRSS")
    taken = medians({"forward": lambda: forward_dynamics(tree, q, qd, tau)}, seconds)["forward"]
    used = kept + memory("VmHWM") - before
    # What small chains need is lost in what the process has anyway.
    return {
        "hinges": n,
        "ns_per_hinge": 1e9 * taken / n,
        "bytes_per_hinge": used / n if n >= 10_000 else None,
    }


def memory(name: str) -> int:
    """Return a figure of /proc/self/status, in bytes."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(name))


def parser() -> argparse.ArgumentParser:
    return made.parser(__doc__)


def main() -> None:
    options = parser().parse_args()
    seconds, n = (0.05, 1) if options.quick else (1.0, None)
    # Scaling first, while the process is small: peak memory is measured.
    for name, measure, sizes in (
        ("mechanics_scaling", scaling, LONG), ("mechanics", engines, SHORT),
        ("mechanics_steps", simulated, CHAINS),
    ):  # fmt: skip
        table = measure(seconds, sizes[:n])
        print(f"\n{table.to_string(index=False, float_format='%.1f')}", flush=True)
        if options.output:
            made.write(table, options.output / f"{name}.csv")


if __name__ == "__main__":
    main()
