"""Normal modes in torsions beside elastic networks: changes between crystals, B factors, cost.

    python analysis/benchmarks/modes.py [CRYSTAL ...] [--pairs DIR] [--only TABLE ...] [-o DIR] [--quick]

modes_pairs.csv: share of the change between two crystals, of C-alphas, that ten modes have together; from
minima of the force field in phi, psi and chi, and of Tirion's network in the same torsions, both here, and by
networks of C-alphas of ProDy (ANM, 15 angstrom) and springcraft (Hinsen), where they are installed. Crystals
of pairs are looked for in structures/ and DIR by their names, 1omp.pdb or 1omp.pdb.gz; absent ones are named.
modes_b_factors.csv: correlation with B factors of C-alphas in the files. modes_cost.csv: seconds of a
processor, one thread, and memory of a process that is given the structure, at a minimum or, of --as-is, as it
is. modes_steps.csv: longest step of the leapfrog at which cold runs do not heat up, by bisection, beside 2/w.
"""

import argparse
import multiprocessing
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from pathlib import Path
from time import perf_counter, process_time

import made
import numpy as np
import pandas as pd
from made import SAMPLES
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

import protochain as pc

prody = springcraft = None
# Processes that measure their memory know nothing of others' libraries.
if multiprocessing.parent_process() is None:
    with suppress(ImportError):
        import prody
        import springcraft
        from biotite.structure import AtomArray

PAIRS = (
    ("adenylate kinase", "4ake", "A", "1ake", "A"),
    ("glutamate receptor 1, ligand-binding", "1ewk", "B", "1ewk", "A"),
    ("glutamate receptor A3, amino-terminal", "3p3w", "A", "3o21", "B"),
    ("maltose-binding protein", "1omp", "A", "1anf", "A"),
    ("lysine-arginine-ornithine-binding", "2lao", "A", "1lst", "A"),
    ("glutamine-binding protein", "1ggg", "A", "1wdn", "A"),
    ("ribose-binding protein", "1urp", "A", "2dri", "A"),
)
"""Name, entry and chain of the open form, of the closed one."""
COUNT = 10
CONTACT = 0.5
"""nm. Between heavy atoms that Tirion's network joins: Phys. Rev. Lett. 77:1905 (1996)."""
CRYSTALS = ("1ubq", "4pti", "3i40", "1hel", "1ejg")
TOLERANCE = 0.1
SIZES = ("1l2y", "1ubq", "1hel")
STEPPED = ("1l2y", "1vii", "1ubq")
BISECTIONS, COLD_STEPS = 6, 400
TABLES = ("cost", "steps", "b_factors", "pairs")


