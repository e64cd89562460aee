"""Page of scored interfaces: the table, and the two sides with residues coloured by their shares."""

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from protochain.chains.setup import Setup
from protochain.results.page import write_page
from protochain.results.provenance import command_line
from protochain.results.viewer import library
from protochain.structure.model import Structure
from protochain.structure.select import sides
from protochain.structure.write import as_text, common_suffix
from protochain.validation.interface import CONFIDENCES, SCORES, Interface

_MOST = 20
"""Interfaces whose structures are on the page: each is up to a megabyte."""
_FULL = 10.0
"""kJ/mol of a residue from which on the colour is the same."""


def write_scored(
    interfaces: Sequence[Interface], rows: Sequence[Mapping[str, Any]], path: Path, setup: Setup, rank: str
) -> None:
    """Write the page of scored interfaces, one file that works offline."""
    known = {**SCORES, **CONFIDENCES}
    write_page(
        path,
        "interfaces.html",
        rows=rows,
        rank=rank,
        known=known,
        shown=[key for key in known if any(row[key] is not None for row in rows)],
        models=[_model(each, row) for each, row in zip(interfaces[:_MOST], rows, strict=False)],
        full=_FULL,
        library=library(),
        command=command_line(),
        forcefield=setup.forcefield,
        solvent=setup.solvent,
        version=version("protochain"),
    )


def _model(interface: Interface, row: Mapping[str, Any]) -> dict[str, Any]:
    """What the viewer needs of an interface: its atoms, the residues of either side, shares of some."""
    structure = interface.structure
    suffix = common_suffix([structure])
    places = _places(structure)
    table = interface.residues
    return {
        "name": f"{Path(row['file']).name} {interface.name}",
        "format": suffix.removeprefix("."),
        "text": as_text(structure, suffix, hydrogens=False),
        "sides": [places[side].tolist() for side in sides(structure, interface.first, interface.second)],
        "shares": {
            f"{chain}:{residue}": round(float(share), 2)
            for chain, residue, share in zip(
                table["chain"], table["residue"], table["energy_kj_mol"], strict=True
            )
        },
    }


def _places(structure: Structure) -> np.ndarray:
    """(nr,) str: chain and number of each residue, as the viewer tells them of an atom."""
    number = np.char.add(structure.residue_number, structure.residue_insertion_code)
    return np.char.add(np.char.add(np.char.strip(structure.residue_chain), ":"), number)
