"""Structures for the interactive viewer of a report: superposed, as text that 3Dmol.js reads."""

from functools import cache
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, PackageLoader, Template

from protochain.analysis.plots import COLOURS
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


def scene(comparison: "Comparison") -> dict[str, Any]:
    """Return what the template of the viewer needs."""
    return {"models": models(comparison), "library": library(), "colours": ("#999999", *COLOURS)}


def template(name: str) -> Template:
    """Return a page of the package, which escapes what it is given."""
    return Environment(loader=PackageLoader("protochain.analysis"), autoescape=True).get_template(name)


class View:
    """A frame in a notebook that holds the viewer and all it needs; text, where no HTML is shown."""

    def __init__(self, comparison: "Comparison") -> None:
        self.comparison = comparison

    def _repr_html_(self) -> str:
        page = template("viewer.html").render(**scene(self.comparison))
        frame = 'sandbox="allow-scripts" style="width: 100%; height: 34rem; border: 0"'
        return f'<iframe {frame} srcdoc="{escape(page)}"></iframe>'

    def __repr__(self) -> str:
        return f"<View of {', '.join(self.comparison.ends())}: shown in notebooks; report() writes a page>"


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
