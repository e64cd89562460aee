"""Rotors in mechanisms: energy, drives, motors, loops, balls and small motions."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from protochain.core.errors import MechanicsError
from protochain.mechanics.motion import DormandPrince, RungeKutta4
from protochain.mechanics.multibody import mass_matrix, row_matrix
from protochain.mechanisms import Mechanism, Rosenbrock, frequencies

DOWN = (0, 0, -9.81)


def arm(rotors=(0.3, 0.2), kind="revolute", **more):
    m = Mechanism(gravity=DOWN)
    for name in "ab":
        m.body(name, 1.0, com=(0.05, 0, -0.3), inertia=(0.02, 0.03, 0.01))
    m.hinge("h", "world", "a", axis=(0, 1, 0), q=0.7, armature=rotors[0], **more)
    m.hinge("k", "a", "b", kind, at=(0, 0, -0.6), axis=(1, 1, 0), armature=rotors[1])
    return m


@pytest.mark.parametrize("kind", ["revolute", "prismatic", "ball"])
@pytest.mark.parametrize("integrator", [RungeKutta4(), DormandPrince(1e-10), Rosenbrock(1e-6)])
def test_energy_is_kept_with_rotors(kind, integrator):
    m = arm(kind=kind)
    m.torsion("t", "h", stiffness=3.0)
    run = m.build().simulate(0.5, 0.002, integrator)
    assert run.audit().energy < 1e-5
    state, model = run.model.state(run.end), run.model
    twists = sum(
        0.5 * (1.0 * v @ v + w @ axes @ np.diag((0.02, 0.03, 0.01)) @ axes.T @ w)
        for name in "ab"
        for v, w, axes in [(state.velocity(name, (0.05, 0, -0.3)), state.spin(name), state.rotation(name))]
    )
    rates = 0.3 * state.rate("h") ** 2 + 0.2 * np.sum(np.square(state.rate("k")))
    assert run.kinetic[-1] == pytest.approx(twists + 0.5 * rates, rel=1e-9)
    assert model.tree.is_plain == (kind != "ball")


def test_a_drive_turns_the_rotor_too():
    """The drive's work is the energy, of which that of the rotor is a part."""
    motion = lambda t: (0.7 + t * t, 2 * t, 2.0)  # noqa: E731
    works = []
    for rotor in (0.0, 0.5):
        m = arm((rotor, 0.2))
        m.drive("h", motion)
        run = m.build().simulate(0.5, 0.005, DormandPrince(1e-10))
        assert run.audit().energy < 1e-8
        works.append(run.work[-1].sum())
    assert works[1] - works[0] == pytest.approx(0.5 * 0.5 * 1.0**2, rel=1e-8)


def test_feed_forward_holds_an_arm_with_rotors_to_its_motion():
    m = arm(qd=0.4)
    m.motor("m", {"h": lambda t: (0.7 + 0.4 * t + t**3, 0.4 + 3 * t * t, 6 * t), "k": 0.0}, feed_forward=True)
    run = m.build().simulate(0.4, 0.002)
    assert run.model.state(run.end).angle("h") == pytest.approx(0.7 + 0.16 + 0.064, abs=1e-9)


def test_a_loop_with_rotors_moves_by_its_dense_equations():
    """(M G^T; G 0)(qdd; -lambda) = (tau; -dG/dt qd), with M from the twists of bodies and the rotors."""
    m = Mechanism(gravity=DOWN)
    rotors = (0.4, 0.0, 0.7)
    for name in "abc":
        m.body(name, 1.0, com=(0, 0, 0.5), inertia=0.1)
    lean = np.arcsin(0.25)
    m.hinge("1", "world", "a", axis=(0, 1, 0), q=-lean, qd=0.6, armature=rotors[0])
    m.hinge("2", "a", "b", at=(0, 0, 1), axis=(0, 1, 0), q=np.pi / 2 + lean, armature=rotors[1])
    m.hinge("3", "world", "c", at=(1.5, 0, 0), axis=(0, 1, 0), armature=rotors[2])
    m.close("C", ("b", (0, 0, 1.0)), ("c", (0, 0, 1.0)), "revolute", axis=(0, 1, 0))
    model = m.build()
    at = model.start()
    tree, frames = model.tree, at.factors.frames
    jacobian = [model.state().jacobian(name, (0, 0, 0.5)) for name in "abc"]
    dense = sum(j.T @ block_diag(np.eye(3), 0.1 * np.eye(3)) @ j for j in jacobian) + np.diag(rotors)
    assert mass_matrix(tree, frames) == pytest.approx(dense, rel=1e-12)
    g = row_matrix(tree, frames, model.state().loops)
    system, zero = model.system, np.zeros(3)
    # Bias forces by the open tree at rest accelerations, and the change of G by a difference along qd.
    c = system.inverse_dynamics(at.q, at.qd, zero) - at.torque
    h = 1e-6
    moved = [system.factors(at.q + sign * h * at.qd).frames for sign in (1, -1)]
    both = [model.bodies.joints.rows(each)[1] for each in moved]
    change = (row_matrix(tree, moved[0], both[0]) - row_matrix(tree, moved[1], both[1])) @ at.qd / (2 * h)
    whole = row_matrix(tree, frames, model.bodies.joints.rows(frames)[1])
    kkt = np.block([[dense, whole.T], [whole, np.zeros((len(whole),) * 2)]])
    wanted = np.linalg.lstsq(kkt, np.concatenate([-c, -change]), rcond=1e-10)[0][:3]
    found = system.accelerations(0.0, at.q, at.qd, at.torque, at.loads, at.factors)[0]
    assert found == pytest.approx(wanted, rel=1e-7)
    assert len(g) == 2
    assert model.simulate(0.3, 0.005, DormandPrince(1e-9)).audit().energy < 1e-6


def test_a_pendulum_with_a_rotor_swings_more_slowly():
    m = Mechanism(gravity=DOWN)
    m.body("rod", 2.0, com=(0, 0, -0.5), inertia=(0.1, 0.1, 0.02))
    m.hinge("pin", "world", "rod", axis=(0, 1, 0), armature=0.3)
    (omega,) = frequencies(m.build())
    assert omega == pytest.approx(np.sqrt(2.0 * 9.81 * 0.5 / (0.1 + 2.0 * 0.25 + 0.3)), rel=1e-9)


def test_a_free_body_has_armature_without_weight():
    m = Mechanism(gravity=DOWN)
    m.body("stone", 2.0, inertia=0.1, armature=3.0)
    run = m.build().simulate(1.0, 0.01)
    assert run.model.state(run.end).velocity("stone") == pytest.approx((0, 0, -9.81 * 2.0 / 5.0))


@pytest.mark.parametrize(
    ("act", "said"),
    [
        (
            lambda m: m.hinge("x", "b", "c", "fixed", armature=0.1),
            'hinge "x": its q, qd and armature must be',
        ),
        (lambda m: m.hinge("x", "b", "c", armature=-0.1), 'hinge "x": its armature'),
        (lambda m: m.body("c", 1.0, inertia=1.0, armature=-1), 'body "c": its armature'),
        (
            lambda m: (m.body("c", 1.0, inertia=1.0, armature=1), m.hinge("x", "b", "c"), m.build()),
            'body "c": armature applies to free bodies only',
        ),
    ],
)
def test_what_is_no_armature_is_refused_by_name(act, said):
    with pytest.raises(MechanicsError, match=said):
        act(arm())
