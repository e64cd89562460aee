"""``minimise``: what its settings become, what a checkpoint compares, how an outcome is judged."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from fixtures.samples import chain
from fixtures.told_energy import FORCES, told

import protochain as pc
from protochain.chains.chain import pose
from protochain.chains.frame import Frame
from protochain.minimisers import RECIPES, Status, minimise_structure
from protochain.minimisers.loop import Stop
from protochain.minimisers.minimise_structure import Minimisation
from protochain.minimisers.restraints import Hold
from protochain.minimisers.spaces import spaces
from protochain.minimisers.stages import Outcome
from protochain.minimisers.start import Start

LBFGS = RECIPES["lbfgs"]


@pytest.mark.parametrize(
    ("recipe", "settings", "said"),
    [
        ("lbfgs", {"tolerance": 0.0}, "tolerance 0: give a number above 0, at most 1e6"),
        ("lbfgs", {"tolerance": 1e308}, "tolerance 1e+308: give a number above 0, at most 1e6"),
        ("lbfgs", {"max_evaluations": 0}, "max_evaluations 0: give at least 1"),
        ("lbfgs", {"seed": -1}, "seed -1: give 0 or more"),
        ("openmm", {"restraints": 1.0},
     "method 'openmm' cannot be restrained to its start; choose cartesian or hybrid"),
        ("openmm", {"checkpoint": "run.npz"},
           "method 'openmm' has no state to resume from; choose another, or no checkpoint"),
        ("openmm", {"resume": "run.npz"},
           "method 'openmm' has no state to resume from; choose another, or no checkpoint"),
    ],
)  # fmt: skip
def test_settings_that_make_no_sense_are_refused(recipe, settings, said):
    with pytest.raises(pc.ProtochainError) as refusal:
        Minimisation(RECIPES[recipe], **settings)
    assert str(refusal.value) == said


def test_a_checkpoint_belongs_to_a_method_its_settings_and_its_start():
    c = chain("ala10.pdb")
    run = Minimisation(
        LBFGS, tolerance=2.0, max_evaluations=7, seed=3, restraints=(5.0, 0.0), max_rmsd=0.75, checkpoint="a"
    )
    assert run.settings(Start(c, told())) == {
        "method": "lbfgs", "tolerance": 2.0, "restraint": [5.0, 0.0], "max_rmsd": 0.75,
        "hinges": "phi psi chi", "root": "auto", "move": "all", "seed": 3, "curvature": True,
        "engine": "native", "device": "cpu", "double_precision": True, "accuracy": 0.001,
        "hydrogen_mass": c.hydrogen_mass, "system": "abc", "start": c.structure.positions_fingerprint,
    }  # fmt: skip


ROWS = (0, 4)
"""Rows of the trace with recorded positions."""


def judged(done, energy=None, held="", **settings):
    c = chain("ala10.pdb")
    frame = Frame(c.structure, held)
    recorded = {"rows": [{"evaluations": 3}], "alphas": [c.structure.positions[c.structure.alpha_carbons]]}
    moved = {row: c.structure.positions + row for row in ROWS}
    record = SimpleNamespace(structure=c.structure, **recorded, frame=frame, recorded_frames=lambda: moved)
    return minimise_structure._judge(
        Start(c, energy or told()), Minimisation(LBFGS, **settings), done, record, 1.5
    )


def test_an_outcome_in_torsions_is_judged_by_its_largest_torque():
    c = chain("ala10.pdb")
    torsions, _ = spaces(c)
    q = c.q0.copy()
    q[0] += 0.01
    done = Outcome(Stop.NO_DESCENT, torsions, q, 11, 12)
    found = judged(done, tolerance=1e-3, seed=4)
    at = pose(c, q)
    # In its frame: superposed on the start, or, where something holds the run, as it is.
    assert np.array_equal(found.q, q) and np.array_equal(found.x, Frame(c.structure)(at.x))
    assert found.ca_rmsd_as_filed_angstrom == pytest.approx(found.ca_rmsd_angstrom, abs=1e-9)
    held = judged(done, held="a restraint")
    assert np.array_equal(held.x, at.x) and str(held.frame) == "held by a restraint"
    assert held.ca_rmsd_angstrom == pytest.approx(found.ca_rmsd_angstrom, abs=1e-9)
    assert held.ca_rmsd_as_filed_angstrom > found.ca_rmsd_as_filed_angstrom + 1e-3
    assert found.frame_rows.tolist() == [*ROWS]
    # Both frames are the start, moved as a whole, and superposed on it when they are read.
    assert found.frames.dtype == np.float32
    assert found.frames == pytest.approx(np.array([c.structure.positions] * 2), abs=1e-5)
    assert held.frames[1] == pytest.approx(c.structure.positions + ROWS[1], abs=1e-5)
    size = torsions.residual(torsions.torque(at, FORCES))
    assert found.end.max_torque == size and found.status == Status.STALLED
    assert found.message == (
        "stalled: no step lowers the energy any further: "
        f"largest torque {size:.4g} kJ/mol/rad for a tolerance of 0.001, in double precision"
    )
    assert (found.n_iterations, found.n_evaluations, found.seconds) == (11, 12, 1.5)
    assert found.trace["evaluations"].tolist() == [3] and found.trace["ca_rmsd_angstrom"].max() < 1e-6
    assert (found.energy, found.end.energy, found.tolerance, found.seed) == (-10.0, -5.0, 1e-3, 4)
    assert found.constant_terms == {"angles": 2} and found.hold == Hold() and found.recipe is LBFGS
    assert 0.0 < found.ca_rmsd_angstrom < 1.0 and found.chain is c


def test_an_outcome_meets_the_tolerance_exactly_or_not():
    c = chain("ala10.pdb")
    torsions, _ = spaces(c)
    size = torsions.residual(torsions.torque(pose(c, c.q0), FORCES))
    done = Outcome(Stop.BUDGET, torsions, c.q0, 1, 2)
    assert judged(done, tolerance=size).status == Status.CONVERGED
    assert judged(done, tolerance=0.999 * size).status == Status.BUDGET
    # What left stages out has not converged.
    assert judged(replace(done, complete=False), tolerance=size).status == Status.BUDGET


def test_an_outcome_of_all_atoms_is_judged_by_its_rms_force_and_rebuilt():
    c = chain("ala10.pdb")
    _, atoms = spaces(c)
    x = 1.002 * c.structure.positions
    found = judged(
        Outcome(Stop.BUDGET, atoms, atoms.start(x), 1, 2), told("custom"), "springs", tolerance=0.5
    )
    size = np.sqrt(np.mean(FORCES**2))
    assert found.end.rms_force == pytest.approx(size) and found.x == pytest.approx(x, abs=1e-12)
    assert found.message == (
        f"budget: 2 evaluations used: RMS force {size:.4g} kJ/mol/nm for a tolerance of 0.5, "
        "evaluated by the callable itself"
    )


@pytest.mark.parametrize(("end", "taken"), [(-4.0, True), (-5.0, True), (-3.9, True), (np.nan, False)])
def test_an_end_above_the_start_gives_way_to_it(end, taken):
    c = chain("ala10.pdb")
    start = c.structure.positions

    def height(x):
        return -3.95 if np.allclose(x, start, atol=1e-9) else end

    q = c.q0.copy()
    q[0] += 0.01
    found = judged(Outcome(Stop.BUDGET, spaces(c)[0], q, 1, 2), told(height=height))
    taken = taken and end <= -3.95
    assert np.array_equal(found.q, q if taken else c.q0) and found.end.energy == (end if taken else -3.95)
    # The start lies on itself: superposing it would change last digits.
    x = Frame(c.structure)(pose(c, q).x) if taken else c.structure.positions
    assert np.array_equal(found.x, x) and (found.ca_rmsd_angstrom < 1e-9) is not taken


def test_restraints_are_judged_and_said():
    c = chain("ala10.pdb")
    torsions, _ = spaces(c)
    done = Outcome(Stop.BUDGET, torsions, c.q0, 1, 2, restraint=lambda x: (7.0, -FORCES))
    found = judged(done)
    assert found.end.max_torque == 0.0 and found.status == Status.CONVERGED and found.end.energy == -5.0
    assert found.message == (
        "converged: largest torque 0 kJ/mol/rad for a tolerance of 1, restraints included, "
        "in double precision; curvature not examined"
    )
    done = replace(done, lowest_eigenvalue=-0.25)
    found = judged(done)
    assert found.message.endswith(
        "in double precision; lowest eigenvalue of the Hessian -0.25 kJ/mol/rad^2, "
        "negative: a smaller tolerance leads lower"
    )
    assert found.lowest_eigenvalue == -0.25 and found.status == Status.CONVERGED
    # Where the end is no better than the start, that is the result, and its curvature is not known.
    turned = replace(done, q=c.q0 + 0.01)
    start = c.structure.positions
    found = judged(turned, told(height=lambda x: -5.0 if np.array_equal(x, start) else -4.0))
    assert found.lowest_eigenvalue is None
