"""Quality of a structure: size, secondary structure, outliers, overlaps, hydrogen bonds, geometry."""

from typing import Any

import numpy as np

from protochain.chains.chain import Chain
from protochain.chains.contacts import overlaps
from protochain.core.arrays import Floats, angle, distance
from protochain.core.checks import check_arguments, instance
from protochain.core.graph import bond_angles
from protochain.core.units import ANGSTROM_PER_NM
from protochain.minimisers import Solution
from protochain.structure import Structure, as_structure, ca_rmsd
from protochain.structure.matching import tm_score
from protochain.validation import measures
from protochain.validation.bonding import hydrogen_bonds, secondary_structure


@check_arguments(chain=instance(Chain, "pc.build_chain(structure)"))
def quality(structure: Any, start: Any = None, chain: Chain | None = None) -> dict[str, Any]:
    """Measure the quality of a structure, alone and against a start.

    Parameters
    ----------
    structure : Structure, Solution, path, or anything that :func:`protochain.as_structure` accepts
        Structure to measure. A solution is measured against its own start.
    start : the same, with the same atoms, optional
        Structure before the change. Without it, measures of change are skipped.
    chain : Chain, optional
        Chain of the start, whose hinges determine which overlaps count.

    Returns
    -------
    dict of str to float
        ``radius_of_gyration_angstrom``, ``overlaps`` of nonbonded atoms, ``hydrogen_bonds`` (Baker, Hubbard,
        1984), and all of :func:`protochain.validation.measures`. With a start also
        ``ca_rmsd_to_start_angstrom``, ``tm_score_to_start``, ``secondary_structure_kept`` (fraction of
        residues, by DSSP), ``bond_length_change_rms_angstrom`` and ``bond_angle_change_rms_degrees``.

    Raises
    ------
    ProtochainError
        If the start has other atoms.

    Examples
    --------
    >>> round(pc.quality("structures/1l2y.pdb")["radius_of_gyration_angstrom"], 1)
    7.3
    """
    if start is None and isinstance(structure, Solution):
        start, chain = structure.chain, chain or structure.chain
    structure = as_structure(structure)
    if start is None:
        return _alone(structure, chain)
    start = as_structure(start)
    rmsd = ca_rmsd(structure, structure.positions, start)
    lengths = _bond_lengths(structure) - _bond_lengths(start)
    angles = _bond_angles(structure) - _bond_angles(start)
    score, folds = tm_score(start, structure), [secondary_structure(model) for model in (structure, start)]
    measured = _alone(structure, chain)
    return {
        "radius_of_gyration_angstrom": measured.pop("radius_of_gyration_angstrom"),
        "ca_rmsd_to_start_angstrom": rmsd,
        "tm_score_to_start": score if np.isfinite(score) else None,
        "secondary_structure_kept": float(np.mean(folds[0] == folds[1])),
        **measured,
        "bond_length_change_rms_angstrom": ANGSTROM_PER_NM * _root_mean_square(lengths),
        "bond_angle_change_rms_degrees": float(np.degrees(_root_mean_square(angles))),
    }


def _alone(structure: Structure, chain: Chain | None) -> dict[str, Any]:
    return {
        "radius_of_gyration_angstrom": radius_of_gyration(structure),
        "overlaps": len(overlaps(structure, structure.positions, chain)),
        "hydrogen_bonds": len(hydrogen_bonds(structure)),
        **measures(structure),
    }


def radius_of_gyration(structure: Structure) -> float:
    """Mass-weighted radius of gyration of all atoms in angstrom (mdtraj centres without masses)."""
    share = structure.atom_mass / structure.atom_mass.sum()
    arms = structure.positions - share @ structure.positions
    return float(ANGSTROM_PER_NM * np.sqrt(share @ np.sum(arms**2, axis=1)))


def _bond_lengths(structure: Structure) -> Floats:
    return distance(*structure.positions[structure.bonds.T])


def _bond_angles(structure: Structure) -> Floats:
    return angle(*structure.positions[bond_angles(structure.bonds, structure.n_atoms).T])


def _root_mean_square(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
