"""What colours the residues of a page: the energy by residue and term, and the B factors of the input."""

from collections.abc import Iterator, Mapping

import numpy as np

from protochain.comparison.differences import Differences
from protochain.core.arrays import Floats, means_by
from protochain.energies.decomposed import TERMS, decomposed, native_of
from protochain.energies.protocol import Energy
from protochain.results.columns import heading
from protochain.results.viewer import Colouring
from protochain.structure import Structure

OF_INPUT = "B factor or confidence of the input"
"""What the file has in its column of B factors; predictors put their confidence there."""


def colourings(
    ends: Mapping[str, Structure], energy: Energy, changes: Mapping[str, Differences] | None = None
) -> list[Colouring]:
    """Colourings of a start and what came of it, by name, with all terms of their energy that are not 0."""
    # Of a callable, and of a System that the native engine cannot compute, there are none of the energy.
    start = next(iter(ends.values()))
    native = native_of(energy)
    result = list[Colouring]()
    if native is not None:
        shares = {name: decomposed(each, native, each.positions).shares for name, each in ends.items()}
        result += of_energies(shares)
    if changes:
        turned = {name: _of_residues(start, each, "torsions_degrees") for name, each in changes.items()}
        result.append(Colouring("change of torsions, degrees", turned))
    if np.nan_to_num(start.b_factor).any():
        result.append(Colouring(OF_INPUT, dict.fromkeys(ends, _mean_b_factor(start))))
    return result


def of_energies(shares: Mapping[str, Floats]) -> Iterator[Colouring]:
    """Total and terms of energies by residue, (terms, nr) each, and how the total changed from the first."""
    totals = {name: each.sum(axis=0) for name, each in shares.items()}
    yield Colouring("energy, kJ/mol", totals, is_signed=True)
    (_, start), *others = totals.items()
    if others:
        yield Colouring(
            "change of energy, kJ/mol", {name: total - start for name, total in others}, is_signed=True
        )
    for k, term in enumerate(TERMS):
        of_term = {name: each[k] for name, each in shares.items()}
        if any(each.any() for each in of_term.values()):
            yield Colouring(heading(f"{term}_kj_mol"), of_term, is_signed=True)


def _of_residues(structure: Structure, changes: Differences, column: str) -> Floats:
    """(nr,) float: column of what changed, for all residues of its first structure; NaN of others."""
    of = changes.residues
    noted = dict(zip(zip(of["chain"], of["residue"], strict=True), of[column], strict=True))
    number = np.char.add(structure.residue_number, structure.residue_insertion_code)
    residues = zip(structure.residue_chain.tolist(), number.tolist(), strict=True)
    return np.array([noted.get(name, np.nan) for name in residues], dtype=float)


def _mean_b_factor(structure: Structure) -> Floats:
    """Mean of the heavy atoms of each residue; NaN of one without any."""
    heavy = structure.atom_element != "H"
    return means_by(structure.atom_residue[heavy], structure.b_factor[heavy], structure.n_residues)
