"""Interfaces scored."""

import numpy as np
import pandas as pd

from tables import markdown, paragraph, table, table_of_rows

table_of_rows(
    "interfaces-columns", "interfaces_columns.csv", ("complex", "{complex}"), ("sides", "{interface}"),
    ("residues", "{n_residues}"), ("energy, kJ/mol", "{energy_kj_mol:.3f}"),
    ("OpenMM", "{energy_openmm_kj_mol:.3f}"),
    ("area", "{area_angstrom2:.0f}"), ("FreeSASA", "{area_freesasa_angstrom2:.0f}"),
    ("its own radii", "{area_freesasa_own_angstrom2:.0f}"), ("Sc", "{sc:.3f}"), ("sc-rs", "{sc_sc_rs:.3f}"),
    ("hydrogen bonds", "{hydrogen_bonds}"), ("Wernet, Nilsson", "{hydrogen_bonds_wernet_nilsson}"),
)  # fmt: skip


@table("interfaces-words", "interfaces_columns.csv")
def words(rows: pd.DataFrame) -> str:
    """What the table of columns says."""
    energy = (rows["energy_kj_mol"] - rows["energy_openmm_kj_mol"]).abs().max()
    area = (rows["area_angstrom2"] / rows["area_freesasa_angstrom2"] - 1.0).abs().max()
    own = 1.0 - (rows["area_freesasa_own_angstrom2"] / rows["area_angstrom2"]).mean()
    fit = (rows["sc"] - rows["sc_sc_rs"]).abs().max()
    return paragraph(
        f"Energies differ by at most {energy:.2g} kJ/mol, areas by {100 * area:.1f} per cent with the same",
        f"radii. With FreeSASA's radii areas are {100 * own:.0f} per cent smaller in the mean. Sc differs by",
        f"at most {fit:.3f}.",
    )


_HEADINGS = {
    "energy_kj_mol": "energy", "interaction_kj_mol": "interaction", "lennard_jones_kj_mol": "Lennard-Jones",
    "buried_area_angstrom2": "area", "shape_complementarity": "Sc", "hydrogen_bonds": "hydrogen bonds",
    "contacts": "contacts", "clashes": "clashes",
}  # fmt: skip


@table("interfaces-moved", "interfaces_moved.csv")
def moved(rows: pd.DataFrame) -> str:
    """Columns at each step, and their ranks."""
    lines = []
    for _, row in rows.iterrows():
        ranks = pd.isna(row["by"])
        unit = "angstrom" if str(row["motion"]).startswith("out") else "degrees"
        by = row["motion"] if ranks else f"{row['motion']}, {row['by']:g} {unit}"
        cells = [_cell(row[key], key, ranks) for key in _HEADINGS]
        lines.append([f"{row['complex']} {row['interface']}", by, *cells])
    return markdown(("complex", "motion", *_HEADINGS.values()), lines)


def _cell(value: float, key: str, is_rank: bool) -> str:
    if pd.isna(value):
        return "-"
    if is_rank or key == "shape_complementarity":
        return f"{value:.2f}"
    return f"{value:.0f}" if abs(value) < 1e6 else f"{value:.1e}"


@table("interfaces-ranks", "interfaces_moved.csv")
def ranks(rows: pd.DataFrame) -> str:
    """Which columns worsen at every step, and where not."""
    found = rows[rows["by"].isna()]
    always, told = [], []
    for key, name in _HEADINGS.items():
        there = found[[*("complex", "motion"), key]].dropna()
        less = there[~np.isclose(there[key].astype(float), 1.0)]
        if len(less):
            where = ", ".join(
                f"{row['complex']} {str(row['motion']).removesuffix(', rank')}" for _, row in less.iterrows()
            )
            told.append(f"{name} ({where})")
        elif len(there):
            always.append(name)
    return paragraph(
        f"These columns worsen at every step of every motion: {', '.join(always) or 'none'}. The others have",
        f"exceptions: {', '.join(told)}. Rigid interlocked sides collide in any motion. Energies then come",
        "from clashes, and a turn may press more residues together, which buries more area.",
    )


@table("interfaces-cost", "interfaces_cost.csv")
def cost(rows: pd.DataFrame) -> str:
    """Seconds of a complex."""
    row = rows.iloc[0]
    own = row["seconds_each"] * row["busy_percent"] / 100.0
    return paragraph(
        f"{row['copies']} copies of {row['complex']} ({row['n_residues']} residues, {row['n_atoms']} atoms)",
        f"are scored by `relax --interface A:B`, with one thread for each of {row['workers']} workers. Each",
        f"needs {own:.0f} processor seconds, two scores and the start of a process included. The workers had",
        f"{row['busy_percent']:.0f} per cent of their cores, and together needed",
        f"{row['seconds_each'] / row['workers']:.0f} s a complex.",
    )
