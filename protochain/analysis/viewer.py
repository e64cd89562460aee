"""Structures for the interactive viewer of a report: superposed, as text that 3Dmol.js reads."""

from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING

from protochain.structure import Structure
from protochain.structure.superpose import motion
from protochain.structure.write import as_text

if TYPE_CHECKING:
    from protochain.analysis.comparison import Comparison

_ALL_ATOMS = 5000
"""Of larger structures the page holds no hydrogens: it would grow by megabytes for what nobody can see."""


def models(comparison: "Comparison") -> list[dict[str, str]]:
    """Start and ends, superposed on the C-alphas of the start.

    Returns
    -------
    list of dict
        ``name``, ``format`` (pdb or cif) and ``text`` of each.
    """
    start, suffix = comparison.structure, comparison.suffix
    return [
        {"name": name, "format": suffix.removeprefix("."), "text": _text(superposed(end, start), suffix)}
        for name, end in comparison.ends().items()
    ]


def superposed(structure: Structure, start: Structure) -> Structure:
    """Move a structure rigidly onto another with the same atoms, C-alphas on C-alphas."""
    alpha = start.alpha_carbons
    turn, shift = motion(structure.positions[alpha], start.positions[alpha])
    return structure.with_positions(structure.positions @ turn.T + shift)


def _text(structure: Structure, suffix: str) -> str:
    return as_text(structure, suffix, hydrogens=structure.n_atoms <= _ALL_ATOMS)


@cache
def library() -> str:
    """Source of 3Dmol.js (Rego, Koes, Bioinformatics 31:1322, 2015), under its BSD licence, beside it."""
    return (files("protochain.analysis") / "static" / "3Dmol-min.js").read_text(encoding="utf-8")
