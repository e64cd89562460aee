"""Free energy of alanine dipeptide in phi and psi: rigid geometry against OpenMM's flexible reference.

    python analysis/benchmarks/dipeptide.py [-o DIR] [--quick] [--seeds N] [--trajectories N] [--ns NS]
                                            [--kept FOLDER]

ACE-ALA-NME at 300 K in OBC2: hybrid Monte Carlo of rigid bodies with Fixman's potential; what
it must agree with, by quadrature (and, for the size of it, what a term left out or of the wrong sign would
give); and Langevin dynamics of all atoms by OpenMM (bonds of hydrogens constrained, 2 fs). Both are run from
several seeds. A sampled share comes with its standard error, the larger of two: by blocks that grow until
neighbours no longer know of each other, and by the spread of the seeds; and with how many errors it is away
from quadrature. Runs that are in a folder (--kept) are not repeated.
"""

import argparse
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import gemmi
import made
import numpy as np
import openmm
import pandas as pd
from openmm import unit
from scipy import constants

import protochain as pc
from protochain.energies import constrain_hydrogens

KT = 300.0 * constants.R / 1000.0
BINS = 24
EDGES = np.linspace(-180.0, 180.0, BINS + 1)
BASINS: dict[str, Callable] = {
    "beta, PII (phi < 0, psi > 60 or < -150)": lambda phi, psi: (phi < 0) & ((psi > 60) | (psi < -150)),
    "alpha R (phi < 0, -150 < psi < 60)": lambda phi, psi: (phi < 0) & (psi <= 60) & (psi >= -150),
    "phi > 0": lambda phi, psi: phi >= 0,
}
WARM_UP = 0.02
"""Share of a run that is left out: all runs begin at one minimum."""
FEWEST_BLOCKS = 32
"""The error of an error from n blocks is 1 / sqrt(2 n) of it: 12 %."""


def molecule() -> pc.Structure:
    """ACE-ALA-NME: trialanine whose first and last residues are cut down to caps."""
    names = {("1", "CA"): "CH3", ("1", "C"): "C", ("1", "O"): "O", ("3", "N"): "N", ("3", "CA"): "CH3"}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "dipeptide.pdb"
        pc.save(pc.from_sequence("AAA"), path)
        lines = []
        for line in path.read_text().splitlines():
            if line[:4] != "ATOM" or line[76:78] == " H" or line[12:16].strip() == "OXT":
                continue
            number, name = line[22:26].strip(), line[12:16].strip()
            if number != "2" and (number, name) not in names:
                continue
            residue = {"1": "ACE", "2": "ALA", "3": "NME"}[number]
            shown = name if number == "2" else names[number, name]
            lines.append(f"{line[:12]} {shown:<3} {residue}{line[20:]}")
        path.write_text("\n".join([*lines, "END\n"]))
        return pc.load(path)


def quadrature(chain: pc.Chain, energy, n: int = 72) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Phi and psi of a grid, degrees, Boltzmann's factors there, and det M relative to its largest."""
    free = pc.build_chain(chain.structure, chain.opened, "free")
    angles = -180.0 + 360.0 * (np.arange(n) + 0.5) / n
    values, log_det = np.empty((n, n)), np.empty((n, n))
    for i, a in enumerate(np.deg2rad(angles)):
        for j, b in enumerate(np.deg2rad(angles)):
            values[i, j] = energy(pc.pose(chain, np.array([a, b])).x)[0]
            log_det[i, j] = pc.log_det_mass(free, pc.pose(free, np.append(free.q0[:-2], [a, b])))
    phi, psi = np.meshgrid(angles, angles, indexing="ij")
    weights = np.exp(-(values - values.min()) / KT)
    return phi.ravel(), psi.ravel(), weights.ravel(), np.exp(log_det - log_det.max()).ravel()


def dihedrals(chain: pc.Chain, x: np.ndarray) -> list[float]:
    """Phi and psi at positions x, rad."""
    return [gemmi.calculate_dihedral(*(gemmi.Position(*x[i]) for i in h.atoms)) for h in chain.hinges]


