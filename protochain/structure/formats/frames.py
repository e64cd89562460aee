"""Frames of ensembles and trajectories, read one by one, so that memory does not grow with their number.

MDAnalysis reads XTC, TRR, DCD and NetCDF, gemmi the models of PDB and mmCIF files, numpy NPZ. A frame that
cannot be read contains the reason, and the following frames are still read.
"""

import math
import re
import struct
import warnings
import zipfile
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import IO, Any

import numpy as np

from protochain.core.arrays import Floats, Integers, Value
from protochain.core.checkpoints import check_sizes, head_of
from protochain.core.checks import brief, plain
from protochain.core.errors import Argument, ProtochainError, StructureError, refusal
from protochain.core.storage import regular
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.formats.files import SUFFIXES, format_of, in_file_order, parse

ALL = "all"
"""Selection of all frames."""
_THINNEST = 0.3  # nm. Lower limit of the width of a periodic box.
_TRR_HEAD = 84
_UNITS = {"nm": 1.0, "nanometer": 1.0, "angstrom": ANGSTROM_PER_NM, "A": ANGSTROM_PER_NM}
_SELECTION = re.compile(
    r"(?P<start>-?\d{1,12})?(?P<several>:(?P<stop>-?\d{1,12})?(:(?P<step>\d{1,12})?)?)?(?<!^)"
)
XTC_HEAD, _XTC_RAW, _XTC_FEW, _XTC_MAGIC = 92, 56, 9, 1995
"""Bytes before compressed and before raw coordinates, largest number of atoms with raw coordinates, magic."""
_XTC_SPAN, _XTC_SIZES, _XTC_APART = 1 << 30, range(9, 73), 0xFFFFFF
"""Largest span of coordinates, bits of small differences, largest span with axes packed together."""
_N, _C = np.array([-0.0525, 0.1363, 0.0]), np.array([0.1526, 0.0, 0.0])
"""nm: N and C in the frame of a residue, CA at its origin (Jumper et al., Nature 596:583, 2021, supplement
1.8.4). Residues differ by 0.0002."""
_C_O = 0.123  # nm. Length of C=O.


@dataclass(frozen=True, eq=False)
class Frame(Value):
    """One frame of an ensemble."""

    index: int  # Index among all frames of the source, from 0.
    x: Floats | None  # (n, 3) nm: Positions of the atoms of the file. None if unreadable.
    box: Floats | None = None  # (3, 3) nm: Vectors of the periodic box as rows. None without a box.
    time: float | None = None  # ps.
    error: str = ""  # Reason why the frame is unreadable.


@dataclass(frozen=True, eq=False)
class Frames:
    """Frames of an ensemble, or a subset. They can be iterated more than once."""

    source: str  # Name of the source, for messages.
    count: int  # Number of all frames of the source.
    n_atoms: int
    read: Callable[[Iterable[int]], Iterator[Frame]]  # Frame indices -> frames, lazily.
    chosen: Sequence[int]  # Indices of the selected frames.
    names: tuple[str, ...] = ()  # Atom names in the format of ``Origin``. Empty if unknown.
    path: Path | None = None  # File from which other processes can read the frames.
    # Sequence of a protein whose frames have only N, CA, C and O of each residue. X if unknown.
    sequence: str = ""

    def __len__(self) -> int:
        return len(self.chosen)

    def __iter__(self) -> Iterator[Frame]:
        return self.read(self.chosen)

    def without_first(self, n: int) -> "Frames":
        """Skip the first n selected frames."""
        return replace(self, chosen=self.chosen[n:])

    def select(self, spec: Any) -> "Frames":
        """Select frames by ``all``, a number, ``START:STOP:STEP`` as in Python, or a list of these."""
        words = spec.split(",") if isinstance(spec, str) else spec
        parts = words if isinstance(words, list | tuple) else [words]
        ranges = [range(self.count)[frame_slice(part, "frames")] for part in parts]
        if not parts or not all(ranges):
            raise ProtochainError(
                f"{self.source}: frames {spec}: none of its {self.count} frames; give others"
            )
        chosen: Sequence[int] = ranges[0] if len(ranges) == 1 else [k for indices in ranges for k in indices]
        return replace(self, chosen=chosen)


class Reading:
    """Random access to frames of a file that stays open."""

    def __init__(self, frames: Frames) -> None:
        self._requests: deque[int] = deque()
        self._read = frames.read(iter(self._requests.popleft, None))

    def at(self, k: int) -> Frame:
        """Read a frame."""
        self._requests.append(k)
        return next(self._read)


