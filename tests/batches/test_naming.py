"""Names of structures in batches: folders mirrored, no name twice, and earlier ones kept."""

import os
import shutil
from collections import Counter
from pathlib import Path

import pytest
from fixtures.samples import STRUCTURES

import protochain as pc
from protochain.batches import BatchSettings, find_jobs
from protochain.batches.jobs import failure
from protochain.batches.naming import NameRequest, assign_names, output_stem
from protochain.batches.table import Tables, earlier_rows

RELAX = BatchSettings(("relax",))


def made(*names):
    """Files of different content."""
    for name in names:
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).write_text(name)


def names(inputs, settings=RELAX, **options):
    jobs = find_jobs(inputs, settings, **options)
    stems = Counter(output_stem(job.name, method) for job in jobs for method in job.settings.methods)
    assert max(stems.values()) == 1 and len({job.name for job in jobs}) == len(jobs)
    # All stay inside the folder for the results.
    assert not any(Path(name).is_absolute() or ".." in Path(name).parts for name in stems)
    return [job.name for job in jobs]


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_folders_below_those_given_are_mirrored():
    samples = [f"predictions/job/seed-1_sample-{k}/model.cif" for k in range(2)]
    made(*samples, "predictions/one.pdb", "other/one.pdb")
    mirrored = ["job/seed-1_sample-0/model", "job/seed-1_sample-1/model"]
    assert names(["predictions"]) == [*mirrored, "one"]
    assert names([*samples, "predictions/one.pdb"]) == [*mirrored, "one"]
    assert names(["predictions/*/*/model.cif"]) == mirrored and names(["predictions/**/*.cif"]) == mirrored
    # A folder with one sample has the names that it has later, with more; a file alone has its own.
    shutil.rmtree("predictions/job/seed-1_sample-1")
    assert names(["predictions"]) == [mirrored[0], "one"] and names(samples[:1]) == ["model"]
    both = ["predictions/job/seed-1_sample-0/model", "predictions/one", "other/one"]
    assert names(["predictions", "other"]) == both
    assert names([Path("predictions").absolute(), "./other/../other"]) == both
    assert output_stem(both[0], "relax") == f"{both[0]}.relaxed" and output_stem("a/b", "kcm") == "a/b.kcm"


def test_names_of_manifests_stay_in_the_folder_for_the_results(here):
    made("in/a/x.pdb", "b/x.pdb", "b/unrelaxed/x_unrelaxed_1.pdb")
    Path("in/work.csv").write_text(
        f"path\na/x.pdb\n../b/x.pdb\n{here}/b/unrelaxed/x_unrelaxed_1.pdb\n{here}/in/../in/a/x.pdb\n"
    )
    found = names([], manifest=Path("in/work.csv"))
    assert found[1:3] == ["b/x", "b/unrelaxed/x_unrelaxed_1"] and found[0].startswith("in/a/x-")
    assert output_stem(found[2], "relax") == "b/unrelaxed/x_relaxed_1"


@pytest.mark.parametrize(
    ("files", "settings", "expected"),
    [
        (
            ("model.pdb", "model.cif", "model.pdb.gz", "x.pdb"), RELAX,
            ["model.cif", "model.pdb", "model.pdb.gz", "x"],
        ),
        # The results would have one name, not the inputs.
        (("x.pdb", "x.unrelaxed.cif"), RELAX, ["x.pdb", "x.unrelaxed.cif"]),
        (("x.pdb", "x.unrelaxed.cif"), BatchSettings(("lbfgs",)), ["x", "x.unrelaxed"]),
        (("x.pdb", "x.lbfgs.pdb"), BatchSettings(("lbfgs", "kcm")), ["x.lbfgs.pdb", "x.pdb"]),
        (("x.pdb", "x.cif", "x.pdb.ent"), RELAX, ["x.cif", "x-KEY", "x.pdb.ent"]),
        (("a/x.pdb", "a.x.pdb", "x.pdb"), RELAX, ["a/x", "a.x", "x"]),
    ],
)  # fmt: skip
def test_no_two_inputs_write_one_output(files, settings, expected):
    made(*(f"in/{file}" for file in files))
    found = names(["in"], settings)
    assert [name if "-" not in name else "x-KEY" for name in found] == expected


