"""Loop closure by constraints: constant distances between atoms of two bodies."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from protochain.arrays import Floats, Integers
from protochain.chain import Chain, pose
from protochain.dynamics.system import Drift, Drifted, Phase, StepTooLargeError
from protochain.errors import ChainError
from protochain.multibody import Frames, Rows, Tree, operational_inverse, row_matrix, solve_closed
from protochain.multibody.articulated import Articulated

CLOSED_NM = 1e-12
"""Largest error of a distance after a step: some hundred times the rounding error of coordinates."""
_ITERATIONS = 50


@dataclass(frozen=True, eq=False)
class Closure:
    """Distance constraints that close loops.

    Parameters
    ----------
    tree : Tree
        Rigid bodies.
    body : (m, 2) int
        Bodies of the two ends of each distance.
    local : (m, 2, 3) float, nm
        Positions of the ends in the frames of their bodies.
    length : (m,) float, nm
        Constant values of the distances.
    """

    tree: Tree
    body: Integers
    local: Floats
    length: Floats

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
        """Velocities (n_v,) of momenta p (n_v,), projected onto those that keep the distances."""
        return solve_closed(self.tree, factors.frames, p, self.rows(factors.frames))

    def drift(self, drift: Drift, at: Phase, p: Floats, time_step: float) -> Drifted:
        """Drift with constraint impulses at the start, such that the distances are kept at the end.

        Raises
        ------
        StepTooLargeError
            If the iteration for the impulses does not converge.

        Notes
        -----
        RATTLE for a general Hamiltonian: Jay, SIAM J. Numer. Anal. 33:368 (1996). Newton's method with
        G M^-1 G^T at the start of the step.
        """
        rows = self.rows(at.factors.frames)
        g = row_matrix(self.tree, at.factors.frames, rows)
        inverse = cho_factor(operational_inverse(self.tree, at.factors.frames, rows))
        impulse = np.zeros(len(g))
        for _ in range(_ITERATIONS):
            q, end, factors = drift(at, p - g.T @ impulse, time_step)
            error = self.errors(factors.frames)
            if np.max(np.abs(error)) < CLOSED_NM:
                return q, end, factors
            impulse += cho_solve(inverse, error) / time_step
        raise StepTooLargeError(
            f"no impulses keep the loops closed over a step of {1000 * abs(time_step):g} fs"
        )


def closure_of(chain: Chain, q: Floats | None = None) -> Closure:
    """Constrain the bond and the bond angles at each loop of a chain to their values at q.

    Parameters
    ----------
    chain : Chain
        Chain with disulfides or other cross-links.
    q : (n_q,) float, optional
        Coordinates; by default those of the input pose.

    Returns
    -------
    Closure
        Three distances a loop, fewer at an ion; its dihedral is left to the force field.

    Raises
    ------
    ChainError
        If there is no loop.
    """
    if not len(chain.loops):
        raise ChainError(f"{chain.structure.name}: no loop to close; choose loops open")
    s = chain.structure
    heavy = s.atom_element != "H"

    def before(atom: int) -> int | None:
        touching = s.bonds[(s.bonds == atom).any(axis=1)]
        others = [int(b) for pair in touching.tolist() for b in pair if b != atom]
        near = [b for b in others if heavy[b] and s.atom_residue[b] == s.atom_residue[atom]]
        return near[0] if near else None

    pairs = [pair for a, b in chain.loops.tolist() for pair in ((a, b), (before(a), b), (a, before(b)))]
    atoms = np.array([pair for pair in pairs if None not in pair], dtype=np.int64)
    x = pose(chain, chain.q0 if q is None else q).x
    length = np.linalg.norm(x[atoms[:, 1]] - x[atoms[:, 0]], axis=1)
    return Closure(chain.tree, chain.atom_body[atoms], chain.atom_local[atoms], length)
