"""Loop closure by constraints: constant distances between atoms of two bodies."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, solve_triangular

from protochain.chains.chain import Chain, pose
from protochain.core.arrays import Floats, Integers
from protochain.core.errors import ChainError, Fault
from protochain.core.settings import document_fields
from protochain.mechanics.motion.system import Drift, Drifted, Phase, StepTooLargeError
from protochain.mechanics.multibody import (
    Frames,
    Rows,
    Tree,
    operational_inverse,
    pull_back,
    row_matrix,
    solve_closed,
    velocities,
)  # fmt: skip
from protochain.mechanics.multibody.articulated import Articulated, solve
from protochain.mechanics.multibody.hamilton import turning_gradient
from protochain.mechanics.multibody.loops import factor_closed
from protochain.mechanics.multibody.newton_euler import momenta_of_bodies
from protochain.mechanics.multibody.operational import row_loads

CLOSED_NM = 1e-12
"""Largest error of a distance after a step, about a hundred times the rounding error of coordinates."""


@document_fields
@dataclass(frozen=True, eq=False)
class Closure:
    """Distance constraints that close loops."""

    tree: Tree  # Rigid bodies.
    body: Integers  # (m, 2) int: Bodies of the two ends of each distance.
    local: Floats  # (m, 2, 3) float, nm: Positions of the ends in the frames of their bodies.
    length: Floats  # (m,) float, nm: Constant values of the distances.

    def ends(self, frames: Frames) -> Floats:
        """(m, 2, 3) float, nm: positions of the ends."""
        turned = np.einsum("meij,mej->mei", frames.rotation[self.body], self.local)
        return np.asarray(turned + frames.origin[self.body])

    def errors(self, frames: Frames) -> Floats:
        """(m,) float, nm: deviations of the distances from their constant values."""
        first, second = self.ends(frames).swapaxes(0, 1)
        return np.asarray(np.linalg.norm(second - first, axis=1) - self.length)

    def rows(self, frames: Frames) -> Rows:
        """Time derivatives of the distances, as constraint rows on the twists of the bodies."""
        ends = self.ends(frames)
        along = ends[:, 1] - ends[:, 0]
        along /= np.linalg.norm(along, axis=1)[:, None]
        force = np.stack([-along, along], axis=1)
        arm = ends - frames.origin[self.body]
        return Rows(self.body, np.concatenate([np.cross(arm, force), force], axis=2))

    def project_velocities(self, factors: Articulated, p: Floats) -> Floats:
        """Velocities (n_v,) of momenta p (n_v,), projected so that the distances stay constant."""
        return solve_closed(self.tree, factors.frames, p, self.rows(factors.frames))

    def log_det(self, factors: Articulated) -> tuple[float, Floats]:
        """Logarithm of det(G M^-1 G^T), with G the rows, and its gradient (n_v,) along q.

        Raises
        ------
        MechanicsError
            If the rows are linearly dependent.

        Notes
        -----
        With A = G M^-1 G^T = L L^T, G' = L^-1 G and u_i the rows of G' M^-1, the gradient is the sum over i
        of 2 dG'_i u_i - u_i^T dM u_i at constant L and u. Both terms are gradients of loads on twists (of the
        rows and of the momenta) that turn with the bodies, except the lines of the distances. O(m n + m^3).
        """
        tree, frames = factors.tree, factors.frames
        rows = self.rows(frames)
        g, loads = row_matrix(tree, frames, rows), row_loads(tree, rows)
        responses = np.array([solve(factors, row) for row in g])
        upper, _ = factor_closed(responses @ g.T)
        mix = solve_triangular(upper, np.eye(len(g)), trans=1)
        twists = np.array([velocities(tree, frames, u) for u in mix @ responses])
        gradient = pull_back(tree, frames, self._turned_lines(frames, np.tensordot(mix, twists, (0, 0))))
        for twist, weights in zip(twists, mix, strict=True):
            load = np.tensordot(weights, loads, 1) - momenta_of_bodies(tree, frames, twist)
            gradient = gradient + turning_gradient(tree, frames, twist, load)
        return 2.0 * float(np.sum(np.log(np.diagonal(upper)))), 2.0 * gradient

    def _turned_lines(self, frames: Frames, twists: Floats) -> Floats:
        """(nb, 6) loads whose torques are the change of :meth:`rows` other than turning with their bodies."""
        # twists (m, nb, 6).
        ends = self.ends(frames)
        line = ends[:, 1] - ends[:, 0]
        length = np.linalg.norm(line, axis=1)[:, None]
        along = line / length
        arm = ends - frames.origin[self.body]
        end_twists = twists[np.arange(len(ends))[:, None], self.body]
        velocity = end_twists[..., 3:] + np.cross(end_twists[..., :3], arm)
        separation_rate = velocity[:, 1] - velocity[:, 0]
        across = (separation_rate - along * np.sum(along * separation_rate, axis=1)[:, None]) / length
        out = np.zeros((self.tree.n_bodies, 6))
        for side, sign in ((0, -1.0), (1, 1.0)):
            moment = np.cross(arm[:, side], across) - np.cross(along, velocity[:, side])
            np.add.at(out, self.body[:, side], sign * np.concatenate([moment, across], axis=1))
        return out

    def drift(self, drift: Drift, at: Phase, p: Floats, time_step: float) -> Drifted:
        """Drift with constraint impulses at the start, such that the distances are correct at the end.

        Raises
        ------
        StepTooLargeError
            If the iteration for the impulses does not converge.
        ChainError
            If it does not converge because of the distance from the origin.

        Notes
        -----
        RATTLE for a general Hamiltonian: Jay, SIAM J. Numer. Anal. 33:368 (1996). Newton's method with
        G M^-1 G^T at the start of the step.
        """
        rows = self.rows(at.factors.frames)
        g = row_matrix(self.tree, at.factors.frames, rows)
        inverse = factor_closed(operational_inverse(self.tree, at.factors.frames, rows))
        impulse = np.zeros(len(g))
        for _ in range(50):
            q, end, factors = drift(at, p - g.T @ impulse, time_step)
            error = self.errors(factors.frames)
            if np.max(np.abs(error)) < CLOSED_NM:
                return q, end, factors
            impulse += cho_solve(inverse, error) / time_step
        far = float(np.max(np.abs(at.factors.frames.origin)))
        if np.finfo(float).eps * far > CLOSED_NM / 4:
            raise ChainError(
                f"loops cannot be closed {far:.3g} nm from the origin, where coordinates are rounded by more "
                f"than their tolerance of {CLOSED_NM:g} nm; move the structure to the origin",
                fault=Fault.FAR,
            )
        raise StepTooLargeError("no impulses close the loops at the end of the time step")


def closure_of(chain: Chain, q: Floats | None = None) -> Closure:
    """Constrain the bond and the bond angles at each loop of a chain to their values at q.

    Parameters
    ----------
    chain : Chain
        Chain with disulfides or other cross-links.
    q : (n_q,) float, optional
        Coordinates. Default: the input pose.

    Returns
    -------
    Closure
        Three distances per loop, fewer at an ion. The force field determines its dihedral.

    Raises
    ------
    ChainError
        If the chain has no loop.
    """
    if not len(chain.loops):
        raise ChainError(f"{chain.structure.name}: no loop to close; choose loops open")
    s = chain.structure
    heavy = s.atom_element != "H"

    def before(atom: int) -> int | None:
        near = (b for b in s.neighbours[atom] if heavy[b] and s.atom_residue[b] == s.atom_residue[atom])
        return next(near, None)

    pairs = [pair for a, b in chain.loops.tolist() for pair in ((a, b), (before(a), b), (a, before(b)))]
    atoms = np.array([pair for pair in pairs if None not in pair], dtype=np.int64)
    x = pose(chain, chain.q0 if q is None else q).x
    length = np.linalg.norm(x[atoms[:, 1]] - x[atoms[:, 0]], axis=1)
    return Closure(chain.tree, chain.atom_body[atoms], chain.atom_local[atoms], length)
