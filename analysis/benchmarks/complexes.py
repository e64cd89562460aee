"""protochain relax on complexes: poses of ligands against PoseBusters' minimisation, and whole models.

    python analysis/benchmarks/complexes.py [poses] [models] [-o DIR] [--quick] [--more FOLDER]

poses: each crystal pose of a ligand, two that were turned and shifted, and a rough one made here (bonds
turned by 20 degrees RMS, the whole by up to 40, shifted by up to 1.5 angstrom), in its protein, judged by
PoseBusters before and after, with charges of NAGL, the rough one also of MMFF94. `relax` moves the whole
complex, and with `--rigid-protein` the pose alone; the rival is the way of PoseBusters' paper (Buttenschoen,
Morris, Deane, Chem. Sci. 15:3130, 2024): the protein stands still, the ligand moves in Sage (with NAGL's
charges) and ff14SB in vacuum, by OpenMM's minimiser on the CPU platform until the RMS force is 10 kJ/mol/nm.
All begin from the same prepared structure, on two threads; seconds are from the file to the end, of the wall
and the processor.

models: predictions and crystal structures with ligands, DNA, RNA and glycans, each by one `protochain relax`;
clashes of 0.4 angstrom and more per 1000 atoms, base pairs (N1 to N3 within 3.3 angstrom, at the end 3.5),
motion of P atoms and of ligands, inverted stereocentres.

FOLDER/../complexes has astex/NAME_protein.pdb, astex/NAME_moved*.sdf, ligands/NAME.sdf and models/.
"""

import argparse
import tempfile
from pathlib import Path
from time import perf_counter, process_time

import made
import numpy as np
import openmm
import pandas as pd
from posebusters import PoseBusters
from posebusters.modules.rmsd import check_rmsd
from rdkit import Chem
from rdkit.Chem import rdMolTransforms
from scipy.spatial.transform import Rotation

import protochain as pc

ACO = (
    "CC(=O)SCCNC(=O)CCNC(=O)[C@H](O)C(C)(C)COP(=O)(O)OP(=O)(O)OC[C@H]1O[C@@H](n2cnc3c(N)ncnc32)[C@H](O)[C@@H]1"
    "OP(=O)(O)O"
)
"""Acetyl-CoA."""
MODELS = {
    "boltz1_6bj9_model_0.cif": None, "chai1_6bj9_model_0.cif": {"LIG3": ACO, "LIG4": ACO},
    "5ugo.cif": None, "1ysa.pdb": None,
    "2r5z.pdb": None, "1bna.pdb": None, "4gxy.cif": None, "3ave.pdb": None, "1a0i.cif": None,
    "5h73.cif": None, "clash_dna.pdb": None, "clash_ligand.cif": None, "charges.cif": None,
}  # fmt: skip
"""Models, and what the ligands of one are, whose names tell nothing."""
THREADS = 2
CHARGES = ("nagl", "mmff94")


def complexes(options: argparse.Namespace) -> Path:
    """Folder of the complexes, beside that of further structures."""
    return options.more.parent / "complexes"


def rough(true: Chem.Mol, rng: np.random.Generator, path: Path) -> None:
    """Write a pose with its bonds turned at random, then all of it turned and shifted."""
    made, n = Chem.Mol(true), true.GetNumAtoms()
    conformer = made.GetConformer()
    for a, b in made.GetSubstructMatches(Chem.MolFromSmarts("[!D1]-&!@[!D1]")):
        ends = [
            next(k for k in range(n) if k != j and made.GetBondBetweenAtoms(i, k))
            for i, j in ((a, b), (b, a))
        ]
        four = conformer, ends[0], a, b, ends[1]
        rdMolTransforms.SetDihedralDeg(*four, rdMolTransforms.GetDihedralDeg(*four) + 20.0 * rng.normal())
    x, axis, away = conformer.GetPositions(), *rng.normal(size=(2, 3))
    turn = Rotation.from_rotvec(np.radians(40.0 * rng.random()) * axis / np.linalg.norm(axis))
    shift = 1.5 * rng.random() * away / np.linalg.norm(away)
    conformer.SetPositions(turn.apply(x - x.mean(axis=0)) + x.mean(axis=0) + shift)
    Chem.MolToMolFile(made, str(path))


