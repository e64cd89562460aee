"""Molecules that something holds from outside: motion as one, frames, and the start of a command."""

import json
from functools import cache

import numpy as np
import pandas as pd
import pytest
from fixtures.command_line import run
from fixtures.samples import STRUCTURES
from fixtures.tolerances import ROUND_OFF_NM
from scipy.stats import gamma, kstest

import protochain as pc
from protochain.core.units import MOLAR_GAS
from protochain.dynamics import simulate

KT = 300.0 * MOLAR_GAS
ANCHOR = pc.Restraint("position", ("name CA and resid 1",), 0.0, 0.0, stiffness=1000.0)
TETHER = pc.Restraint("distance", ("A:1:CA", "A:5:CA"), 0.0, 6.0)
RADIUS = 5.0
"""nm, of a sphere in which a molecule is free until it comes to its wall."""


@cache
def peptide():
    """Chain, energy and coordinates of a minimum of a peptide of five residues."""
    s = pc.from_sequence("GASVF")
    c, e = pc.build_chain(s), pc.energy(s, threads=1)
    return c, e, pc.minimise(c, e, "lbfgs", tolerance=1.0).q


def in_field(x):
    """Springs of all atoms to the plane z = 0: a turn about z and shifts along x and y change nothing."""
    return 50.0 * float(np.sum(x[:, 2] ** 2)), -100.0 * x * [0.0, 0.0, 1.0]


def in_sphere(x):
    distance = np.linalg.norm(x, axis=1)
    beyond = np.maximum(distance - RADIUS, 0.0)
    return 500.0 * float(np.sum(beyond**2)), -1000.0 * (beyond / np.maximum(distance, 1e-9))[:, None] * x


def in_map(x):
    """Energy that has no value outside a box."""
    inside = bool((np.abs(x) < 2.0).all())
    return (0.0 if inside else np.nan), np.zeros_like(x)


def alone(x):
    return 0.0, np.zeros_like(x)


HELD = [
    (None, {"restraints": ANCHOR}, "restraints of positions"),
    (None, {"restraints": pc.Restraint("position", ("name CA",), 0.0, 20.0)}, "restraints of positions"),
    (in_field, {}, "its energy"), (in_sphere, {}, "its energy"), (in_map, {}, "its energy"),
]  # fmt: skip
FREE = [
    (None, {}), (None, {"restraints": TETHER}), (alone, {}), (None, {"pull": "A:1:CA-A:5:CA"}),
    (None, {"restraints": pc.Restraint("position", ("name CA",), 0.0, 0.0, stiffness=0.0)}),
]  # fmt: skip


@pytest.mark.parametrize("thermostat", ["none", "rescale", "nose-hoover", "langevin", "hmc"])
def test_six_freedoms_are_taken_from_molecules_that_nothing_holds_alone(thermostat):
    c, e, q = peptide()
    options = {"thermostat": thermostat, "n_steps": 2, "trajectory_length": 1, "every": 1}
    for field, more, holder in HELD:
        m = simulate(c, field or e, q, **options, **more)
        assert (m.freedoms, m.record()["frame"]) == (m.chain.n_v, f"held by {holder}")
    for field, more in FREE:
        if "pull" in more and thermostat == "hmc":
            continue
        m = simulate(c, field or e, q, **options, **more)
        removed = 0 if thermostat in ("langevin", "hmc") else 6
        assert (m.freedoms, m.record()["frame"]) == (m.chain.n_v - removed, "superposed on the start")


@pytest.mark.parametrize("thermostat", ["none", "rescale", "nose-hoover"])
def test_what_holds_a_molecule_takes_no_energy_every_100_steps(thermostat):
    m = simulate(
        *peptide(), time_step=0.001, n_steps=400, every=10, seed=1, thermostat=thermostat, restraints=ANCHOR
    )
    conserved, kinetic = m.trace["conserved_kj_mol"], m.trace["kinetic_kj_mol"]
    # Each removal took 0.1 to 0.4 kJ/mol.
    assert np.ptp(kinetic) > 3.0 and np.ptp(conserved) < 0.03
    assert m.trace["restraints_kj_mol"].max() > 0.5


