"""Contact of two boxes, and of a box with a plane: separating axes, then the points where they press.

Of two convex bodies that overlap, the shortest way apart is along a normal of a face of either, or across an
edge of each: 3 + 3 + 9 axes for boxes (Gottschalk, Lin, Manocha, SIGGRAPH 1996). Along a face's normal, the
face of the other that looks most against it is cut to the face's prism (Sutherland, Hodgman, Commun. ACM
17:32, 1974), and the corners of what remains are the points; across edges it is one point between them.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from protochain.core.arrays import Floats, floats
from protochain.core.errors import MechanicsError
from protochain.mechanics.multibody.algebra import Matrix, Vector
from protochain.mechanisms.box_kernels import MOST_POINTS, box_on_box, box_on_plane


class Touch(NamedTuple):
    """Contact of two bodies.

    Parameters
    ----------
    depth : float
        How far they must move apart along the normal; negative, minus a gap, where they do not touch (a lower
        bound on their distance: that of a face to a body, or of two edges, but not of two corners).
    normal : (3,) float
        From the first to the second.
    points : (k, 3) float
        Points of contact, halfway between the two surfaces. None without a contact.
    depths : (k,) float
        Depths there, positive.
    shares : (k,) float
        Parts of the contact that the points stand for: a whole face is 1, a corner 1/4, and crossed edges
        1/2.
    pushes : (k, 3) float
        Directions of the force there on the second, whose part along the normal is 1: minus the gradient of
        the depth by its place. An edge or corner is pushed along the normal of what it presses on.
    axis : int
        Which axis: 0-2 normals of the first, 3-5 of the second, 6 + 3 i + j across their edges i and j.
    """

    depth: float
    normal: Floats
    points: Floats
    depths: Floats
    shares: Floats
    pushes: Floats
    axis: int


class Box(NamedTuple):
    """Box anywhere.

    Parameters
    ----------
    centre : (3,) float
    rotation : (3, 3) float
        Columns are the directions of its edges.
    half : (3,) float
        Half lengths of the edges.
    """

    centre: ArrayLike
    rotation: ArrayLike
    half: ArrayLike


def touch_boxes(first: Box, second: Box, prefer_faces: float = 0.0) -> Touch:
    """Contact of two boxes.

    Parameters
    ----------
    first, second : Box
    prefer_faces : float
        Length by which a contact of two edges must be shallower than one with a face, to be taken: of
        bodies almost flat upon each other either may be shallower, but only a face carries.

    Returns
    -------
    Touch

    Raises
    ------
    MechanicsError
        If a box is none: its edges not positive, its rotation none, a number not finite.
    """
    work = _room()
    number, depth, normal, axis = box_on_box(*_plain(first), *_plain(second), float(prefer_faces), *work)
    return _touch(number, depth, normal, axis, work[2])


def touch_plane(normal: ArrayLike, offset: float, box: Box) -> Touch:
    """Contact of a half space, the points x with normal . x <= offset, and a box.

    Parameters
    ----------
    normal : (3,) float
        Of unit length.
    offset : float
    box : Box

    Returns
    -------
    Touch
        The first is the half space: points are corners of the box.

    Raises
    ------
    MechanicsError
        If the box is none, or the normal is not of unit length.
    """
    up = floats(normal, (3,), "normal")
    if not abs(np.linalg.norm(up) - 1.0) <= 1e-9:
        raise MechanicsError(f"the normal {up} of a plane must have unit length")
    work = _room()
    n = (float(up[0]), float(up[1]), float(up[2]))
    number, depth = box_on_plane(n, float(offset), *_plain(box), work[2])
    return _touch(number, depth, n, 0, work[2])


def _room() -> tuple[Floats, Floats, Floats]:
    """Work space of the kernels: two polygons, and the points found."""
    return np.empty((MOST_POINTS + 4, 7)), np.empty((MOST_POINTS + 4, 7)), np.empty((MOST_POINTS, 8))


def _touch(number: int, depth: float, normal: Vector, axis: int, found: Floats) -> Touch:
    rows = found[:number].copy()
    return Touch(depth, np.array(normal), rows[:, :3], rows[:, 3], rows[:, 4], rows[:, 5:], int(axis))


def _plain(box: Box) -> tuple[Vector, Matrix, Vector]:
    """Centre, rotation and half edges as the kernels take them."""
    centre, half = floats(box.centre, (3,), "centre"), floats(box.half, (3,), "half")
    rotation = floats(box.rotation, (3, 3), "rotation")
    check_boxes(centre[None], rotation[None], half[None])
    return tuple(map(float, centre)), tuple(map(float, rotation.ravel())), tuple(map(float, half))  # type: ignore[return-value]  # mypy does not count them


def check_boxes(centre: Floats, rotation: Floats, half: Floats) -> None:
    """Raise if arrays (n, 3), (n, 3, 3), (n, 3) are no boxes; the message names the first.

    Raises
    ------
    MechanicsError
        If an edge is not positive, a rotation none, a number not finite.
    """
    finite = np.isfinite(centre).all(axis=1) & np.isfinite(half).all(axis=1)
    finite = np.asarray(finite & np.isfinite(rotation).all(axis=(1, 2)))
    for bad, why in (
        (~finite, "its centre, rotation and edges must be finite"),
        (~(half > 0.0).all(axis=1), "its edges must be longer than nothing"),
        (~_is_rotation(np.where(finite[:, None, None], rotation, np.eye(3))), "its rotation is none"),
    ):
        if np.any(bad):
            raise MechanicsError(f"box {int(np.argmax(bad))}: {why}")


def _is_rotation(rotation: Floats) -> np.ndarray:
    product = rotation @ rotation.swapaxes(1, 2)
    return np.all(np.abs(product - np.eye(3)) <= 1e-9, axis=(1, 2)) & (np.linalg.det(rotation) > 0.0)
