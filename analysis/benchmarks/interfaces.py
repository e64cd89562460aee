"""protochain score: its columns against other programs, partners moved out of place, and what it costs.

    python analysis/benchmarks/interfaces.py [columns] [moved] [cost] [-o DIR] [--quick] [--more FOLDER]

columns: each complex as its file has it, hydrogens added. The energy of binding against OpenMM's Reference
platform, with both sides there and 1e5 nm apart; the buried area against FreeSASA's slices (Mitternacht,
F1000Research 5:189, 2016; where it is installed) with the same radii, and with its own, which stand for
hydrogens, too; Sc against sc-rs, which follows CCP4's program; hydrogen bonds against the criterion of Wernet
and Nilsson, by mdtraj.
Bonds join the chains of insulin, so that they cannot be parted; other programs know no radii of ligands.

moved: relaxed complexes, the second side moved out along the line from the first, or turned about it; ranks
are Spearman's of the column with the motion, 1 where it worsens at every step.

cost: copies of a complex of some 400 residues, by `protochain relax --interface`, which scores it at both
ends, one thread to each of two workers; the busy share is that of both cores.

FOLDER/../complexes/models has predictions and complexes with DNA.
"""

import argparse
import resource
import shutil
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from time import perf_counter

import made
import mdtraj
import numpy as np
import pandas as pd
import shape_complementarity
from mdtraj.geometry.sasa import _ATOMIC_RADII
from scipy.stats import spearmanr

import protochain as pc
from protochain.batches import relax_files
from protochain.relaxation import RelaxSettings
from protochain.validation import SCORES

freesasa = None
with suppress(ImportError):
    import freesasa

COMPLEXES = {
    "3i40_insulin.pdb": "A:B", "4zhl_icodes.cif": "U:P", "1hpv_oldformat.pdb": "A:B",
    "1hpv_oldformat.pdb 478": "A,B:resname 478", "1afs_638.pdb": "A:B", "boltz1_6bj9_model_0.cif": "A:B",
    "1ysa.pdb": "C,D:A,B",
}  # fmt: skip
JOINED = ("3i40_insulin.pdb",)
MOVED = ("4zhl_icodes.cif", "1ysa.pdb")
AWAY = 1e5
"""nm. Charges of both sides act by less than a hundredth of a kJ/mol through water."""
SHIFTS, TURNS = (0.0, 1.0, 2.0, 4.0), (0.0, 5.0, 10.0, 20.0)
"""angstrom, degrees."""
WATCHED = (
    "energy_kj_mol", "interaction_kj_mol", "lennard_jones_kj_mol", "buried_area_angstrom2",
    "shape_complementarity", "hydrogen_bonds", "contacts", "clashes",
)  # fmt: skip
LARGE, COPIES, WORKERS = "1ake_full.cif", 4, 2


def file_of(name: str) -> str:
    return name.split()[0]


def path_of(options: argparse.Namespace, name: str) -> Path:
    name = file_of(name)
    found = options.more / name
    return found if found.exists() else options.more.parent / "complexes" / "models" / name


def by_openmm(structure: pc.Structure, one: np.ndarray, other: np.ndarray) -> float:
    """Energy of both sides there, without that of both apart, kJ/mol."""
    judge = pc.energy(structure, engine="openmm").reference
    away = np.zeros((structure.n_atoms, 3))
    away[~one & ~other, 1] = AWAY
    together = judge(structure.positions + away)[0]
    away[other, 0] = AWAY
    return float(together - judge(structure.positions + away)[0])


def by_freesasa(structure: pc.Structure, one: np.ndarray, other: np.ndarray, united: bool) -> float:
    """Area that both sides lose, square angstrom, with mdtraj's radii or its own of heavy atoms."""
    if freesasa is None:
        return np.nan
    how = freesasa.Parameters({"algorithm": freesasa.LeeRichards, "n-slices": 50})
    of, element = structure.atom_residue, structure.atom_element
    classes = freesasa.Classifier()

    def radius(k: int) -> float:
        if united:
            its = classes.radius(str(structure.residue_name[of[k]]), str(structure.atom_name[k]))
            return its if its > 0.0 else 10.0 * _ATOMIC_RADII[str(element[k])]
        return 10.0 * _ATOMIC_RADII[str(element[k])]

    def area(mask: np.ndarray) -> float:
        atoms = np.flatnonzero(mask & (element != "H") if united else mask)
        x = (10.0 * structure.positions[atoms]).ravel().tolist()
        return freesasa.calcCoord(x, [radius(k) for k in atoms.tolist()], how).totalArea()

    return area(one) + area(other) - area(one | other)