def without(structure: pc.Structure, x: np.ndarray, atoms: np.ndarray, path: Path) -> None:
    """Write a complex without a ligand and hydrogens, for PoseBusters, which does not look at these."""
    other = structure.atom_element != "H"
    other[atoms] = False
    topology = openmm.app.Topology()
    for chain in structure.topology.chains():
        new_chain = topology.addChain(chain.id)
        for residue in chain.residues():
            mine = [a for a in residue.atoms() if other[a.index]]
            new = topology.addResidue(residue.name, new_chain, residue.id) if mine else None
            for a in mine:
                topology.addAtom(a.name, a.element, new)
    with path.open("w") as file:
        openmm.app.PDBFile.writeFile(topology, 10.0 * x[other], file, keepIds=True)


def frozen(structure: pc.Structure, atoms: np.ndarray) -> np.ndarray:
    """Ends (na, 3) of PoseBusters' way."""
    system = pc.energy(structure, solvent="vacuum", engine="openmm").system
    for k in set(range(structure.n_atoms)) - {*atoms.tolist()}:
        system.setParticleMass(k, 0.0)
    platform = openmm.Platform.getPlatformByName("CPU")
    properties = {"Threads": f"{THREADS}", "DeterministicForces": "true"}
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), platform, properties)
    context.setPositions(structure.positions)
    openmm.LocalEnergyMinimizer.minimize(context, 10.0)
    found = context.getState(getPositions=True).getPositions(asNumpy=True)
    return np.array(found.value_in_unit(openmm.unit.nanometer))


def failed(busters: PoseBusters, molecule, true, protein: Path) -> list[str]:
    """Tests of PoseBusters that a pose fails, its distance to the crystal's left out."""
    row = busters.bust([molecule], true, Chem.MolFromPDBFile(str(protein), sanitize=False)).iloc[0]
    return [str(name) for name, passed in row.items() if not passed and "rmsd" not in str(name)]


def poses(options: argparse.Namespace) -> pd.DataFrame:
    """Poses that PoseBusters takes, before and after."""
    folder, busters, rows = complexes(options), PoseBusters("redock"), []
    names = sorted(
        path.name.removesuffix("_protein.pdb") for path in (folder / "astex").glob("*_protein.pdb")
    )
    for k, name in enumerate(names[: 1 if options.quick else None]):
        protein = folder / "astex" / f"{name}_protein.pdb"
        true = Chem.MolFromMolFile(str(folder / "ligands" / f"{name}.sdf"))
        kinds = {"crystal": folder / "ligands" / f"{name}.sdf"}
        kinds |= {f"moved {i}": folder / "astex" / f"{name}_moved{i}.sdf" for i in (0, 1)}
        with tempfile.TemporaryDirectory() as scratch:
            kinds["rough"] = Path(scratch) / "rough.sdf"
            rough(true, np.random.default_rng(k), kinds["rough"])
            for kind, charges in [*((kind, CHARGES[0]) for kind in kinds), ("rough", CHARGES[1])]:
                path = kinds[kind]
                row = one_pose(busters, protein, path, true, charges, Path(scratch))
                rows.append({"complex": name, "pose": kind, "charges": charges, **row})
                print(rows[-1], flush=True)
    return pd.DataFrame(rows)


def one_pose(
    busters: PoseBusters, protein: Path, path: Path, true: Chem.Mol, charges: str, scratch: Path
) -> dict[str, object]:
    """Verdicts on one pose, before and after each way; the rival's with the default charges alone."""
    began = clocks()
    start = pc.load(protein, ligands=path, ligand_charges=charges)
    bound, prepared = start.ligands[-1], clocks() - began
    ways = {
        "before": lambda: start.positions,
        "relax": lambda: pc.relax(start, threads=THREADS).x,
        "rigid": lambda: pc.relax(start, threads=THREADS, rigid_protein=True).x,
        "frozen": lambda: frozen(start, bound.atoms),
    }
    heavy = bound.atoms[bound.ligand.molecule.heavy]
    row: dict[str, object] = {"residues": start.n_protein_residues}
    for way in [*ways][: None if charges == CHARGES[0] else -1]:
        began = clocks()
        x = ways[way]()
        seconds = prepared + clocks() - began
        without(start, x, bound.atoms, scratch / "protein.pdb")
        pc.save_ligands(start.with_positions(x), scratch / "ligands.sdf", path)
        (molecule,) = Chem.SDMolSupplier(str(scratch / "ligands.sdf"))
        bad = failed(busters, molecule, true, scratch / "protein.pdb")
        row |= {
            f"valid_{way}": not bad, f"failed_{way}": ";".join(bad),
            f"rmsd_{way}_angstrom": check_rmsd(molecule, true)["results"]["rmsd"],
        }  # fmt: skip
        if way != "before":
            moved = 10.0 * np.linalg.norm(x[heavy] - start.positions[heavy], axis=1)
            row |= {f"seconds_{way}": seconds[0].round(2), f"cpu_seconds_{way}": seconds[1].round(2)}
            row[f"moved_{way}_angstrom"] = np.median(moved)
    return row


