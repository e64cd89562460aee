import json
import os
import signal
import subprocess
import sys

import gemmi
import pytest
from fixtures.command_line import COMMAND
from fixtures.samples import ROOT, STRUCTURES
from fixtures.waiting import HANG, until


def test_help_loads_nothing_heavy():
    code = "import sys, protochain.cli; print(*sorted(m for m in sys.modules if '.' not in m))"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    assert not {"openmm", "numba", "numpy", "scipy", "pandas", "matplotlib", "mdtraj", "gemmi"} & set(loaded)
    shown = subprocess.run([*COMMAND, "--help"], capture_output=True, text=True)
    assert shown.returncode == 0
    assert all(word in shown.stdout for word in ("minimise", "compare", "info", "build"))


def test_minimise_says_what_it_did_and_ends_with_0_when_converged(protochain, tmp_path):
    done = protochain("minimize", STRUCTURES / "ala10.pdb")
    assert done.returncode == 0
    assert "converged" in done.stdout and "written: ala10.cartesian.pdb" in done.stdout
    assert (tmp_path / "ala10.cartesian.pdb").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["minimise", "nowhere.pdb"], ["nowhere.pdb", "check the name"]),
        (["minimise"], ["IN"]),
        (["frobnicate"], ["frobnicate"]),
        (["minimise", "in.pdb", "--metod", "kcm"], ["--metod"]),
        (["minimise", "in.pdb", "--method", "cg"], ["'cg'", "kcm-adaptive", "hybrid, openmm"]),
        (["minimise", "in.pdb", "--tolerance", "-1"], ["tolerance -1"]),
        (["minimise", "in.pdb", "--max-evaluations", "many"], ["--max-evaluations", "integer"]),
        (["minimise", "in.pdb", "--hinges", "phi psy"], ["'psy'"]),
        (["minimise", "in.pdb", "--spread", "30"], ["spread", "--starts 2"]),
        (["minimise", "in.pdb", "--starts", "3", "--resume", "c.npz"], ["--resume", "several starts"]),
        (["minimise", "in.pdb", "--restrain", "strong"], ["'strong'", "1000 100 0"]),
        (["minimise", "in.pdb", "--move", "rezid 5"], ["'rezid 5'", "cannot be read"]),
        (["minimise", "in.pdb", "--resume", "no.npz"], ["no.npz", "not found"]),
        (["minimise", "in.pdb", "--max-rmsd", "0"], ["max-rmsd 0"]),
        (["minimise", "in.pdb", "--solvent", "tea"], ["'tea'"]),
        (["minimise", "in.pdb", "--forcefield", "no.xml"], ["no.xml"]),
        (["minimise", "in.pdb", "-o", "out.xyz"], ["out.xyz", ".pdb or .ent or .cif"]),
        (["minimise", "in.pdb", "-o", "in.pdb"], ["in.pdb", "--force"]),
        (["minimise", "in.pdb", "--trajectory", "t.avi"], ["t.avi"]),
        (["minimise", "cut.pdb"], ["cut.pdb", "line", "cut short"]),
        (["minimise", "trace.pdb"], ["trace.pdb", "C-alpha"]),
        (["minimise", "in.pdb", "-o", "one.pdb", "--trace", "one.pdb"], ["one.pdb", "two outputs"]),
        (["minimise", "in.pdb", "-o", "folder.pdb"], ["folder.pdb", "is a folder"]),
        (["minimise", "in.pdb", "-o", f"{'long' * 99}.pdb"], ["longlong", "too long", "check the name"]),
        (["validate", f"{'long' * 99}.pdb"], ["longlong", "too long", "check the name"]),
        (["minimise", "in.pdb", "-o", "in.pdb/out.pdb"], ["in.pdb/out.pdb", "not a folder"]),
        (["minimise", "in.pdb", "--trace", "/proc/t.csv"], ["/proc/t.csv", "cannot be written"]),
        (["minimise", "stars.pdb"], ["stars.pdb: line 3: x is '********'", "columns 31-38"]),
        (["minimise", "nan.pdb"], ["nan.pdb: line 3: x is 'nan'"]),
        (["minimise", "long.cif", "-o", "out.pdb"], ["'LONG'", "write .cif"]),
        (["compare", "in.pdb", "--methods", "kcm,nope"], ["'nope'"]),
        (["compare", "in.pdb", "-o", "in.pdb"], ["in.pdb", "not a folder"]),
        (["compare", "in.pdb", "--repeats", "0"], ["repeats 0"]),
        (["batch"], ["no structures found"]),
        (["batch", "*.xyz"], ["*.xyz", "matches no file"]),
        (["batch", "in.pdb", "-o", "."], ["in.pdb", "folder of their own"]),
        (["batch", "in.pdb", "-o", "in.pdb"], ["in.pdb", "not a folder"]),
        (["batch", "in.pdb", "--methods", "kcm,nope"], ["'nope'"]),
        (["batch", "in.pdb", "--time-limit", "0"], ["time-limit"]),
        (["info", "empty.pdb"], ["empty.pdb", "no atoms"]),
        (["info", "in.pdb", "--model", "all"], ["model all", "give its number"]),
        (["build", "AAZ", "-o", "a.pdb"], ["letter 3"]),
    ],
)
def test_bad_input_is_one_line_and_status_2_and_writes_nothing(protochain, arguments, words, tmp_path):
    # Under the archive's names nothing is renamed, and nothing said beside the one line.
    text = (STRUCTURES / "ala10.pdb").read_text().replace(" H   ALA A   1", " H1  ALA A   1")
    (tmp_path / "in.pdb").write_text(text)
    (tmp_path / "cut.pdb").write_text(text[: text.index("ATOM     40") + 30])
    lines = text.splitlines(True)
    for name, x in (("stars.pdb", "********"), ("nan.pdb", "     nan")):
        changed = f"{lines[2][:30]}{x}{lines[2][38:]}"
        (tmp_path / name).write_text("".join([*lines[:2], changed, *lines[3:]]))
    (tmp_path / "folder.pdb").mkdir()
    long = gemmi.read_pdb_string(text)
    long[0][0].name = "LONG"
    long.make_mmcif_document().write_file(str(tmp_path / "long.cif"))
    (tmp_path / "trace.pdb").write_text(
        "".join(line for line in text.splitlines(True) if line[12:16] == " CA ")
    )
    (tmp_path / "empty.pdb").write_text("")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    done = protochain(*arguments)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith("protochain: ") and done.stderr.count("\n") == 1
    assert all(word in done.stderr for word in words)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()} == before


