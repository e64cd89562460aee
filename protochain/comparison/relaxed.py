"""Page of a relaxation: before and after, both structures, the end coloured by how far each atom moved."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from protochain.comparison.colourings import colourings
from protochain.comparison.differences import Differences, joined, of_ends, totals_of
from protochain.comparison.plots import plot_differences
from protochain.relaxation import Relaxation
from protochain.relaxation.record import before_and_after
from protochain.results.figures import data_url
from protochain.results.page import write_page
from protochain.results.provenance import command_line
from protochain.results.terms import energies_by_term
from protochain.results.viewer import DISPLACEMENT, pockets, scene
from protochain.structure.losses import loss_lines


def write_relaxed(relaxation: Relaxation, record: Mapping[str, Any], path: Path) -> None:
    """Write the page of a relaxation, one file that works offline."""
    strength = relaxation.settings.strength
    changes = of_ends(relaxation.ends())
    figure = plot_differences({name: each.residues for name, each in changes.items()}, relaxation.start.name)
    write_page(
        path,
        "relaxed.html",
        record=record,
        rows=before_and_after(record),
        terms=energies_by_term({"end": record}),
        lost=loss_lines([record]),
        changes=totals_of(changes),
        bonds_changed=joined(changes, "bonds"),
        figure=data_url(figure),
        command=command_line(),
        name=strength.name,
        source=strength.source,
        pockets=pockets(relaxation.start, relaxation.start.positions, relaxation.x),
        **coloured(relaxation, changes),
    )


def coloured(relaxation: Relaxation, changes: Mapping[str, Differences] = {}) -> dict[str, Any]:
    """Variables of the viewer's template, by displacement at first."""
    ends = relaxation.ends()
    return scene(ends, colourings(ends, relaxation.energy_function, changes), DISPLACEMENT)
