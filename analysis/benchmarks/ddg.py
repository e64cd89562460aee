"""What the energies of `mutate` are worth: beside measured changes of stability, FoldX and Rosetta.

    python analysis/benchmarks/ddg.py [-o DIR] [--quick] [--more FOLDER] [--kept FOLDER]

The set is S461 (Hernandez, Dehouck, Bastolla, Lopez-Blanco, Chacon, Bioinformatics 39:btad011, 2023): rows of
S669 (Pancotti et al., Brief. Bioinform. 23:bbab555, 2022) corrected by its authors, of proteins below 25 %
identity to those of S2648. Structures, measured values and published predictions are read from
FOLDER/korpm, a copy of github.com/chaconlab/korpm, whose licence (NPOSL-3.0) keeps them out of this
repository: ddg.csv has our values alone, ddg_programs.csv how each program compares.

The sample was stated before the first run: structures of fewer than 160 residues, of each at most four
mutations, evenly spaced in the order of the set. No number is fitted to it, nor to other rows of the set.

Antisymmetry is measured on Ssym (Pucci, Bernaerts, Kwasigroch, Rooman, Bioinformatics 34:3659, 2018), pairs
of crystals that differ by one mutation, from the same folder and sampled by the same rule. The mutation is
made of the one crystal, and its reverse of the other.

Protocol: each structure by `relax` with its defaults, each mutation of the result by `mutate` with its own.
Signs are ours, above 0 is less stable; kcal/mol, as in the set. Structures in a folder (--kept) are not
repeated.
"""

import argparse
import sys
import tempfile
from collections.abc import Hashable, Iterator
from pathlib import Path
from time import perf_counter
from typing import Any

import made
import numpy as np
import pandas as pd

import protochain as pc

MOST_RESIDUES, MOST_MUTATIONS = 160, 4
KJ_PER_KCAL = 4.184
PUBLISHED = {"foldx": "FoldX", "rosetta": "CartDD"}
"""Programs, and what their files are named by: FoldX, and Rosetta's cartesian_ddg."""
OF_PAIRS = {"foldx": "FoldX_Pucci2018{}_th8", "rosetta": "Cartddg_Pucci2018{}_th8"}
"""The same of Ssym, direct and reverse."""


def values(path: Path) -> dict[tuple[str, str], tuple[float, float]]:
    """Measured and predicted value of each mutation of a file, in our sign, by structure and mutation."""
    rows = [line.split() for line in path.read_text().splitlines() if line[:1] not in ("", "#")]
    return {(row[0], row[1]): (-float(row[2]), -float(row[3])) for row in rows}


def place(mutation: str) -> str:
    """Residue to mutate and its new letter in our words: FA7L of the set is A:F7L."""
    return f"{mutation[1]}:{mutation[0]}{mutation[2:]}"


def n_residues(path: Path) -> int:
    """Residues of the protein of a PDB file."""
    return len({line[21:27] for line in path.read_text().splitlines() if line[:4] == "ATOM"})


def sampled(table: pd.DataFrame) -> pd.DataFrame:
    """Rows of the small structures by the rule above."""
    table = table[table["residues"] < MOST_RESIDUES]
    parts = [its.iloc[evenly(len(its))] for _, its in table.groupby("structure", sort=False)]
    return pd.concat(parts, ignore_index=True)


def sample(folder: Path) -> pd.DataFrame:
    """Rows of S461 that are run."""
    results = folder / "S461_results"
    published = {name: values(results / f"S461_{of}_DIR.txt") for name, of in PUBLISHED.items()}
    rows = []
    for (name, mutation), (measured, _) in values(results / "S461.txt").items():
        row = {"structure": name, "residues": n_residues(folder / "S461" / f"{name}.pdb")}
        row |= {"mutation": place(mutation), "measured_kcal_mol": measured}
        known = {key: its[name, mutation] for key, its in published.items() if (name, mutation) in its}
        rows.append(row | {f"{key}_kcal_mol": predicted for key, (_, predicted) in known.items()})
    return sampled(pd.DataFrame(rows))


def sample_of_pairs(folder: Path) -> pd.DataFrame:
    """Pairs of Ssym that are run: structure and mutation, the same of the reverse, and what is published."""
    sides = [
        [line.split() for line in (folder / f"Ssym{side}.txt").read_text().splitlines()] for side in "DR"
    ]
    published = {
        (key, side): values(folder / "Ssym_results" / f"{of.format(side)}.txt")
        for key, of in OF_PAIRS.items()
        for side in ("dirN", "revN")
    }
    rows = []
    for direct, reverse in zip(*sides, strict=True):
        row = {"structure": direct[0], "residues": n_residues(folder / "Ssym" / f"{direct[0]}.pdb")}
        row |= {"mutation": place(direct[1]), "reverse_structure": reverse[0], "reverse": place(reverse[1])}
        row |= {"measured_kcal_mol": -float(direct[2])}
        for key in OF_PAIRS:
            row[f"{key}_kcal_mol"] = published[key, "dirN"][direct[0], direct[1]][1]
            row[f"{key}_reverse_kcal_mol"] = published[key, "revN"][reverse[0], reverse[1]][1]
        rows.append(row)
    return sampled(pd.DataFrame(rows))


def evenly(n: int) -> list[int]:
    """At most so many of n places, the first and the last among them."""
    return sorted({round(float(k)) for k in np.linspace(0, n - 1, min(n, MOST_MUTATIONS))})


