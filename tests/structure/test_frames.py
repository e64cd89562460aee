"""Frames read from files of other programs: the numbers, the boxes, and what is wrong with single frames."""

import io
import struct
import zipfile

import numpy as np
import pytest
from fixtures.frames import models, saved, shaken, trajectory
from fixtures.refusals import expect_refusal
from fixtures.samples import load
from fixtures.tolerances import IDEAL_NM, PDB_NM, SINGLE_NM, XTC_NM

import protochain as pc
from protochain.structure.formats.frames import Reading, backbones, frame_slice, open_frames

SMALL = "1l2y.pdb"
BOX = np.array([[5.0, 0.0, 0.0], [1.0, 4.5, 0.0], [0.5, -0.7, 4.0]])
"""nm; triclinic."""
FORMATS = {".xtc": XTC_NM, ".trr": SINGLE_NM, ".dcd": SINGLE_NM, ".nc": SINGLE_NM}


@pytest.fixture
def x():
    return shaken(load(SMALL), 7)


@pytest.mark.parametrize("suffix", FORMATS)
def test_frames_of_other_programs_are_read_in_order_with_their_box(tmp_path, x, suffix):
    saved(load(SMALL), x, tmp_path / f"x{suffix}", BOX)
    frames = open_frames(tmp_path / f"x{suffix}")
    assert (len(frames), frames.n_atoms) == (7, 304)
    for again in range(2):  # It may be read more than once.
        read = [*frames]
        assert [each.index for each in read] == [*range(7)], again
        assert all(np.abs(each.x - own).max() < FORMATS[suffix] for each, own in zip(read, x, strict=True))
        # Of DCD and NetCDF lengths and angles are stored, with the first vector along x.
        assert all(np.allclose(each.box, BOX, atol=1e-5) for each in read)
    # Nothing is written beside it.
    assert [path.name for path in tmp_path.iterdir()] == [f"x{suffix}"]


@pytest.mark.parametrize("suffix", FORMATS)
def test_frames_without_a_box_have_none(tmp_path, x, suffix):
    saved(load(SMALL), x, tmp_path / f"x{suffix}")
    assert [each.box for each in open_frames(tmp_path / f"x{suffix}")] == [None] * 7


@pytest.mark.parametrize("suffix", [".pdb", ".cif", ".pdb.gz"])
def test_models_are_frames(tmp_path, x, suffix):
    frames = open_frames(models(load(SMALL), x, tmp_path / f"x{suffix}"))
    assert len(frames) == 7 and len(frames.names) == 304
    assert all(np.abs(each.x - own).max() < PDB_NM for each, own in zip(frames, x, strict=True))


def test_a_model_of_other_atoms_is_named_and_the_others_are_read(tmp_path, x):
    path = models(load(SMALL), x[:3], tmp_path / "x.pdb")
    lines, of_model = [], 0
    for line in path.read_text().splitlines(keepends=True):
        of_model += line.startswith("MODEL ")
        if not (of_model == 2 and line[12:26] == " CB  TRP A   6"):
            lines.append(line)
    path.write_text("".join(lines))
    first, second, third = open_frames(path)
    assert second.x is None and "A/6/TRP/CB" in second.error
    assert first.x is not None and third.x is not None


@pytest.mark.parametrize("suffix", [".xtc", ".trr", ".dcd"])
def test_a_file_that_is_cut_short_names_the_frame_in_which_it_ends(tmp_path, x, suffix):
    path = tmp_path / f"x{suffix}"
    saved(load(SMALL), x, path)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * 0.62)])
    read = [*open_frames(path)]
    assert [each.x is None for each in read] == [False] * 4 + [True]
    assert read[-1].index == 4 and "ends" in read[-1].error
    assert np.abs(read[3].x - x[3]).max() < FORMATS[suffix]


XTC_SAME, TRR_SAME = struct.pack(">ii", 1995, 304), struct.pack(">3i", 1993, 13, 12) + b"GMX_trn_file"


