"""Frames of a run -> a DCD or XTC file, through mdtraj."""

from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from protochain.arrays import Floats
from protochain.errors import StructureError
from protochain.units import ANGSTROM_PER_NM


class TrajectoryFile:
    """Writes frames under a temporary name; the file appears when the ``with`` block ends.

    Parameters
    ----------
    path : path-like
        Ends in ``.dcd`` or ``.xtc``.

    Raises
    ------
    StructureError
        If the suffix is neither.
    """

    def __init__(self, path: str | Path) -> None:
        from mdtraj.formats import DCDTrajectoryFile, XTCTrajectoryFile

        formats = {".dcd": (DCDTrajectoryFile, ANGSTROM_PER_NM), ".xtc": (XTCTrajectoryFile, 1.0)}
        self.path = Path(path)
        if self.path.suffix.lower() not in formats:
            raise StructureError(f"{path}: unknown trajectory suffix {self.path.suffix!r}; use .dcd or .xtc")
        opener, self._unit = formats[self.path.suffix.lower()]
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._temporary = self.path.with_name(f".{self.path.stem}.part{self.path.suffix}")
        self._file: Any = opener(str(self._temporary), "w")

    def append(self, x: Floats) -> None:
        """Write one frame of positions (na, 3) in nm."""
        self._file.write((self._unit * x)[None].astype(np.float32))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()
        if kind is None:
            self._temporary.replace(self.path)
        else:
            self._temporary.unlink(missing_ok=True)
