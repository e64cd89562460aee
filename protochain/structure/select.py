"""Atoms by the selection language of MDAnalysis."""

import numpy as np

from protochain.errors import StructureError
from protochain.structure.convert import to_mdanalysis
from protochain.structure.model import Structure


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
        raise StructureError(f"{structure.name}: selection {selection!r} names no atom")
    return mask
