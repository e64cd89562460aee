"""Hessian of the native energy: pairs and Born radii analytically, bonded terms by a few differences.

A pair of atoms adds its second derivative, K = J^T H J, and a term of its forces for the atoms' curved paths,
-f . d2x/dq dq, by sums of x f^T over the atoms outward of each hinge. The generalised Born energy E(x, B(x))
adds P^T E_BB P + P^T E_Bx J + J^T E_xB P + sum E_B B'' dI dI^T with P = dB/dq, by dense products, O(na^2 n).
Bonded terms only change with the hinges between their atoms, so that many hinges may turn at once.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dgemm
from scipy.sparse import csr_array

from protochain.chains.chain import Chain, Pose
from protochain.comparison import pair_kernels
from protochain.core.arrays import Floats, Integers
from protochain.energies import Energy, NativeEnergy
from protochain.energies.native.terms import Terms
from protochain.minimisers.torsion_kernels import _inward_order, _motions

kernels: Any = pair_kernels

_ROWS = 256  # Number of atoms in a block of second derivatives in Born radii.
_PART = 32  # Number of atoms in a task of a thread.
_KEPT = 64e6  # Bytes of stored derivatives of Born radii, or half of the result's bytes for large molecules.
_BODIES = 64  # Number of bodies in a block of rows.
_COLUMNS = 16
"""Parts of the other bodies for threads, so that the order of sums is independent of their number."""


def applies(energy: Energy) -> bool:
    """Whether an energy is the sum of these terms: native, without cutoff, with a solvent without necks."""
    if not isinstance(energy, NativeEnergy):
        return False
    terms = energy.terms
    solvent = terms.solvent
    if np.isfinite(terms.nonbonded.cutoff):
        return False
    return solvent is None or (solvent.necks is None and bool((solvent.scaled_radius >= 0.0).all()))


def pair_hessian(chain: Chain, energy: NativeEnergy, at: Pose) -> Floats:
    """Second derivatives (n_v, n_v) of all pairs of atoms, exceptions and Born radii included."""
    terms, centre = energy.terms, at.x.mean(axis=0)
    by_body = np.argsort(chain.atom_body, kind="stable")
    x, body = at.x[by_body] - centre, chain.atom_body[by_body]
    first = np.searchsorted(body, np.arange(chain.tree.n_bodies + 1)).astype(np.int64)
    tree = np.array(chain.tree.parent), np.array(chain.tree.v_start), _motions(chain, at, centre)
    matrix, zeros = np.zeros((chain.n_v, chain.n_v)), np.zeros(len(x))
    solvated: tuple[Any, ...] = (False, zeros, zeros, zeros, zeros, False, zeros, (0.0, 0.0))
    with ThreadPoolExecutor(energy.threads) as pool:

        def share(do: Callable[[Any], None], parts: Any) -> None:
            for _ in pool.map(do, parts):
                pass

        if terms.solvent is not None:
            born = energy.born_radii(at.x)[by_body]
            solvated = _add_radii(matrix, terms, by_body, born, (x, body, first), tree, share)
        pairs = _parameters(terms, by_body), solvated
        pair_stiffness = _add_pairs(matrix, (x, first), tree, pairs, share)
    _add_atoms(matrix, chain, at, tree[2], body, x, pair_stiffness, centre)
    symmetrise(matrix)
    return matrix


Share = Callable[[Callable[[Any], None], Any], None]
"""Calls a function for each part, in threads."""


def symmetrise(matrix: Floats) -> None:
    """Replace a matrix (n, n) by the mean with its transpose, in place."""
    n = len(matrix)
    for a in range(0, n, _ROWS):
        for b in range(a, n, _ROWS):
            above, below = matrix[a : a + _ROWS, b : b + _ROWS], matrix[b : b + _ROWS, a : a + _ROWS]
            above[:] = 0.5 * (above + below.T)
            below[:] = above.T


def _add_product(matrix: Floats, a: Floats, b: Floats) -> None:
    """Add 2 (a^T b)^T to a matrix in place, whose symmetric part is a^T b + b^T a."""
    dgemm(2.0, a.T, b.T, beta=1.0, c=matrix.T, trans_b=True, overwrite_c=True)


def _parameters(terms: Terms, by_body: Integers) -> tuple[Any, ...]:
    """Parameters of the pairs, with atoms in the order of their bodies."""
    nonbonded = terms.nonbonded
    return (
        nonbonded.charge[by_body], nonbonded.lj_type[by_body].astype(np.int64), np.array(nonbonded.a12),
        np.array(nonbonded.b6), *_exceptions(terms, by_body),
    )  # fmt: skip


def _add_pairs(
    matrix: Floats, atoms: tuple[Floats, Integers], tree: tuple[Any, ...], pairs: tuple[Any, Any],
    share: Share,
) -> Floats:  # fmt: skip
    """Add each pair between bodies once. Return the stiffness and force of each single atom (na, 9)."""
    (x, first), (parent, v_start, motions) = atoms, tree
    order, depth = _inward_order(parent)
    ends = np.searchsorted(first, np.arange(_COLUMNS + 1) * len(x) // _COLUMNS).astype(np.int64)
    rows = np.zeros((int(depth.max()) + 1, 6, 6 * len(parent)))
    atom_stiffness = np.zeros((len(x), 9))
    for begin in range(0, len(order), _BODIES):
        bodies = order[begin : begin + _BODIES]
        sources, freedoms = _ranges(first, bodies), _ranges(v_start, bodies)
        along, sums = np.empty((len(freedoms), 6 * len(parent))), np.empty((_COLUMNS, len(sources), 9))

        def sweep(part: int, bodies: Integers = bodies, along: Floats = along, sums: Floats = sums) -> None:
            kernels.pair_sweep(
                bodies, ends[part], ends[part + 1], (parent, depth, v_start, motions), atoms, *pairs,
                (rows, along, sums[part], atom_stiffness),
            )  # fmt: skip

        share(sweep, range(_COLUMNS))
        atom_stiffness[sources] += sums.sum(axis=0)
        to = freedoms, parent, v_start, motions, along, matrix
        share(partial(_call_kernel, kernels.add_rows, to), _parts(0, len(freedoms)))
    return atom_stiffness


def _ranges(start: Integers, indices: Integers) -> Integers:
    """Concatenated ranges of indices, each from its start to its end."""
    return np.concatenate([np.arange(start[b], start[b + 1]) for b in indices]).astype(np.int64)


def _exceptions(terms: Terms, by_body: Integers) -> tuple[Integers, Integers, Floats]:
    """Start of each atom's partners, the partners, and the parameters of the pairs, in both directions."""
    place = np.empty(terms.n_atoms, np.int64)
    place[by_body] = np.arange(terms.n_atoms)
    i, j = place[terms.nonbonded.exceptions.atoms].T
    parameters = terms.nonbonded.exceptions.parameters
    one, partners = np.concatenate([i, j]), np.concatenate([j, i])
    order = np.argsort(one, kind="stable")
    start = np.searchsorted(one[order], np.arange(terms.n_atoms + 1)).astype(np.int64)
    return start, partners[order], np.concatenate([parameters, parameters])[order]


