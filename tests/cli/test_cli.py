import importlib
import io
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

from protochain.batches import Batch
from protochain.cli import app
from protochain.cli.options import batch_status


def test_help_loads_nothing_heavy():
    code = "import sys, protochain.cli; print(*sorted(m for m in sys.modules if '.' not in m))"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    assert not {"openmm", "numba", "numpy", "scipy", "pandas", "matplotlib", "mdtraj", "gemmi"} & set(loaded)
    shown = subprocess.run([*COMMAND, "--help"], capture_output=True, text=True)
    assert shown.returncode == 0
    assert all(word in shown.stdout for word in ("minimise", "compare", "info", "build"))


def test_json_is_one_object_and_the_files_are_there(protochain, tmp_path):
    done = protochain(
        "minimise", STRUCTURES / "3i40.pdb", "-o", "out.cif", "--json", "--max-evaluations", 30,
        "--trace", "t.csv", "--trajectory", "t.xtc", "--seed", 5, "--threads", 1
    )  # fmt: skip
    assert done.returncode == 3
    record = json.loads(done.stdout)
    promised = {
        "protochain", "input", "output", "method", "engine", "forcefield", "solvent", "hinges", "n_chains",
        "n_residues", "n_atoms", "n_bodies", "n_hinges", "energy_start_kj_mol", "energy_end_kj_mol",
        "energy_end_reference_kj_mol", "max_torque_end_kj_mol_rad", "rms_force_end_kj_mol_nm",
        "ca_rmsd_angstrom", "iterations", "evaluations", "seconds", "seconds_preparation", "status",
        "message", "left_out", "repairs", "seed", "threads",
    }  # fmt: skip
    assert promised <= set(record)
    assert (record["status"], record["seed"], record["threads"], record["n_chains"]) == ("budget", 5, 1, 2)
    assert record["left_out"] == {"waters": 35}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.cif", "t.csv", "t.xtc"]
    assert (tmp_path / "t.csv").read_text().startswith("iteration,evaluations,seconds,energy_kj_mol")


def test_minimise_says_what_it_did_and_ends_with_0_when_converged(protochain, tmp_path):
    done = protochain("minimize", STRUCTURES / "ala10.pdb")
    assert done.returncode == 0
    assert "converged" in done.stdout and "written: ala10.cartesian.pdb" in done.stdout
    assert (tmp_path / "ala10.cartesian.pdb").exists()
    assert max(map(len, done.stdout.splitlines())) <= 80


def test_compare_writes_the_folder(protochain, tmp_path):
    done = protochain("compare", STRUCTURES / "ala10.pdb", "--methods", "kcm,openmm", "--max-evaluations", 20)
    assert done.returncode == 3
    names = {path.name for path in (tmp_path / "ala10-comparison").iterdir()}
    assert {"report.html", "summary.csv", "traces.csv", "ala10.kcm.pdb", "ala10.openmm.pdb"} <= names


def test_info_describes_the_chain(protochain, tmp_path):
    done = protochain("info", STRUCTURES / "1ejg.pdb", "--json")
    facts = json.loads(done.stdout)
    assert done.returncode == 0 and (facts["n_residues"], len(facts["loops"])) == (46, 3)
    shown = protochain("info", STRUCTURES / "1ejg.pdb")
    assert "alternate location" in shown.stdout


def test_build_makes_a_file_that_loads(protochain, tmp_path):
    assert protochain("build", "GPW", "-o", "new/gpw.pdb").returncode == 0
    facts = json.loads(protochain("info", "new/gpw.pdb", "--json").stdout)
    assert facts["n_residues"] == 3 and not [line for line in facts["repairs"] if "added" in line]


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


def test_options_of_a_run_arrive_and_are_recorded(protochain, tmp_path):
    sample = STRUCTURES / "ala10.pdb"
    done = protochain(
        "minimise", sample, "--json", "--method", "lbfgs", "--move", "resid 3:8", "--max-rmsd", 0.5,
        "--restrain", "100 0", "--max-evaluations", 6, "--checkpoint", "c.npz", "-o", "a.pdb"
    )  # fmt: skip
    record = json.loads(done.stdout)
    assert (record["move"], record["max_rmsd_angstrom"]) == ("resid 3:8", 0.5)
    assert record["restraint_kj_mol_nm2"] == [100.0, 0.0] and record["status"] == "budget"
    done = protochain(
        "minimise", sample, "--json", "--method", "lbfgs", "--move", "resid 3:8", "--max-rmsd", 0.5,
        "--restrain", "100 0", "--resume", "c.npz", "-o", "a.pdb"
    )  # fmt: skip
    assert json.loads(done.stdout)["evaluations"] > 6
    done = protochain(
        "minimise", sample, "--json", "--method", "lbfgs", "--starts", 3, "--spread", 30, "-o", "b.pdb"
    )  # fmt: skip
    record = json.loads(done.stdout)
    assert len(record["starts"]) == record["starts_summary"]["n_starts"] == 3
    energies = [start["energy_end_reference_kj_mol"] for start in record["starts"]]
    assert record["energy_end_reference_kj_mol"] == min(energies)


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
            ("--keep", "water"),
            ("--ph", "2"),
        )
    ]
    assert [len(each["loops"]) for each in facts] == [3, 0, 1, 3, 3]
    n_atoms = [each["n_atoms"] for each in facts]
    assert n_atoms[1] == n_atoms[0] + 6 and n_atoms[3] == n_atoms[0] + 180 and n_atoms[4] > n_atoms[0]
    for wrong, why in (
        (("--disulfide", "5-55"), "A:3-A:40"),
        (("--disulfide", "A:5-A:14"), "A:5 and A:55 are bonded, and no cysteine has two bonds"),
        (("--model", "one"), "give its number"),
        (("--model", "2"), "no model 2"),
        (("--ph", "15"), "pH 15"),
    ):
        done = protochain("info", path, *wrong)
        assert done.returncode == 2 and why in done.stderr and done.stderr.count("\n") == 1