def test_overlaps_are_named_before_a_run(protochain, tmp_path):
    lines = (STRUCTURES / "ala10.pdb").read_text().splitlines()
    atoms = [k for k, line in enumerate(lines) if line.startswith("ATOM")]
    first, last = lines[atoms[0]], next(lines[k] for k in atoms if lines[k][12:26] == " CB  ALA A   9")
    x = float(first[30:38]) + 0.5
    lines[lines.index(last)] = f"{last[:30]}{x:8.3f}{first[38:54]}{last[54:]}"
    (tmp_path / "in.pdb").write_text("\n".join(lines))
    shown = json.loads(protochain("info", "in.pdb", "--json").stdout)["overlaps"]
    assert any("atom CB of residue 9 ALA" in line and "atom N of residue 1 ALA" in line for line in shown)
    done = protochain("minimise", "in.pdb", "--max-evaluations", 5)
    assert "angstrom apart" in done.stderr and "turning bonds can part them" in done.stderr


def test_force_lets_the_input_be_replaced(protochain, tmp_path):
    path = tmp_path / "in.pdb"
    path.write_text((STRUCTURES / "ala10.pdb").read_text())
    assert protochain("minimise", "in.pdb", "-o", "in.pdb", "--force").returncode == 0
    assert "METHOD cartesian" in path.read_text()


