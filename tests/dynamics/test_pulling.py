"""Pulling: a moving spring's forces and work, against closed forms; names, files, the command."""

import gemmi
import numpy as np
import pandas as pd
import pytest
from fixtures.refusals import expect_refusal
from fixtures.samples import STRUCTURES, chain, energy, load
from fixtures.tolerances import ROUND_OFF
from scipy.integrate import solve_ivp

import protochain as pc
from protochain.dynamics import Isolated, Langevin, Leapfrog, Propagator, State, System, advance, simulate
from protochain.dynamics.integrators import INTEGRATORS
from protochain.dynamics.pulling import MovingSpring, check_pull, moving_spring
from protochain.mechanics import multibody
from protochain.mechanics.multibody import HingeKind, Tree

ENDS = "A:1:N-A:10:C"


@pytest.fixture(scope="module")
def small():
    """Ten alanines at a minimum of their torsions."""
    c, e = chain("ala10.pdb"), energy("ala10.pdb")
    return c, e, pc.minimise(c, e, "lbfgs", 1.0).q


# --- The spring alone


def centre(s, x, atoms):
    return np.average(x[atoms], axis=0, weights=s.atom_mass[atoms])


@pytest.mark.parametrize("between", ["A:2:CA-A:17:CB", "A:3-A:18", "resid 1:4 - resid 12:20 and name CA CB"])
def test_distance_energy_and_torques_are_those_of_the_places(between):
    """Places of one body, of several, and that share bodies with one another."""
    c = pc.build_chain(load("1l2y.pdb"), root="free")
    s, pull = c.structure, pc.Pull(between, stiffness=700.0, speed=0.3)
    spring = moving_spring(pull, c, c.q0)
    number = s.residue_number[s.atom_residue].astype(int)
    atoms = {
        "A:2:CA-A:17:CB": (
            (number == 2) & (s.atom_name == "CA"), (number == 17) & (s.atom_name == "CB"),
        ),
        "A:3-A:18": (number == 3, number == 18),
    }.get(between, (number <= 4, (number >= 12) & np.isin(s.atom_name, ["CA", "CB"])))  # fmt: skip
    rng = np.random.default_rng(1)
    q = multibody.integrate(c.tree, c.q0, 0.1 * rng.normal(size=c.n_v))

    def distance(at):
        x = pc.pose(c, at).x
        return np.linalg.norm(centre(s, x, atoms[1]) - centre(s, x, atoms[0]))

    time = 0.7
    rest = distance(c.q0) + 0.3 * time

    def stored(at):
        return 350.0 * (distance(at) - rest) ** 2

    frames = pc.pose(c, q).frames
    assert spring.start == pytest.approx(distance(c.q0), rel=ROUND_OFF)
    assert spring.tension(time, frames) == pytest.approx(
        (distance(q), 700.0 * (rest - distance(q))), rel=1e-11
    )
    assert spring.energy(time, frames) == pytest.approx(stored(q), rel=1e-11)
    torque = spring.load().along(c.tree, time, q, np.zeros(c.n_v), frames)
    h = 1e-6
    numeric = [
        -(stored(multibody.integrate(c.tree, q, h * e)) - stored(multibody.integrate(c.tree, q, -h * e)))
        / (2 * h)
        for e in np.eye(c.n_v)
    ]
    assert np.abs(torque - numeric).max() < 1e-7 * np.abs(torque).max()
    # Nothing pushes the molecule as a whole.
    total = np.sum(torque[:6].reshape(2, 3)[1])
    assert abs(total) < 1e-9 * np.abs(torque).max()


def test_length_never_falls_below_nothing():
    spring = held_slider(stiffness=50.0, speed=-0.5)
    assert spring.length(1.0) == pytest.approx(1.5) and spring.length(4.1) == spring.length(9.0) == 0.0
    tree = spring.tree
    for x in (1e-3, -1e-3, 1e-15, 0.0):
        frames = multibody.pose(tree, np.array([x]))
        torque = spring.load().along(tree, 9.0, np.array([x]), np.zeros(1), frames)
        assert torque[0] == pytest.approx(-50.0 * x, abs=1e-12)


