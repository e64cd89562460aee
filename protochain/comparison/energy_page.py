"""Page of the energy of one structure by term and by residue, with residues coloured by energy."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from protochain.comparison.colourings import of_energies
from protochain.energies.decomposed import TERMS, energy_terms
from protochain.energies.protocol import Energy
from protochain.results.columns import heading
from protochain.results.page import table_data, write_page
from protochain.results.viewer import scene
from protochain.structure import Structure


def write_energies(
    structure: Structure, energy: Energy, path: Path, between: Sequence[str] | str | None = None
) -> None:
    """Write the page of an energy, one file that works offline."""
    terms = energy_terms(structure, "term", between=between, energy=energy).T
    residues = energy_terms(structure, "residue", between=between, energy=energy)
    ranked = residues.loc[residues["total"].abs().sort_values(ascending=False).index]
    columns = [name for name in residues if name not in (*TERMS, "total")]
    (first, *_) = colourings = list(of_energies({structure.name: residues[list(TERMS)].to_numpy().T}))
    write_page(
        path,
        "energies.html",
        structure=structure,
        between=between,
        energy=energy,
        terms=_with_units(terms[terms.any(axis=1)]).rename_axis("term").rename(heading).reset_index(),
        data=table_data(_with_units(ranked[[*columns, "total", *TERMS]])),
        **scene({structure.name: structure}, colourings, first.name),
    )


def _with_units(table: pd.DataFrame) -> pd.DataFrame:
    """Table with the unit in the names of energies, without columns that are all 0."""
    energies = table.select_dtypes("number")
    nonzero = table[[name for name in table if name not in energies or energies[name].any()]]
    return nonzero.rename(columns={name: f"{name}_kj_mol" for name in energies})