def test_one_file_with_several_settings_and_models():
    made("x.pdb", "x.1.pdb")
    Path("work.csv").write_text("path,preset,model\nx.pdb,crystal,1\nx.pdb,design,1\nx.pdb,,2\nx.1.pdb,,\n")
    first, second, *others = find_jobs([], RELAX, Path("work.csv"))
    assert first.name == f"x.1-{first.key[:8]}" and second.name == f"x.1-{second.key[:8]}"
    assert [job.name for job in others] == ["x.2", "x.1.pdb"]
    assert len(names([], manifest=Path("work.csv"))) == 4
    # One file under two paths is one job.
    assert names(["x.pdb", Path("x.pdb").absolute(), "./x.pdb"]) == ["x"]
    # What has one key under several paths has a name of its own all the same.
    twice = [NameRequest(Path("/in/x.pdb"), Path("/in"), None, "abc", ("relax",)) for _ in range(2)]
    assert assign_names(twice) == ["x-abc-0", "x-abc-1"] and assign_names([]) == []


def resumed(inputs, output=Path("out"), settings=RELAX, **options):
    """Rows of a batch that goes on in a folder, without the work; names of what would be done."""
    jobs = find_jobs(inputs, settings, output=output, earlier=earlier_rows(output), **options)
    tables = Tables(output, True, methods=settings.methods)
    done = tables.select_finished(jobs)
    todo = [job for job in jobs if job.identity not in done]
    for job in todo:
        tables.append([failure(job, method, "refused", "why") for method in settings.methods])
    tables.close()
    rows = [(row.structure, os.path.relpath(row.input)) for row in earlier_rows(output)]
    assert len(dict(rows)) == len(rows)
    return [job.name for job in todo], rows


def test_results_keep_their_names_when_others_come_from_elsewhere():
    made("a/x.pdb", "b/x.pdb", "b/y.pdb")
    assert resumed(["a"])[0] == ["x"]
    # Alone, this would be x, too; the first is left out, and is not lost.
    assert resumed(["b/x.pdb"]) == (["x.pdb"], [("x", "a/x.pdb"), ("x.pdb", "b/x.pdb")])
    todo, rows = resumed(["a", "b"])
    assert todo == ["b/y"] and rows[:2] == [("x", "a/x.pdb"), ("x.pdb", "b/x.pdb")]
    made("a/x.cif")
    assert resumed(["a"])[0] == ["x.cif"] and resumed(["a", "b"])[0] == []


def test_changed_and_moved_inputs_are_those_of_their_names():
    made("a/x.pdb", "a/deep/y.pdb", "b/z.pdb")
    assert resumed(["a"])[0] == ["deep/y", "x"]
    Path("a/x.pdb").write_text("changed")
    todo, rows = resumed(["a", "b"])
    assert todo == ["x", "b/z"] and sorted(rows) == [
        ("b/z", "b/z.pdb"), ("deep/y", "a/deep/y.pdb"), ("x", "a/x.pdb"),
    ]  # fmt: skip
    # Nothing is done again where all has been moved. A copy is another file, and so is what has a new name.
    shutil.copytree("b", "copied")
    assert resumed(["copied"])[0] == ["z"]
    shutil.move("a", "moved/to/a")
    shutil.move("b", "moved/to/b")
    assert resumed(["moved"])[0] == []
    shutil.move("moved/to/a/x.pdb", "moved/to/a/new.pdb")
    assert resumed(["moved"])[0] == ["to/a/new"]


def test_a_manifest_or_link_in_the_folder_for_the_results_is_refused():
    made("in/x.pdb")
    Path("out").mkdir()
    shutil.copy(STRUCTURES / "ala10.pdb", "out/y.relaxed.pdb")
    Path("out/list.csv").write_text("path\n../in/x.pdb\n")
    Path("out/x.pdb").symlink_to(Path("in/x.pdb").absolute())
    Path("in/z.pdb").symlink_to(Path("out/y.relaxed.pdb").absolute())
    before = {path.name: path.read_bytes() for path in Path("out").iterdir()}
    with pytest.raises(pc.ProtochainError, match="in: is the output folder"):
        pc.batch("in", "in", "relax")
    for given, options in (
        ([], {"manifest": "out/list.csv"}), ("out/x.pdb", {}), ("in/z.pdb", {}),
        ("out/y.relaxed.pdb", {}), ("in/../out/x.pdb", {}),
    ):  # fmt: skip
        with pytest.raises(pc.ProtochainError, match="is inside the output folder"):
            pc.batch(given, "out", "relax", **options)
    assert {path.name: path.read_bytes() for path in Path("out").iterdir()} == before