class Tirion:
    """Springs between heavy atoms that touch, at rest as they are; kJ/mol, nm."""

    def __init__(self, structure: pc.Structure) -> None:
        heavy = np.flatnonzero(structure.atom_element != "H")
        self.pairs = heavy[cKDTree(structure.positions[heavy]).query_pairs(CONTACT, output_type="ndarray")]
        i, j = self.pairs.T
        self.rest = np.linalg.norm(structure.positions[i] - structure.positions[j], axis=1)

    def __call__(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Energy and forces."""
        i, j = self.pairs.T
        apart = x[i] - x[j]
        length = np.linalg.norm(apart, axis=1)
        stretch = 1000.0 * (length - self.rest)
        pull = (stretch / length)[:, None] * apart
        force = np.zeros_like(x)
        np.add.at(force, i, -pull)
        np.add.at(force, j, pull)
        return 0.5 * float(np.sum(stretch * (length - self.rest))), force


def read(entry: str, chain: str, folders: list[Path]) -> pc.Structure | None:
    """Load a chain of an entry, if there is a file of it."""
    for folder in folders:
        for path in sorted(folder.glob(f"{entry}*")):
            if path.name.removesuffix(".gz") in (f"{entry}.pdb", f"{entry}.cif"):
                return pc.load(path, chains=chain)
    return None


def alphas(structure: pc.Structure) -> np.ndarray:
    """(n, 3) float, angstrom: C-alphas."""
    return 10.0 * structure.positions[structure.alpha_carbons]


def of_prody(structure: pc.Structure, count: int) -> np.ndarray:
    """(k, n, 3) float: modes of ProDy's ANM."""
    network = prody.ANM("network")
    network.buildHessian(alphas(structure), cutoff=15.0)
    network.calcModes(count)
    return network.getEigvecs().T.reshape(count, -1, 3)


def of_springcraft(structure: pc.Structure, count: int) -> np.ndarray:
    """(k, n, 3) float: modes of springcraft with Hinsen's springs."""
    atoms = AtomArray(len(structure.alpha_carbons))
    atoms.coord = alphas(structure).astype(np.float32)
    atoms.atom_name[:], atoms.element[:] = "CA", "C"
    network = springcraft.ANM(atoms, springcraft.HinsenForceField())
    vectors = network.eigen()[1]
    return np.array(vectors[6 : 6 + count]).reshape(count, -1, 3)


def ten(of: np.ndarray, structure: pc.Structure, other: pc.Structure) -> float:
    """Share of the change to another crystal in the span of modes, without rigid motions."""
    mine, here, there = matched(structure, other)
    whole = rigid(here)
    change = (there - here).ravel()
    change -= whole @ (whole.T @ change)
    modes = of[:, mine].reshape(len(of), -1)
    modes = modes - (modes @ whole) @ whole.T
    basis = np.linalg.qr(modes.T)[0]
    return float(np.linalg.norm(change @ basis) / np.linalg.norm(change))


def matched(one: pc.Structure, other: pc.Structure) -> tuple[np.ndarray, ...]:
    """Places of C-alphas of the same residue number and name, and their positions, superposed."""
    first, second = ({name: k for k, name in enumerate(residues(s))} for s in (one, other))
    common = sorted(first.keys() & second.keys())
    mine, its = (np.array([place[name] for name in common]) for place in (first, second))
    here, there = alphas(one)[mine], alphas(other)[its]
    turn, shift = kabsch(there, here)
    return mine, here, there @ turn.T + shift


def residues(structure: pc.Structure) -> list[tuple[int, str]]:
    """Number and name of the residue of each C-alpha."""
    of = structure.atom_residue[structure.alpha_carbons]
    return [*zip(structure.residue_number[of].tolist(), structure.residue_name[of].tolist(), strict=True)]


def kabsch(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and shift that bring a onto b: Kabsch (1976)."""
    u, _, v = np.linalg.svd((a - a.mean(axis=0)).T @ (b - b.mean(axis=0)))
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))])
    turn = v.T @ flip @ u.T
    return turn, b.mean(axis=0) - turn @ a.mean(axis=0)


def rigid(x: np.ndarray) -> np.ndarray:
    """(3n, 6) float: orthonormal basis of the rigid motions of points."""
    arms = x - x.mean(axis=0)
    columns = [np.tile(e, (len(x), 1)) for e in np.eye(3)] + [np.cross(e, arms) for e in np.eye(3)]
    return np.linalg.qr(np.array([c.ravel() for c in columns]).T)[0]


def own(structure: pc.Structure, count: int) -> dict[str, pc.NormalModes]:
    """Modes of the force field at its minimum, and of Tirion's network at the crystal."""
    minimum = pc.minimise(structure, method="lbfgs", tolerance=TOLERANCE)
    return {
        "force_field": pc.normal_modes(minimum, k=count),
        "tirion": pc.normal_modes(pc.build_chain(structure), Tirion(structure), k=count, method="dense"),
    }


def pairs(folders: list[Path]) -> Iterator[dict[str, object]]:
    """Cumulative overlaps, of both directions of each pair."""
    for name, *ends in PAIRS:
        found = [read(*ends[k : k + 2], folders) for k in (0, 2)]
        if None in found:
            print(f"{name}: no file of {ends[0]} or {ends[2]} in {', '.join(map(str, folders))}", flush=True)
            continue
        labels = [f"{ends[k]}:{ends[k + 1]}" for k in (0, 2)]
        for a, b in ((0, 1), (1, 0)):
            start, end = found[a], found[b]
            _, here, there = matched(start, end)
            rmsd = float(np.sqrt(np.mean(np.sum((there - here) ** 2, axis=1))))
            row: dict[str, object] = {"pair": name, "start": labels[a], "end": labels[b]}
            row |= {"residues": start.n_residues, "rmsd_angstrom": rmsd}
            began = perf_counter()
            for method, modes in own(start, COUNT).items():
                row |= {f"first_{method}": float(modes.overlap(end)[0])}
                row |= {f"ten_{method}": float(modes.cumulative_overlap(end)[-1])}
            row["seconds"] = perf_counter() - began
            for method, make in (("prody", of_prody), ("springcraft", of_springcraft)):
                if prody is None:
                    continue
                vectors = make(start, COUNT)
                row |= {
                    f"first_{method}": ten(vectors[:1], start, end),
                    f"ten_{method}": ten(vectors, start, end),
                }
            print(*(f"{v:.3g}" if isinstance(v, float) else v for v in row.values()), flush=True)
            yield row


def b_factors(paths: list[Path]) -> Iterator[dict[str, object]]:
    """Correlations of fluctuations of C-alphas with B factors in the files."""
    for path in paths:
        structure = pc.load(path)
        filed = structure.b_factor[structure.alpha_carbons]
        known = filed > 0.0
        row: dict[str, object] = {"structure": path.name.partition(".")[0], "residues": int(known.sum())}
        began = perf_counter()
        for method, modes in own(structure, 100).items():
            row[method] = np.nan
            try:
                squares = modes.mean_squares()[structure.alpha_carbons]
                row[method] = float(np.corrcoef(squares[known], filed[known])[0, 1])
            except pc.ProtochainError as error:
                print(f"{method}: {error}", flush=True)
        row["seconds"] = perf_counter() - began
        if prody is not None:
            for method, network in (("prody_anm", prody.ANM("a")), ("prody_gnm", prody.GNM("g"))):
                build = network.buildHessian if method == "prody_anm" else network.buildKirchhoff
                build(alphas(structure), cutoff=15.0 if method == "prody_anm" else 10.0)
                network.calcModes(None)
                squares = prody.calcSqFlucts(network)
                row[method] = float(np.corrcoef(squares[known], filed[known])[0, 1])
        print(*(f"{v:.3g}" if isinstance(v, float) else v for v in row.values()), flush=True)
        yield row


def cost(relaxed: list[Path], as_is: list[str]) -> Iterator[dict[str, object]]:
    """Cost of twenty modes of structures, of which some are minimised first."""
    for path in relaxed:
        minimum = pc.minimise(pc.load(path), method="lbfgs", tolerance=TOLERANCE)
        yield shown({"structure": path.name.partition(".")[0], **in_process(minimum.structure)})
    for given in as_is:
        file, _, chains = given.partition(":")
        structure = pc.load(file, **({"chains": chains} if chains else {}))
        name = Path(file).name.partition(".")[0] + (f", {chains}" if chains else "")
        yield shown({"structure": name, **in_process(structure)})


def shown(row: dict[str, object]) -> dict[str, object]:
    print(*(f"{v:.3g}" if isinstance(v, float) else v for v in row.values()), flush=True)
    return row


def in_process(structure: pc.Structure) -> dict[str, object]:
    """Cost of twenty modes, in a process of its own, of one thread."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(one_cost, structure).result()


def one_cost(structure: pc.Structure) -> dict[str, object]:
    """Seconds of a processor of twenty modes and of one evaluation, and the largest memory."""
    pc.normal_modes(pc.load(sample("ala10")), k=20)  # loads what is compiled
    chain, energy = pc.build_chain(structure, root="free"), pc.energy(structure, threads=1)
    energy(structure.positions)
    began = process_time()
    energy(structure.positions)
    single, began, wall = process_time() - began, process_time(), perf_counter()
    modes = pc.normal_modes(chain, energy, k=20)
    return {
        "residues": structure.n_residues, "freedoms": modes.n_freedoms, "minimum": modes.is_minimum,
        "seconds": process_time() - began, "wall_seconds": perf_counter() - wall,
        "evaluation_seconds": single, "peak_mb": highest(), "residual": float(modes.residuals.max()),
    }  # fmt: skip


def highest() -> float:
    """Largest memory of this process, MB: what getrusage has is also that of the process that began it."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmHWM")).split()[1]) / 1024.0


