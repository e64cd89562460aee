"""Methods, restraints and energies from outside the package: the guide's own lines, and what they promise."""

import sys
from dataclasses import dataclass

import numpy as np
import pytest
from fixtures.refusals import expect_refusal
from fixtures.samples import ROOT, chain, energy, load
from fixtures.texts import DOCS, blocks

import protochain as pc
from protochain.batches import BatchSettings
from protochain.minimisers import KCM, Armijo, Descent, Direction, Fixed, Recipe, Run, StrongWolfe

GUIDE = DOCS / "python.md"
OWN = [block for block in blocks(GUIDE, "python") if "class " in block or "def " in block]


@pytest.fixture(scope="module")
def said(tmp_path_factory):
    """What the guide's lines leave behind, run one after the other."""
    names: dict = {"__name__": "__main__"}
    folder = tmp_path_factory.mktemp("guide")
    (folder / "structures").symlink_to(ROOT / "structures")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for block in OWN:
            exec(compile(block, str(GUIDE), "exec"), names)
    return names


def test_each_example_is_short():
    assert len(OWN) == 4
    assert all(len(block.splitlines()) < 40 for block in OWN)


def test_a_direction_from_outside_runs_and_is_compared(said):
    r, k = said["r"], said["k"]
    assert r.method == "OneHinge" and r.keeps_geometry and r.end.energy < r.start.energy - 1.0
    assert r.trace["evaluations"].iloc[-1] <= 200 and "in double precision" in r.message
    assert list(k.table["method"]) == ["OneHinge", "kcm-adaptive", "lbfgs"]
    assert np.array_equal(k.solutions[0].x, r.x)
    turned = r.chain.q0 - said["pc"].minimise(r.chain, energy("ala10.pdb"), said["one_hinge"], 1.0, 2).q
    assert np.count_nonzero(np.abs(turned) > 1e-12) == 1


def test_a_method_from_outside_goes_on_as_if_it_had_not_stopped(said, tmp_path):
    c, e, method = chain("ala10.pdb"), energy("ala10.pdb"), said["Momentum"]()
    file = tmp_path / "run.npz"
    whole = pc.minimise(c, e, method, max_evaluations=60)
    pc.minimise(c, e, method, max_evaluations=25, checkpoint=file)
    rest = pc.minimise(c, e, method, max_evaluations=60, resume=file)
    assert np.array_equal(rest.x, whole.x) and rest.n_evaluations == whole.n_evaluations

    class Nameless:
        init, step = method.init, method.step

    with pytest.raises(pc.ProtochainError, match="has no state"):
        pc.minimise(c, e, Nameless(), checkpoint=file)


def test_any_direction_goes_with_any_rule():
    class Downhill(Direction):
        def propose(self, problem, at, solve, memory):
            yield at.torque / np.abs(at.torque).max() * 0.001, memory

    c, e = chain("ala10.pdb"), energy("ala10.pdb")
    for rule in (Armijo(1.0), StrongWolfe()):
        r = pc.minimise(c, e, Descent(Downhill(), rule), max_evaluations=40)
        assert r.end.energy < r.start.energy


def test_a_restraint_from_outside_counts_in_the_residual_and_not_in_the_energy(said):
    bent, x0 = said["bent"], load("ala10.pdb").positions
    assert bent.status == "converged" and "restraints included" in bent.message
    assert np.linalg.norm(bent.x[-1] - bent.x[0]) < 0.9 * np.linalg.norm(x0[-1] - x0[0])
    assert bent.end.energy == pytest.approx(energy("ala10.pdb").reference(bent.x)[0], abs=1e-6)
    assert bent.record()["restraint_kj_mol_nm2"] == ["__main__.ends_together"]


