"""Atom selection in the language of MDAnalysis, and places named as chain:number:atom."""

import re

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from protochain.core import defaults
from protochain.core.arrays import Integers
from protochain.core.errors import StructureError
from protochain.structure.convert import to_mdanalysis
from protochain.structure.model import Structure


def select(structure: Structure, selection: str) -> np.ndarray:
    """Select atoms.

    Parameters
    ----------
    structure : Structure
    selection : str
        In the language of MDAnalysis, distances in angstrom: ``resid 5:20 and not backbone``, ``chainID A``,
        ``around 5 resid 12``. Two words more: ``sidechain``, atoms of the protein beyond the C-alpha, and
        ``interface``, residues with a heavy atom within 5 angstrom of one of another chain, water aside;
        ``interface A B`` are those of chains A and B that touch the other of the two.

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
    masks: dict[str, NDArray[np.bool_]] = {}

    def group(found: re.Match[str]) -> str:
        word, *pair = found[0].split()
        name = f"own{len(masks)}"
        masks[name] = _of_two(structure, *pair) if pair else _OWN[word](structure)
        return f"group {name}"

    between = _between(structure)
    asked = re.sub(rf"{_AROUND[0]}(?:{between}{'|'.join(_OWN)}){_AROUND[1]}", group, selection)
    groups = {name: universe.atoms[mask] for name, mask in masks.items()}
    try:
        # MDAnalysis warns of an empty text.
        chosen = universe.select_atoms(asked, **groups) if asked.strip() else universe.atoms[:0]
    except (SelectionError, ValueError, AttributeError) as error:
        reason = " ".join(str(error).split())
        raise StructureError(f"selection {selection!r} cannot be read: {reason}; {_EXAMPLES}") from None
    mask = np.zeros(structure.n_atoms, dtype=bool)
    mask[chosen.indices] = True
    if not mask.any():
        raise StructureError(f"{structure.name}: selection {selection!r} selects no atom; change it")
    return mask


_AROUND = r"(?<![\w:'-])", r"(?![\w:'-])"
"""What a word may not be part of."""
_EXAMPLES = "give it as 'resid 5:20', 'chainID A and sidechain', 'interface A B' or 'around 5 chainID B'"


def moving(structure: Structure, move: str) -> NDArray[np.bool_]:
    """Atoms (na,) that a selection lets move; ``all`` but obstacles.

    Raises
    ------
    StructureError
        As of :func:`select`; if it selects obstacles only.
    """
    free = ~structure.obstacle
    if move == defaults.MOVE:
        return free
    chosen = select(structure, move) & free
    if not chosen.any():
        raise StructureError(
            f"{structure.name}: move {move!r} selects only molecules that stand still; select of the protein"
        )
    return chosen


def _sidechain(structure: Structure) -> NDArray[np.bool_]:
    return ~structure.kept & ~np.isin(structure.atom_name, _BACKBONE)


def _between(structure: Structure) -> str:
    """What ``interface A B`` looks like, of the chains of a structure, before the words."""
    chains = sorted({re.escape(str(chain)) for chain in structure.residue_chain if chain}, key=len)[::-1]
    chain = rf"\s+(?:{'|'.join(chains)})(?![^\s)])"
    return rf"interface{chain}{chain}|" if chains else ""


def _of_two(structure: Structure, one: str, other: str) -> NDArray[np.bool_]:
    of_two = np.isin(structure.residue_chain, (one, other))[structure.atom_residue]
    return _interface(structure, of_two)


def _interface(structure: Structure, among: NDArray[np.bool_] | None = None) -> NDArray[np.bool_]:
    names, of = structure.residue_name, structure.atom_residue
    looked_at = np.ones(len(of), dtype=bool) if among is None else among
    (heavy,) = np.nonzero((structure.atom_element != "H") & (names[of] != "HOH") & looked_at)
    pairs = heavy[cKDTree(structure.positions[heavy]).query_pairs(_TOUCHING, output_type="ndarray")]
    chain = structure.residue_chain[of]
    residues = of[pairs[chain[pairs[:, 0]] != chain[pairs[:, 1]]]]
    return np.isin(of, residues)


_BACKBONE = ("N", "H", "H1", "H2", "H3", "CA", "HA", "HA2", "HA3", "C", "O", "OXT", "HXT")
_TOUCHING = 0.5
"""nm. Distance of heavy atoms of two chains from which on their residues touch, as CAPRI counts contacts."""
_OWN = {"sidechain": _sidechain, "interface": _interface}
"""Words that MDAnalysis does not have."""


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
