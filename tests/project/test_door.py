"""Public calls: arguments are read as users mean them, or refused in one line that names them."""

import copy
import inspect
import pickle
import re
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache, partial

import gemmi
import numpy as np
import pandas as pd
import pytest
from fixtures.samples import STRUCTURES, chain, load, simulation
from fixtures.tolerances import RMSD_ANGSTROM
from openmm import app, unit

import protochain as pc
from protochain.chains.frame import Frame
from protochain.comparison.deviation import deviation
from protochain.energies import NativeEnergy
from protochain.minimisers import KCM, Descent, Fixed
from protochain.minimisers.solution import N_FRAMES, Recorder
from protochain.validation import MEASURES

PHI = pc.Restraint("dihedral", ["phi A:5"], 0, 0, 9.0)
FILE = STRUCTURES / "ala10.pdb"
S, C = partial(load, "ala10.pdb"), partial(chain, "ala10.pdb")


@cache
def vacuum():
    return pc.energy(S(), solvent="vacuum", threads=1)


@cache
def solution():
    return pc.minimise(C(), vacuum(), "lbfgs", max_evaluations=200)


class Odd:
    """No public call knows what to do with it."""

    def __repr__(self):
        return "Odd()"


def at():
    return pc.pose(C(), C().q0)


REQUIRED = {
    "EveryFrame": lambda: (pc.to_mdanalysis(S()),),
    "HingeSpring": lambda: ("omega", 40.0),
    "Pull": lambda: ("A:1:N-A:10:C",),
    "Restraint": lambda: ("distance", ("A:1:CA", "A:9:CA"), 0.0, 5.0),
    "Setup": tuple,
    "as_structure": lambda: (S(),),
    "batch": lambda: ([FILE], "never-written"),
    "build_chain": lambda: (S(),),
    "ca_rmsd": lambda: (S(), S().positions, S().positions),
    "cluster_frames": lambda: (S(), S().positions[None]),
    "compare": lambda: (C(),),
    "deviation": lambda: (S(), S()),
    "differences": lambda: (S(), S()),
    "energy": lambda: (S(),),
    "energy_from": lambda: (pc.to_ase(S(), vacuum()), S()),
    "energy_terms": lambda: (S(),),
    "explore": lambda: (C(), vacuum()),
    "frame_energies": lambda: (S(), S().positions[None]),
    "from_sequence": lambda: ("AA",),
    "from_simulation": lambda: (simulation(FILE.name),),
    "hessian": lambda: (C(), vacuum()),
    "hessian_product": lambda: (C(), vacuum(), C().q0, np.ones(C().n_v)),
    "kcm": tuple,
    "ligand": lambda: ("CCO",),
    "load": lambda: (FILE,),
    "log_det_mass": lambda: (C(), at()),
    "mass_matrix": lambda: (C(), at()),
    "minimise": lambda: (C(), vacuum()),
    "mutate": lambda: (S(), "A:A3G"),
    "normal_modes": lambda: (C(), vacuum()),
    "pose": lambda: (C(), C().q0),
    "pull_back": lambda: (C(), at(), np.zeros((C().n_atoms, 3))),
    "quality": lambda: (S(),),
    "relax": lambda: (S(),),
    "relax_frames": lambda: (S(), S().positions[None]),
    "complex_quality": lambda: (S(), S()),
    "rmsd": lambda: (S(), S()),
    "save": lambda: (S(), "never-written.pdb"),
    "scan_mutations": lambda: (S(), "A:3"),
    "scan": lambda: (C(), vacuum(), {"phi A:3": [-60.0]}),
    "score_interface": lambda: (S(), "resid 1:4", "resid 6:10"),
    "save_ligands": lambda: (S(), "never-written.sdf"),
    "search": lambda: (C(), vacuum()),
    "simulate": lambda: (C(), vacuum()),
    "solve_mass": lambda: (C(), at(), np.zeros(C().n_v)),
    "to_ase": lambda: (S(), vacuum()),
    "unfold": lambda: (S(), vacuum()),
    "to_simulation": lambda: (S(), simulation(FILE.name)),
    "to_mdanalysis": lambda: (S(),),
    "to_mdtraj": lambda: (S(),),
    "touching_chains": lambda: (S(),),
    "umbrella": lambda: (C(), vacuum(), PHI, [-60, -50]),
    "validate": lambda: (S(),),
    "view": lambda: (S(),),
}
"""Arguments with which each public function works, and which are replaced by wrong ones in turn."""
ANYTHING_GOES = {
    ("as_structure", "name"), ("save", "remarks"),
}  # fmt: skip
"""Names that no work depends on."""
FURTHER = {
    "batch": (
        "curvature", "max_evaluations", "tolerance", "max_rmsd", "seed", "workers", "threads", "time_limit",
        "ph", "hinges",
    ),
    "explore": ("tolerance", "max_evaluations", "watch"),
    "compare": ("max_evaluations", "seed", "curvature", "judge"),
    "relax": (
        "protocol",
        "tolerance",
        "stiffness",
        "max_iterations",
        "max_outer_iterations",
        "exclude",
        "keep_hydrogens",
        "repack",
        "repack_region",
        "mirror",
        "rebuild_side_chains",
        "sequence",
        "restraints",
        "interface",
        "threads",
        "ph",
    ),
    "EveryFrame": ("hinges", "ph", "threads", "keep"),
    "relax_frames": ("protocol", "tolerance", "repack", "threads", "ph"),
}  # fmt: skip
"""Names that a function takes by ``**``."""