def by_sc_rs(structure: pc.Structure, one: np.ndarray, other: np.ndarray) -> float:
    given = []
    for mask in (one, other):
        k = np.flatnonzero(mask & (structure.atom_element != "H"))
        names = structure.residue_name[structure.atom_residue[k]].tolist()
        given.append((10.0 * structure.positions[k], structure.atom_name[k].tolist(), names))
    return float(shape_complementarity.compute_sc(*given[0], *given[1], parallel=False).sc)


def by_wernet_nilsson(structure: pc.Structure, one: np.ndarray, other: np.ndarray) -> int:
    (found,) = mdtraj.wernet_nilsson(pc.to_mdtraj(structure), periodic=False)
    d, _, a = found.T
    return int(((one[d] & other[a]) | (other[d] & one[a])).sum())


def atoms_of(structure: pc.Structure, *pair: str) -> list[np.ndarray]:
    """(na,) bool of each of two sides: chains, without water and the other side, or a residue by its name."""
    names, chains = structure.residue_name, structure.residue_chain
    named = [names == side.split()[-1] if side.startswith("resname") else None for side in pair]
    rest = (names != "HOH") & ~np.any([each for each in named if each is not None], axis=0)
    sides = [
        rest & np.isin(chains, side.split(",")) if own is None else own
        for side, own in zip(pair, named, strict=True)
    ]
    return [side[structure.atom_residue] for side in sides]


def columns(options: argparse.Namespace) -> pd.DataFrame:
    """Columns of an interface, and by other programs."""
    rows = []
    for name, interface in [*COMPLEXES.items()][: 2 if options.quick else None]:
        structure = pc.load(path_of(options, name))
        energy, pair = pc.energy(structure, threads=1), interface.split(":")
        one, other = atoms_of(structure, *pair)
        began = perf_counter()
        found = pc.score_interface(structure, *pair, energy=energy).scores
        seconds = perf_counter() - began
        rows.append(
            {
                "complex": Path(file_of(name)).stem, "interface": interface,
                "n_residues": len(np.unique(structure.atom_residue[one | other])),
                "energy_kj_mol": found["energy_kj_mol"],
                "energy_openmm_kj_mol": np.nan if name in JOINED else by_openmm(structure, one, other),
                "area_angstrom2": found["buried_area_angstrom2"],
                "area_freesasa_angstrom2": by_freesasa(structure, one, other, False),
                "area_freesasa_own_angstrom2": by_freesasa(structure, one, other, True),
                "sc": found["shape_complementarity"],
                "sc_sc_rs": by_sc_rs(structure, one, other) if "resname" not in interface else np.nan,
                "hydrogen_bonds": found["hydrogen_bonds"],
                "hydrogen_bonds_wernet_nilsson": by_wernet_nilsson(structure, one, other),
                "salt_bridges": found["salt_bridges"], "unsatisfied": found["unsatisfied_polar_atoms"],
                "clashes": found["clashes"], "contacts": found["contacts"], "seconds": seconds,
            }
        )  # fmt: skip
        print(rows[-1], flush=True)
    return pd.DataFrame(rows)


def turned(x: np.ndarray, axis: np.ndarray, centre: np.ndarray, degrees: float) -> np.ndarray:
    """Positions turned about an axis through a centre, by Rodrigues' formula."""
    angle, arm = np.radians(degrees), x - centre
    along = (arm @ axis)[:, None] * axis
    return centre + along + np.cos(angle) * (arm - along) + np.sin(angle) * np.cross(axis, arm)


