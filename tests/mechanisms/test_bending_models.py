"""Mechanisms of which some bodies bend: against chains made by hand, finite segments and the energy."""

import numpy as np
import pytest

from bench.scenes.canonical import chain, started
from protochain.core.errors import MechanicsError
from protochain.mechanics.motion import DormandPrince, Leapfrog
from protochain.mechanisms import Beam, Mechanism, assumed_modes, bending
from protochain.mechanisms.flexible import canonical_rates
from protochain.mechanisms.flexible.dynamics import forward_dynamics


def links(axis=(0, 0, 1), gravity=(0, 0, 0), n=3):
    """Links of 1 m and 1 kg, hinged end to end, with a ball at the end."""
    m = Mechanism(gravity=gravity)
    for k in range(n):
        m.body(f"link {k}", 1.0, com=(0.5, 0, 0), inertia=1 / 12)
        above = f"link {k - 1}" if k else "world"
        m.hinge(f"hinge {k}", above, f"link {k}", at=(1 if k else 0, 0, 0), axis=axis)
    m.body("ball", 0.3, inertia=0.003)
    m.hinge("weld", f"link {n - 1}", "ball", kind="fixed", at=(1, 0, 0))
    return m


def test_it_is_the_chain_made_by_hand():
    flexible = chain(3, shapes=2, tip=0.3)
    q, qd = started(flexible)
    link = assumed_modes(Beam(1.0, 1.0, 3.0), lag=2)
    system, start = bending(links().build(), {f"link {k}": link for k in range(3)})
    assert start.q.tolist() == [0.0] * system.flexible.n_q
    tau = np.random.default_rng(0).normal(size=flexible.n_v)
    q[3:] = 0.02 * tau[3:]
    wanted = forward_dynamics(flexible, q, qd, tau)
    np.testing.assert_allclose(system.forward_dynamics(q, qd, tau), wanted, rtol=1e-11, atol=1e-11)


def test_links_that_fall_keep_their_energy_in_any_plane_and_follow_hamiltons_equations():
    fallen = []
    for axis, gravity, of in (((0, 0, 1), (0, -9.81, 0), "lag"), ((0, 1, 0), (0, 0, -9.81), "flap")):
        shapes = assumed_modes(Beam(1.0, 1.0, 3.0), **{of: 2})
        system, at = bending(links(axis, gravity).build(), {f"link {k}": shapes for k in range(3)})
        energy = at.potential
        for _ in range(30):
            at = DormandPrince(1e-10).step(system, at, 0.01)
        kinetic = 0.5 * at.p @ at.qd
        assert kinetic > 1.0
        assert kinetic + at.potential == pytest.approx(energy, abs=1e-7 * kinetic)
        # About z a link rises as its angle grows, about y it falls.
        fallen.append(-at.q[:3] if axis[2] else at.q[:3])
        qd, slope = canonical_rates(system.flexible, at.q, at.p, at.torque)
        np.testing.assert_allclose(qd, at.qd, rtol=1e-9, atol=1e-9)
        h = 1e-5
        ends = [DormandPrince(1e-12).step(system, at, step).p for step in (h, 2.0 * h)]
        np.testing.assert_allclose((4.0 * ends[0] - 3.0 * at.p - ends[1]) / (2.0 * h), slope, atol=1e-3)
    np.testing.assert_allclose(fallen[0], fallen[1], atol=1e-7)


def test_what_bodies_that_bend_do_not_take_is_said():
    shapes = assumed_modes(Beam(1.0, 1.0, 3.0), lag=1)
    m = links()
    m.close("loop", a=("ball", (0, 0, 0)), b=("world", (2, 1, 0)), kind="spherical")
    with pytest.raises(MechanicsError, match="flexible bodies do not support closed loops"):
        bending(m.build(), {"link 0": shapes})
    m = links()
    m.torsion("damper", "hinge 0", damping=1.0)
    with pytest.raises(MechanicsError, match=r"apply to rigid bodies only.*replace\(system, loads"):
        bending(m.build(), {"link 0": shapes})
    with pytest.raises(MechanicsError, match='no body "link 9"'):
        bending(links().build(), {"link 9": shapes})
    with pytest.raises(MechanicsError, match=r'bending: "link 0": .*give Shapes'):
        bending(links().build(), {"link 0": 3})
    m = links()
    m.spring("pull", a=("link 0", (1, 0, 0)), b=("world", (0, 1, 0)), stiffness=1.0, rest=0.5)
    with pytest.raises(MechanicsError, match='a load acts on "link 0", which is flexible'):
        bending(m.build(), {"link 0": shapes})
    system, start = bending(links().build(), {"link 0": shapes})
    with pytest.raises(MechanicsError, match="bodies that bend"):
        Leapfrog().step(system, start, 0.01)
