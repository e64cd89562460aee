"""Jobs of a batch: settings read and refused, files found, names, keys and rows of failures."""

import gzip
import hashlib
import io
import json
import math
import re
import shutil
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import pytest
from fixtures.samples import STRUCTURES

import protochain as pc
from protochain.batches import jobs as of_jobs
from protochain.batches.jobs import NAMES, BatchSettings, Job, Row, failure, find_jobs, origin, read_names
from protochain.core import defaults
from protochain.relaxation import RelaxSettings

PLAIN = {
    "methods": (defaults.METHOD,), "tolerance": None, "max_rmsd": float("inf"),
    "max_evaluations": defaults.MAX_EVALUATIONS, "seed": defaults.SEED, "restraint": "", "n_starts": 1,
    "spread": defaults.SPREAD, "curvature": None, "judge": defaults.JUDGE, "hinges": defaults.HINGES,
    "root": defaults.ROOT, "move": defaults.MOVE, "rigid_protein": False, "forcefield": defaults.FORCEFIELD,
    "solvent": defaults.SOLVENT, "salt": defaults.SALT, "engine": defaults.ENGINE, "device": defaults.DEVICE,
    "terms": "all", "cutoff": defaults.CUTOFF, "accuracy": defaults.ACCURACY, "calculator": None,
    "trust_forcefield": False,
    "model": None,
    "assembly": "", "altloc": "",
    "keep": defaults.KEEP, "disulfide": None, "ph": defaults.PH, "strict": False, "chains": (),
    "ligands": (), "ligand_charges": defaults.LIGAND_CHARGES, "standard_residues": False,
    "cap": defaults.CAP,
}  # fmt: skip
"""All settings of a minimisation by name, at their defaults."""

OF_RELAX = {
    "preset": defaults.PRESET, "protocol": "", "stiffness": None, "max_iterations": defaults.MAX_ITERATIONS,
    "max_outer_iterations": defaults.MAX_OUTER_ITERATIONS, "exclude": "", "keep_hydrogens": True,
    "repack": False, "posebusters": False, "free_ligands": False, "score_only": False,
    "repack_region": "", "interface": "", "mirror": False, "rebuild_side_chains": "",
    "sequence": "", "restraints": (),
}  # fmt: skip
"""Those of ``relax`` alone."""

MINIMISING = {
    "max_rmsd", "max_evaluations", "seed", "restraint", "n_starts", "spread", "curvature", "judge",
    "hinges", "root",
}  # fmt: skip
"""Those that ``relax`` does not have."""

FIELDS = {
    "restraints": "restraint", "starts": "n_starts", "energy": "calculator",
}  # fmt: skip
"""Fields by names of columns that are others."""


def names(inputs, settings=None, **options):
    return [job.name for job in find_jobs(inputs, settings or BatchSettings(), **options)]


def test_settings_are_recorded_by_name_but_for_threads():
    assert BatchSettings().record() == PLAIN
    assert BatchSettings(setup=pc.Setup(threads=3)).record() == PLAIN
    assert (
        set(NAMES) == {*PLAIN, *OF_RELAX, "setup", "relaxing", "threads"} - {"restraint"}
        and NAMES[7] == "n_starts"
    )


def test_settings_that_results_do_not_depend_on_are_not_recorded():
    both = BatchSettings(("relax", "lbfgs"))
    assert both.record() == PLAIN | OF_RELAX | {"methods": ("relax", "lbfgs")}
    alone = BatchSettings(("relax",)).record()
    assert alone.keys() == both.record().keys() - MINIMISING
    # Of a protocol the force field, too: rows have it.
    assert BatchSettings(("relax",)).changed(protocol="alphafold").record()["forcefield"] == "amber99sb"
    assert both.changed(protocol="alphafold").record()["forcefield"] == "amber14"


def test_one_tolerance_is_that_of_all_methods():
    for settings in (
        BatchSettings(("relax", "lbfgs"), tolerance=5.0),
        BatchSettings(("relax", "lbfgs"), relaxing=RelaxSettings(tolerance=5.0)),
        BatchSettings(("relax", "lbfgs"), relaxing=RelaxSettings(tolerance=7.0)).changed(tolerance=5.0),
        BatchSettings(("relax", "lbfgs")).read({"tolerance": "5"}),
    ):
        assert settings.tolerance == settings.relaxing.tolerance == 5.0
    usual = BatchSettings(("relax", "lbfgs"))
    assert (usual.tolerance, usual.relaxing.strength.tolerance) == (None, 10.0)


