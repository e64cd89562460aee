"""Colourings of the residues of a page: energies by residue and term, and B factors of the input."""

from collections.abc import Iterator, Mapping

import numpy as np

from protochain.comparison.differences import Differences
from protochain.core.arrays import Floats, means_by
from protochain.energies.decomposed import TERMS, decomposed, native_of
from protochain.energies.protocol import Energy
from protochain.results.columns import heading
from protochain.results.viewer import Colouring
from protochain.structure import Structure


def colourings(
    ends: Mapping[str, Structure], energy: Energy, changes: Mapping[str, Differences] | None = None
) -> list[Colouring]:
    """Colourings of a start and its ends, by name, with all energy terms that are not 0."""
    # Energies need the native engine: callables, and some Systems of OpenMM, have none.
    start = next(iter(ends.values()))
    native = native_of(energy)
    result = list[Colouring]()
    if native is not None:
        shares = {name: decomposed(model, native, model.positions).shares for name, model in ends.items()}
        result += of_energies(shares)
    if changes:
        turned = {name: _of_residues(start, change, "torsions_degrees") for name, change in changes.items()}
        result.append(Colouring("change of torsions, degrees", turned))
    if np.nan_to_num(start.b_factor).any():
        quantity = start.b_factor_quantity.replace("unknown", "B factor or confidence")
        heavy = start.atom_element != "H"
        # Residues without heavy atoms have NaN.
        means = means_by(start.atom_residue[heavy], start.b_factor[heavy], start.n_residues)
        result.append(Colouring(f"{quantity} of the input", dict.fromkeys(ends, means)))
    return result


def of_energies(shares: Mapping[str, Floats]) -> Iterator[Colouring]:
    """Colourings by the total, its change from the first, and terms of energies by residue, (terms, nr)."""
    totals = {name: values.sum(axis=0) for name, values in shares.items()}
    yield Colouring("energy, kJ/mol", totals, is_signed=True)
    (_, start), *other_totals = totals.items()
    if other_totals:
        changes = {name: total - start for name, total in other_totals}
        yield Colouring("change of energy, kJ/mol", changes, is_signed=True)
    for k, term in enumerate(TERMS):
        of_term = {name: values[k] for name, values in shares.items()}
        if any(values.any() for values in of_term.values()):
            yield Colouring(heading(f"{term}_kj_mol"), of_term, is_signed=True)


def _of_residues(structure: Structure, changes: Differences, column: str) -> Floats:
    """(nr,) float: column of the changes for all residues of the first structure, NaN if missing."""
    table = changes.residues
    values = dict(zip(zip(table["chain"], table["residue"], strict=True), table[column], strict=True))
    number = np.char.add(structure.residue_number, structure.residue_insertion_code)
    residues = zip(structure.residue_chain.tolist(), number.tolist(), strict=True)
    return np.array([values.get(name, np.nan) for name in residues], dtype=float)
