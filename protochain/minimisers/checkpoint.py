"""Checkpoints of stopped runs, made of arrays and plain values. Reading one runs no code."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.checkpoints import checkpoint, fitting, write_checkpoint
from protochain.minimisers.descent import DescentState
from protochain.minimisers.loop import Snapshot, Unstarted
from protochain.minimisers.metrics import Preconditioner
from protochain.minimisers.problem import Evaluation, Tally
from protochain.minimisers.stages import Stage, Waypoint

_KINDS = (Waypoint, Snapshot, Tally, Unstarted)
"""Classes in every checkpoint. The method lists the other classes, its states."""


def save_checkpoint(path: Path, waypoint: Waypoint, settings: Mapping[str, Any]) -> None:
    """Write a waypoint, with the settings of its run."""
    arrays: dict[str, np.ndarray] = {}
    write_checkpoint(path, arrays, _to_plain(waypoint, arrays, {}), settings)


def load_checkpoint(path: Path, plan: list[Stage], settings: Mapping[str, Any], x: Floats) -> Waypoint:
    """Read a waypoint of a plan: x (na, 3) nm."""
    remedy = "give a file that an earlier run wrote as its checkpoint"
    with checkpoint(path, settings, "minimisation", remedy) as contents:
        arrays, tree = contents.arrays, contents.values
        number, position = tree["fields"]["stage"], tree["fields"].get("at")
        if type(number) is not int or not 0 <= number < len(plan):
            raise ValueError(f"stage {number!r} of {len(plan)}")
        stage = plan[number]
        if stage.fit is not None and position is not None:
            stage = stage.fit(stage, fitting(arrays[position["array"]], "at", x.shape))
        waypoint: Waypoint = _Reader(arrays, stage, x).value(tree)
        if type(waypoint) is not Waypoint:
            raise ValueError(f"{type(waypoint).__name__} in place of a waypoint")
    return waypoint


def _to_plain(value: Any, arrays: dict[str, np.ndarray], names: dict[int, Any]) -> Any:
    """Convert to values for JSON. Arrays are stored separately by name, each once."""
    if isinstance(value, np.ndarray):
        name = names.get(id(value), f"a{len(arrays)}")
        names[id(value)] = name
        arrays[name] = value
        return {"array": name}
    if isinstance(value, tuple):
        return [_to_plain(part, arrays, names) for part in value]
    if isinstance(value, Preconditioner):
        return {"made_at": _to_plain(value.made_at, arrays, names), "age": value.age}
    if isinstance(value, Evaluation):
        # The rest of the pose follows from q.
        numbers = (value.pose.q, value.energy, value.torque, value.residual, value.restraint)
        return {"evaluation": _to_plain(numbers, arrays, names)}
    if is_dataclass(value):
        kind = type(value).__name__
        parts = {field.name: _to_plain(getattr(value, field.name), arrays, names) for field in fields(value)}
        return {"kind": kind, "fields": parts}
    return value.item() if isinstance(value, np.generic) else value


class _Reader:
    """Inverse of :func:`_to_plain`. It accepts only classes and shapes that a stage allows."""

    # Metrics are recomputed at their original points.

    def __init__(self, arrays: Mapping[str, np.ndarray], stage: Stage, x: Floats) -> None:
        self.arrays, self.stage = arrays, stage
        at = stage.space.start(x)
        self.q = at.shape
        self.v = stage.space.torque(stage.space.place(at), np.zeros_like(x)).shape
        self.x = x.shape
        classes = (*_KINDS, *getattr(stage.method, "states", ()))
        self.kinds = {kind.__name__: kind for kind in classes}

    def value(self, tree: Any) -> Any:
        """Value of a part."""
        if isinstance(tree, list):
            return tuple(self.value(part) for part in tree)
        if not isinstance(tree, dict):
            return tree
        if "array" in tree:
            return self.arrays[tree["array"]]
        if "made_at" in tree:
            method: Any = self.stage.method
            at, metric = self.value(tree["made_at"]), method.metric
            _fit(tree["age"], int, "age", self.v)
            return Preconditioner(metric, at, metric.at(self.stage.space, at), tree["age"])
        if "evaluation" in tree:
            return self._evaluation(*self.value(tree["evaluation"]))
        kind = self.kinds[tree["kind"]]
        parts = {name: self.value(part) for name, part in tree["fields"].items()}
        hints = {**get_type_hints(kind), **self._own_hints(kind)}
        for name, part in parts.items():
            # Only these classes have positions; other arrays have the shape of velocities.
            _fit(part, hints.get(name, Any), name, self.x if kind in (Waypoint, Snapshot) else self.v)
        return kind(**parts)

    def _evaluation(self, q: Any, energy: Any, torque: Any, residual: Any, restraint: Any) -> Evaluation:
        for name, number in (("energy", energy), ("residual", residual), ("restraint", restraint)):
            _fit(number, float, name, ())
        place = self.stage.space.place(fitting(q, "q", self.q))
        return Evaluation(place, energy, fitting(torque, "torque", self.v), residual, restraint)

    def _own_hints(self, kind: type) -> dict[str, Any]:
        """Types of the memories of a descent's direction and rule, from their annotations."""
        if kind is not DescentState:
            return {}
        method: Any = self.stage.method
        memory = get_type_hints(method.direction.propose).get("memory", Any)
        return {"memory": memory | tuple[()], "rule": get_type_hints(method.rule.init).get("return", Any)}


def _fit(value: Any, hint: Any, name: str, shape: tuple[int, ...]) -> None:
    """Raise an error if a value has another type, or an array in it another shape or infinite numbers."""
    if isinstance(value, np.ndarray):
        fitting(value, name, shape)
    if not _matches(value, hint):
        raise ValueError(f"{name} is of another type: {type(value).__name__}")
    if isinstance(value, tuple):
        for part in value:
            _fit(part, Any, name, shape)


def _matches(value: Any, hint: Any) -> bool:
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return any(_matches(value, alternative) for alternative in arguments)
    if origin is tuple:
        hints = arguments[:1] * len(value) if arguments[1:] == (...,) else arguments
        return isinstance(value, tuple) and len(value) == len(hints) and all(map(_matches, value, hints))
    if origin is np.ndarray:
        return isinstance(value, np.ndarray)
    if hint is float:
        return type(value) in (int, float)
    if hint is Any or getattr(hint, "_is_protocol", False):
        return not isinstance(value, str)
    if not isinstance(hint, type):
        return True
    return type(value) is hint if hint in (int, bool, str) else isinstance(value, hint)