def test_a_setting_that_no_method_has_is_refused(tmp_path):
    shutil.copy(STRUCTURES / "ala10.pdb", tmp_path / "a.pdb")
    here, there = tmp_path / "a.pdb", tmp_path / "work.csv"
    for methods, settings, said in (
        (("relax",), {"max_evaluations": 7}, "max_evaluations: does not apply to relax"),
        (("kcm", "lbfgs"), {"preset": "crystal"}, "preset: does not apply to kcm, lbfgs"),
    ):
        with pytest.raises(pc.ProtochainError) as refusal:
            find_jobs([here], BatchSettings(methods).changed(**settings))
        assert str(refusal.value).startswith(said)
        names, cells = ",".join(settings), ",".join(map(str, settings.values()))
        there.write_text(f'path,methods,{names}\na.pdb,"{",".join(methods)}",{cells}\n')
        with pytest.raises(pc.ProtochainError, match=f"work.csv: line 2: {re.escape(said)}"):
            find_jobs([], BatchSettings(), there)
    # Of a batch of both, each structure takes what its methods have.
    there.write_text("path,methods\na.pdb,relax\na.pdb,lbfgs\n")
    common = BatchSettings().changed(preset="crystal", max_evaluations=7)
    relaxed, minimised = find_jobs([], common, there)
    assert relaxed.settings.record()["preset"] == "crystal" and "preset" not in minimised.settings.record()


def test_a_manifest_has_the_settings_of_relax():
    row = {
        "methods": "relax", "preset": "crystal", "stiffness": "200", "max-iterations": "9", "repack": "yes",
        "max-outer-iterations": "2", "exclude": "resid 3", "keep_hydrogens": "no", "chains": "A",
        "forcefield": "amber19", "tolerance": "3",
    }  # fmt: skip
    own = BatchSettings().read(row)
    assert own.relaxing == RelaxSettings("crystal", "", 3.0, 200.0, 9, 2, "resid 3", False, True)
    assert own.setup == pc.Setup(chains=("A",), forcefield="amber19") and own.methods == ("relax",)
    for cells, said in (
        ({"preset": "weak"}, "preset 'weak' is not known; choose from predicted, crystal, design"),
        ({"protocol": "alphafold", "solvent": "gbn2"}, "protocol alphafold is vacuum"),
        ({"repack": "perhaps"}, "neither true nor false"),
        ({"seed": "3"}, "seed: does not apply to relax; remove it"),
    ):
        with pytest.raises(pc.ProtochainError, match=said):
            BatchSettings().read({"methods": "relax", **cells})


LINE = "distance A:1:CA A:10:CA 0 6 1000"


@pytest.mark.parametrize(
    ("old", "new", "cell"),
    [("chain", "chains", "A"), ("calculator", "energy", "xtb"), ("ligand", "ligands", "ABC=CCO"),
     ("restrain", "restraints", LINE), ("restraint", "restraints", "100 0")],
)  # fmt: skip
def test_a_manifest_has_former_names_of_columns(old, new, cell):
    assert BatchSettings().read({old: cell}) == BatchSettings().read({new: cell}) != BatchSettings()


def test_restraints_are_of_all_methods_but_springs_of_minimisations():
    both = BatchSettings(("relax", "lbfgs"), restraints=LINE)
    assert both.relaxing.restraints == (pc.Restraint.read(LINE),)
    assert both.record()["restraint"] == LINE and len(both.record()["restraints"]) == 1
    (alone, minimised) = (both.changed(methods=(method,)).record() for method in ("relax", "lbfgs"))
    assert "restraint" not in alone and "restraints" not in minimised and minimised["restraint"] == LINE
    listed = BatchSettings(("relax",), relaxing=RelaxSettings(restraints=LINE))
    assert listed.relaxing == both.relaxing
    with pytest.raises(pc.ProtochainError) as refusal:
        both.changed(restraints="1000 0")
    said = "restraints '1000 0': springs of a minimisation; for relax give restraints, or stiffness"
    assert str(refusal.value) == said
    assert both.changed(methods=("lbfgs",), restraints="1000 0").restraints == "1000 0"