def rigid(chain: pc.Chain, energy, n: int, seed: int) -> np.ndarray:
    """Sample phi and psi by hybrid Monte Carlo, degrees."""
    seen = []

    def watch(row, x):
        seen.append(dihedrals(chain, x))

    m = pc.simulate(
        chain, energy, time_step=0.012, n_steps=40 * n, thermostat="hmc", trajectory_length=40, every=40,
        fixman=True, seed=seed, watch=watch,
    )  # fmt: skip
    print(f"seed {seed}: {n} trajectories of 40 steps of 12 fs, {100 * m.accepted:.1f} % kept", flush=True)
    return np.rad2deg(np.array(seen[1:]))


def flexible(chain: pc.Chain, energy, ns: float, seed: int) -> np.ndarray:
    """Sample phi and psi by OpenMM, degrees, one every 0.2 ps."""
    system = openmm.XmlSerializer.clone(energy.system)
    constrain_hydrogens(system)
    integrator = openmm.LangevinMiddleIntegrator(300, 1, 0.002)
    integrator.setRandomNumberSeed(seed)
    platform = openmm.Platform.getPlatform("CPU")
    context = openmm.Context(system, integrator, platform, {"Threads": "1"})
    context.setPositions(chain.structure.positions)
    openmm.LocalEnergyMinimizer.minimize(context)
    context.setVelocitiesToTemperature(300 * unit.kelvin, seed)
    out = []
    for _ in range(round(5000 * ns)):
        integrator.step(100)
        x = context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(unit.nanometer)
        out.append(dihedrals(chain, x))
    return np.rad2deg(np.array(out))


def surface(phi, psi, weights=None) -> np.ndarray:
    """Free energy above its lowest bin, kJ/mol; infinite where nothing was."""
    density, _, _ = np.histogram2d(phi, psi, bins=EDGES, weights=weights)
    with np.errstate(divide="ignore"):
        return -KT * np.log(density / density.max())


