"""Side chains built on the bare backbones of crystals, beside FASPR on the same.

    python analysis/benchmarks/sidechains.py [built] [faspr] [-o DIR] [--quick] [--more FOLDER]

Of each crystal to 2 angstrom, all side chains are deleted, with the C-betas, hydrogens and waters.

built: ligands, ions and DNA stay. `load` builds the side chains, and `relax` goes on from there.

faspr: the same by FASPR (Huang, Pearce, Zhang, Bioinformatics 36:3758, 2020), of the protein alone, where a
program of this name is on the PATH.

What counts: side chains of standard residues, all of whose heavy atoms are in the file, with occupancy and
without alternates. A dihedral of Asp, Glu, Phe, Tyr that repeats after 180 degrees is compared so; equal
atoms may be exchanged in RMSDs, which are means over residues. Core: at least 20 other C-betas within 10
angstrom.

Files are of FOLDER and FOLDER/../complexes. The weights of the energies were chosen on 19 other crystals:
1AY7, 1BTL, 1DIX, 1MOL, 1O1Z, 1P4K, 1QGI, 2HBB, 2MB5, 2RTG, 3BKR, 3KCS, 3LZM, 3O5R, 3SGB, 4BKJ, 5L87, 7GSA,
9VYQ.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from time import perf_counter

import gemmi
import made
import numpy as np
import pandas as pd
from mdtraj.geometry.dihedral import CHI1_ATOMS, CHI2_ATOMS, CHI3_ATOMS, CHI4_ATOMS

import protochain as pc

CRYSTALS = {
    "1a8o_mse.pdb": 1.7, "1ajj_ldlr.pdb": 1.7, "1ake_full.cif": 2.0, "1bx8_hirustasin.pdb": 1.4,
    "1cih_scop_oldcols.pdb": 1.8, "1ejg_crambin.pdb": 0.54, "1fas_fasciculin.cif": 1.8,
    "1hel_lysozyme.pdb": 1.7, "1hpv_oldformat.pdb": 1.9, "1orc_icode.pdb": 1.54,
    "1ubq_ubiquitin.pdb": 1.8, "1us0_altlocs.pdb": 0.66, "3al1_caps_altloc.pdb": 0.75,
    "3i40_insulin.pdb": 1.85, "4cup_missing.cif": 1.88, "4pti_bpti.pdb": 1.5,
    "astex/1HQ2_PH2_protein.pdb": 1.25, "astex/1IA1_TQ3_protein.pdb": 1.7, "astex/1OQ5_CEL_protein.pdb": 1.5,
    "astex/1P62_GEO_protein.pdb": 1.9, "astex/1R55_097_protein.pdb": 1.58, "astex/1S3V_TQD_protein.pdb": 1.8,
    "astex/1SJ0_E4D_protein.pdb": 1.9, "astex/1T46_STI_protein.pdb": 1.6, "astex/1TOW_CRZ_protein.pdb": 2.0,
    "astex/1YGC_905_protein.pdb": 2.0, "astex/1Z95_198_protein.pdb": 1.8, "models/3ave.pdb": 2.0,
    "models/5h73.cif": 1.58, "models/5ugo.cif": 1.9,
}  # fmt: skip
"""Resolution, angstrom, as the PDB has it."""
EQUAL = {
    "ARG": {"NH1": "NH2"}, "ASP": {"OD1": "OD2"}, "GLU": {"OE1": "OE2"},
    "PHE": {"CD1": "CD2", "CE1": "CE2"}, "TYR": {"CD1": "CD2", "CE1": "CE2"},
}  # fmt: skip
SYMMETRIC = ("ASP", "GLU", "PHE", "TYR")
"""Residues whose last dihedral repeats after half a turn."""
BACKBONE = ("N", "CA", "C", "O", "OXT")
NEAR, MANY = 10.0, 20
"""Angstrom, -: C-betas so near, and so many, make a core."""
WITHIN = 40.0
"""Degrees: a dihedral is right."""

Places = dict[str, np.ndarray]


@cache
def complete() -> dict[str, set[str]]:
    """Heavy atoms of each standard residue, by its name."""
    whole, found = pc.from_sequence("GACDEFGHIKLMNPQRSTVWYG"), dict[str, set[str]]()
    for name, element, of in zip(whole.atom_name, whole.atom_element, whole.atom_residue, strict=True):
        if element != "H" and name != "OXT":
            found.setdefault(str(whole.residue_name[of]), set()).add(str(name))
    return found


def place(options: argparse.Namespace, name: str) -> Path:
    folder = options.more.parent / "complexes" if "/" in name else options.more
    return folder / name


def read(path: Path) -> gemmi.Structure:
    """A file; of the PDB's old form the ids and serial numbers in columns 73 to 80 are no elements."""
    is_pdb = ".pdb" in path.suffixes
    return gemmi.read_pdb(str(path), max_line_length=72) if is_pdb else gemmi.read_structure(str(path))


