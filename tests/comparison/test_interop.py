"""What notebooks and other libraries see: frames of MDAnalysis, ASE, scipy, bars, tables, shared energies."""

import dataclasses
import gc
import io
import sys

import numpy as np
import pytest
from fixtures.samples import chain, energy, load, simulation
from fixtures.tolerances import NATIVE_ENERGY
from openmm import app, unit

import protochain as pc
from protochain.energies.requested import cached_energy

SINGLE_NM = 2e-6
"""Positions of some nm in single precision."""


def universe_of(*frames):
    """A Universe of the sample with these frames, nm."""
    universe = pc.to_mdanalysis(load("ala10.pdb"))
    universe.load_new(10.0 * np.array(frames), order="fac")
    return universe


def shaken(k):
    x = load("ala10.pdb").positions
    return x + np.random.default_rng(k).normal(scale=0.002, size=x.shape)


def test_every_frame_is_minimised_as_if_it_were_alone():
    frames = [shaken(k) for k in range(3)]
    results = pc.EveryFrame(universe_of(*frames), "lbfgs").run(step=2).results
    assert results.table["frame"].tolist() == [0, 2]
    for row, end, x in zip(
        results.table.to_dict("records"), results.structures, (frames[0], frames[2]), strict=True
    ):
        alone = pc.minimise(pc.build_chain(load("ala10.pdb").with_positions(x)), energy("ala10.pdb"), "lbfgs")
        assert row["status"] == "converged"
        # Positions went through single precision; forces here are some thousand kJ/mol/nm.
        assert row["energy_start_kj_mol"] == pytest.approx(alone.start.energy, abs=0.1)
        assert row["energy_end_kj_mol"] == pytest.approx(alone.end.energy, abs=0.1)
        assert row["ca_rmsd_angstrom"] == pytest.approx(
            pc.ca_rmsd(end, end.positions, x), abs=10 * 100 * SINGLE_NM
        )


def test_every_frame_can_be_measured_only_and_a_bad_one_stops_nothing():
    spoilt = shaken(1)
    spoilt[2] = np.nan
    results = pc.EveryFrame(universe_of(shaken(0), spoilt, shaken(2)), None).run().results
    table = results.table
    assert "energy_end_kj_mol" not in table
    for k in (0, 2):
        value, forces = energy("ala10.pdb").reference(shaken(k))
        assert table.loc[k, "energy_start_kj_mol"] == pytest.approx(value, abs=0.1)
        rms = np.sqrt(np.mean(forces**2))
        assert table.loc[k, "rms_force_start_kj_mol_nm"] == pytest.approx(rms, rel=1e-3)
        assert np.abs(results.structures[k].positions - shaken(k)).max() < SINGLE_NM
    assert results.structures[1] is None and np.isnan(table.loc[1, "energy_start_kj_mol"])
    assert "frame 1" in table.loc[1, "message"]


def test_equal_atoms_share_an_energy_and_others_do_not():
    s = load("ala10.pdb")
    first = cached_energy(s, solvent="vacuum")
    assert cached_energy(s.with_positions(shaken(0)), solvent="vacuum") is first
    assert cached_energy(s, solvent="obc2") is not first
    assert dataclasses.replace(s, obstacle=np.arange(s.n_atoms) == 0).fingerprint != s.fingerprint
    assert load("1l2y.pdb").fingerprint != s.fingerprint


def test_ase_sees_the_same_energy_in_its_units():
    from ase.units import kJ, mol, nm

    s, e = load("ala10.pdb"), energy("ala10.pdb")
    atoms = pc.to_ase(s, e)
    value, forces = e(s.positions)
    assert atoms.get_potential_energy() / (kJ / mol) == pytest.approx(value, rel=1e-12)
    assert np.allclose(atoms.get_forces() / (kJ / mol / nm), forces, rtol=1e-10, atol=1e-8)
    assert atoms.get_chemical_symbols() == s.atom_element.tolist()
    # ASE's own finite differences, in eV/angstrom.
    atom, step = 5, 1e-4
    difference = []
    for sign in (1, -1):
        moved = atoms.copy()
        moved.calc = atoms.calc
        moved.positions[atom, 0] += sign * step
        difference.append(moved.get_potential_energy())
    assert -(difference[0] - difference[1]) / (2 * step) == pytest.approx(
        atoms.get_forces()[atom, 0], rel=1e-4, abs=1e-5
    )


