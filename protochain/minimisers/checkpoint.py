"""A stopped run as a file to go on from: arrays and plain values, nothing that could run when it is read."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from protochain.errors import ProtochainError
from protochain.minimisers.annealing import Cooling
from protochain.minimisers.fire import Moving
from protochain.minimisers.kcm import Standing
from protochain.minimisers.lbfgs import Memory
from protochain.minimisers.loop import Snapshot, Standstill
from protochain.minimisers.metrics import Preconditioner
from protochain.minimisers.newton import Continuation, Position
from protochain.minimisers.problem import Evaluation
from protochain.minimisers.stages import Stage, Waypoint
from protochain.storage import read_arrays, write_arrays

_KINDS = (
    Waypoint, Snapshot, Evaluation, Standstill, Standing, Memory, Position, Continuation, Moving, Cooling,
)  # fmt: skip
_VALUES = {kind.__name__: kind for kind in _KINDS}
"""What a checkpoint may be made of."""


def save_checkpoint(path: Path, waypoint: Waypoint, settings: Mapping[str, Any]) -> None:
    """Write a waypoint, and the settings that it belongs to.

    Parameters
    ----------
    path : Path
        An .npz file, written under a temporary name and renamed.
    waypoint : Waypoint
    settings : mapping
        Of plain values.
    """
    arrays: dict[str, np.ndarray] = {}
    known: dict[int, Any] = {}
    tree = _plain(waypoint, arrays, known)
    write_arrays(path, arrays, tree, settings)


def load_checkpoint(path: Path, plan: list[Stage], settings: Mapping[str, Any]) -> Waypoint:
    """Read a waypoint for a plan.

    Parameters
    ----------
    path : Path
    plan : list of Stage
    settings : mapping
        Those of the run that is to go on.

    Raises
    ------
    ProtochainError
        If the file cannot be read, or belongs to a run with other settings.
    """
    arrays, tree = read_arrays(path, settings)
    try:
        stage = plan[tree["fields"]["stage"]]
        waypoint: Waypoint = _value(tree, arrays, stage)
        return waypoint
    except (KeyError, IndexError, TypeError, AttributeError) as error:
        raise ProtochainError(f"{path}: a damaged checkpoint ({type(error).__name__}: {error})") from None


def _plain(value: Any, arrays: dict[str, np.ndarray], known: dict[int, Any]) -> Any:
    """Return what JSON can hold; arrays and repeated values are named."""
    if isinstance(value, np.ndarray):
        name = known.get(id(value), f"a{len(arrays)}")
        known[id(value)] = name
        arrays[name] = value
        return {"array": name}
    if isinstance(value, tuple):
        return [_plain(part, arrays, known) for part in value]
    if isinstance(value, Preconditioner):
        return {"made_at": _plain(value.made_at, arrays, known), "age": value.age}
    if is_dataclass(value):
        kind = type(value).__name__
        parts = {field.name: _plain(getattr(value, field.name), arrays, known) for field in fields(value)}
        return {"kind": kind, "fields": parts}
    return value.item() if isinstance(value, np.generic) else value


def _value(tree: Any, arrays: Mapping[str, np.ndarray], stage: Stage) -> Any:
    """Return what :func:`_plain` was given; metrics are made again, at the points they were made at."""
    if isinstance(tree, list):
        return tuple(_value(part, arrays, stage) for part in tree)
    if not isinstance(tree, dict):
        return tree
    if "array" in tree:
        return arrays[tree["array"]]
    if "made_at" in tree:
        metric: Any = stage.method
        at = _value(tree["made_at"], arrays, stage)
        return Preconditioner(metric.metric, at, metric.metric.at(stage.space, at), tree["age"])
    parts = {name: _value(part, arrays, stage) for name, part in tree["fields"].items()}
    return _VALUES[tree["kind"]](**parts)
