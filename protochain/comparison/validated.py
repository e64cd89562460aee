"""Page of a validation: measures, residues with faults, clashes in the viewer, and the Ramachandran plot."""

from collections import defaultdict
from pathlib import Path

import pandas as pd

from protochain.comparison.plots import plot_ramachandran_classes
from protochain.results.figures import data_url
from protochain.results.page import table_data, write_page
from protochain.results.viewer import residue_keys, scene
from protochain.validation import LIKENESS, MEASURES
from protochain.validation.clashes import clash_discs
from protochain.validation.validate_structure import Validation

_SHOWN = {
    "chain", "residue", "name", "violation", "clashes", "ramachandran", "ramachandran_percent",
    "rotamer_outlier", "cbeta_deviation_angstrom",
}  # fmt: skip
"""Columns of residues that are shown at first."""


def write_validated(result: Validation, path: Path) -> None:
    """Write the page of a validation, one file that works offline."""
    s = result.structure
    faults: dict[int, list[str]] = defaultdict(list)
    for residue, fault in result.findings:
        faults[residue].append(fault)
    keys = residue_keys(s)
    # Residues with most faults first.
    worst = sorted(faults, key=lambda r: -len(faults[r]))
    named = [(str(keys[r]), f"{s.residue(r)}: {', '.join(faults[r])}") for r in worst]
    words = {key: measure.what for key, measure in MEASURES.items()}
    words |= {key: description for key, (_, description) in LIKENESS.items()}
    rows = [(words[key], value) for key, value in result.measures.items() if value is not None]
    write_page(
        path,
        "validated.html",
        structure=s,
        measures=result.measures,
        added=result.added,
        named=named,
        rows=pd.DataFrame(rows, columns=["measure", "value"]),
        ramachandran=data_url(plot_ramachandran_classes({s.name: s})),
        data=table_data(result.residues, _SHOWN),
        ligands=result.ligand_table,
        **scene({s.name: s}, discs=clash_discs, focus=named[0][0] if named else ""),
    )
