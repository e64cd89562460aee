"""Restraints of one form: their energies, the files they are read from, and the runs that take them."""

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest
from fixtures.command_line import refusal_as_said, run
from fixtures.refusals import expect_refusal
from fixtures.samples import STRUCTURES, chain, load, shared

import protochain as pc
from protochain.chains.restraint import PLACES
from protochain.chains.restraint_lines import read_restraints
from protochain.chains.restraint_list import FORMS, Restraints
from protochain.energies.custom import check_forces
from protochain.structure.select import atoms_at


def distance(structure, a, b, x=None):
    x = structure.positions if x is None else x
    return 10.0 * np.linalg.norm(x[atoms_at(structure, a)[0]] - x[atoms_at(structure, b)[0]])


@pytest.mark.parametrize(
    "line",
    [
        "distance A:3:CA A:15:CA 4 5 1000", "distance A:3:CA A:15:CA 20 30 500",
        "distance 'resid 3 and name HB*' 'resid 15 and name HA#' 1 2 300",
        "dihedral 'phi A:5' 60 80 200", "dihedral phi@A:5 170 190 200",
        "dihedral A:5:N A:5:CA A:5:CB A:5:CG -10 0 50", "position A:3 0.5 1000",
    ],
)  # fmt: skip
def test_forces_are_those_of_the_energy(line):
    s = load("1l2y.pdb")
    held = Restraints.of(s, line)
    x = s.positions + np.random.default_rng(1).normal(scale=0.05, size=s.positions.shape)
    assert held(x)[0] > 0.0
    check_forces(held, x, line)
    value, forces = held(x)
    assert np.abs(forces.sum(axis=0)).max() < 1e-6 or "position" in line
    for _ in range(3):
        step = 1e-6 * np.random.default_rng(2).normal(size=x.shape)
        slope = held(x + step)[0] - held(x - step)[0]
        assert slope == pytest.approx(-2.0 * np.vdot(forces, step), rel=1e-4)
    assert value == pytest.approx(sum(Restraints.of(s, [each])(x)[0] for each in (line,)))


def test_within_the_bounds_there_is_no_energy_and_outside_half_k_e_squared():
    s = load("1l2y.pdb")
    d = distance(s, "A:3:CA", "A:15:CA")
    for low, high, e in ((d - 1, d + 1, 0.0), (d - 3, d - 2, 2.0), (d + 1.5, d + 3, 1.5)):
        value, forces = Restraints.of(s, pc.Restraint("distance", ("A:3:CA", "A:15:CA"), low, high, 700.0))(
            s.positions
        )
        assert value == pytest.approx(0.5 * 700.0 * (0.1 * e) ** 2) and bool(forces.any()) == (e > 0.0)
    far = pc.Restraint("distance", ("A:3:CA", "A:15:CA"), 0.0, d - 3.0, 700.0, linear=1.0)
    assert Restraints.of(s, far)(s.positions)[0] == pytest.approx(700.0 * 0.1 * (0.3 - 0.05))
    phi = s.dihedrals()["phi"][4]
    over = pc.Restraint("dihedral", ("phi A:5",), phi + 350.0, phi + 355.0, 80.0)
    assert Restraints.of(s, over)(s.positions)[0] == pytest.approx(0.5 * 80.0 * np.deg2rad(5.0) ** 2)


def test_several_atoms_are_as_near_as_by_r6():
    s = load("1l2y.pdb")
    held = Restraints.of(s, "distance 'resid 3 and name HB*' A:14:HA 0 1")
    pairs = [distance(s, f"A:3:{name}", "A:14:HA") for name in ("HB2", "HB3")]
    assert 10.0 * held.values(s.positions)[0] == pytest.approx(np.sum(np.array(pairs) ** -6.0) ** (-1 / 6))


def test_lines_are_read_as_they_are_written(tmp_path):
    lines = [
        "distance A:3:CA A:15:CA 0 6 1000",
        "dihedral 'phi A:5' -70 -50 200",
        "position 'name CA' 0.5 10",
    ]
    (tmp_path / "r.txt").write_text("# held\n\n" + "  # so\n".join(lines) + "\n")
    read = read_restraints(tmp_path / "r.txt")
    assert [str(each) for each in read] == lines == [str(each) for each in read_restraints(lines)]
    assert read[0] == pc.Restraint("distance", ("A:3:CA", "A:15:CA"), 0.0, 6.0)
    assert pc.Restraint.read("distance A:3:CA A:15:CA 0 6").stiffness == 1000.0


