"""Throughput of a batch with one worker and with two, and the client's memory.

    python analysis/benchmarks/batch.py -o DIR [--workers 1,2] [--structures N] [--method M] [--more DIR]

The set: all models of an NMR ensemble (with --more FOLDER), perturbed copies of samples, one file in ten
broken. Rates are from when all workers have started to the last row written.
Per structure it measures what a plan for many needs: seconds and bytes of each kind of output.
"""

import argparse
import shutil
from pathlib import Path

import numpy as np
import psutil

import protochain as pc

SAMPLES = Path(__file__).parents[2] / "structures"
COPIED = ("1l2y", "ala10", "1vii", "3i40", "1ejg", "4pti")
ENSEMBLE = "2k39_ubiquitin_nmr15.pdb"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--workers", default="1,2")
    parser.add_argument("--structures", type=int, default=100)
    parser.add_argument("--method", default="lbfgs")
    parser.add_argument("--more", type=Path, help="folder of further structures")
    options = parser.parse_args()
    inputs = options.output / "inputs"
    write_inputs(inputs, options.structures, options.more)
    rates = {}
    for workers in [int(n) for n in options.workers.split(",")]:
        folder = options.output / f"workers{workers}"
        shutil.rmtree(folder, ignore_errors=True)
        seen: list[tuple[int, float, float, int]] = []

        def watch(p, seen=seen) -> None:
            seen.append((p.done, p.seconds, psutil.Process().memory_info().rss / 2**20, p.failed))

        done = pc.batch(inputs, folder, options.method, workers=workers, model="all", watch=watch)
        # The first rows of each worker come after it has started its child.
        first = next(k for k, (n, *_) in enumerate(seen) if n >= 2 * workers)
        (n0, t0, m0, _), (n1, t1, m1, failed) = seen[first], seen[-1]
        rates[workers] = (n1 - n0) / (t1 - t0)
        print(
            f"{workers} workers: {n1} structures, {failed} without a result ({done.counts()}), "
            f"{rates[workers]:.2f} a second, {t1:.1f} s with the start; "
            f"client {m0:.0f} MB after {n0}, {m1:.0f} MB after {n1}",
            flush=True,
        )
    fewest, most = min(rates), max(rates)
    print(f"\n{most} workers against {fewest}: {rates[most] / rates[fewest]:.2f}x")
    show_costs(done)


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


def show_costs(done: pc.Batch) -> None:
    """Print what a structure costs, for plans."""
    folder, table = done.folder, done.table
    good = table[table["output"].notna()]
    structures = table["structure"].nunique()

    def kilobytes(paths) -> float:
        return sum(path.stat().st_size for path in paths) / structures / 1024

    print("\n| of each structure, mean | |")
    print("|---|--:|")
    print(f"| residues | {good['n_residues'].mean():.0f} |")
    print(f"| seconds of preparation | {good['seconds_preparation'].mean():.2f} |")
    print(f"| seconds of minimisation | {good['seconds'].mean():.2f} |")
    print(f"| KB of summary.csv | {kilobytes([folder / 'summary.csv']):.2f} |")
    print(f"| KB of traces.csv | {kilobytes([folder / 'traces.csv']):.2f} |")
    print(f"| KB of structure | {kilobytes(folder.glob('*.pdb')):.1f} |")
    print(f"| KB of page | {kilobytes((folder / 'pages').glob('*.html')):.1f} |")


if __name__ == "__main__":
    main()