def frame_slice(spec: Any, name: str) -> slice:
    """Parse one part of a selection of :meth:`Frames.select`."""
    if spec is None or spec == ALL or isinstance(spec, slice):
        return spec if isinstance(spec, slice) else slice(None)
    if isinstance(spec, range):
        return slice(spec.start, spec.stop, spec.step)
    match = _SELECTION.fullmatch("".join(str(spec).split()))
    if not match or match["step"] == "0":
        raise ProtochainError(
            Argument(name), f" {brief(spec)}: give all, a number, or START:STOP:STEP, as 0:1000:10"
        )
    start, stop, step = (int(text) if (text := match[part]) else None for part in ("start", "stop", "step"))
    if match["several"] is None:
        return slice(start, None if start == -1 else (start or 0) + 1)
    return slice(start, stop, step)


def trajectories(folder: Path) -> list[Path]:
    """Return trajectories below a folder, by suffix, except ``.npz``, which has other uses."""
    return sorted(path for path in folder.rglob("*") if path.suffix.lower() in {*_READERS} - {".npz"})


def open_frames(source: Any, frames: Any = None) -> Frames:
    """Open an ensemble."""
    ensemble = source if isinstance(source, Frames) else _open_source(source)
    if not ensemble.count:
        raise StructureError(f"{ensemble.source}: holds no frames; give a trajectory, or a file with models")
    return ensemble if frames is None else ensemble.select(frames)


def _open_source(source: Any) -> Frames:
    if isinstance(source, str | Path):
        path = Path(source)
        reader = _models if format_of(path) else _READERS.get(path.suffix.lower())
        if reader is None:
            suffixes = ", ".join([*_READERS, *SUFFIXES])
            raise StructureError(
                f"{path}: unknown suffix {path.suffix!r} of a trajectory; use one of {suffixes}"
            )
        if not path.exists():
            raise StructureError(f"{path}: not found; check the name")
        return reader(regular(path))
    if hasattr(source, "xyz") and hasattr(source, "unitcell_vectors"):
        return _from_arrays("frames", source.xyz, source.unitcell_vectors, source.time)
    if hasattr(source, "atoms") and hasattr(source.atoms, "universe"):
        return _from_universe(source.atoms)
    try:
        x = np.asarray(plain(source, "nanometer", "frames"), dtype=float)
    except (TypeError, ValueError):
        raise refusal("frames", brief(source), "give positions (frames, atoms, 3) in nm, or a file") from None
    if x.ndim != 3 or x.shape[2] != 3:
        raise StructureError(
            f"frames: has shape {x.shape}; give positions (frames, atoms, 3) in nm, or a file"
        )
    return _from_arrays("frames", x)


def _frames_of(source: str | Path, count: int, n_atoms: int, read: Any, **fields: Any) -> Frames:
    path = source if isinstance(source, Path) else None
    return Frames(str(source), count, n_atoms, read, range(count), path=path, **fields)


def _from_arrays(source: str, x: Any, boxes: Any = None, times: Any = None) -> Frames:
    def frame(k: int) -> Frame:
        box = None if boxes is None else _box(boxes[k])
        return Frame(k, _copy_nm(x[k]), box, None if times is None else float(times[k]))

    return _frames_of(source, len(x), x.shape[1], partial(map, frame))


def _copy_nm(x: Any, scale: float = 1.0) -> Floats:
    """Copy positions in nm, because readers reuse their memory."""
    return np.array(x, dtype=float) / scale


def _box(vectors: Any) -> Floats | None:
    """Return box vectors, nm, or None for zeros or 1 angstrom, which mean that a file has no box."""
    box = np.array(vectors, dtype=float).reshape(3, 3)
    is_box = np.isfinite(box).all() and np.linalg.norm(box, axis=1).min() > _THINNEST
    return box if is_box and abs(np.linalg.det(box)) > _THINNEST**3 else None


def _from_universe(atoms: Any) -> Frames:
    trajectory = atoms.universe.trajectory

    def frame(k: int) -> Frame:
        step = trajectory[k]
        return Frame(k, _copy_nm(atoms.positions, ANGSTROM_PER_NM), _step_box(step), float(step.time))

    return _frames_of("frames", len(trajectory), len(atoms), partial(map, frame))


def _step_box(step: Any) -> Floats | None:
    return None if step.dimensions is None else _box(step.triclinic_dimensions / ANGSTROM_PER_NM)


