"""ff14SB by OpenMM alone, its forces and its minimiser; race.py calls it as a process of its own.

    python analysis/benchmarks/race_openmm.py IN.pdb OUT.pdb [--tolerance 10] [--threads 2] [--force gbsa]

IN has all hydrogens. Forces are those of GB: "obc2" and "gbn2" are CustomGBForces, as OpenMM's force field
builds them, "gbsa" is OBC2 by its quicker GBSAOBCForce, "vacuum" none.
"""

import argparse
from functools import cache
from pathlib import Path

import openmm
from openmm import app, unit


@cache
def force_field(*files: str) -> app.ForceField:
    """Force field of files, which are read once."""
    return app.ForceField(*files)


def system(topology: app.Topology, solvent: str | None, cutoff: float | None = None) -> openmm.System:
    """Return ff14SB with a solvent, as OpenMM's force field builds it."""
    files = ["amber14/protein.ff14SB.xml", *([f"implicit/{solvent}.xml"] if solvent else [])]
    method = {"nonbondedMethod": app.NoCutoff}
    if cutoff:
        method = {"nonbondedMethod": app.CutoffNonPeriodic, "nonbondedCutoff": cutoff * unit.nanometer}
    return force_field(*files).createSystem(topology, **method)


def with_gbsa_obc(topology: app.Topology) -> openmm.System:
    """Return ff14SB in OBC2 by OpenMM's own force, with the radii of its implicit files."""
    built = system(topology, "obc2")
    ((place, of),) = (
        (i, each) for i, each in enumerate(built.getForces()) if isinstance(each, openmm.CustomGBForce)
    )
    force = openmm.GBSAOBCForce()
    for i in range(of.getNumParticles()):
        charge, offset_radius, scaled_radius = of.getParticleParameters(i)
        force.addParticle(charge, offset_radius + 0.009, scaled_radius / offset_radius)
    built.removeForce(place)
    built.addForce(force)
    return built


def built(topology: app.Topology, force: str) -> openmm.System:
    """System of a force of these names."""
    return (
        with_gbsa_obc(topology) if force == "gbsa" else system(topology, {"vacuum": None}.get(force, force))
    )


def gb_class(built: openmm.System) -> str:
    """Name of the class of OpenMM's that is the solvent."""
    names = [type(force).__name__ for force in built.getForces()]
    return next((name for name in names if "GB" in name), "none")


def context(built: openmm.System, threads: int) -> openmm.Context:
    """A context of the CPU platform."""
    platform = openmm.Platform.getPlatform("CPU")
    return openmm.Context(built, openmm.VerletIntegrator(0.001), platform, {"Threads": str(threads)})


def main() -> None:
    own = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )  # fmt: skip
    own.add_argument("input", type=Path)
    own.add_argument("output", type=Path)
    own.add_argument("--tolerance", type=float, default=10.0)
    own.add_argument("--threads", type=int, default=2)
    own.add_argument("--force", default="gbsa")
    options = own.parse_args()
    read = app.PDBFile(str(options.input))
    run = context(built(read.topology, options.force), options.threads)
    run.setPositions(read.positions)
    openmm.LocalEnergyMinimizer.minimize(run, options.tolerance)
    with options.output.open("w") as out:
        app.PDBFile.writeFile(read.topology, run.getState(positions=True).getPositions(), out)


if __name__ == "__main__":
    main()
