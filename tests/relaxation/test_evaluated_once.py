"""A relaxation evaluates its start and its end once, and judges by what it found there."""

from itertools import pairwise

import numpy as np
import pytest
from fixtures.samples import STRUCTURES

import protochain as pc
from protochain.energies.native.evaluation import Evaluation
from protochain.relaxation.relax_settings import RelaxSettings
from protochain.relaxation.relax_structure import relax_structure


def test_radii_of_the_last_point_are_those_computed_anew():
    structure = pc.load(STRUCTURES / "ala10.pdb")
    energy, other = pc.energy(structure), pc.energy(structure)
    x = structure.positions
    energy(x)
    away = x + 0.01
    other(away)
    for at in (x, away, x):
        np.testing.assert_array_equal(energy.born_radii(at), other.born_radii(at))


def test_a_call_that_did_not_end_has_been_nowhere(monkeypatch):
    structure = pc.load(STRUCTURES / "ala10.pdb")
    energy, x = pc.energy(structure), structure.positions
    energy(x)
    evaluation = energy._evaluation
    assert evaluation.was_at(x) and not evaluation.was_at(x + 0.01)
    # Helpers, of other energies too, look for work a little longer.
    monkeypatch.setattr("protochain.energies.native.evaluation.work", lambda leads, *_: leads and 1 / 0)
    with pytest.raises(ZeroDivisionError):
        energy(x)
    assert not evaluation.was_at(x)


def test_a_relaxation_evaluates_no_point_twice_in_a_row(monkeypatch):
    seen = []
    evaluate = Evaluation.__call__

    def counted(evaluation, x):
        seen.append((evaluation.workspace, x.copy()))
        return evaluate(evaluation, x)

    structure = pc.load(STRUCTURES / "1l2y.pdb")
    energy = pc.energy(structure)
    monkeypatch.setattr(Evaluation, "__call__", counted)
    done = relax_structure(structure, energy, RelaxSettings())
    assert len(seen) == done.rounds[0].evaluations
    done.record()  # Terms: the radii at the end are there, those at the start are not.
    assert len(seen) == done.rounds[0].evaluations + 1
    for (_, one), (_, two) in pairwise(seen):
        assert not np.array_equal(one, two)


def test_what_judges_sums_all_pairs():
    given = {"accuracy": 1e-2, "solvent": "vacuum"}
    done = pc.relax(STRUCTURES / "1ake.pdb.gz", max_iterations=3, max_outer_iterations=1, **given)
    energy = done.energy_function
    assert energy.opening is not None
    exact = pc.energy(done.start, solvent=energy.solvent, accuracy="exact")
    for x, told in ((done.start.positions, done.energy_start), (done.structure.positions, done.energy_end)):
        assert told == pytest.approx(exact(x)[0], rel=1e-12)
        assert told != pytest.approx(energy(x)[0], rel=1e-9)
    assert len(energy.errors) == 2 and "at last by" in energy.reason
