"""What a run knows of its energy is what the energy would say, bit for bit; and what judges it."""

from itertools import pairwise
from threading import current_thread, main_thread
from types import SimpleNamespace

import numpy as np
import pytest
from fixtures.refusals import expect_refusal
from fixtures.samples import STRUCTURES

import protochain as pc
from protochain.energies.native.evaluation import Evaluation
from protochain.minimisers.judging import CachedEnergy
from protochain.relaxation.relax_settings import RelaxSettings
from protochain.relaxation.relax_structure import relax_structure


class Counting:
    """An energy that counts its calls, with lists that may be made anew."""

    def __init__(self, lists_at):
        self.lists_at, self.calls, self.coarse, self.exact = lists_at, 0, "rough", self

    def list_at(self, x):
        self.lists_at = None if self.lists_at is None else x

    def __call__(self, x):
        self.calls += 1
        return float(x.sum()) + self.calls, x.copy()


def points():
    return [np.full((2, 3), value) for value in (1.0, 2.0, 3.0)]


def test_the_first_and_the_last_point_are_known():
    energy = Counting(np.zeros(3))
    known, (one, two, three) = CachedEnergy(energy), points()
    first, forces = known(one)
    forces[:] = np.nan  # Whoever gets them may change them.
    last = known(two)[0], known(three)[0]
    assert energy.calls == 3
    assert known(one)[0] == first and known(three)[0] == last[1] and energy.calls == 3
    known(one)[1][:] = np.nan
    np.testing.assert_array_equal(known(one)[1], one)
    assert known.coarse == "rough"
    known(two)  # Between these, and forgotten.
    assert energy.calls == 4


def test_nothing_is_known_with_other_lists_or_without_lists():
    energy = Counting(np.zeros(3))
    known, (one, two, _) = CachedEnergy(energy), points()
    first = known(one)[0]
    energy.lists_at = np.zeros(3)
    assert known(one)[0] != first and energy.calls == 2
    assert known.judge_at(one, first=True)[0] == first and energy.calls == 2
    assert known.judge_at(two, first=True)[0] != first and energy.lists_at is two and energy.calls == 3
    without = Counting(None)
    known = CachedEnergy(without)
    known(one), known(one), known.judge_at(one, first=True)
    assert without.calls == 3


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
    monkeypatch.setattr("protochain.energies.native.tasks.work", lambda leads, *_: leads and 1 / 0)
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


def test_a_minimisation_evaluates_its_ends_once(monkeypatch):
    seen = []
    evaluate = Evaluation.__call__
    monkeypatch.setattr(Evaluation, "__call__", lambda self, x: seen.append(x.copy()) or evaluate(self, x))
    done = pc.minimise(STRUCTURES / "1l2y.pdb")
    # The first also warms it up; of the ends the run has the energies.
    assert len(seen) == done.n_evaluations
    np.testing.assert_array_equal(seen[0], done.chain.structure.positions)


def test_judges_have_names_and_threads_of_their_own():
    asked = []

    def judge(engine):
        def at(x):
            asked.append(current_thread() is main_thread())
            return -5.0, np.zeros((2, 3))

        at.engine, at.list_at = engine, lambda x: None
        return at

    for engine, named in (("native", "native"), ("openmm", "OpenMM's Reference"), ("custom", "callable")):
        known = CachedEnergy(SimpleNamespace(exact=judge(engine), reference=judge("openmm")))
        assert named in known.judge and known.judge_at(points()[0])[0] == -5.0
    # So that an interrupt is heard; what judges itself is asked where it is.
    assert asked == [False] * 3
    itself = Counting(None)
    assert CachedEnergy(itself).judge_at(points()[0])[0] == 7.0
    with expect_refusal("judge"):
        pc.minimise(STRUCTURES / "ala10.pdb", judge="me")


@pytest.mark.parametrize(
    ("name", "method", "settings"),
    [
        ("1l2y.pdb", "cartesian", {"forcefield": "amber19", "solvent": "gbn2"}),
        ("5awl.pdb", "hybrid", {"forcefield": "amber99sbildn", "solvent": "obc2"}),
        ("1l2y.pdb", "cartesian", {"engine": "openmm"}),
    ],
)
def test_the_judge_equals_the_reference_platform_and_no_bit_depends_on_threads(name, method, settings):
    s = pc.load(STRUCTURES / name)
    ends = [
        pc.minimise(s, pc.energy(s, threads=n, **settings), method, max_evaluations=12, judge=judge)
        for n, judge in ((1, "auto"), (2, "auto"), (2, "reference"))
    ]
    assert [("native" in r.judge) for r in ends] == [settings.get("engine") is None] * 2 + [False]
    for r in ends:
        assert r.record()["judge"] == r.judge and any(r.judge.upper() in line for line in r.provenance())
        reference = r.energy_function.reference
        for judged, x in ((r.start, s.positions), (r.end, r.x)):
            assert judged.energy == pytest.approx(reference(x)[0], rel=1e-8)
    if "engine" not in settings:
        assert ends[0].end == ends[1].end and ends[0].start == ends[1].start
        assert ends[2].end.rms_force == pytest.approx(ends[1].end.rms_force, rel=1e-6)


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