def block_errors(series: np.ndarray) -> dict[int, float]:
    """Standard errors of the mean of a correlated series, by length of the blocks it is averaged over.

    They grow with the blocks until these are independent (Flyvbjerg, Petersen, J. Chem. Phys. 91:461, 1989).

    Parameters
    ----------
    series : (k, n) float
        Runs of equal length; no block extends over two of them.
    """
    runs, n = series.shape
    errors, length = {}, 1
    while runs * (n // length) >= FEWEST_BLOCKS and length <= n:
        blocks = series[:, : n - n % length].reshape(runs, -1, length).mean(axis=2).ravel()
        errors[length] = float(blocks.std(ddof=1) / np.sqrt(len(blocks)))
        length *= 2
    return errors


def standard_error(series: np.ndarray) -> tuple[float, float]:
    """Standard error of the mean of runs (k, n), and samples for each that counts (1: independent)."""
    errors = block_errors(series)
    error = max(errors.values())
    return error, (error / errors[1]) ** 2 if errors[1] > 0.0 else 1.0


def row(method: str, runs: list[np.ndarray], basin: str, exact: float) -> dict[str, object]:
    """What runs (n, 2) of phi and psi say of a basin, against a share known by quadrature."""
    kept = [run[round(WARM_UP * len(run)) :] for run in runs]
    inside = np.array([BASINS[basin](*run.T) for run in kept], dtype=float)
    by_blocks, each = standard_error(inside)
    shares = inside.mean(axis=1)
    by_seeds = float(shares.std(ddof=1) / np.sqrt(len(shares))) if len(shares) > 1 else 0.0
    error = max(by_blocks, by_seeds)
    return {
        "method": method, "basin": basin, "seeds": len(runs), "samples": inside.size,
        "share_percent": 100 * shares.mean(), "error_percent": 100 * error,
        "error_by_blocks_percent": 100 * by_blocks, "error_by_seeds_percent": 100 * by_seeds,
        "samples_per_independent_one": each, "lowest_seed_percent": 100 * shares.min(),
        "highest_seed_percent": 100 * shares.max(), "quadrature_percent": 100 * exact,
        "errors_from_quadrature": (shares.mean() - exact) / error if error > 0.0 else np.nan,
    }  # fmt: skip


Runs = dict[str, list[np.ndarray]]


def report(runs: Runs, exact: dict[tuple[str, str], float], known: tuple, output: Path | None) -> None:
    """Print shares of basins and distances of surfaces, and write them."""
    rows = [
        row(name, sampled, basin, exact["Fixman", basin])
        for name, sampled in runs.items()
        for basin in BASINS
    ]
    wanted = list(dict.fromkeys(name for name, _ in exact))
    print(
        "\n| basin | "
        + " | ".join(f"quadrature, {name}" for name in wanted)
        + " | "
        + " | ".join(runs)
        + " |"
    )
    print("|---" + "|--:" * (len(wanted) + len(runs)) + "|")
    for basin in BASINS:
        shares = [f"{100 * exact[name, basin]:.1f} %" for name in wanted]
        shares += [
            f"{r['share_percent']:.1f} +- {r['error_percent']:.1f} %" if r["share_percent"] else "not visited"
            for r in rows
            if r["basin"] == basin
        ]
        print(f"| {basin} | " + " | ".join(shares) + " |")
    table = pd.DataFrame(rows)
    for r in rows:
        print(
            f"{r['method']}, {r['basin']}: {r['errors_from_quadrature']:+.1f} errors from quadrature; error "
            f"by blocks {r['error_by_blocks_percent']:.1f} %, by seeds {r['error_by_seeds_percent']:.1f} %; "
            f"seeds {r['lowest_seed_percent']:.1f} to {r['highest_seed_percent']:.1f} %; "
            f"{r['samples_per_independent_one']:.0f} samples count as one"
        )
    surfaces = {"rigid, quadrature": surface(*known)}
    surfaces |= {name: surface(*np.concatenate(sampled).T) for name, sampled in runs.items()}
    exactly = surfaces["rigid, quadrature"]
    for name, other in surfaces.items():
        low = (exactly < 10.0) & np.isfinite(other)
        print(
            f"{name}: root mean square difference to quadrature where that is below 10 kJ/mol: "
            f"{np.std(other[low] - exactly[low]):.2f} kJ/mol"
        )
    if output:
        for name, basin in exact:
            table.loc[len(table)] = {"method": f"quadrature, {name}", "basin": basin} | {
                "share_percent": 100 * exact[name, basin]
            }
        made.write(table.round(3), output / "dipeptide.csv")


def parser() -> argparse.ArgumentParser:
    own = made.parser(__doc__)
    own.add_argument("--seeds", type=int, default=4)
    own.add_argument("--ns", type=float, default=2.0, help="of each run of OpenMM")
    own.add_argument("--trajectories", type=int, default=10_000, help="of each run of hybrid Monte Carlo")
    own.add_argument("--kept", type=Path, metavar="FOLDER", help="of runs, not to be repeated")
    return own


def main() -> None:
    options = parser().parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        study(options, options.kept or Path(scratch))


def study(options: argparse.Namespace, kept: Path) -> None:
    """Sample, compare and write; each run is kept in a folder."""
    if options.quick:
        options.seeds, options.ns, options.trajectories = 2, 0.05, 300
    structure = molecule()
    energy = pc.energy(structure, threads=1)
    # Rigid geometry is the force field's own: that of a minimum of all atoms.
    structure = pc.minimise(structure, energy, "cartesian", 0.1).structure
    chain = pc.build_chain(structure, "phi psi")
    phi, psi, weights, det = quadrature(chain, energy)
    wanted = {"Fixman": weights, "no Fixman": weights * np.sqrt(det), "wrong sign": weights * det}
    exact = {
        (name, basin): float(w[inside(phi, psi)].sum() / w.sum())
        for name, w in wanted.items()
        for basin, inside in BASINS.items()
    }
    seeds = range(1, options.seeds + 1)
    walks = {
        "rigid, Monte Carlo": partial(rigid, chain, energy, options.trajectories),
        "flexible, OpenMM": partial(flexible, chain, energy, options.ns),
    }
    runs = {
        name: [made.kept(kept / f"{name[:5]}-{seed}.npy", partial(walk, seed)) for seed in seeds]
        for name, walk in walks.items()
    }
    report(runs, exact, (phi, psi, weights), options.output)


if __name__ == "__main__":
    main()
