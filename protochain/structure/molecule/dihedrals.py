"""Dihedrals of residues by name (phi, psi, omega, chi1 ...), their atoms and values."""

from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Any

import numpy as np

from protochain.core.arrays import dihedral
from protochain.structure.molecule import residues

if TYPE_CHECKING:
    import pandas as pd

NamedDihedral = tuple[str, str, list[int | None]]
"""Kind of a hinge, name of the dihedral, and its four atoms, or None for a missing atom."""
_SHOWN = ("phi", "psi", "omega", *(f"chi{k}" for k in range(1, 6)))


def dihedral_finder(
    structure: Any, kinds: Collection[str]
) -> tuple[list[dict[str, int]], Callable[[int], list[NamedDihedral]]]:
    """Return the atoms of each residue by name, and a function that finds its dihedrals of these kinds."""
    index = [dict[str, int]() for _ in range(structure.n_residues)]
    places = zip(structure.atom_name.tolist(), structure.atom_residue.tolist(), strict=True)
    for atom, (name, residue) in enumerate(places):
        index[residue][name] = atom
    chain, names = structure.residue_chain_index.tolist(), structure.residue_name.tolist()

    def atom_at(residue: int, name: str) -> int | None:
        neighbour = residue + {"+": 1, "-": -1}.get(name[-1], 0)
        if not 0 <= neighbour < structure.n_residues or chain[neighbour] != chain[residue]:
            return None
        return index[neighbour].get(name.rstrip("+-"))

    def dihedrals_of(r: int) -> list[NamedDihedral]:
        psi = residues.PSI_TERMINAL if atom_at(r, "N+") is None else residues.PSI
        table: list[tuple[str, str, tuple[str, ...]]] = [("phi", "phi", residues.PHI), ("psi", "psi", psi)]
        table.append(("omega", "omega", residues.OMEGA))
        table += [("chi", f"chi{i}", four) for i, four in enumerate(residues.CHI.get(names[r], ()), 1)]
        rotors = (*residues.ROTORS.get(names[r], ()), residues.ROTOR_N_TERMINAL)
        table += [("rotors", "rotor", four) for four in rotors]
        table += [("nucleic", *torsion) for torsion in residues.NUCLEIC.get(names[r], {}).items()]
        return [(kind, label, [atom_at(r, n) for n in four]) for kind, label, four in table if kind in kinds]

    return index, dihedrals_of


def dihedrals(structure: Any) -> "pd.DataFrame":
    """Dihedrals in degrees, one row per protein residue, as in :meth:`Structure.dihedrals`."""
    import pandas as pd

    _, dihedrals_of = dihedral_finder(structure, ("phi", "psi", "omega", "chi"))
    protein = np.unique(structure.atom_residue[~structure.kept]).tolist()
    rows = [(r, label, atoms) for r in protein for _, label, atoms in dihedrals_of(r) if None not in atoms]
    atoms = np.array([atoms for *_, atoms in rows], dtype=np.int64).reshape(-1, 4)
    values = np.degrees(dihedral(*structure.positions[atoms].swapaxes(0, 1)))
    number = np.char.add(structure.residue_number, structure.residue_insertion_code)
    table = pd.DataFrame(
        {"chain": structure.residue_chain, "residue": number, "name": structure.residue_name_in_file}
    ).loc[protein]
    table = table.assign(**dict.fromkeys(_SHOWN, np.nan))
    for (r, label, _), value in zip(rows, values.tolist(), strict=True):
        table.loc[r, label] = value
    return table.reset_index(drop=True)
