"""Scenes of mechanics, each run in full: what was checked, how it ended, what it costs.

    python analysis/benchmarks/mechanisms.py [-o DIR] [--quick]

mechanisms.csv: a row a scene, with the check that comes nearest to its bound. mechanisms_checks.csv: every
value beside its oracle. mechanisms_work.csv: every point of error against run time. mechanisms_left_out.csv:
what was left out, and how many times as long it takes with it. Processor seconds, one thread.
"""

import argparse
from collections import Counter
from collections.abc import Iterator
from time import process_time
from typing import Any

import made
import pandas as pd

from bench.scenes import SCENES, Scene, run

TABLES = ("checks", "work", "left_out")


def row(scene: Scene, seconds: float) -> dict[str, Any]:
    """How a scene ended."""
    nearest = max(scene.checks, key=lambda check: check.error / check.bound if check.bound else 0.0)
    outcomes = Counter(each.verdict for each in scene.extremes)
    return {
        "scene": scene.name, "title": scene.title, "seconds": round(seconds, 1), "checks": len(scene.checks),
        "nearest": nearest.name, "error": nearest.error, "bound": nearest.bound,
        **{outcome: outcomes[outcome] for outcome in ("right", "refused", "wrong")},
        "saved": max((each.ratio for each in scene.left_out), default=float("nan")),
        "failed": "; ".join(scene.wrong),
    }  # fmt: skip


def scenes(quick: bool) -> Iterator[tuple[Scene, float]]:
    """Every scene with its processor seconds; in the first of a method kernels may be compiled."""
    for name in SCENES:
        began = process_time()
        found = run(name, quick)
        yield found, process_time() - began


def parser() -> argparse.ArgumentParser:
    return made.parser(__doc__ or "")


def main() -> None:
    options = parser().parse_args()
    rows: list[dict[str, Any]] = []
    tables: dict[str, list[pd.DataFrame]] = {name: [] for name in TABLES}
    for scene, seconds in scenes(options.quick):
        rows.append(row(scene, seconds))
        print(pd.DataFrame(rows[-1:]).drop(columns="title").to_string(index=False), flush=True)
        frames = scene.frames()
        for name in TABLES:
            tables[name].append(frames[name].assign(scene=scene.name))
    if not options.output:
        return
    made.write(pd.DataFrame(rows), options.output / "mechanisms.csv")
    for name, parts in tables.items():
        table = pd.concat([part for part in parts if len(part)])
        made.write(table[["scene", *table.columns.drop("scene")]], options.output / f"mechanisms_{name}.csv")


if __name__ == "__main__":
    main()
