"""What runs leave out: the study finds what is wrong."""

import numpy as np
import pandas as pd
import pytest
from fixtures.samples import STRUCTURES, load

import protochain as pc
from bench.__main__ import main
from bench.studies.omissions import energies, runs
from bench.studies.omissions.cells import SAME, Material, calls_of, difference, run_omission


@pytest.fixture(scope="module")
def trp_cage():
    return Material(load("1l2y.pdb"), STRUCTURES / "1l2y.pdb")


def test_differences_are_relative_to_the_size_of_each_part():
    a, b = (1.0, np.array([3.0, 4.0])), (1.0 + 1e-6, np.array([3.0, 4.0 - 1e-3]))
    assert difference(a, b, (10.0, 5.0)) == pytest.approx(2e-4, rel=1e-9)
    assert difference(a, b, (1e-3, 5.0)) == pytest.approx(1e-3, rel=1e-6)
    with pytest.raises(pc.ProtochainError, match="different shapes"):
        difference(a, (1.0,), (1.0, 1.0))


def test_calls_into_a_package_are_counted_from_outside_it():
    c = pc.build_chain(load("ala10.pdb"))
    x = pc.pose(c, c.q0).x
    pc.pull_back(c, pc.pose(c, c.q0), x)
    # What these call in their package does not count, and what they keep was made before.
    assert calls_of("protochain.mechanics.multibody", lambda: pc.pose(c, c.q0).x) == 1
    assert calls_of("protochain.mechanics.multibody", lambda: pc.pull_back(c, pc.pose(c, c.q0), x)) == 2
    assert calls_of("protochain.mechanics.multibody", lambda: 1) == 0


@pytest.mark.parametrize("omission", energies.OMISSIONS, ids=lambda each: each.name)
def test_energies_without_what_is_not_needed_are_the_same(omission, trp_cage):
    row = run_omission(omission, trp_cage, 0.0)
    if omission.name.startswith("kept"):
        assert row is None
        return
    assert row.verdict == "right" and row.error <= row.bound == SAME, row.message
    counted = [row.more[name] for name in ("terms", "pairs", "bodies", "sweeps", "lists")]
    assert min(counted) >= 0 and max(counted) > 0


@pytest.mark.parametrize("omission", runs.OMISSIONS[:4], ids=lambda each: each.name)
def test_runs_without_what_is_not_needed_are_the_same(omission, trp_cage):
    row = run_omission(omission, trp_cage, 0.0)
    assert row.verdict == "right" and row.error <= SAME, row.message
    if omission.name == "no velocities":
        assert row.more["sweeps"] == 2 and row.error == 0.0


@pytest.mark.slow
def test_the_quick_part_of_the_study_is_right(tmp_path):
    asked = ["omissions", str(STRUCTURES / "4pti.pdb"), "--quick", "-o", str(tmp_path)]
    assert main(asked) == 0
    found = pd.read_csv(tmp_path / "omissions.csv")
    assert len(found) >= 14 and (found["verdict"] == "right").all()
    assert found.set_index("scene")["imports"]["protochain minimise"] > 500
