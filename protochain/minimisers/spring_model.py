"""Model of the Hessian from geometry alone: springs between nearby atoms, stiffest along bonds.

For energies whose near terms are not known (:mod:`protochain.minimisers.curvature`), as of a callable.

Minimisation is slow because some freedoms are a million times stiffer than others: bonds than dihedrals and,
among dihedrals, those that press two atoms together than those that swing a loop. Springs between atoms
reproduce this well enough for a preconditioner, whatever the force field: Packwood, Kermode, Mones,
Bernstein, Woolley, Gould, Ortner, Csanyi, J. Chem. Phys. 144:164109 (2016), with stiffness falling
exponentially; with bonds and angles as further springs, Mones, Ortner, Csanyi, Sci. Rep. 8:13991 (2018). In
torsions K = J^T C J, as in torsional elastic networks (Mendez, Bastolla, Phys. Rev. Lett. 104:228103, 2010).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from protochain.chains.chain import Chain, Pose
from protochain.chains.contacts import joined, near_pairs
from protochain.core.arrays import Floats, Integers
from protochain.minimisers.torsion_kernels import stiffness_in_torsions
from protochain.structure.model import Structure, of_atoms

DEPTH = 0.4
"""kJ/mol, well depth of a contact: Lennard-Jones wells of protein atoms are 0.06 to 1 deep. The curvature at
the minimum is 72 times the depth divided by the square of the distance."""

DECAY = 14.0
"""Decay rate of the stiffness, per contact distance: that of the repulsive part of a curvature, r^-14. The
whole 12-6 curvature falls by 21 at contact."""

REACH = 1.3
"""Longest spring, in contact distances; its stiffness is 2 % of that at contact."""

TORSION_FLOOR = 150.0
"""kJ/mol/rad^2, added for every freedom, for dihedral terms and long-range forces. Values between 60 and 400
perform alike."""

BOND, ANGLE, DIHEDRAL = 2.5e5, 4.0e4, 2.0e3
"""kJ/mol/nm^2, of springs between atoms one, two and three bonds apart: ff14SB's bonds have 1.5e5 to 5e5, and
an angle's 300 to 700 kJ/mol/rad^2 act at a lever of about 0.1 nm."""

CARTESIAN_FLOOR = 8.0e3
"""kJ/mol/nm^2, added for every atom."""


@dataclass(frozen=True, eq=False)
class Springs:
    """Harmonic springs along lines between pairs (n, 2) int of stiffness (n,) kJ/mol/nm^2."""

    pairs: Integers
    stiffness: Floats


def contacts(structure: Structure, x: Floats, bonds: int, decay: float = DECAY) -> Springs:
    """Springs between nearby atoms that are more than this many bonds apart."""
    pairs, touch = near_pairs(structure, x, REACH, bonds)
    distance = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)
    return Springs(pairs, 72.0 * DEPTH / touch**2 * np.exp(-decay * (distance / touch - 1.0)))


@of_atoms
def covalent(structure: Structure) -> Springs:
    """Springs for bonds, angles and dihedrals: between atoms up to three bonds apart."""
    pairs = joined(structure, 3)
    n = structure.n_atoms
    keys = pairs @ [n, 1]
    near = [np.isin(keys, joined(structure, bonds) @ [n, 1]) for bonds in (1, 2)]
    return Springs(pairs, np.select(near, [BOND, ANGLE], DIHEDRAL))


Near = Callable[[Structure, Floats, int], Springs]
"""Springs between near atoms more than a number of bonds apart: :func:`contacts`, or softer ones."""


Gradients = tuple[Integers, Floats, Floats]
"""Atoms (n, k) of angles or dihedrals, gradients (n, k, 3) in rad/nm, and stiffness (n,) in kJ/mol/rad^2."""


def torsion_stiffness(
    chain: Chain,
    at: Pose,
    near_by: Near = contacts,
    tether: Floats | None = None,
    gradients: Sequence[Gradients] = (),
) -> Floats:
    """Stiffness K = J^T C J of the contacts of a chain, in its torsions.

    tether (na,).
    -> (n_v, n_v) kJ/mol/rad^2: Of all that acts between bodies; springs within a rigid group keep their
        length.
    """
    near = near_by(chain.structure, at.x, 2)
    along = _directions(at.x, near.pairs)
    lengths = near.pairs, np.stack([along, -along], axis=1), near.stiffness
    held = np.zeros(chain.n_atoms) if tether is None else np.array(tether)
    return stiffness_in_torsions(chain, at, [lengths, *gradients], held)


def cartesian_solver(
    structure: Structure,
    bonded: Springs,
    x: Floats,
    moving: NDArray[np.bool_],
    near_by: Near = contacts,
    tether: Floats | None = None,
    floor: float = CARTESIAN_FLOOR,
) -> Callable[[Floats], Floats]:
    """Solver for the sparse stiffness of bonds, angles, dihedrals and contacts, in Cartesian coordinates.

    x (na, 3) nm, moving (na,) bool, tether (na,), floor kJ/mol/nm^2.
    """
    near = near_by(structure, x, 3)
    matrix = _sparse(structure.n_atoms, bonded, x, True) + _sparse(structure.n_atoms, near, x, False)
    matrix.setdiag(matrix.diagonal() + (floor if tether is None else np.repeat(floor + tether, 3)))
    free = np.flatnonzero(np.repeat(moving, 3))
    factors = splu(
        csc_array(matrix[free][:, free]), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )  # fmt: skip

    return on_moving(moving, factors.solve)


def on_moving(moving: NDArray[np.bool_], solve: Callable[[Floats], Floats]) -> Callable[[Floats], Floats]:
    """Solver for all atoms, made of one for those that move: the others take no step."""
    free = np.flatnonzero(np.repeat(moving, 3))

    def solve_all(torque: Floats) -> Floats:
        step = np.zeros_like(torque)
        step[free] = solve(torque[free])
        return step

    return solve_all


def _sparse(n_atoms: int, springs: Springs, x: Floats, coupled: bool) -> csc_array:
    """Sparse stiffness (3 na, 3 na) of springs; uncoupled, only its diagonal blocks."""
    i, j = springs.pairs.T
    along = _directions(x, springs.pairs)
    block = springs.stiffness[:, None, None] * along[:, :, None] * along[:, None, :]
    places = [(i, i, block), (j, j, block)]
    if coupled:
        places += [(i, j, -block), (j, i, -block)]
    row, column = (np.concatenate([place[k] for place in places]) for k in (0, 1))
    values = np.concatenate([place[2] for place in places])
    three = np.arange(3)
    rows = np.broadcast_to(3 * row[:, None, None] + three[:, None], values.shape)
    columns = np.broadcast_to(3 * column[:, None, None] + three, values.shape)
    shape = (3 * n_atoms, 3 * n_atoms)
    return coo_array((values.ravel(), (rows.ravel(), columns.ravel())), shape=shape).tocsc()


def _directions(x: Floats, pairs: Integers) -> Floats:
    """Unit vectors (n, 3) from second to first atom; zero for atoms at one point."""
    across = x[pairs[:, 0]] - x[pairs[:, 1]]
    length = np.linalg.norm(across, axis=1, keepdims=True)
    return np.divide(across, length, out=np.zeros_like(across), where=length > 0)