def natives(model: gemmi.Model) -> dict[tuple[str, str], tuple[str, Places]]:
    """Name and heavy atoms, angstrom, of the residues that count, by chain and number."""
    found = {}
    for chain in model:
        for residue in chain:
            if residue.name not in complete() or residue.name in ("ALA", "GLY"):
                continue
            heavy = [a for a in residue if not a.is_hydrogen() and a.name != "OXT"]
            seen = all(a.occ > 0.0 and a.altloc in ("\0", " ", "") for a in heavy)
            if seen and {a.name for a in heavy} == complete()[residue.name]:
                at = {a.name: np.array(a.pos.tolist()) for a in heavy}
                found[chain.name, str(residue.seqid)] = residue.name, at
    return found


def strip(structure: gemmi.Structure, path: Path, alone: bool = False) -> None:
    """Write a structure without hydrogens, waters and side chains; ``alone``: the protein only."""
    bare = structure.clone()
    bare.remove_hydrogens()
    bare.remove_waters()
    bare.remove_alternative_conformations()
    for residue in [each for chain in bare[0] for each in chain]:
        if residue.name == "MSE":
            residue.name, residue.het_flag = "MET", "A"
        if residue.name in complete():
            for k in reversed(range(len(residue))):
                if residue[k].name not in BACKBONE:
                    del residue[k]
    if alone:
        bare.remove_ligands_and_waters()
    bare.remove_empty_chains()
    # Bonds to atoms that are no longer there.
    while len(bare.connections):
        bare.connections.pop()
    bare.write_pdb(str(path))


def places_of(path: Path) -> dict[tuple[str, str], Places]:
    structure = read(path)
    return {
        (chain.name, str(residue.seqid)): {a.name: np.array(a.pos.tolist()) for a in residue}
        for chain in structure[0]
        for residue in chain
    }


def core(native: dict[tuple[str, str], tuple[str, Places]], model: gemmi.Model) -> set[tuple[str, str]]:
    """Residues with many C-betas around."""
    betas = np.array([a.pos.tolist() for c in model for r in c for a in r if a.name == "CB"])
    return {
        key
        for key, (_, at) in native.items()
        if (np.linalg.norm(betas - at["CB"], axis=1) < NEAR).sum() - 1 >= MANY
    }


def dihedral(at: Places, quartet: Sequence[str]) -> float:
    """In radians."""
    return gemmi.calculate_dihedral(*(gemmi.Position(*at[name]) for name in quartet))


def errors(name: str, at: Places, model: Places) -> np.ndarray:
    """(5,) float: errors of chi1 to chi4, degrees, NaN where there is none, and RMSD, angstrom."""
    row = np.full(5, np.nan)
    known = () if name == "PRO" else (CHI1_ATOMS, CHI2_ATOMS, CHI3_ATOMS, CHI4_ATOMS)
    quartets = [own for some in known if (own := next((q for q in some if {*q} <= at.keys()), None))]
    for k, quartet in enumerate(quartets):
        period = 180.0 if name in SYMMETRIC and k == len(quartets) - 1 else 360.0
        off = np.rad2deg(dihedral(model, quartet) - dihedral(at, quartet))
        row[k] = abs((off + period / 2) % period - period / 2)
    side = [n for n in at if n not in BACKBONE]
    swapped = EQUAL.get(name, {}) | {b: a for a, b in EQUAL.get(name, {}).items()}
    ways = [[model[n] for n in side], [model[swapped.get(n, n)] for n in side]]
    row[4] = min(
        np.sqrt(np.mean(np.sum((np.array(way) - [at[n] for n in side]) ** 2, axis=1))) for way in ways
    )
    return row


def told(table: pd.DataFrame) -> dict[str, float]:
    """Of side chains: shares of right ones, mean errors and RMSDs; proline has no chi here."""
    chi = table[table["chi1"].notna()]
    two = chi[chi["chi2"].notna()]
    row = {
        "side_chains": len(chi),
        "chi1_percent": 100 * (chi["chi1"] <= WITHIN).mean(),
        "chi12_percent": 100 * ((two["chi1"] <= WITHIN) & (two["chi2"] <= WITHIN)).mean(),
    }
    row |= {f"chi{k}_error_degrees": chi[f"chi{k}"].mean() for k in (1, 2, 3, 4)}
    inside = table[table["core"]]
    return row | {
        "core_side_chains": int(inside["chi1"].notna().sum()),
        "core_chi1_percent": 100 * (inside["chi1"].dropna() <= WITHIN).mean(),
        "core_chi1_error_degrees": inside["chi1"].mean(),
        "rmsd_angstrom": table["rmsd"].mean(),
        "core_rmsd_angstrom": inside["rmsd"].mean(),
    }


