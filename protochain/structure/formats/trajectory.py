"""Writing of DCD and XTC trajectories with OpenMM's writers."""

import errno
import os
import struct
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

import numpy as np
from openmm import app, unit

from protochain.core.arrays import Floats
from protochain.core.errors import StructureError, WriteError
from protochain.core.storage import check_writable, writing
from protochain.structure.formats.frames import XTC_HEAD, open_frames, xtc_end
from protochain.structure.molecule.model import Structure

_DCD_COUNT = 8  # Offset of the number of frames in a DCD file: four bytes, little-endian.
FORMATS = (".dcd", ".xtc")
"""Suffixes of trajectories that can be written."""


def part_of(path: Path) -> Path:
    """Return the name of an incomplete trajectory."""
    return path.with_name(f"{path.stem}.part{path.suffix}")


def check_trajectory(path: Path) -> None:
    """Refuse an unknown trajectory suffix."""
    if path.suffix.lower() not in FORMATS:
        raise StructureError(f"{path}: unknown trajectory suffix {path.suffix!r}; use {' or '.join(FORMATS)}")


def _are_complete(path: Path, begin: int, end: int, n_atoms: int) -> bool:
    """Return whether XTC frames in a range of bytes are complete. OpenMM's writer does not report errors."""
    with path.open("rb") as file:
        file.seek(begin)
        while begin < end and (length := xtc_end(file.read(XTC_HEAD), n_atoms)):
            begin = file.seek(begin + length)
    return begin == end


class TrajectoryFile:
    """Writer of ``NAME.part.dcd``, renamed at the end. ``resume_at``: frames and bytes to continue after."""

    def __init__(
        self,
        path: str | Path,
        structure: Structure,
        interval: float = 1.0,
        resume_at: tuple[int, int] | None = None,
        hydrogens: bool = True,
    ) -> None:
        self.path = Path(path)
        self.atoms: Any
        topology, self.atoms = structure.topology, slice(None)
        if not hydrogens:
            self.atoms = np.flatnonzero(structure.atom_element != "H")
            modeller = app.Modeller(topology, structure.positions * unit.nanometer)
            modeller.delete([atom for atom in topology.atoms() if atom.element.symbol == "H"])
            topology = modeller.topology
        check_trajectory(self.path)
        check_writable(self.path)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.part = part_of(self.path)
        self.n_frames = 0
        if resume_at is None:
            self.part.unlink(missing_ok=True)
        else:
            self._check(topology, *resume_at)
            self._cut(*resume_at)
        self._file: Any = None
        try:
            with writing(self.path):
                self._open(topology, {"dt": interval, "append": resume_at is not None})
        except WriteError:
            if resume_at is None:
                self.discard()
            raise

    def _open(self, topology: Any, settings: dict[str, Any]) -> None:
        if self.path.suffix.lower() == ".dcd":
            self._file = self.part.open("r+b" if settings["append"] else "w+b")
            self._writer: Any = app.DCDFile(self._file, topology, **settings)
            self._file.flush()
        else:
            self.part.touch()
            self._writer = app.XTCFile(str(self.part), topology, **settings)

    def _existing_file(self) -> Path:
        """Return the file to continue, which has its final name if the run had ended."""
        return self.part if self.part.exists() else self.path

    def _check(self, topology: Any, n_frames: int, n_bytes: int) -> None:
        """Raise an error for a file that cannot be continued, before it is truncated."""
        path = self._existing_file()
        if not path.exists() or path.stat().st_size < n_bytes:
            raise StructureError(f"{path}: has lost frames since its checkpoint; start the run anew")
        try:
            if path.suffix.lower() == ".dcd":
                with path.open("rb") as file:
                    app.DCDFile(file, topology, 0.0, append=True)
                if n_frames and any(frame.x is None for frame in open_frames(path).read(range(n_frames))):
                    raise ValueError("a frame is damaged")
            elif not _are_complete(path, 0, n_bytes, topology.getNumAtoms()):
                raise ValueError("a frame is damaged")
        except (ValueError, struct.error, OSError) as error:
            reason = "damaged" if isinstance(error, StructureError) else error
            raise StructureError(f"{path}: cannot be continued ({reason}); start the run anew") from None

    def _cut(self, n_frames: int, n_bytes: int) -> None:
        path = self._existing_file()
        path.replace(self.part)
        with self.part.open("r+b") as file:
            file.truncate(n_bytes)
            if self.path.suffix.lower() == ".dcd":
                file.seek(_DCD_COUNT)
                file.write(struct.pack("<i", n_frames))
        self.n_frames = n_frames

    def append(self, x: Floats) -> None:
        """Write one frame of positions (na, 3) in nm."""
        with writing(self.path):
            begin = self.part.stat().st_size
            x = x[self.atoms]
            self._writer.writeModel(x)
            if self._file is None and not _are_complete(self.part, begin, self.part.stat().st_size, len(x)):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self.n_frames += 1

    def sync(self) -> tuple[int, int]:
        """Write all frames to the disk, and return the number of frames and bytes."""
        with writing(self.path):
            if self._file is not None:
                self._file.flush()
            with self.part.open("rb") as file:
                os.fsync(file.fileno())
        return self.n_frames, self.part.stat().st_size

    def close(self) -> None:
        """Close the file without renaming it."""
        if self._file is not None:
            self._file.close()

    def finish(self) -> None:
        """Close the file and rename it."""
        with writing(self.path):
            self.close()
        self.part.replace(self.path)

    def discard(self) -> None:
        """Close the file and delete it."""
        with suppress(OSError):  # After a full disk, the buffer still has data.
            self.close()
        self.part.unlink(missing_ok=True)

    def finish_at(self, n_frames: int, n_bytes: int) -> None:
        """Close the file, truncate it to the given numbers of frames and bytes, and rename it."""
        with suppress(OSError):
            self.close()
        self._cut(n_frames, n_bytes)
        self.part.replace(self.path)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None:
                self.finish()
        finally:
            self.discard()
