"""What predictors write beside a model goes with its result."""

import io
import json
import shutil
import zipfile

import numpy as np
import pandas as pd
import pytest
from fixtures.command_line import run
from fixtures.samples import ROOT, STRUCTURES

from protochain.structure.formats import confidences
from protochain.structure.formats.confidences import confidence_files, copy_confidences, read_scores

SAMPLE = STRUCTURES / "1l2y.pdb"
MODELS = ROOT.parent / "shared" / "complexes" / "models"
NAMES = {
    "AlphaFold 3": ("job_seed-1_sample-0_model", ["job_seed-1_sample-0_summary_confidences.json",
                                                  "job_seed-1_sample-0_confidences.json"]),
    "AlphaFold Server": ("fold_x_model_3", ["fold_x_summary_confidences_3.json", "fold_x_full_data_3.json"]),
    "Boltz": ("x_model_0", ["confidence_x_model_0.json", "pae_x_model_0.npz", "plddt_x_model_0.npz",
                            "pde_x_model_0.npz", "affinity_x.json"]),
    "Chai": ("pred.model_idx_1", ["scores.model_idx_1.npz"]),
    "Protenix": ("x_seed_101_sample_2", ["x_seed_101_summary_confidence_sample_2.json",
                                         "x_seed_101_full_data_sample_2.json"]),
    "ColabFold": ("x_unrelaxed_rank_001_alphafold2_ptm_model_1_seed_000",
                  ["x_scores_rank_001_alphafold2_ptm_model_1_seed_000.json"]),
    "database": ("AF-P00698-F1-model_v4", ["AF-P00698-F1-confidence_v4.json",
                                           "AF-P00698-F1-predicted_aligned_error_v4.json"]),
}  # fmt: skip


@pytest.fixture
def boltz(tmp_path):
    """A model with a confidence file, and one that belongs to another model."""
    (tmp_path / "in").mkdir()
    shutil.copy(SAMPLE, tmp_path / "in" / "x_model_0.pdb")
    (tmp_path / "in" / "confidence_x_model_0.json").write_bytes(b'{"ptm": 0.9}\r\n\x00')
    (tmp_path / "in" / "confidence_x_model_1.json").write_text("{}")
    return tmp_path / "in" / "x_model_0.pdb"


@pytest.mark.parametrize("suffix", [".cif", ".pdb", ".cif.gz"])
@pytest.mark.parametrize("program", NAMES)
def test_names_are_those_of_the_programs(tmp_path, program, suffix):
    stem, names = NAMES[program]
    for name in (*names, "other.json", "confidence_other_model_0.json"):
        (tmp_path / name).write_text(name)
    assert {path.name for path in confidence_files(tmp_path / f"{stem}{suffix}")} == set(names)


def test_they_are_copied_as_they_are_and_replace_nothing(boltz, tmp_path):
    result = tmp_path / "out" / "y.cif"
    copied = copy_confidences(boltz, result)
    beside = boltz.with_name("confidence_x_model_0.json")
    assert [path.name for path in copied.written] == [beside.name] and not copied.left
    assert copied.written[0].read_bytes() == beside.read_bytes()
    assert copy_confidences(boltz, result) == ((), ())
    copied.written[0].write_text("mine")
    again = copy_confidences(boltz, result)
    assert not again.written and len(again.left) == 1 and "confidence_x_model_0.json" in again.left[0]
    assert copied.written[0].read_text() == "mine"
    assert copy_confidences(boltz, boltz.with_name("z.pdb")) == ((), ())
    beside.unlink()
    beside.mkdir()
    assert copy_confidences(boltz, tmp_path / "else" / "y.cif") == ((), ())


def test_what_is_too_large_is_told(boltz, tmp_path):
    with boltz.with_name("pae_x_model_0.npz").open("wb") as file:
        file.truncate(1_000_000_001)
    copied = copy_confidences(boltz, tmp_path / "out" / "y.cif")
    assert len(copied.written) == 1 and "pae_x_model_0.npz" in copied.left[0]


@pytest.mark.parametrize("unpacked", [100, 400_000])
def test_what_unpacks_to_too_much_is_not_read(tmp_path, monkeypatch, unpacked):
    """A file of kilobytes may hold gigabytes of zeros."""
    monkeypatch.setattr(confidences, "_LARGEST_READ", 200_000)
    path = tmp_path / "scores.model_idx_1.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        array = io.BytesIO()
        np.save(array, np.float64(0.5))
        file.writestr("iptm.npy", array.getvalue())
        file.writestr("other", b"0" * unpacked)
    assert read_scores([path]).iptm == (0.5 if unpacked == 100 else None)


def test_commands_take_them_along(boltz, tmp_path, capsys):
    beside = boltz.with_name("confidence_x_model_0.json")
    to = tmp_path / "one" / "r.pdb"
    run("relax", boltz, "-o", to, "--json")
    assert json.loads(capsys.readouterr().out)["confidences"] == [str(to.with_name(beside.name))]
    run("minimise", boltz, "--max-evaluations", "20", "-o", tmp_path / "two" / "m.pdb")
    assert f"written: {tmp_path / 'two' / beside.name}" in capsys.readouterr().out.replace("\n", "")
    shutil.copy(boltz, boltz.with_name("x_model_1.pdb"))
    run("relax", boltz.parent, "-o", tmp_path / "three", "--workers", "1")
    for folder in ("one", "two", "three"):
        assert (tmp_path / folder / beside.name).read_bytes() == beside.read_bytes()
    assert (tmp_path / "three" / "confidence_x_model_1.json").read_text() == "{}"
    table = pd.read_csv(tmp_path / "three" / "relaxed.csv")
    assert set(table["confidences"]) == {"confidence_x_model_0.json", "confidence_x_model_1.json"}
    assert sorted(path.name for path in boltz.parent.iterdir()) == [
        "confidence_x_model_0.json", "confidence_x_model_1.json", "x_model_0.pdb", "x_model_1.pdb",
    ]  # fmt: skip


def test_chains_of_boltz_are_in_the_order_of_their_numbers(tmp_path):
    """Indices may be in any order in the file, and 10 is after 9."""
    order = [10, 2, *range(2), *range(3, 10)]
    pairs = {f"{a}": {f"{b}": 0.01 * (11 * a + b) for b in reversed(order)} for a in order}
    (tmp_path / "confidence_x_model_0.json").write_text(json.dumps({"pair_chains_iptm": pairs}))
    read = read_scores([tmp_path / "confidence_x_model_0.json"])
    in_order = [[0.01 * (11 * a + b) for b in range(11)] for a in range(11)]
    assert np.array_equal(read.pairs, in_order)
