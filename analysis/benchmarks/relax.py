"""protochain relax against AlphaFold's relaxation by OpenMM: seconds, violations left, fold kept, energies.

    python analysis/benchmarks/relax.py [MODEL ...] [-o DIR] [--quick] [--made N] [--repeats N]
    python analysis/benchmarks/relax.py --many 1000 [--sample 20] [-o DIR]

Each model is relaxed from shell to shell by relax_openmm.py (AlphaFold's protocol as published), by
`protochain relax` and by `protochain relax --protocol alphafold`, one after the other, on two cores and two
threads; figures are medians of the repeats, OpenMM's seconds without counting violations. Models: the files
given, and N damaged copies of samples, heavy atoms alone. What is left is judged by one counter in all
results (protochain.validation), and energies without springs on the same atoms: in amber99sb and vacuum
(OpenMM's result against --protocol alphafold), and in ff14SB and OBC2 (against the default). Atoms that a
result lacks, hydrogens of another tautomer, are added and alone minimised.

With --many, a folder of N models of 20 to 129 residues is relaxed by one `protochain relax FOLDER` with two
workers, and a sample of them by OpenMM in two processes of one thread; its time is scaled to N.
"""

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import made
import numpy as np
import pandas as pd
from made import ROOT, SAMPLES

import protochain as pc
from protochain.validation import measures

sys.path.insert(0, str(ROOT / "tests"))
from fixtures import models

MADE_OF = ("1hel", "1ubq", "4pti")
MANY_OF = ("1l2y", "1vii", "1ejg", "3i40", "4pti", "1ubq", "1hel")
KEPT = (
    "structure", "status", "message", "n_residues", "violations_start", "violations_end", "overlaps_start",
    "overlaps_end", "inverted_stereocentres_start", "inverted_stereocentres_end",
    "threaded_rings_start", "threaded_rings_end",
    "ca_rmsd_angstrom", "n_rounds", "evaluations",
)  # fmt: skip
"""Columns of a folder's relaxed.csv that are kept."""
PROGRAM = shutil.which("protochain") or "protochain"
OPENMM = Path(__file__).with_name("relax_openmm.py")
WAYS = ("openmm", "relax", "relax_alphafold")
SAME_FIELD = {
    "amber99sb_vacuum": (("openmm", "relax_alphafold"), {"forcefield": "amber99sb", "solvent": "vacuum"}),
    "ff14sb_obc2": (("openmm", "relax"), {"forcefield": "amber14", "solvent": "obc2"}),
}


@dataclass(frozen=True)
class Run:
    """One process: seconds of the wall and of the processors, exit status, what it printed."""

    seconds: float
    cpu_seconds: float
    status: int
    told: dict
    errors: str


def command(way: str, model: Path, output: Path, threads: int = 2) -> list[str]:
    if way == "openmm":
        return [sys.executable, str(OPENMM), str(model), str(output), "--threads", str(threads)]
    program = [PROGRAM, "relax", str(model), "-o", str(output), "--force"]
    protocol = ["--protocol", "alphafold"] if way == "relax_alphafold" else []
    return [*program, "--threads", str(threads), "--json", *protocol]


def run(arguments: list[str]) -> Run:
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        began = perf_counter()
        process = subprocess.Popen(arguments, stdout=out, stderr=err, env=made.surroundings())
        _, status, used = os.wait4(process.pid, 0)
        seconds = perf_counter() - began
        process.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0), err.seek(0)
        try:
            told = json.loads(out.read().strip())
        except json.JSONDecodeError:
            told = {}
        errors = err.read()
    cpu = used.ru_utime + used.ru_stime
    counting = told.get("seconds_counting", 0.0) if isinstance(told, dict) else 0.0
    return Run(seconds - counting, cpu - counting, process.returncode, told, errors)


def made_models(folder: Path, n: int) -> list[Path]:
    """Write n damaged copies of samples."""
    samples = [pc.load(SAMPLES / f"{name}.pdb") for name in MADE_OF]
    return [write(s, folder / f"{name}.pdb") for name, s in models.damaged(samples, n, seed=1)]