def clocks() -> np.ndarray:
    """Seconds of the wall and of the processor."""
    return np.array([perf_counter(), process_time()])


def base_pairs(s: pc.Structure, x: np.ndarray, within: float) -> set[tuple[int, int]]:
    """Watson-Crick pairs by the distance (nm) of N1 to N3, of bases that are no neighbours in sequence."""
    base = s.residue_name[s.atom_residue]
    purine = np.flatnonzero((s.atom_name == "N1") & np.isin(base, ["DA", "DG", "A", "G"]))
    other = np.flatnonzero((s.atom_name == "N3") & np.isin(base, ["DT", "DC", "U", "C"]))
    near = np.linalg.norm(x[purine][:, None] - x[other], axis=2) < within
    pairs = s.atom_residue[purine][:, None] - s.atom_residue[other]
    near &= np.abs(pairs) > 2
    return {(int(purine[i]), int(other[j])) for i, j in np.argwhere(near)}


def models(options: argparse.Namespace) -> pd.DataFrame:
    """Models of complexes, each relaxed once."""
    rows = []
    for name, ligands in list(MODELS.items())[-1 if options.quick else 0 :]:
        began = perf_counter()
        start = pc.load(complexes(options) / "models" / name, ligands=ligands)
        prepared = perf_counter() - began
        done = pc.relax(start, threads=THREADS)
        seconds, x = perf_counter() - began, done.x
        pairs = base_pairs(start, start.positions, 0.33)
        record = done.record()
        phosphorus = np.isin(start.residue_name[start.atom_residue], [*"ACGU", "DA", "DC", "DG", "DT"])
        phosphorus &= (start.atom_element == "P") & ~start.obstacle
        heavy = [b.atoms[b.ligand.molecule.heavy] for b in start.ligands]
        moved = 10.0 * np.linalg.norm(x - start.positions, axis=1)
        rows.append(
            {
                "model": name, "residues": start.n_residues, "atoms": start.n_atoms,
                "status": str(done.status), "ligands_that_move": len(start.ligands),
                "atoms_fixed": int(start.obstacle.sum()),
                "seconds_prepared": round(prepared, 2), "seconds": round(seconds, 2),
                "clashes_start": record["clashscore_per_1000_atoms_start"],
                "clashes_end": record["clashscore_per_1000_atoms_end"],
                "overlaps_start": record["overlaps_start"],
                "overlaps_end": record["overlaps_end"], "base_pairs": len(pairs),
                "base_pairs_kept": len(pairs & base_pairs(start, x, 0.35)),
                "p_moved_median_angstrom": np.median(moved[phosphorus]) if phosphorus.any() else np.nan,
                "ligand_moved_median_angstrom": np.median(moved[np.concatenate(heavy)]) if heavy else np.nan,
                "inverted_stereocentres_start": record["inverted_stereocentres_start"],
                "inverted_stereocentres_end": record["inverted_stereocentres_end"],
            }
        )  # fmt: skip
        print(rows[-1], flush=True)
    return pd.DataFrame(rows)


STUDIES = {"poses": poses, "models": models}


def parser() -> argparse.ArgumentParser:
    return made.parser(__doc__, STUDIES, more=True)


def main() -> None:
    options = parser().parse_args()
    made.study(options, STUDIES, "complexes", lambda _, table: table.iloc[:, 0].unique(), THREADS)


if __name__ == "__main__":
    main()
