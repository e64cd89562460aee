"""Hessian of the native energy: pairs and Born radii analytically, bonded terms by a few differences.

A pair of atoms adds its second derivative, K = J^T H J, and what its forces do as the atoms' paths curve:
-f . d2x/dq dq, by sums of x f^T over what each hinge carries. The generalised Born energy E(x, B(x)) adds
P^T E_BB P + P^T E_Bx J + J^T E_xB P + sum E_B B'' dI dI^T with P = dB/dq, by dense products, O(na^2 n).
Bonded terms change with the hinges between their atoms only, so that many hinges may turn at once.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from protochain.analysis import pair_kernels
from protochain.chain import Chain, Pose
from protochain.core.arrays import Floats, Integers
from protochain.energies import Energy, NativeEnergy
from protochain.energies.native.terms import Terms
from protochain.minimisers.torsion_kernels import _inward_order, _motions

kernels: Any = pair_kernels

_ROWS = 256
"""Atoms whose second derivatives in Born radii are made at a time."""
_PART = 32
"""Atoms that a thread takes at a time."""


def applies(energy: Energy) -> bool:
    """Whether an energy is the sum of these terms: native, without cutoff, and of a solvent without necks."""
    if not isinstance(energy, NativeEnergy):
        return False
    terms = energy.terms
    solvent = terms.solvent
    if np.isfinite(terms.nonbonded.cutoff):
        return False
    return solvent is None or (solvent.necks is None and bool((solvent.scaled_radius >= 0.0).all()))


def pair_hessian(chain: Chain, energy: NativeEnergy, at: Pose) -> Floats:
    """Second derivatives (n_v, n_v) of all pairs of atoms, exceptions and Born radii included."""
    terms, tree, middle = energy.terms, chain.tree, at.x.mean(axis=0)
    by_body = np.argsort(chain.atom_body, kind="stable")
    x, body = at.x[by_body] - middle, chain.atom_body[by_body]
    first = np.searchsorted(body, np.arange(tree.n_bodies + 1)).astype(np.int64)
    parent, v_start = np.array(tree.parent), np.array(tree.v_start)
    motions = _motions(chain, at, middle)
    order, depth = _inward_order(parent)
    nonbonded, n = terms.nonbonded, len(x)
    matrix = np.zeros((chain.n_v, chain.n_v))
    none = np.zeros(n)
    solvated: tuple[Any, ...] = (False, none, none, none, none, False, none)
    share = _shares(energy.threads)
    if terms.solvent is not None:
        matrix, solvated = _of_radii(terms, by_body, (x, body, first), (parent, v_start, motions), share)
    own = _exceptions(terms, by_body)
    ends = _even(first, energy.threads)
    forces = np.zeros((energy.threads, n, 3))
    found = np.zeros((energy.threads, chain.n_v, chain.n_v))

    def sweep(part: int) -> None:
        kernels.pair_sweep(
            ends[part], ends[part + 1], parent, order, depth, v_start, motions, x, body, first,
            nonbonded.charge[by_body], nonbonded.lj_type[by_body].astype(np.int64), np.array(nonbonded.a12),
            np.array(nonbonded.b6), *own, *solvated, forces[part], found[part],
        )  # fmt: skip

    share(sweep, range(energy.threads))
    matrix += found.sum(axis=0)
    _add_bending(matrix, chain, at, motions, body, x, forces.sum(axis=0), middle)
    return 0.5 * (matrix + matrix.T)


Share = Callable[[Callable[[Any], None], Any], None]
"""Does something for each part, in threads."""


def _shares(threads: int) -> Share:
    def share(do: Callable[[Any], None], parts: Any) -> None:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(do, parts))

    return share


def _even(first: Integers, parts: int) -> Integers:
    """Bodies at which parts of about as many atoms begin, and the end."""
    return np.searchsorted(first, np.arange(parts + 1) * first[-1] / parts).astype(np.int64)


def _exceptions(terms: Terms, by_body: Integers) -> tuple[Integers, Integers, Floats]:
    """Start of each atom's partners, the partners, and the parameters of the pairs, both ways."""
    place = np.empty(terms.n_atoms, np.int64)
    place[by_body] = np.arange(terms.n_atoms)
    i, j = place[terms.nonbonded.exceptions.atoms].T
    parameters = terms.nonbonded.exceptions.parameters
    one, other = np.concatenate([i, j]), np.concatenate([j, i])
    order = np.argsort(one, kind="stable")
    start = np.searchsorted(one[order], np.arange(terms.n_atoms + 1)).astype(np.int64)
    return start, other[order], np.concatenate([parameters, parameters])[order]