def write(structure: pc.Structure, path: Path) -> Path:
    """Write heavy atoms, as predicted models have them."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pc.save(structure, path)
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(line for line in lines if not (line.startswith("ATOM") and line[76:78] == " H")))
    return path


def on_same_atoms(structure: pc.Structure, end: pc.Structure) -> tuple[np.ndarray, int]:
    """Positions (na, 3), nm, of a result on the atoms of a structure, and how many atoms it lacked.

    Raises
    ------
    ValueError
        If heavy atoms are missing, or the residues are others.
    """
    if structure.n_residues != end.n_residues:
        raise ValueError(f"{end.n_residues} residues, not {structure.n_residues}")
    at = {(r, a): k for k, (r, a) in enumerate(zip(end.atom_residue, end.atom_name, strict=True))}
    atoms = list(zip(structure.atom_residue, structure.atom_name, strict=True))
    there = np.array([key in at for key in atoms])
    if (~there & (structure.atom_element != "H")).any():
        missing = structure.describe(int(np.flatnonzero(~there & (structure.atom_element != "H"))[0]))
        raise ValueError(f"{missing} is missing")
    x = structure.positions.copy()
    x[there] = end.positions[[at[key] for key, known in zip(atoms, there, strict=True) if known]]
    if there.all():
        return x, 0
    return _with_hydrogens(structure, x, there), int((~there).sum())


def _with_hydrogens(structure: pc.Structure, x: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Positions with hydrogens placed where their parents went, and minimised."""
    for hydrogen in np.flatnonzero(~there):
        bonded = structure.bonds[(structure.bonds == hydrogen).any(axis=1)].ravel()
        parent = int(bonded[bonded != hydrogen][0])
        near = structure.bonds[(structure.bonds == parent).any(axis=1)].ravel()
        frame = [parent, *(int(k) for k in np.unique(near) if k not in (parent, hydrogen) and there[k])]
        x[hydrogen] = _carried(structure.positions, x, frame, int(hydrogen))
    chosen = "index " + " ".join(map(str, np.flatnonzero(~there)))
    return pc.relax(structure.with_positions(x), move=chosen, stiffness=0.0, tolerance=1.0).x


def _carried(before: np.ndarray, after: np.ndarray, frame: list[int], atom: int) -> np.ndarray:
    """Place of an atom after its neighbours moved: turned and moved as they were."""
    a, b = before[frame], after[frame]
    u, _, v = np.linalg.svd((a - a.mean(axis=0)).T @ (b - b.mean(axis=0)))
    u[:, -1] *= np.sign(np.linalg.det(u @ v))
    return b[0] + (before[atom] - a[0]) @ u @ v


def judged(structure: pc.Structure, path: Path) -> dict[str, object]:
    """Violations and other measures of a result, its RMSD from the input, and its energies."""
    if not path.exists():
        return {"notes": "no result"}
    end = pc.load(path, keep="none")
    row: dict[str, object] = {**measures(end), "ca_rmsd_angstrom": pc.rmsd(structure, end)}
    try:
        x, lacked = on_same_atoms(structure, end)
    except ValueError as error:
        return row | {"notes": f"no energy, {error}"}
    for field, (_, options) in SAME_FIELD.items():
        row[f"energy_{field}"] = pc.energy(structure, **options)(x)[0]
    return row | ({"notes": f"{lacked} hydrogens added"} if lacked else {})


def compare(files: list[Path], repeats: int, scratch: Path) -> pd.DataFrame:
    """A row for each model; all ways take turns, and the order turns with the repeats."""
    runs: dict[tuple[Path, str], list[Run]] = {}
    for repeat in range(repeats):
        for model in files:
            for k in range(len(WAYS)):
                way = WAYS[(k + repeat) % len(WAYS)]
                end = place_of(scratch, way, repeat, model)
                end.parent.mkdir(parents=True, exist_ok=True)
                runs.setdefault((model, way), []).append(run(command(way, model, end)))
    rows = []
    for model in files:
        structure = pc.load(model, keep="none")
        row: dict[str, object] = {"model": stem_of(model), "residues": structure.n_residues}
        row |= {"atoms": structure.n_atoms, "violations_start": measures(structure)["violations"]}
        for way in WAYS:
            # OpenMM's sums have no fixed order, and its results differ; ours repeat bit for bit.
            ends = [judged(structure, place_of(scratch, way, k, model)) for k in range(repeats)]
            row |= _of_way(way, runs[model, way], ends if way == "openmm" else ends[:1])
        row["times_sooner"] = row["seconds_openmm"] / row["seconds_relax"]
        row["times_less_cpu"] = row["cpu_seconds_openmm"] / row["cpu_seconds_relax"]
        told = [r.told.get("seconds_last_cleaning", 0.0) for r in runs[model, "openmm"]]
        row["seconds_openmm_last_cleaning"] = statistics.median(told)
        rows.append(row)
        print(_line(row), flush=True)
    return pd.DataFrame(rows)