@pytest.mark.parametrize(
    ("method", "sent"), [("lbfgs", signal.SIGTERM), ("hybrid", signal.SIGINT), ("openmm", signal.SIGINT)]
)
def test_a_signal_ends_with_the_best_so_far_written(method, sent, tmp_path):
    arguments = [
        "minimise", str(STRUCTURES / "1hel.pdb"), "-o", "out.pdb", "--trajectory", "t.dcd", "--json",
        "--method", method,
    ]  # fmt: skip
    process = subprocess.Popen(
        [*COMMAND, *arguments], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        # Whoever runs the tests in the background has SIGINT ignored, and children inherit that.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    # The trajectory appears when the run starts, and grows with it.
    until(lambda: any(path.stat().st_size > 200_000 for path in tmp_path.glob("t.part.dcd")), process)
    process.send_signal(sent)
    out, _ = process.communicate(timeout=HANG)
    record = json.loads(out)
    assert process.returncode == 130 and record["status"] == "interrupted"
    assert record["energy_end_reference_kj_mol"] < record["energy_start_kj_mol"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.pdb", "t.dcd"]


def test_what_is_taken_of_a_file_can_be_said(protochain, tmp_path):
    path = str(STRUCTURES / "4pti.pdb")
    facts = [
        json.loads(protochain("info", path, "--json", *options).stdout)
        for options in (
            (),
            ("--no-disulfide",),
            ("--disulfide", "A:5-A:55", "--no-disulfide"),
            ("--disulfide", "A:5-A:55,A:14-A:38", "--no-disulfide"),
            ("--keep", "water"),
            ("--ph", "2"),
        )
    ]
    assert [len(each["loops"]) for each in facts] == [3, 0, 1, 2, 3, 3]
    n_atoms = [each["n_atoms"] for each in facts]
    assert n_atoms[1] == n_atoms[0] + 6 and n_atoms[4] == n_atoms[0] + 180 and n_atoms[5] > n_atoms[0]
    for wrong, why in (
        (("--disulfide", "5-55"), "A:3-A:40"),
        (("--disulfide", "A:5-A:14"), "A:5 and A:55 are bonded, and no cysteine has two bonds"),
        (("--model", "one"), "give its number"),
        (("--model", "2"), "no model 2"),
        (("--ph", "15"), "pH 15"),
    ):
        done = protochain("info", path, *wrong)
        assert done.returncode == 2 and why in done.stderr and done.stderr.count("\n") == 1


def test_a_batch_lists_its_work_does_it_and_says_how_it_ended(protochain, tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.pdb").write_bytes((STRUCTURES / "ala10.pdb").read_bytes())
    (tmp_path / "in" / "b.pdb").write_text("nothing of use\n")
    listed = protochain("batch", "in", "--dry-run", "--methods", "lbfgs,kcm")
    assert listed.returncode == 0 and not (tmp_path / "batch").exists()
    assert [line.split()[:2] for line in listed.stdout.splitlines()] == [
        ["a", "lbfgs,kcm"],
        ["b", "lbfgs,kcm"],
    ]
    as_json = protochain("batch", "in", "--dry-run", "--methods", "lbfgs,kcm", "--json")
    assert json.loads(as_json.stdout)["structures"] == [
        {"structure": name, "methods": ["lbfgs", "kcm"], "input": str(tmp_path / "in" / f"{name}.pdb")}
        for name in "ab"
    ]
    work = ("batch", "in", "-o", "out", "--methods", "lbfgs", "--workers", 1)
    done = protochain(*work)
    assert done.returncode == 4 and "lbfgs: 1 converged, 1 refused" in done.stdout
    assert f"b: refused: {tmp_path}/in/b.pdb" in done.stdout and (tmp_path / "out" / "a.lbfgs.pdb").exists()
    refused = protochain(*work)
    assert refused.returncode == 2 and "holds a batch; --resume" in refused.stderr
    again = protochain(*work, "--resume", "--json")
    assert again.returncode == 4
    assert json.loads(again.stdout)["status"] == {"converged": 1, "refused": 1}