def slider():
    """The world, and a ball of 2 amu on a rail along z."""
    return Tree(
        [-1, 0], [HingeKind.FIXED, HingeKind.PRISMATIC], np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1)),
        np.full(2, 2.0), np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1)),
    )  # fmt: skip


MASS, K, SPRING, REST, KT = 2.0, 300.0, 800.0, 2.0, 2.5
"""A ball held by K at 2 nm from the world, and pulled by a spring between the two."""


def held_slider(stiffness=SPRING, speed=0.1):
    return MovingSpring(
        slider(), np.array([0, 1]), np.zeros((2, 3)), np.array([-1.0, 1.0]), stiffness, speed, REST
    )


def held(q, factors):
    away = q[0] - REST
    return 0.5 * K * away * away, np.array([-K * away])


def pulled(speed, friction, n_steps, time_step, kt=0.0, potential=held, seed=0, start=None):
    """Work done by then, and the state; from rest at the minimum, or from a start."""
    spring = held_slider(speed=speed)
    system = System(spring.tree, potential, loads=(spring.load(),))
    thermostat = Langevin(kt, friction) if friction else Isolated()
    propagator = Propagator(system, Leapfrog(), thermostat, time_step, kt, seed, False)
    q, qd = (np.array([REST]), np.zeros(1)) if start is None else start
    at = system.at(q, qd)
    state = State(0, at, thermostat.init(at))
    for _ in range(n_steps):
        state = advance(propagator, state)
    return spring.row(state.at)["pull_work_kj_mol"], state


def exactly(speed, friction, until, k=K):
    """Work and place of the damped ball by DOP853; work is what the moving end does."""

    def rates(t, y):
        tension = SPRING * (REST + speed * t - y[0])
        return [y[1], (tension - k * (y[0] - REST)) / MASS - friction * y[1], speed * tension]

    return solve_ivp(rates, (0.0, until), [REST, 0.0, 0.0], method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]


@pytest.mark.parametrize(("speed", "friction"), [(0.5, 0.0), (0.5, 3.0), (-0.5, 3.0), (20.0, 0.5)])
def test_place_and_work_are_those_of_the_equation_of_motion(speed, friction):
    x, _, work = exactly(speed, friction, 1.0)
    errors = []
    for n in (200, 400):
        ours, state = pulled(speed, friction, n, 1.0 / n)
        errors.append((abs(ours - work) / abs(work), abs(state.at.q[0] - x) / (abs(speed) + 0.1)))
        assert state.at.time == pytest.approx(1.0, abs=1e-12)
    assert max(errors[1]) < 2e-3
    # The thermostat alternates with the leapfrog, which is of order two without it.
    assert errors[0][0] / errors[1][0] > (1.7 if friction else 3.5)


# --- Energy less work


def spread(m):
    return np.ptp(m.trace["conserved_kj_mol"])


def test_energy_less_work_is_kept_to_the_second_order(small):
    settings = {"thermostat": "none", "pull": pc.Pull(ENDS, 2000.0, 0.5), "every": 1, "seed": 3}
    runs = [simulate(*small, time_step=h, n_steps=round(0.4 / h), **settings) for h in (0.004, 0.002)]
    assert spread(runs[0]) / spread(runs[1]) == pytest.approx(4.0, rel=0.3)
    done = runs[1].trace["pull_work_kj_mol"].iloc[-1]
    assert done > 5.0 and spread(runs[1]) < 0.02 * done
    # What is kept is not the total energy: the spring has given work.
    assert np.ptp(runs[1].trace["total_kj_mol"]) > 20 * spread(runs[1])


@pytest.mark.parametrize("integrator", sorted(INTEGRATORS))
def test_every_integrator_counts_the_work(integrator, small):
    m = simulate(
        *small, time_step=0.002, n_steps=20, thermostat="none", integrator=integrator, every=1, seed=3,
        pull=pc.Pull(ENDS, 2000.0, 2.0),
    )  # fmt: skip
    allowed = {"dormand-prince": 1e-6, "rk4": 1e-4}.get(integrator, 2e-2)
    assert spread(m) < allowed < 0.01 * np.ptp(m.trace["total_kj_mol"]) + allowed
    assert m.trace["pull_work_kj_mol"].iloc[-1] > 1.0
    # Work as the moving end has it: the force on it over its way.
    force = m.trace["pull_force_kj_mol_nm"].to_numpy()
    way = 2.0 * 0.002 * (0.5 * force[0] + force[1:-1].sum() + 0.5 * force[-1])
    assert m.trace["pull_work_kj_mol"].iloc[-1] == pytest.approx(way, rel=5e-3)


