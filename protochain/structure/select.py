"""Atom selection in the language of MDAnalysis, and places named as chain:number:atom."""

import re

import numpy as np

from protochain.arrays import Integers
from protochain.errors import StructureError
from protochain.structure.convert import to_mdanalysis
from protochain.structure.model import Structure


def select(structure: Structure, selection: str) -> np.ndarray:
    """Select atoms.

    Parameters
    ----------
    structure : Structure
    selection : str
        In the language of MDAnalysis, distances in angstrom: ``resid 5:20 and not backbone``, ``chainID A``,
        ``around 5 resid 12``.

    Returns
    -------
    (na,) bool
        Mask of the selected atoms.

    Raises
    ------
    StructureError
        If the selection cannot be read or is empty.
    """
    from MDAnalysis.exceptions import SelectionError

    universe = to_mdanalysis(structure)
    try:
        chosen = universe.select_atoms(selection)
    except (SelectionError, ValueError, AttributeError) as error:
        reason = " ".join(str(error).split())
        raise StructureError(f"selection {selection!r} cannot be read: {reason}") from None
    mask = np.zeros(structure.n_atoms, dtype=bool)
    mask[chosen.indices] = True
    if not mask.any():
        raise StructureError(f"{structure.name}: selection {selection!r} selects no atom; change it")
    return mask


def atoms_at(structure: Structure, place: str) -> Integers:
    """Atoms of a place.

    Parameters
    ----------
    structure : Structure
    place : str
        An atom as ``A:20:CA``, a residue as ``A:20`` or ``A:20B`` (with its insertion code), or a selection.

    Returns
    -------
    (n,) int
        At least one.

    Raises
    ------
    StructureError
        If there is no such residue or atom, or more than one residue of this name.
    """
    named = re.fullmatch(r"(\S*):(-?\d+\w?)(?::(\S+))?", place)
    if not named:
        return np.flatnonzero(select(structure, place))
    chain, number, atom = named.groups()
    numbers = np.char.add(structure.residue_number, structure.residue_insertion_code)
    of_chain = structure.residue_chain == chain
    found = np.flatnonzero(of_chain & (numbers == number))
    if len(found) > 1:
        # Waters and ligands may be numbered as residues of the protein are.
        beside = np.unique(structure.atom_residue[structure.kept])
        found = np.setdiff1d(found, beside) if len(np.setdiff1d(found, beside)) else found
    if len(found) != 1:
        chains = dict.fromkeys(name or "(blank)" for name in structure.residue_chain.tolist())
        known = f"its chains are {', '.join(chains)}"
        if of_chain.any():
            known = f"chain {chain} has {numbers[of_chain][0]} to {numbers[of_chain][-1]}"
        how_many = len(found) or "no"
        raise StructureError(
            f"{structure.name}: {place}: there are {how_many} residues {chain}:{number}; {known}"
        )
    (atoms,) = np.nonzero(structure.atom_residue == found[0])
    if atom is None:
        return atoms
    its = atoms[structure.atom_name[atoms] == atom]
    if not len(its):
        raise StructureError(
            f"{structure.name}: {place}: no atom {atom} in {structure.describe_residue(int(found[0]))}; "
            f"its atoms are {' '.join(structure.atom_name[atoms])}"
        )
    return its
