"""Interactive viewer of reports and notebooks: superposed structures, drawn by 3Dmol.js."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from protochain.core.arrays import Floats, Integers
from protochain.core.palette import START, looks
from protochain.core.units import ANGSTROM_PER_NM
from protochain.results.page import render
from protochain.structure import Structure, as_structure
from protochain.structure.superpose import motion
from protochain.structure.write import as_text, common_suffix

_POCKET = 0.5  # nm. Distance from a ligand.
_ALL_ATOMS = 5000
"""Limit of atoms. Larger structures are shown without hydrogens, which would add megabytes to the page."""


@dataclass(frozen=True)
class Colouring:
    """A quantity that colours the residues of structures."""

    name: str  # Its name on the page, with its unit.
    values: Mapping[str, Floats]  # By names of structures, NaN if unknown. Other structures are unchanged.
    is_signed: bool = False  # Two colours about zero, else one colour from the lowest to the highest.


def scene(
    shown: Mapping[str, Structure],
    colourings: Iterable[Colouring] = (),
    chosen: str = "",
    discs: Callable[[Structure], tuple[Integers, Floats]] | None = None,
    focus: str = "",
) -> dict[str, Any]:
    """Variables of the viewer's template, with all structures superposed on the first.

    ``discs`` returns clashing pairs of atoms (n, 2) and their discs (n, 7), and ``focus`` is a residue's key.
    """
    (first_name, first), *other_structures = shown.items()
    ends = {name: superpose(model, first) for name, model in other_structures}
    shifts = {name: model.positions - first.positions for name, model in ends.items()}
    away = {name: ANGSTROM_PER_NM * np.linalg.norm(by, axis=1) for name, by in shifts.items()}
    suffix = common_suffix(shown.values())
    # Displacements of atoms are written to the column of B factors, which the viewer reads.
    texts = {first_name: first} | {name: replace(model, b_factor=away[name]) for name, model in ends.items()}
    models = [
        {
            "name": name,
            "format": suffix.removeprefix("."),
            "text": as_text(model, suffix, hydrogens=model.n_atoms <= _ALL_ATOMS),
        }
        for name, model in texts.items()
    ]
    scales = [_of_atoms(first, away)] if ends else []
    scales += [_of_residues(model, tuple(shown)) for model in colourings]
    return {
        "models": models,
        "library": library(),
        "colours": (START, *(look.colour for look in looks(ends).values())),
        "colourings": scales,
        "chosen": next((k for k, model in enumerate(scales) if model["name"] == chosen), -1),
        "residues": _residues(first, suffix),
        "discs": [_disc_rows(model, *discs(model)) for model in (first, *ends.values())] if discs else [],
        "focus": focus,
    }


_MOST_DISCS = 500


def _disc_rows(structure: Structure, pairs: Integers, discs: Floats) -> list[list[Any]]:
    """Rows for the viewer: seven numbers of a disc, and the keys of its two residues."""
    names = residue_keys(structure)[structure.atom_residue[pairs[:_MOST_DISCS]]].tolist()
    return [[*disc, *pair] for disc, pair in zip(np.round(discs, 2).tolist(), names, strict=False)]


def residue_keys(structure: Structure) -> NDArray[np.str_]:
    """(nr,) str: chain, number and insertion code of each residue, as viewers report them of an atom."""
    number = np.char.add(structure.residue_number, structure.residue_insertion_code)
    return np.char.add(np.char.add(np.char.strip(structure.residue_chain), ":"), number)


def _residues(structure: Structure, suffix: str) -> list[str]:
    """Names of residues for the viewer. It ignores insertion codes of mmCIF: ambiguous names are empty."""
    chain, number = structure.residue_chain, structure.residue_number
    if suffix == ".pdb":
        number = np.char.add(number, structure.residue_insertion_code)
    names = np.char.add(np.char.add(chain, ":"), number)
    _, place, counts = np.unique(names, return_inverse=True, return_counts=True)
    return np.where(counts[place] == 1, names, "").tolist()


DISPLACEMENT = "displacement, angstrom"
_FULL_RED = 2.0  # Angstrom of displacement at which the colour saturates, or less if few atoms moved as far.
_MOST = 0.98
"""Share of values within the colour scale, so that a few large values do not make all others grey."""


def _of_atoms(structure: Structure, by_end: Mapping[str, Floats]) -> dict[str, Any]:
    heavy = np.concatenate([distances[structure.atom_element != "H"] for distances in by_end.values()])
    high = float(np.clip(np.quantile(heavy, _MOST), 0.1, _FULL_RED))
    return {"name": DISPLACEMENT, "low": 0.0, "high": high, "is_signed": False, "values": None}


def _of_residues(colouring: Colouring, names: Sequence[str]) -> dict[str, Any]:
    """A colouring with its scale, in short numbers for JSON."""
    finite_values = np.concatenate([np.empty(0), *colouring.values.values()])
    finite_values = finite_values[np.isfinite(finite_values)]
    if colouring.is_signed:
        high = float(np.quantile(np.abs(finite_values), _MOST)) if len(finite_values) else 0.0
        low = -high
    else:
        low, high = np.quantile(finite_values, (0.0, _MOST)).tolist() if len(finite_values) else (0.0, 0.0)
    values = [
        None if name not in colouring.values
        else [float(f"{v:.4g}") if np.isfinite(v) else None for v in colouring.values[name].tolist()]
        for name in names
    ]  # fmt: skip
    return {
        "name": colouring.name, "low": low, "high": high, "is_signed": colouring.is_signed, "values": values,
    }  # fmt: skip


def pockets(structure: Structure, bonds: Integers, *ends: Floats) -> list[dict[str, Any]]:
    """Ligands, residues near them at any end (na, 3), nm, and hydrogen bonds (n, 2), donors and acceptors."""
    of = structure.atom_residue

    def atom(k: int) -> dict[str, Any]:
        return selections([int(of[k])])[0] | {"atom": str(structure.atom_name[k])}

    def selections(residues: Iterable[int]) -> list[dict[str, Any]]:
        return [
            {"chain": str(structure.residue_chain[r]) or " ", "resi": int(structure.residue_number[r])}
            for r in residues
        ]

    pocket_list = []
    for ligand in structure.ligands:
        residue = int(of[ligand.atoms[0]])
        near = {r for x in ends for r in of[cKDTree(x[ligand.atoms]).query(x)[0] < _POCKET].tolist()}
        across = [(i, j) for i, j in bonds.tolist() if (of[i] == residue) != (of[j] == residue)]
        pocket_list.append({
            "name": str(structure.residue(residue)), "ligand": selections([residue]),
            "near": selections(sorted(near - {residue})), "bonds": [[atom(i), atom(j)] for i, j in across],
        })  # fmt: skip
    return pocket_list


class View:
    """Interactive viewer in a notebook, and plain text elsewhere."""

    def __init__(self, shown: Mapping[str, Structure]) -> None:
        self.shown = shown

    def _repr_html_(self) -> str:
        page = render("viewer.html", alone=True, **scene(self.shown))
        frame = 'sandbox="allow-scripts" style="width: 100%; height: 34rem; border: 0"'
        return f'<iframe title="Structures" {frame} srcdoc="{escape(page)}"></iframe>'

    def __repr__(self) -> str:
        return f"<View of {', '.join(self.shown)}: shown in notebooks>"


def view(shown: Any) -> View:
    """Show a structure, or the start and end of a minimisation, in three dimensions in a notebook.

    Parameters
    ----------
    shown : Solution, Relaxation, Comparison, Chain, or anything that :func:`protochain.as_structure` accepts
        For a result, its start and its ends are shown.

    Returns
    -------
    View
        View in notebooks, without any server.

    Raises
    ------
    ProtochainError
        If it has another type.

    Examples
    --------
    >>> type(pc.view("structures/ala10.pdb")).__name__
    'View'
    """
    if hasattr(shown, "ends"):
        return View(shown.ends())
    structure = as_structure(shown)
    return View({structure.name: structure})


def superpose(structure: Structure, start: Structure) -> Structure:
    """Superpose a structure on another with the same atoms, by the C-alphas."""
    alpha = start.alpha_carbons
    turn, shift = motion(structure.positions[alpha], start.positions[alpha])
    return structure.with_positions(structure.positions @ turn.T + shift)


@cache
def library() -> str:
    """Source of 3Dmol.js (Rego, Koes, Bioinformatics 31:1322, 2015), with its BSD licence in its folder."""
    return (files("protochain.results") / "static" / "3Dmol-min.js").read_text(encoding="utf-8")
