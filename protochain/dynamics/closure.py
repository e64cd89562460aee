"""Loops held closed: distances between atoms of two bodies that do not change."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from protochain.arrays import Floats, Integers
from protochain.chain import Chain, pose
from protochain.dynamics.system import Flight, Flown, Phase, StepTooLargeError
from protochain.errors import ChainError
from protochain.multibody import Frames, Rows, Tree, operational_inverse, row_matrix, solve_closed
from protochain.multibody.articulated import Articulated

CLOSED_NM = 1e-12
"""What a distance may be off after a step: some hundred roundings of coordinates of a nanometre."""
_ITERATIONS = 50


@dataclass(frozen=True, eq=False)
class Closure:
    """Distances that are kept.

    Parameters
    ----------
    tree : Tree
    body : (m, 2) int
        Bodies of the two ends of each distance.
    local : (m, 2, 3) float, nm
        The ends in the frames of their bodies.
    length : (m,) float, nm
    """

    tree: Tree
    body: Integers
    local: Floats
    length: Floats

    def ends(self, frames: Frames) -> Floats:
        """(m, 2, 3) float, nm: where the ends are."""
        turned = np.einsum("meij,mej->mei", frames.rotation[self.body], self.local)
        return np.asarray(turned + frames.origin[self.body])

    def errors(self, frames: Frames) -> Floats:
        """(m,) float, nm: distances less what they ought to be."""
        first, second = self.ends(frames).swapaxes(0, 1)
        return np.asarray(np.linalg.norm(second - first, axis=1) - self.length)

    def rows(self, frames: Frames) -> Rows:
        """Rates of the distances, as rows on the twists of the bodies."""
        ends = self.ends(frames)
        along = ends[:, 1] - ends[:, 0]
        along /= np.linalg.norm(along, axis=1)[:, None]
        force = np.stack([-along, along], axis=1)
        arm = ends - frames.origin[self.body]
        return Rows(self.body, np.concatenate([np.cross(arm, force), force], axis=2))

    def kept(self, factors: Articulated, p: Floats) -> Floats:
        """Velocities (n_v,) of momenta p (n_v,), less those that would change the distances."""
        return solve_closed(self.tree, factors.frames, p, self.rows(factors.frames))

    def fly(self, flight: Flight, at: Phase, p: Floats, time_step: float) -> Flown:
        """Fly with impulses at the start that keep the distances to the end.

        Raises
        ------
        StepTooLargeError
            If no impulses are found.

        Notes
        -----
        RATTLE for a general Hamiltonian: Jay, SIAM J. Numer. Anal. 33:368 (1996). Newton's method with
        G M^-1 G^T of where the step begins.
        """
        rows = self.rows(at.factors.frames)
        g = row_matrix(self.tree, at.factors.frames, rows)
        inverse = cho_factor(operational_inverse(self.tree, at.factors.frames, rows))
        impulse = np.zeros(len(g))
        for _ in range(_ITERATIONS):
            q, end, factors = flight(at, p - g.T @ impulse, time_step)
            error = self.errors(factors.frames)
            if np.max(np.abs(error)) < CLOSED_NM:
                return q, end, factors
            impulse += cho_solve(inverse, error) / time_step
        raise StepTooLargeError(f"no impulses keep the loops closed in {1000 * abs(time_step):g} fs")


def closure_of(chain: Chain) -> Closure:
    """Bond and bond angles of each loop of a chain, at the lengths they have at q0.

    Parameters
    ----------
    chain : Chain

    Returns
    -------
    Closure
        Three distances a loop; its dihedral is left to the force field.

    Raises
    ------
    ChainError
        If there is no loop.
    """
    if not len(chain.loops):
        raise ChainError(f"{chain.structure.name}: has no loop to hold closed")
    s = chain.structure
    heavy = s.atom_element != "H"

    def before(atom: int) -> int:
        touching = s.bonds[(s.bonds == atom).any(axis=1)]
        others = [int(b) for pair in touching.tolist() for b in pair if b != atom]
        near = [b for b in others if heavy[b] and s.atom_residue[b] == s.atom_residue[atom]]
        return near[0]

    pairs = [pair for a, b in chain.loops.tolist() for pair in ((a, b), (before(a), b), (a, before(b)))]
    atoms = np.array(pairs, dtype=np.int64)
    x = pose(chain, chain.q0).x
    length = np.linalg.norm(x[atoms[:, 1]] - x[atoms[:, 0]], axis=1)
    return Closure(chain.tree, chain.atom_body[atoms], chain.atom_local[atoms], length)
