"""Files of frames: their bytes while they grow, after a cut, and what is left when a run fails."""

import struct

import mdtraj
import numpy as np
import pytest
from fixtures.molecules import ring

import protochain as pc
from protochain.structure.formats.trajectory import TrajectoryFile, check_trajectory

FRAME = {".dcd": 3 * (14 * 4 + 8), ".XTC": 128, ".xtc": 128}
"""Bytes of a frame of 14 atoms: three records of floats between two counts; as OpenMM packs them."""
S = ring()


def frames(path):
    """Positions in nm, and times in ps or None."""
    if path.suffix == ".dcd":
        with mdtraj.formats.DCDTrajectoryFile(str(path)) as file:
            return file.read()[0] / 10.0, None
    with mdtraj.formats.XTCTrajectoryFile(str(path)) as file:
        x, time, _, _ = file.read()
        return x, time


def wrote(path, n, kept=None, **settings):
    file = TrajectoryFile(path, S, resume_at=kept, **settings)
    told = []
    for _ in range(n):
        file.append(S.positions + 0.5 * file.n_frames)
        told.append(file.sync())
    return file, told


def test_only_two_formats_of_any_case_are_known(tmp_path):
    for name in ("a.dcd", "a.DCD", "a.xtc", "a.XTC"):
        check_trajectory(tmp_path / name)
    with pytest.raises(pc.ProtochainError) as refused:
        TrajectoryFile(tmp_path / "new" / "a.trr", S)
    assert str(refused.value) == f"{tmp_path}/new/a.trr: unknown trajectory suffix '.trr'; use .dcd or .xtc"
    (tmp_path / "folder.dcd").mkdir()
    with pytest.raises(pc.ProtochainError, match="is a folder"):
        TrajectoryFile(tmp_path / "folder.dcd", S)
    assert [path.name for path in tmp_path.iterdir()] == ["folder.dcd"]


@pytest.mark.parametrize("suffix", [".dcd", ".xtc"])
def test_a_file_grows_by_a_frame_and_gets_its_name_at_the_end(suffix, tmp_path):
    path = tmp_path / "deep" / "er" / f"a{suffix}"
    file, told = wrote(path, 3, interval=0.25)
    part = path.with_name(f"a.part{suffix}")
    assert [n for n, _ in told] == [1, 2, 3] and list(path.parent.iterdir()) == [part]
    assert set(np.diff([size for _, size in told])) == {FRAME[suffix]} and told[-1][1] == part.stat().st_size
    file.finish()
    assert list(path.parent.iterdir()) == [path]
    x, time = frames(path)
    assert np.allclose(x, [S.positions + 0.5 * k for k in range(3)], atol=6e-4)
    if time is not None:
        assert time.tolist() == [0.0, 0.25, 0.5]
    else:
        # Time units of 20.45483 / sqrt(1000) of a picosecond each in the header.
        (step,) = struct.unpack("<f", path.read_bytes()[44:48])
        assert step == pytest.approx(0.25 / 0.04888821, rel=1e-6)


def test_frames_are_a_picosecond_apart_unless_told(tmp_path):
    wrote(tmp_path / "a.xtc", 2)[0].finish()
    assert frames(tmp_path / "a.xtc")[1].tolist() == [0.0, 1.0]


@pytest.mark.parametrize("suffix", [".dcd", ".xtc"])
@pytest.mark.parametrize("finished", [False, True])
def test_a_file_goes_on_from_what_a_checkpoint_knows(suffix, finished, tmp_path):
    path = tmp_path / f"a{suffix}"
    file, told = wrote(path, 3)
    file.finish() if finished else file.close()
    again, after = wrote(path, 2, kept=told[1])
    assert after[0] == (3, told[2][1]) and after[1][0] == 4
    if suffix == ".dcd":
        again.close()
        assert struct.unpack("<i", again.part.read_bytes()[8:12]) == (4,)
    again.finish()
    assert np.allclose(frames(path)[0], [S.positions + 0.5 * k for k in range(4)], atol=6e-4)
    assert list(tmp_path.iterdir()) == [path]


def test_what_lies_behind_a_checkpoint_is_cut_off_before_anything_is_written(tmp_path):
    path = tmp_path / "a.DCD"
    file, told = wrote(path, 3)
    file.close()
    again, _ = wrote(path, 0, kept=told[0])
    assert again.n_frames == 1 and again.part.stat().st_size == told[0][1]
    assert struct.unpack("<i", again.part.read_bytes()[8:12]) == (1,)
    again.close()
    # Another run begins anew.
    new, after = wrote(path, 1)
    assert after == told[:1]
    new.close()


@pytest.mark.parametrize("suffix", [".dcd", ".xtc"])
def test_a_frame_that_cannot_be_read_is_refused_before_the_file_is_cut(suffix, tmp_path):
    path = tmp_path / f"a{suffix}"
    file, told = wrote(path, 3)
    file.finish()
    damaged = bytearray(path.read_bytes())
    damaged[told[0][1] : told[0][1] + 4] = b"\x7f" * 4  # where the second frame begins
    path.write_bytes(damaged)
    with pytest.raises(pc.ProtochainError, match=r"cannot be continued \(.*\); start the run anew"):
        TrajectoryFile(path, S, resume_at=told[2])
    assert path.read_bytes() == damaged and list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("suffix", [".dcd", ".xtc"])
def test_a_file_that_lost_frames_is_refused(suffix, tmp_path):
    path = tmp_path / f"a{suffix}"
    file, told = wrote(path, 2)
    file.close()
    with file.part.open("r+b") as stream:
        stream.truncate(told[1][1] - 1)
    for there in (file.part, path):
        with pytest.raises(pc.ProtochainError) as refused:
            TrajectoryFile(path, S, resume_at=told[1])
        assert str(refused.value) == f"{there}: has lost frames since its checkpoint; start the run anew"
        file.part.unlink(missing_ok=True)


def test_what_is_no_dcd_file_of_the_structure_is_refused_before_it_is_cut(tmp_path):
    path = tmp_path / "a.dcd"
    file, told = wrote(path, 2)
    file.finish()
    whole = path.read_bytes()
    for damaged in (b"X" + whole[1:], whole[:4] + b"DROC" + whole[8:], b"\0" * len(whole)):
        path.write_bytes(damaged)
        with pytest.raises(pc.ProtochainError) as refused:
            TrajectoryFile(path, S, resume_at=told[1])
        assert str(refused.value).startswith(f"{path}: cannot be continued (")
        assert path.read_bytes() == damaged and list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("suffix", [".dcd", ".xtc"])
def test_an_empty_file_is_there_from_the_beginning_and_gone_after_a_failure(suffix, tmp_path):
    path = tmp_path / f"a{suffix}"
    with TrajectoryFile(path, S) as file:
        assert file.part.exists() and file.n_frames == 0 and file.sync()[0] == 0
    assert list(tmp_path.iterdir()) == [path]
    path.unlink()
    with pytest.raises(KeyError), TrajectoryFile(path, S) as file:
        file.append(S.positions)
        raise KeyError
    assert list(tmp_path.iterdir()) == []
    assert file._file is None or file._file.closed