def test_amber_is_read(tmp_path):
    """As sander has it: E = k (r - r3)^2 beyond r3, and on along its slope beyond r4; kcal/mol, angstrom."""
    (tmp_path / "rst").write_text(
        "# 3 CA 15 CA\n &rst iat= 1, 20, 0\n r1=1.0, r2=2.0, r3=5.0, r4=6.0, rk2=20.0, rk3=32.0, /\n"
        "&rst iat=5,7,9,11, r1=-90., r2=-70., r3=-50., r4=-30., rk2=4.,rk3=4., &end\n"
    )
    s = load("1l2y.pdb")
    held = Restraints.of(s, tmp_path / "rst")
    first, other = (int(np.flatnonzero(s.origin.place == k)[0]) for k in (0, 19))
    x = np.array(s.positions)
    for r, expected in ((5.5, 32.0 * 0.25), (8.0, 32.0 * 1.0 + 64.0 * 2.0), (3.0, 0.0), (1.5, 20.0 * 0.25)):
        x[other] = x[first] + [0.1 * r, 0.0, 0.0]
        only = Restraints.of(s, held.listed[:1])
        assert only(x)[0] == pytest.approx(4.184 * expected)
    assert (held.listed[1].lower, held.listed[1].upper, held.listed[1].linear) == (-70.0, -50.0, 20.0)
    assert held.listed[1].stiffness == pytest.approx(2 * 4.184 * 4.0)


def test_cns_is_read(tmp_path):
    (tmp_path / "noe.tbl").write_text(
        "! sheet\nassign (resid 3 and name HB#) (resid 14 and name HA) 4.0 2.2 1.0 ! strong\n"
        "assi (( resid 4 and name HN ) or (resid 4 and name ha)) (segid A and resid 9 and name CA) 5 5 0\n"
    )
    (tmp_path / "dihe.tbl").write_text(
        "assign (resid 4 and name C) (resid 5 and name N)\n  (resid 5 and name CA) (resid 5 and name C)"
        " 5.0 -60.0 20.0 2\n"
    )
    s = load("1l2y.pdb")
    noe, dihedral = (Restraints.of(s, tmp_path / name) for name in ("noe.tbl", "dihe.tbl"))
    assert [(round(r.lower, 9), r.upper) for r in noe.listed] == [(1.8, 5.0), (0.0, 5.0)]
    assert len(noe.coordinates[0].pairs) == 2 + 2  # HN is H.
    assert np.degrees(dihedral.values(s.positions)[0]) == pytest.approx(s.dihedrals()["phi"][4])
    (r,) = dihedral.listed
    assert (r.lower, r.upper, r.stiffness) == (-80.0, -40.0, pytest.approx(41.84))


def test_every_run_takes_them():
    s = load("1l2y.pdb")
    e = pc.energy(s, solvent="vacuum", threads=1)
    line = "distance A:3:CA A:15:CA 0 5 50000"
    assert distance(s, "A:3:CA", "A:15:CA") > 8.0
    r = pc.minimise(s, e, restraints=line, max_evaluations=300)
    assert distance(s, "A:3:CA", "A:15:CA", r.x) < 6.0 and r.restraints[1] < r.restraints[0]
    assert r.end.energy == pytest.approx(e(r.x)[0], rel=1e-6)  # No result contains them.
    torsions = pc.minimise(s, e, "lbfgs", restraints=pc.Restraint.read(line), max_evaluations=300)
    assert distance(s, "A:3:CA", "A:15:CA", torsions.x) < 6.5
    clean = pc.relax(s, solvent="vacuum", threads=1, restraints=[line], stiffness=10.0, tolerance=50.0)
    assert distance(s, "A:3:CA", "A:15:CA", clean.x) < 6.0
    c = chain("ala10.pdb")
    held = pc.energy(c.structure, solvent="vacuum", threads=1)
    how = {"n_steps": 1500, "seed": 1, "every": 20, "time_step": 0.002, "friction": 20.0}
    m = pc.simulate(c, held, restraints="dihedral phi@A:5 -60 -60 5000", **how)
    phi = c.structure.with_positions(m.x).dihedrals()["phi"][4]
    assert abs((phi + 60.0 + 180.0) % 360.0 - 180.0) < 15.0
    assert m.trace["restraints_kj_mol"].iloc[-1] < 50.0 < m.trace["restraints_kj_mol"].iloc[0]
    drift = m.trace["conserved_kj_mol"] - m.trace["conserved_kj_mol"].iloc[0]
    assert drift.abs().max() < 20.0