@pytest.mark.parametrize("thermostat", ["none", "langevin", "nose-hoover", "rescale"])
def test_every_thermostat_counts_the_work(thermostat, small):
    m = simulate(
        *small, time_step=0.002, n_steps=200, thermostat=thermostat, friction=5.0, every=10, seed=2,
        pull=pc.Pull(ENDS, speed=1.0),
    )  # fmt: skip
    assert m.ending == "completed"
    assert spread(m) < 0.03 * np.ptp(m.trace["kinetic_kj_mol"]) < np.ptp(m.trace["total_kj_mol"])
    last = m.trace.iloc[-1]
    assert last["pull_extension_nm"] == pytest.approx(
        last["pull_distance_nm"] - m.trace["pull_distance_nm"].iloc[0], abs=1e-12
    )
    spring = 1000.0 * (m.trace["pull_distance_nm"].iloc[0] + 0.4 - last["pull_distance_nm"])
    assert last["pull_force_kj_mol_nm"] == pytest.approx(spring, abs=1e-6)


def test_the_largest_force_is_the_largest_in_size(small):
    """Pushed together: forces are negative."""
    m = simulate(
        *small, time_step=0.002, n_steps=100, thermostat="none", every=10, pull=pc.Pull(ENDS, speed=-1.0)
    )
    force = m.trace["pull_force_kj_mol_nm"]
    assert m.record()["pull_force_largest_kj_mol_nm"] == force.min() < -force.max()


def test_closed_loops_keep_the_order_and_what_they_keep_cannot_be_pulled():
    """The power at the end of a step is that of velocities that the loops allow."""
    c, e = chain("3i40.pdb"), energy("3i40.pdb", solvent="vacuum")
    settings = {"thermostat": "none", "loops": "closed", "every": 1, "seed": 1, "temperature": 100.0}

    def run(between, h):
        return simulate(
            c, e, time_step=h, n_steps=round(0.01 / h), pull=pc.Pull(between, 20000.0, 20.0), **settings
        )

    runs = [run("A:7:SG-B:1:N", h) for h in (0.001, 0.0005)]
    assert spread(runs[0]) / spread(runs[1]) == pytest.approx(4.0, rel=0.1)
    assert runs[0].trace["closure_error_nm"].max() < 1e-11
    # A bond that the loops keep, and one of the distances that keep its angles.
    for between in ("A:7:SG-B:7:SG", "A:7:CB-B:7:SG"):
        with pytest.raises(pc.ProtochainError, match="closed loops fix this distance"):
            run(between, 0.001)


def test_nothing_turns_or_drifts_by_pulling(small):
    m = simulate(*small, n_steps=50, thermostat="none", every=50, pull=pc.Pull(ENDS, speed=1.0))
    linear, angular = multibody.momentum(m.chain.tree, m.state.at.factors.frames, m.qd)
    assert np.abs(linear).max() < 1e-8 and np.abs(angular).max() < 1e-8


# --- A spring that stands still


# --- Going on


@pytest.mark.parametrize(
    ("thermostat", "integrator"),
    [("none", "midpoint"), ("langevin", "leapfrog"), ("nose-hoover", "leapfrog")],
)
def test_a_run_in_parts_is_the_run_in_one(thermostat, integrator, small, tmp_path):
    c, e, q = small
    settings = {
        "thermostat": thermostat, "integrator": integrator, "every": 5, "seed": 3,
        "pull": pc.Pull(ENDS, speed=0.7),
    }  # fmt: skip
    n = 30 if integrator == "leapfrog" else 15
    whole = simulate(c, e, q, n_steps=n, **settings)
    simulate(c, e, q, n_steps=n - 10, output=tmp_path, checkpoint_every=1, **settings)
    # Resumed without q, as the command does: the spring has the length of its own start.
    part = simulate(c, e, n_steps=n, output=tmp_path, resume=True, **settings)
    assert np.array_equal(part.q, whole.q) and np.array_equal(part.qd, whole.qd)
    assert (
        np.array_equal(part.state.at.work, whole.state.at.work) and part.state.at.time == whole.state.at.time
    )
    pd.testing.assert_frame_equal(part.trace, whole.trace, check_exact=True, check_dtype=False)


