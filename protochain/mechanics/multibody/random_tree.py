"""Random trees for tests and measurements."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from protochain.mechanics.multibody.tree import HingeKind, Tree


def random_tree(
    n: int,
    seed: int | np.random.Generator,
    branching: float = 0.0,
    root: HingeKind = HingeKind.FREE,
    kinds: Sequence[HingeKind] = (HingeKind.REVOLUTE,),
) -> Tree:
    """Build a tree of n bodies of random shape, joined by random hinges.

    Parameters
    ----------
    n : int
        Number of bodies.
    seed : int or numpy.random.Generator
        Seed or source of random numbers.
    branching : float
        Fraction of the bodies whose parent is any earlier body, not the last one: 0 gives a serial chain.
    root : HingeKind
        Hinge between the first body and the world.
    kinds : sequence of HingeKind
        Kinds that the other hinges are drawn from.

    Returns
    -------
    Tree
        Tree with lengths of order 0.1 nm and masses of order 10 amu, as in a protein.

    Examples
    --------
    >>> from protochain import multibody
    >>> tree = multibody.random_tree(5, seed=1)
    >>> tree.n_bodies, tree.n_v
    (5, 10)
    """
    rng = np.random.default_rng(seed)
    last = np.arange(-1, n - 1)
    anywhere = np.concatenate([[-1], rng.integers(0, np.arange(1, n))])
    kind = rng.choice(np.array(kinds, dtype=np.int64), size=n)
    kind[0] = root
    placement = Rotation.random(n, rng=rng).as_matrix()
    placement[0] = np.eye(3)
    # Point masses at random positions give inertias that a rigid body can have.
    points = rng.normal(scale=0.1, size=(n, 6, 3))
    mass = rng.uniform(1.0, 3.0, size=(n, 6))
    com = np.einsum("bk,bki->bi", mass, points) / mass.sum(axis=1)[:, None]
    second = np.einsum("bk,bki,bkj->bij", mass, points - com[:, None], points - com[:, None])
    return Tree(
        parent=np.where(rng.random(n) < branching, anywhere, last),
        kind=kind,
        offset=rng.normal(scale=0.1, size=(n, 3)),
        placement=placement,
        mass=mass.sum(axis=1),
        com=com,
        inertia=np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second,
        pitch=rng.normal(scale=0.1, size=n),
    )