def arguments():
    for name in REQUIRED:
        parameters = inspect.signature(getattr(pc, name)).parameters.values()
        for each in parameters:
            if each.kind is not each.VAR_KEYWORD and (name, each.name) not in ANYTHING_GOES:
                yield name, each.name
        yield from ((name, more) for more in FURTHER.get(name, ()))


def test_every_public_function_is_tried():
    functions = {name for name in pc.__all__ if inspect.isfunction(getattr(pc, name))}
    assert functions - {"minimize", "progress"} == set(REQUIRED) - {
        "EveryFrame",
        "HingeSpring",
        "Pull",
        "Restraint",
        "Setup",
    }


@pytest.mark.parametrize(("name", "argument"), list(arguments()))
def test_what_makes_no_sense_is_refused_in_one_line_that_names_it(name, argument, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    call = getattr(pc, name)
    given = inspect.signature(call).bind(*REQUIRED[name]())
    for wrong in (Odd(), [Odd()]):
        with pytest.raises(pc.ProtochainError) as refused:
            call(**dict(given.arguments) | {argument: wrong})
        said = str(refused.value)
        assert "\n" not in said and len(said) < 300
        assert argument in said or "Odd" in said, said
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: pc.energy(S(), threads="2"), "threads '2': give a whole number, not a text: threads=2"),
        (lambda: pc.energy(S(), threads=1.5), "threads 1.5: give a whole number"),
        (lambda: pc.load(FILE, ph="7"), "ph '7': give a number, not a text: ph=7"),
        (lambda: pc.minimise(C(), vacuum(), max_evaluations=None), "max_evaluations None: give a"),
        (lambda: pc.minimise(C(), vacuum(), watch=True), "watch True: give a callable of row, x"),
        (lambda: pc.minimise(C(), vacuum(), watch=pc.progress), "watch progress: give a callable of row, x"),
        (lambda: pc.compare(C(), watch=lambda: None), "give a callable of method"),
        (lambda: pc.explore(C(), vacuum(), seed=-1), "seed -1: give 0 or more"),
        (lambda: pc.simulate(C(), vacuum(), pull=("A:1:N", 3)), "pull ('A:1:N', 3): give two atoms, as"),
        (lambda: pc.simulate(C(), vacuum(), hinge_springs=[pc.Setup()]), "give HingeSprings"),
        (lambda: pc.Pull("A:1:N-A:10:C", speed=1 * unit.kelvin), "speed is in kelvin; give it in nanometer"),
        (lambda: pc.simulate(C(), vacuum(), resume="folder"), "resume 'folder': give True or False"),
        (lambda: pc.EveryFrame(FILE), "give an MDAnalysis Universe or AtomGroup"),
        (lambda: pc.pose(S(), C().q0), "give a Chain, for example from pc.build_chain"),
        (lambda: pc.ca_rmsd(S(), load("1l2y.pdb").positions, S()), "x has shape (304, 3), not (103, 3)"),
        (lambda: pc.ca_rmsd(S(), load("1l2y.pdb"), S()), "other atoms than ala10; pc.rmsd matches"),
        (lambda: pc.build_chain(S(), hinges=["phi", "fi"]), "hinges 'fi' is not a kind of hinge"),
        (lambda: vacuum()(np.zeros((103, 3), complex)), "x: give real numbers, not complex ones"),
        (lambda: vacuum()("positions"), "x: give an array of numbers of shape (103, 3)"),
        (lambda: vacuum()(S().positions * unit.kelvin), "x is in kelvin; give it in nanometer"),
    ],
)  # fmt: skip
def test_a_message_says_what_to_give(call, said):
    with pytest.raises(pc.ProtochainError, match=re.escape(said)):
        call()


