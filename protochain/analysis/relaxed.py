"""Page of a relaxation: before and after, both structures, the end coloured by how far each atom moved."""

import shlex
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from protochain.analysis.plots import plot_displacement
from protochain.core.units import ANGSTROM_PER_NM
from protochain.relaxation import Relaxation
from protochain.relaxation.record import before_and_after
from protochain.results.figures import data_url
from protochain.results.page import write_page
from protochain.results.tables import energies_by_term
from protochain.results.viewer import pockets, scene, superposed
from protochain.structure.losses import told

_FULL_RED = 2.0
"""Angstrom of displacement from which on the colour is the same; less where little moved as far."""
_MOST = 0.98
"""Share of the heavy atoms whose displacements the colours tell apart."""


def write_relaxed(relaxation: Relaxation, record: Mapping[str, Any], path: Path) -> None:
    """Write the page of a relaxation, one file that works offline.

    Parameters
    ----------
    relaxation : Relaxation
    record : mapping
        Its record, with what the caller adds.
    path : Path
        HTML file.
    """
    strength = relaxation.settings.strength
    moved = relaxation.displacements.rename(columns={"displacement_angstrom": "relaxed"})
    write_page(
        path,
        "relaxed.html",
        record=record,
        rows=before_and_after(record),
        terms=energies_by_term({"end": record}),
        lost=told([record]),
        figure=data_url(plot_displacement(moved, relaxation.start.name)),
        command=shlex.join(sys.argv),
        name=strength.name,
        source=strength.source,
        pockets=pockets(relaxation.start, relaxation.start.positions, relaxation.x),
        **coloured(relaxation),
    )


def coloured(relaxation: Relaxation) -> dict[str, Any]:
    """Variables of the viewer's template; displacements are in the column of the end's B factors."""
    start = relaxation.start
    end = superposed(relaxation.structure, start)
    away = ANGSTROM_PER_NM * np.linalg.norm(end.positions - start.positions, axis=1)
    shown = scene({"input": start, "relaxed": replace(end, b_factor=away)})
    heavy = away[start.atom_element != "H"]
    # A side chain that turned must not leave all others grey.
    shown["models"][1]["farthest_angstrom"] = float(np.clip(np.quantile(heavy, _MOST), 0.1, _FULL_RED))
    return shown
