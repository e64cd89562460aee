"""Trees of bodies that are hard on arithmetic: long, branched, light, thin, straight."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from protochain.core.arrays import Floats
from protochain.mechanics.multibody import HingeKind, Tree, random_tree, rigid_bodies


def beads(n: int, shared: bool, angle: float = 70.0) -> Tree:
    """Chain of equal beads with free torsions: each bead beyond the third is a body of its own.

    With ``shared``, a bead on the axes of neighbouring hinges gives a third of its mass to each of the three
    bodies in which it is at rest, so that every rotational inertia has full rank.
    """
    turn = np.deg2rad(180.0 - angle)
    parent, kind = np.arange(-1, n - 3), np.full(n - 2, HingeKind.REVOLUTE)
    kind[0] = HingeKind.FREE
    # Body b holds bead b + 2 at the end of a bond; its hinge is the bond before, along z.
    bend = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    placement = np.tile(bend, (n - 2, 1, 1))
    placement[0] = np.eye(3)
    bond = 0.15
    tip = bond * bend[:, 2]
    offset = np.tile(tip, (n - 2, 1))
    offset[0] = 0.0
    body = np.repeat(np.arange(n - 2), 3)
    local = np.tile([[0.0, 0.0, -bond], [0.0, 0.0, 0.0], tip], (n - 2, 1))
    bead = (np.arange(n - 2)[:, None] + np.arange(3)).ravel()
    if shared:
        mass = 12.0 / np.bincount(bead)[bead]
    else:
        first = (body == 0) | (np.tile([0, 0, 1], n - 2) == 1)
        body, local, mass = body[first], local[first], np.full(first.sum(), 12.0)
    return Tree(parent, kind, offset, placement, *rigid_bodies(body, local, mass, n - 2))


def nearly_collinear(degrees: float) -> Tree:
    """Chain of thirty bodies, the last at this angle from its hinge's axis."""
    tree = random_tree(30, 4, 0.0, HingeKind.FREE)
    away = np.deg2rad(degrees)
    points = np.array([[0.0, 0.0, 0.05], [0.1 * np.sin(away), 0.0, 0.1 * np.cos(away)]])
    mass, com, inertia = rigid_bodies(np.zeros(2, dtype=np.int64), points, np.array([12.0, 1.0]), 1)
    all_mass, all_com, all_inertia = tree.mass.copy(), tree.com.copy(), tree.inertia.copy()
    all_mass[-1], all_com[-1], all_inertia[-1] = mass[0], com[0], inertia[0]
    return replace(tree, mass=all_mass, com=all_com, inertia=all_inertia)


def mass_ratio(ratio: float) -> Tree:
    """Branched tree of a hundred bodies, every other one heavier or lighter by a factor."""
    tree = random_tree(100, 6, 0.3, HingeKind.FREE)
    factor = np.where(np.arange(100) % 2, ratio, 1.0)
    return replace(tree, mass=tree.mass * factor, inertia=tree.inertia * factor[:, None, None])


def chain(n: int) -> Tree:
    """Serial chain of n random bodies with a free root at its end."""
    return random_tree(n, n, 0.0, HingeKind.FREE)


def branched(n: int) -> Tree:
    """Tree of n bodies, a third of which hang on any earlier one."""
    return random_tree(n, n, 0.3, HingeKind.FREE)


def star(n: int) -> Tree:
    """Tree of n bodies, all of which hang on the root."""
    return replace(chain(n), parent=np.minimum(np.arange(-1, n - 1), 0))


def forest(n: int) -> Tree:
    """Forest of n bodies in five serial chains with free roots."""
    tree, first = chain(n), np.arange(0, n, n // 5)
    parent, kind, placement = tree.parent.copy(), tree.kind.copy(), tree.placement.copy()
    parent[first], kind[first], placement[first] = -1, HingeKind.FREE, np.eye(3)
    return replace(tree, parent=parent, kind=kind, placement=placement)


def from_the_middle(n: int) -> Tree:
    """Serial chain of n bodies whose root is in its middle: two arms, whose bodies alternate."""
    return replace(chain(n), parent=np.maximum(np.arange(n) - 2, np.where(np.arange(n), 0, -1)))


def tip_heavier(ratio: float) -> Tree:
    """Serial chain of thirty bodies, the last heavier or lighter by a factor."""
    tree = chain(30)
    factor = np.where(np.arange(30) == 29, ratio, 1.0)
    return replace(tree, mass=tree.mass * factor, inertia=tree.inertia * factor[:, None, None])


def thin(width: float) -> Tree:
    """Serial chain of thirty rods, this wide relative to their length."""
    points = 0.1 * np.array([[0, 0, 0], [0, 0, 1], [width, 0, 0.3], [0, width, 0.6]])
    return _of_points(points @ Rotation.from_euler("x", 40, degrees=True).as_matrix())


def small(size: float) -> Tree:
    """Serial chain of thirty bodies of this size relative to the length of a link, away from the axes."""
    return _of_points(0.1 * size * (np.eye(3) - 1 / 3) + [0.1, 0.0, 0.0])


def nearly_parallel(degrees: float) -> Tree:
    """Serial chain of thirty bodies, each hinge's axis at this angle to the one before."""
    tree = chain(30)
    turn = Rotation.from_euler("x", degrees, degrees=True).as_matrix()
    placement = np.tile(turn, (30, 1, 1))
    placement[0] = np.eye(3)
    return replace(tree, placement=placement)


def _of_points(points: Floats) -> Tree:
    """Serial chain of thirty bodies that are alike, of points of 3 amu."""
    tree, k = chain(30), len(points)
    body = np.repeat(np.arange(30), k)
    parts = rigid_bodies(body, np.tile(points, (30, 1)), np.full(30 * k, 3.0), 30)
    mass, com, inertia = parts
    return replace(tree, mass=mass, com=com, inertia=inertia)
