"""Commands that are killed at any time and resumed leave the same files and rows as those that were not."""

import os
import random
import signal
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
from fixtures.samples import ROOT

pytestmark = pytest.mark.slow
TIMES = ("seconds", "memory", "_at", "date", "speed", "ns_per_day", "threads")
"""Parts of names of columns that differ between runs."""
COMMANDS = {
    "batch": "batch IN --methods lbfgs --tolerance 1 --workers 2 -o OUT/run",
    "frames": "relax IN/ala10.pdb --trajectory FRAMES --workers 2 -o OUT/relaxed.dcd",
    "search": "search YGGFM --evaluations 4000 --walkers 2 --workers 2 -o OUT/run",
    "simulate": "simulate IN/1l2y.pdb --steps 1500 --every 10 --checkpoint-every 1 --threads 1 -o OUT/run",
}


def begun(command, output, made, *more):
    """A command as the shell starts it, in a group of its own."""
    words = command.replace("IN", str(made / "in")).replace("FRAMES", str(made / "run/trajectory.dcd"))
    return subprocess.Popen(
        [sys.executable, "-m", "protochain", *words.replace("OUT", str(output)).split(), *more],
        start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
    )  # fmt: skip


def ended(process):
    """Its status, which is 0 or 3; what it printed is shown if it is another."""
    _, said = process.communicate()
    assert process.returncode in (0, 3), said.decode()
    return process.returncode


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Structures, and frames of one."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "in").mkdir()
    for name in ("ala10", "1l2y", "1vii"):
        (folder / f"in/{name}.pdb").write_bytes((ROOT / f"structures/{name}.pdb").read_bytes())
    command = "simulate IN/ala10.pdb --steps 1200 --every 4 --threads 1 -o OUT/run"
    assert ended(begun(command, folder, folder)) == 0
    return folder


def left(folder: Path):
    """Of each file what does not depend on time: of tables other columns, of structures and frames all.

    The head of DCD has the time at which it was made.
    """
    found = {}
    for path in sorted(each for each in folder.rglob("*") if each.is_file()):
        name = str(path.relative_to(folder)).removeprefix("run/")
        if path.suffix == ".csv":
            table = pd.read_csv(path)
            kept = [column for column in table if not any(part in column for part in TIMES)]
            lines = table[kept].to_csv(index=False).splitlines()
            found[name] = [line for line in lines if "seconds" not in line]
        else:
            kept = path.suffix in (".pdb", ".cif", ".dcd")
            found[name] = path.read_bytes()[276 * (path.suffix == ".dcd") :] if kept else b""
    return found


@pytest.mark.parametrize("name", COMMANDS)
def test_kills_change_nothing(name, made, tmp_path):
    """Up to five, each after some seconds drawn at random; what had begun to write is resumed."""
    status = ended(begun(COMMANDS[name], tmp_path / "whole", made))
    draw = random.Random(name)
    more, killed, end = (), 0, None
    while killed < 5 and end is None:
        process = begun(COMMANDS[name], tmp_path / "killed", made, *more)
        try:
            process.wait(draw.uniform(1.0, 4.0))
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            killed += 1
        else:
            end = ended(process)
        more = ("--resume",) if [name for name in left(tmp_path / "killed") if name[0] != "."] else ()
    assert killed
    if end is None:
        end = ended(begun(COMMANDS[name], tmp_path / "killed", made, *more))
    assert end == status
    whole, resumed = left(tmp_path / "whole"), left(tmp_path / "killed")
    assert list(whole) == list(resumed)
    assert [each for each in whole if whole[each] != resumed[each]] == []
