"""Page of scored interfaces: the table, and the two sides with residues coloured by energy."""

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd

from protochain.chains.setup import Setup
from protochain.comparison.docking import DOCKING
from protochain.results.page import table_data, write_page
from protochain.results.viewer import library, residue_keys
from protochain.structure.select import sides
from protochain.structure.write import as_text, common_suffix
from protochain.validation.interface import CONFIDENCES, MAKEUP, SCORES, Interface

_MOST = 20  # Limit of interfaces with structures on the page, each up to a megabyte.
_FULL = 10.0  # kJ/mol of a residue at which the colour saturates.


def write_scored(
    interfaces: Sequence[Interface], rows: Sequence[Mapping[str, Any]], path: Path, setup: Setup, rank: str
) -> None:
    """Write the page of scored interfaces, one file that works offline."""
    measures = {**SCORES, **MAKEUP, **CONFIDENCES, **DOCKING}
    write_page(
        path,
        "interfaces.html",
        rows=rows,
        data=_ranking(rows, [key for key in measures if any(row.get(key) is not None for row in rows)]),
        rank=rank,
        known=measures,
        models=[_model(interface, row) for interface, row in zip(interfaces[:_MOST], rows, strict=False)],
        full=_FULL,
        library=library(),
        forcefield=setup.forcefield,
        solvent=setup.solvent_label,
        version=version("protochain"),
    )


_FIRST = (
    "rank", "file", "interface", "energy_kj_mol", "buried_area_angstrom2", "shape_complementarity",
    "hydrogen_bonds", "salt_bridges", "unsatisfied_polar_atoms", "clashes", "ipsae", "pdockq2", "dockq",
)  # fmt: skip
"""Columns that are shown initially."""


def _ranking(rows: Sequence[Mapping[str, Any]], scores: Sequence[str]) -> dict[str, Any]:
    keys = ["interface", *scores]
    cells = [
        {"rank": place, "file": Path(row["file"]).name, **{key: row[key] for key in keys}}
        for place, row in enumerate(rows, 1)
    ]
    return table_data(pd.DataFrame(cells, columns=["rank", "file", *keys]).infer_objects(), _FIRST)


def _model(interface: Interface, row: Mapping[str, Any]) -> dict[str, Any]:
    """Data of an interface for the viewer: atoms, residues of each side, and energies of residues."""
    structure, table = interface.structure, interface.residues
    suffix, places = common_suffix([structure]), residue_keys(structure)
    shares = zip(table["chain"], table["residue"], table["energy_kj_mol"], strict=True)
    return {
        "name": f"{Path(row['file']).name} {interface.name}",
        "format": suffix.removeprefix("."),
        "text": as_text(structure, suffix, hydrogens=False),
        "sides": [places[side].tolist() for side in sides(structure, interface.first, interface.second)],
        "shares": {f"{chain}:{residue}": round(float(share), 2) for chain, residue, share in shares},
    }
