"""Normal modes in torsions, K a = w^2 M a: Go, Noguti, Nishikawa, PNAS 80:3696 (1983), for any tree.

The energy of a free chain does not depend on its position: with T its rigid motions, the rates are T w + P s,
with the first root at rest in P s, and K s = P^T K P s. The kinetic energy is least without momentum, with
Schur's complement in place of M. Its inverse is S M^-1 S^T in O(n). S subtracts the motion of the first root
from all rates: s = S (T w + P s). So the zero modes of the whole are removed, and all others are exact.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve, cholesky, eigh
from scipy.linalg.blas import dsymv
from scipy.linalg.lapack import dpotrf, dpotrs
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh, lobpcg

from protochain.chains.articulate import transfer_coordinates, with_energy, with_free_root
from protochain.chains.chain import Chain, Pose, mass_matrix, pose
from protochain.chains.frame import frame_of
from protochain.comparison.hessian import Torques, torques_at
from protochain.comparison.modes import NormalModes
from protochain.comparison.pair_hessian import applies
from protochain.core.arrays import Floats, floats, read_only
from protochain.core.checks import at_least, check_arguments, one_of
from protochain.core.errors import Fault, ProtochainError
from protochain.mechanics import multibody
from protochain.minimisers.curvature import near_terms
from protochain.minimisers.spaces import Torsions, motions_of_whole

METHODS = ("auto", "dense", "products")
DENSE = 1000
"""Freedoms up to which ``auto`` computes the whole Hessian by differences. The lowest modes need about 700
products, for any number of freedoms."""
MOST, ANALYTIC = 6000, 16000
"""Limits of freedoms by differences, and with an analytic Hessian. Five matrices of 6000 need 1.4 GB, a
single matrix of 16000 with work arrays 3 GB and an hour."""
ALL = 2000
"""Freedoms up to which all eigenvalues of the whole Hessian are computed, in half a minute at this size."""
RESIDUAL = 1e-8
"""Largest |K a - w^2 M a| of a mode, relative to |K| |a|: about the error of differences."""
_FLOOR = 1.0  # kJ/mol/rad^2, stiffness of the softest turns, added to the near terms.
_SHIFT = 0.01
"""1/ps^2, the least s of K + s M, of half a wavenumber, increased tenfold while negative modes need it."""
_GUARDS = 4  # Additional modes of the search, so that the last of the k modes converges too.
_SWEEPS = 200  # Limit of the iterations of LOBPCG, of which 60 are usual.


@dataclass(frozen=True, eq=False)
class Inertia:
    """Mass matrix of the freedoms of a chain without its motion as a whole."""

    chain: Chain
    pose: Pose
    rigid: Floats  # (n_v, 0 or 6): Rigid motions of a free chain.

    @cached_property
    def freedoms(self) -> NDArray[np.int64]:
        """(n,) int: counted freedoms, all except the first root's if the chain is free."""
        return np.setdiff1d(np.arange(self.chain.n_v), self._root)

    @property
    def _root(self) -> NDArray[np.int64]:
        return self.chain.tree.v_start[0] + np.arange(self.rigid.shape[1])

    @cached_property
    def _along(self) -> Floats:
        """(n, 6) float: rates of the counted freedoms in rigid motions, by the first root's rates."""
        root = self.rigid[self._root]
        return np.asarray(np.linalg.solve(root.T, self.rigid[self.freedoms].T).T)

    @cached_property
    def _rigid_momenta(self) -> tuple[Floats, Floats]:
        """Momenta (n_v, 6) of the rigid motions, and their mass matrix (6, 6)."""
        momenta = np.array([self._multiply(motion) for motion in self.rigid.T]).reshape(-1, self.chain.n_v).T
        return momenta, self.rigid.T @ momenta

    def _multiply(self, x: Floats) -> Floats:
        return multibody.multiply_mass(self.chain.tree, self.pose.frames, x)

    def full(self, x: Floats) -> Floats:
        """Rates (n_v, ...) of all freedoms, without momentum, from the counted rates (n, ...)."""
        out = np.zeros((self.chain.n_v, *x.shape[1:]))
        out[self.freedoms] = x
        momenta, block = self._rigid_momenta
        return out - self.rigid @ np.linalg.solve(block, momenta.T @ out)

    def times(self, x: Floats) -> Floats:
        """Mass matrix times (n,)."""
        return self._multiply(self.full(x))[self.freedoms]

    def column(self, scale: float, j: int) -> Floats:
        """A column (n,) of the mass matrix times a number."""
        return scale * self.times(np.eye(1, len(self.freedoms), j)[0])

    def solve(self, tau: Floats) -> Floats:
        """Inverse of the mass matrix times (n,)."""
        torques = np.zeros(self.chain.n_v)
        torques[self.freedoms], torques[self._root] = tau, -self._along.T @ tau
        rates = multibody.solve_mass(self.chain.tree, self.pose.frames, torques)
        return rates[self.freedoms] - self._along @ rates[self._root]

    def matrix(self) -> Floats:
        """Mass matrix (n, n)."""
        momenta, block = self._rigid_momenta
        momenta = momenta[self.freedoms]
        full = mass_matrix(self.chain, self.pose)[np.ix_(self.freedoms, self.freedoms)]
        matrix = full - momenta @ np.linalg.solve(block, momenta.T)
        return 0.5 * (matrix + matrix.T)

    def log_det(self) -> float:
        """Logarithm of the determinant, in O(n): det M = det M_s det T^T M T / det T_root^2."""
        log_det_tree = multibody.log_det_mass(self.chain.tree, self.pose.frames)
        if not len(self._root):
            return log_det_tree
        log_det_whole, log_det_root = (
            float(np.linalg.slogdet(matrix)[1]) for matrix in (self._rigid_momenta[1], self.rigid[self._root])
        )
        return log_det_tree - log_det_whole + 2.0 * log_det_root


