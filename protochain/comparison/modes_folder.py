"""Output folder of `protochain modes`: tables, the structure, swings, and a page with moving modes."""

from collections.abc import Mapping
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from protochain.comparison.modes import NormalModes
from protochain.core.markup import plural
from protochain.core.palette import COLOURS
from protochain.core.storage import json_text, write_text
from protochain.results.columns import Column, of_energy, of_losses, of_structure, record
from protochain.results.figures import data_url, outside, panels
from protochain.results.page import write_page
from protochain.results.tables import save
from protochain.results.viewer import library
from protochain.structure import save as save_structure
from protochain.structure.formats.trajectory import TrajectoryFile
from protochain.structure.write import as_text

MOVING = 5
"""Number of lowest modes whose swings are written and shown."""
_structure = attrgetter("chain.structure")

COLUMNS = (
    Column("structure", lambda m: m.chain.structure.name),
    Column("is_minimum", lambda m: m.is_minimum, kind=bool),
    Column("message", lambda m: m.verdict),
    Column("n_modes", lambda m: m.n_modes),
    Column("n_negative", lambda m: m.n_negative),
    Column("lowest_frequency_per_cm", lambda m: float(m.frequencies[0]), kind=float | None),
    Column("b_factor_correlation", lambda m: m.b_factor_correlation, kind=float | None),
    Column("b_factor_column", lambda m: m.chain.structure.b_factor_quantity),
    Column("largest_stable_step_ps", lambda m: m.largest_stable_step),
    Column("largest_residual", lambda m: float(np.max(m.residuals)), kind=float | None),
    Column("max_torque_kj_mol_rad", lambda m: m.max_torque),
    Column("log_det_mass", lambda m: m.log_det_mass, kind=float | None),
    Column("products", lambda m: m.n_products, kind=int),
    Column("seconds", lambda m: m.seconds),
    *of_structure(_structure),
    Column("n_hinges", lambda m: m.chain.n_hinges),
    Column("hinges", lambda m: m.chain.opened),
    Column("held_by", lambda m: m.held_by),
    *of_energy(),
    *of_losses(_structure),
)
"""Columns of the record, in the order of a reader's interest."""


def files_of(folder: Path, n_modes: int, suffix: str, trajectory: str) -> list[Path]:
    """Files that are written to the folder, at most."""
    names = ["modes.csv", "fluctuations.csv", "summary.json", "report.html", f"minimum{suffix}"]
    swings = [f"mode-{number}" for number in range(1, min(n_modes, MOVING) + 1)]
    # Under the other name while it is written.
    names += [f"{swing}{part}.{trajectory}" for swing in swings for part in ("", ".part")]
    return [folder / name for name in names]


def record_of(modes: NormalModes, temperature: float) -> dict[str, Any]:
    """Return the flat record of modes, with the entropies if all modes are known."""
    entropy, usable = partial(modes.entropy, temperature), modes.is_minimum and modes.is_stable
    return record(COLUMNS, modes) | {
        "temperature_k": temperature,
        "entropy_kj_mol_k": entropy() if usable and modes.spectrum is not None else None,
        "entropy_classical_kj_mol_k": (
            entropy(quantum=False) if usable and modes.log_det_hessian is not None else None
        ),
        "log_det_hessian": modes.log_det_hessian,
    }


def write_modes(
    modes: NormalModes,
    folder: Path,
    extra: Mapping[str, Any],
    temperature: float,
    *,
    suffix: str = ".pdb",
    trajectory: str = "dcd",
    amplitude: float = 1.0,
    model: Any = None,
) -> dict[str, Any]:
    """Write tables, the structure, swings of the lowest modes and the page. Return the record."""
    # temperature K, amplitude angstrom.
    table, tables = modes.table(), {}
    full_record = record_of(modes, temperature) | dict(extra)
    if model is not None:
        table["overlap"], table["cumulative_overlap"] = modes.overlap(model), modes.cumulative_overlap(model)
        share = float(table["cumulative_overlap"].iloc[-1])
        full_record |= {"other": model.name, "cumulative_overlap": share}
    shown = None
    if modes.is_stable and len(modes.chain.structure.alpha_carbons):
        tables["fluctuations.csv"] = modes.fluctuations(temperature)
        shown = data_url(_figure(tables["fluctuations.csv"], modes.chain.structure.name))
    folder.mkdir(parents=True, exist_ok=True)
    save(folder, {"modes.csv": table, **tables})
    structure = modes.chain.structure.with_positions(modes.x)
    save_structure(structure, folder / f"minimum{suffix}", [f"NORMAL MODES AT {modes.verdict.upper()}"])
    ends = []
    for mode in range(min(modes.n_modes, MOVING)):
        frames = list(modes.swing(mode, amplitude))
        ends.append(structure.with_positions(frames[len(frames) // 4]))
        with TrajectoryFile(folder / f"mode-{mode + 1}.{trajectory}", structure) as file:
            for x in frames:
                file.append(x)
    text = partial(as_text, suffix=suffix, hydrogens=False)
    write_page(
        folder / "report.html",
        "modes.html",
        record=full_record,
        table=table.to_dict("records"),
        figure=shown,
        colours=COLOURS,
        library=library(),
        format=suffix.removeprefix("."),
        models=[text(end) for end in (structure, *ends)],
        amplitude=amplitude,
        size=plural(structure.n_protein_residues, "residue"),
    )
    write_text(folder / "summary.json", json_text(full_record, 1) + "\n")
    return full_record


def _figure(table: pd.DataFrame, name: str) -> Figure:
    """Plot B factors of the C-alphas along the sequence, next to the B factors of the file, if present."""
    figure, (axes,) = panels(None, 1, (7, 2.4))
    places = np.arange(1, len(table) + 1)
    filed = table["ca_b_factor_in_file_angstrom2"]
    axes.plot(places, table["ca_b_factor_angstrom2"], color=COLOURS[0], label="modes")
    if np.ptp(filed) > 0.0:
        axes.plot(places, filed, color=COLOURS[1], linestyle="--", label="file")
    axes.set(xlabel="residue, counted from 1", ylabel="B factor of C-alpha, square angstrom")
    largest = int(np.argmax(table["ca_b_factor_angstrom2"])) + 1
    axes.set_title(f"{name}: residue {largest} of {len(table)} moves most".replace("$", r"\$"))
    outside([axes])
    return figure