def stem_of(model: Path) -> str:
    return model.name.split(".")[0]


def place_of(scratch: Path, way: str, repeat: int, model: Path) -> Path:
    """OpenMM's protocol writes PDB; ours the format of the model, whose names may not fit a PDB file."""
    suffix = ".cif" if ".cif" in model.name and way != "openmm" else ".pdb"
    return scratch / way / str(repeat) / f"{stem_of(model)}{suffix}"


def _of_way(way: str, runs: list[Run], ends: list[dict[str, object]]) -> dict[str, object]:
    """Columns of a way: medians of its runs and results, and the range of what varies."""
    row: dict[str, object] = {
        f"seconds_{way}": statistics.median(r.seconds for r in runs),
        f"cpu_seconds_{way}": statistics.median(r.cpu_seconds for r in runs),
        f"exit_{way}": max(r.status for r in runs),
        f"rounds_{way}": statistics.median(_rounds(r.told) for r in runs),
        f"notes_{way}": "; ".join(dict.fromkeys(str(end["notes"]) for end in ends if "notes" in end)),
    }
    for key in dict.fromkeys(key for end in ends for key in end if key != "notes"):
        values = [end[key] for end in ends if end.get(key) is not None]
        row[f"{key}_{way}"] = statistics.median(values) if values else None
        if len(ends) > 1 and values and key in ("violations", "ca_rmsd_angstrom"):
            row |= {f"{key}_{way}_least": min(values), f"{key}_{way}_most": max(values)}
    return row


def _rounds(told: dict) -> float:
    rounds = told.get("rounds", float("nan"))
    return len(rounds) if isinstance(rounds, list) else rounds


def _without_last_cleaning(table: pd.DataFrame) -> pd.Series:
    return (table["seconds_openmm"] - table["seconds_openmm_last_cleaning"]) / table["seconds_relax"]


def _line(row: dict[str, object]) -> str:
    def of(key: str, digits: int) -> str:
        value = row.get(key)
        return "-" if value is None else f"{value:.{digits}f}"

    cells = [str(row["model"]), str(row["residues"]), of("seconds_openmm", 1), of("seconds_relax", 2)]
    cells += [f"{of('times_sooner', 1)}x", f"{of('times_less_cpu', 1)}x"]
    for key, digits in (("violations", 0), ("ca_rmsd_angstrom", 2)):
        cells += [of(f"{key}_start", digits)] if key == "violations" else []
        cells += [of(f"{key}_{way}", digits) for way in WAYS]
    for field, (ways, _) in SAME_FIELD.items():
        ends = [row.get(f"energy_{field}_{way}") for way in ways]
        cells.append("-" if None in ends else f"{ends[1] - ends[0]:+.0f}")
    return f"| {' | '.join(cells)} |"


HEADINGS = (
    "model", "residues", "OpenMM s", "relax s", "sooner", "less CPU",
    "violations start", "OpenMM", "relax", "relax, AlphaFold's protocol",
    "RMSD OpenMM", "relax", "relax, AlphaFold's protocol",
    "kJ/mol more, amber99sb, vacuum", "kJ/mol more, ff14SB, OBC2",
)  # fmt: skip


def summary(table: pd.DataFrame) -> str:
    """Ratios, and which of the bars are met by how many."""
    n = len(table)
    sooner = table["times_sooner"]
    middle = table["residues"].between(100, 400)
    lines = [f"{n} models, load of the machine {os.getloadavg()[1]:.1f}"]
    lines.append(
        f"sooner: median {sooner.median():.1f}x, least {sooner.min():.1f}x; of 100 to 400 residues median "
        f"{sooner[middle].median():.1f}x, least {sooner[middle].min():.1f}x; against OpenMM without "
        f"cleaning its last result: median {_without_last_cleaning(table).median():.1f}x"
    )
    lines.append(
        f"less processor time: median {table['times_less_cpu'].median():.1f}x, "
        f"least {table['times_less_cpu'].min():.1f}x"
    )
    for way in WAYS[1:]:
        left = (table[f"violations_{way}"] <= table["violations_openmm"]).sum()
        fold = table[f"ca_rmsd_angstrom_{way}"] <= table["ca_rmsd_angstrom_openmm"] + 0.02
        lines.append(
            f"{way}: no more violations in {left} of {n}; RMSD at most OpenMM's + 0.02 in {fold.sum()} of {n}"
        )
    for field, (ways, _) in SAME_FIELD.items():
        theirs, ours = (table.get(f"energy_{field}_{way}", pd.Series(dtype=float)) for way in ways)
        both = theirs.notna() & ours.notna()
        lines.append(f"{field}: {ways[1]} lower in {(ours <= theirs)[both].sum()} of {both.sum()}")
    failed = {way: int((~table[f"exit_{way}"].isin([0, 3])).sum()) for way in WAYS}
    return "\n".join([*lines, f"failures: {failed}"])