def test_files_structures_and_results_are_taken_everywhere(tmp_path):
    """A path, a Structure, and what holds one: each call takes any."""
    r = solution()
    by_file = pc.energy(FILE, solvent="vacuum")
    assert by_file.fingerprint == vacuum().fingerprint
    assert pc.minimise(FILE, by_file, "lbfgs", max_evaluations=3).n_evaluations <= 3
    assert np.array_equal(pc.build_chain(str(FILE)).q0, C().q0)
    assert pc.view(C()).shown["ala10"] is S() and list(pc.view(r).shown) == ["start", "lbfgs"]
    assert [*pc.view(str(FILE)).shown] == ["ala10"]
    few = pc.minimise(pc.build_chain(S(), "phi", move="resid 3:8"), by_file, "lbfgs", max_evaluations=5)
    more = pc.minimise(few, by_file, "lbfgs", max_evaluations=5)
    assert (more.chain.opened, more.chain.move) == ("phi", "resid 3:8")
    assert np.array_equal(more.chain.structure.positions, few.x)
    k = pc.compare(few, ("lbfgs", "kcm"), by_file, max_evaluations=2)
    assert list(pc.view(k).shown) == ["start", "lbfgs", "kcm"]
    pc.save(k, tmp_path / "k.pdb")
    assert np.allclose(pc.load(tmp_path / "k.pdb").positions, k.best.x, atol=1e-4)
    assert np.array_equal(pc.as_structure(r).positions, r.x)
    pc.save(r, tmp_path / "r.pdb")
    assert np.allclose(pc.load(tmp_path / "r.pdb").positions, r.x, atol=1e-4)
    assert pc.to_mdtraj(r).xyz.shape == (1, 103, 3) and len(pc.to_mdanalysis(C()).atoms) == 103
    pytest.importorskip("ase")
    assert len(pc.to_ase(FILE)) == 103


def test_words_are_taken_as_a_text_or_as_a_list(tmp_path):
    assert np.array_equal(pc.build_chain(S(), ["phi", "psi"]).q0, pc.build_chain(S(), "phi psi").q0)
    assert pc.build_chain(S(), ("phi", "psi")).opened == pc.build_chain(S(), "phi,psi").opened == "phi psi"
    assert pc.Setup(hinges=["phi", "psi"]) == pc.Setup(hinges="phi psi")
    water = (
        f"HETATM 9998  O   HOH A{n:4d}    {5 + n:8.3f}  20.000  20.000  1.00  0.00           O\n"
        for n in (90, 95)
    )
    text = FILE.read_text().partition("END")[0] + "".join(water) + "END\n"
    (tmp_path / "wet.pdb").write_text(text)
    assert pc.load(tmp_path / "wet.pdb").obstacle.sum() == 0
    for keep in ("water", ("water",), "ions, water", ["water"]):
        assert pc.load(tmp_path / "wet.pdb", keep=keep).obstacle.sum() == 6
        made = gemmi.read_structure(str(tmp_path / "wet.pdb"))
        assert pc.as_structure(made, keep=keep).obstacle.sum() == 6
    assert [s.method for s in pc.compare(C(), "lbfgs,kcm", vacuum(), max_evaluations=2).solutions] == [
        "lbfgs",
        "kcm",
    ]
    own = Descent(KCM(), Fixed(0.001))
    assert [s.method for s in pc.compare(C(), own, vacuum(), max_evaluations=2).solutions] == ["KCM"]
    bpti = STRUCTURES / "4pti.pdb"
    pairs = ([("A:5", "A:55")], ["A:5-A:55"], "A:5-A:55", [["A:5", "A:55"]])
    assert len({pc.load(bpti, disulfide=pair).fingerprint for pair in pairs}) == 1
    for two in ("none, A:5-A:55,A:38-A:14", ["none", ("A:5", "A:55"), "A:14-A:38"]):
        s = pc.load(bpti, disulfide=two)
        bridged = s.bonds[(s.atom_name[s.bonds] == "SG").all(axis=1)]
        numbers = s.residue_number[s.atom_residue[bridged]].astype(int)
        assert sorted(map(sorted, numbers.tolist())) == [[5, 55], [14, 38]]