def test_settings_change_by_the_names_of_their_fields_or_of_the_setups():
    changed = BatchSettings().changed(seed=3, ph=5.0, methods=("kcm", "lbfgs", "kcm"))
    assert changed.record() == PLAIN | {"seed": 3, "ph": 5.0, "methods": ("kcm", "lbfgs")}
    setup = pc.Setup(solvent="gbn2", ph=6.0)
    assert changed.changed(setup=setup, ph=5.5).setup == replace(setup, ph=5.5)
    assert changed.changed(tolerance=2.0).setup == changed.setup


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"methods": ()}, "methods: give at least one"),
        ({"model": "first"}, "model 'first': give its number, or all, or a range such as 1-5"),
        ({"colour": 1}, f"no setting is called 'colour'; choose from {', '.join(NAMES)}"),
        ({"tolerance": 0.0}, "tolerance 0: give a number above 0, at most 1e6"),
        ({"n_starts": 2.5}, "n_starts 2.5: give a whole number"),
   ({"spread": 1.0}, "spread: applies to several starts only; give n_starts 2 or more, or omit it"),
        *(({"n_starts": 2, name: value}, "restraints and max_rmsd refer to each start's own structure; "
           "use one start") for name, value in (("restraints", "5"), ("max_rmsd", 1.0))),
    ],
)  # fmt: skip
def test_settings_that_make_no_sense_are_refused(settings, said):
    with pytest.raises(pc.ProtochainError) as refusal:
        BatchSettings().changed(**settings)
    assert str(refusal.value) == said


def test_methods_of_one_name_are_refused():
    twice = ("fire", "protochain.minimisers:Fire", "protochain.minimisers.fire:Fire")
    with pytest.raises(pc.ProtochainError) as refusal:
        BatchSettings(methods=twice)
    assert str(refusal.value) == f"methods {', '.join(twice)}: two have one name, and so would their files"
    assert BatchSettings(methods=twice[:2]).methods == twice[:2]