def of_structure(path: Path, rows: pd.DataFrame) -> Iterator[dict[Hashable, Any]]:
    """Ours for the rows of one structure; what cannot be relaxed or mutated has a message."""
    began = perf_counter()
    try:
        relaxed = pc.relax(path)
    except pc.ProtochainError as error:
        relaxed, why = None, str(error).replace(f"{path.parent}/", "")
    seconds = perf_counter() - began
    for row in rows.to_dict("records"):
        ours: dict[Hashable, Any] = dict.fromkeys(("ddg_kcal_mol", "status", "seconds"))
        if relaxed is not None:
            try:
                record = pc.mutate(relaxed, row["mutation"]).record()
                ddg = record["ddg_kj_mol"]
                ours |= {name: record[name] for name in ("status", "seconds")}
                ours["ddg_kcal_mol"] = np.nan if ddg is None else ddg / KJ_PER_KCAL
                why = record["message"]
            except pc.ProtochainError as error:
                why = str(error)
        yield row | ours | {"seconds_relax": seconds, "message": why}


def of_structures(rows: pd.DataFrame, folder: Path, kept: Path, options: argparse.Namespace) -> pd.DataFrame:
    """Ours for all rows, by structure."""
    tables = []
    for name, its in rows.head(4 if options.quick else len(rows)).groupby("structure", sort=False):
        path = folder / f"{name}.pdb"
        tables.append(made.kept_rows(kept / f"{name}.csv", lambda p=path, r=its: of_structure(p, r)))
        print(made.markdown(tables[-1].drop(columns="message")), flush=True)
    return pd.concat(tables, ignore_index=True)


def run_pairs(options: argparse.Namespace, folder: Path, kept: Path) -> pd.DataFrame:
    """Ours for each pair: of the one crystal, and of the other, reversed."""
    rows = sample_of_pairs(folder)
    rows = rows.head(4 if options.quick else len(rows))
    reverse = rows[["reverse_structure", "reverse"]].set_axis(["structure", "mutation"], axis=1)
    for part in ("direct", "reverse"):
        (kept / part).mkdir(parents=True, exist_ok=True)
    there = of_structures(rows, folder / "Ssym", kept / "direct", options)
    back = of_structures(reverse, folder / "Ssym", kept / "reverse", options)
    ours = back.set_index(["structure", "mutation"])["ddg_kcal_mol"]
    pairs = zip(there["reverse_structure"], there["reverse"], strict=True)
    return there.assign(ddg_reverse_kcal_mol=[ours[pair] for pair in pairs])


def programs(rows: pd.DataFrame) -> pd.DataFrame:
    """Each program beside the measured values of the rows that all have, kcal/mol."""
    rows = rows.dropna(subset=[f"{name}_kcal_mol" for name in ("ddg", *PUBLISHED)])
    measured, found = rows["measured_kcal_mol"], []
    draws = np.random.default_rng(0).integers(len(rows), size=(2000, len(rows)))
    of = {name: rows[f"{name}_kcal_mol"] for name in ("ddg", *PUBLISHED)}
    for name, its in (of | {"mean": measured.mean() + 0.0 * measured}).items():
        off, row = its - measured, {"program": name, "mutations": len(rows)}
        if name != "mean":
            again = [np.corrcoef(its.to_numpy()[k], measured.to_numpy()[k])[0, 1] for k in draws]
            low, high = np.percentile(again, [2.5, 97.5])
            row |= {"correlation": its.corr(measured), "lowest": low, "highest": high}
            row |= {"of_ranks": its.corr(measured, method="spearman"), "spread": its.std() / measured.std()}
        row |= {"error_median": off.abs().median(), "error_mean": off.abs().mean()}
        row |= {"error_rms": np.sqrt((off**2).mean())}
        found.append(row | {"right_sign_percent": 100 * ((its > 0) == (measured > 0)).mean()})
    return pd.DataFrame(found)


def antisymmetry(rows: pd.DataFrame) -> pd.DataFrame:
    """How far each program's values of a mutation and of its reverse cancel, kcal/mol."""
    names = ("ddg", *OF_PAIRS)
    rows = rows.dropna(subset=[f"{name}{side}_kcal_mol" for name in names for side in ("", "_reverse")])
    measured, found = rows["measured_kcal_mol"], []
    for name in names:
        there, back = (rows[f"{name}{side}_kcal_mol"] for side in ("", "_reverse"))
        row = {"program": name, "pairs": len(rows), "correlation": there.corr(back)}
        row |= {"bias": (there + back).mean() / 2, "sum_median": (there + back).abs().median()}
        row |= {"measured_direct": there.corr(measured), "measured_reverse": back.corr(-measured)}
        found.append(row)
    return pd.DataFrame(found)


def parser() -> argparse.ArgumentParser:
    own = made.parser(__doc__ or "", more=True)
    own.add_argument("--kept", type=Path, metavar="FOLDER", help="of structures that are done")
    return own


def main() -> None:
    options = parser().parse_args()
    folder = options.more / "korpm"
    if not folder.is_dir():
        sys.exit(f"{folder} is not there: a copy of github.com/chaconlab/korpm")
    with tempfile.TemporaryDirectory() as scratch:
        kept = options.kept or Path(scratch)
        table = of_structures(sample(folder), folder / "S461", kept, options)
        pairs = run_pairs(options, folder, kept / "ssym")
    if options.output:
        for rows, summary, names in (
            (table, programs(table), ("ddg", "ddg_programs")),
            (pairs, antisymmetry(pairs), ("ddg_pairs", "ddg_antisymmetry")),
        ):
            files = [f"{name}.pdb" for name in dict.fromkeys(rows["structure"])]
            made.write(summary.round(3), options.output / f"{names[1]}.csv", files, threads=2)
            # Measured and published values are under the licence of the set.
            of_others = [name for name in map(str, rows) if name.startswith(("measured", *PUBLISHED))]
            made.write(
                rows.drop(columns=of_others).round(3), options.output / f"{names[0]}.csv", files, threads=2
            )


if __name__ == "__main__":
    main()