def test_the_kinetic_energy_of_a_held_molecule_follows_the_gamma_law_of_all_freedoms():
    c, e, q = peptide()
    m = simulate(
        c, e, q, 300.0, 0.0005, 220, "rescale", 4, friction=5000.0, every=1, restraints=ANCHOR
    )  # fmt: skip
    energies = m.trace["kinetic_kj_mol"].to_numpy()[1:]
    assert kstest(energies, gamma(m.chain.n_v / 2, scale=KT).cdf).pvalue > 1e-3
    assert kstest(energies, gamma((m.chain.n_v - 6) / 2, scale=KT).cdf).pvalue < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("thermostat", ["rescale", "nose-hoover", "langevin"])
def test_a_spring_to_a_place_has_three_halves_of_kt(thermostat):
    """Exactly: nothing else depends on the place of the molecule. <|x - x0|^2> = 3 kT / k, too."""
    c, e, q = peptide()
    spring, atom = ANCHOR, c.structure.alpha_carbons[0]
    m = simulate(
        c, e, q, time_step=0.002, n_steps=40000, every=20, seed=3, thermostat=thermostat, friction=5.0,
        restraints=spring,
    )  # fmt: skip
    energies = m.trace["restraints_kj_mol"].to_numpy()[200:]
    away = m.frames[200:, atom] - c.structure.positions[atom]
    assert 0.5 * spring.stiffness * np.mean(np.sum(away**2, axis=1)) == pytest.approx(
        energies.mean(), rel=1e-3
    )
    assert energies.mean() == pytest.approx(1.5 * KT, rel=0.25)


def test_frames_of_a_held_molecule_stay_where_the_run_went_and_a_resumed_run_too(tmp_path):
    c, e, q = peptide()
    settings = {"every": 10, "seed": 2, "thermostat": "rescale", "restraints": ANCHOR}
    whole = simulate(c, e, q, n_steps=240, **settings)
    simulate(c, e, q, n_steps=120, output=tmp_path, **settings)
    m = simulate(c, e, q, n_steps=240, output=tmp_path, resume=True, **settings)
    assert m.freedoms == whole.freedoms and np.array_equal(m.q, whole.q)
    assert np.abs(m.x - pc.pose(m.chain, m.q).x).max() < ROUND_OFF_NM
    assert np.abs(m.frames[0] - pc.pose(c, q).x).max() < 1e-6 and np.abs(m.frames - whole.frames).max() < 1e-6
    atom = c.structure.alpha_carbons[0]
    away = np.linalg.norm(m.frames[:, atom] - c.structure.positions[atom], axis=1)
    assert away == pytest.approx(np.sqrt(2.0 * m.trace["restraints_kj_mol"] / ANCHOR.stiffness), abs=1e-4)


RESTRAINTS = {
    "distance A:1:CA A:10:CA 0 6 1000": 2000.0,
    "dihedral 'phi A:5' 50 70 5000": 1000.0,
}
"""And a bound in kJ/mol: the input is above it."""


@pytest.mark.parametrize("line", RESTRAINTS)
def test_a_command_minimises_with_its_restraints(line, tmp_path, capsys):
    source, folder = STRUCTURES / "ala10.pdb", tmp_path / "run"
    run(
        "simulate", source, "-o", folder, "--steps", 40, "--every", 10, "--time-step", 2,
        "--restraints", line, "--solvent", "vacuum", "--json",
    )  # fmt: skip
    printed = capsys.readouterr()
    record, log = json.loads(printed.out), pd.read_csv(folder / "log.csv")
    c = pc.build_chain(source)
    before = pc.simulate(c, pc.energy(c, solvent="vacuum"), n_steps=1, restraints=line).trace[
        "restraints_kj_mol"
    ]
    assert before[0] > RESTRAINTS[line] and "restraints" in printed.err
    assert log["restraints_kj_mol"][0] < 10.0 and log["temperature_k"].max() < 600.0
    assert record["status"] == "completed"
