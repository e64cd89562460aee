"""Verdicts word for word; judgements by hand."""

from threading import current_thread, main_thread
from types import SimpleNamespace

import numpy as np
import pytest
from fixtures.samples import chain, load

import protochain as pc
from protochain.chain import pose, pull_back
from protochain.contacts import overlaps
from protochain.minimisers.loop import Stop
from protochain.minimisers.verdict import ALL_PAIRS, Status, judge, judge_of, rebuilt, verdict

MESSAGES = {
    Stop.TOLERANCE: ("stalled", "stalled: the tolerance was met only above the lowest energy: so far"),
    Stop.NO_DESCENT: ("stalled", "stalled: no step lowers the energy any further: so far"),
    Stop.CIRCLING: ("stalled", "stalled: the energy has found no new low for a long time: so far"),
    Stop.BUDGET: ("budget", "budget: 7 evaluations used: so far"),
    Stop.NON_FINITE: (
        "non-finite",
        "non-finite: the energy or a torque is not a number; the last structure before it is kept: so far",
    ),
    Stop.STRAINED: (
        "stalled",
        "stalled: bonds, angles and contacts are strained beyond what turning bonds can relieve without "
        "unfolding the chain; relax moves all atoms and keeps the fold: so far",
    ),
    Stop.SADDLE: ("stalled", "stalled: the energy falls on both sides of where the torques vanish: so far"),
    Stop.INTERRUPTED: ("interrupted", "interrupted after 7 evaluations: so far"),
}


@pytest.mark.parametrize("stop", Stop)
def test_a_verdict_is_of_the_reason_and_of_what_the_judge_measured(stop):
    s = load("ala10.pdb")
    assert verdict(stop, False, "so far", s, s.positions, 7) == MESSAGES[stop]
    met = (Status.CONVERGED, "converged: so far")
    if stop is Stop.SADDLE:
        met = (Status.SADDLE, "saddle: the energy falls on both sides of where the torques vanish: so far")
    assert verdict(stop, True, "so far", s, s.positions, 7) == met


@pytest.mark.parametrize("met", [True, False])
@pytest.mark.parametrize("stop", Stop)
def test_an_overlap_is_a_clash_whatever_else(stop, met):
    s = load("ala10.pdb")
    x = s.positions.copy()
    x[-1] = x[0] + [0.03, 0.0, 0.0]
    worst, *others = overlaps(s, x)
    expected = "clash", f"clash: {worst}, and {len(others)} more; so far"
    assert others
    interrupted = MESSAGES[Stop.INTERRUPTED]
    assert verdict(stop, met, "so far", s, x, 7) == (interrupted if stop is Stop.INTERRUPTED else expected)


def test_a_judgement_is_of_the_reference_with_restraints_in_the_residuals_only():
    c = chain("ala10.pdb")
    rng = np.random.default_rng(0)
    forces, pull = rng.normal(size=(2, c.structure.n_atoms, 3))
    asked = []

    def reference(x):
        asked.append((x, current_thread() is main_thread()))
        return -5.0, forces

    at = pose(c, c.q0)
    energy = SimpleNamespace(reference=reference, engine="native")
    for restraint, total in ((None, forces), (lambda x: (3.0, pull), forces + pull)):
        found = judge(c, energy, at, restraint)
        assert found.energy == -5.0
        assert found.rms_force == pytest.approx(np.sqrt(np.mean(total**2)), rel=1e-12)
        assert found.max_torque == pytest.approx(np.abs(pull_back(c, at, total)).max(), rel=1e-12)
    assert judge(c, SimpleNamespace(reference=reference, engine="custom"), at).energy == -5.0
    # On a thread of its own, so that an interrupt is heard; callables may not like that.
    assert [on_main for _, on_main in asked] == [False, False, True] and all(x is at.x for x, _ in asked)


def test_the_judge_is_named():
    assert judge_of(SimpleNamespace(engine="custom")) == "the callable itself"
    reference, sums = SimpleNamespace(engine="openmm"), SimpleNamespace(engine="native")
    small = SimpleNamespace(engine="native", reference=reference)
    assert judge_of(small) == "OpenMM's Reference platform, in double precision"
    assert judge_of(SimpleNamespace(engine="native", reference=sums)) == ALL_PAIRS


def test_a_chain_rebuilt_elsewhere_has_the_same_hinges_root_and_selection():
    c = pc.build_chain(load("ala10.pdb"), "phi psi", "free")
    assert c.root == "free"
    x = 1.01 * c.structure.positions
    moved = rebuilt(c, x)
    assert np.array_equal(moved.structure.positions, x)
    assert (moved.opened, moved.root, moved.move, moved.n_v) == (c.opened, c.root, c.move, c.n_v)
    part = pc.build_chain(load("ala10.pdb"), move="resid 3:6")
    assert (rebuilt(part, x).move, rebuilt(part, x).n_v) == ("resid 3:6", part.n_v)
