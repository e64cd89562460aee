"""AlphaFold's relaxation of one model, as published, in a process of its own; called by relax.py.

    python analysis/benchmarks/relax_openmm.py IN OUT [--threads 2] [--rounds 3]

As alphafold/relax in AlphaFold 2 (Jumper et al., Nature 596:583, 2021; settings of run_alphafold.py): heavy
atoms of amino acids alone; PDBFixer (nonstandard residues, heterogens, missing atoms, hydrogens at pH 7);
amber99sb in vacuum without cutoff, bonds to hydrogen constrained; E = k/2 r^2, k = 10 kcal/mol/angstrom^2, on
heavy atoms; L-BFGS to 2.39 kcal/mol/nm (10 kJ/mol/nm); while violations are left, rounds of the same from the
last result, hydrogens anew, the residues concerned without springs.

One line of JSON tells the rounds, the seconds of counting violations, which a caller may subtract (protochain
counts them, for AlphaFold's own counter needs jax), and those of cleaning the last result once more, which is
as published, and of no use. Checks and logging are left out.
"""

import argparse
import io
import json
from pathlib import Path
from time import perf_counter

import gemmi
import openmm
import pdbfixer
from openmm import app, unit

STIFFNESS = 10.0 * unit.kilocalories_per_mole / unit.angstrom**2
TOLERANCE = 2.39 * unit.kilocalories_per_mole / unit.nanometer


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("input", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    print(json.dumps(relaxed(options.input, options.output, options.threads, options.rounds)))


def relaxed(path: Path, output: Path, threads: int, most: int = 3) -> dict[str, float]:
    """Relax a model in rounds; what the line of JSON tells."""
    cleaned = clean(heavy_atoms(path))
    free: set[int] = set()
    wrong: set[int] = set()
    rounds, counting, cleaning = 0, 0.0, 0.0
    while not rounds or (wrong and rounds < most):
        rounds += 1
        text = minimised(cleaned, free, threads)
        output.write_text(text)
        began = perf_counter()
        cleaned = clean(heavy_atoms(output))
        cleaning = perf_counter() - began
        began = perf_counter()
        wrong = violating(output)
        counting += perf_counter() - began
        free |= wrong
    told = {"rounds": rounds, "violations": len(wrong)}
    return told | {"seconds_counting": counting, "seconds_last_cleaning": cleaning}


def heavy_atoms(path: Path) -> str:
    """PDB text of the amino acids' heavy atoms, first model and first alternates."""
    structure = gemmi.read_structure(str(path))
    structure.setup_entities()
    del structure[1:]
    structure.remove_alternative_conformations()
    structure.remove_ligands_and_waters()
    structure.remove_hydrogens()
    structure.remove_empty_chains()
    structure.shorten_chain_names()
    return structure.make_pdb_string(gemmi.PdbWriteOptions(minimal=True))


def clean(text: str) -> str:
    """PDB text with the atoms that are missing, as cleanup.py does it."""
    fixer = pdbfixer.PDBFixer(pdbfile=io.StringIO(text), platform=openmm.Platform.getPlatform("CPU"))
    fixer.findNonstandardResidues()
    fixer.replaceNonstandardResidues()
    fixer.removeHeterogens(keepWater=False)
    fixer.findMissingResidues()
    fixer.findMissingAtoms()
    fixer.addMissingAtoms(seed=0)
    fixer.addMissingHydrogens()
    fixed = io.StringIO()
    app.PDBFile.writeFile(fixer.topology, fixer.positions, fixed, keepIds=True)
    fixed.seek(0)
    # A chain of one residue has no template.
    read = app.PDBFile(fixed)
    alone = [chain for chain in read.topology.chains() if len(list(chain.residues())) == 1]
    modeller = app.Modeller(read.topology, read.positions)
    modeller.delete(alone)
    return written(modeller.topology, modeller.positions)


def minimised(text: str, free: set[int], threads: int) -> str:
    """PDB text after one restrained minimisation; residues in ``free`` have no springs."""
    read = app.PDBFile(io.StringIO(text))
    system = app.ForceField("amber99sb.xml").createSystem(read.topology, constraints=app.HBonds)
    springs = openmm.CustomExternalForce("0.5 * k * ((x-x0)^2 + (y-y0)^2 + (z-z0)^2)")
    springs.addGlobalParameter("k", STIFFNESS)
    for name in ("x0", "y0", "z0"):
        springs.addPerParticleParameter(name)
    for i, atom in enumerate(read.topology.atoms()):
        if atom.residue.index not in free and atom.element.symbol != "H":
            springs.addParticle(i, read.positions[i])
    system.addForce(springs)
    platform = openmm.Platform.getPlatform("CPU")
    simulation = app.Simulation(
        read.topology, system, openmm.LangevinIntegrator(0, 0.01, 0.0), platform, {"Threads": str(threads)}
    )
    simulation.context.setPositions(read.positions)
    simulation.minimizeEnergy(maxIterations=0, tolerance=TOLERANCE)
    return written(simulation.topology, simulation.context.getState(positions=True).getPositions())


def written(topology: app.Topology, positions: unit.Quantity) -> str:
    text = io.StringIO()
    app.PDBFile.writeFile(topology, positions, text)
    return text.getvalue()


def violating(path: Path) -> set[int]:
    """Indices of the residues with violations."""
    import protochain as pc
    from protochain.validation import violations

    return set(violations(pc.load(path)).residues.tolist())


if __name__ == "__main__":
    main()
