"""Atom selection in the language of MDAnalysis, and places named as chain:number:atom."""

import re
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from protochain.core import defaults
from protochain.core.arrays import Integers
from protochain.core.errors import Argument, StructureError
from protochain.core.markup import abridge
from protochain.structure.convert import as_structure, to_mdanalysis
from protochain.structure.molecule.model import Structure

_RANGES = re.compile(r"index( \d+:\d+)+")
_EXAMPLES = "give it as 'resid 5:20', 'chainID A and sidechain', 'interface' or 'around 5 chainID B'"
_BACKBONE = ("N", "H", "H1", "H2", "H3", "CA", "HA", "HA2", "HA3", "C", "O", "OXT", "HXT")
_CONTACT = 0.5  # nm. Largest distance of heavy atoms of residues in contact, as in CAPRI.


def select(structure: Structure, selection: str) -> np.ndarray:
    """Return the mask (na,) bool of the selected atoms."""
    mask = np.zeros(structure.n_atoms, dtype=bool)
    if _RANGES.fullmatch(selection):  # From mutations. Spares half a second to import MDAnalysis.
        for first, last in re.findall(r"(\d+):(\d+)", selection):
            mask[int(first) : int(last) + 1] = True
        if mask.any():
            return mask
    from MDAnalysis.exceptions import SelectionError

    universe = to_mdanalysis(structure)
    groups = dict[str, Any]()

    def as_group(word: re.Match[str]) -> str:
        name = f"own{len(groups)}"
        groups[name] = universe.atoms[_WORDS[word[1]](structure, word[2] or "")]
        return f"group {name}"

    query = _word_pattern(structure).sub(as_group, selection)
    try:
        # MDAnalysis warns of an empty text.
        chosen = universe.select_atoms(query, **groups) if query.strip() else universe.atoms[:0]
    except (SelectionError, ValueError, AttributeError) as error:
        reason = " ".join(str(error).split())
        raise StructureError(f"selection {selection!r} cannot be read: {reason}; {_EXAMPLES}") from None
    mask[chosen.indices] = True
    if not mask.any():
        raise StructureError(f"{structure.name}: selection {selection!r} selects no atom; change it")
    return mask


def move_argument(source: Any) -> dict[str, str]:
    """Return the argument ``move`` of a chain or a result as keywords."""
    move = getattr(getattr(source, "chain", source), "move", None)
    return {"move": move} if isinstance(move, str) else {}


def moving_mask(structure: Structure, move: str) -> NDArray[np.bool_]:
    """Return the mask (na,) of the moving atoms of a selection. Obstacles never move."""
    free = ~structure.obstacle
    if move == defaults.MOVE:
        return free
    chosen = select(structure, move) & free
    if not chosen.any():
        raise StructureError(
            f"{structure.name}: move {move!r} selects only molecules that stand still; select of the protein"
        )
    return chosen


