"""Springs and dampers on hinges: against differences, dense matrices, and integrators that see dampers."""

import numpy as np
import pandas as pd
import pytest
from fixtures.refusals import expect_refusal
from fixtures.samples import chain, energy, load
from scipy.linalg import expm

import protochain as pc
from protochain.dynamics import Isolated, Leapfrog, Propagator, State, System, advance, closure_of, simulate
from protochain.dynamics.hinge_springs import Dampers, dampers, hinge_springs
from protochain.dynamics.loop import noise
from protochain.mechanics import multibody
from protochain.mechanics.multibody import HingeKind, random_tree

KT = 2.5


def nothing(q, factors):
    return 0.0, np.zeros(factors.tree.n_v)


@pytest.fixture(scope="module")
def soft():
    """Ten alanines whose peptide bonds and backbone angles turn, at a minimum."""
    c = pc.build_chain(load("ala10.pdb"), "phi psi omega angles")
    e = energy("ala10.pdb")
    return c, e, pc.minimise(c, e, "lbfgs", 5.0).q


# --- Springs


def test_torques_are_differences_of_the_energy_and_vanish_at_the_start(soft):
    c = soft[0]
    # Two on each omega, which add up.
    given = [
        pc.HingeSpring(*each) for each in (("omega", 30.0), ("angles", 300.0), ("phi", 5.0), ("omega", 10.0))
    ]
    springs = hinge_springs(given, c, c.q0)
    kinds = [hinge.kind for hinge in c.hinges]
    n_omega, n_angle, n_phi = (
        kinds.count("omega"),
        kinds.count("angle N") + kinds.count("angle CA"),
        kinds.count("phi"),
    )
    assert n_omega == 9 and n_angle >= 16 and n_phi == 9
    assert np.array_equal(
        springs.stiffness, [30.0] * n_omega + [300.0] * n_angle + [5.0] * n_phi + [10.0] * n_omega
    )
    value, torque = springs.potential(c.q0, None)
    assert value == 0.0 and not torque.any()
    rng = np.random.default_rng(2)
    move = rng.normal(size=c.n_v)
    q = multibody.integrate(c.tree, c.q0, move)
    value, torque = springs.potential(q, None)
    moved = move[c.tree.v_start[c.hinge_body]]
    is_angle = np.array([hinge.is_angle for hinge in c.hinges])
    wide = {"omega": 40.0, "phi": 5.0}
    expected = 150.0 * moved[is_angle] @ moved[is_angle] + sum(
        wide.get(kind, 0.0) * (1.0 - np.cos(angle)) for kind, angle in zip(kinds, moved, strict=True)
    )
    assert value == pytest.approx(expected, rel=1e-12)
    h = 1e-6
    numeric = [
        -(springs.potential(q + h * one, None)[0] - springs.potential(q - h * one, None)[0]) / (2 * h)
        for one in np.eye(c.n_v)
    ]
    assert np.allclose(torque, numeric, atol=1e-7 * np.abs(torque).max())
    assert (torque == 0.0).sum() == c.n_v - n_omega - n_angle - n_phi


@pytest.mark.parametrize("kind", ["phi", "psi", "omega", "chi", "rotors", "angles"])
def test_every_kind_of_hinge_takes_springs(kind):
    c = pc.build_chain(load("1l2y.pdb"), "phi psi omega chi rotors angles")
    springs = hinge_springs([pc.HingeSpring(kind, 1.0)], c, c.q0)
    own = [hinge.kind for hinge in c.hinges]
    expected = {"rotors": own.count("rotor"), "chi": sum(k.startswith("chi") for k in own)}.get(
        kind, sum(k.startswith("angle") for k in own) if kind == "angles" else own.count(kind)
    )
    assert len(springs.at_q) == expected > 5
    with pytest.raises(pc.ProtochainError, match=f"no hinge of this kind turns; .* '(.* )?{kind}'"):
        hinge_springs(
            [pc.HingeSpring(kind, 1.0)],
            pc.build_chain(load("1l2y.pdb"), "phi" if kind != "phi" else "psi"),
            None,
        )


# --- Dampers


def scene(seed=2, n=7, kinds=(HingeKind.REVOLUTE,)):
    """A tree in motion, with dampers on four of its hinges."""
    rng = np.random.default_rng(seed)
    tree = random_tree(n, seed, root=HingeKind.FREE, kinds=kinds)
    q = np.zeros(tree.n_q)
    q[0] = 1.0
    q = multibody.integrate(tree, q, rng.normal(size=tree.n_v))
    return tree, q, rng.normal(size=tree.n_v), np.array([6, 8, 9, 11]), rng.uniform(0.1, 2.0, 4)


class Given:
    """Numbers in place of random ones."""

    def __init__(self, numbers):
        self.numbers = numbers

    def standard_normal(self, n):
        return self.numbers[:n]


