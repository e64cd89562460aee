"""Explicit steps in one kernel, against the same steps call by call."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from protochain.core.errors import Fault, MechanicsError
from protochain.mechanics.motion import Applied, DormandPrince, Equations, RungeKutta4, StepTooLargeError
from protochain.mechanics.tableaux import CLASSICAL, DORMAND_PRINCE
from protochain.mechanisms import Mechanism
from protochain.mechanisms.assemble import Body, Hinge
from protochain.mechanisms.elements import Acting, Gravity
from protochain.mechanisms.explicit import InOneKernel

Y = (0, 1, 0)


def four_bar(springs=True):
    m = Mechanism(gravity=(0.3, 0, -9.81))
    for name, along in (("crank", (0, 0, 1.0)), ("coupler", (2.0, 0, 0.5)), ("rocker", (0, 0, 1.5))):
        length = float(np.linalg.norm(along))
        m.body(name, length, com=np.multiply(0.5, along), inertia=length**3 / 12.0)
    m.hinge("A", "world", "crank", axis=Y, qd=3.0)
    m.hinge("B", "crank", "coupler", axis=Y, at=(0, 0, 1.0))
    m.hinge("D", "world", "rocker", axis=Y, at=(2.0, 0, 0))
    m.close("C", ("coupler", (2.0, 0, 0.5)), ("rocker", (0, 0, 1.5)), "revolute", axis=Y)
    if springs:
        m.spring("pull", ("coupler", (1.0, 0.2, 0.3)), ("world", (0.5, 0.1, -1.0)), stiffness=50.0, rest=0.7)
        m.torsion("wound", "A", stiffness=4.0, rest=0.3)
    return m


def tree():
    """All kinds of hinges, a free root, and another tree on the world."""
    m = Mechanism(gravity=(0, 0.5, -9.81))
    turn = Rotation.from_rotvec([0.3, -0.8, 0.4]).as_matrix()
    m.body("free", 2.0, com=(0.1, 0.2, -0.1), inertia=(0.3, 0.4, 0.5), position=(0, 0, 3), rotation=turn,
           velocity=(1, 2, 0), spin=(0.5, -2.0, 3.0))  # fmt: skip
    for name in ("turns", "slides", "screws", "fixed", "hung"):
        m.body(name, 1.0, com=(0.1, -0.2, 0.3), inertia=(0.1, 0.15, 0.2))
    m.hinge("r", "free", "turns", axis=(1, 1, 0), at=(0.3, 0, 0.1), q=0.4, qd=2.0)
    m.hinge("p", "turns", "slides", "prismatic", axis=(0, 1, 2), at=(0, 0.4, 0), qd=-1.0)
    m.hinge("s", "free", "screws", "screw", axis=(0, 0, 1), at=(0, 0.2, 0.1), pitch=0.2, qd=5.0)
    m.hinge("f", "screws", "fixed", "fixed", at=(0, 0, 0.5))
    m.hinge("h", "world", "hung", axis=(1, 0, 0), qd=1.0)
    m.spring("one", ("slides", (0, 0, 0.2)), ("hung", (0, 0.3, 0)), stiffness=30.0)
    m.spring("two", ("fixed", (0, 0, 0.2)), ("world", (0, 0.3, 0)), stiffness=20.0, rest=0.0)
    m.torsion("three", "p", stiffness=15.0)
    return m


def damped(m):
    """With dampers between points, and in a hinge."""
    name = "A" if "A" in m._parts[Hinge] else "p"
    a, b = [*m._parts[Body]][:2]
    m.torsion("slow", name, damping=0.7)
    m.spring("dash", (a, (0.1, 0, 0.4)), ("world", (0.5, 0.1, -1.0)), damping=2.0)
    m.spring("both", (b, (0.1, 0.2, 0.4)), ("world", (0.5, 1.0, 1.0)), stiffness=5.0, damping=1.0)
    return m


def arm(kind="revolute"):
    """Links on hinges across each other, the fourth on a hinge of this kind."""
    m = Mechanism(gravity=(0, 0.5, -9.81))
    for k in range(5):
        m.body(f"l{k}", 1.0 + 0.2 * k, com=(0.02, 0.01, 0.2), inertia=(0.02, 0.03, 0.01))
        parent, axis = (f"l{k - 1}", (k % 2, 1, 0)) if k else ("world", (0, 1, 0.2))
        q, qd = 0.3 + 0.1 * k, 0.5 - 0.4 * k
        if k == 3 and kind == "ball":
            m.hinge("h3", parent, "l3", "ball", at=(0, 0, 0.4), q=(0.3, 0.1, -0.5), qd=(1.0, 0.5, -0.7))
        else:
            m.hinge(f"h{k}", parent, f"l{k}", axis=axis, at=(0, 0, 0.4 * (k > 0)), q=q, qd=qd)
    return m


def moving(m):
    """Followed by motors, with limits, stops, and torques that are functions of time."""
    first, second = [*m._parts[Hinge]][:2]
    m.motor(
        "follows", {first: lambda t: (np.sin(t), np.cos(t), -np.sin(t)), second: 0.2}, 30.0, 2.0, True, 9.0
    )
    m.motor("holds", {second: lambda t: (0.3 * t, 0.3, 0.0)}, 5.0, 1.0)
    m.torque("pushed", second, value=lambda t: np.cos(7.0 * t))
    m.torque("constant", first, value=0.3)
    return m


def rubbed(m, coefficient=0.0):
    """With constant friction in hinges, and friction by their forces."""
    for k, hinge in enumerate([*m._parts[Hinge]][:3]):
        m.friction(
            f"f{k}", hinge, torque=0.2 * k, coefficient=coefficient, radius=0.1, damping=0.1, speed=0.1
        )
    return m


def soft(m):
    """With a bushing that damps, and with stops that are touched."""
    bodies, hinge = [*m._parts[Body]], [*m._parts[Hinge]][1]
    m.bushing(
        "soft", (bodies[0], (0, 0, 0.5)), ("world", (0.1, 0, 0.5)), [*[2.0] * 3, *[30.0] * 3], [0.1] * 6
    )
    q = m.build().start().q[1]
    m.stop("ends", hinge, q - 0.002, q + 0.002, stiffness=100.0, damping=2.0)
    return m


class Wind:
    """A uniform field, which feed-forward does not know."""

    def bind(self, bodies):
        return Acting(conservative=Gravity(bodies.tree, np.array([2.0, -1.0, 0.5])))


def windy(m):
    """With an element of the user's that is computed as gravity is, and feed-forward."""
    m.force("wind", Wind())
    m.motor("ahead", {"h0": lambda t: (0.3 + 0.5 * t, 0.5, 0.0)}, 5.0, 1.0, True)
    return m