def throughput(n: int, sample: int, scratch: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Rows of a folder by protochain relax with two workers, and models an hour; a sample by OpenMM."""
    folder, ends = scratch / "many", scratch / "relaxed"
    structures = [pc.load(SAMPLES / f"{name}.pdb") for name in MANY_OF]
    files = [write(s, folder / f"{name}.pdb") for name, s in models.damaged(structures, n, seed=1)]
    chosen = files[:: max(1, n // sample)][:sample]
    seconds = by_openmm(chosen[::2], scratch)
    program = [PROGRAM, "relax", str(folder), "-o", str(ends), "--workers", "2"]
    began = perf_counter()
    done = subprocess.run(
        [*program, "--threads", "1"], capture_output=True, text=True, env=made.surroundings()
    )
    ours = perf_counter() - began
    seconds += by_openmm(chosen[1::2], scratch)
    theirs = seconds * n / len(chosen)
    table = pd.read_csv(ends / "relaxed.csv").copy()
    statuses = table["status"].fillna("failed").value_counts()
    ended = ", ".join(f"{k} {name}" for name, k in statuses.items())
    row = {
        "models": n, "rows": len(table), "statuses": ended, "exit": done.returncode,
        "residues_with_violations_start": table["violations_start"].sum(),
        "residues_with_violations_end": table["violations_end"].sum(),
        "seconds_relax": ours, "models_an_hour_relax": 3600 * n / ours,
        "sample_openmm": len(chosen), "seconds_openmm_scaled": theirs,
        "models_an_hour_openmm": 3600 * n / theirs, "times_sooner": theirs / ours, "load": os.getloadavg()[1],
    }  # fmt: skip
    print(done.stderr[-1000:], file=sys.stderr)
    table["message"] = table["message"].str.replace(f"{folder}/", "")
    return table[list(KEPT)], pd.DataFrame([row])


def by_openmm(files: list[Path], scratch: Path) -> float:
    """Seconds for some models, two processes of one thread, without counting violations."""
    began = perf_counter()
    with ThreadPoolExecutor(2) as pool:
        ends = [scratch / f"openmm-{path.name}" for path in files]
        arguments = [command("openmm", path, end, threads=1) for path, end in zip(files, ends, strict=True)]
        runs = list(pool.map(run, arguments))
    counting = sum(r.told.get("seconds_counting", 0.0) for r in runs)
    return perf_counter() - began - counting / 2


def parser() -> argparse.ArgumentParser:
    own = made.parser(__doc__)
    own.add_argument("models", nargs="*", type=Path, metavar="MODEL")
    own.add_argument("--made", type=int, default=7, help="damaged copies of samples")
    own.add_argument("--repeats", type=int, default=3)
    own.add_argument("--many", type=int, metavar="N", help="throughput of N models instead")
    own.add_argument("--sample", type=int, default=20, help="models of these that OpenMM relaxes")
    return own


def main() -> None:
    options = parser().parse_args()
    if options.quick:
        options.models, options.made, options.repeats, options.sample = [], 1, 1, 2
        options.many = options.many and 4
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:2])
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch)
        if options.many:
            rows, found = throughput(options.many, options.sample, place)
            name = "relax_throughput.csv"
            print(found.T.to_string(header=False))
        else:
            files = options.models + made_models(place / "models", options.made)
            small = write(pc.load(SAMPLES / "1l2y.pdb"), place / "warm.pdb")
            for way in WAYS:  # compiled kernels, files in memory
                run(command(way, small, place / f"warm-{way}.pdb"))
            print(f"| {' | '.join(HEADINGS)} |\n|---|{'--:|' * (len(HEADINGS) - 1)}")
            found, name = compare(files, options.repeats, place), "relax.csv"
            print(f"\n{summary(found)}")
    if options.output:
        given = options.models or [f"{options.many or options.made} damaged copies of samples"]
        made.write(found.round(4), options.output / name, given, 2)
        if options.many:
            made.write(rows, options.output / "relax_many.csv", given, 2)


if __name__ == "__main__":
    main()