def test_frames_are_relaxed_under_them():
    s = load("5awl.pdb")
    line = "distance A:1:CA A:10:CA 0 4 50000"
    (done,) = pc.relax_frames(s, s.positions[None], restraints=line, stiffness=10.0, solvent="vacuum")
    assert distance(s, "A:1:CA", "A:10:CA", done.structure.positions) < distance(s, "A:1:CA", "A:10:CA") - 0.3


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("distance A:3:CA 0 6", "give kind, places"), ("distance A:3:CA A:9:CA 6 0", "upper; give 0 6"),
        ("angle A:3:CA A:9:CA 0 6", "1000 100 0"), ("distance A:3:CA A:99:CA 0 6", "no residues A:99"),
        ("distance A:3:CA A:3:CA 0 6", "on both sides"), ("dihedral 'phi A:1' 0 6", "A:1 has psi"),
        ("dihedral A:3 A:4:CA A:5:CA A:6:CA 0 6", "single atoms"), ("position A:3:CA -1", "a lower and an"),
        ("dihedral phi@A:5 170 -170", "above the upper; give 170 190"), ("nofile.txt", "no such file"),
        ("dihedral phi@A:5 -700 -50", "less than 360 degrees"),
        ("distance 'resid 3 and name XX' A:9:CA 0 6", "no atoms"), ("distance @1 @99999 0 6", "atoms @99999"),
    ],
)  # fmt: skip
def test_what_cannot_be_held_is_refused(given, said):
    with pytest.raises(pc.ProtochainError, match=said):
        pc.minimise(load("1l2y.pdb"), restraints=given, max_evaluations=2)


def test_damaged_tables_are_refused_by_their_name(tmp_path):
    for text, said in (
        ("&rst iat=1,2, r1=1 /", "give r1 to r4"),
        ("&rst iat=-1,2,r1=1,r2=2,r3=3,r4=4,rk2=1,rk3=1 /", "give the atoms of its group"),
        ("# none\n\n", "no restraints"), ("&rst iat=1,2", "has no end"),
        ("assign (resid 1) (resid 2) a b c", "not a distance"), ("distance A:1\n", "give kind, places"),
    ):  # fmt: skip
        (tmp_path / "bad.tbl").write_text(text)
        with pytest.raises(pc.ProtochainError, match=f"bad.tbl: .*{said}"):
            read_restraints(tmp_path / "bad.tbl")
    with expect_refusal("restraints"):
        pc.relax(load("1l2y.pdb"), restraints="nofile.txt")


def test_commands_take_a_file_or_a_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "r.txt").write_text("distance A:1:CA A:10:CA 0 5 20000\n")
    source, s = STRUCTURES / "5awl.pdb", load("5awl.pdb")
    common = ["--solvent", "vacuum", "--json"]
    for command, more in (
        ("minimise", ["-o", "m.pdb", "--max-evaluations", 200]),
        ("relax", ["-o", "r.pdb", "--stiffness", 10]),
    ):  # fmt: skip
        run(command, source, "--restraints", "r.txt", *more, *common)
        told = json.loads(capsys.readouterr().out)
        x = pc.load(more[1]).positions
        assert distance(s, "A:1:CA", "A:10:CA", x) < 5.6, command
        assert told["energy_restraints_end_kj_mol"] < told["energy_restraints_start_kj_mol"]
    folder = ["-o", "sim", "--steps", 20, "--every", 10, "--no-relax", *common]
    run("simulate", source, "--restraints", "r.txt", "--restraints", "dihedral 'phi A:5' -60 -50", *folder)
    assert len(json.loads(capsys.readouterr().out)["restraint"]) == 2
    assert "restraints_kj_mol" in (tmp_path / "sim" / "log.csv").read_text()
    assert "give kind, places" in refusal_as_said("simulate", source, "--restraints", "distance A:1", *folder)
    assert "omit it" in refusal_as_said("minimise", source, "--restraints", "")


