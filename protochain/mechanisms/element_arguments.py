"""Arguments of elements, converted or refused in one line that names the element and the remedy."""

from collections.abc import Callable
from typing import Any

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.checks import brief
from protochain.core.errors import Fault, MechanicsError, ProtochainError
from protochain.mechanics.multibody.tree import is_rotation

_KINDS = {
    (): "a number",
    (2,): "two numbers",
    (3,): "three numbers, as (0, 0, 1)",
    (6,): "six numbers",
    (3, 3): "a matrix of 3x3",
}


def numbers(value: Any, label: str, shape: tuple[int, ...] = (3,)) -> Floats:
    """Return finite numbers of a shape. ``label`` begins the message, as ``spring "s": its stiffness``."""
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        array = np.array(np.nan)
    if array.shape != shape or not np.all(np.isfinite(array)) or isinstance(value, bool):
        raise MechanicsError(f"{label} {brief(value)}: give {_KINDS[shape]}, finite", fault=Fault.NOT_FINITE)
    return array


def answer(label: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Result of a function of the user. Its exceptions name the element."""
    try:
        return function(*arguments)
    except ProtochainError:
        raise
    except Exception as error:
        raise MechanicsError(f"{label} fails: {type(error).__name__}: {error}; correct it") from error


def number(value: Any, label: str) -> float:
    """Return a finite number."""
    return float(numbers(value, label, ()))


def not_negative(value: Any, label: str, shape: tuple[int, ...] = ()) -> Floats:
    """Return finite numbers, none of them below zero. One number stands for all."""
    array = numbers(np.full(shape, value) if np.ndim(value) == 0 and shape else value, label, shape)
    if np.any(array < 0.0):
        raise MechanicsError(
            f"{label} {brief(value)}: give none below zero, which would create energy", fault=Fault.NEGATIVE
        )
    return array


def amount(value: Any, label: str) -> float:
    """Return a finite number that is not below zero."""
    return float(not_negative(value, label))


def direction(value: Any, label: str) -> Floats:
    """Return a vector of length one, (3,)."""
    way = numbers(value, label)
    # Divided first, so that tiny and huge ones keep their digits.
    largest = float(np.max(np.abs(way)))
    if largest == 0.0:
        raise MechanicsError(f"{label} has length zero: give a direction, as (0, 0, 1)")
    way = way / largest
    return np.asarray(way / np.linalg.norm(way))


def rotation_matrix(value: Any, label: str) -> Floats:
    """Return a rotation, (3, 3)."""
    matrix = numbers(value, label, (3, 3))
    if not is_rotation(matrix[None])[0]:
        raise MechanicsError(f"{label} is none: give a matrix with orthonormal columns and determinant 1")
    return matrix