@pytest.mark.parametrize(
    ("suffix", "same", "places"),
    [
        (".xtc", XTC_SAME, (52, 60, 84, 88)),  # Number of atoms, limits, size of differences, bytes.
        (".trr", TRR_SAME, (24, 32, 52, 60, 64)),  # Parameters, box, positions, forces, number of atoms.
    ],
)
def test_a_damaged_head_of_a_frame_costs_that_frame_alone(tmp_path, x, suffix, same, places):
    path = tmp_path / f"x{suffix}"
    saved(load(SMALL), x, path)
    data = bytearray(path.read_bytes())
    begins = [i for i in range(0, len(data), 4) if data[i : i + len(same)] == same]
    for what in places:
        broken = bytearray(data)
        broken[begins[2] + what : begins[2] + what + 4] = b"\x7f\xff\xff\xff"
        path.write_bytes(broken)
        read = [*open_frames(path)]
        assert [each.index for each in read if each.x is None] == [2], what
        assert np.abs(read[3].x - x[3]).max() < FORMATS[suffix] and len(read) == 7


@pytest.mark.parametrize("filled", [b"\xff", b"\0"])
def test_a_frame_that_packs_other_atoms_than_it_says_is_not_unpacked(tmp_path, x, filled):
    """Runs of near atoms beyond the last, and atoms beyond the last byte."""
    path = tmp_path / "x.xtc"
    saved(load(SMALL), x, path)
    data = bytearray(path.read_bytes())
    begins = [i for i in range(0, len(data), 4) if data[i : i + 8] == XTC_SAME]
    begin, end = begins[2] + 92, begins[3]
    data[begin:end] = filled * (end - begin)
    path.write_bytes(data)
    assert [each.index for each in open_frames(path) if each.x is None] == [2]


def test_an_archive_has_no_more_frames_than_its_bytes(tmp_path, x):
    head, unit = io.BytesIO(), io.BytesIO()
    shape = {"descr": "<f8", "fortran_order": False, "shape": (10**9, 103, 3)}
    np.lib.format.write_array_header_1_0(head, shape)
    np.save(unit, np.array("nm"))
    with zipfile.ZipFile(tmp_path / "huge.npz", "w") as archive:
        archive.writestr("positions.npy", head.getvalue() + bytes(1000))
        archive.writestr("unit.npy", unit.getvalue())
    with pytest.raises(pc.ProtochainError, match=r"huge\.npz"):
        open_frames(tmp_path / "huge.npz")
    np.savez_compressed(tmp_path / "x.npz", positions=x, unit="nm")
    assert len(open_frames(tmp_path / "x.npz")) == len(x)


def test_arrays_and_objects_of_other_libraries_are_frames(x):
    structure = load(SMALL)
    for source in (x, trajectory(structure, x)):
        frames = open_frames(source, "1:6:2")
        assert [each.index for each in frames] == [1, 3, 5]
        assert all(np.abs(each.x - x[each.index]).max() < SINGLE_NM for each in frames)
    universe = pc.to_mdanalysis(structure)
    universe.load_new(10.0 * x, order="fac")
    read = [*open_frames(universe)]
    assert len(read) == 7 and np.abs(read[6].x - x[6]).max() < SINGLE_NM
    with pytest.raises(pc.ProtochainError, match=r"\(7, 304\)"):
        open_frames(x[:, :, 0])


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
@pytest.mark.parametrize(("name", "unit", "scale"), [("positions", "nm", 1.0), ("pos", "angstrom", 10.0)])
def test_archives_of_numpy_are_read_frame_by_frame_in_any_order(tmp_path, x, save, name, unit, scale):
    save(tmp_path / "x.npz", **{name: scale * x, "unit": unit})
    frames = open_frames(tmp_path / "x.npz")
    reading = Reading(frames)
    for k in (0, 5, 2, 2, 6):
        np.testing.assert_allclose(reading.at(k).x, x[k], rtol=1e-15)