def _xdr(path: Path, kind: "_Kind") -> Frames:
    """Open XTC or TRR. MDAnalysis's own readers would write an offset file into the user's folder."""
    from MDAnalysis.lib.formats import libmdaxdr

    begins, damaged, n_atoms = _xdr_frames(path, kind)

    def read(chosen: Iterable[int]) -> Iterator[Frame]:
        with getattr(libmdaxdr, f"{kind.name}File")(str(path)) as file, path.open("rb") as raw:
            file.set_offsets(begins)
            for k in chosen:
                reason = damaged.get(k, "")
                try:
                    if not reason and not kind.is_sound(raw, int(begins[k]), n_atoms):
                        reason = "it is damaged"
                    if not reason:
                        file.seek(k)
                        frame = file.read()
                except (OSError, EOFError, StopIteration, RuntimeError, ValueError) as error:
                    reason = f"cannot be read ({error})"
                if reason:
                    yield Frame(k, None, error=reason)
                else:
                    yield Frame(k, _copy_nm(frame.x), _box(frame.box), float(frame.time))

    return _frames_of(path, len(begins), n_atoms, read)


def _xdr_frames(path: Path, kind: "_Kind") -> tuple[Integers, dict[int, str], int]:
    """Return offsets of frames, errors of frames that would crash the library, and the number of atoms."""
    with path.open("rb") as raw, _reading_errors(path), mmap(raw.fileno(), 0, access=ACCESS_READ) as data:
        size, begins, damaged = len(data), list[int](), dict[int, str]()
        head, at = data[: kind.same], 0
        if size < kind.atoms + 4 or not head.startswith(kind.magic):
            raise StructureError(f"{path}: is no {kind.name} file; give a trajectory")
        (n_atoms,) = struct.unpack(">i", data[kind.atoms : kind.atoms + 4])
        while at < size:
            begins.append(at)
            after = at + kind.end(data[at : at + kind.head], n_atoms)
            if not (at < after <= size and data[after : after + kind.same] in (b"", head)):
                damaged[len(begins) - 1] = "the file ends within it" if after > size else "it is damaged"
                # Search for the next frame.
                following = data.find(head, at + 8)
                after = size if following < 0 else following
            at = after
    return np.array(begins, dtype=np.int64), damaged, n_atoms


