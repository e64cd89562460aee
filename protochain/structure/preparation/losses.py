"""What is reported at the end of a run of atoms that files lost, though nobody asked to leave them out."""

from collections.abc import Iterable, Mapping
from textwrap import shorten
from typing import Any

from protochain.core import defaults
from protochain.structure.molecule.repairs import KEEP_ALL, Loss, Reason, Render

_WIDTH = 200
"""Characters of the report of one structure."""
_SHOWN = 8
"""Structures that are named."""


def lost_atoms(losses: Iterable[Loss]) -> list[str]:
    """Residues that lack atoms, and which, as in a record."""
    return [str(loss) for loss in losses if loss.why is not Reason.FAR]


def n_lost(losses: Iterable[Loss]) -> int:
    """Number of their atoms."""
    return sum(len(loss.atoms) for loss in losses if loss.why is not Reason.FAR)


def far_molecules(losses: Iterable[Loss]) -> list[str]:
    """Molecules that are left out because they are far from the protein, as in a record."""
    return [str(loss) for loss in losses if loss.why is Reason.FAR]


def loss_lines(rows: Iterable[Mapping[Any, Any]], say: Render = str) -> list[str]:
    """Tell at the end of a run what its structures lost."""
    of = {str(row.get("structure")): row for row in rows}
    lines = []
    for key, what in _COLUMNS.items():
        remedy = f"; {say(KEEP_ALL)} keeps them" if key == "far_molecules" else ""
        cells = {name: row.get(key) for name, row in of.items()}
        texts = {name: "; ".join(cell) if isinstance(cell, list) else cell for name, cell in cells.items()}
        told = {name: text for name, text in texts.items() if isinstance(text, str) and text}
        lost = {name: shorten(text, _WIDTH, placeholder=" ...") for name, text in told.items()}
        if len(of) == 1 and lost:
            lines.append(f"{what}: {''.join(lost.values())}{remedy}")
        elif lost:
            stated = ", ".join(f"{name} ({text})" for name, text in [*lost.items()][:_SHOWN])
            more = f" and {len(lost) - _SHOWN} more" if len(lost) > _SHOWN else ""
            lines.append(f"{len(lost)} of {len(of)} structures {what}: {stated}{more}{remedy}")
    return lines


_COLUMNS = {
    "lost_atoms": "lost atoms",
    "far_molecules": f"left out molecules further than {defaults.KEEP_WITHIN:g} angstrom from the protein",
}
"""Columns, and what they tell."""
