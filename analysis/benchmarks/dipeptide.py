"""Free energy of alanine dipeptide in phi and psi: rigid geometry against OpenMM's flexible reference.

    python analysis/benchmarks/dipeptide.py STRUCTURE [-o DIR] [--ns NS] [--trajectories N]

STRUCTURE is ACE-ALA-NME. Three surfaces at 300 K in OBC2: hybrid Monte Carlo of rigid bodies with Fixman's
potential; the same by quadrature of the Boltzmann factor, which it must agree with; and Langevin dynamics of
all atoms by OpenMM (bonds of hydrogens constrained, 2 fs). Prints how far they differ, and the populations of
basins.
"""

import argparse
from pathlib import Path

import gemmi
import matplotlib.pyplot as plt
import numpy as np
import openmm
from openmm import unit
from scipy import constants

import protochain as pc
from protochain.energies import constrain_hydrogens

KT = 300.0 * constants.R / 1000.0
BINS = 24
EDGES = np.linspace(-180.0, 180.0, BINS + 1)
BASINS = {
    "beta, PII (phi < 0, psi > 60 or < -150)": lambda phi, psi: (phi < 0) & ((psi > 60) | (psi < -150)),
    "alpha R (phi < 0, -150 < psi < 60)": lambda phi, psi: (phi < 0) & (psi <= 60) & (psi >= -150),
    "phi > 0": lambda phi, psi: phi >= 0,
}


def quadrature(chain: pc.Chain, energy, n: int = 72) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights on a grid of phi and psi, degrees."""
    angles = -180.0 + 360.0 * (np.arange(n) + 0.5) / n
    values = np.array([[energy(pc.pose(chain, np.deg2rad([a, b])).x)[0] for b in angles] for a in angles])
    phi, psi = np.meshgrid(angles, angles, indexing="ij")
    return phi.ravel(), psi.ravel(), np.exp(-(values - values.min()) / KT).ravel()


def dihedrals(chain: pc.Chain, x: np.ndarray) -> list[float]:
    """Phi and psi at positions x, rad."""
    return [gemmi.calculate_dihedral(*(gemmi.Position(*x[i]) for i in h.atoms)) for h in chain.hinges]


def rigid(chain: pc.Chain, energy, n: int) -> np.ndarray:
    """Sample phi and psi by hybrid Monte Carlo, degrees."""
    seen = []

    def watch(row, x):
        seen.append(dihedrals(chain, x))

    m = pc.simulate(
        chain, energy, time_step=0.012, n_steps=40 * n, thermostat="hmc", trajectory_length=40, every=40,
        fixman=True, seed=1, watch=watch,
    )  # fmt: skip
    print(f"hybrid Monte Carlo: {n} trajectories of 40 steps of 12 fs, {100 * m.accepted:.1f} % kept")
    return np.rad2deg(np.array(seen[1:]))


def flexible(chain: pc.Chain, energy, ns: float) -> np.ndarray:
    """Sample phi and psi by OpenMM, degrees, one every 0.2 ps."""
    system = openmm.XmlSerializer.clone(energy.system)
    constrain_hydrogens(system)
    integrator = openmm.LangevinMiddleIntegrator(300, 1, 0.002)
    integrator.setRandomNumberSeed(1)
    platform = openmm.Platform.getPlatform("CPU")
    context = openmm.Context(system, integrator, platform, {"Threads": "1"})
    context.setPositions(chain.structure.positions)
    openmm.LocalEnergyMinimizer.minimize(context)
    context.setVelocitiesToTemperature(300 * unit.kelvin, 1)
    integrator.step(5000)
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


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("structure", type=Path)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--ns", type=float, default=20.0)
    parser.add_argument("--trajectories", type=int, default=20_000)
    options = parser.parse_args()
    structure = pc.load(options.structure)
    energy = pc.energy(structure, threads=1)
    # Rigid geometry is the force field's own: that of a minimum of all atoms.
    structure = pc.minimise(structure, energy, "cartesian", 0.1).structure
    chain = pc.build_chain(structure, "phi psi")
    phi, psi, weights = quadrature(chain, energy)
    hmc, md = rigid(chain, energy, options.trajectories), flexible(chain, energy, options.ns)
    named = {
        "rigid, quadrature": (phi, psi, weights),
        "rigid, hybrid Monte Carlo": (*hmc.T, np.ones(len(hmc))),
        f"flexible, OpenMM {options.ns:g} ns": (*md.T, np.ones(len(md))),
    }
    print("\n| basin | " + " | ".join(named) + " |\n|---" + "|--:" * len(named) + "|")
    for basin, inside in BASINS.items():
        shares = [100 * np.sum(w[inside(a, b)]) / np.sum(w) for a, b, w in named.values()]
        print(f"| {basin} | " + " | ".join(f"{share:.1f} %" for share in shares) + " |")
    surfaces = {name: surface(*parts) for name, parts in named.items()}
    exact = surfaces["rigid, quadrature"]
    for name, other in surfaces.items():
        low = (exact < 10.0) & np.isfinite(other)
        offset = np.mean(other[low] - exact[low])
        difference = other[low] - exact[low] - offset
        print(
            f"{name}: root mean square difference to rigid quadrature where that is below 10 kJ/mol: "
            f"{np.sqrt(np.mean(difference**2)):.2f} kJ/mol"
        )
    if options.output:
        options.output.mkdir(parents=True, exist_ok=True)
        figure, axes = plt.subplots(1, 3, figsize=(11, 3.6), layout="constrained", sharey=True)
        for axis, (name, values) in zip(axes, surfaces.items(), strict=True):
            shown = axis.pcolormesh(EDGES, EDGES, values.T, vmin=0.0, vmax=25.0, cmap="cividis")
            axis.set(title=name, xlabel="phi, degrees", aspect="equal")
        axes[0].set_ylabel("psi, degrees")
        figure.colorbar(shown, ax=axes, label="free energy, kJ/mol")
        figure.savefig(options.output / "dipeptide.png", dpi=150)


if __name__ == "__main__":
    main()
