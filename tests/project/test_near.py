"""What the benchmark of minima compares with: the end of OpenMM's minimiser, not a point on its way."""

import importlib
import sys

import numpy as np
import openmm
import pytest
from fixtures.samples import ROOT, energy, load
from fixtures.tolerances import OWN_END

import protochain as pc

sys.path.insert(0, str(ROOT / "analysis" / "benchmarks"))
near = importlib.import_module("near")


@pytest.fixture(scope="module")
def compared():
    return near.compared(load("ala10.pdb"))


def test_openmms_ends_are_those_of_its_own_run(compared):
    """Whose tolerance is of the RMS force on an atom; of its components, as ours is, 0.58 of that."""
    s, e = load("ala10.pdb"), energy("ala10.pdb")
    for row in compared[1]:
        platform = openmm.Platform.getPlatform("CPU")
        integrator = openmm.VerletIntegrator(0.001)
        context = openmm.Context(e.system, integrator, platform, {"Threads": "1"})
        context.setPositions(s.positions)
        openmm.LocalEnergyMinimizer.minimize(context, row["tolerance"])
        x = context.getState(positions=True).getPositions(asNumpy=True)._value
        value, forces = e.reference(x)
        size = np.sqrt(np.mean(forces**2))
        assert row["openmm_kj_mol"] == pytest.approx(value, abs=OWN_END)
        assert row["openmm_rms_force_kj_mol_nm"] == pytest.approx(size, abs=OWN_END)
        # A point on the way would be above it, and is.
        assert size < 1.05 * row["tolerance"] / np.sqrt(3.0) < 0.7 * row["tolerance"]
        assert row["openmm_first_met_kj_mol"] > row["openmm_kj_mol"] + 10.0 * OWN_END


def test_our_points_are_at_the_same_force_and_no_farther(compared):
    ways, ends = compared
    trace = pc.minimise(load("ala10.pdb"), pc.energy(load("ala10.pdb"), threads=1), tolerance=0.1).trace
    for row in ends:
        small = trace["rms_force_kj_mol_nm"] <= row["openmm_rms_force_kj_mol_nm"]
        at = trace.loc[small.idxmax()]
        assert row["equal_force_kj_mol"] == at["energy_kj_mol"]
        assert row["equal_force_evaluations"] == at["evaluations"]
        near_by = trace["ca_rmsd_angstrom"] <= row["openmm_ca_rmsd_angstrom"]
        assert row["equal_distance_kj_mol"] == trace["energy_kj_mol"][near_by].min()
        (met,) = (
            each
            for each in ways
            if (each["method"], each["tolerance"]) == ("cartesian", row["tolerance"])
        )  # fmt: skip
        assert met["energy_kj_mol"] == pytest.approx(row["end_kj_mol"], abs=1e-6)
        assert met["evaluations"] == row["end_evaluations"]
        assert 0.0 < met["above_kj_mol"] < 10.0