def moved(options: argparse.Namespace) -> pd.DataFrame:
    """Columns of an interface whose second side is moved out, or turned."""
    rows = []
    for name in MOVED[: 1 if options.quick else None]:
        structure = pc.relax(pc.load(path_of(options, name)), threads=1).structure
        energy, pair = pc.energy(structure, threads=1), COMPLEXES[name].split(":")
        one, other = atoms_of(structure, *pair)
        its = pc.score_interface(structure, *pair, energy=energy).residues
        number = np.char.add(structure.residue_number, structure.residue_insertion_code)
        keys = np.char.add(np.char.add(structure.residue_chain, ":"), number)
        touching = np.isin(keys, its["chain"] + ":" + its["residue"])[structure.atom_residue]
        x = structure.positions
        near, far = (x[touching & side].mean(axis=0) for side in (one, other))
        axis = (far - near) / np.linalg.norm(far - near)
        for kind, steps in (("out", SHIFTS), ("turned", TURNS)):
            for step in steps[:: 3 if options.quick else 1]:
                y = x.copy()
                y[other] = (
                    x[other] + 0.1 * step * axis if kind == "out" else turned(x[other], axis, far, step)
                )
                found = pc.score_interface(structure.with_positions(y), *pair, energy=energy).scores
                rows.append(
                    {"complex": Path(name).stem, "interface": COMPLEXES[name], "motion": kind, "by": step}
                    | {key: found[key] for key in WATCHED}
                )
    table = pd.DataFrame(rows)
    ranks = []
    for (name, kind), own in table.groupby(["complex", "motion"], sort=False):
        # Better when more: it should fall with the motion.
        rank = {
            key: -SCORES[key].better * spearmanr(own["by"], own[key].astype(float)).statistic
            if own[key].nunique(dropna=False) > 1 else np.nan
            for key in WATCHED
        }  # fmt: skip
        ranks.append(
            {"complex": name, "interface": own["interface"].iloc[0], "motion": f"{kind}, rank"} | rank
        )
    return pd.concat([table, pd.DataFrame(ranks)], ignore_index=True)


def cost(options: argparse.Namespace) -> pd.DataFrame:
    """Seconds of a complex, relaxed and scored at both ends, and scored alone."""
    path, copies = path_of(options, LARGE), 2 if options.quick else COPIES
    structure = pc.load(path)
    energy = pc.energy(structure, threads=1)
    began = perf_counter()
    pc.score_interface(structure, "A", "B", energy=energy)
    scoring = perf_counter() - began
    with tempfile.TemporaryDirectory() as folder:
        inputs = Path(folder) / "in"
        inputs.mkdir()
        for k in range(copies):
            shutil.copy(path, inputs / f"copy{k}{path.suffix}")
        began, before = perf_counter(), _cpu()
        batch = relax_files(
            [inputs], Path(folder) / "out", RelaxSettings(interface="A:B"), threads=1, workers=WORKERS
        )
        seconds, used = perf_counter() - began, _cpu() - before
        done = batch.table
    return pd.DataFrame(
        [
            {
                "complex": Path(LARGE).stem, "n_residues": int(done["n_residues"].iloc[0]),
                "n_atoms": structure.n_atoms, "copies": copies, "workers": WORKERS,
                "seconds_relaxation": float(done["seconds"].median()), "seconds_score": scoring,
                "seconds_each": WORKERS * seconds / copies, "busy_percent": 100.0 * used / WORKERS / seconds,
            }
        ]
    )  # fmt: skip


def _cpu() -> float:
    """Seconds of processors that children have used."""
    own = resource.getrusage(resource.RUSAGE_CHILDREN)
    return own.ru_utime + own.ru_stime


TABLES = {"columns": columns, "moved": moved, "cost": cost}


def parser() -> argparse.ArgumentParser:
    return made.parser(__doc__, TABLES, more=True)


def main() -> int:
    options = parser().parse_args()
    files = {"columns": dict.fromkeys(map(file_of, COMPLEXES)), "moved": MOVED, "cost": [LARGE]}
    made.study(options, TABLES, "interfaces", lambda name, _: files[name])
    return 0


if __name__ == "__main__":
    sys.exit(main())
