"""What runs leave out: the study finds what is wrong."""

import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from fixtures.samples import STRUCTURES, load

import protochain as pc
from bench.__main__ import main
from bench.studies import omissions
from bench.studies.omissions import energies, runs
from bench.studies.omissions.cells import (
    SAME,
    Both,
    Material,
    Omission,
    calls_of,
    difference,
    run_omission,
)
from bench.studies.stability.energies import copies
from protochain.dynamics.loop import noise
from protochain.dynamics.thermostats import THERMOSTATS, Isolated


@pytest.fixture(scope="module")
def trp_cage():
    return Material(load("1l2y.pdb"), STRUCTURES / "1l2y.pdb")


def two(everything, less, **given):
    return Omission("sums", "all", lambda m: Both(everything, less, [1.0, 2.0], lambda x: (x,), **given))


def test_an_answer_that_differs_is_wrong_and_fails_the_command(tmp_path, monkeypatch):
    def fails(x):
        raise RuntimeError("out of <order>")

    table = (
        two(lambda x: (x,), lambda x: (x,)),
        two(lambda x: (x,), lambda x: (x * (1 + 0.5 * SAME),)),
        two(lambda x: (x,), lambda x: (x if x == 1.0 else x * (1 + 3 * SAME),)),
        two(lambda x: (x,), lambda x: (np.nan,)),
        two(lambda x: (np.nan if x == 2.0 else x,), lambda x: (x,)),
        two(lambda x: (x,), lambda x: (np.array([x, x]),)),
        two(lambda x: (x,), fails),
        Omission("waters", "all", lambda m: None),
        Omission("long", "all", fails, False),
    )
    monkeypatch.setattr(energies, "OMISSIONS", table)
    monkeypatch.setattr(runs, "OMISSIONS", ())
    monkeypatch.setattr(omissions, "SHORT", "AG<"[:2])
    monkeypatch.setattr(omissions, "_SECONDS", (0.0, 0.0))
    assert main(["omissions", "--quick", "-o", str(tmp_path)]) == 1
    found = pd.read_csv(tmp_path / "omissions.csv", keep_default_na=False)
    assert found["verdict"].tolist() == ["right", "right"] + ["wrong"] * 5
    assert found["proof"].tolist()[:2] == ["bits", "1e-12 at 2 points"]
    page = (tmp_path / "report.html").read_text()
    assert page.count('<td class="wrong">') == 5 and "out of &lt;order&gt;" in page and "<order>" not in page
    assert (tmp_path / "omissions.png").stat().st_size > 5000


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


def test_kept_waters_are_left_out_among_themselves():
    row = run_omission(energies.OMISSIONS[-1], Material(load("4pti.pdb"), STRUCTURES / "4pti.pdb"), 0.0)
    assert row.verdict == "right" and row.message.startswith("180 atoms of waters")


@pytest.mark.parametrize("omission", runs.OMISSIONS[:4], ids=lambda each: each.name)
def test_runs_without_what_is_not_needed_are_the_same(omission, trp_cage):
    row = run_omission(omission, trp_cage, 0.0)
    assert row.verdict == "right" and row.error <= SAME, row.message
    if omission.name == "no velocities":
        assert row.more["sweeps"] == 2 and row.error == 0.0


def test_disulfides_are_the_loops_that_are_closed():
    both = runs.loops(Material(load("4pti.pdb")))
    assert both.what.endswith("for 9 constraints")


def test_counts_of_a_region_are_those_of_its_blocks(trp_cage):
    s = trp_cage.structure
    moving = pc.build_chain(s, move="resid 3").moving
    less = trp_cage.energy("vacuum").without_constants(np.where(moving, -1, 0)[:, None], s.positions)
    still = [not moving[k : k + 32].any() for k in range(0, s.n_atoms, 32)]
    tiles = sum(not (a and b) for i, a in enumerate(still) for b in still[i:])
    listed = len(less._lists.free)
    assert less.visited["pairs"] == 32 * 32 * tiles + listed
    whole = trp_cage.energy("obc2")
    n = -(-s.n_atoms // 32)
    whole(s.positions)
    lists = whole._lists
    expected = 3 * 32 * 32 * n * (n + 1) // 2 + len(lists.free) + 2 * len(lists.close)
    assert whole.visited["pairs"] == expected and whole.visited["lists"] == len(lists.close)


@pytest.mark.parametrize("name", THERMOSTATS)
def test_a_generator_is_made_for_steps_that_draw_alone(name, trp_cage):
    kind = THERMOSTATS[name]
    fields = {"thermal_energy": 2.5, "freedoms": 60, "friction": 1.0, "trajectory_length": 2}
    made = kind(**{key: value for key, value in fields.items() if key in kind.__dataclass_fields__})
    of = runs.propagator(trp_cage, Isolated())
    at = runs.begun(of, runs.calm(trp_cage)).at
    begin = made.init(at)
    asked = []
    for _ in range(4):  # Two trajectories.
        at, begin = made.apply(of.system, at, begin, 0.001, lambda: asked.append(1) or noise(0, 1))
    drawn = {"none": 0, "nose-hoover": 0, "hmc": 2}
    assert len(asked) == drawn.get(name, 4)


def test_minimise_imports_nothing_of_plots_tables_pages_and_trajectories(tmp_path):
    code = (
        "import sys; from protochain.cli import app; sys.stdout = sys.stderr;"
        f"app(['minimise', {str(STRUCTURES / 'ala10.pdb')!r}, '-o', {str(tmp_path / 'out.pdb')!r}],"
        " standalone_mode=False); print(*sys.modules, file=sys.__stdout__)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    loaded = {name.split(".")[0] for name in done.stdout.split()}
    assert (tmp_path / "out.pdb").exists() and {"numba", "openmm", "gemmi"} <= loaded, done.stderr
    unneeded = {"matplotlib", "pandas", "jinja2", "mdtraj", "MDAnalysis", "dask", "distributed", "Bio"}
    assert not loaded & unneeded


@pytest.mark.parametrize("apart", [(0.0, 2.0, 0.5), (0.02, 0.0, 0.0)])
def test_ten_chains_are_ten_molecules_side_by_side_or_one_upon_another(apart):
    s = copies(pc.from_sequence("AAA"), 10, apart)
    alpha = s.positions[s.alpha_carbons].reshape(10, 3, 3)
    assert s.n_chains == 10 and np.allclose(np.diff(alpha, axis=0), apart, atol=1e-9)


@pytest.mark.slow
def test_the_quick_part_of_the_study_is_right(tmp_path):
    asked = ["omissions", str(STRUCTURES / "4pti.pdb"), "--quick", "-o", str(tmp_path)]
    assert main(asked) == 0
    found = pd.read_csv(tmp_path / "omissions.csv")
    assert len(found) >= 14 and (found["verdict"] == "right").all()
    assert found.set_index("scene")["imports"]["protochain minimise"] > 500