def measured(
    way: str, name: str, native: dict[tuple[str, str], tuple[str, Places]], inner: set, path: Path
) -> pd.DataFrame:
    there = places_of(path)
    rows = [
        (way, name, residue, key in inner, *errors(residue, at, there[key]))
        for key, (residue, at) in native.items()
        if set(at) <= there.get(key, {}).keys()
    ]
    names = ["way", "structure", "residue", "core", "chi1", "chi2", "chi3", "chi4", "rmsd"]
    return pd.DataFrame(rows, columns=names)


def opened(options: argparse.Namespace, name: str) -> gemmi.Structure:
    structure = read(place(options, name))
    structure.setup_entities()
    del structure[1:]
    for chain in structure[0]:
        # A chain without an id would get one on the way.
        chain.name = chain.name.strip() or "A"
    return structure


def of_structure(options: argparse.Namespace, name: str, scratch: Path) -> tuple[pd.DataFrame, dict]:
    structure = opened(options, name)
    native = natives(structure[0])
    inner = core(native, structure[0])
    bare, built, relaxed = (scratch / f"{k}.pdb" for k in ("bare", "built", "relaxed"))
    strip(structure, bare)
    began = perf_counter()
    loaded = pc.load(bare)
    seconds = perf_counter() - began
    pc.save(loaded, built)
    tables = [measured("built", name, native, inner, built)]
    began = perf_counter()
    pc.load(built)
    row = {
        "structure": Path(name).name.split("_")[0].split(".")[0].lower(),
        "resolution_angstrom": CRYSTALS[name],
        "chains": len({chain for chain, _ in native}), "residues": loaded.n_residues,
    }  # fmt: skip
    row |= told(tables[0]) | {"seconds": seconds, "seconds_complete": perf_counter() - began}
    done = pc.relax(loaded)
    record = done.record()
    pc.save(done.structure, relaxed)
    tables.append(measured("relaxed", name, native, inner, relaxed))
    row |= {
        "status": record["status"], "seconds_relax": record["seconds"],
        "overlaps_relaxed": record["overlaps_end"], "violations_relaxed": record["violations_end"],
        "clashscore_relaxed_per_1000_atoms": record["clashscore_per_1000_atoms_end"],
    }  # fmt: skip
    return pd.concat(tables), row


def by_faspr(options: argparse.Namespace, names: list[str]) -> pd.DataFrame:
    """FASPR, of the structures that it writes."""
    program = shutil.which("FASPR")
    if program is None:
        sys.exit("there is no program FASPR on the PATH; name built alone, or install it")
    tables, seconds = [], 0.0
    for name in names:
        structure = opened(options, name)
        native = natives(structure[0])
        with tempfile.TemporaryDirectory() as scratch:
            bare, built = Path(scratch) / "bare.pdb", Path(scratch) / "built.pdb"
            strip(structure, bare, alone=True)
            began = perf_counter()
            # Its library is beside it.
            command = [str(Path(program).resolve()), "-i", str(bare), "-o", str(built)]
            subprocess.run(command, capture_output=True, check=False)
            seconds += perf_counter() - began
            if built.exists():
                tables.append(measured("FASPR", name, native, core(native, structure[0]), built))
    row = {"way": "FASPR", "structures": len(tables), **told(pd.concat(tables)), "seconds": seconds}
    return pd.DataFrame([row])


def parser() -> argparse.ArgumentParser:
    return made.parser(__doc__ or "", ("built", "faspr"), more=True)


def main() -> None:
    options = parser().parse_args()
    chosen = list(CRYSTALS)
    if options.quick:
        chosen, options.more = ["1ubq.pdb", "4pti.pdb"], made.SAMPLES
        CRYSTALS.update({"1ubq.pdb": 1.8, "4pti.pdb": 1.5})
    inputs = [place(options, name) for name in chosen]
    if "faspr" in options.studies or (not options.studies and shutil.which("FASPR")):
        found = by_faspr(options, chosen)
        print(made.markdown(found.round(2)))
        if options.output:
            made.write(found.round(3), options.output / "sidechains_faspr.csv", inputs)
    if options.studies and "built" not in options.studies:
        return
    tables, rows = [], []
    with tempfile.TemporaryDirectory() as scratch:
        for name in chosen:
            table, row = of_structure(options, name, Path(scratch))
            tables.append(table)
            rows.append(row)
            print({k: round(v, 2) if isinstance(v, float) else v for k, v in row.items()}, flush=True)
    all_of = pd.concat(tables)
    ways = [
        {"way": way, "structures": its["structure"].nunique(), **told(its)}
        for way, its in all_of.groupby("way", sort=False)
    ]
    by_residue = [
        {"way": way, "residue": residue, **told(its)}
        for (way, residue), its in all_of[all_of["residue"] != "PRO"].groupby(["way", "residue"])
    ]
    print(made.markdown(pd.DataFrame(ways).round(2)))
    if options.output:
        for table, file in (
            (rows, "sidechains.csv"), (ways, "sidechains_all.csv"), (by_residue, "sidechains_residues.csv")
        ):  # fmt: skip
            made.write(pd.DataFrame(table).round(3), options.output / file, inputs)


if __name__ == "__main__":
    main()
