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


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["minimise", "in.pdb", "--spread", "30"], ["spread", "--starts 2"]),
        (["minimise", "in.pdb", "--starts", "3", "--resume", "c.npz"], ["--resume", "single start"]),
        (["minimise", "in.pdb", "--move", "rezid 5"], ["'rezid 5'", "cannot be read"]),
        (["minimise", "in.pdb", "--resume", "no.npz"], ["no.npz", "not found"]),
        (["minimise", "in.pdb", "-o", "out.xyz"], ["out.xyz", ".pdb or .ent or .cif"]),
        (["minimise", "in.pdb", "--trajectory", "t.avi"], ["t.avi"]),
        (["minimise", "cut.pdb"], ["cut.pdb", "line", "cut short"]),
        (["minimise", "in.pdb", "-o", "folder.pdb"], ["folder.pdb", "is a folder"]),
        (["minimise", "in.pdb", "-o", f"{'long' * 99}.pdb"], ["longlong", "too long", "Check the name"]),
        (["minimise", "in.pdb", "-o", "in.pdb/out.pdb"], ["in.pdb/out.pdb", "not a folder"]),
        (["minimise", "in.pdb", "--trace", "/proc/t.csv"], ["/proc/t.csv", "cannot be written"]),
        (["minimise", "stars.pdb"], ["stars.pdb: line 3: x is '********'", "columns 31-38"]),
        (["minimise", "long.cif", "-o", "out.pdb"], ["'LONG'", "write .cif"]),
        (["compare", "in.pdb", "-o", "in.pdb"], ["in.pdb", "not a folder"]),
        (["batch"], ["no structures found"]),
        (["batch", "*.xyz"], ["*.xyz", "matches no file"]),
        (["batch", "in.pdb", "-o", "."], ["in.pdb", "another output folder"]),
        (["batch", "in.pdb", "-o", "in.pdb"], ["in.pdb", "not a folder"]),
        (["batch", "in.pdb", "--methods", "kcm,nope"], ["'nope'"]),
        (["info", "in.pdb", "--model", "all"], ["model all", "give its number"]),
    ],
)
def test_bad_input_is_one_line_and_status_2_and_writes_nothing(protochain, arguments, words, tmp_path):
    # Nothing is renamed: at most the line of the structure comes before the refusal.
    text = (STRUCTURES / "ala10.pdb").read_text().replace(" H   ALA A   1", " H1  ALA A   1")
    (tmp_path / "in.pdb").write_text(text)
    (tmp_path / "cut.pdb").write_text(text[: text.index("ATOM     40") + 30])
    lines = text.splitlines(True)
    changed = f"{lines[2][:30]}********{lines[2][38:]}"
    (tmp_path / "stars.pdb").write_text("".join([*lines[:2], changed, *lines[3:]]))
    (tmp_path / "folder.pdb").mkdir()
    long = gemmi.read_pdb_string(text)
    long[0][0].name = "LONG"
    long.make_mmcif_document().write_file(str(tmp_path / "long.cif"))
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    done = protochain(*arguments)
    assert done.returncode == 2 and done.stdout == ""
    *account, refusal = done.stderr.splitlines()
    assert refusal.startswith("protochain: ")
    assert not account or (len(account) == 1 and account[0].endswith(" 10 residues, 103 atoms"))
    assert all(word in done.stderr for word in words)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()} == before


@pytest.mark.parametrize(("method", "sent"), [("hybrid", signal.SIGTERM), ("openmm", signal.SIGINT)])
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