def test_an_energy_from_outside_is_its_own_judge_and_says_so(said):
    back = said["back"]
    assert back.status == "converged" and "evaluated by the callable itself" in back.message
    assert back.end.energy == pytest.approx(said["elastic_network"](back.x)[0])
    assert back.record()["engine"] == "custom"
    apart = pc.ca_rmsd(back.structure, back.x, load("ala10.pdb").positions)
    assert apart < 0.5 * pc.ca_rmsd(back.structure, said["bent"].x, load("ala10.pdb").positions)
    k = pc.compare(said["perturbed"], ("lbfgs", "kcm-adaptive"), said["elastic_network"], max_evaluations=50)
    assert k.summary()["judge"] == "the callable itself"
    with pytest.raises(pc.ProtochainError, match="OpenMM"):
        pc.minimise(said["perturbed"], said["elastic_network"], "openmm")
    begun = []
    with pytest.raises(pc.ProtochainError, match="OpenMM"):
        pc.compare(said["perturbed"], ("lbfgs", "openmm"), said["elastic_network"], watch=begun.append)
    assert not begun


@pytest.mark.usefixtures("worker_processes")
def test_a_method_goes_by_its_import_path(tmp_path, monkeypatch):
    block = OWN[1].split("\n\npc.minimise")[0]
    (tmp_path / "mymodule.py").write_text(f"import numpy as np\n{block}\n")
    monkeypatch.syspath_prepend(tmp_path)
    c, e = chain("ala10.pdb"), energy("ala10.pdb")
    assert pc.minimise(c, e, "mymodule:Momentum", max_evaluations=10).method == "Momentum"
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    done = pc.batch(
        ROOT / "structures" / "ala10.pdb",
        tmp_path / "out",
        "mymodule:Momentum",
        workers=1,
        max_evaluations=10,
    )
    assert done.table["status"].tolist() == ["budget"]
    assert (tmp_path / "out" / done.table["output"][0]).exists()
    for path, word in (
        ("mymodule:Nothing", "cannot be imported"),
        ("nomodule:x", "cannot be imported"),
        ("x", "not known"),
    ):
        with pytest.raises(pc.ProtochainError, match=word):
            pc.minimise(c, e, path)
    (tmp_path / "another.py").write_text("from mymodule import Momentum\n")
    with pytest.raises(pc.ProtochainError, match="two have one name"):
        BatchSettings(methods=("mymodule:Momentum", "another:Momentum"))
    for name in ("mymodule", "another"):
        sys.modules.pop(name)


def test_methods_of_one_name_are_told_apart_or_refused():
    c, e = chain("ala10.pdb"), energy("ala10.pdb")
    short, long = (Descent(KCM(), Fixed(angle)) for angle in (0.0005, 0.005))
    with pytest.raises(pc.ProtochainError, match="two methods are named 'KCM'"):
        pc.compare(c, (short, long), e, max_evaluations=3)
    named = [Recipe(name, (Run(method),)) for name, method in (("short", short), ("long", long))]
    k = pc.compare(c, (*named, "lbfgs", "lbfgs", named[0]), e, max_evaluations=3)
    assert [s.method for s in k.solutions] == ["short", "long", "lbfgs"]


def test_a_random_method_gets_its_seed_and_is_repeated(said):
    @dataclass(frozen=True)
    class Shaken(said["Momentum"]):
        seed: int = 0

        def init(self, problem, at):
            return said["MomentumState"](
                at, 1e-3 * np.random.default_rng(self.seed).normal(size=at.torque.shape)
            )

    c, e = chain("ala10.pdb"), energy("ala10.pdb")
    k = pc.compare(c, (Shaken(),), e, max_evaluations=10, repeats=2)
    assert k.spread["runs"].tolist() == [2]
    assert not np.array_equal(k.solutions[0].x, k.repeats[0].x)
    assert np.array_equal(k.repeats[0].x, pc.minimise(c, e, Shaken(), max_evaluations=10, seed=1).x)


def test_what_is_no_method_is_refused():
    with pytest.raises(pc.ProtochainError, match="init and step"):
        pc.minimise(chain("ala10.pdb"), energy("ala10.pdb"), 7)
    with pytest.raises(TypeError, match="'restrain'"):
        pc.minimise(chain("ala10.pdb"), energy("ala10.pdb"), restrain=100.0)
    with expect_refusal("restraints", match="1000 100 0"):
        pc.minimise(chain("ala10.pdb"), energy("ala10.pdb"), restraints="strong")