def test_quantities_are_converted():
    x, s = S().positions, S()
    moved = x.copy()
    moved[s.alpha_carbons[0]] += 0.1
    in_angstrom = moved * 10.0 * unit.angstrom
    assert pc.ca_rmsd(s, in_angstrom, x * unit.nanometer) == pytest.approx(pc.ca_rmsd(s, moved, x), rel=1e-12)
    assert pc.ca_rmsd(s, s.with_positions(moved), s) == pc.ca_rmsd(s, moved, x)
    value = vacuum()(x)[0]
    for engine in (vacuum(), vacuum().reference):
        assert engine(x * 10.0 * unit.angstrom)[0] == pytest.approx(value, rel=1e-9)
    forces = vacuum()(x)[1]
    # kcal/mol/angstrom are 41.84 kJ/mol/nm.
    tau = pc.pull_back(C(), at(), forces / 41.84 * unit.kilocalorie_per_mole / unit.angstrom)
    assert np.allclose(tau, pc.pull_back(C(), at(), forces), rtol=1e-9)
    settings = {"n_steps": 5, "every": 5, "seed": 1}
    plainly = pc.simulate(C(), vacuum(), time_step=0.002, temperature=250.0, friction=5.0, **settings)
    units = pc.simulate(
        C(), vacuum(), time_step=2.0 * unit.femtosecond, temperature=250.0 * unit.kelvin,
        friction=5.0 / unit.picosecond, **settings,
    )  # fmt: skip
    assert np.allclose(units.x, plainly.x, atol=1e-12)
    per_mol = unit.kilocalorie_per_mole
    pull = pc.Pull("A:1:N-A:10:C", 1.0 * per_mol / unit.angstrom**2, 1.0 * unit.angstrom / unit.picosecond)
    assert (pull.stiffness, pull.speed) == (pytest.approx(418.4), pytest.approx(0.1))
    degree = pc.HingeSpring("omega", 1.0 * per_mol / unit.degree**2)
    assert degree.stiffness == pytest.approx(4.184 * np.degrees(1.0) ** 2)
    assert pc.minimise(C(), vacuum(), "lbfgs", max_evaluations=3e0).n_evaluations <= 3
    assert pc.to_mdtraj(s, x[None] * 10.0 * unit.angstrom).xyz == pytest.approx(x[None], rel=1e-6)


CLONES = {
    "pickle": lambda value: pickle.loads(pickle.dumps(value)),
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
}


def same(a, b):
    """Whether two values are equal, field by field, and arrays of the second are as little writable."""
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b) and a.flags.writeable == b.flags.writeable
    if isinstance(a, pd.DataFrame):
        return a.equals(b)
    if isinstance(a, Mapping):
        return dict(a) == dict(b)
    if is_dataclass(a):
        return all(same(getattr(a, each.name), getattr(b, each.name)) for each in fields(a))
    return a == b or isinstance(a, app.Topology | NativeEnergy)


@pytest.mark.parametrize("clone", CLONES.values(), ids=CLONES)
def test_values_can_be_pickled_and_copied(clone):
    r = solution()
    for value in (S(), C(), C().tree, at(), r):
        _ = [getattr(value, name, None) for name in ("fingerprint", "rigid_groups", "bonds", "n_q")]
        again = clone(value)
        assert type(again) is type(value) and same(value, again)
    s = clone(S())
    assert s.fingerprint == S().fingerprint and repr(s) == repr(S())
    with pytest.raises(TypeError):
        s.left_out["x"] = 1
    c = clone(C())
    assert np.array_equal(pc.pose(c, c.q0).x, at().x)
    again = clone(r)
    assert again.record() == r.record() and again.provenance and again.structure.n_atoms == 103
    more = pc.minimise(again.chain, again.energy_function, "lbfgs", max_evaluations=200)
    assert np.array_equal(more.x, r.x)
    assert clone(pc.Setup(keep="water")) == pc.Setup(keep="water")


@pytest.mark.parametrize("clone", [CLONES["pickle"]], ids=["pickle"])
def test_energies_can_be_pickled_and_copied(clone):
    x = S().positions
    whole = vacuum()
    reduced = whole.without_constants(C().rigid_groups, x)
    for e in (whole, reduced, whole.reference, pc.energy(S(), solvent="vacuum", engine="openmm", threads=1)):
        again = clone(e)
        assert again.fingerprint == e.fingerprint and again.reason == e.reason and again.atoms == e.atoms
        assert dict(again.left_out) == dict(e.left_out)
        assert again(x)[0] == pytest.approx(e(x)[0], rel=1e-6)
    m = pc.simulate(C(), whole, n_steps=2, every=1)
    assert np.array_equal(clone(m).x, m.x) and clone(m).record() == m.record()
    starts = pc.explore(C(), whole, "lbfgs", 2, max_evaluations=3)
    assert clone(starts).summary() == starts.summary()


