"""Checkpoints: arrays, plain values and the settings of a run, in a file that cannot execute code."""

import json
import math
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.errors import Argument, ProtochainError
from protochain.core.storage import regular, write_atomically


def write_checkpoint(
    path: Path, arrays: Mapping[str, np.ndarray], values: Any, settings: Mapping[str, Any]
) -> None:
    """Write a checkpoint (.npz): arrays, values that JSON can represent, and the settings of the run."""
    text = json.dumps({"settings": dict(settings), "values": values})

    def write(to: Path) -> None:
        with to.open("wb") as file:
            np.savez(file, allow_pickle=False, text=np.array(text), **arrays)

    write_atomically(path, write)


@dataclass(frozen=True)
class Checkpoint:
    """Contents of a file, looked up by name, kind and shape. Raise ValueError if one does not fit."""

    arrays: Mapping[str, np.ndarray]
    values: Any

    def array(self, name: str, shape: tuple[int, ...]) -> Floats:
        """Finite numbers of a shape."""
        return fitting(self.arrays[name], name, shape)

    def count(self, name: str) -> int:
        """Whole number from 0 on."""
        return _plain(self.values[name], name, (int,), 0)

    def number(self, name: str) -> float:
        """Finite number."""
        return _plain(self.values[name], name, (int, float))


def fitting(member: Any, name: str, shape: tuple[int, ...]) -> Floats:
    """Array of a checkpoint that a run can use."""
    if not isinstance(member, np.ndarray) or member.dtype != np.float64 or member.shape != shape:
        raise ValueError(f"{name} is not {shape} numbers")
    if not (np.abs(member) < 1e100).all():  # Nor would squares of larger ones be.
        raise ValueError(f"{name} is not finite")
    return member


def _plain(value: Any, name: str, kinds: tuple[type, ...], least: float = -math.inf) -> Any:
    if type(value) not in kinds or not least <= value < math.inf:
        raise ValueError(f"{name} is {value!r}")
    return value


@contextmanager
def checkpoint(
    path: Path, settings: Mapping[str, Any], kind: str, *remedy: str | Argument
) -> Iterator[Checkpoint]:
    """Read the checkpoint of a run with the same settings. Refuse misfits, also inside the ``with``."""
    try:
        with regular(path).open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            check_sizes(file)
            arrays = dict(file)
        text = json.loads(str(arrays.pop("text")))
        written, values = {**text["settings"]}, text["values"]
    except FileNotFoundError:
        raise ProtochainError(f"{path}: not found; give the checkpoint of an earlier run") from None
    except PermissionError as error:
        raise ProtochainError(f"{path}: cannot be read ({error.strerror}); change its permissions") from None
    except _DAMAGED:
        raise ProtochainError(f"{path}: is not a checkpoint of a {kind}; ", *remedy) from None
    if not {*list(settings)[:1]} <= set(written):
        raise ProtochainError(f"{path}: is not a checkpoint of a {kind}; ", *remedy)
    # A setting that one of the two lacks is of another version. Without settings, nothing is compared.
    for name in {**settings, **written} if settings else ():
        stored, value = written.get(name, _ABSENT), settings.get(name, _ABSENT)
        if stored == value:
            continue
        if name in _HASHED:
            raise ProtochainError(f"{path}: was written by a run with {_HASHED[name]}; repeat its settings")
        difference = f" {stored!r}, not {value!r}; repeat its settings"
        raise ProtochainError(f"{path}: was written by a run with ", Argument(name), difference)
    try:
        yield Checkpoint(arrays, values)
    except ProtochainError:
        raise
    except (KeyError, IndexError, TypeError, AttributeError, ValueError) as error:
        cause = f"{type(error).__name__}: {error}"
        raise ProtochainError(f"{path}: damaged checkpoint ({cause}); ", *remedy) from None


class _Absent:
    """Value of a setting that a run does not have."""

    def __repr__(self) -> str:
        return "absent"


_ABSENT = _Absent()
_HASHED = {
    "system": "another system: its atoms, caps, force field, solvent or salt",
    "start": "another start: its atoms or positions",
}
"""Settings that are hashes, with the words of a refusal."""
_DAMAGED = (
    OSError, EOFError, AttributeError, ValueError, KeyError, TypeError, BadZipFile, RuntimeError, zlib.error,
    MemoryError,
)  # fmt: skip
"""What reading a damaged archive raises: by zipfile, by numpy, by json."""


def head_of(stream: Any) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, order and type of an array of an archive, of which the rest of the stream are the numbers."""
    version, form = np.lib.format.read_magic(stream), np.lib.format
    return (form.read_array_header_1_0 if version == (1, 0) else form.read_array_header_2_0)(stream)


def check_sizes(file: Any, packed: bool = False) -> dict[str, tuple[int, ...]]:
    """Shapes of arrays. Refuse them before allocation if they claim more than the archive has."""
    shapes = {}
    for member in file.zip.infolist():
        with file.zip.open(member) as stream:
            shape, _, dtype = head_of(stream)
            claimed = math.prod(shape) * dtype.itemsize
            limit = _DEFLATED * member.compress_size if packed else member.compress_size
            if claimed != member.file_size - stream.tell() or member.file_size > limit:
                raise ValueError(f"{member.filename}: {claimed} bytes")
            shapes[member.filename.removesuffix(".npy")] = shape
    return shapes


_DEFLATED = 1100  # Bytes that one of a deflated file may become, at most.