@pytest.mark.parametrize("looped", [False, True])
def test_velocities_decay_as_dense_matrices_say_and_keep_their_distribution(looped):
    """E = exp(-M^-1 C t), and E Sigma E^T + N N^T = Sigma for the noise N; on the tangent of closed loops."""
    if looped:
        c = pc.build_chain(load("3i40.pdb"), root="free")
        closure, tree, q = closure_of(c), c.tree, c.q0
        at_v = tree.v_start[c.hinge_body[[i for i, h in enumerate(c.hinges) if h.kind == "psi"]]]
        damping = np.linspace(0.2, 3.0, len(at_v))
        qd = np.random.default_rng(1).normal(size=tree.n_v)
    else:
        (tree, q, qd, at_v, damping), closure = scene(), None
    system = System(tree, nothing, closure)
    frames = multibody.pose(tree, q)
    m = multibody.mass_matrix(tree, frames)
    inverse = np.linalg.inv(m)
    if looped:
        g = multibody.row_matrix(tree, frames, closure.rows(frames))
        inverse -= inverse @ g.T @ np.linalg.solve(g @ inverse @ g.T, g @ inverse)
    full = np.zeros(tree.n_v)
    full[at_v] = damping
    time = 0.3
    at = system.with_velocities(system.at(q, np.zeros(tree.n_v)), qd)
    of = Dampers(at_v, damping, 0.0)
    decay = expm(-inverse * full * time)
    after = of.apply(system, at, time, None)
    scale = np.abs(at.qd).max()
    assert np.abs(after.qd - decay @ at.qd).max() < 1e-10 * scale
    assert np.abs(after.qd - at.qd).max() > 1e-2 * scale
    assert np.array_equal(after.q, at.q) and np.allclose(
        after.p, m @ after.qd, atol=1e-9 * np.abs(after.p).max()
    )
    # Two halves are one whole.
    twice = of.apply(system, of.apply(system, at, 0.5 * time, None), 0.5 * time, None)
    assert np.abs(twice.qd - after.qd).max() < 1e-11 * scale
    # Noise: from rest, by unit vectors in place of random numbers.
    warm, rest = Dampers(at_v, damping, KT), system.with_velocities(at, np.zeros(tree.n_v))
    spread = np.array([warm.apply(system, rest, time, Given(one)).qd for one in np.eye(len(at_v))]).T
    canonical = KT * inverse
    kept = decay @ canonical @ decay.T + spread @ spread.T
    assert np.abs(kept - canonical).max() < 1e-9 * np.abs(canonical).max()
    assert np.abs(spread @ spread.T).max() > 1e-3 * np.abs(canonical).max()


@pytest.mark.parametrize("damping", [1e-12, 1e3, 1e12, 1e100])
def test_dampers_far_stiffer_than_the_step_stop_their_hinges_and_nothing_else(damping):
    tree, q, qd, at_v, _ = scene()
    system = System(tree, nothing)
    at = system.at(q, qd)
    after = Dampers(at_v, np.full(4, damping), KT).apply(system, at, 0.1, None)
    momentum = [multibody.momentum(tree, each.factors.frames, each.qd) for each in (at, after)]
    assert np.allclose(*momentum, atol=1e-12)
    others = np.setdiff1d(np.arange(6, tree.n_v), at_v)
    assert np.allclose(after.p[others], at.p[others], atol=1e-12)
    if damping < 1.0:
        assert np.allclose(after.qd, qd, atol=1e-9)
    else:
        assert np.abs(after.qd[at_v]).max() < 1e-2 * np.abs(qd).max()
        assert after.kinetic < at.kinetic


def test_dampers_and_thermostats_draw_different_numbers():
    drawn = []

    class Drawing(Isolated):
        """Thermostat and dampers that only draw."""

        def apply(self, system, at, *others):
            random = others[-1] if len(others) == 2 else others[-1]()
            drawn.append(random.standard_normal(50))
            return (at, others[0]) if len(others) == 3 else at

    system = System(scene()[0], nothing)
    at = system.at(*scene()[1:3])
    one = Drawing()
    advance(Propagator(system, Leapfrog(), one, 1e-3, 0.0, 3, False, one), State(4, at, one.init(at)))
    assert np.abs(np.corrcoef(drawn) - np.eye(3)).max() < 0.5
    assert np.array_equal(noise(3, 5).standard_normal(50), drawn[2])


