"""``protochain search``: from a sequence or a file to a folder."""

import json

import pytest
from fixtures.command_line import refusal, refusal_as_said, run

import protochain as pc

pytestmark = pytest.mark.usefixtures("interruptible")
FEW = ("--evaluations", "200", "--walkers", "1", "--workers", "1", "--solvent", "vacuum")


def test_a_sequence_and_its_file_find_the_same(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run("search", "AAA", *FEW, "--json") == 0
    record = json.loads(capsys.readouterr().out)
    assert record["structure"] == "AAA" and record["method"] == "csa" and record["evaluations"] >= 200
    assert (tmp_path / "AAA-search" / "report.html").exists()
    pc.save(pc.from_sequence("AAA"), "aaa.pdb")
    assert run("search", "aaa.pdb", *FEW, "-o", "of-file") == 0
    said = capsys.readouterr().out
    assert said.startswith("aaa: ") and "written: of-file" in said
    # The file rounds positions to 0.001 angstrom.
    own = json.loads((tmp_path / "of-file" / "summary.json").read_text())
    assert own["energy_lowest_kj_mol"] == pytest.approx(record["energy_lowest_kj_mol"], abs=1.0)
    assert "--resume continues it" in refusal_as_said("search", "AAA", *FEW)
    assert run("search", "AAA", *FEW, "--resume") == 0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("search", "ABZ"), "ABZ"),
        (("search", "AAA", "--temperatures", "600-300"), "the lower first"),
        (("search", "AAA", "--method", "luck"), "choose from csa"),
        (("search", "AAA", "--resume"), "contains no search to resume"),
        (("search", "A" * 300, "--resume", "-o", "long"), "contains no search to resume"),
        (("search", "AAA", "--workers", "0"), "workers 0"),
    ],
)
def test_bad_input_is_one_clear_line(words, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    line = refusal(*words)
    assert said in line and "\n" not in line
    assert not list(tmp_path.iterdir())