@check_arguments(k=at_least(1), method=one_of(METHODS))
def normal_modes(
    chain: Any, energy: Any = None, q: Any = None, k: int = 20, *, method: str = "auto"
) -> NormalModes:
    """Normal modes of a chain of rigid bodies: small motions of its hinges about a minimum.

    Parameters
    ----------
    chain : Chain, Structure, path, or anything that :func:`protochain.as_structure` accepts
        Files and structures are cut into chains with the default hinges, results with their hinges. A root
        that ``auto`` has fixed is freed, unless obstacles or the energy fix the position of the chain. A root
        with ``fixed`` stays fixed.
    energy : Energy or callable, optional
        As in :func:`protochain.minimise`.
    q : (n_q,) float, optional
        Coordinates of a minimum, by default the coordinates of the chain's structure. They are not minimised:
        ``is_minimum`` of the result reports whether they are a minimum.
    k : int
        Number of modes, the lowest first, or all if there are fewer.
    method : str
        ``dense`` computes the whole Hessian, as :func:`protochain.hessian`, and up to 2000 freedoms all
        frequencies. ``products`` computes the lowest by LOBPCG (Knyazev, SIAM J. Sci. Comput. 23:517, 2001)
        on differences of torques, preconditioned by a model of the Hessian. ``auto`` is dense if the Hessian
        is analytic, and else up to 1000 freedoms.

    Returns
    -------
    NormalModes
        Frequencies, modes, and derived quantities, without the six zero modes of a free molecule.

    Raises
    ------
    ProtochainError
        If the input cannot be used, the method is unknown, the modes do not converge, or there are more than
        16000 freedoms, or 6000 without an analytic Hessian.

    Examples
    --------
    >>> c = pc.build_chain(pc.from_sequence("GAG"))
    >>> at_minimum = pc.build_chain(pc.minimise(c, method="newton"))
    >>> pc.normal_modes(at_minimum, k=3).frequencies.shape
    (3,)
    """
    began = perf_counter()
    cut, energy_used = with_energy(chain, energy)
    start = cut.q0 if q is None else floats(q, (cut.n_q,), "q")
    held_by = frame_of(cut, energy_used).held_by
    chain = cut if held_by else with_free_root(cut)
    start = start if held_by else transfer_coordinates(cut, chain, start)
    # Solve K a = w^2 M a without the rigid motions of a free chain.
    torques = torques_at(chain, energy_used, start)
    at = pose(chain, torques.q)
    rigid_motions = np.empty((0, chain.n_v)) if held_by else motions_of_whole(chain, at)
    inertia = Inertia(chain, at, rigid_motions.T)
    n = len(inertia.freedoms)
    if n == 0:
        raise ProtochainError(f"{chain.structure.name}: it has no internal motion; open more hinges")
    analytic = applies(torques.energy)
    limit, remedy = MOST, ", or use OBC2 without a cutoff, whose Hessian is analytic"
    if analytic and method != "products":
        limit, remedy = ANALYTIC, ""
    if n > limit:  # More do not fit into memory and an hour.
        raise ProtochainError(
            f"{chain.structure.name}: {n} freedoms exceed the limit of {limit}; open fewer hinges{remedy}"
        )
    dense = method == "dense" or (method == "auto" and (analytic or n <= DENSE))
    solve = _dense if dense else _by_products
    eigenpairs = solve(torques, inertia, min(k, n))
    order = np.argsort(eigenpairs.values)
    return NormalModes(
        chain=chain,
        energy_function=torques.energy,
        q=read_only(torques.q),
        eigenvalues=read_only(eigenpairs.values[order]),
        modes=read_only(inertia.full(eigenpairs.vectors[:, order])),
        residuals=read_only(eigenpairs.residuals[order]),
        errors=read_only(eigenpairs.errors[order]),
        largest_eigenvalue=eigenpairs.largest,
        spectrum=None if eigenpairs.spectrum is None else read_only(eigenpairs.spectrum),
        log_det_mass=inertia.log_det(),
        log_det_hessian=eigenpairs.log_det,
        max_torque=torques.largest,
        held_by=held_by,
        n_products=eigenpairs.products,
        seconds=perf_counter() - began,
    )