def test_a_held_run_of_hybrid_monte_carlo_goes_on_too(small, tmp_path):
    c, e, q = small
    settings = {
        "thermostat": "hmc", "every": 10, "seed": 3, "pull": pc.Pull(ENDS, 300.0, 0.0), "fixman": True,
        "hinge_springs": "psi 5",
    }  # fmt: skip
    whole = simulate(c, e, q, n_steps=40, **settings)
    simulate(c, e, q, n_steps=20, output=tmp_path, **settings)
    part = simulate(c, e, n_steps=40, output=tmp_path, resume=True, **settings)
    assert np.array_equal(part.q, whole.q) and whole.accepted > 0.0
    pd.testing.assert_frame_equal(part.trace, whole.trace, check_exact=True, check_dtype=False)
    # All that is added to the force field's energy is a column of its own.
    row = whole.trace.iloc[-1]
    held = 0.5 * row["pull_force_kj_mol_nm"] ** 2 / 300.0
    added = row["fixman_kj_mol"] + row["hinge_springs_kj_mol"] + held
    assert row["potential_kj_mol"] + added == pytest.approx(whole.state.at.potential, rel=1e-12)
    assert row["potential_kj_mol"] == pytest.approx(e(whole.x)[0], abs=1e-6)


def test_another_pull_is_another_run(small, tmp_path):
    simulate(*small, n_steps=10, every=5, output=tmp_path, pull=pc.Pull(ENDS))
    for other, word in (
        (pc.Pull(ENDS, speed=0.02), "pull_speed"),
        (pc.Pull(ENDS, 900.0), "pull_stiffness"),
        (pc.Pull("A:1:N-A:9:C"), "A:9:C"),
        (None, "pull"),
    ):
        with pytest.raises(pc.ProtochainError, match=word):
            simulate(*small, n_steps=20, every=5, output=tmp_path, resume=True, pull=other)


# --- Names of places


def test_places_are_found_by_chain_number_insertion_code_and_name(tmp_path):
    """In PDB and mmCIF, with a number below zero and two residues of one number."""
    read = gemmi.read_structure(str(STRUCTURES / "ala10.pdb"))
    for i, residue in enumerate(read[0][0]):
        residue.seqid = gemmi.SeqId(-3 if i == 0 else min(i, 5), " " if i < 5 else chr(60 + i))
    read.setup_entities()
    read.write_pdb(str(tmp_path / "odd.pdb"))
    read.make_mmcif_document().write_file(str(tmp_path / "odd.cif"))
    for name in ("odd.pdb", "odd.cif"):
        s = pc.load(tmp_path / name)
        c = pc.build_chain(s)
        assert list(s.residue_number[-2:]) == ["5", "5"] and s.residue_insertion_code[-1] == "E"
        spring = moving_spring(pc.Pull("A:-3:N-A:5E:C"), c, c.q0)
        named = {
            (int(r), str(n)): i for i, (r, n) in enumerate(zip(s.atom_residue, s.atom_name, strict=True))
        }
        apart = s.positions[named[9, "C"]] - s.positions[named[0, "N"]]
        assert spring.start == pytest.approx(np.linalg.norm(apart), rel=1e-9)
        with pytest.raises(
            pc.ProtochainError, match=r"A:7:C: there are no residues A:7; chain A has -3 to 5E"
        ):
            moving_spring(pc.Pull("A:-3:N-A:7:C"), c, c.q0)


@pytest.mark.parametrize(
    ("between", "read"),
    [
        ("A:-3:N-B:-1A:CG2", ("A:-3:N", "B:-1A:CG2")),
        ("A-2:1:N-B-x:20:O5'", ("A-2:1:N", "B-x:20:O5'")),
        ("A:1-A:20:CA", ("A:1", "A:20:CA")),
        ("resid -5:-3 - name CA", ("resid -5:-3", "name CA")),
        (["A:1:N", "resid 5"], ("A:1:N", "resid 5")),
    ],
)
def test_two_places_are_read_as_they_are_meant(between, read):
    assert pc.Pull(between).between == read


