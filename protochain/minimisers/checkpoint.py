"""Checkpoints of stopped runs: arrays and plain values; reading one runs no code."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from protochain.errors import ProtochainError
from protochain.minimisers.loop import Snapshot, Unstarted
from protochain.minimisers.metrics import Preconditioner
from protochain.minimisers.problem import Evaluation, Tally
from protochain.minimisers.stages import Stage, Waypoint
from protochain.storage import read_arrays, write_arrays

_KINDS = (Waypoint, Snapshot, Tally, Unstarted)
"""Classes of every checkpoint; the others are the states that the method names."""


def save_checkpoint(path: Path, waypoint: Waypoint, settings: Mapping[str, Any]) -> None:
    """Write a waypoint, with the settings of its run.

    Parameters
    ----------
    path : Path
        An .npz file.
    waypoint : Waypoint
    settings : mapping
        Of plain values.
    """
    arrays: dict[str, np.ndarray] = {}
    known: dict[int, Any] = {}
    tree = _plain(waypoint, arrays, known)
    write_arrays(path, arrays, tree, settings)


def load_checkpoint(path: Path, plan: list[Stage], settings: Mapping[str, Any]) -> Waypoint:
    """Read a waypoint of a plan.

    Parameters
    ----------
    path : Path
    plan : list of Stage
    settings : mapping
        Those of the run to be continued.

    Raises
    ------
    ProtochainError
        If the file cannot be read, or belongs to a run with other settings.
    """
    remedy = "give a file that an earlier run wrote as its checkpoint"
    arrays, tree = read_arrays(path, settings, "minimisation", remedy)
    try:
        stage = plan[tree["fields"]["stage"]]
        place = tree["fields"].get("at")
        if stage.fit is not None and place is not None:
            stage = stage.fit(stage, _value(place, arrays, stage))
        waypoint: Waypoint = _value(tree, arrays, stage)
        return waypoint
    except (KeyError, IndexError, TypeError, AttributeError) as error:
        raise ProtochainError(f"{path}: damaged checkpoint ({type(error).__name__}: {error})") from None


def _plain(value: Any, arrays: dict[str, np.ndarray], known: dict[int, Any]) -> Any:
    """Convert to values that JSON can hold; arrays are stored apart by name, each once."""
    if isinstance(value, np.ndarray):
        name = known.get(id(value), f"a{len(arrays)}")
        known[id(value)] = name
        arrays[name] = value
        return {"array": name}
    if isinstance(value, tuple):
        return [_plain(part, arrays, known) for part in value]
    if isinstance(value, Preconditioner):
        return {"made_at": _plain(value.made_at, arrays, known), "age": value.age}
    if isinstance(value, Evaluation):
        # The rest of the pose follows from q.
        numbers = (value.pose.q, value.energy, value.torque, value.residual, value.restraint)
        return {"evaluation": _plain(numbers, arrays, known)}
    if is_dataclass(value):
        kind = type(value).__name__
        parts = {field.name: _plain(getattr(value, field.name), arrays, known) for field in fields(value)}
        return {"kind": kind, "fields": parts}
    return value.item() if isinstance(value, np.generic) else value


def _value(tree: Any, arrays: Mapping[str, np.ndarray], stage: Stage) -> Any:
    """Inverse of :func:`_plain`; metrics are computed again at the points they were computed at."""
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
    if "evaluation" in tree:
        q, *rest = _value(tree["evaluation"], arrays, stage)
        return Evaluation(stage.space.place(q), *rest)
    kinds = {kind.__name__: kind for kind in (*_KINDS, *getattr(stage.method, "states", ()))}
    parts = {name: _value(part, arrays, stage) for name, part in tree["fields"].items()}
    return kinds[tree["kind"]](**parts)
