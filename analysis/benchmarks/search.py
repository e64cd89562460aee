"""Cost of the search for contacts: cells for cubes, a tree of boxes for triangles, and cells for atoms.

    python analysis/benchmarks/search.py [-o DIR] [--quick] [STRUCTURE ...]

search.csv: cubes of 20 mm, as dense as in a pile, each in a ball through its corners; balls over a surface of
as many triangles. Nanoseconds a body, sizes in turn, the least of some; scipy's cKDTree beside the cells. The
exponent is that of the whole cost over the sizes. search_lists.csv: cells against the neighbour lists of the
native energy, on the same atoms and for the same pairs; ratio: lists over cells. Processor time, one thread.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import made
import numpy as np
import pandas as pd
from made import SAMPLES
from scipy.spatial import cKDTree

import protochain as pc
import protochain.energies
from bench import exponent, in_turn
from protochain.mechanisms import box_tree, overlapping, touching

native = protochain.energies.native.neighbours
"""The lists, which are no public name."""

SIZES = (1_000, 3_162, 10_000, 31_623, 100_000)
EDGE, PACKING = 0.02, 0.55
"""m, and the share of the volume that cubes fill."""
REPEATS = 9
DISTANCES = (0.3, 0.5, 1.0)
"""nm, with the skin."""


def least(calls: dict[object, Callable[[], object]], repeats: int) -> dict[object, float]:
    """Least seconds of each call; all are made in turn, after one that compiles."""
    for call in calls.values():
        call()
    found = in_turn(list(calls.values()), turns=repeats)
    return {key: each.least for key, each in zip(calls, found, strict=True)}


def pile(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Centres and radii of cubes at random, as many in a volume as in a pile."""
    side = (n * EDGE**3 / PACKING) ** (1.0 / 3.0)
    return np.random.default_rng(n).uniform(0.0, side, (n, 3)), np.full(n, 0.5 * EDGE * 3.0**0.5)


def ground(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Boxes of some n triangles of a hilly surface, (n, 3) each."""
    k = int(np.sqrt(n / 2.0)) + 1
    x, y = np.meshgrid(np.arange(k) * EDGE, np.arange(k) * EDGE, indexing="ij")
    at = np.stack([x, y, 2.0 * EDGE * np.sin(7.0 * x) * np.cos(5.0 * y)], axis=-1)
    corners = (at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:])
    faces = np.concatenate([np.stack([corners[k] for k in face], axis=2) for face in ((0, 1, 2), (0, 2, 3))])
    faces = faces.reshape(-1, 3, 3)
    return faces.min(axis=1), faces.max(axis=1)


def scaling(sizes: tuple[int, ...], repeats: int) -> pd.DataFrame:
    """Cost of each search by size."""
    calls: dict[object, Callable[[], object]] = {}
    for n in sizes:
        centre, radius = pile(n)
        low, high = ground(n)
        tree = box_tree(low, high)
        # A ball over every triangle, in no order.
        ball = 0.5 * (low + high)[np.random.default_rng(n).permutation(len(low))]
        calls["cubes, cells", n] = lambda c=centre, r=radius: touching(c, r)
        calls["cubes, cKDTree", n] = lambda c=centre, r=radius: cKDTree(c).query_pairs(
            2.0 * r[0], output_type="ndarray"
        )
        calls["triangles, search", n] = lambda t=tree, b=ball: overlapping(t, b - 0.5 * EDGE, b + 0.5 * EDGE)
        calls["triangles, making the tree", n] = lambda lo=low, hi=high: box_tree(lo, hi)
    seconds = least(calls, repeats)
    rows = [{"search": name, "bodies": n, "ns_each": s / n * 1e9} for (name, n), s in seconds.items()]
    table = pd.DataFrame(rows).sort_values(["search", "bodies"])
    table["pairs_each"] = [
        len(calls[row.search, row.bodies]()) / row.bodies if row.search.startswith("cubes") else np.nan
        for row in table.itertuples()
    ]
    powers = table.groupby("search").apply(
        lambda own: exponent(own["bodies"], own["bodies"] * own["ns_each"]), include_groups=False
    )
    return table.assign(exponent=table["search"].map(powers))


def lists(path: Path, repeats: int) -> pd.DataFrame:
    """Cells against neighbour lists on the atoms of a protein."""
    x = np.ascontiguousarray(pc.load(path).positions)
    blocks = -(-len(x) // 32)
    none = native.partners(np.empty((0, 2), np.int64), len(x))
    alone, apart = np.full((len(x), 1), -1), np.full(blocks, -1)
    calls: dict[object, Callable[[], object]] = {}
    for distance in DISTANCES:
        near, radius = distance - native.SKIN, np.full(len(x), 0.5 * distance)
        calls["cells", distance] = lambda r=radius: touching(x, r)
        calls["lists", distance] = lambda d=near: (
            native.make_lists(x, d, np.full(blocks, d), 0.0, d, none, alone, apart).close
        )
    seconds = least(calls, repeats)
    rows = []
    for distance in DISTANCES:
        found, listed = (calls[way, distance]() for way in ("cells", "lists"))
        listed = listed[np.lexsort(listed.T[::-1])]
        times = {way: seconds[way, distance] for way in ("cells", "lists")}
        rows.append({
            "structure": path.stem, "atoms": len(x), "distance_nm": distance, "pairs": len(found),
            "same": bool(np.array_equal(found, listed)), "cells_ms": 1e3 * times["cells"],
            "lists_ms": 1e3 * times["lists"], "ratio": times["lists"] / times["cells"],
        })  # fmt: skip
    return pd.DataFrame(rows)


def parser() -> argparse.ArgumentParser:
    own = made.parser(__doc__)
    own.add_argument(
        "structures", nargs="*", type=Path, default=[SAMPLES / f"{n}.pdb" for n in ("1ubq", "1hel")]
    )
    return own


def main() -> None:
    options = parser().parse_args()
    repeats = 3 if options.quick else REPEATS
    found = scaling(SIZES[:2] if options.quick else SIZES, repeats)
    beside = pd.concat([lists(path, repeats) for path in options.structures[: 1 if options.quick else None]])
    for table in (found, beside):
        print(table.to_string(index=False, float_format=lambda value: f"{value:.3g}"))
    if options.output:
        made.write(found, options.output / "search.csv")
        made.write(beside, options.output / "search_lists.csv", options.structures)


if __name__ == "__main__":
    main()
