"""Model of the Hessian from geometry alone: springs between nearby atoms, stiffest along bonds.

For energies whose near terms are not known (:mod:`protochain.minimisers.curvature`), e.g. callables.

Minimisation is slow because some freedoms are a million times stiffer than others. Bonds are stiffer than
dihedrals. Dihedrals that press two atoms together are stiffer than others that swing a loop. Springs between
atoms reproduce this well enough for a preconditioner, for any force field. Packwood, Kermode, Mones,
Bernstein, Woolley, Gould, Ortner, Csanyi, J. Chem. Phys. 144:164109 (2016) use exponentially decaying
stiffness. Mones, Ortner, Csanyi, Sci. Rep. 8:13991 (2018) add springs for bonds and angles. In torsions K =
J^T C J, as in torsional elastic networks (Mendez, Bastolla, Phys. Rev. Lett. 104:228103, 2010).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from protochain.chains.chain import Chain, Pose
from protochain.chains.contacts import bonded_pairs, near_pairs
from protochain.core.arrays import Floats, Integers, distance
from protochain.minimisers.torsion_kernels import stiffness_in_torsions
from protochain.structure.molecule.model import Structure, per_structure

DEPTH = 0.4
"""kJ/mol, well depth of a contact. Lennard-Jones wells of protein atoms are 0.06 to 1 deep. The curvature at
the minimum is 72 times the depth divided by the squared distance."""

DECAY = 14.0
"""Decay rate of the stiffness per contact distance, as in the repulsive part of a curvature, r^-14. The whole
12-6 curvature has a rate of 21 at contact."""

REACH = 1.3  # Longest spring, in contact distances. Its stiffness is 2 % of the stiffness at contact.
TORSION_FLOOR = 150.0
"""kJ/mol/rad^2, added for every freedom, for dihedrals and long-range forces. 60 to 400 perform alike."""
BOND, ANGLE, DIHEDRAL = 2.5e5, 4.0e4, 2.0e3
"""kJ/mol/nm^2, of springs between atoms one, two and three bonds apart. Bonds of ff14SB have 1.5e5 to 5e5.
Angles have 300 to 700 kJ/mol/rad^2, at a lever of about 0.1 nm."""

CARTESIAN_FLOOR = 8.0e3  # kJ/mol/nm^2, added for every atom.


@dataclass(frozen=True, eq=False)
class Springs:
    """Harmonic springs along the lines between pairs of atoms."""

    pairs: Integers  # (n, 2) int.
    stiffness: Floats  # (n,) kJ/mol/nm^2.


def contacts(structure: Structure, x: Floats, bonds: int, decay: float = DECAY) -> Springs:
    """Springs between nearby atoms that are more than this many bonds apart."""
    pairs, touch = near_pairs(structure, x, REACH, bonds)
    share = distance(*x[pairs.T]) / touch
    return Springs(pairs, 72.0 * DEPTH / touch**2 * np.exp(-decay * (share - 1.0)))


@per_structure
def covalent(structure: Structure) -> Springs:
    """Springs for bonds, angles and dihedrals: between atoms up to three bonds apart."""
    pairs = bonded_pairs(structure, 3)
    n = structure.n_atoms
    keys = pairs @ [n, 1]
    near = [np.isin(keys, bonded_pairs(structure, bonds) @ [n, 1]) for bonds in (1, 2)]
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
    """Stiffness K = J^T C J of the contacts of a chain, in its torsions."""
    # tether (na,) -> (n_v, n_v) kJ/mol/rad^2, of all terms between bodies. Springs within a rigid group have
    # constant lengths.
    near = near_by(chain.structure, at.x, 2)
    along = _directions(at.x, near.pairs)
    lengths = near.pairs, np.stack([along, -along], axis=1), near.stiffness
    tether_stiffness = np.zeros(chain.n_atoms) if tether is None else np.array(tether)
    return stiffness_in_torsions(chain, at, [lengths, *gradients], tether_stiffness)


def _directions(x: Floats, pairs: Integers) -> Floats:
    """Unit vectors (n, 3) from second to first atom, zero for coinciding atoms."""
    across = x[pairs[:, 0]] - x[pairs[:, 1]]
    length = np.linalg.norm(across, axis=1, keepdims=True)
    return np.divide(across, length, out=np.zeros_like(across), where=length > 0)
