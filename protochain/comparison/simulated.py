"""Page of a simulation: its log, fluctuations, the Ramachandran plot, and frames in the viewer."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from protochain.comparison.plots import ramachandran_ground, residue_places
from protochain.core.arrays import Floats
from protochain.core.palette import COLOURS, looks
from protochain.core.units import ANGSTROM_PER_NM
from protochain.results.columns import heading
from protochain.results.figures import data_url, outside, panels, plain
from protochain.results.page import write_page
from protochain.results.provenance import of_run
from protochain.results.viewer import library, superpose
from protochain.structure import Structure
from protochain.structure.write import as_text, common_suffix
from protochain.validation.ramachandran import REGIONS, ramachandran

_MOST, _SHOWN, _ATOMS = 400, 60, 200_000
"""Limits of frames in figures, of frames in the viewer, and of their atoms, each about ten bytes."""
_DRAWN = (
    ("energy, kJ/mol", ("potential_kj_mol", "conserved_kj_mol"), "potential: {mean:.1f} kJ/mol on average"),
    ("temperature, K", ("temperature_k",), "{mean:.0f} K on average"),
    ("C-alpha RMSD to the start, angstrom", ("ca_rmsd_angstrom",), "{last:.2f} angstrom at the end"),
)
"""Panels of the log: label, columns, and a title with the mean and last value of the first column."""


def write_simulated(
    structure: Structure, log: pd.DataFrame, record: Mapping[str, Any], trajectory: Path, path: Path
) -> None:
    """Write the page of a simulation, one file that works offline. A row of the log is a frame."""
    from protochain.structure.formats.frames import open_frames

    stride = -(-len(log) // _MOST)
    frames = [
        superpose(structure.with_positions(frame.x), structure)
        for k, frame in enumerate(open_frames(trajectory)) if k % stride == 0 and frame.x is not None
    ]  # fmt: skip
    times = log["time_ps"].to_numpy()[::stride][: len(frames)]
    suffix, heavy = common_suffix([structure]), structure.atom_element != "H"
    skip = -(-len(frames) // max(2, min(_SHOWN, _ATOMS // max(1, int(heavy.sum())))))
    shown = [np.rint(100.0 * ANGSTROM_PER_NM * frame.positions[heavy]) for frame in frames[::skip]]
    write_page(
        path,
        "simulated.html",
        name=structure.name,
        length=float(log["time_ps"].iloc[-1]),
        record=record,
        structure=structure,
        n_frames=len(log),
        trajectory=trajectory.name,
        averages=averages(log),
        last=log.iloc[-1].to_dict(),
        means=log.mean(numeric_only=True).to_dict(),
        figures={
            "log": data_url(_log(log)),
            "rmsf": data_url(_fluctuations(structure, frames)),
            "ramachandran": data_url(_ramachandran(frames, times)),
        },
        text=as_text(frames[0], suffix, hydrogens=False),
        format=suffix.removeprefix("."),
        coordinates=[frame.astype(int).ravel().tolist() for frame in shown],
        times=[round(float(t), 4) for t in times[::skip]],
        library=library(),
        run=of_run("openmm", "gemmi", "numpy", "scipy", "numba"),
    )


def averages(log: pd.DataFrame) -> pd.DataFrame:
    """Mean, standard deviation, lowest, highest and drift, with a row for each quantity of a log."""
    time, rows = log["time_ps"].to_numpy(), []
    for name in (column for column in log.columns if column not in ("step", "time_ps", "seconds")):
        values = log[name].to_numpy(dtype=float)
        drift = np.polyfit(time, values, 1)[0] if np.isfinite(values).all() and np.ptp(time) > 0.0 else np.nan
        rows.append([heading(str(name)), values.mean(), values.std(), values.min(), values.max(), drift])
    columns = ["quantity", "mean", "standard deviation", "lowest", "highest", "drift, per ps"]
    return pd.DataFrame(rows, columns=columns)


def _log(log: pd.DataFrame) -> Figure:
    """Plot quantities of the log against time, quantities of one unit in one panel."""
    rows = [(label, [name for name in names if name in log], title) for label, names, title in _DRAWN]
    rows = [row for row in rows if row[1]]
    figure, axes = panels(None, (len(rows), 1), (7, 0.3 + 1.8 * len(rows)), sharex=True)
    for ax, (label, names, title) in zip(axes, rows, strict=True):
        columns = {heading(name).split(",")[0]: name for name in names}
        for look, (legend, name) in zip(looks(columns).values(), columns.items(), strict=True):
            ax.plot(log["time_ps"], log[name], **look.line(legend) | {"marker": "", "linewidth": 1.2})
        ax.set_title(title.format(mean=log[names[0]].mean(), last=log[names[0]].iloc[-1]))
        ax.set_ylabel(label.replace(", ", ",\n") if len(label) > 20 else label)
        if len(names) > 1:
            outside([ax])
        plain(ax)
    axes[-1].set_xlabel("time, ps")
    return figure


def rmsf(structure: Structure, frames: Iterable[Structure]) -> Floats:
    """(n,) float, angstrom: root mean square fluctuation of each C-alpha of superposed frames."""
    x = np.array([frame.positions[structure.alpha_carbons] for frame in frames])
    return np.asarray(ANGSTROM_PER_NM * np.sqrt(((x - x.mean(axis=0)) ** 2).sum(axis=-1).mean(axis=0)))


def _fluctuations(structure: Structure, frames: list[Structure]) -> Figure:
    figure, (ax,) = panels(None, 1, (7, 2.3))
    values, residues = rmsf(structure, frames), structure.atom_residue[structure.alpha_carbons]
    ax.plot(np.arange(1, len(values) + 1), values, color=COLOURS[0], marker="o", markersize=3)
    number = np.char.add(structure.residue_number, structure.residue_insertion_code)
    places = residue_places(structure.residue_chain[residues], number[residues])
    ax.set_xticks([*places], [*places.values()])
    if len(values):
        r = int(residues[np.argmax(values)])
        ax.set_title(f"{structure.residue(r)} moves most: {values.max():.2f} angstrom")
    ax.set(xlabel="residue", ylabel="RMSF of C-alpha, angstrom", ylim=(0.0, None))
    plain(ax)
    return figure


def _ramachandran(frames: list[Structure], times: Floats) -> Figure:
    """Phi and psi of all frames, coloured by time."""
    figure, (ax,) = panels(None, 1, (5.0, 3.3))
    angles = [ramachandran(frame) for frame in frames]
    names = ("phi", "psi", "region")
    phi, psi, regions = (np.concatenate([getattr(turns, name) for turns in angles]) for name in names)
    time = np.repeat(times, [len(turns.phi) for turns in angles])
    ramachandran_ground(ax)
    points = ax.scatter(phi, psi, s=5, c=time, cmap="viridis", linewidths=0)
    if len(regions):
        favoured = 100.0 * np.mean(regions == REGIONS.index("favoured"))
        ax.set_title(f"{favoured:.0f} % of all residues and frames are favoured")
    ax.set(xlabel="phi, degrees", ylabel="psi, degrees")
    figure.colorbar(points, ax=ax, label="time, ps")
    return figure