@pytest.mark.parametrize(
    "between", ["", "A:1:N", "A:1:N A:20:C", "resid 5", ("A:1:N",), ("a", "b", "c"), 5, None]
)
def test_other_than_two_places_is_refused(between):
    with expect_refusal("between", match="A:1:N-A:20:C") as refused:
        pc.Pull(between)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("given", "word"),
    [
        ({"stiffness": 0.0}, "stiffness 0 kJ/mol/nm"),
        ({"stiffness": np.inf}, "stiffness"),
        ({"stiffness": "5"}, "stiffness=5"),
        ({"speed": np.nan}, "speed nan nm/ps"),
    ],
)
def test_numbers_that_make_no_sense_are_refused(given, word):
    assert pc.Pull(ENDS, stiffness=0.5).stiffness == 0.5
    with pytest.raises(pc.ProtochainError, match=word):
        pc.Pull(ENDS, **given)


@pytest.mark.parametrize(
    ("between", "said"),
    [
        ("A:1:N-A:2:XX", "A:2:XX: no atom XX in A:ALA2; its atoms are N H CA"),
        ("A:1:N-B:2:N", "there are no residues B:2; its chains are A"),
        ("A:1:N-A:11:N", "chain A has 1 to 10"),
        ("A:1:N-A:1:CA", "no hinge changes this distance"),
        # Both lie on the axis of a hinge between their bodies.
        ("A:2:N-A:2:CA", "no hinge changes this distance"),
        ("name N and resid 99 - resid 5", "selects no atom"),
        ("nonsense ( - resid 5", "cannot be read"),
        ("name CA - name CA", "both places coincide"),
    ],
)
def test_places_that_cannot_be_pulled_are_refused(between, said):
    with pytest.raises(pc.ProtochainError, match=said.replace("(", r"\(")) as refused:
        check_pull(pc.Pull(between), pc.build_chain(load("ala10.pdb"), root="free"))
    assert "\n" not in str(refused.value)


def test_what_nothing_moves_cannot_be_pulled():
    """Two chains with fixed roots: their roots stay as far apart as they are, other parts do not."""
    s = load("3i40.pdb")
    c = pc.build_chain(s, root="fixed")
    roots = c.tree.parent < 0
    fixed = [np.flatnonzero((c.atom_body == b) & (s.atom_name == "CA"))[0] for b in np.flatnonzero(roots)]
    names = [
        f"{s.residue_chain[r]}:{s.residue_number[r]}:CA" for r in s.atom_residue[fixed]
    ]  # fmt: skip
    with pytest.raises(pc.ProtochainError, match="no hinge changes this distance"):
        check_pull(pc.Pull(names), c)
    check_pull(pc.Pull(names), pc.build_chain(s, root="free"))
    check_pull(pc.Pull(("A:1:N", "B:1:N")), c)


# --- Extremes


def test_a_spring_too_fast_or_too_stiff_is_said_so(small):
    m = simulate(*small, n_steps=400, every=50, pull=pc.Pull(ENDS, 1e5, speed=19.0))
    assert m.ending == "unstable" and "pull more slowly" in m.message
    for speed in (21.0, -21.0, 1e200):
        with pytest.raises(
            pc.ProtochainError, match=r"moves the spring by more than 0\.1 nm in a step; .* 20$"
        ):
            simulate(*small, n_steps=400, pull=pc.Pull(ENDS, speed=speed))
    for stiffness in (1e9, 1e30):
        m = simulate(*small, n_steps=50, every=50, pull=pc.Pull(ENDS, stiffness))
        assert m.ending == "unstable" and "softer spring" in m.message


def test_hybrid_monte_carlo_has_no_time_in_which_to_pull(small):
    with pytest.raises(pc.ProtochainError, match=r"hmc: .* speed of 0"):
        simulate(*small, n_steps=10, thermostat="hmc", every=10, pull=ENDS)


# --- The command