def test_cells_of_a_manifest_are_read_by_the_kind_of_their_setting():
    row = {
        "methods": "kcm, lbfgs", "tolerance": "2", "max_rmsd": " 0.5 ", "max_evaluations": "7", "seed": "3",
        "restraints": "5 0", "curvature": "no", "judge": "reference",
        "hinges": "phi", "root": "free", "move": "resid 3:5", "forcefield": "amber19", "solvent": "gbn2",
        "salt": "0.15", "engine": "native", "device": "cpu", "cutoff": "2.5", "accuracy": "1e-3",
        "rigid_protein": "no", "energy": "xtb",
        "model": "2", "assembly": "1", "altloc": "B", "keep": "ZN,CA",
        "disulfide": "A:3-A:40", "ph": "6.5", "strict": "Yes", "chains": "A, B", "terms": "nonbonded",
        "ligands": "ABC=CCO", "ligand_charges": "gasteiger", "standard_residues": "yes", "cap": "ends",
    }  # fmt: skip
    assert BatchSettings().read(row).record() == {
        "methods": ("kcm", "lbfgs"), "tolerance": 2.0, "max_rmsd": 0.5, "max_evaluations": 7, "seed": 3,
        "restraint": "5 0", "n_starts": 1, "spread": 0.2, "curvature": False, "judge": "reference",
        "hinges": "phi", "root": "free", "move": "resid 3:5", "forcefield": "amber19", "solvent": "gbn2",
        "salt": 0.15, "engine": "native", "device": "cpu", "cutoff": 2.5, "accuracy": 1e-3,
        "rigid_protein": False, "calculator": "xtb",
        "model": 2, "assembly": "1", "altloc": "B", "keep": ("ZN", "CA"),
        "disulfide": (("A:3", "A:40"),), "ph": 6.5, "strict": True, "trust_forcefield": False,
        "terms": "nonbonded",
        "chains": ("A", "B"), "ligands": (("ABC", "CCO"),), "ligand_charges": "gasteiger",
        "standard_residues": True, "cap": "ends",
    }  # fmt: skip
    # Columns have the names of the options or of the fields, and angles are in degrees.
    starts = {"n_starts": 4, "spread": math.pi / 2}
    for named in (("starts", "spread"), ("n_starts", "spread")):
        cells = dict(zip(named, ("4", "90"), strict=True))
        assert BatchSettings().read(cells) == BatchSettings(**starts)
    assert {FIELDS.get(name, name) for name in (*row, *cells)} == set(PLAIN) - {"trust_forcefield"}
    assert BatchSettings().read({"model": "1-3, 5", "disulfide": "none"}).setup == pc.Setup(
        model="1-3,5", disulfide=("none",)
    )
    assert BatchSettings(seed=4).read(dict.fromkeys((*row, *cells), " ")) == BatchSettings(seed=4)
    for text, expected in (("true", True), ("1", True), ("FALSE", False), ("no", False), ("0", False)):
        assert (
            BatchSettings(setup=pc.Setup(strict=not expected)).read({"strict": text}).setup.strict is expected
        )


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ({"strict": "maybe"}, "'maybe' is neither true nor false"),
        ({"seed": "1.5"}, "invalid literal for int() with base 10: '1.5'"),
        ({"methods": "a:B"}, "methods: an import path runs code; give it as an option of the batch"),
        ({"model": "two"}, "model 'two': give its number, or all, or a range such as 1-5"),
        *(({name: "x"}, f"no setting is called {name!r}; choose from ") for name in
          ("setup", "threads", "trust_forcefield", "path")),
    ],
)  # fmt: skip
def test_cells_that_cannot_be_read_are_refused(row, said):
    with pytest.raises(pc.ProtochainError) as refusal:
        BatchSettings().read(row)
    options = {field: name for name, field in FIELDS.items() if "-" not in name}
    known = {options.get(name, name) for name in (*PLAIN, *OF_RELAX) if name != "trust_forcefield"}
    told, named, names_listed = str(refusal.value).partition("choose from ")
    if "no setting" in told:
        assert told + named == said and {*names_listed.split(", ")} == known
    else:
        assert str(refusal.value) == said


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with files of many names, which is the current one."""
    for name in (
        "b.pdb",
        "a.CIF",
        "deep/c.ent.GZ",
        "deep/d.mmcif",
        "e.txt",
        "f.gz",
        "deep/g.pdb.gz",
        "sum[1].pdb",
    ):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(name)
    (tmp_path / "folder.pdb").mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_structures_of_a_folder_are_those_with_their_suffixes(here):
    assert names(["."]) == ["a", "b", "deep/c", "deep/d", "deep/g", "sum[1]"]
    assert names([here / "deep"]) == ["c", "d", "g"]
    assert names(["deep/d.mmcif", "deep"]) == ["d", "c", "g"]  # in the order given, each once
    # A file that is named is taken, whatever its suffix; one that is missing is a job that fails.
    assert names(["e.txt", "XYZ.pdb"]) == ["e", "XYZ"] and names(["sum[1].pdb"]) == ["sum[1]"]
    assert find_jobs(["b.pdb"], BatchSettings())[0].path == here / "b.pdb"


def test_other_files_of_a_folder_are_not_looked_at(tmp_path, monkeypatch):
    """A look may be slow, or refused."""
    for name in ("a.pdb", "notes.txt", "run.dcd"):
        (tmp_path / name).touch()
    seen = []
    monkeypatch.setattr(Path, "is_file", lambda path: bool(seen.append(path.name)) or True)
    assert [path.name for path, _ in of_jobs._paths(str(tmp_path), None)] == seen == ["a.pdb"]


def test_patterns_are_of_files_in_order(here):
    assert names(["*.pdb"]) == ["b", "sum[1]"] and names(["**/*.gz"]) == ["deep/g", "f"]
    assert names(["[ab].*"]) == ["a", "b"] and names(["*.*"]) == ["a", "b", "e", "f", "sum[1]"]
    for nothing in ("*.xyz", "?.xyz", "[z].pdb"):
        with pytest.raises(pc.ProtochainError) as refusal:
            names([nothing])
        assert str(refusal.value) == f"{nothing}: matches no file"
    with pytest.raises(pc.ProtochainError) as refusal:
        names([])
    assert str(refusal.value) == "no structures found; give files, folders or patterns"
    Path("list.csv").write_text("path\n")
    with pytest.raises(pc.ProtochainError, match=r"^list\.csv: no structures found; "):
        find_jobs([], BatchSettings(), Path("list.csv"))


def test_a_list_on_standard_input_has_a_name_on_each_line(here, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO("  b.pdb \n\n  \ndeep\n"))
    assert names(["-"]) == ["b", "deep/c", "deep/d", "deep/g"]
    Path("b.pdb").rename("two\nlines .pdb")
    for text, by_nul in (("two\nlines .pdb\0\0e.txt", False), ("two\nlines .pdb", True)):
        monkeypatch.setattr("sys.stdin", io.StringIO(text))
        assert names(read_names(by_nul)) == ["two\nlines ", "e"][: 2 - by_nul]


def test_results_are_not_searched_and_no_input_may_lie_among_them(here):
    assert names(["."], output=here / "deep") == ["a", "b", "sum[1]"]
    assert names(["deep"], output=here / "deep" / "new") == ["c", "d", "g"]
    with pytest.raises(pc.ProtochainError) as refusal:
        names(["deep/d.mmcif"], output=Path("deep"))
    assert str(refusal.value) == ("deep/d.mmcif: is inside the output folder; choose another output folder")


def test_a_manifest_names_files_beside_it_each_with_its_settings(here):
    sheet = here / "deep" / "work.csv"
    sheet.write_text("seed,path\n3, d.mmcif \n,../b.pdb\n3,d.mmcif\n", encoding="utf-8-sig")
    first, second = find_jobs([], BatchSettings(seed=1), sheet)
    assert [(job.name, job.settings.seed) for job in (first, second)] == [("deep/d", 3), ("b", 1)]
    assert first.path.samefile("deep/d.mmcif") and second.path.samefile("b.pdb")
    # Given names come before those of the manifest.
    assert names(["e.txt"], manifest=sheet) == ["e", "deep/d", "b"]
    for text, said in (
        ("file\n", ": has no column 'path'"), ("", ": has no column 'path'"),
        ("path\nb.pdb,1\n", ": line 2: more cells than columns"),
        ("path,seed\nb.pdb,1\nb.pdb,x\n", ": line 3: invalid literal for int() with base 10: 'x'"),
    ):  # fmt: skip
        sheet.write_text(text)
        with pytest.raises(pc.ProtochainError) as refusal:
            names([], manifest=sheet)
        assert str(refusal.value) == f"{sheet}{said}"
    sheet.write_text("path,seed\nd.mmcif\nb.pdb\n")
    assert names([], manifest=sheet) == ["d", "b"]
    with pytest.raises(pc.ProtochainError) as refusal:
        names([], manifest=here / "none.csv")
    assert str(refusal.value) == f"{here}/none.csv: not found; give a CSV file with a column 'path'"


def test_a_batch_over_nothing_is_refused(here):
    with pytest.raises(pc.ProtochainError) as refusal:
        names(["XYZ.pdb", "none.pdb"])
    assert str(refusal.value) == "XYZ.pdb: not found, nor any other structure; check the names"
    assert names(["XYZ.pdb", "b.pdb"]) == ["XYZ", "b"]


def test_a_key_is_a_hash_of_version_content_settings_and_force_field(here):
    def key(content, settings, forcefield=b""):
        hashes = [hashlib.sha256(text).hexdigest() if text else "" for text in (content, forcefield)]
        parts = [version("protochain"), hashes[0], settings.record(), hashes[1]]
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()

    settings = BatchSettings(seed=4)
    (job,) = find_jobs(["b.pdb"], settings)
    assert job.key == key(b"b.pdb", settings) and job.identity == ("b", job.key)
    assert find_jobs(["none.pdb", "b.pdb"], settings)[0].key == key(b"", settings)
    Path("own.xml").write_text("<ForceField/>")
    own = settings.changed(forcefield="own.xml")
    assert find_jobs(["b.pdb"], own)[0].key == key(b"b.pdb", own, b"<ForceField/>")


def test_each_model_is_a_job_where_all_are_asked_for(here):
    atoms = (STRUCTURES / "ala10.pdb").read_text().split("ATOM", 1)[1].rsplit("\n", 3)[0]
    text = "".join(f"MODEL     {k:4}\nATOM{atoms}\nENDMDL\n" for k in (3, 5))
    with gzip.open(here / "two.pdb.gz", "wt") as file:
        file.write(text)
    (here / "one.pdb").write_text((STRUCTURES / "ala10.pdb").read_text())
    every = BatchSettings(setup=pc.Setup(model="all"))
    jobs = find_jobs(["two.pdb.gz", "one.pdb", "none.pdb", "b.pdb"], every)
    assert [(job.name, job.settings.setup.model) for job in jobs] == [
        ("two.3", 3), ("two.5", 5), ("one", None), ("none", None), ("b", None),
    ]  # fmt: skip
    one, two, *_ = jobs
    assert one.key != two.key and origin(two)["model"] == 5 and origin(jobs[2])["model"] == ""
    assert names(["two.pdb.gz"]) == ["two"]
    # Models asked for by number are not looked for: a job whose model is not there fails.
    some = find_jobs(["two.pdb.gz"], every.changed(model="5,3-4"))
    assert [(job.name, job.settings.setup.model) for job in some] == [
        ("two.5", 5), ("two.3", 3), ("two.4", 4),
    ]  # fmt: skip
    assert [job.key for job in some[:2]] == [two.key, one.key]


def test_the_row_of_a_failure_says_where_and_why_in_one_line():
    job = Job("two.5", Path("/in/two.pdb"), BatchSettings(setup=pc.Setup(model=5)), "abc")
    assert failure(job, "kcm", "refused", "why,\n  so", 2.5) == Row(
        {
            "structure": "two.5", "input": "/in/two.pdb", "model": 5, "key": "abc", "method": "kcm",
            "status": "refused", "message": "why, so", "seconds": 2.5,
        },
        [],
    )  # fmt: skip
    assert failure(job, "kcm", "refused", "").record["seconds"] == 0.0


def test_a_folder_of_poses_is_a_job_for_each_which_is_done_anew_if_its_pose_changes(tmp_path):
    (tmp_path / "protein.pdb").write_text((STRUCTURES / "ala10.pdb").read_text())
    poses = tmp_path / "poses"
    poses.mkdir()
    for name in ("b.sdf", "a.MOL2", "notes.txt"):
        (poses / name).write_text(name)
    settings = BatchSettings(setup=pc.Setup(ligands=(str(poses), "ABC=CCO")))
    jobs = find_jobs([tmp_path / "protein.pdb"], settings)
    assert [job.name for job in jobs] == ["protein.a", "protein.b"]
    assert [job.settings.setup.ligands for job in jobs] == [
        (("ABC", "CCO"), ("", str(poses / name))) for name in ("a.MOL2", "b.sdf")
    ]
    (poses / "b.sdf").write_text("moved")
    again = find_jobs([tmp_path / "protein.pdb"], settings)
    assert [old.key == new.key for old, new in zip(jobs, again, strict=True)] == [True, False]
    for name in ("b.sdf", "a.MOL2"):
        (poses / name).unlink()
    with pytest.raises(pc.ProtochainError, match=r"poses: contains no poses; give a folder of \.sdf"):
        find_jobs([tmp_path / "protein.pdb"], settings)


def test_a_file_with_several_poses_is_a_job_for_each(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("protein.pdb").write_text((STRUCTURES / "ala10.pdb").read_text())
    Path("poses.sdf").write_text("one\n$$$$\ntwo\n$$$$\n")
    jobs = find_jobs(["protein.pdb"], BatchSettings(setup=pc.Setup(ligands=("poses.sdf",))))
    assert [job.name for job in jobs] == ["protein.poses_1", "protein.poses_2"]
    assert [job.settings.setup.ligands for job in jobs] == [(("", f"poses.sdf#{k}"),) for k in (1, 2)]
    assert jobs[1].anywhere().settings.setup.ligands == (("", f"{tmp_path / 'poses.sdf'}#2"),)
    Path("poses.sdf").write_text("one\n$$$$\nmoved\n$$$$\n")
    again = find_jobs(["protein.pdb"], BatchSettings(setup=pc.Setup(ligands=("poses.sdf",))))
    assert {job.key for job in jobs}.isdisjoint(job.key for job in again)


def test_a_worker_in_another_folder_finds_poses_and_charges(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("x.pdb", "pose.sdf", "q.csv"):
        Path(name).write_text("")
    (job,) = find_jobs(
        ["x.pdb"], BatchSettings(setup=pc.Setup(ligands=("pose.sdf",), ligand_charges="q.csv"))
    )
    assert job.anywhere().settings.setup.ligands == (("", str(tmp_path / "pose.sdf")),)
    assert job.anywhere().settings.setup.ligand_charges == str(tmp_path / "q.csv")


def test_a_link_to_nothing_in_a_folder_is_a_row(here):
    Path("in").mkdir(exist_ok=True)
    shutil.copy(STRUCTURES / "ala10.pdb", "in/a.pdb")
    Path("in/z.pdb").symlink_to("nowhere.pdb")
    assert [job.path.name for job in find_jobs(["in"], BatchSettings())][-1] == "z.pdb"


@pytest.mark.parametrize(
    "data",
    ["path\nala10.pdb\n".encode("utf-16"), b"path,exclude\na.pdb," + b"x" * 200_000],
    ids=["UTF-16", "a long cell"],
)
def test_a_manifest_that_is_no_csv_in_utf_8_is_one_line(data, tmp_path):
    (tmp_path / "m.csv").write_bytes(data)
    with pytest.raises(pc.ProtochainError, match=r"m\.csv: cannot be read"):
        find_jobs([], BatchSettings(), tmp_path / "m.csv")