def test_without_ase_the_mend_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "ase", None)
    with pytest.raises(pc.ProtochainError, match="pip install ase"):
        pc.to_ase(load("ala10.pdb"), energy("ala10.pdb"))


@pytest.mark.parametrize("kind", ["minimise", "simulate"])
def test_a_bar_counts_what_was_done_and_ends(kind, monkeypatch):
    shown = io.StringIO()
    monkeypatch.setattr(sys, "stderr", shown)
    if kind == "minimise":
        watch = pc.progress("lbfgs")
        r = pc.minimise(chain("ala10.pdb"), energy("ala10.pdb"), "lbfgs", watch=watch)
        said = f"{r.n_evaluations} evaluations"
    else:
        watch = pc.progress("motion", total=40)
        pc.simulate(chain("ala10.pdb"), energy("ala10.pdb"), n_steps=40, every=10, watch=watch)
        said = "40 steps"
    del watch
    gc.collect()  # A compiler that ran meanwhile may have kept its callers' frames.
    last = shown.getvalue().split("\r")[-1]
    assert said in last and "\n" in last and ("kJ/mol" in last or " K" in last)
    assert ("left 0:00:00" in last) == (kind == "simulate")


def test_a_structure_and_a_solution_can_be_looked_at():
    r = pc.minimise(chain("ala10.pdb"), energy("ala10.pdb"), "lbfgs", max_evaluations=3)
    assert list(pc.view(r).shown) == ["start", "lbfgs"]
    assert pc.view(load("ala10.pdb"))._repr_html_().startswith("<iframe title=")


def test_an_energy_of_other_atoms_is_refused():
    built = pc.from_sequence("NLYIQWLKDGGPSSGRPPPS")
    assert built.n_atoms == load("1l2y.pdb").n_atoms
    e = energy("1l2y.pdb")
    for run in (pc.minimise, pc.simulate):
        with pytest.raises(pc.ProtochainError, match="other atoms"):
            run(pc.build_chain(built), e)
    given = pc.energy(built, system=e.system, engine="openmm")
    assert pc.minimise(pc.build_chain(built), given, "kcm", max_evaluations=2).n_evaluations == 2


def test_a_simulation_of_openmm_comes_and_goes():
    of = simulation("ala10.pdb")
    s, e = pc.from_simulation(of)
    judged = of.context.getState(getEnergy=True).getPotentialEnergy().value_in_unit(unit.kilojoule_per_mole)
    assert np.allclose(s.positions, load("ala10.pdb").positions, atol=SINGLE_NM)
    assert e(s.positions)[0] == pytest.approx(judged, rel=NATIVE_ENERGY * 100)
    r = pc.minimise(s, e, max_evaluations=50)
    pc.to_simulation(r, of)
    found = of.context.getState(getEnergy=True, getPositions=True)
    assert np.allclose(found.getPositions(asNumpy=True).value_in_unit(unit.nanometer), r.x, atol=SINGLE_NM)
    ended = found.getPotentialEnergy().value_in_unit(unit.kilojoule_per_mole)
    assert ended == pytest.approx(r.end.energy, rel=1e-9) and ended < judged
    of.step(1)


def test_simulations_that_cannot_be_taken_are_refused():
    with pytest.raises(pc.ProtochainError, match="flexibleConstraints"):
        pc.from_simulation(simulation("ala10.pdb", constraints=app.HBonds))
    kept = simulation("ala10.pdb", constraints=app.HBonds, flexibleConstraints=True)
    assert pc.from_simulation(kept)[1].engine == "native"
    with pytest.raises(pc.ProtochainError, match="304 atoms, not the 103"):
        pc.to_simulation(load("1l2y.pdb"), kept)
    with pytest.raises(pc.ProtochainError, match="explicit water"):
        pc.from_simulation(simulation("ala10.pdb", water=5.0))