def steps(names: tuple[str, ...]) -> Iterator[dict[str, object]]:
    """Longest stable steps at minima, found by cold runs, beside 2/w of the fastest mode."""
    for name in names:
        minimum = pc.minimise(pc.load(sample(name)), method="lbfgs", tolerance=0.01)
        chain = pc.build_chain(minimum.structure, root="free")
        energy = pc.energy(chain.structure, threads=1)
        known = pc.normal_modes(chain, energy, k=1).largest_stable_step

        def stable(time_step: float, chain: pc.Chain = chain, energy: object = energy) -> bool:
            run = pc.simulate(
                chain, energy, temperature=1e-6, thermostat="none", time_step=time_step, n_steps=COLD_STEPS,
                every=COLD_STEPS,
            )  # fmt: skip
            first, last = (run.rows[k]["kinetic_kj_mol"] for k in (0, -1))
            return run.ending == "completed" and last < 1e4 * first

        found = bisected(stable, 0.8 * known, 1.25 * known)
        row = {"structure": name, "hinges": chain.n_hinges, "predicted_fs": 1e3 * known}
        yield shown({**row, "found_fs": 1e3 * found, "ratio": found / known})


def bisected(stable: Callable[[float], bool], low: float, high: float) -> float:
    """Geometric mean of the longest stable step and the shortest one that is not."""
    assert stable(low)
    assert not stable(high)
    for _ in range(BISECTIONS):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if stable(middle) else (low, middle)
    return float(np.sqrt(low * high))


