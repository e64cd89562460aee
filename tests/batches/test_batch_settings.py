"""A batch is resumed with the settings that its results have, or refused."""

import contextlib
import importlib

import pytest
from fixtures.samples import STRUCTURES

import protochain as pc
from protochain.batches.jobs import failure


def rows_of(folder):
    return (folder / "summary.csv").read_text()


@pytest.mark.parametrize(
    ("other", "said"),
    [
        ({"methods": ("lbfgs", "kcm")}, "methods lbfgs, not lbfgs,kcm"),
        ({"max_rmsd": 2.0}, "out max_rmsd, which is 2.0 now"), ({"keep": "none"}, "keep near, not none"),
        ({"ph": 5.0}, r"ph 7\.0, not 5\.0"), ({"chains": "A"}, "chains none, not A"),
    ],
)  # fmt: skip
def test_a_batch_goes_on_with_its_own_settings_only(other, said, tmp_path, monkeypatch):
    usual = {"methods": "lbfgs", "max_evaluations": 5}
    files = (STRUCTURES / "ala10.pdb", STRUCTURES / "1l2y.pdb")
    first = start_without_work(files, tmp_path, monkeypatch, **usual)
    before = rows_of(tmp_path)
    assert first == ["ala10", "1l2y"] and before.count("\n") == 3
    with pytest.raises(pc.ProtochainError, match=rf"contains results with.*{said}; repeat the settings"):
        start_without_work(files, tmp_path, monkeypatch, resume=True, **usual | other)
    assert rows_of(tmp_path) == before
    added = (*files, STRUCTURES / "1vii.pdb")
    assert start_without_work(added, tmp_path, monkeypatch, resume=True, **usual) == ["1vii"]


def start_without_work(files, output, monkeypatch, **settings):
    """Names of the structures that a batch gives to its workers, each of which gets a row at once."""
    given = []

    def work(workers, todo, tables, *_):
        for job in todo:
            given.append(job.name)
            tables.append([failure(job, method, "refused", "why") for method in job.settings.methods])
        return False

    api = importlib.import_module("protochain.batches.batch_structures")
    monkeypatch.setattr(api, "_work", work)
    monkeypatch.setattr(api, "_finish", lambda *_: None)
    monkeypatch.setattr(api, "open_workers", lambda processes: contextlib.nullcontext())
    pc.batch(files, output, **settings)
    return given


def test_results_without_their_settings_are_not_continued(tmp_path, monkeypatch):
    """Of an older version, or deleted: nobody knows what they are results of."""
    files, usual = (STRUCTURES / "ala10.pdb",), {"methods": "lbfgs", "max_evaluations": 5}
    start_without_work(files, tmp_path, monkeypatch, **usual)
    (tmp_path / "settings.json").unlink()
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(pc.ProtochainError, match=r"contains results without settings\.json.*another folder"):
        start_without_work(files, tmp_path, monkeypatch, resume=True, **usual)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    # The folder is not left locked, and without results there is nothing to doubt.
    header = (tmp_path / "summary.csv").read_text().splitlines(True)[0]
    (tmp_path / "summary.csv").write_text(header)
    assert start_without_work(files, tmp_path, monkeypatch, resume=True, **usual) == ["ala10"]


def test_a_manifest_is_resumed_with_its_own_settings_only(tmp_path, monkeypatch):
    first, second = STRUCTURES / "ala10.pdb", STRUCTURES / "1l2y.pdb"
    manifest, output = tmp_path / "work.csv", tmp_path / "out"

    def go(*rows, **more):
        manifest.write_text("\n".join(["path,methods,solvent", *rows]))
        return start_without_work((), output, monkeypatch, manifest=manifest, **more)

    assert go(f"{first},lbfgs,", f"{second},kcm,vacuum") == ["ala10", "1l2y"]
    before = rows_of(output)
    assert go(f"{first},lbfgs,", f"{second},kcm,vacuum", resume=True) == []
    for row, said in (
        (f"{second},kcm,gbn2", "solvent vacuum, not gbn2"),
        (f"{second},,", "methods kcm, not cartesian"),
    ):
        with pytest.raises(pc.ProtochainError, match=rf"results for .*1l2y\.pdb with {said}"):
            go(f"{first},lbfgs,", row, resume=True)
    with pytest.raises(pc.ProtochainError, match=r"ala10\.pdb with methods lbfgs, not kcm"):
        go(f"{first},kcm,", resume=True)
    assert rows_of(output) == before
    # A new structure may have any settings.
    assert go(f"{second},kcm,vacuum", f"{STRUCTURES / '1vii.pdb'},fire,gbn2", resume=True) == ["1vii"]
    assert set(before.splitlines()) < set(rows_of(output).splitlines())


