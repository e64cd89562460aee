"""Interactive viewer of reports and notebooks: superposed structures, drawn by 3Dmol.js."""

from collections.abc import Iterable, Mapping
from functools import cache
from html import escape
from importlib.resources import files
from typing import Any

from scipy.spatial import cKDTree

from protochain.core.arrays import Floats
from protochain.results.figures import COLOURS
from protochain.results.page import render
from protochain.structure import Structure, as_structure
from protochain.structure.superpose import motion
from protochain.structure.write import as_text, common_suffix

_POCKET = 0.5
"""nm from a ligand."""
_ALL_ATOMS = 5000
"""Larger structures are shown without hydrogens, which would add megabytes to the page."""


def scene(shown: Mapping[str, Structure]) -> dict[str, Any]:
    """Variables of the viewer's template, with all structures superposed on the first."""
    first = next(iter(shown.values()))
    suffix = common_suffix(shown.values())
    models = [
        {"name": name, "format": suffix.removeprefix("."), "text": _text(superposed(each, first), suffix)}
        for name, each in shown.items()
    ]
    return {"models": models, "library": library(), "colours": ("#999999", *COLOURS)}


def pockets(structure: Structure, *ends: Floats) -> list[dict[str, Any]]:
    """What the viewer of pockets needs: each ligand and the residues that are near it at any end.

    Parameters
    ----------
    structure : Structure
    *ends : (na, 3) float, nm
    """

    def selected(residues: Iterable[int]) -> list[dict[str, Any]]:
        return [
            {"chain": str(structure.residue_chain[r]) or " ", "resi": int(structure.residue_number[r])}
            for r in residues
        ]

    found = []
    for each in structure.ligands:
        own = int(structure.atom_residue[each.atoms[0]])
        near = {
            r
            for x in ends
            for r in structure.atom_residue[cKDTree(x[each.atoms]).query(x)[0] < _POCKET].tolist()
        }
        name = str(structure.residue(own))
        found.append({"name": name, "ligand": selected([own]), "near": selected(sorted(near - {own}))})
    return found


class View:
    """Interactive viewer in a notebook; plain text elsewhere."""

    def __init__(self, shown: Mapping[str, Structure]) -> None:
        self.shown = shown

    def _repr_html_(self) -> str:
        page = render("viewer.html", **scene(self.shown))
        frame = 'sandbox="allow-scripts" style="width: 100%; height: 34rem; border: 0"'
        return f'<iframe {frame} srcdoc="{escape(page)}"></iframe>'

    def __repr__(self) -> str:
        return f"<View of {', '.join(self.shown)}: shown in notebooks>"


def view(shown: Any) -> View:
    """Show a structure, or the start and end of a minimisation, in three dimensions in a notebook.

    Parameters
    ----------
    shown : Solution, Relaxation, Comparison, Chain, or anything that :func:`protochain.as_structure` takes
        A result shows its start and its ends.

    Returns
    -------
    View
        Shown in notebooks; no server is contacted.

    Raises
    ------
    ProtochainError
        If it is none of these.
    """
    if hasattr(shown, "ends"):
        return View(shown.ends())
    structure = as_structure(shown)
    return View({structure.name: structure})


def superposed(structure: Structure, start: Structure) -> Structure:
    """Superpose a structure on another with the same atoms, by the C-alphas."""
    alpha = start.alpha_carbons
    turn, shift = motion(structure.positions[alpha], start.positions[alpha])
    return structure.with_positions(structure.positions @ turn.T + shift)


def _text(structure: Structure, suffix: str) -> str:
    return as_text(structure, suffix, hydrogens=structure.n_atoms <= _ALL_ATOMS)


@cache
def library() -> str:
    """Source of 3Dmol.js (Rego, Koes, Bioinformatics 31:1322, 2015); its BSD licence is beside it."""
    return (files("protochain.results") / "static" / "3Dmol-min.js").read_text(encoding="utf-8")
