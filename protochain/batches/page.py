"""Page of one structure: results, energy curves, repairs. It is small, as there may be thousands."""

from collections.abc import Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from protochain.batches.jobs import Job, Row
from protochain.core.lazy_pandas import pd
from protochain.core.palette import looks
from protochain.core.storage import write_text
from protochain.minimisers.record import SHORT_COLUMNS, short_columns
from protochain.relaxation.record import METHOD as RELAX
from protochain.results.columns import Column, energies_by_term
from protochain.results.page import write_page as fill
from protochain.results.viewer import DISPLACEMENT, library, scene
from protochain.structure import Structure
from protochain.structure.molecule.repairs import Repair, loss_lines

SHOWN_RELAXED = tuple(
    Column(key, itemgetter(key), heading)
    for key, heading in {
        "status": "status", "violations_start": "residues with violations at start",
        "violations_end": "at end", "overlaps_start": "overlaps at start", "overlaps_end": "at end",
        "energy_start_kj_mol": "energy at start", "energy_end_reference_kj_mol": "energy at end",
        "ca_rmsd_angstrom": "C-alpha RMSD", "n_rounds": "rounds", "seconds": "seconds",
    }.items()
)  # fmt: skip
"""Columns of relaxed structures."""
WIDTH, HEIGHT = 640, 240
"""Size of the drawing, in units of the SVG."""


def write_page(
    folder: Path,
    job: Job,
    rows: Sequence[Row],
    repairs: Sequence[Repair],
    ends: Mapping[str, tuple[Structure, Structure | None]] = MappingProxyType({}),
) -> None:
    """Write ``pages/NAME.html``."""
    minimised_columns = SHORT_COLUMNS if {*job.settings.methods} != {RELAX} else ()
    of_relaxed = SHOWN_RELAXED if RELAX in job.settings.methods else ()
    columns = {column.key: column for column in (*of_relaxed, *minimised_columns)}.values()
    records = [row.record for row in rows]
    path = folder / "pages" / f"{job.name}.html"
    fill(
        path,
        "structure.html",
        job=job,
        home="../" * len(path.relative_to(folder).parent.parts),
        shown=short_columns(records, columns),
        records=records,
        repairs=repairs,
        changes=_changes(ends),
        terms=energies_by_term({row.record["method"]: row.record for row in rows}),
        lost=loss_lines(row.record for row in rows),
        curves=curves(rows),
        looks={name: look.svg for name, look in looks(row.record["method"] for row in rows).items()},
        width=WIDTH,
        height=HEIGHT,
        **_view_data(folder, path, ends),
    )


_MOST_ATOMS = 20_000
"""Most atoms of a structure on its page. More would be megabytes, and there may be thousands of pages."""


def _view_data(
    folder: Path, path: Path, ends: Mapping[str, tuple[Structure, Structure | None]]
) -> dict[str, Any]:
    """Variables of the viewer. All pages share one file of its library."""
    structures = {method: end for method, (_, end) in ends.items() if end is not None}
    start = next((start for start, _ in ends.values()), None)
    if start is None or not structures or start.n_atoms > _MOST_ATOMS:
        return {"models": []}
    shared_file = folder / "pages" / "viewer.js"
    if not shared_file.exists():
        write_text(shared_file, library())
    address = "../" * (len(path.relative_to(folder).parent.parts) - 1) + shared_file.name
    equal = {method: end for method, end in structures.items() if end.n_atoms == start.n_atoms}
    return scene({"start": start, **equal}, chosen=DISPLACEMENT) | {"library_at": address, "library": ""}


def _changes(ends: Mapping[str, tuple[Structure, Structure | None]]) -> "pd.DataFrame":
    """Totals of the changes of each method, in one column each."""
    from protochain.comparison.differences import of_ends, totals_of

    changes = {
        method: of_ends({"start": start, method: end})
        for method, (start, end) in ends.items() if end is not None
    }  # fmt: skip
    return totals_of({method: change[method] for method, change in changes.items() if change})


def curves(rows: Sequence[Row]) -> dict[str, object]:
    """Lowest energy so far against the logarithm of evaluations, as points of an SVG."""
    runs = {}
    for row in rows:
        energies = np.array([point["energy_kj_mol"] for point in row.trace])
        work = np.array([max(point["evaluations"], 1.0) for point in row.trace])
        sound = np.isfinite(energies)
        if sound.any():
            runs[row.record["method"]] = (np.log10(work[sound]), np.minimum.accumulate(energies[sound]))
    if not runs:
        return {"lines": {}}
    low = min(float(energy.min()) for _, energy in runs.values())
    high = max(float(energy.max()) for _, energy in runs.values())
    largest = max(float(work.max()) for work, _ in runs.values())
    lines = {
        method: " ".join(
            f"{WIDTH * w / max(largest, 1e-9):.1f},{HEIGHT * (high - e) / max(high - low, 1e-9):.1f}"
            for w, e in zip(work, energy, strict=True)
        )
        for method, (work, energy) in runs.items()
    }
    return {"low": low, "high": high, "most": round(10**largest), "lines": lines}
