"""Random mechanisms, by seeds, against MuJoCo at equal error: trees, loops, springs, dampers, drives.

Right is within a millionth of the scale; what a mechanism cannot be is refused. Nothing differs unsaid.
"""

import numpy as np
import pytest
from fixtures.random_loops import dense_accelerations, dense_matrices
from scipy.interpolate import CubicSpline

from protochain.core.errors import ProtochainError
from protochain.mechanics.motion import DormandPrince
from protochain.mechanisms import Mechanism

mujoco = pytest.importorskip("mujoco", reason="MuJoCo comes with the extra robots")

UNTIL = 0.25
SCALE = 1e-6
"""Of places, by the size of the mechanism and how far it moves."""
KINDS = ("revolute", "prismatic", "ball", "fixed")


def made(seed):
    """A tree of two to seven bodies, free or hung, what acts between them, and what is driven."""
    rng = np.random.default_rng(seed)
    m = Mechanism(gravity=rng.normal(size=3) * (0, 0, 5) + (0, 0, -5))
    n = int(rng.integers(2, 8))
    hinges = []
    for k in range(n):
        m.body(f"b{k}", rng.uniform(0.5, 3.0), rng.normal(size=3) * 0.2, rng.uniform(0.05, 0.09, 3))
        if k and rng.random() < 0.1:
            continue
        kind = rng.choice(KINDS, p=(0.55, 0.2, 0.15, 0.1))
        parent = "world" if k == 0 or rng.random() < 0.1 else f"b{rng.integers(k)}"
        m.hinge(f"h{k}", parent, f"b{k}", str(kind), at=rng.normal(size=3) * 0.5, axis=rng.normal(size=3))
        if kind in ("revolute", "prismatic"):
            hinges.append(f"h{k}")
    for k, name in enumerate(hinges):
        if rng.random() < 0.5:
            rest = float(rng.normal() * 0.3)
            m.torsion(f"t{k}", name, stiffness=rng.uniform(1, 60), damping=rng.uniform(0, 2), rest=rest)
    for k in range(int(rng.integers(0, 4))):
        a, b = rng.choice(n, 2, replace=False)
        ends = (f"b{a}", rng.normal(size=3) * 0.3), (f"b{b}", rng.normal(size=3) * 0.3)
        m.spring(f"s{k}", *ends, stiffness=rng.uniform(5, 80), damping=rng.uniform(0, 3))
    driven = str(rng.choice(hinges)) if hinges and rng.random() < 0.3 else None
    return m, driven, rng


def close(m, rng):
    """Hold a point of the last body by a ball where it is, if it is not fixed to the world."""
    state = m.build().state()
    name = state.bodies.names[-1]
    at = rng.normal(size=3) * 0.3
    m.close("loop", (name, at), ("world", state.point(name, at)), "spherical")


def differs(seed, loop):
    """Largest distance of bodies from where MuJoCo has them, by the scale; None if it is refused."""
    m, driven, rng = made(seed)
    text = m.to_mjcf()
    torque, prescribed = None, False
    if driven is not None:
        size, rate = rng.uniform(1.0, 5.0), rng.uniform(2.0, 9.0)
        torque = lambda t: size * np.sin(rate * t)  # noqa: E731
        prescribed = not loop and rng.random() < 0.5
    if prescribed:
        a, w = 0.1 * size, rate
        m.drive(driven, lambda t: (a - a * np.cos(w * t), a * w * np.sin(w * t), a * w * w * np.cos(w * t)))
    elif driven is not None:
        m.torque("drive", driven, torque)
    if loop:
        close(m, rng)
        return _by_dense_algebra(m)
    try:
        run = m.build().simulate(UNTIL, 0.005, DormandPrince(1e-9))
    except ProtochainError:
        return None
    if prescribed:
        # MuJoCo is given but the torque that we find for the drive, and must follow the motion.
        torque = CubicSpline(run.time, run.motion[f"{driven} drive"])
    found, state = [], run.model.state(run.end)
    names = [name for name in state.bodies.names if not name.endswith((": x", ": y"))]
    ours = np.array([state.point(name, (0.1, 0.2, 0.3)) for name in names])
    for step in (1e-3, 5e-4):
        model = mujoco.MjModel.from_xml_string(text)
        model.opt.timestep, model.opt.disableflags = step, mujoco.mjtDisableBit.mjDSBL_CONTACT
        data = mujoco.MjData(model)
        if torque is not None:
            # MuJoCo asks for forces at the times of the stages.
            of = model.joint(driven).dofadr[0]
            mujoco.set_mjcb_passive(lambda _, d, of=of: _push(d, of, torque))
        try:
            mujoco.mj_step(model, data, round(UNTIL / step))
        finally:
            mujoco.set_mjcb_passive(None)
        turned = [
            data.body(name).xmat.reshape(3, 3) @ (0.1, 0.2, 0.3) + data.body(name).xpos for name in names
        ]
        found.append(np.array(turned))
    # Of the two, with their error of order four taken off.
    wanted = found[1] + (found[1] - found[0]) / 15.0
    scale = max(1.0, float(np.max(np.abs(ours))))
    return float(np.max(np.abs(ours - wanted))) / scale


def _push(data, of, torque):
    data.qfrc_passive[of] += torque(data.time)


def _by_dense_algebra(m):
    """Of a loop, that MuJoCo holds but softly, accelerations along the run are held against dense algebra."""
    try:
        model = m.build()
        run = model.simulate(UNTIL, 0.005, DormandPrince(1e-9))
    except ProtochainError:
        return None
    assert run.audit().gap < 1e-10
    assert run.audit().energy < SCALE
    worst = 0.0
    for k in range(0, len(run.time), 10):
        at = model.system.at(run.q[k], run.qd[k], float(run.time[k]))
        dense = dense_matrices(model, at.q, at.qd)
        pushed = dense._replace(torque=dense.torque + at.torque - model.state(at).weight)
        found = model.system.accelerations(at.time, at.q, at.qd, at.torque, at.loads, at.factors)[0]
        scale = max(1.0, np.max(np.abs(np.linalg.solve(dense.mass, pushed.torque)), initial=0.0))
        worst = max(worst, np.max(np.abs(found - dense_accelerations(pushed)), initial=0.0) / scale)
    return worst


def wrong(seeds, loop):
    found = {seed: differs(seed, loop) for seed in seeds}
    refused = [seed for seed, by in found.items() if by is None]
    assert len(refused) <= len(found) // 10, refused
    return {seed: by for seed, by in found.items() if by is not None and not by < SCALE}


def test_twenty_random_mechanisms_move_as_in_mujoco():
    assert wrong(range(20), loop=False) == {}


def test_what_a_loop_holds_still_has_no_energy_that_is_lost():
    """Of seed 489 rounding alone moves, of which all is an error."""
    assert differs(489, loop=True) < SCALE


@pytest.mark.slow
def test_five_hundred_random_mechanisms_move_as_in_mujoco_or_keep_their_loops():
    assert wrong(range(20, 420), loop=False) == {}
    assert wrong(range(420, 520), loop=True) == {}
