"""A cutoff: the same function as OpenMM's with it, chosen for large structures, its error said."""

import re

import numpy as np
import openmm
import pytest
from fixtures.samples import load
from fixtures.tolerances import NATIVE_ENERGY, NATIVE_FORCE
from openmm import app, unit

import protochain as pc
from protochain.chains.setup import Setup
from protochain.core import defaults
from protochain.core.errors import ProtochainError
from protochain.energies.factory import _sums_of


def by_openmm(s, solvent, cutoff):
    """Energy and forces on the Reference platform of what the force field's own files build."""
    files = ["amber14/protein.ff14SB.xml", *([f"implicit/{solvent}.xml"] if solvent != "vacuum" else [])]
    system = app.ForceField(*files).createSystem(
        s.topology, nonbondedMethod=app.CutoffNonPeriodic, nonbondedCutoff=cutoff * unit.nanometer
    )
    platform = openmm.Platform.getPlatformByName("Reference")
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), platform)
    context.setPositions(s.positions)
    state = context.getState(getEnergy=True, getForces=True)
    energy = state.getPotentialEnergy().value_in_unit(unit.kilojoule_per_mole)
    return energy, state.getForces(asNumpy=True).value_in_unit(unit.kilojoule_per_mole / unit.nanometer)


@pytest.mark.parametrize("solvent", ["vacuum", "obc2", "gbn2"])
def test_a_cutoff_is_that_of_openmms_files(solvent):
    s = load("1l2y.pdb")
    e = pc.energy(s, solvent=solvent, cutoff=0.8, engine="native")
    expected, forces = by_openmm(s, solvent, 0.8)
    size = sum(map(abs, e.parts(s.positions)[0].values()))
    assert abs(e(s.positions)[0] - expected) < 10.0 * NATIVE_ENERGY * size
    assert np.linalg.norm(e(s.positions)[1] - forces) < 10.0 * NATIVE_FORCE * np.linalg.norm(forces)
    assert abs(e.reference(s.positions)[0] - e(s.positions)[0]) < NATIVE_ENERGY * size
    assert abs(pc.energy(s, solvent=solvent, cutoff=None)(s.positions)[0] - expected) > 1.0


@pytest.mark.parametrize("solvent", ["obc2", "vacuum"])
def test_the_error_of_a_cutoff_is_said(solvent):
    """Compared with all pairs, without a reaction field, which a cutoff has in vacuum alone."""
    s = load("1l2y.pdb")
    whole = pc.energy(s, solvent=solvent)(s.positions)[1]
    for cutoff in (0.8, 1.5):
        e = pc.energy(s, solvent=solvent, cutoff=cutoff)
        off = np.sqrt(np.mean(np.sum((e(s.positions)[1] - whole) ** 2, axis=1)))
        assert f"cutoff {cutoff:g} nm" in e.reason
        (said,) = re.findall(r"differ by (\S+) kJ/mol/nm RMS", e.reason)
        assert float(said) == pytest.approx(off, rel=0.06) and off > 0.1


def test_auto_takes_all_pairs_of_small_structures_and_in_vacuum(monkeypatch):
    s = load("1l2y.pdb")
    assert "no cutoff" in pc.energy(s).reason and "no cutoff" in pc.energy(s, cutoff="none").reason
    monkeypatch.setattr(defaults, "FULL_UP_TO", s.n_atoms - 1)
    assert f"cutoff {defaults.LONG_CUTOFF:g} nm" in pc.energy(s).reason
    assert "no cutoff" in pc.energy(s, solvent="vacuum").reason
    assert "no cutoff" in pc.energy(s, cutoff=None).reason
    monkeypatch.setattr(defaults, "FULL_UP_TO", s.n_atoms)
    assert "no cutoff" in pc.energy(s).reason


def test_a_setup_hands_its_cutoff_on():
    s = load("1l2y.pdb")
    assert "cutoff 1.2 nm" in Setup(cutoff="1.2").energy(s).reason
    assert "no cutoff" in Setup().energy(s).reason


@pytest.mark.parametrize("given", [0, "far", float("nan"), "1e7", True])
def test_what_is_no_distance_is_refused(given):
    with pytest.raises(ProtochainError, match=r"cutoff .*: give a (distance in nm, auto, or none|number)"):
        pc.energy(load("1l2y.pdb"), cutoff=given)


@pytest.mark.parametrize("engine", ["auto", "native", "openmm"])
def test_a_cutoff_within_which_atoms_touch_is_refused_by_every_engine(engine):
    """OpenMM took 0.1 nm, and gave -10,650 kJ/mol for -2,414."""
    for given in (0.1, "0.1", 0.499):
        with pytest.raises(
            ProtochainError, match=r"^cutoff 0\.\d+ nm: is shorter than contacts .* give 0\.5 nm or more"
        ):
            pc.energy(load("1l2y.pdb"), engine=engine, cutoff=given)
    assert "cutoff 0.5 nm" in Setup(cutoff="0.5", engine=engine).energy(load("1l2y.pdb")).reason


@pytest.mark.parametrize(
    ("engine", "solvent", "n_atoms", "accuracy", "cutoff"),
    [
        ("auto", "vacuum", defaults.TREE_FROM_IN_VACUUM - 1, "exact", None),
        ("auto", "vacuum", defaults.TREE_FROM_IN_VACUUM, defaults.TREE_ACCURACY, None),
        ("openmm", "vacuum", 90_000, "exact", None),
        ("native", "obc2", defaults.TREE_FROM - 1, "exact", None),
        ("native", "gbn2", defaults.TREE_FROM, defaults.TREE_ACCURACY, None),
        ("openmm", "obc2", defaults.FULL_UP_TO, "exact", None),
        ("openmm", "obc2", defaults.FULL_UP_TO + 1, "exact", defaults.LONG_CUTOFF),
        ("auto", "obc2", defaults.FULL_UP_TO + 1, defaults.TREE_ACCURACY, None),
    ],
)  # fmt: skip
def test_the_rules_of_sums_go_by_engine_solvent_and_size(engine, solvent, n_atoms, accuracy, cutoff):
    assert _sums_of(engine, solvent, n_atoms) == (accuracy, cutoff)
