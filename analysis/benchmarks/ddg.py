"""What the energies of `mutate` are worth: beside measured changes of stability, FoldX and Rosetta.

    python analysis/benchmarks/ddg.py [-o DIR] [--quick] [--more FOLDER] [--kept FOLDER]

The set is S461 (Hernandez, Dehouck, Bastolla, Lopez-Blanco, Chacon, Bioinformatics 39:btad011, 2023): rows of
S669 (Pancotti et al., Brief. Bioinform. 23:bbab555, 2022) corrected by its authors, of proteins below 25 %
identity to those of S2648. Structures, measured values and published predictions are read from
FOLDER/korpm, a copy of github.com/chaconlab/korpm, whose licence (NPOSL-3.0) keeps them out of this
repository: ddg.csv has our values alone, ddg_programs.csv how each program compares.

The sample was stated before the first run: structures of fewer than 160 residues, of each at most four
mutations, evenly spaced in the order of the set. No number is fitted to it, nor to other rows of the set.

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


def values(path: Path) -> dict[tuple[str, str], tuple[float, float]]:
    """Measured and predicted value of each mutation of a file, in our sign, by structure and mutation."""
    rows = [line.split() for line in path.read_text().splitlines() if line[:1] not in ("", "#")]
    return {(row[0], row[1]): (-float(row[2]), -float(row[3])) for row in rows}


def sample(folder: Path) -> pd.DataFrame:
    """Rows of the set that are run, by the rule above."""
    results = folder / "S461_results"
    published = {name: values(results / f"S461_{of}_DIR.txt") for name, of in PUBLISHED.items()}
    rows = []
    for (name, told), (measured, _) in values(results / "S461.txt").items():
        atoms = (folder / "S461" / f"{name}.pdb").read_text().splitlines()
        residues = len({line[21:27] for line in atoms if line[:4] == "ATOM"})
        if residues < MOST_RESIDUES:
            wild, chain, place = told[0], told[1], told[2:]
            row = {"structure": name, "residues": residues, "mutation": f"{chain}:{wild}{place}"}
            row |= {"measured_kcal_mol": measured}
            known = {key: its[name, told] for key, its in published.items() if (name, told) in its}
            rows.append(row | {f"{key}_kcal_mol": predicted for key, (_, predicted) in known.items()})
    table = pd.DataFrame(rows)
    parts = [its.iloc[evenly(len(its))] for _, its in table.groupby("structure", sort=False)]
    return pd.concat(parts, ignore_index=True)


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


def run(options: argparse.Namespace, folder: Path, kept: Path) -> pd.DataFrame:
    """Ours beside measured and published values."""
    chosen, tables = sample(folder), []
    for name, rows in chosen.head(4 if options.quick else len(chosen)).groupby("structure", sort=False):
        path = folder / "S461" / f"{name}.pdb"
        tables.append(made.kept_rows(kept / f"{name}.csv", lambda p=path, r=rows: of_structure(p, r)))
        print(made.markdown(tables[-1].drop(columns="message")), flush=True)
    return pd.concat(tables, ignore_index=True)


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
        table = run(options, folder, options.kept or Path(scratch))
    if options.output:
        files = [f"{name}.pdb" for name in dict.fromkeys(table["structure"])]
        made.write(programs(table).round(3), options.output / "ddg_programs.csv", files, threads=2)
        of_others = ["measured_kcal_mol", *(f"{name}_kcal_mol" for name in PUBLISHED)]
        made.write(table.drop(columns=of_others).round(3), options.output / "ddg.csv", files, threads=2)


if __name__ == "__main__":
    main()
