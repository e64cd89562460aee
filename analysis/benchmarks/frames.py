"""Every frame of ensembles relaxed by one command, beside AlphaFold's relaxation by OpenMM; memory by frames.

    python analysis/benchmarks/frames.py [STUDY ...] [--more FOLDER] [--frames 1000] [-o DIR] [--quick]

speed: an NMR ensemble of 15 models of ubiquitin (MORE), and frames of ubiquitin that `protochain simulate`
makes in torsions at 300 K, are relaxed by `protochain relax TOP --trajectory FRAMES` in two processes of one
thread. A sample of the same frames is relaxed by AlphaFold's protocol (relax_openmm.py) in two processes of
one thread, half before and half after ours; its seconds are those of the frames alone, without the start of
Python and without counting violations; with the start, as of a command a frame, in a column of its own. Ours
are those of the whole command.

memory: the sum of the peaks of all processes of a command, of a tenth and all of the frames relaxed, and of
energies of each tenth frame of twenty times as many.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from time import perf_counter

import made
import mdtraj
import numpy as np
import pandas as pd
from made import MORE, SAMPLES

import protochain as pc

NMR = "2k39_ubiquitin_nmr15.pdb"
MADE_OF = SAMPLES / "1ubq.pdb"
PROGRAM = shutil.which("protochain") or "protochain"
WORKERS = 2
EVERY = 10
"""Steps of the simulation between frames."""
_POLL = 0.1
"""s between looks at the memory of processes."""


@dataclass(frozen=True)
class Run:
    """A command: seconds of the wall and of the processors, peak of memory, and what it printed."""

    seconds: float
    cpu_seconds: float
    peak_mb: float
    told: dict


def run(*words: object) -> Run:
    """Run a command, and watch the memory of its processes."""
    began, before = perf_counter(), os.times()
    process = subprocess.Popen(
        [*map(str, words)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=made.surroundings()
    )
    peaks: dict[int, float] = {}
    over = threading.Event()

    def watch() -> None:
        while not over.wait(_POLL):
            peaks.update(_peaks(process.pid))

    watching = threading.Thread(target=watch)
    watching.start()
    out, err = process.communicate()
    over.set()
    watching.join()
    if process.returncode not in (0, 3):
        sys.exit(f"{words}: exit status {process.returncode}: {err[-500:]}")
    after = os.times()
    cpu = sum(after[k] - before[k] for k in (2, 3))
    return Run(perf_counter() - began, cpu, sum(peaks.values()), json.loads(out) if out[:1] == "{" else {})


def _peaks(pid: int) -> dict[int, float]:
    """Peak of the memory of a process and all below it, MB; nothing of those that have ended."""
    parent, found = dict[int, int](), dict[int, float]()
    for path in Path("/proc").glob("[0-9]*/status"):
        with suppress(OSError, ValueError, IndexError):
            words = path.read_text().split()
            parent[int(path.parent.name)] = int(words[words.index("PPid:") + 1])
            found[int(path.parent.name)] = float(words[words.index("VmHWM:") + 1]) / 1024
    mine = {pid}
    while more := {each for each, its in parent.items() if its in mine} - mine:
        mine |= more
    return {each: found[each] for each in mine & found.keys()}


@cache
def simulated(folder: Path, n: int) -> Path:
    """Frames of ubiquitin by torsional dynamics of this program."""
    run(
        PROGRAM, "simulate", MADE_OF, "-o", folder / "dynamics", "--steps", n * EVERY, "--every", EVERY,
        "--threads", WORKERS, "--keep", "none",
    )  # fmt: skip
    return next((folder / "dynamics").glob("*.dcd"))


def ensembles(options: argparse.Namespace, scratch: Path) -> dict[str, tuple[Path, Path]]:
    """Topology and frames of each ensemble."""
    nmr = options.more / NMR
    found = {"NMR, 15 models": (nmr, nmr)} if nmr.exists() and not options.quick else {}
    return found | {f"dynamics, {options.frames} frames": (MADE_OF, simulated(scratch, options.frames))}


def relax(top: Path, frames: Path, output: Path, chosen: str = "all") -> Run:
    return run(
        PROGRAM, "relax", top, "--trajectory", frames, "--frames", chosen, "-o", output, "--workers", WORKERS,
        "--keep", "none", "--json", "--force",
    )  # fmt: skip


def by_openmm(models: Sequence[Path]) -> np.ndarray:
    """Seconds, CPU seconds and residues left with violations of models, by two processes of one thread."""
    code = (
        "import json, sys, time; from pathlib import Path; import relax_openmm\n"
        "relax_openmm.violating(Path(sys.argv[1]))\n"  # loads kernels
        "seconds, cpu, left = 0.0, 0.0, 0\n"
        "for path in map(Path, sys.argv[1:]):\n"
        "    began, before = time.perf_counter(), time.process_time()\n"
        "    told = relax_openmm.relaxed(path, path.with_suffix('.end.pdb'), 1)\n"
        "    seconds += time.perf_counter() - began - told['seconds_counting']\n"
        "    cpu += time.process_time() - before - told['seconds_counting']\n"
        "    left += told['violations']\n"
        "print(json.dumps([seconds, cpu, left]))"
    )
    env = made.surroundings(PYTHONPATH=os.pathsep.join([str(Path(__file__).parent), *sys.path[1:]]))
    running = [
        subprocess.Popen([sys.executable, "-c", code, *map(str, own)], env=env, stdout=subprocess.PIPE)
        for own in (models[k::WORKERS] for k in range(WORKERS))
        if own
    ]
    told = [json.loads(each.communicate()[0]) for each in running]
    seconds, cpu, left = np.sum(told, axis=0) if told else (0.0, 0.0, 0.0)
    return np.array([seconds / max(1, len(told)), cpu, left])


def start_of_openmm() -> float:
    """Seconds that a command of its protocol takes before it begins."""
    env = made.surroundings(PYTHONPATH=str(Path(__file__).parent))
    began = perf_counter()
    subprocess.run([sys.executable, "-c", "import relax_openmm"], env=env, check=True)
    return perf_counter() - began


def speed(options: argparse.Namespace) -> pd.DataFrame:
    """Every frame relaxed, and a sample of them by OpenMM."""
    rows, start = [], start_of_openmm()
    with tempfile.TemporaryDirectory() as folder:
        scratch = Path(folder)
        for name, (top, frames) in ensembles(options, scratch).items():
            relax(top, frames, scratch / "first.dcd", ":1")  # compiles kernels on a new installation
            models = _models(top, frames, scratch, options.sample)
            half = len(models) // 2
            before = by_openmm(models[:half])
            ours = relax(top, frames, scratch / "ours.dcd")
            seconds, cpu, left = before + by_openmm(models[half:])
            table = pd.read_csv(scratch / "ours.csv")
            n, theirs, their_cpu = len(table), seconds / len(models), cpu / len(models)
            rows.append({"ensemble": name, "residues": pc.load(top, keep="none").n_residues, **_ends(table)})
            rows[-1] |= {
                "seconds_frame": ours.seconds / n, "cpu_seconds_frame": ours.cpu_seconds / n,
                "cores_busy": ours.cpu_seconds / ours.seconds / WORKERS,
                "seconds_frame_in_process": table["seconds"].median(), "sample_openmm": len(models),
                "residues_with_violations_openmm": int(left), "seconds_frame_openmm": theirs,
                "cpu_seconds_frame_openmm": their_cpu, "times_sooner": theirs / (ours.seconds / n),
                "times_less_cpu": their_cpu / (ours.cpu_seconds / n), "seconds_start_openmm": start,
                "times_sooner_than_commands": (theirs + start / WORKERS) / (ours.seconds / n),
            }  # fmt: skip
    return pd.DataFrame(rows).round(4)


def _ends(table: pd.DataFrame) -> dict[str, object]:
    """How frames ended, from their rows."""
    with_violations = {when: int((table[f"violations_{when}"] > 0).sum()) for when in ("start", "end")}
    return {
        "frames": len(table), "converged": int((table["status"] == "converged").sum()),
        **{f"frames_with_violations_{when}": n for when, n in with_violations.items()},
        **{f"overlaps_{when}": int(table[f"overlaps_{when}"].sum()) for when in ("start", "end")},
        "ca_rmsd_angstrom": table["ca_rmsd_angstrom"].median(), "evaluations": table["evaluations"].mean(),
    }  # fmt: skip


def _models(top: Path, frames: Path, scratch: Path, n: int) -> list[Path]:
    """Some of the frames, evenly spaced, as files."""
    made_of, paths = pc.load(top, keep="none"), []
    models = mdtraj.load(frames, top=None if top == frames else pc.to_mdtraj(made_of))
    for k in range(0, len(models), max(1, len(models) // n))[:n]:
        paths.append(scratch / f"{frames.stem}-{k}.pdb")
        models[k].save_pdb(paths[-1])
    return paths


def memory(options: argparse.Namespace) -> pd.DataFrame:
    """Peak of memory, by the number of frames."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        scratch = Path(folder)
        frames, n = simulated(scratch, options.frames), options.frames
        for chosen, count in ((f":{n // 10}", n // 10), ("all", n)):
            rows.append(("relax", count, relax(MADE_OF, frames, scratch / "o.dcd", chosen).peak_mb))
        long = _repeated(frames, scratch / "long.dcd", 20)
        for chosen, count in (("::50", 2 * n // 5), ("::10", 2 * n)):
            done = run(
                PROGRAM, "energy", MADE_OF, "--trajectory", long, "--frames", chosen, "-o", scratch / "e.csv",
                "--workers", WORKERS, "--keep", "none", "--json",
            )  # fmt: skip
            rows.append((f"energy, of {20 * n}", count, done.peak_mb))
    return pd.DataFrame(rows, columns=["command", "frames", "peak_mb"]).round(1)


def _repeated(frames: Path, output: Path, times: int) -> Path:
    """The same frames as often, one after the other."""
    opened = mdtraj.load(frames, top=pc.to_mdtraj(pc.load(MADE_OF, keep="none")))
    mdtraj.join([opened] * times).save_dcd(output)
    return output


STUDIES = {"speed": speed, "memory": memory}


def parser() -> argparse.ArgumentParser:
    own = made.parser(__doc__ or "", STUDIES, more=True)
    own.add_argument("--frames", type=int, default=200, help="of the ensemble made by dynamics")
    own.add_argument("--sample", type=int, default=10, help="frames that OpenMM relaxes")
    return own


def main() -> None:
    options = parser().parse_args()
    if options.quick:
        options.frames, options.sample = 10, 2
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:WORKERS])
    made.study(
        options,
        STUDIES,
        "frames",
        lambda name, table: [MADE_OF, *([MORE / NMR] * (name == "speed"))],
        WORKERS,
    )


if __name__ == "__main__":
    main()