@pytest.mark.parametrize("edges", [None, np.arange(-190.0, 0.0, 10.0)])
def test_windows_give_the_free_energy_from_which_their_samples_are_drawn(edges, monkeypatch):
    """Exactly, at random: F is known, and so is how much a bin's free energy scatters."""
    pytest.importorskip("pymbar")
    c, kt = pc.build_chain(pc.from_sequence("AA"), "phi", "fixed"), 8.314462618e-3 * 300.0
    grid, random = np.arange(-180.0, 180.0, 1.0) + 0.5, np.random.default_rng(5)
    (at,) = c.tree.q_start[c.hinge_body]
    q = np.tile(c.q0, (len(grid), 1))
    q[:, at] += np.deg2rad(grid) - np.deg2rad(c.structure.dihedrals()["phi"][1])
    x = [pc.pose(c, each).x for each in q]
    whole = 6.0 * np.cos(np.deg2rad(2.0 * grid)) + 3.0 * np.sin(np.deg2rad(grid))
    asked = []

    def drawn(chain, energy, q, temperature, *, restraints, watch, **options):
        restraint = restraints
        asked.append((restraint.lower, restraint.upper, temperature, options, q))
        pull = np.array([Restraints.of(c.structure, restraint)(each)[0] for each in x])
        share = np.exp(-(whole + pull) / kt)
        for k in random.choice(len(grid), 160, p=share / share.sum()):
            watch({}, x[k])
        return SimpleNamespace(is_sound=True, chain=c, q=f"end of {restraint.lower}")

    monkeypatch.setattr("protochain.dynamics.umbrella.simulate", drawn)
    centres, spring = np.arange(-170.0, 0.0, 20.0), pc.Restraint("dihedral", ("phi A:2",), 0, 0, 60.0)
    found = pc.umbrella(c, pc.energy(c), spring, centres[::-1], edges=edges, n_equilibrate=10, n_steps=7)
    assert [each[:3] for each in asked] == [(k, k, 300.0) for k in centres]
    assert [each[4] for each in asked] == [None, *(f"end of {k}" for k in centres[:-1])]
    assert asked[0][3] == {"n_steps": 7}
    bins = np.arange(-180.0, 1.0, 20.0) if edges is None else edges
    middle, of = 0.5 * (bins[1:] + bins[:-1]), np.digitize((grid - bins[0]) % 360.0 + bins[0], bins) - 1
    exact = {m: -kt * np.log(np.exp(-whole[of == k] / kt).sum()) for k, m in enumerate(middle)}
    off = found["free_energy_kj_mol"] - found["value"].map(exact)
    assert {*middle[2:-2]} <= {*found["value"]} <= {*middle} and found["free_energy_kj_mol"].min() == 0.0
    assert 150 * len(centres) * 0.95 < found["samples"].sum() <= 150 * len(centres)
    error = found["error_kj_mol"]  # Of the difference to the lowest, which has none.
    scatter = ((off - off.median()) / np.hypot(error, error.median())).to_numpy()
    assert np.abs(scatter).max() < 4.0 and 0.3 < np.sqrt((scatter**2).mean()) < 1.5, scatter


def test_windows_are_two_at_least_and_of_one_coordinate():
    c = pc.build_chain(pc.from_sequence("AA"), "phi")
    for spring, centres in (
        (pc.Restraint("dihedral", ("phi A:2",), 0, 0, 60.0), [0.0]),
        (pc.Restraint("position", (":2",), 0, 1, 60.0), [0.0, 1.0]),
    ):
        with pytest.raises(pc.ProtochainError, match="two centres or more, of a dihedral or a distance"):
            pc.umbrella(c, pc.energy(c), spring, centres)


@pytest.mark.slow
def test_windows_give_the_free_energy_of_quadrature():
    """Of a dipeptide's torsions, with Fixman's potential: F(phi) = -kT ln (sum over psi of exp(-E/kT))."""
    pytest.importorskip("pymbar")
    c = pc.build_chain(pc.load(shared("ala_dipeptide.pdb")), "phi psi")
    e = pc.energy(c.structure, threads=1)
    kt = 8.314462618e-3 * 300.0
    phi, psi = np.arange(-160.0, -49.0, 2.0), np.arange(-180.0, 180.0, 5.0)
    grid = pc.scan(c, e, {"phi :2": phi, "psi :2": psi})["energy_kj_mol"].to_numpy().reshape(len(phi), -1)
    whole = -kt * np.log(np.exp(-(grid - grid.min()) / kt).sum(axis=1))
    edges = np.arange(-160.0, -49.0, 10.0)
    bins = np.digitize(phi, edges) - 1
    expected = [-kt * np.log(np.exp(-whole[bins == k] / kt).mean()) for k in range(len(edges) - 1)]
    found = pc.umbrella(
        c, e, pc.Restraint("dihedral", ("phi :2",), 0, 0, 100.0), np.arange(-155.0, -50.0, 15.0), edges=edges,
        n_steps=8000, every=10, fixman=True, time_step=0.004, friction=10.0, seed=3,
    )  # fmt: skip
    off = found["free_energy_kj_mol"].to_numpy() - (np.array(expected) - np.min(expected))
    off -= off.mean()
    assert len(found) == len(expected) and np.abs(off).max() < 1.0, off
    assert math.sqrt((off**2).mean()) < 0.5


def test_every_kind_of_restraint_has_one_form():
    assert sorted(kind for form in FORMS for kind in form.kinds) == sorted(PLACES)