def sides(structure: Structure, first: str, second: str) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Residues of the two sides of an interface, (nr,) bool each, waters on neither."""
    parts = [_side(structure, text) for text in (first, second)]
    for i, j in ((0, 1), (1, 0)):
        if parts[j].selected and not parts[i].selected:
            parts[i] = _Side(parts[i].residues & ~parts[j].residues, selected=False)
    one, two = (side.residues for side in parts)
    interface = f"{structure.name}: interface {first}:{second}"
    if (one & two).any():
        residue = structure.describe_residue(int(np.argmax(one & two)))
        raise StructureError(f"{interface}: {residue} is on both sides; give other chains")
    for text, residues in zip((first, second), (one, two), strict=True):
        if not residues.any():
            raise StructureError(f"{interface}: nothing is left of side {text!r}; give other chains")
    return one, two


def split_sides(structure: Structure, interface: str) -> tuple[str, str]:
    """Split ``A:B``, ``A,B:C`` or ``A:resid 5:20`` at the colon that leaves two sides."""
    parts = interface.split(":")
    splits = [(":".join(parts[:k]).strip(), ":".join(parts[k:]).strip()) for k in range(1, len(parts))]
    refused = StructureError(
        f"{structure.name}: interface {interface!r}: give its two sides, as A:B or A,B:C"
    )
    for first, second in splits:
        try:
            sides(structure, first, second)
        except StructureError as error:
            refused = refused if len(splits) > 1 else error
        else:
            return first, second
    raise refused


def touching_chains(structure: Any) -> list[tuple[str, str]]:
    """List the pairs of chains with heavy atoms within 5 angstrom, without waters.

    Parameters
    ----------
    structure : Structure, or anything that :func:`protochain.as_structure` accepts
        Complex to examine.

    Returns
    -------
    list of (str, str)
        Names of chains, in the order of the file.

    Raises
    ------
    StructureError
        If the structure cannot be used.

    Examples
    --------
    >>> pc.touching_chains(pc.load("structures/3i40.pdb"))
    [('A', 'B')]
    """
    structure = as_structure(structure)
    chain = structure.residue_chain[_touching(structure)]
    order = {name: k for k, name in enumerate(dict.fromkeys(structure.residue_chain.tolist()))}
    pairs = {tuple(sorted(pair, key=order.__getitem__)) for pair in chain.tolist() if pair[0] != pair[1]}
    return sorted(((a, b) for a, b in pairs), key=lambda pair: [order[name] for name in pair])


def contacts(structure: Structure, first: NDArray[np.bool_], second: NDArray[np.bool_]) -> Integers:
    """Residues (n, 2) of two sides, (nr,) bool each, with heavy atoms within 5 angstrom."""
    pairs = _touching(structure)
    pairs = np.concatenate([pairs, pairs[:, ::-1]])
    return pairs[first[pairs[:, 0]] & second[pairs[:, 1]]]


def _touching(structure: Structure) -> Integers:
    """(n, 2) int: residues with heavy atoms within 5 angstrom, without waters, the smaller index first."""
    residue = structure.atom_residue
    (heavy,) = np.nonzero((structure.atom_element != "H") & ~is_water(structure)[residue])
    pairs = heavy[cKDTree(structure.positions[heavy]).query_pairs(_CONTACT, output_type="ndarray")]
    return np.unique(np.sort(residue[pairs], axis=1), axis=0).reshape(-1, 2)


def is_water(structure: Structure) -> NDArray[np.bool_]:
    """(nr,) bool: waters."""
    return np.asarray(structure.residue_name == "HOH")


class _Side(NamedTuple):
    residues: NDArray[np.bool_]
    selected: bool


def _side(structure: Structure, text: str) -> _Side:
    names, chains = [name.strip() for name in text.split(",")], structure.residue_chain
    if {*names} <= {*chains.tolist()}:
        return _Side(np.isin(chains, names) & ~is_water(structure), selected=False)
    mask = np.zeros(structure.n_residues, dtype=bool)
    try:
        mask[structure.atom_residue[select(structure, text)]] = True
    except StructureError:
        raise StructureError(
            f"{structure.name}: side {text!r} of an interface is no chain, nor a selection with atoms; "
            f"its chains are {abridge([name or '(blank)' for name in dict.fromkeys(chains.tolist())])}"
        ) from None
    return _Side(mask & ~is_water(structure), selected=True)


def _ligand(structure: Structure, _: str) -> NDArray[np.bool_]:
    if not structure.ligands:
        raise StructureError(
            f"{structure.name}: has no ligand of known chemistry that could move; add one with ",
            Argument("ligands"),
        )
    posed = [ligand for ligand in structure.ligands if ligand.posed]
    mask = np.zeros(structure.n_atoms, dtype=bool)
    for ligand in posed or structure.ligands:
        mask[ligand.atoms] = True
    return mask


def _interface(structure: Structure, between: str) -> NDArray[np.bool_]:
    if between:
        residues = contacts(structure, *sides(structure, *re.split(r":|\s+", between)))
    else:
        residues = _touching(structure)
        chain = structure.residue_chain[residues]
        residues = residues[chain[:, 0] != chain[:, 1]]
    return np.isin(structure.atom_residue, residues)


_WORDS: dict[str, Callable[[Structure, str], NDArray[np.bool_]]] = {
    "sidechain": lambda s, _: ~s.kept & ~np.isin(s.atom_name, _BACKBONE),
    "ligand": _ligand, "interface": _interface,
}  # fmt: skip
"""Selection words that MDAnalysis lacks."""


def _word_pattern(structure: Structure) -> re.Pattern[str]:
    """Pattern of these words, with the sides of an interface if present, but not inside other words."""
    chain = "|".join(re.escape(name) for name in {*structure.residue_chain.tolist()} if name) or "(?!)"
    side = rf"(?!(?:and|or)\b)(?:{chain}|[\w,]+)"
    of = rf"(?<=e)\s+([\w,]+:[\w,]+|{side}\s+{side})"
    return re.compile(rf"(?<![\w:'-])(sidechain|ligand|interface)(?:{of})?(?![\w:'-])")


def atoms_at(structure: Structure, place: str) -> Integers:
    """Return the atoms (n,) int of a place, at least one."""
    match = re.fullmatch(r"(\S*):(-?\d+\w?)(?::(\S+))?", place)
    if not match:
        return np.flatnonzero(select(structure, place))
    chain, number, atom = match.groups()
    numbers = np.char.add(structure.residue_number, structure.residue_insertion_code)
    of_chain = structure.residue_chain == chain
    residues = np.flatnonzero(of_chain & (numbers == number))
    if len(residues) > 1:
        # Waters and ligands may have numbers of protein residues.
        hetero = np.unique(structure.atom_residue[structure.kept])
        residues = np.setdiff1d(residues, hetero) if len(np.setdiff1d(residues, hetero)) else residues
    if len(residues) != 1:
        chains = dict.fromkeys(name or "(blank)" for name in structure.residue_chain.tolist())
        hint = f"its chains are {', '.join(chains)}"
        if of_chain.any():
            hint = f"chain {chain} has {numbers[of_chain][0]} to {numbers[of_chain][-1]}"
        how_many = len(residues) or "no"
        raise StructureError(
            f"{structure.name}: {place}: there are {how_many} residues {chain}:{number}; {hint}"
        )
    (atoms,) = np.nonzero(structure.atom_residue == residues[0])
    if atom is None:
        return atoms
    selected = atoms[structure.atom_name[atoms] == atom]
    if not len(selected):
        raise StructureError(
            f"{structure.name}: {place}: no atom {atom} in {structure.describe_residue(int(residues[0]))}; "
            f"its atoms are {' '.join(structure.atom_name[atoms])}"
        )
    return selected