def _add_radii(
    matrix: Floats, terms: Terms, by_body: Integers, born: Floats, atoms: tuple[Floats, Integers, Integers],
    tree: tuple[Any, ...], share: Share,
) -> tuple[Any, ...]:  # fmt: skip
    """Add second derivatives through the Born radii, and return the solvent's parameters of pairs."""
    # Derivatives of radii (na, n_v) may be too many to store: then some are stored, and the others are
    # computed again for each block.
    s = terms.solvent
    assert s is not None
    n, n_v = len(by_body), len(matrix)
    offset, radius, scaled = s.offset_radius[by_body], s.radius[by_body], s.scaled_radius[by_body]
    charge, surface, shape = s.charge[by_body], s.surface[by_body], s.bend[by_body]
    integral, slope, bend, of_born, atom_stiffness = np.empty((5, n))
    salt = s.salt or (0.0, 0.0)
    arguments = *atoms, offset, scaled, bool(s.engulfs), *tree

    def derivatives(begin: int, end: int, to: Floats) -> Floats:
        share(partial(_call_kernel, kernels.integrals, (*arguments, integral, to), begin), _parts(begin, end))
        chunk = slice(begin, end)
        _, slope[chunk], bend[chunk] = born_radii(integral[chunk], offset[chunk], radius[chunk], shape[chunk])
        to = to[: end - begin]
        to *= slope[chunk, None]
        return to

    def coupling_block(begin: int, end: int, left: int, right: int) -> Floats:
        block = np.empty((end - begin, right - left))

        def rows(part: tuple[int, int]) -> None:
            to = block[part[0] - begin : part[1] - begin]
            kernels.couplings(*part, left, right, atoms[0], charge, born, salt, to)

        share(rows, _parts(begin, end))
        return block

    derivatives_of_rows = np.empty((min(n, max(_ROWS, n_v // 2, int(_KEPT) // (8 * n_v))), n_v))
    further, mixed = np.empty((2, min(n, _ROWS), n_v))
    constants = *atoms, charge, surface, born, salt, *tree, of_born, atom_stiffness, mixed
    for left in range(0, n, len(derivatives_of_rows)):
        right = min(n, left + len(derivatives_of_rows))
        along = derivatives(left, right, derivatives_of_rows)
        for begin, end in _parts(left, right, _ROWS):
            share(partial(_call_kernel, kernels.born_rows, constants, begin), _parts(begin, end))
            couplings = coupling_block(begin, end, begin, right)
            # Half of a symmetric product: the other half is its transpose.
            chunk_couplings = couplings[:, : end - begin]
            chunk_couplings *= 0.5
            # Radii at their upper limit are constant.
            rows, turn = slice(begin, end), np.zeros(end - begin)
            np.divide(bend[rows], slope[rows] ** 2, out=turn, where=slope[rows] != 0.0)
            chunk_couplings[np.diag_indices(end - begin)] = 0.5 * (
                atom_stiffness[rows] + of_born[rows] * turn
            )
            product = mixed[: end - begin]
            product += couplings @ along[begin - left :]
            _add_product(matrix, along[begin - left : end - left], product)
        for begin, end in _parts(right, n, _ROWS):
            across = coupling_block(begin, end, left, right) @ along
            _add_product(matrix, derivatives(begin, end, further), across)
    return True, charge, born, offset, scaled, bool(s.engulfs), of_born * slope, salt


def _parts(begin: int, end: int, size: int = _PART) -> list[tuple[int, int]]:
    """Split a range into parts, by default of the size of a thread's task."""
    return [(k, min(end, k + size)) for k in range(begin, end, size)]


def _call_kernel(kernel: Any, arguments: tuple[Any, ...], *parts: Any) -> None:
    """Call a kernel with the first arguments, the last part unpacked, and all other arguments."""
    kernel(*parts[:-1], *parts[-1], *arguments)


def born_radii(
    integral: Floats, offset: Floats, radius: Floats, bend: Floats
) -> tuple[Floats, Floats, Floats]:
    """Born radii from integrals, with their first and second derivatives."""
    # 1/B = 1/offset - tanh(u)/radius with u = alpha psi - beta psi^2 + gamma psi^3, psi = integral offset. In
    # HCT the three are zero, and 1/B = 1/offset - integral.
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


def _add_atoms(
    matrix: Floats, chain: Chain, at: Pose, motions: Floats, body: Integers, x: Floats, per_atom: Floats,
    centre: Floats,
) -> None:  # fmt: skip
    """Add J^T D J of each single atom, and -f . d2x/dq dq."""
    # A turn about axis a after one about b moves by a cross (b cross r).
    tree, forces = chain.tree, per_atom[:, 6:]
    moments, sums = np.zeros((tree.n_bodies, 3, 3)), np.zeros((tree.n_bodies, 3))
    stiffness = np.zeros((tree.n_bodies, 6, 6))
    np.add.at(moments, body, x[:, :, None] * forces[:, None, :])
    np.add.at(sums, body, forces)
    # Rows u - r cross omega of a point, for the twist (omega, u).
    arms = np.zeros((len(x), 3, 6))
    arms[:, [0, 1, 2], [3, 4, 5]] = 1.0
    arms[:, [0, 1, 2], [1, 2, 0]], arms[:, [0, 1, 2], [2, 0, 1]] = x[:, [2, 0, 1]], -x[:, [1, 2, 0]]
    blocks = per_atom[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    np.add.at(stiffness, body, arms.transpose(0, 2, 1) @ blocks @ arms)
    for b in range(tree.n_bodies - 1, -1, -1):
        if tree.parent[b] >= 0:
            moments[tree.parent[b]] += moments[b]
            sums[tree.parent[b]] += sums[b]
            stiffness[tree.parent[b]] += stiffness[b]
    origin, axes = at.frames.origin - centre, motions[:, :3]
    inward: list[NDArray[np.int64]] = []
    for b in range(tree.n_bodies):
        freedoms = np.arange(tree.v_start[b], tree.v_start[b + 1])
        above = inward[tree.parent[b]] if tree.parent[b] >= 0 else np.empty(0, np.int64)
        inward.append(np.concatenate([above, freedoms]))
        about = moments[b] - np.outer(origin[b], sums[b])
        turned = axes[freedoms] @ about.T - axes[freedoms] * np.trace(about)
        stiffened = motions[freedoms] @ stiffness[b]
        of_above = motions[above] @ stiffened.T - axes[above] @ turned.T
        matrix[np.ix_(above, freedoms)] += of_above
        matrix[np.ix_(freedoms, above)] += of_above.T
        matrix[np.ix_(freedoms, freedoms)] += motions[freedoms] @ stiffened.T - axes[freedoms] @ turned.T


def colours(chain: Chain, energy: NativeEnergy) -> tuple[csr_array, Integers]:
    """Freedoms coupled by bonded terms (n_v, n_v), and colours: freedoms of a colour share no row."""
    tree = chain.tree
    depth, root = np.zeros(tree.n_bodies, np.int64), np.arange(tree.n_bodies)
    for b in range(tree.n_bodies):
        if tree.parent[b] >= 0:
            depth[b], root[b] = depth[tree.parent[b]] + 1, root[tree.parent[b]]
    hinge_sets: set[tuple[int, ...]] = set()
    for terms in energy.terms.bonded.values():
        bodies = np.unique(np.sort(chain.atom_body[terms.atoms], axis=1), axis=0)
        for row in bodies.tolist():
            hinges = {*_hinges_between({*row}, tree.parent, depth, root)}
            if hinges:
                hinge_sets.add(tuple(sorted(hinges)))
    freedoms = [[v for b in path for v in range(tree.v_start[b], tree.v_start[b + 1])] for path in hinge_sets]
    row = np.repeat(np.arange(len(freedoms)), [len(hinge_set) for hinge_set in freedoms])
    column = np.array([v for hinge_set in freedoms for v in hinge_set], dtype=np.int64)
    incidence = csr_array((np.ones(len(row)), (row, column)), shape=(len(freedoms), chain.n_v))
    coupled = (incidence.T @ incidence).tocsr()
    reachable = (coupled @ coupled).tocsr()
    colour = np.full(chain.n_v, -1)
    for v in range(chain.n_v):
        used = {*colour[reachable.indices[reachable.indptr[v] : reachable.indptr[v + 1]]].tolist()}
        colour[v] = next(k for k in range(chain.n_v + 1) if k not in used)
    return coupled, colour


def _hinges_between(bodies: set[int], parent: Any, depth: Integers, root: Integers) -> Iterator[int]:
    """Bodies whose hinges are between some bodies, for several trees up to the roots inclusive."""
    left = set(bodies)
    while len(left) > 1:
        deepest = max(left, key=lambda b: int(depth[b]))
        yield deepest
        left.remove(deepest)
        if parent[deepest] >= 0:
            left.add(int(parent[deepest]))
        elif not left:
            return
    # In several trees the last root moves relative to the others, too.
    if len({int(root[b]) for b in bodies}) > 1:
        yield from left