def driven(m):
    """With a hinge whose motion is prescribed."""
    (hinge,) = [hinge for name, hinge in m._parts[Hinge].items() if name in ("A", "h1")]
    q, qd = hinge.q, hinge.qd
    hinge.fix(q=0.0, qd=0.0)
    m.drive(hinge.name, lambda t: (q + qd * t + 0.5 * t * t, qd + t, 1.0))
    return m


MADE = {
    "loop": four_bar(), "bare": four_bar(springs=False), "tree": tree(), "damped loop": damped(four_bar()),
    "damped tree": damped(tree()), "ball": arm("ball"), "motors": moving(arm()), "rubbed": rubbed(arm()),
    "pressed": rubbed(moving(arm("ball")), 0.3), "soft": soft(arm()), "driven": driven(arm()),
    "all": rubbed(driven(soft(arm("ball"))), 0.2),
    "soft loop": rubbed(moving(soft(four_bar(springs=False)))), "driven loop": damped(driven(four_bar())),
}  # fmt: skip


@pytest.mark.parametrize("made", MADE.values(), ids=MADE)
@pytest.mark.parametrize("integrator", [RungeKutta4(), DormandPrince(1e-7)], ids=("rk4", "dp"))
def test_a_run_in_one_call_is_its_steps_one_by_one(made, integrator, monkeypatch):
    model = made.build()
    run = model.simulate(0.31, 0.01, integrator, every=3)
    monkeypatch.setattr(InOneKernel, "march", lambda self, method, at, h, steps, every: ([], at, 0))
    one = model.simulate(0.31, 0.01, integrator, every=3)
    assert len(run.rows) == len(one.rows) == 12
    for name in ("time", "q", "qd", "potential", "kinetic", "work", "jumps"):
        assert np.allclose(getattr(run, name), getattr(one, name), rtol=1e-10, atol=1e-11), name
    for name in ("q", "p", "torque", "work", "time", "loads"):
        found, exact = getattr(run.end, name), getattr(one.end, name)
        assert (found is None and exact is None) or np.allclose(found, exact, rtol=1e-9, atol=1e-10), name
    if any(load.dissipates for load in model.loads):
        assert run.table["dissipation"].iloc[-1] > 0.0
        assert run.audit().energy < 1e-4


WINDY = {**MADE, "windy": windy(arm())}