def sample(name: str) -> Path:
    return next(path for path in sorted(SAMPLES.glob(f"{name}.pdb*")))


def parser() -> argparse.ArgumentParser:
    ours = made.parser(__doc__)
    ours.add_argument("crystals", nargs="*", type=Path, default=[sample(name) for name in CRYSTALS])
    ours.add_argument("--pairs", type=Path, help="folder of the crystals of pairs")
    ours.add_argument(
        "--large", nargs="*", type=Path, default=[], help="more structures to minimise and time"
    )
    ours.add_argument("--as-is", nargs="*", default=[], metavar="FILE[:CHAINS]", help="more, not minimised")
    ours.add_argument("--only", nargs="*", choices=TABLES, default=TABLES, help="tables; all by default")
    return ours


def main() -> None:
    options = parser().parse_args()
    with suppress(AttributeError):
        prody.confProDy(verbosity="none")
    if options.quick:
        options.crystals = [sample("4pti")]
    folders = [SAMPLES, *([options.pairs] if options.pairs else [])]
    sizes = [sample(name) for name in (SIZES[:2] if options.quick else SIZES)] + options.large
    stepped = STEPPED[:1] if options.quick else STEPPED
    made_by = {
        "cost": lambda: cost(sizes, options.as_is),
        "steps": lambda: steps(stepped),
        "b_factors": lambda: b_factors(options.crystals),
        "pairs": lambda: pairs(folders),
    }
    inputs = {"cost": [*sizes, *options.as_is], "steps": [sample(name) for name in stepped]}
    for name in options.only:
        if name == "pairs" and options.quick:
            continue
        rows = []
        with threadpool_limits(1, "blas"):
            for row in made_by[name]():
                rows.append(row)
                # Large structures come last, and take long.
                if options.output:
                    given = inputs.get(name, options.crystals)
                    made.write(pd.DataFrame(rows), options.output / f"modes_{name}.csv", given)
        print(pd.DataFrame(rows).round(3).to_string(index=False))


if __name__ == "__main__":
    main()