@dataclass(frozen=True, eq=False)
class _Eigenpairs:
    """Eigenpairs: values (k,), vectors (n, k) with a^T M a = 1, residuals and errors (k,), and all values."""

    values: Floats
    vectors: Floats
    residuals: Floats
    errors: Floats
    largest: float
    products: int
    spectrum: Floats | None = None
    log_det: float | None = None


def _largest(stiffness: Floats) -> float:
    """Largest eigenvalue, by Lanczos."""
    n = len(stiffness)
    if n < 20:
        return float(np.linalg.eigvalsh(stiffness)[-1])
    values: Any = eigsh(stiffness, k=1, which="LA", return_eigenvectors=False, v0=np.ones(n))
    return float(values[0])


def _with_errors(values: Floats, vectors: Floats, misfit: Floats, norm: float, **data: Any) -> _Eigenpairs:
    """Eigenpairs with their backward errors, and errors of values from an error of 1e-8 of K."""
    sizes = np.linalg.norm(vectors, axis=0)
    residuals = np.linalg.norm(misfit, axis=0) / (norm * sizes)
    return _Eigenpairs(values, vectors, residuals, RESIDUAL * norm * sizes**2, **data)


def _dense(torques: Torques, inertia: Inertia, k: int) -> _Eigenpairs:
    """All eigenvalues by LAPACK, or for many freedoms the lowest and the largest by Lanczos."""
    stiffness = torques.matrix(inertia.freedoms)
    n = len(stiffness)
    if not np.isfinite(np.vdot(stiffness, stiffness)):
        raise ProtochainError(
            f"{inertia.chain.structure.name}: the Hessian is not finite; minimise it first",
            fault=Fault.NOT_FINITE,
        )
    if n > max(ALL, 2 * k):
        return _by_factor(_Factored(stiffness), inertia, k)
    mass, norm = inertia.matrix(), _largest(stiffness)
    values, vectors = eigh(stiffness, mass)
    lowest = vectors[:, :k]
    misfit = stiffness @ lowest - mass @ lowest * values[:k]
    largest, log_det = float(values[-1]), _log_det(stiffness)
    return _with_errors(
        values[:k], lowest, misfit, norm, largest=largest, products=0, spectrum=values, log_det=log_det
    )


def _log_det(stiffness: Floats) -> float | None:
    """Logarithm of the determinant, or None if the matrix is not positive definite."""
    try:
        return 2.0 * float(np.sum(np.log(np.diagonal(cholesky(stiffness, lower=True, check_finite=False)))))
    except LinAlgError:
        return None


class _Factored:
    """A symmetric matrix (n, n), and in the same memory the Cholesky factor of it or of a sum with it.

    The factor is in one triangle and the diagonal, which is copied. The matrix is in the other triangle.
    """

    def __init__(self, matrix: Floats) -> None:
        # LAPACK's matrix is the transpose, without a copy.
        self.matrix, self.diagonal = matrix.T, np.diagonal(matrix).copy()

    def __matmul__(self, x: Floats) -> Floats:
        upper = self.diagonal - np.diagonal(self.matrix)
        return np.asarray(dsymv(1.0, self.matrix, x, lower=0) + upper * x)

    def factorise(self, add: Callable[[int], Floats] | None = None) -> bool:
        """Factorise the matrix plus added columns. Return False if the sum is not positive definite."""
        for j, below in enumerate(self.matrix.T):
            below[j], below[j + 1 :] = self.diagonal[j], self.matrix[j, j + 1 :]
            if add is not None:
                below[j:] += add(j)[j:]
        return not dpotrf(self.matrix, lower=1, clean=0, overwrite_a=1)[1]

    def solve(self, b: Floats) -> Floats:
        return np.asarray(dpotrs(self.matrix, b, lower=1)[0])

    def log_det(self) -> float:
        return 2.0 * float(np.sum(np.log(np.diagonal(self.matrix))))