def test_a_pickle_does_not_nest_with_the_number_of_atoms():
    s = load("1hel.pdb")
    assert CLONES["pickle"](s).fingerprint == s.fingerprint


def test_rmsd_and_quality_take_what_users_have():
    r, s = solution(), S()
    assert pc.rmsd(s, r) == pytest.approx(r.ca_rmsd_angstrom, abs=RMSD_ANGSTROM)
    assert pc.rmsd(FILE, r, "name CA C N") == deviation(s, r.structure, "name CA C N", "name CA C N").rmsd
    off = pc.rmsd(FILE, r, "resid 1:5 and name CA", "resid 6:10 and name CA")
    assert off == pc.deviation(s, r, "resid 1:5 and name CA", "resid 6:10 and name CA").rmsd > 0.1
    row = pc.quality(r)
    assert row == pc.quality(r.structure, s, C()) and row["ca_rmsd_to_start_angstrom"] == r.ca_rmsd_angstrom
    alone = pc.quality(r.structure)
    assert alone == {key: row[key] for key in alone} and len(alone) == 3 + len(MEASURES)
    with pytest.raises(pc.ProtochainError, match="other atoms than"):
        pc.quality(s, load("1l2y.pdb"))


def test_a_solution_has_frames_and_the_displacement_of_each_residue():
    r = solution()
    n = len(r.frame_rows)
    assert r.frames.shape == (n, 103, 3) and r.frame_rows[0] == 0 and r.frame_rows[-1] == len(r.trace) - 1
    assert np.allclose(r.frames[0], S().positions, atol=1e-6) and np.allclose(r.frames[-1], r.x, atol=1e-6)
    along = [pc.ca_rmsd(S(), x, S().positions) for x in r.frames]
    assert np.allclose(along, r.trace["ca_rmsd_angstrom"].iloc[r.frame_rows], atol=1e-4)
    assert pc.to_mdtraj(r, r.frames).n_frames == n
    away = r.displacements
    assert away.columns.tolist() == ["chain", "residue", "name", "displacement_angstrom"] and len(away) == 10
    rms = np.sqrt(np.mean(away["displacement_angstrom"] ** 2))
    assert rms == pytest.approx(r.ca_rmsd_angstrom, abs=RMSD_ANGSTROM)


@pytest.mark.parametrize("length", [0, 1, 51, 101])
def test_frames_are_few_evenly_spaced_and_include_the_ends(length):
    record = Recorder(S(), Frame(S(), "a test"))
    for k in range(length):
        record(S().positions + k, 0.0, {}, k)
    rows = list(record.recorded_frames())
    assert len(rows) <= N_FRAMES + 1 and rows == sorted(rows)
    if length:
        assert rows[0] == 0 and rows[-1] == length - 1 and len(set(np.diff(rows[:-1]))) <= 1
        assert len(rows) >= min(length, N_FRAMES // 2)
        assert all(np.allclose(x, S().positions + k) for k, x in record.recorded_frames().items())


def test_figures_are_drawn_where_the_caller_says():
    from matplotlib import pyplot as plt

    k = pc.compare(C(), ("lbfgs", "cartesian"), vacuum(), max_evaluations=30)
    panels = {
        "energy": (1, 2), "torque": (1, 2), "rmsd": (1, 2), "displacement": (1,), "ramachandran": (3,),
        "work_precision": (4,), "differences": (1, 2),
    }  # fmt: skip
    for name, counts in panels.items():
        plot = getattr(k, f"plot_{name}")
        for n in counts:
            figure, axes = plt.subplots(1, n, squeeze=False)
            drawn = plot(ax=axes[0, 0] if n == 1 else axes[0])
            assert drawn is figure and all(ax.has_data() for ax in axes.flat), name
            plt.close(figure)
        alone = plot()
        assert alone is not figure
        titles = [ax.get_title(place) for ax in alone.axes for place in ("left", "center")]
        assert alone.get_suptitle() or any(titles), name
        wrong = plt.subplots(1, 5)[1]
        with pytest.raises(pc.ProtochainError, match=r"ax: give .* Axes"):
            plot(ax=wrong)
        with pytest.raises(pc.ProtochainError, match=r"ax: give .* Axes"):
            plot(ax=True)
        plt.close("all")
