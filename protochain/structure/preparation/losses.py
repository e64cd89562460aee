"""Report of removed atoms at the end of a run, without the omissions that the user requested."""

from collections.abc import Iterable, Mapping
from textwrap import shorten
from typing import Any

from protochain.core import defaults
from protochain.structure.molecule.repairs import KEEP_ALL, Loss, Reason, Render

_WIDTH = 200
"""Characters of the report of one structure."""
_SHOWN = 8
"""Number of structures that are named."""


def lost_atoms(losses: Iterable[Loss]) -> list[str]:
    """Return the residues that lost atoms with these atoms, as in a record."""
    return [str(loss) for loss in losses if loss.why is not Reason.FAR]


def n_lost(losses: Iterable[Loss]) -> int:
    """Return the number of lost atoms."""
    return sum(len(loss.atoms) for loss in losses if loss.why is not Reason.FAR)


def far_molecules(losses: Iterable[Loss]) -> list[str]:
    """Return the molecules removed because they are far from the protein, as in a record."""
    return [str(loss) for loss in losses if loss.why is Reason.FAR]


def loss_lines(rows: Iterable[Mapping[Any, Any]], render: Render = str) -> list[str]:
    """Report the losses of the structures of a run."""
    row_of = {str(row.get("structure")): row for row in rows}
    lines = []
    for key, heading in _COLUMNS.items():
        remedy = f"; {render(KEEP_ALL)} keeps them" if key == "far_molecules" else ""
        cells = {name: row.get(key) for name, row in row_of.items()}
        texts = {name: "; ".join(cell) if isinstance(cell, list) else cell for name, cell in cells.items()}
        filled = {name: text for name, text in texts.items() if isinstance(text, str) and text}
        lost = {name: shorten(text, _WIDTH, placeholder=" ...") for name, text in filled.items()}
        if len(row_of) == 1 and lost:
            lines.append(f"{heading}: {''.join(lost.values())}{remedy}")
        elif lost:
            stated = ", ".join(f"{name} ({text})" for name, text in [*lost.items()][:_SHOWN])
            suffix = f" and {len(lost) - _SHOWN} more" if len(lost) > _SHOWN else ""
            lines.append(f"{len(lost)} of {len(row_of)} structures {heading}: {stated}{suffix}{remedy}")
    return lines


_COLUMNS = {
    "lost_atoms": "lost atoms",
    "far_molecules": f"left out molecules further than {defaults.KEEP_WITHIN:g} angstrom from the protein",
}
"""Columns and their texts."""