def test_models_of_one_file_have_settings_of_their_own(tmp_path, monkeypatch):
    manifest, output = tmp_path / "work.csv", tmp_path / "out"

    def go(first, second, **more):
        rows = [f"{STRUCTURES / 'ala10.pdb'},{model},{seed}" for model, seed in ((1, first), (2, second))]
        manifest.write_text("\n".join(["path,model,seed", *rows]))
        return start_without_work((), output, monkeypatch, manifest=manifest, methods="lbfgs", **more)

    assert go(3, 4) == ["ala10.1", "ala10.2"] and go(3, 4, resume=True) == []
    with pytest.raises(pc.ProtochainError, match=r"for .*ala10\.pdb, model [12] with seed"):
        go(4, 3, resume=True)


def test_settings_of_structures_that_are_left_out_are_kept(tmp_path, monkeypatch):
    first, second = (f"{STRUCTURES / name},vacuum" for name in ("ala10.pdb", "1l2y.pdb"))
    manifest, output = tmp_path / "work.csv", tmp_path / "out"

    def go(*rows, **more):
        manifest.write_text("\n".join(["path,solvent", *rows]))
        return start_without_work((), output, monkeypatch, manifest=manifest, methods="lbfgs", **more)

    assert go(first, second) == ["ala10", "1l2y"]
    assert go(first, resume=True) == []
    before = rows_of(output)
    # It was left out once, and is still known by what it was done with.
    with pytest.raises(pc.ProtochainError, match=r"1l2y\.pdb with solvent vacuum\b"):
        go(first, second.replace("vacuum", "gbn2"), resume=True)
    assert go(first, second, resume=True) == [] and rows_of(output) == before


@pytest.mark.parametrize(
    "damaged",
    [b"", b"[]", b"\0" * 99, b"[" * 100_000, b'{"settings": 1' + b"1" * 5000 + b"}", "{}".encode("utf-16")],
    ids=["empty", "a list", "NULs", "deep", "a long number", "UTF-16"],
)
def test_damaged_settings_of_a_folder_are_refused_in_a_line(damaged, tmp_path, monkeypatch):
    usual = (STRUCTURES / "ala10.pdb",), tmp_path, monkeypatch
    assert start_without_work(*usual, methods="lbfgs") == ["ala10"]
    before = rows_of(tmp_path)
    (tmp_path / "settings.json").write_bytes(damaged)
    with pytest.raises(pc.ProtochainError, match=r"^[^\n]*settings.json: contains no settings[^\n]*$"):
        start_without_work(*usual, methods="lbfgs", resume=True)
    assert rows_of(tmp_path) == before and (tmp_path / "settings.json").read_bytes() == damaged


def test_a_changed_force_field_or_version_is_another_setting(tmp_path, monkeypatch):
    own = tmp_path / "own.xml"
    own.write_text("<ForceField/>")
    usual = {"methods": "lbfgs", "forcefield": str(own)}
    start_without_work([STRUCTURES / "ala10.pdb"], tmp_path / "out", monkeypatch, **usual)
    own.write_text("<ForceField> </ForceField>")
    with pytest.raises(pc.ProtochainError, match="content of the force field"):
        start_without_work([STRUCTURES / "ala10.pdb"], tmp_path / "out", monkeypatch, resume=True, **usual)
    own.write_text("<ForceField/>")
    kept = importlib.import_module("protochain.batches.batch_settings")
    monkeypatch.setattr(kept, "version", lambda name: "99")
    with pytest.raises(pc.ProtochainError, match=r"protochain .*, not 99"):
        start_without_work([STRUCTURES / "ala10.pdb"], tmp_path / "out", monkeypatch, resume=True, **usual)
