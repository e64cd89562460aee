"""What a device gains: evaluations, minimise, relax and frames by device, OpenMM's own minimiser beside them.

    python device.py [FILE ...] [-o DIR] [--quick]

For each structure (some samples by default) and each device that OpenMM has here, the processor first:
seconds to make the context, ms of an evaluation, by how much its forces differ from the native engine's,
seconds and energy of minimise and relax, seconds a frame of an ensemble (the start with noise of 0.005 nm);
on CUDA and HIP also OpenMM's minimiser with its context, to the same tolerance. One CSV, device.csv. It needs
nothing but an installed protochain: on a machine with a GPU, a wheel and this file are enough.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np
import openmm
import pandas as pd

import protochain as pc
from protochain.energies import devices

SAMPLES = Path(__file__).parents[2] / "structures"
FILES = ("1l2y.pdb", "1ubq.pdb")
NOISE = 0.005
"""nm."""


def seconds_of(call: Any) -> tuple[float, Any]:
    """Seconds of a call, and what it returns."""
    began = perf_counter()
    made = call()
    return perf_counter() - began, made


def row(s: pc.Structure, device: str, n_frames: int) -> dict[str, Any]:
    """Row of a structure on a device."""
    x = s.positions
    exact = pc.energy(s, device="cpu")
    energy = pc.energy(s, device=device)
    context, (_, forces) = seconds_of(lambda: energy(x))
    evaluation = median(seconds_of(lambda: energy(x))[0] for _ in range(10))
    off = np.sqrt(((forces - exact.exact(x)[1]) ** 2).sum(axis=1).mean())
    minimise, least = seconds_of(lambda: pc.minimise(s, pc.energy(s, device=device)))
    relax, relaxed = seconds_of(lambda: pc.relax(s, device=device))
    noise = np.random.default_rng(0).normal(0.0, NOISE, (n_frames, *x.shape))
    frames, done = seconds_of(lambda: [*pc.relax_frames(s, x + noise, device=device)])
    return {
        "structure": s.name, "atoms": s.n_atoms, "device": device, "by": energy.reason.split(";")[0],
        "context_s": max(0.0, context - evaluation), "evaluation_ms": 1e3 * evaluation,
        "rms_force_off_kj_mol_nm": off, "minimise_s": minimise, "evaluations": least.n_evaluations,
        "status": str(least.status), "energy_kj_mol": least.end.energy, "relax_s": relax,
        "relaxed_kj_mol": relaxed.energy_end, "frame_s": frames / n_frames,
        "frames_done": sum(each.structure is not None for each in done),
    }  # fmt: skip


def openmms(s: pc.Structure, device: str) -> dict[str, Any]:
    """Row of OpenMM's own minimiser on a device, which ends the process by OpenCL on a processor."""
    energy, tolerance = pc.energy(s, device="cpu"), 5.0 * np.sqrt(3.0)
    platform = openmm.Platform.getPlatform(device.upper())

    def run() -> Any:
        integrator = openmm.VerletIntegrator(0.001)
        context = openmm.Context(energy.system, integrator, platform, {"Precision": "mixed"})
        context.setPositions(s.positions)
        openmm.LocalEnergyMinimizer.minimize(context, tolerance)
        return np.asarray(context.getState(positions=True).getPositions(asNumpy=True) / openmm.unit.nanometer)

    seconds, x = seconds_of(run)
    return {
        "structure": s.name, "atoms": s.n_atoms, "device": device, "by": "OpenMM's minimiser alone",
        "minimise_s": seconds, "energy_kj_mol": energy.exact(x)[0],
    }  # fmt: skip


def rows(files: list[Path], n_frames: int) -> Iterator[dict[str, Any]]:
    """Rows of all structures."""
    there = [each.split(":")[0] for each in devices() if ": none" not in each]
    for file in files:
        s = pc.load(file)
        for device in ("cpu", *there):
            yield row(s, device, n_frames)
            if device in ("cuda", "hip"):
                yield openmms(s, device)


def parser() -> argparse.ArgumentParser:
    """The parser of the command line."""
    own = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    own.add_argument("files", nargs="*", type=Path, metavar="FILE", help="structures")
    own.add_argument("-o", "--output", type=Path, metavar="DIR", help="folder for its table")
    own.add_argument("--quick", action="store_true", help="small inputs: shows that it works, no more")
    return own


def main() -> None:
    options = parser().parse_args()
    print("\n".join(devices()))
    files = options.files or [SAMPLES / name for name in FILES[: 1 if options.quick else None]]
    pc.minimise(pc.from_sequence("GAG"))  # Compiles what all need.
    table = pd.DataFrame(rows(files, 2 if options.quick else 10))
    print(table.to_string())
    if options.output:
        try:
            from made import write
        except ModuleNotFoundError:  # Away from its folder.
            options.output.mkdir(parents=True, exist_ok=True)
            table.to_csv(options.output / "device.csv", index=False)
        else:
            write(table, options.output / "device.csv", files)


if __name__ == "__main__":
    sys.exit(main())
