"""Atom selection in the language of MDAnalysis."""

import numpy as np

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
