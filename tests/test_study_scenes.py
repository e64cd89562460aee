"""What scenes leave out: the study finds what is wrong, and its builds without a feature cannot call it."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from conftest import STRUCTURES, load

import protochain as pc
from protochain.analysis.studies import scenes
from protochain.analysis.studies.scenes import energies, runs
from protochain.analysis.studies.scenes.cells import (
    SAME,
    Both,
    Material,
    Scene,
    calls_of,
    difference,
    run_scene,
)
from protochain.analysis.studies.scenes.features import FEATURES, costs, without
from protochain.cli import app
from protochain.dynamics import System, chain_potential, loop
from protochain.dynamics.closure import closure_of
from protochain.dynamics.settings import THERMOSTATS
from protochain.dynamics.thermostats import Isolated, Langevin, NoseHoover
from protochain.minimisers.problem import evaluate
from protochain.minimisers.restraints import Tethers
from protochain.minimisers.spaces import Torsions
from protochain.motion.leapfrog import Leapfrog


@pytest.fixture(scope="module")
def trp_cage():
    return Material(load("1l2y.pdb"), STRUCTURES / "1l2y.pdb")


def edits_of(name):
    (feature,) = (each for each in FEATURES if each.name == name and "kernels" not in each.of)
    return without(feature.where, feature.edits)


def two(everything, less, **given):
    return Scene("sums", "all", lambda m: Both(everything, less, [1.0, 2.0], lambda x: (x,), **given))


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
        Scene("waters", "all", lambda m: None),
        Scene("long", "all", fails, False),
    )
    monkeypatch.setattr(energies, "SCENES", table)
    monkeypatch.setattr(runs, "SCENES", ())
    monkeypatch.setattr(scenes, "costs", lambda *_: [])
    monkeypatch.setattr(scenes, "SHORT", "AG<"[:2])
    monkeypatch.setattr(scenes, "_SECONDS", (0.0, 0.0))
    assert app(["bench", "scenes", "--quick", "-o", str(tmp_path)], standalone_mode=False) == 1
    found = pd.read_csv(tmp_path / "scenes.csv", keep_default_na=False)
    assert found["verdict"].tolist() == ["right", "right"] + ["wrong"] * 5
    assert found["proof"].tolist()[:2] == ["bits", "1e-12 at 2 points"]
    page = (tmp_path / "report.html").read_text()
    assert page.count('<td class="wrong">') == 5 and "out of &lt;order&gt;" in page and "<order>" not in page
    assert (tmp_path / "scenes.png").stat().st_size > 5000


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
    assert calls_of("protochain.multibody", lambda: pc.pose(c, c.q0).x) == 1
    assert calls_of("protochain.multibody", lambda: pc.pull_back(c, pc.pose(c, c.q0), x)) == 2
    assert calls_of("protochain.multibody", lambda: 1) == 0


@pytest.mark.parametrize("scene", energies.SCENES, ids=lambda scene: scene.name)
def test_energies_without_what_is_not_needed_are_the_same(scene, trp_cage):
    row = run_scene(scene, trp_cage, 0.0)
    if scene.name.startswith("kept"):
        assert row is None
        return
    assert row.verdict == "right" and row.error <= row.bound == SAME, row.message
    counted = [row.terms, row.pairs, row.bodies, row.sweeps, row.lists]
    assert min(counted) >= 0 and max(counted) > 0


def test_kept_waters_are_left_out_among_themselves():
    row = run_scene(energies.SCENES[-1], Material(load("4pti.pdb"), STRUCTURES / "4pti.pdb"), 0.0)
    assert row.verdict == "right" and row.message.startswith("180 atoms of waters")


@pytest.mark.parametrize("scene", runs.SCENES[:4], ids=lambda scene: scene.name)
def test_runs_without_what_is_not_needed_are_the_same(scene, trp_cage):
    row = run_scene(scene, trp_cage, 0.0)
    assert row.verdict == "right" and row.error <= SAME, row.message
    if scene.name == "no velocities":
        assert row.sweeps == 2 and row.error == 0.0


def test_disulfides_are_the_loops_of_the_scene():
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


@pytest.mark.parametrize("feature", FEATURES, ids=lambda f: f"{f.name} {f.of}")
def test_every_text_that_a_build_leaves_out_is_there(feature):
    with pytest.raises(pc.ProtochainError, match=r"has no longer 'not there': edit features\.py"):
        without(feature.where, (*feature.edits, ("not there", "")))


def test_without_features_the_answers_are_the_same_to_the_bit(trp_cage):
    # Kernels take seconds to compile: the slow test has them.
    in_python = [each for each in FEATURES if "kernels" not in each.of]
    found = list(costs(trp_cage, 0.0, in_python))
    assert len(found) >= 4 and {row.verdict for row in found} == {"right"}, found
    assert all(row.here_ms > 0 and np.isfinite(row.percent) for row in found)


def test_a_build_without_springs_does_not_call_them(trp_cage):
    s, whole = trp_cage.structure, trp_cage.energy("vacuum")
    c = pc.build_chain(s)
    tethers = Tethers(s.positions + 0.01, np.full(s.n_atoms, 100.0))
    space = Torsions(c)
    plain, held = evaluate(space, whole, c.q0), evaluate(space, whole, c.q0, tethers)
    found = edits_of("springs")["evaluate"](space, whole, c.q0, tethers)
    assert held.energy > plain.energy + 1.0 and found.energy == plain.energy
    assert np.array_equal(found.torque, plain.torque)


def test_a_build_without_thermostat_keeps_the_energy(trp_cage):
    of = runs.propagator(trp_cage, Isolated())
    start = runs.begun(of, runs.calm(trp_cage))
    heated = replace(of, thermostat=Langevin(of.thermal_energy, 50.0))
    plain, found = loop.advance(of, start), edits_of("thermostat")["advance"](heated, start)
    assert np.array_equal(found.at.qd, plain.at.qd)
    assert not np.array_equal(loop.advance(heated, start).at.qd, plain.at.qd)


def test_a_build_without_closures_opens_loops():
    s = load("3i40.pdb")
    c, own = pc.build_chain(s, root="free"), pc.energy(s, solvent="vacuum", engine="native", threads=1)
    closure = closure_of(c)
    opened, closed = (System(c.tree, chain_potential(c, own), each) for each in (None, closure))
    start = opened.at(c.q0, np.random.default_rng(1).normal(scale=0.1, size=c.n_v))
    method, edited = Leapfrog(), edits_of("closures")["Leapfrog"]()
    free, found = method.step(opened, start, 1e-4), edited.step(closed, start, 1e-4)
    assert np.array_equal(free.q, found.q)
    assert not np.array_equal(method.step(closed, start, 1e-4).q, found.q)


@pytest.mark.parametrize("name", THERMOSTATS)
def test_thermostats_that_draw_nothing_need_no_random_numbers(name, trp_cage):
    assert {Isolated.draws, NoseHoover.draws} == {False}
    kind = THERMOSTATS[name]
    fields = {"thermal_energy": 2.5, "freedoms": 60, "friction": 1.0, "trajectory_length": 1}
    made = kind(**{key: value for key, value in fields.items() if key in kind.__dataclass_fields__})
    of = runs.propagator(trp_cage, Isolated())
    at = runs.begun(of, runs.calm(trp_cage)).at
    begin = made.init(at)
    if made.draws:
        with pytest.raises(AttributeError):
            made.apply(of.system, at, begin, 0.001, None)
    else:
        made.apply(of.system, at, begin, 0.001, None)


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


def test_ten_chains_are_ten_molecules():
    s = runs.several("AAA", 10)
    alpha = s.positions[s.alpha_carbons].reshape(10, 3, 3)
    apart = np.diff(alpha, axis=0)
    assert np.allclose(apart, [0.0, 2.0, 0.0], atol=1e-9)


@pytest.mark.slow
def test_the_quick_part_of_the_study_is_right(tmp_path):
    asked = ["bench", "scenes", str(STRUCTURES / "4pti.pdb"), "--quick", "-o", str(tmp_path)]
    assert app(asked, standalone_mode=False) == 0
    found = pd.read_csv(tmp_path / "scenes.csv")
    assert len(found) >= 14 and (found["verdict"] == "right").all()
    assert found.set_index("scene")["imports"]["protochain minimise"] > 500
    assert len(pd.read_csv(tmp_path / "features.csv")) == sum(each.in_quick for each in FEATURES)