@pytest.mark.parametrize("made", WINDY.values(), ids=WINDY)
@pytest.mark.parametrize("tableau", [CLASSICAL, DORMAND_PRINCE], ids=("rk4", "dp"))
def test_a_step_is_the_one_that_calls_take(made, tableau, monkeypatch):
    system = made.build().system
    assert isinstance(system, InOneKernel)
    at = system.at(*(made.build().q, made.build().qd))
    wanted = [at]
    for h in (0.02, -0.01, 0.03):
        wanted.append(Equations.advance(system, tableau, wanted[-1], h))
        wanted[-1], *errors = wanted[-1]
    monkeypatch.setattr(Equations, "advance", None)  # The kernel alone.
    for h, there in zip((0.02, -0.01, 0.03), wanted[1:], strict=True):
        at, *own = system.advance(tableau, at, h)
        for name in ("time", "q", "qd", "p", "potential", "torque", "work"):
            found, exact = np.asarray(getattr(at, name)), np.asarray(getattr(there, name))
            assert found == pytest.approx(
                exact, rel=1e-11, abs=1e-11 * max(1.0, np.max(np.abs(exact), initial=0.0))
            ), name
        # Of hinges only; and what is above a Cholesky factor is nothing.
        for read in (
            lambda of: of.inertia, lambda of: of.gain[of.tree.hinge_bodies], lambda of: of.pivot,
            lambda of: np.tril(of.root), lambda of: of.frames.rotation, lambda of: of.frames.origin,
        ):  # fmt: skip
            assert read(at.factors) == pytest.approx(read(there.factors), rel=1e-10, abs=1e-11)
    for found, exact in zip(own, errors, strict=True):
        assert found == pytest.approx(exact, abs=1e-11)


class Held(list):
    """An empty list, which is false, that can be called."""

    def __call__(self, t):
        return 0.4, 0.0, 0.0


def reused():
    """A function of time that returns the same array at all times."""
    out = np.zeros(3)

    def turn(t):
        out[:] = np.sin(t), np.cos(t), -np.sin(t)
        return out

    return turn


@pytest.mark.parametrize(
    ("target", "plain"),
    [(Held(), lambda t: (0.4, 0.0, 0.0)), (reused(), lambda t: (np.sin(t), np.cos(t), -np.sin(t)))],
    ids=("false", "reused"),
)
def test_targets_do_not_depend_on_the_kind_of_function(target, plain):
    runs = []
    for motion in (target, plain):
        m = Mechanism(gravity=(0, 0, -9.81))
        m.body("rod", 1.0, com=(0, 0, -0.5), inertia=0.1)
        m.hinge("pin", "world", "rod", axis=Y)
        m.motor("drive", {"pin": motion}, 50.0, 5.0)
        runs.append(m.build().simulate(2.0, 0.01).q[-1])
    assert np.array_equal(*runs)


def test_what_a_kernel_cannot_know_takes_the_other_way():
    for more in (
        lambda m: m.torque("motor", "A", value=lambda t, state: t),
        lambda m: m.load("pushed", "crank", force=lambda t: (1.0, 0, 0)),
        lambda m: m.friction("pressed", "A", coefficient=0.1, radius=0.1),
    ):
        m = four_bar()
        more(m)
        assert not isinstance(m.build().system, InOneKernel)


def test_a_load_with_another_function_is_computed_by_calls():
    model = moving(arm()).build()
    assert isinstance(model.system, InOneKernel)
    for named in model.loads:
        m = arm()
        m.force("other", replace(named.load, applied=lambda time, q, qd, frames: Applied(torques=-qd)))
        run = m.build().simulate(0.2, 0.01, RungeKutta4())
        assert not isinstance(run.model.system, InOneKernel)
        assert run.work[-1] < 0.0, named.name


@pytest.mark.parametrize("target", [lambda t: np.array([t]), lambda t: (t, 0.0)])
def test_a_torque_that_is_not_a_number_is_refused_from_the_start(target):
    m = four_bar()
    m.torque("motor", "A", value=target)
    with pytest.raises(MechanicsError, match='torque "motor": its value'):
        m.build().simulate(1.0, 0.01, RungeKutta4())


def test_what_fails_is_refused_in_the_same_words():
    m = Mechanism()
    m.body("a", 1.0, inertia=1.0)
    m.hinge("slide", "world", "a", "prismatic", axis=(1, 0, 0), q=0.5, qd=-1.0)
    m.spring("pull", ("a", (0, 0, 0)), ("world", (0, 0, 0)), stiffness=1.0)
    with pytest.raises(MechanicsError, match='spring "pull": its ends coincide'):
        m.build().simulate(1.0, 1.0, RungeKutta4())
    with pytest.raises(StepTooLargeError) as refused:
        four_bar(springs=False).build().simulate(10.0, 5.0, RungeKutta4())
    assert refused.value.fault is Fault.OPEN
