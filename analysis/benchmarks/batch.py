"""Throughput of a batch with one worker and with two, and the client's memory.

    python analysis/benchmarks/batch.py [-o DIR] [--quick] [--workers 1,2] [--structures N] [--method M]
                                        [--more FOLDER]

The set: all models of an NMR ensemble (2k39_ubiquitin_nmr15.pdb of --more), perturbed copies of samples, one
file in ten broken. Rates are from when all workers have started to the last row written.
Per structure it measures what a plan for many needs: seconds and bytes of each kind of output.
"""

import argparse
import shutil
import tempfile
from pathlib import Path

import made
import numpy as np
import pandas as pd
import psutil
from made import SAMPLES

import protochain as pc

COPIED = ("1l2y", "ala10", "1vii", "3i40", "1ejg", "4pti")
ENSEMBLE = "2k39_ubiquitin_nmr15.pdb"


def parser() -> argparse.ArgumentParser:
    own = made.parser(__doc__, more=True)
    own.add_argument("--workers", default="1,2")
    own.add_argument("--structures", type=int, default=100)
    own.add_argument("--method", default="lbfgs")
    return own


def main() -> None:
    options = parser().parse_args()
    numbers = [int(n) for n in options.workers.split(",")]
    with tempfile.TemporaryDirectory() as scratch:
        inputs = Path(scratch) / "inputs"
        if options.quick:
            write_inputs(inputs, 20, None)
        else:
            write_inputs(inputs, options.structures, options.more)
        rates, costs = measured(inputs, numbers, options.method)
    print(f"\n{rates.to_string(index=False)}\n\n{costs.T.to_string(header=False)}")
    if options.output:
        for name, table in (("batch", rates), ("batch_costs", costs)):
            of = [*(f"{name}.pdb" for name in COPIED), *([] if options.quick else [ENSEMBLE])]
            made.write(table, options.output / f"{name}.csv", of, max(numbers))


def measured(inputs: Path, numbers: list[int], method: str) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Rate and memory by number of workers, and what a structure costs."""
    rows = []
    for workers in numbers:
        folder = inputs.with_name(f"workers{workers}")
        seen: list[tuple[int, float, float, int]] = []

        def watch(p, seen=seen) -> None:
            seen.append((p.done, p.seconds, psutil.Process().memory_info().rss / 2**20, p.failed))

        done = pc.batch(inputs, folder, method, workers=workers, model="all", watch=watch)
        # The first rows of each worker come after it has started its child.
        first = next(k for k, (n, *_) in enumerate(seen) if n >= 2 * workers)
        (n0, t0, m0, _), (n1, t1, m1, failed) = seen[first], seen[-1]
        rows.append(
            {
                "workers": workers, "structures": n1, "without_result": failed,
                "converged": done.counts().get("converged", 0), "a_second": (n1 - n0) / (t1 - t0),
                "seconds_with_start": t1, "client_mb_first": m0, "client_mb_last": m1,
            }
        )  # fmt: skip
        print(*(f"{key} {value:.4g}" for key, value in rows[-1].items()), sep=", ", flush=True)
    table = pd.DataFrame(rows)
    return table.assign(ratio=table["a_second"] / table["a_second"].iloc[0]), costs_of(done)


def write_inputs(folder: Path, n: int, more: Path | None) -> None:
    """Write the set, the same for the same n."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    random = np.random.default_rng(0)
    samples = [pc.load(SAMPLES / f"{name}.pdb") for name in COPIED]
    ensemble = more / ENSEMBLE if more else None
    left = n
    if ensemble and ensemble.exists():
        shutil.copy(ensemble, folder / ensemble.name)
        left -= 15
    for k in range(n // 10):
        broken = ("", "ATOM   nonsense\n", "ATOM      1  CA  GLY A   1       1.0 x 1.0\nEND\n", "\x00\x01")
        (folder / f"broken{k}.pdb").write_text(broken[k % 4])
    for k in range(left - n // 10):
        s = samples[k % len(samples)]
        x = s.positions + random.normal(scale=0.003, size=s.positions.shape)
        pc.save(s.with_positions(x), folder / f"{s.name}-copy{k:05}.pdb")


def costs_of(done: pc.Batch) -> pd.DataFrame:
    """What a structure costs in the mean, for plans: one row."""
    folder, table = done.folder, done.table
    good = table[table["output"].notna()]
    structures = table["structure"].nunique()

    def kilobytes(paths) -> float:
        return sum(path.stat().st_size for path in paths) / structures / 1024

    row = {
        "structures": structures, "residues": good["n_residues"].mean(),
        "seconds_preparation": good["seconds_preparation"].mean(), "seconds": good["seconds"].mean(),
        "kb_summary": kilobytes([folder / "summary.csv"]), "kb_traces": kilobytes([folder / "traces.csv"]),
        "kb_structure": kilobytes(folder.glob("*.pdb")),
        "kb_page": kilobytes((folder / "pages").glob("*.html")),
    }  # fmt: skip
    return pd.DataFrame([row])


if __name__ == "__main__":
    main()
