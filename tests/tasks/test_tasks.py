"""What people type, each line of table.txt, and what they must see."""

import json
import shlex
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from fixtures.command_line import run
from fixtures.samples import STRUCTURES
from typer.exceptions import TyperException

import protochain as pc
from protochain.cli import message_of

TABLE = Path(__file__).with_name("table.txt").read_text()
LINES = [line for line in TABLE.splitlines() if line[:1] not in ("", "#")]
TASKS = {line.split()[0]: line for line in LINES}


NOES = """data_nef_1l2y
save_nef_distance_restraint_list_noe
_nef_distance_restraint_list.potential_type square-well-parabolic
loop_
_nef_distance_restraint.restraint_id
_nef_distance_restraint.chain_code_1
_nef_distance_restraint.sequence_code_1
_nef_distance_restraint.residue_name_1
_nef_distance_restraint.atom_name_1
_nef_distance_restraint.chain_code_2
_nef_distance_restraint.sequence_code_2
_nef_distance_restraint.residue_name_2
_nef_distance_restraint.atom_name_2
_nef_distance_restraint.upper_limit
7 A 3 TYR HBx A 8 LYS HZ% 2.5
7 A 3 TYR HBx A 8 LYS HEx 2.5
8 A 6 TRP HE1 A 16 ARG H 6.0
stop_
save_
"""
"""Two distances, one of them ambiguous."""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The samples, and what tasks begin with beside them."""
    folder = tmp_path_factory.mktemp("tasks")
    for path in STRUCTURES.iterdir():
        (folder / path.name).symlink_to(path)
    s = pc.load(STRUCTURES / "ala10.pdb")
    rng = np.random.default_rng(0)
    frames = [s.with_positions(s.positions + rng.normal(0.0, 0.004, s.positions.shape)) for _ in range(3)]
    pc.save(frames, folder / "models.pdb")
    np.savez(folder / "frames.npz", positions=np.array([each.positions for each in frames]), unit="nm")
    pair = pc.load(STRUCTURES / "3i40.pdb")
    other = pair.residue_chain[pair.atom_residue] == "B"
    way = pair.positions[~other].mean(0) - pair.positions[other].mean(0)
    near = pair.positions + np.outer(other, 0.25 * way / np.linalg.norm(way))
    pc.save(pair.with_positions(near), folder / "near.pdb")
    backbone = ("N", "CA", "C", "O")
    lines = (STRUCTURES / "5awl.pdb").read_text().splitlines(keepends=True)
    bare = [line for line in lines if line[:4] != "ATOM" or line[12:16].strip() in backbone]
    (folder / "bare.pdb").write_text("".join(bare))
    lines = (STRUCTURES / "1ubq.pdb").read_text().splitlines(keepends=True)
    broken = [line for line in lines if line[:4] != "ATOM" or not 16 <= int(line[22:26]) <= 18]
    (folder / "broken.pdb").write_text("".join(broken))
    (folder / "empty.pdb").write_text("END\n")
    (folder / "r.txt").write_text("distance A:1:CA A:10:CA 0 30  # far\ndihedral phi@A:5 -70 -50 200\n")
    (folder / "noe.nef").write_text(NOES)
    records = [(STRUCTURES / f"{name}.sdf").read_text() for name in ("1P2Y_NCT", "1MEH_MOA")]
    (folder / "poses.sdf").write_text("".join([*records, "broken\n\n\n none\nM  END\n$$$$\n"]))
    (folder / "list.csv").write_text("path\n5awl.pdb\nala10.pdb\n")
    (folder / "seq.fasta").write_text(">A\nAGAVALASAK\n")
    heads = ("ala10, score=1.7", "T=0.1, sample=1, score=0.7", "T=0.1, sample=2, score=0.7")
    letters = ("AAAAAAAAAA", "AGAVALASAK", "AAAVALASAE")
    (folder / "designs.fa").write_text("".join(f">{h}\n{s}\n" for h, s in zip(heads, letters, strict=True)))
    (folder / "predicted").mkdir()
    for name in ("6bj9_model_0.cif.gz", "confidence_6bj9_model_0.json"):
        (folder / "predicted" / name).symlink_to(STRUCTURES / name)
    return folder


def outcome(words):
    """Exit status, and what was refused."""
    try:
        return run(*words) or 0, ""
    except (pc.ProtochainError, TyperException) as error:
        return 2, message_of(error) if isinstance(error, pc.ProtochainError) else error.format_message()
    except SystemExit as error:
        return error.code, ""


def test_there_are_a_hundred():
    assert len(TASKS) == len(LINES) >= 100


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
def test_it_is_done(name, made, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for path in made.iterdir():
        (tmp_path / path.name).symlink_to(path)
    told, command = TASKS[name].split(" : ", 1)
    _, statuses, *seen = shlex.split(told)
    if command.startswith(">>>"):
        assert eval(command[3:].strip(), {"pc": pc, "np": np})
        return
    status, refused = outcome(shlex.split(command))
    out, errors = capsys.readouterr()
    assert str(status) in statuses.split(","), (status, out, errors, refused)
    for each in seen:
        if each.startswith("="):
            assert each[1:] in out + errors + refused
        elif each.startswith("json:"):
            assert {*each[5:].split(",")} <= json.loads(out).keys()
        else:
            file, _, columns = each.partition(":")
            file, _, rows = file.partition("#")
            assert Path(file).stat().st_size
            assert not Path(file).is_symlink()
            if columns:
                assert {*columns.split(",")} <= {*pd.read_csv(file).columns}
            if rows:
                assert len(pd.read_csv(file)) == int(rows)
