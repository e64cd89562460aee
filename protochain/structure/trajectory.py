"""Trajectories in DCD or XTC files, by OpenMM's writers."""

import os
import struct
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from openmm import app

from protochain.arrays import Floats
from protochain.errors import StructureError
from protochain.storage import check_writable
from protochain.structure.model import Structure

_DCD_COUNT = 8
"""Offset of the number of frames in a DCD file: four bytes, little-endian."""


def check_trajectory(path: Path) -> None:
    """Refuse an unknown trajectory suffix.

    Raises
    ------
    StructureError
        Naming the suffix.
    """
    if path.suffix.lower() not in (".dcd", ".xtc"):
        raise StructureError(f"{path}: unknown trajectory suffix {path.suffix!r}; use .dcd or .xtc")


class TrajectoryFile:
    """Writer of frames to ``NAME.part.dcd``, renamed when the ``with`` block ends.

    Parameters
    ----------
    path : path-like
        Ends in ``.dcd`` or ``.xtc``.
    structure : Structure
        Structure that gives the topology.
    interval : float, ps
        Time between frames.
    kept : tuple of int and int, optional
        Continue a file from this number of frames and bytes; the rest is cut off.

    Raises
    ------
    StructureError
        If the suffix is unknown, or the file to continue has lost frames.
    """

    def __init__(
        self,
        path: str | Path,
        structure: Structure,
        interval: float = 1.0,
        kept: tuple[int, int] | None = None,
    ) -> None:
        self.path = Path(path)
        check_trajectory(self.path)
        check_writable(self.path)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.part = self.path.with_name(f"{self.path.stem}.part{self.path.suffix}")
        self.n_frames = 0
        if kept is None:
            self.part.unlink(missing_ok=True)
        else:
            self._cut(*kept)
        self._file: Any = None
        settings = {"dt": interval, "append": kept is not None}
        if self.path.suffix.lower() == ".dcd":
            self._file = self.part.open("w+b" if kept is None else "r+b")
            self._writer: Any = app.DCDFile(self._file, structure.topology, **settings)
        else:
            self.part.touch()
            self._writer = app.XTCFile(str(self.part), structure.topology, **settings)

    def _cut(self, n_frames: int, n_bytes: int) -> None:
        if not self.part.exists() and self.path.exists():
            self.path.replace(self.part)
        if not self.part.exists() or self.part.stat().st_size < n_bytes:
            raise StructureError(f"{self.part}: has lost frames since its checkpoint; start the run anew")
        with self.part.open("r+b") as file:
            file.truncate(n_bytes)
            if self.path.suffix.lower() == ".dcd":
                file.seek(_DCD_COUNT)
                file.write(struct.pack("<i", n_frames))
        self.n_frames = n_frames

    def append(self, x: Floats) -> None:
        """Write one frame of positions (na, 3) in nm."""
        self._writer.writeModel(x)
        self.n_frames += 1

    def stored(self) -> tuple[int, int]:
        """Write all frames to the disk; return their number and the bytes of the file."""
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
        self.close()
        self.part.replace(self.path)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.finish()
        else:
            self.close()
            self.part.unlink(missing_ok=True)