def _by_factor(stiffness: _Factored, inertia: Inertia, k: int) -> _Eigenpairs:
    """The lowest eigenpairs by Lanczos with a factor of K + s M, which is positive even with zero modes."""
    n = len(stiffness.diagonal)
    k_op, m_op, inverse_mass, inverse = (
        LinearOperator((n, n), matvec=f, dtype=np.float64)
        for f in (stiffness.__matmul__, inertia.times, inertia.solve, stiffness.solve)
    )
    start = np.ones(n)
    options: dict[str, Any] = {"k": 1, "which": "LA", "return_eigenvectors": False, "v0": start}
    norm = float(eigsh(k_op, **options)[0])
    largest = float(eigsh(k_op, M=m_op, Minv=inverse_mass, **options)[0])
    log_det = stiffness.log_det() if stiffness.factorise() else None
    shift = _SHIFT
    # The shift is below the lowest eigenvalue, so that the nearest eigenvalues are the lowest.
    while not stiffness.factorise(partial(inertia.column, shift)):
        shift *= 10.0
    values, lowest = eigsh(k_op, k=k, M=m_op, sigma=-shift, OPinv=inverse, v0=start)
    pairs = zip(lowest.T, values, strict=True)
    misfit = np.stack([stiffness @ a - inertia.times(a) * value for a, value in pairs])
    return _with_errors(values, lowest, misfit.T, norm, largest=largest, products=0, log_det=log_det)


def _by_products(torques: Torques, inertia: Inertia, k: int) -> _Eigenpairs:
    """Lowest eigenpairs, by LOBPCG with a model of the Hessian as preconditioner, and the largest value."""
    n, n_products = len(inertia.freedoms), 0

    def stiffness(x: Floats) -> Floats:
        nonlocal n_products
        n_products += 1
        rates = np.zeros(inertia.chain.n_v)
        rates[inertia.freedoms] = x
        return torques.product(rates)[inertia.freedoms]

    def operator(times: Callable[[Floats], Floats]) -> LinearOperator:
        def columns(x: Floats) -> Floats:
            return np.stack([times(column) for column in x.T], axis=1)

        return LinearOperator((n, n), matvec=lambda x: times(x.ravel()), matmat=columns, dtype=np.float64)

    k_op, m_op = operator(stiffness), operator(inertia.times)
    norm = float(eigsh(k_op, k=1, tol=0.05, return_eigenvectors=False, v0=np.ones(n))[0])
    try:
        inverse_mass = operator(inertia.solve)
        options: dict[str, Any] = {"k": 1, "tol": 1e-3, "return_eigenvectors": False, "v0": np.ones(n)}
        largest = float(eigsh(k_op, M=m_op, Minv=inverse_mass, **options)[0])
    except ArpackNoConvergence:
        largest = np.nan
    # Modes of the model are the first guess, and its factor is the preconditioner.
    model = _model(torques, inertia)
    factor = cho_factor(model, lower=True)
    guides = eigh(model, inertia.matrix(), subset_by_index=[0, min(n, k + _GUARDS) - 1])[1]
    tolerance = 0.5 * RESIDUAL * norm * float(np.min(np.linalg.norm(guides, axis=0)))
    with warnings.catch_warnings():
        # Residuals are checked below.
        warnings.simplefilter("ignore")
        solution: Any = lobpcg(
            k_op, guides, B=m_op, M=operator(lambda x: cho_solve(factor, x)), tol=tolerance, maxiter=_SWEEPS,
            largest=False,
        )  # fmt: skip
    order = np.argsort(solution[0])[:k]
    values, vectors = solution[0][order], solution[1][:, order]
    misfit = k_op.matmat(vectors) - m_op.matmat(vectors) * values
    eigenpairs = _with_errors(values, vectors, misfit, norm, largest=largest, products=n_products)
    if np.max(eigenpairs.residuals) > RESIDUAL:
        raise ProtochainError(
            f"{inertia.chain.structure.name}: the modes did not converge: a residual is "
            f"{np.max(eigenpairs.residuals):.1g} above {RESIDUAL:g}; compute more modes, or use the "
            "dense method"
        )
    return eigenpairs


def _model(torques: Torques, inertia: Inertia) -> Floats:
    """Stiffness (n, n) of near terms, or of contacts if terms are unknown, as in minimisers."""
    matrix = Torsions(inertia.chain, near_terms(torques.energy)).model(inertia.pose)
    matrix = matrix[np.ix_(inertia.freedoms, inertia.freedoms)]
    matrix[np.diag_indices_from(matrix)] += _FLOOR * torques.scale[inertia.freedoms] ** -2
    return matrix
