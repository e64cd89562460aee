"""Arguments of the builder, converted or refused in one line that names the element and the remedy."""

import inspect
from collections.abc import Callable, Container, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from protochain.arrays import Floats, read_only
from protochain.checks import shown
from protochain.errors import MechanicsError

_KINDS = {
    (): "a number",
    (2,): "two numbers",
    (3,): "three numbers, as (0, 0, 1)",
    (6,): "six numbers",
    (3, 3): "a matrix of 3x3",
}


def numbers(value: Any, shape: tuple[int, ...], said: str) -> Floats:
    """Return finite numbers of a shape; ``said`` begins the message, as ``spring "s": its stiffness``."""
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        array = np.array(np.nan)
    if array.shape != shape or not np.all(np.isfinite(array)) or isinstance(value, bool):
        raise MechanicsError(f"{said} {shown(value)}: give {_KINDS[shape]}, finite")
    return array


def number(value: Any, said: str) -> float:
    """Return a finite number."""
    return float(numbers(value, (), said))


def not_negative(value: Any, said: str, shape: tuple[int, ...] = ()) -> Floats:
    """Return finite numbers, none of them below zero; one number stands for all."""
    array = numbers(np.full(shape, value) if np.ndim(value) == 0 and shape else value, shape, said)
    if np.any(array < 0.0):
        raise MechanicsError(
            f"{said} {shown(value)}: give none below zero, which would make energy of nothing"
        )
    return array


def rotation(value: ArrayLike | None, said: str) -> Floats:
    """Return a rotation, (3, 3); None is none."""
    if value is None:
        return np.eye(3)
    matrix = numbers(value, (3, 3), said)
    if np.max(np.abs(matrix.T @ matrix - np.eye(3))) > 1e-9 or np.linalg.det(matrix) < 0.0:
        raise MechanicsError(f"{said} is none: give a matrix with orthonormal columns and determinant 1")
    return matrix


def direction(value: Any, said: str) -> Floats:
    """Return a vector of length one, (3,)."""
    vector = numbers(value, (3,), said)
    # Divided first, so that tiny and huge ones keep their digits.
    largest = float(np.max(np.abs(vector)))
    if largest == 0.0:
        raise MechanicsError(f"{said} has length zero: give a direction, as (0, 0, 1)")
    vector = vector / largest
    return np.asarray(vector / np.linalg.norm(vector))


def inertia(value: Any, said: str) -> Floats:
    """Return an inertia tensor (3, 3) of its diagonal, of all of it, or of one number for a ball."""
    if np.ndim(value) == 0:
        return number(value, said) * np.eye(3)
    if np.shape(value) == (3,):
        return np.diag(numbers(value, (3,), said))
    matrix = numbers(value, (3, 3), said)
    if np.max(np.abs(matrix - matrix.T)) > 1e-9 * np.max(np.abs(matrix)):
        raise MechanicsError(f"{said} is not symmetric: give the tensor about the centre of mass")
    return 0.5 * (matrix + matrix.T)


def choice(value: Any, among: Sequence[str], said: str) -> str:
    """Return one of several words."""
    if value in among:
        return str(value)
    raise MechanicsError(f"{said} {shown(value)}: give {', '.join(among[:-1])} or {among[-1]}")


def name_of(value: Any, kind: str, taken: Container[str], reserved: Container[str] = ()) -> str:
    """Return a name that is neither taken nor reserved."""
    if not isinstance(value, str) or not value:
        raise MechanicsError(f"the name {shown(value)} of a {kind}: give a text")
    if value in reserved:
        raise MechanicsError(f'"{value}" is no name for a {kind}: it has a meaning; give another')
    if value in taken:
        raise MechanicsError(f'{kind} "{value}" is named twice; give each a name of its own')
    return value


def n_parameters(value: Callable[..., Any], most: int, said: str) -> int:
    """Return how many arguments a callable takes: ``most`` or, if it cannot, fewer."""
    try:
        signature = inspect.signature(value)
    except (TypeError, ValueError):  # Some callables that are not of Python have no signature.
        return 1
    for n in range(most, 0, -1):
        try:
            signature.bind(*[None] * n)
        except TypeError:
            continue
        return n
    raise MechanicsError(f"{said}: give a callable of t, or of t and state")


def ends(a: Any, b: Any, said: str) -> tuple[tuple[str, str], Floats]:
    """Return the bodies of two points, and both points in their axes, (6,)."""
    for end in (a, b):
        if not (isinstance(end, tuple | list) and len(end) == 2 and isinstance(end[0], str)):
            raise MechanicsError(f'{said} give its ends as ("body", (x, y, z))')
    if a[0] == b[0]:
        raise MechanicsError(f'{said} both of its ends are on "{a[0]}"; join two bodies')
    return (a[0], b[0]), np.concatenate([numbers(end[1], (3,), f"{said} its point") for end in (a, b)])


def constants(stiffness: Any, damping: Any, said: str) -> tuple[float, float]:
    """Return stiffness and damping, of which one at least is above zero."""
    k = float(not_negative(stiffness, f"{said} its stiffness"))
    c = float(not_negative(damping, f"{said} its damping"))
    if k == c == 0.0:
        raise MechanicsError(f"{said} it does nothing; give a stiffness or a damping")
    return k, c


def law(value: Any, shape: tuple[int, ...], said: str) -> Any:
    """Return constants as checked numbers of a shape; a function, or None, as it is."""
    if value is None:
        return None
    if callable(value):
        n_parameters(value, 2, said)
        return value
    return read_only(numbers(value, shape, said))
