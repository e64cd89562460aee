"""Page of a relaxation: measures and structures before and after, coloured by displacement."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from protochain.comparison.colourings import colourings
from protochain.comparison.differences import Differences, concatenate, of_ends, totals_of
from protochain.comparison.plots import plot_differences, plot_ramachandran_classes
from protochain.relaxation import Relaxation
from protochain.relaxation.record import before_and_after
from protochain.results.columns import energies_by_term
from protochain.results.figures import data_url
from protochain.results.page import write_page
from protochain.results.viewer import DISPLACEMENT, pockets, residue_keys, scene
from protochain.structure import Structure
from protochain.structure.molecule.repairs import loss_lines
from protochain.validation.bonding import hydrogen_bonds
from protochain.validation.clashes import clash_discs
from protochain.validation.findings import Findings


def write_relaxed(relaxation: Relaxation, record: Mapping[str, Any], path: Path) -> None:
    """Write the page of a relaxation, one file that works offline."""
    strength = relaxation.settings.strength
    changes = of_ends(relaxation.ends())
    figure = plot_differences(
        {name: difference.residues for name, difference in changes.items()}, relaxation.start.name
    )
    no_pairs = np.empty((0, 2), dtype=np.int64)
    bonds = hydrogen_bonds(relaxation.structure)[:, [0, 2]] if relaxation.start.ligands else no_pairs
    named = named_residues(relaxation, changes)
    write_page(
        path,
        "relaxed.html",
        named=named,
        record=record,
        rows=before_and_after(record),
        terms=energies_by_term({"end": record}),
        lost=loss_lines([record]),
        changes=totals_of(changes),
        bonds_changed=concatenate(changes, "bonds"),
        figure=data_url(figure),
        ramachandran=data_url(plot_ramachandran_classes(relaxation.ends())),
        name=strength.name,
        source=strength.source,
        pockets=pockets(relaxation.start, bonds, relaxation.start.positions, relaxation.x),
        **viewer_scene(relaxation, changes, _focus(relaxation.start, named)),
    )


_NAMED = 10  # Number of residues that are listed as those that moved or turned most.
_MOVED, _TURNED = 0.1, 10.0
"""Least displacement of a C-alpha, angstrom, and change of torsions (RMS), degrees, of listed residues."""


def named_residues(
    relaxation: Relaxation, changes: Mapping[str, Differences]
) -> dict[str, list[tuple[str, str]]]:
    """Most interesting residues by kind: their keys in the viewer, and text."""
    s = relaxation.start
    before, after = (_outliers(Findings(s, x)) for x in (s.positions, relaxation.x))
    new = {f"New {kind}": residues - before[kind] for kind, residues in after.items()}
    resolved = {f"Resolved {kind}": before[kind] - residues for kind, residues in after.items()}
    groups = {label: [(r, "") for r in sorted(residues)] for label, residues in (new | resolved).items()}
    keys = residue_keys(s).tolist()
    place = {key: r for r, key in enumerate(keys)}
    for difference in changes.values():
        table = difference.residues
        indices = [place.get(f"{chain.strip()}:{number}", -1)
                 for chain, number in zip(table["chain"], table["residue"], strict=True)]  # fmt: skip
        for label, column, least, unit in (
            ("Moved most", "ca_moved_angstrom", _MOVED, " angstrom"),
            ("Turned most", "torsions_degrees", _TURNED, " degrees"),
        ):
            largest = table.assign(where=indices)[table[column] >= least].nlargest(_NAMED, column)
            groups[label] = [
                (r, f", {value:.2g}{unit}" if value < 10 else f", {value:.0f}{unit}")
                for r, value in zip(largest["where"], largest[column], strict=True) if r >= 0
            ]  # fmt: skip
    return {
        label: [(keys[r], f"{s.residue(r)}{words}") for r, words in residues]
        for label, residues in groups.items() if residues
    }  # fmt: skip


def _outliers(findings: Findings) -> dict[str, set[int]]:
    residue_of, rama = findings.structure.atom_residue, findings.ramachandran
    return {
        "violations": set(findings.violations.residues.tolist()),
        "clashes": set(residue_of[findings.clashes.pairs].ravel().tolist()),
        "Ramachandran outliers": set(rama.residue[rama.region == 0].tolist()),
        "rotamer outliers": set(findings.side_chains.outliers.tolist()),
        "C-beta outliers": set(findings.cbeta.outliers.tolist()),
        "inverted stereocentres": set(residue_of[findings.inverted_stereocentres].tolist()),
    }


def _focus(structure: Structure, named: Mapping[str, list[tuple[str, str]]]) -> str:
    """Key of the residue that the viewer shows first: a ligand, else the first that is named."""
    if structure.ligands:
        ligand = max(structure.ligands, key=lambda ligand: ligand.posed)
        return str(residue_keys(structure)[structure.atom_residue[ligand.atoms[0]]])
    return next((residues[0][0] for residues in named.values()), "")


def viewer_scene(
    relaxation: Relaxation, changes: Mapping[str, Differences] = {}, focus: str = ""
) -> dict[str, Any]:
    """Variables of the viewer's template, initially coloured by displacement."""
    ends = relaxation.ends()
    coloured = colourings(ends, relaxation.energy_function, changes)
    return scene(ends, coloured, DISPLACEMENT, clash_discs, focus)
