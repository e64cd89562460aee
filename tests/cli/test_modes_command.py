"""``protochain modes``: what it writes, says and refuses."""

import json

import numpy as np
import pandas as pd
import pytest
from fixtures.command_line import refusal, run
from fixtures.samples import STRUCTURES, load

import protochain as pc

pytestmark = pytest.mark.usefixtures("interruptible")
ALA = STRUCTURES / "ala10.pdb"


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("modes")
    pc.save(pc.minimise(load("ala10.pdb"), max_evaluations=200), folder / "other.pdb")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        status = run("modes", ALA, "-o", "out", "--modes", "7", "--to", "other.pdb", "--amplitude", "0.5")
    assert status == 0
    return folder / "out"


def test_tables_swings_and_page_are_those_of_the_modes(written):
    names = {path.name for path in written.iterdir()}
    tables = {"modes.csv", "fluctuations.csv", "summary.json", "report.html", "minimum.pdb"}
    assert names == tables | {f"mode-{number}.dcd" for number in range(1, 6)}
    record = json.loads((written / "summary.json").read_text())
    end = pc.load(written / "minimum.pdb")
    again = pc.normal_modes(pc.minimise(end, method="lbfgs", tolerance=0.1), k=7)
    table = pd.read_csv(written / "modes.csv")
    assert table["mode"].tolist() == list(range(1, 8))
    # The file rounds positions to 0.001 angstrom.
    assert table["frequency_per_cm"].to_numpy() == pytest.approx(again.frequencies, rel=0.01)
    assert table["cumulative_overlap"].to_numpy() == pytest.approx(
        again.cumulative_overlap(written.parent / "other.pdb"), abs=0.02
    )
    assert record["is_minimum"] and record["first"].startswith("minimised first")
    assert record["entropy_kj_mol_k"] == pytest.approx(again.entropy(), rel=0.01)
    assert record["largest_stable_step_ps"] == pytest.approx(again.largest_stable_step, rel=0.01)
    squares = pd.read_csv(written / "fluctuations.csv")["ca_fluctuation_angstrom"].to_numpy()
    assert squares == pytest.approx(again.fluctuations()["ca_fluctuation_angstrom"].to_numpy(), rel=0.05)
    frames = 0.1 * pytest.importorskip("MDAnalysis").coordinates.DCD.DCDReader(
        str(written / "mode-2.dcd")
    ).timeseries(order="fac")
    alpha, x = end.alpha_carbons, end.positions
    away = np.sqrt(np.mean(np.sum((frames[:, alpha] - x[alpha]) ** 2, axis=2), axis=1))
    assert away.max() == pytest.approx(0.05, rel=0.1) and away[[0, -1]] == pytest.approx(0.0, abs=2e-4)
    for i, j in end.bonds:
        length = np.linalg.norm(frames[:, i] - frames[:, j], axis=1)
        assert np.ptp(length) < 1e-5


def test_a_minimum_is_not_minimised_again(written, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    status = run("modes", written / "minimum.pdb", "--modes", "2", "--json", "--trajectory", "xtc")
    record = json.loads(capsys.readouterr().out)
    assert status == (0 if record["is_minimum"] else 3)
    assert (tmp_path / "minimum-modes" / "mode-2.xtc").exists()
    # As it is in the file, it has torques, and is told to be no minimum.
    assert run("modes", ALA, "--no-relax", "--modes", "2", "-o", "raw") == 3
    assert "not a minimum" in capsys.readouterr().out
    assert json.loads((tmp_path / "raw" / "summary.json").read_text())["first"] == "not minimised first"


def test_what_makes_no_sense_is_refused_before_the_work(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for options, said in (
        (["--modes", "0"], "modes"),
        (["--method", "lanczos"], "method"),
        (["--temperature", "-1"], "temperature"),
        (["--amplitude", "0"], "amplitude"),
        (["--trajectory", "avi"], "avi"),
        (["--to", "nothing.pdb"], "nothing.pdb"),
    ):
        assert said in refusal("modes", ALA, *options)
    assert list(tmp_path.iterdir()) == []
