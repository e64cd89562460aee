"""Tables of what runs leave out, of searches for contacts, and of scenes."""

from pathlib import Path

import pandas as pd
from tables import Cell, of_rows, table

COUNTED = ("terms", "pairs", "bodies", "sweeps", "lists", "imports")
SHORT = (
    "tenth residue, vacuum", "tenth residue, OBC2", "side chains of 10 residues, vacuum",
    "atoms of the middle residue, vacuum", "vacuum", "ten chains, OBC2 and a cutoff", "closed loops",
    "constant energy",
)  # fmt: skip
"""Scenes of the table of the README."""


def _left_out(row: pd.Series) -> str:
    """What a scene leaves out, counted."""
    return ", ".join(f"{row[name]:,} {name}" for name in COUNTED if row[name]) or row["message"]


def _error(row: pd.Series) -> str:
    return "bits" if row["error"] == 0.0 else f"{row['error']:.0e}"


_COLUMNS: tuple[tuple[str, Cell], ...] = (
    ("scene", "{scene}"), ("with everything", "{against}"), ("ms", "{everything_ms:.3g}"),
    ("left out, ms", "{left_out_ms:.3g}"), ("ratio", "{ratio:.2f}"), ("error", _error),
)  # fmt: skip


@table("scenes")
def scenes(results: Path) -> str:
    """Every scene, with counts of what it leaves out."""
    return of_rows(pd.read_csv(results / "scenes.csv"), *_COLUMNS, ("left out", _left_out))


@table("scenes-short")
def scenes_short(results: Path) -> str:
    """Some scenes, for the README."""
    rows = pd.read_csv(results / "scenes.csv")
    return of_rows(rows[rows["scene"].isin(SHORT)], *_COLUMNS)


@table("search")
def search(results: Path) -> str:
    """Cost of searches for contacts by size."""
    rows = pd.read_csv(results / "search.csv")
    wide = rows.pivot(index="search", columns="bodies", values="ns_each")
    wide["exponent"] = rows.groupby("search")["exponent"].first()
    sizes = tuple((f"{n:,}", f"{{n{n}:.0f}}") for n in wide.columns[:-1])
    wide.columns = [*(f"n{n}" for n in wide.columns[:-1]), "exponent"]
    return of_rows(wide.reset_index(), ("search", "{search}"), *sizes, ("exponent", "{exponent:.2f}"))


@table("search-lists")
def search_lists(results: Path) -> str:
    """Cells against the neighbour lists of the energy."""
    return of_rows(
        pd.read_csv(results / "search_lists.csv"),
        ("structure", "{structure}"), ("atoms", "{atoms}"), ("distance nm", "{distance_nm:.1f}"),
        ("pairs", "{pairs:,}"), ("cells ms", "{cells_ms:.2f}"), ("lists ms", "{lists_ms:.2f}"),
        ("lists over cells", "{ratio:.1f}"),
    )  # fmt: skip


@table("mechanisms")
def mechanisms(results: Path) -> str:
    """How each scene of mechanics ended, and what it took."""
    return of_rows(
        pd.read_csv(results / "mechanisms.csv"),
        ("scene", "`{scene}`: {title}"), ("CPU seconds", "{seconds:.0f}"), ("checks", "{checks}"),
        ("nearest to its bound", "{nearest}"), ("error", "{error:.1e}"), ("bound", "{bound:.0e}"),
        ("extremes", _extremes), ("most saved by leaving out", "{saved:.2g}x"),
    )  # fmt: skip


@table("mechanisms-short")
def mechanisms_short(results: Path) -> str:
    """What the scenes of mechanics are, and how they ended, for the README."""
    return of_rows(
        pd.read_csv(results / "mechanisms.csv"),
        ("scene", "`{scene}`: {title}"), ("checks", "{checks}"), ("extremes", _extremes),
        ("CPU seconds", "{seconds:.0f}"),
    )  # fmt: skip


def _extremes(row: pd.Series) -> str:
    told = [f"{row[name]} {name}" for name in ("right", "refused", "wrong") if row[name]]
    return ", ".join(told) or "-"