def xtc_end(head: bytes, n_atoms: int) -> int:
    """Return the length in bytes of an XTC frame from its head, or 0 if the head is invalid."""
    if len(head) < 8 or struct.unpack(">2i", head[:8]) != (_XTC_MAGIC, n_atoms):
        return 0
    if n_atoms <= _XTC_FEW:
        return _XTC_RAW + 12 * n_atoms
    if len(head) < XTC_HEAD:
        return XTC_HEAD
    n_repeated, _, *limits, small, n_bytes = struct.unpack(">if8i", head[52:])
    spans = [high - low for low, high in zip(limits[:3], limits[3:], strict=True)]
    is_sound = n_repeated == n_atoms and min(spans) >= 0 and max(spans) < _XTC_SPAN and small in _XTC_SIZES
    return XTC_HEAD + 4 * -(-n_bytes // 4) if is_sound and 0 <= n_bytes <= 16 * n_atoms else 0


def _xtc_is_sound(file: IO[bytes], begin: int, n_atoms: int) -> bool:
    """Return whether a compressed frame has all atoms within its bytes, which the library does not check."""
    # Each group is a full atom and one bit, which announces a new number of near atoms and of their bits.
    if n_atoms <= _XTC_FEW:
        return True
    file.seek(begin)
    head = file.read(XTC_HEAD)
    *limits, small, n_bytes = struct.unpack(">8i", head[60:])
    spans = [high - low + 1 for low, high in zip(limits[:3], limits[3:], strict=True)]
    full = sum(map(int.bit_length, spans)) if max(spans) > _XTC_APART else math.prod(spans).bit_length()
    data, at, i, run = file.read(n_bytes) + b"\0\0", 0, 0, 0
    while i < n_atoms and small in _XTC_SIZES and at + full < 8 * n_bytes:
        at += full
        six = (data[at >> 3] << 8 | data[(at >> 3) + 1]) >> 10 - (at & 7) & 63
        at += 6 if six > 31 else 1
        step = (six & 31) % 3 if six > 31 else 1
        run = (six & 31) // 3 if six > 31 else run
        at, i = at + run * small, i + 1 + run
        small += step - 1
    return i == n_atoms and at <= 8 * n_bytes


def _trr_end(head: bytes, n_atoms: int) -> int:
    """Return the length in bytes of a TRR frame from its head, or 0 if the head is invalid."""
    if len(head) < _TRR_HEAD:
        return 0
    ir, e, box, virial, pressure, top, sym, x, v, f, n, *_ = struct.unpack(">13i", head[24:76])
    if n == n_atoms and box + x + v + f and not (ir or e or top or sym):
        for real in (4, 8):
            if {box, virial, pressure} <= {0, 9 * real} and {x, v, f} <= {0, 3 * n_atoms * real}:
                return 76 + 2 * real + box + virial + pressure + x + v + f
    return 0


@dataclass(frozen=True)
class _Kind:
    """An XDR trajectory format."""

    name: str
    magic: bytes  # First bytes of a frame.
    same: int  # Number of first bytes that all frames share.
    atoms: int  # Offset of the number of atoms.
    head: int  # Number of bytes for ``end``.
    end: Callable[[bytes, int], int]
    is_sound: Callable[[IO[bytes], int, int], bool] = lambda *_: True


_XTC = _Kind("XTC", struct.pack(">i", _XTC_MAGIC), 8, 4, XTC_HEAD, xtc_end, _xtc_is_sound)
_TRR = _Kind("TRR", struct.pack(">3i", 1993, 13, 12) + b"GMX_trn_file", 24, 64, _TRR_HEAD, _trr_end)


def _mdanalysis(path: Path, kind: str) -> Frames:
    """Open DCD or NetCDF with the readers of MDAnalysis."""
    from MDAnalysis.coordinates import DCD, TRJ

    make = DCD.DCDReader if kind == "DCD" else TRJ.NCDFReader
    with path.open("rb") as raw:
        head = raw.read(8)
    # Check first: for other files the readers write a second warning when they are deleted.
    if not (head[4:] == b"CORD" if kind == "DCD" else head[:3] == b"CDF"):
        raise StructureError(f"{path}: is no {kind} file; give a trajectory")

    @contextmanager
    def open_reader() -> Iterator[Any]:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with _reading_errors(path):
                if kind == "DCD":  # If opening fails, the reader would warn again when it is deleted.
                    DCD.DCDFile(str(path)).close()
                file = make(str(path))
        try:
            yield file
        finally:
            with suppress(Exception):  # scipy's NetCDF warns about views of its memory.
                file.close()

    with open_reader() as file:
        count, n_atoms = len(file), file.n_atoms
    total = max(count, _dcd_frame_count(path) if kind == "DCD" else 0)
    ends_within = total > count

    def read(chosen: Iterable[int]) -> Iterator[Frame]:
        with open_reader() as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for k in chosen:
                if k == count:
                    reason = f"the file ends before it is whole, and should have {total} frames"
                    yield Frame(k, None, error=reason)
                    continue
                try:
                    step = file[k]
                except (OSError, EOFError, ValueError, RuntimeError, IndexError) as error:
                    yield Frame(k, None, error=f"cannot be read ({error})")
                    continue
                yield Frame(k, _copy_nm(step.positions, ANGSTROM_PER_NM), _step_box(step), float(step.time))

    return _frames_of(path, count + ends_within, n_atoms, read)


def _dcd_frame_count(path: Path) -> int:
    """Return the number of frames in a DCD header. A truncated file has fewer."""
    with path.open("rb") as file:
        head = file.read(12)
    order = "little" if head[:4] == b"T\0\0\0" else "big"
    stated = int.from_bytes(head[8:12], order)  # type: ignore[arg-type]  # one of the two
    return stated if stated < 1 << 31 else 0  # From there on the sign bit is set.


@contextmanager
def _reading_errors(path: Path) -> Iterator[None]:
    """Convert errors of a library to an error that names the file."""
    try:
        yield
    except ProtochainError:
        raise
    except Exception as error:  # Readers raise anything of damaged files.
        reason = " ".join(f"{error}".split()) or type(error).__name__
        raise StructureError(f"{path}: cannot be read as a trajectory: {reason}; write it again") from None


def _models(path: Path) -> Frames:
    parsed = parse(path)[0]
    cell = parsed.cell
    box = _box(np.array(cell.orth.mat.tolist()).T / ANGSTROM_PER_NM) if cell.is_crystal() else None
    models = [*parsed]
    names = tuple(name for name, _ in in_file_order(models[0]))

    def frame(k: int) -> Frame:
        at = {name: atom.pos.tolist() for name, atom in in_file_order(models[k])}
        absent = next((name for name in names if name not in at), None)
        if absent is None and len(at) == len({*names}):
            return Frame(k, _copy_nm([at[name] for name in names], ANGSTROM_PER_NM), box)
        mismatch = absent or next(name for name in at if name not in names)
        verb = "lacks" if absent else "has"
        return Frame(k, None, error=f"other atoms than the first: it {verb} {mismatch}")

    return _frames_of(path, len(models), len(names), partial(map, frame), names=names)


def _npz(path: Path) -> Frames:
    """Open a numpy archive, whose positions are read frame by frame."""
    try:
        with np.load(path, allow_pickle=False) as file:
            shapes = check_sizes(file, packed=True)
            of_backbones = {"pos", "node_orientations"} <= shapes.keys()
            name = next((name for name in ("positions", "pos") if name in shapes), None)
            unit = "nm" if of_backbones else str(file["unit"]) if "unit" in shapes else ""
            sequence = str(file["sequence"]) if of_backbones and "sequence" in shapes else ""
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise StructureError(
            f"{path}: cannot be read as NPZ: {error}; write it again by numpy.savez"
        ) from None
    if name is None or len(shapes[name]) != 3 or shapes[name][2] != 3:
        contents = ", ".join(f"{name} {shape}" for name, shape in shapes.items()) or "nothing"
        raise StructureError(f"{path}: holds {contents}; give an array positions of (frames, atoms, 3)")
    if unit not in _UNITS:
        raise StructureError(
            f"{path}: does not say the unit of {name}{unit and f', but {unit!r}'}; "
            "add unit='nm' or unit='angstrom' to its arrays"
        )
    count, n_atoms = shapes[name][:2]
    sequence = sequence or "X" * n_atoms * of_backbones
    if of_backbones and not (
        shapes["node_orientations"] == (count, n_atoms, 3, 3) and len(sequence) == n_atoms
    ):
        raise StructureError(
            f"{path}: pos, node_orientations and sequence do not fit each other; write it again"
        )

    names = (name, "node_orientations") if of_backbones else (name,)

    def read(chosen: Iterable[int]) -> Iterator[Frame]:
        for k, (x, *rotation) in _stream(path, names, chosen):
            x = _copy_nm(x, _UNITS[unit])
            yield Frame(k, backbones(x, _copy_nm(*rotation)) if of_backbones else x)

    return _frames_of(path, count, 4 * n_atoms if of_backbones else n_atoms, read, sequence=sequence)


def _stream(path: Path, names: Sequence[str], chosen: Iterable[int]) -> Iterator[tuple[int, list[Any]]]:
    """Yield rows of the arrays of an archive, one by one."""
    with ExitStack() as stack:
        archive = stack.enter_context(zipfile.ZipFile(path))
        rows = [stack.enter_context(archive.open(f"{name}.npy")) for name in names]
        heads = [(*head_of(file), file.tell()) for file in rows]
        for name, (_, fortran, dtype, _) in zip(names, heads, strict=True):
            if fortran or dtype.hasobject:
                raise StructureError(f"{path}: {name} is not in C order; write it again by numpy.savez")
        for k in chosen:
            values = []
            for file, (shape, _, dtype, begin) in zip(rows, heads, strict=True):
                size = int(np.prod(shape[1:])) * dtype.itemsize
                file.seek(begin + k * size)
                data = file.read(size)
                is_full = len(data) == size
                row = np.frombuffer(data, dtype).reshape(shape[1:]) if is_full else np.full(shape[1:], np.nan)
                values.append(row)
            yield k, values


def backbones(x: Floats, rotation: Floats) -> Floats:
    """Return N, CA, C and O (4 n, 3), nm, of residues with CA at x (n, 3), nm, rotated by (n, 3, 3)."""
    n, c = x + rotation @ _N, x + rotation @ _C
    away = _unit(c - x) + _unit(np.vstack([c[:-1] - n[1:], x[-1:] - n[-1:]]))
    return np.stack([n, x, c, c + _C_O * _unit(away)], axis=1).reshape(-1, 3)


def _unit(v: Floats) -> Floats:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), np.finfo(float).tiny))


_READERS: dict[str, Callable[[Path], Frames]] = {
    ".xtc": partial(_xdr, kind=_XTC),
    ".trr": partial(_xdr, kind=_TRR),
    ".dcd": partial(_mdanalysis, kind="DCD"),
    ".nc": partial(_mdanalysis, kind="NetCDF (version 3)"),
    ".ncdf": partial(_mdanalysis, kind="NetCDF (version 3)"),
    ".npz": _npz,
}