def _of_radii(
    terms: Terms, by_body: Integers, atoms: tuple[Floats, Integers, Integers], tree: tuple[Any, ...],
    share: Share,
) -> tuple[Floats, tuple[Any, ...]]:  # fmt: skip
    """Second derivatives by way of the Born radii, and what pairs need to know of these."""
    s = terms.solvent
    assert s is not None
    n, n_v = len(by_body), len(tree[-1])
    offset, radius, scaled = s.offset_radius[by_body], s.radius[by_body], s.scaled_radius[by_body]
    charge, surface = s.charge[by_body], s.surface[by_body]
    integral, along = np.empty(n), np.empty((n, n_v))

    def integrate(part: tuple[int, int]) -> None:
        sphere = offset, scaled, bool(s.engulfs)
        kernels.integrals(*part, *atoms, *sphere, *tree, integral, along)

    share(integrate, _parts(0, n))
    born, slope, bend = born_radii(integral, offset, radius, s.bend[by_body])
    along *= slope[:, None]
    # Where a radius is as large as it can be, nothing changes it.
    bend_by_slope = np.divide(bend, slope**2, out=np.zeros(n), where=slope != 0.0)
    of_born, matrix = np.empty(n), np.zeros((n_v, n_v))
    for begin in range(0, n, _ROWS):
        rows = np.arange(begin, min(n, begin + _ROWS))
        couplings, mixed = np.zeros((len(rows), n)), np.empty((len(rows), n_v))
        known, to = (*atoms, charge, surface, born), (of_born, couplings, mixed)
        share(partial(_born_rows, begin, (*known, *tree, *to)), _parts(begin, begin + len(rows)))
        couplings[rows - begin, rows] += of_born[rows] * bend_by_slope[rows]
        # Half of a symmetric product: the other is its transpose.
        mixed += 0.5 * couplings[:, rows] @ along[rows]
        mixed += couplings[:, rows[-1] + 1 :] @ along[rows[-1] + 1 :]
        matrix += along[rows].T @ mixed
    matrix += matrix.T.copy()
    return matrix, (True, charge, born, offset, scaled, bool(s.engulfs), of_born * slope)


def _parts(begin: int, end: int) -> list[tuple[int, int]]:
    """Ranges of atoms that a thread takes at a time."""
    return [(k, min(end, k + _PART)) for k in range(begin, end, _PART)]


def _born_rows(first: int, rest: tuple[Any, ...], part: tuple[int, int]) -> None:
    kernels.born_rows(first, *part, *rest)


def born_radii(
    integral: Floats, offset: Floats, radius: Floats, bend: Floats
) -> tuple[Floats, Floats, Floats]:
    """Born radii of integrals, with their first and second derivatives.

    1/B = 1/offset - tanh(u)/radius with u = alpha psi - beta psi^2 + gamma psi^3, psi = integral offset; of
    HCT, whose three are zero, 1/B = 1/offset - integral.
    """
    alpha, beta, gamma = bend.T
    psi = integral * offset
    t = np.tanh(psi * (alpha - psi * (beta - psi * gamma)))
    first = (alpha - psi * (2.0 * beta - 3.0 * psi * gamma)) * offset
    second = (-2.0 * beta + 6.0 * psi * gamma) * offset**2
    once, twice = (1.0 - t * t) * first, (1.0 - t * t) * (second - 2.0 * t * first**2)
    bent = alpha != 0.0
    value = np.where(bent, t / radius, integral)
    once, twice = np.where(bent, once / radius, 1.0), np.where(bent, twice / radius, 0.0)
    born = 1.0 / (1.0 / offset - value)
    return born, born**2 * once, 2.0 * born**3 * once**2 + born**2 * twice


