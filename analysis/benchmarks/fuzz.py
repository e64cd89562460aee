"""Damaged files and odd options: what is taken, what is refused in one line, and what is a fault.

    python analysis/benchmarks/fuzz.py [-o DIR] [--quick] [--files 10000] [--options 2000]
    python analysis/benchmarks/fuzz.py --first 1000 --files 3000 --options 500
    python analysis/benchmarks/fuzz.py --only "PDB, models" --seed 17

Cases are made by kind and seed (analysis/bench/files/damage.py), run in processes split off one that has
loaded all, and judged (analysis/bench/files/judge.py); a row a kind. The second form runs further cases, the
third one, and prints all of it.
"""

import argparse
import os
import shlex
from collections import Counter
from pathlib import Path

import made
import pandas as pd

from bench.files import damage, judge

FILES, OPTIONS = 10_000, 2000


def counted(ended: list[judge.Outcome]) -> pd.DataFrame:
    """A row a kind: how many, taken, refused, and at fault; the longest and the largest process."""
    rows = []
    for kind in dict.fromkeys(each.kind for each in ended):
        own = [each for each in ended if each.kind == kind]
        wrong = [each for each in own if each.faults]
        refused = sum(each.status == judge.REFUSED and not each.faults for each in own)
        what = Counter(fault.split(":")[0] for each in wrong for fault in each.faults)
        rows.append(
            {
                "kind": kind, "files": len(own), "taken": len(own) - refused - len(wrong),
                "refused": refused, "faults": len(wrong),
                "seconds": round(max(each.seconds for each in own), 1),
                "megabytes": round(max(each.megabytes for each in own)),
                "what": "; ".join(f"{n} {name}" for name, n in what.most_common()),
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


def told(each: judge.Outcome) -> str:
    words = shlex.join(word.encode("utf-8", "backslashreplace").decode() for word in each.words)
    return f"{each.kind} --seed {each.seed}: {', '.join(each.faults)}\n  {words}\n  {each.said[-600:]!r}"


def parser() -> argparse.ArgumentParser:
    own = made.parser(__doc__ or "")
    own.add_argument("--files", type=int, default=FILES, help="damaged files")
    own.add_argument("--options", type=int, default=OPTIONS, help="sets of options")
    own.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)), help="processes")
    kinds = [*damage.FILES, *damage.OPTIONS]
    own.add_argument("--only", nargs="+", metavar="KIND", choices=kinds, help="; ".join(kinds))
    own.add_argument("--first", type=int, default=0, metavar="SEED", help="of the cases of each kind; 0")
    own.add_argument("--seed", type=int, help="one case of each kind")
    return own


def main() -> None:
    given = parser().parse_args()
    n_files, n_options = (100, 40) if given.quick else (given.files, given.options)
    cases = judge.chosen(damage.FILES_BY_WEIGHT, n_files) + judge.chosen(damage.OPTIONS, n_options)
    cases = [(kind, given.first + seed) for kind, seed in cases]
    if given.only:
        cases = [case for case in cases if case[0] in given.only]
    if given.seed is not None:
        cases = [(kind, given.seed) for kind in dict.fromkeys(kind for kind, _ in cases)]
    ended = []
    for k, each in enumerate(judge.outcomes(cases, given.jobs)):
        ended.append(each)
        if each.faults or given.seed is not None:
            print(told(each), flush=True)
        if k % 100 == 99:
            print(f"{k + 1} of {len(cases)}", flush=True)
    table = counted(ended)
    print(table.to_string())
    if given.output:
        made.write(table, Path(given.output) / "fuzz.csv", ["kinds of analysis/bench/files/damage.py"])


if __name__ == "__main__":
    main()
