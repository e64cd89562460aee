"""Atoms by the selection language of MDAnalysis."""

import numpy as np

from protochain.errors import StructureError
from protochain.structure.model import Structure
from protochain.units import ANGSTROM_PER_NM


def select(structure: Structure, selection: str) -> np.ndarray:
    """Atoms that a selection names.

    Parameters
    ----------
    structure : Structure
    selection : str
        As ``resid 5:20 and not backbone``, ``chainID A``, ``around 5 resid 12``: see MDAnalysis. Distances in
        angstrom.

    Returns
    -------
    (na,) bool

    Raises
    ------
    StructureError
        If it cannot be read, or names no atom.
    """
    import MDAnalysis
    from MDAnalysis.exceptions import SelectionError

    atom_chain = structure.residue_chain[structure.atom_residue]
    chains, chain_of = np.unique(structure.residue_chain, return_inverse=True)
    universe = MDAnalysis.Universe.empty(
        structure.n_atoms, structure.n_residues, len(chains),
        atom_resindex=structure.atom_residue, residue_segindex=chain_of, trajectory=True,
    )  # fmt: skip
    for name, values in (
        ("names", structure.atom_name), ("elements", structure.atom_element), ("masses", structure.atom_mass),
        ("chainIDs", atom_chain), ("resnames", structure.residue_name),
        ("resids", [int(number) for number in structure.residue_number]),
        ("icodes", structure.residue_insertion_code), ("segids", chains),
    ):  # fmt: skip
        universe.add_TopologyAttr(name, values)
    universe.add_TopologyAttr("bonds", structure.bonds.tolist())
    universe.atoms.positions = ANGSTROM_PER_NM * structure.positions
    try:
        chosen = universe.select_atoms(selection)
    except (SelectionError, ValueError, AttributeError) as error:
        reason = " ".join(str(error).split())
        raise StructureError(f"selection {selection!r} cannot be read: {reason}") from None
    mask = np.zeros(structure.n_atoms, dtype=bool)
    mask[chosen.indices] = True
    if not mask.any():
        raise StructureError(f"{structure.name}: selection {selection!r} names no atom")
    return mask