def _add_bending(
    matrix: Floats, chain: Chain, at: Pose, motions: Floats, body: Integers, x: Floats, forces: Floats,
    middle: Floats,
) -> None:  # fmt: skip
    """Add -f . d2x/dq dq: a turn about axis a after one about b moves by a cross (b cross r)."""
    tree = chain.tree
    moments, sums = np.zeros((tree.n_bodies, 3, 3)), np.zeros((tree.n_bodies, 3))
    np.add.at(moments, body, x[:, :, None] * forces[:, None, :])
    np.add.at(sums, body, forces)
    for b in range(tree.n_bodies - 1, -1, -1):
        if tree.parent[b] >= 0:
            moments[tree.parent[b]] += moments[b]
            sums[tree.parent[b]] += sums[b]
    origin, axes = at.frames.origin - middle, motions[:, :3]
    inward: list[NDArray[np.int64]] = []
    for b in range(tree.n_bodies):
        mine = np.arange(tree.v_start[b], tree.v_start[b + 1])
        above = inward[tree.parent[b]] if tree.parent[b] >= 0 else np.empty(0, np.int64)
        inward.append(np.concatenate([above, mine]))
        about = moments[b] - np.outer(origin[b], sums[b])
        turned = axes[mine] @ about.T - axes[mine] * np.trace(about)
        of_above = axes[above] @ turned.T
        matrix[np.ix_(above, mine)] -= of_above
        matrix[np.ix_(mine, above)] -= of_above.T
        of_mine = axes[mine] @ turned.T
        matrix[np.ix_(mine, mine)] -= 0.5 * (of_mine + of_mine.T)


def colours(chain: Chain, energy: NativeEnergy) -> tuple[csr_array, Integers]:
    """Freedoms that bonded terms couple (n_v, n_v), and a colour of each; none shares a row with its like."""
    tree = chain.tree
    depth = np.zeros(tree.n_bodies, np.int64)
    for b in range(tree.n_bodies):
        depth[b] = depth[tree.parent[b]] + 1 if tree.parent[b] >= 0 else 0
    crossed: set[tuple[int, ...]] = set()
    for some in energy.terms.bonded.values():
        bodies = np.unique(np.sort(chain.atom_body[some.atoms], axis=1), axis=0)
        for row in bodies.tolist():
            found = {*_between({*row}, tree.parent, depth)}
            if found:
                crossed.add(tuple(sorted(found)))
    freedoms = [[v for b in path for v in range(tree.v_start[b], tree.v_start[b + 1])] for path in crossed]
    row = np.repeat(np.arange(len(freedoms)), [len(each) for each in freedoms])
    column = np.array([v for each in freedoms for v in each], dtype=np.int64)
    incidence = csr_array((np.ones(len(row)), (row, column)), shape=(len(freedoms), chain.n_v))
    coupled = (incidence.T @ incidence).tocsr()
    seen = (coupled @ coupled).tocsr()
    colour = np.full(chain.n_v, -1)
    for v in range(chain.n_v):
        taken = {*colour[seen.indices[seen.indptr[v] : seen.indptr[v + 1]]].tolist()}
        colour[v] = next(k for k in range(chain.n_v + 1) if k not in taken)
    return coupled, colour


def _between(bodies: set[int], parent: Any, depth: Integers) -> Iterator[int]:
    """Bodies whose hinges lie between some bodies; of several trees, all to the roots and these too."""
    left = set(bodies)
    while len(left) > 1:
        deepest = max(left, key=lambda b: int(depth[b]))
        yield deepest
        left.remove(deepest)
        if parent[deepest] >= 0:
            left.add(int(parent[deepest]))
        elif not left:
            return
    # Of several trees the last root moves against the others, too.
    if len({_root(b, parent) for b in bodies}) > 1:
        yield from left


def _root(body: int, parent: Any) -> int:
    while parent[body] >= 0:
        body = int(parent[body])
    return body