def test_every_model_can_be_minimised(protochain, tmp_path):
    lines = [line for line in (STRUCTURES / "ala10.pdb").read_text().splitlines(True) if line[:4] == "ATOM"]
    (tmp_path / "two.pdb").write_text(
        "".join(f"MODEL {n:8d}\n{''.join(lines)}ENDMDL\n" for n in (1, 5)) + "END\n"
    )
    done = protochain("minimise", "two.pdb", "--model", "all", "--json", "-o", "out.pdb")
    records = json.loads(done.stdout)["models"]
    assert [(each["model"], each["output"]) for each in records] == [(1, "out.1.pdb"), (5, "out.5.pdb")]
    assert records[0]["energy_end_kj_mol"] == records[1]["energy_end_kj_mol"]
    assert {path.name for path in tmp_path.iterdir()} == {"two.pdb", "out.1.pdb", "out.5.pdb"}
    assert protochain("minimise", "two.pdb", "--model", "all", "--trace", "t.csv").returncode == 2


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


def test_a_batch_takes_names_with_nuls_between_and_refuses_to_do_nothing(protochain, tmp_path, monkeypatch):
    for name in ("a b.pdb", "c\nd.pdb"):
        (tmp_path / name).write_bytes((STRUCTURES / "ala10.pdb").read_bytes())
    for flag in ("-0", "--null", "--json"):
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(b"a b.pdb\0c\nd.pdb\0")))
        listed = protochain("batch", "-", flag, "--dry-run")
        assert listed.returncode == 0, listed.stderr
        assert "a b" in listed.stdout and "d" in listed.stdout
    nothing = protochain("batch", "none.pdb", "-o", "out")
    assert nothing.returncode == 2 and "none.pdb: not found" in nothing.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("ends", "interrupted", "status"),
    [
        ((("converged", "a.pdb"), ("converged", "b.pdb")), False, 0),
        ((("converged", "a.pdb"), ("converged", "b.pdb")), True, 130),
        ((("converged", "a.pdb"), ("refused", "")), False, 4),
        ((("budget", "a.pdb"), ("stalled", "b.pdb")), False, 3),
        ((("refused", ""), ("killed", "")), False, 1),
        ((("refused", ""), ("killed", "")), True, 130),
        ((("refused", ""), ("refused", "")), False, 2),
        ((), False, 1),
    ],
)
def test_a_batchs_exit_status_tells_all_converged_from_some_results_from_none(
    ends, interrupted, status, tmp_path
):
    rows = "".join(f"{end},{output}\n" for end, output in ends)
    (tmp_path / "summary.csv").write_text(f"status,output\n{rows}")
    assert batch_status(Batch(tmp_path, interrupted)) == status


@pytest.mark.parametrize(
    ("ends", "status"),
    [
        (("converged", "converged"), 0), (("converged", "budget"), 3), (("budget", "converged"), 3),
        (("converged", "interrupted"), 130), (("interrupted",), 130),
    ],
)  # fmt: skip
def test_models_end_with_0_only_if_all_converged(ends, status, tmp_path, monkeypatch, capsys):
    atoms, _, _ = (STRUCTURES / "ala10.pdb").read_text().partition("END")
    (tmp_path / "two.pdb").write_text("".join(f"MODEL     {n:4}\n{atoms}ENDMDL\n" for n in (1, 2)))
    left = iter(ends)
    # The package has a command of the module's name.
    command = importlib.import_module("protochain.cli.minimise")
    monkeypatch.setattr(command, "_solved", lambda *_: {"status": next(left)})
    arguments = ["minimise", str(tmp_path / "two.pdb"), "--model", "all", "--json"]
    assert app([*arguments, "-o", str(tmp_path / "out.pdb")], standalone_mode=False) == status
    assert [each["status"] for each in json.loads(capsys.readouterr().out)["models"]] == list(ends)
