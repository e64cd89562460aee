"""Arrays and plain values in a file to go on from: nothing in it could run when it is read."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from protochain.errors import ProtochainError
from protochain.structure.write import write_atomically


def write_arrays(
    path: Path, arrays: Mapping[str, np.ndarray], values: Any, settings: Mapping[str, Any]
) -> None:
    """Write arrays, values that JSON can hold, and the settings they belong to.

    Parameters
    ----------
    path : Path
        An .npz file, written under a temporary name and renamed.
    arrays : mapping of str to array
    values : plain values
    settings : mapping of plain values
    """
    text = json.dumps({"settings": dict(settings), "values": values})

    def write(to: Path) -> None:
        with to.open("wb") as file:
            np.savez(file, allow_pickle=False, text=np.array(text), **arrays)

    write_atomically(path, write)


def read_arrays(path: Path, settings: Mapping[str, Any]) -> tuple[dict[str, np.ndarray], Any]:
    """Read what :func:`write_arrays` wrote, for a run with the same settings.

    Raises
    ------
    ProtochainError
        If the file cannot be read, or belongs to a run with other settings.
    """
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            arrays = dict(file)
        text = json.loads(str(arrays.pop("text")))
        theirs, values = text["settings"], text["values"]
    except FileNotFoundError:
        raise ProtochainError(f"{path}: not found; give the checkpoint of an earlier run") from None
    except (OSError, EOFError, AttributeError, ValueError, KeyError, TypeError, BadZipFile) as error:
        raise ProtochainError(f"{path}: not a checkpoint ({error})") from None
    for name, value in settings.items():
        if theirs.get(name) != value:
            raise ProtochainError(
                f"{path}: is of a run with {name} {theirs.get(name)!r}, not {value!r}; repeat its settings"
            )
    return arrays, values