def test_archives_that_do_not_say_what_they_hold_are_refused_in_a_line(tmp_path, x):
    for arrays, said in (
        ({"pos": x}, "unit"), ({"pos": x, "unit": "feet"}, "feet"), ({"xyz": x, "unit": "nm"}, "xyz"),
        ({"pos": x[0], "unit": "nm"}, "(304, 3)"),
        ({"pos": x, "node_orientations": x, "sequence": "AAA"}, "node_orientations"),
    ):  # fmt: skip
        np.savez(tmp_path / "x.npz", **arrays)
        with pytest.raises(pc.ProtochainError) as refused:
            open_frames(tmp_path / "x.npz")
        assert said in str(refused.value) and "\n" not in str(refused.value)
    (tmp_path / "x.npz").write_bytes(b"PK no archive")
    with pytest.raises(pc.ProtochainError, match=r"x\.npz"):
        open_frames(tmp_path / "x.npz")


def test_residues_frames_put_backbones_where_the_crystal_has_them(tmp_path):
    """BioEmu's archives: C-alphas and rotations whose columns are along C, across to N, and upright."""
    structure = load("1ubq.pdb")
    n, ca, c, o = (structure.positions[structure.atom_name == name][:76] for name in ("N", "CA", "C", "O"))
    along = (c - ca) / np.linalg.norm(c - ca, axis=1)[:, None]
    across = (n - ca) - np.sum((n - ca) * along, axis=1)[:, None] * along
    across /= np.linalg.norm(across, axis=1)[:, None]
    turn = np.stack([along, across, np.cross(along, across)], axis=2)
    made = backbones(ca, turn).reshape(-1, 4, 3)
    assert np.abs(np.linalg.norm(made[:, 1] - ca, axis=1)).max() == 0.0
    assert max(np.linalg.norm(made[:, k] - its, axis=1).max() for k, its in ((0, n), (2, c))) < IDEAL_NM
    # The plane of a peptide bond leaves O one place; only the last residue has no next one.
    assert np.linalg.norm(made[:-1, 3] - o[:-1], axis=1).max() < 2 * IDEAL_NM
    sequence = "MQIFVKTLTGKTITLEVEPSDTIENVKAKIQDKEGIPPDQQRLIFAGKQLEDGRTLSDYNIQKESTLHLVLRLRGG"
    np.savez(tmp_path / "b.npz", pos=ca[None], node_orientations=turn[None], sequence=sequence)
    (frame,) = frames = open_frames(tmp_path / "b.npz")
    assert frames.sequence == sequence and np.array_equal(frame.x, made.reshape(-1, 3))


@pytest.mark.parametrize(
    ("asked", "chosen"),
    [
        ("all", range(7)), (None, range(7)), ("0", range(1)), (3, range(3, 4)), ("-1", range(6, 7)),
        ("::3", range(0, 7, 3)), ("1:5:2", range(1, 5, 2)), ("4:", range(4, 7)), (":-5", range(2)),
        (slice(2, 4), range(2, 4)),
    ],
)  # fmt: skip
def test_frames_are_chosen_as_python_has_it(asked, chosen):
    assert range(7)[frame_slice(asked, "frames")] == chosen


@pytest.mark.parametrize("asked", ["", "abc", "1:2:3:4", "::0", "1,3", ":::", "1.5", "--1"])
def test_what_chooses_no_frames_is_refused(asked):
    with expect_refusal("frames"):
        frame_slice(asked, "frames")


def test_files_that_are_no_trajectories_are_refused_in_a_line(tmp_path, x):
    with pytest.raises(pc.ProtochainError, match=r"x\.foo.*\.xtc"):
        open_frames(tmp_path / "x.foo")
    with pytest.raises(pc.ProtochainError, match="not found"):
        open_frames(tmp_path / "absent.xtc")
    for suffix in FORMATS:
        (tmp_path / f"x{suffix}").write_bytes(
            b"no such thing, but long enough to hold a head of some kind" * 9
        )
        with pytest.raises(pc.ProtochainError) as refused:
            [*open_frames(tmp_path / f"x{suffix}")]
        assert f"x{suffix}" in str(refused.value) and "\n" not in str(refused.value)
        (tmp_path / f"x{suffix}").write_bytes(b"")
        with pytest.raises(pc.ProtochainError):
            open_frames(tmp_path / f"x{suffix}")
    with pytest.raises(pc.ProtochainError, match="none of its 7"):
        open_frames(x, "9:")
    with pytest.raises(pc.ProtochainError, match="no frames"):
        open_frames(x[:0])