@pytest.mark.parametrize(
    ("thermostat", "integrator"), [("none", "leapfrog"), ("langevin", "leapfrog"), ("rescale", "rk4")]
)
def test_what_dampers_take_is_counted(thermostat, integrator, soft):
    n = 150 if integrator == "leapfrog" else 40
    m = simulate(
        *soft, n_steps=n, time_step=0.001, thermostat=thermostat, integrator=integrator, every=5, seed=2,
        hinge_springs=["omega 40 0.5", "angles 100 0.2"],
    )  # fmt: skip
    assert m.ending == "completed"
    conserved = m.trace["conserved_kj_mol"]
    assert np.ptp(conserved) < 0.03 * np.ptp(m.trace["kinetic_kj_mol"])
    taken = m.trace["dampers_kj_mol"]
    assert taken.abs().iloc[1:].min() > 0.0
    assert (np.diff(taken) >= 0.0).all() == (thermostat == "none")
    if thermostat == "none":
        assert taken.iloc[-1] > 0.5 and m.trace["total_kj_mol"].iloc[-1] < m.trace["total_kj_mol"].iloc[0]
    if thermostat == "none" and integrator == "leapfrog":
        linear, angular = multibody.momentum(m.chain.tree, m.state.at.factors.frames, m.qd)
        assert np.abs(linear).max() < 1e-8 and np.abs(angular).max() < 1e-8


def test_closed_loops_stay_closed_with_dampers():
    c, e = chain("3i40.pdb"), energy("3i40.pdb", solvent="vacuum")
    m = simulate(
        c, e, temperature=100.0, time_step=0.001, n_steps=6, every=1, loops="closed", thermostat="none",
        hinge_springs="chi 1 5",
    )  # fmt: skip
    assert m.trace["closure_error_nm"].max() < 1e-11
    assert np.ptp(m.trace["conserved_kj_mol"]) < 0.02 * m.trace["dampers_kj_mol"].iloc[-1]


# --- Going on, settings, the command


@pytest.mark.parametrize("thermostat", ["langevin"])
def test_a_run_in_parts_is_the_run_in_one(thermostat, soft, tmp_path):
    c, e, q = soft
    settings = {
        "thermostat": thermostat, "every": 5, "seed": 3, "time_step": 0.001, "pull": "A:1:N-A:10:C",
        "hinge_springs": ["omega 40 0.5", "angles 200"],
    }  # fmt: skip
    whole = simulate(c, e, q, n_steps=30, **settings)
    simulate(c, e, q, n_steps=15, output=tmp_path, checkpoint_every=1, **settings)
    part = simulate(c, e, n_steps=30, output=tmp_path, resume=True, **settings)
    assert np.array_equal(part.q, whole.q) and np.array_equal(part.qd, whole.qd)
    pd.testing.assert_frame_equal(part.trace, whole.trace, check_exact=True, check_dtype=False)
    for other in ("omega 40 0.4", "omega 40 0.5", ()):
        with expect_refusal("hinge_springs"):
            simulate(c, e, n_steps=40, output=tmp_path, resume=True, **settings | {"hinge_springs": other})


def test_springs_are_read_as_they_are_meant():
    one = pc.HingeSpring("omega", 40.0, 0.5)
    assert pc.HingeSpring.several("omega 40 0.5") == pc.HingeSpring.several(one) == (one,)
    assert pc.HingeSpring.several(["omega 40 .5", "phi 1e2"]) == (one, pc.HingeSpring("phi", 100.0))
    assert pc.HingeSpring.several(()) == () and pc.HingeSpring.read(str(one)) == one
    same = dampers([one, pc.HingeSpring("omega", 0.0, 1.0)], pc.build_chain(load("ala10.pdb"), "omega"), 0.0)
    assert np.array_equal(same.damping, [1.5] * 9)
    assert dampers([pc.HingeSpring("omega", 3.0)], pc.build_chain(load("ala10.pdb"), "omega"), 0.0) is None


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("omega", "'omega': give kind, stiffness, damping, as 'omega 40 0.5'"),
        ("omega forty", "give kind"),
        ("omega 1 2 3", "give kind"),
        ("bond 40", "kind 'bond' is not a hinge kind; choose from phi, psi, omega"),
        ("omega -1", "stiffness -1: give 0 or more"),
        ("omega 1 nan", "damping nan: give 0 or more"),
        (3.0, "hinge_springs 3.0: give HingeSprings"),
        ("chi 5", "no hinge of this kind turns"),
    ],
)
def test_springs_that_make_no_sense_are_refused(given, said):
    c = pc.build_chain(load("ala10.pdb"), "phi psi")
    with pytest.raises(pc.ProtochainError, match=said) as refused:
        simulate(c, energy("ala10.pdb"), n_steps=1, hinge_springs=given)
    assert "\n" not in str(refused.value)


def test_hybrid_monte_carlo_takes_springs_but_no_dampers(soft):
    with pytest.raises(pc.ProtochainError, match=r"hmc: .* damping of 0"):
        simulate(*soft, n_steps=10, every=10, thermostat="hmc", hinge_springs="omega 40 0.5")
    m = simulate(*soft, n_steps=20, time_step=0.001, every=10, thermostat="hmc", hinge_springs="omega 40")
    assert m.ending == "completed" and m.trace["hinge_springs_kj_mol"].iloc[-1] > 0.0
