"""Kinds of file that people bring: what was lost, said and changed, and whether results are read again equal.

    python analysis/benchmarks/kinds.py [-o DIR] [--quick] [--only FAMILY ...] [--processes N]

Each kind of analysis/bench/files/file_kinds.py is made anew, read, prepared, relaxed for at most 100
iterations, written as PDB and mmCIF, and read again (analysis/bench/files/fate.py); a row a kind. Those that
need files beside the repository are left out where these are not there. Structures of more than 3000 atoms
are not relaxed.
"""

import argparse
import tempfile
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from time import perf_counter

import made
import pandas as pd

from bench.files import fate, file_kinds

ITERATIONS = 100
LONGEST = 400
"""Characters of a cell."""


def row(name: str) -> dict[str, object]:
    """What became of one kind, a traceback included."""
    kind = next(kind for kind in file_kinds.KINDS if kind.name == name)
    began = perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        path, meant = kind.make(Path(folder))
        try:
            found = fate.fate(path, meant, ITERATIONS, kind.options)
            wrong = fate.faults(found, path.name, kind.refused, kind.links, kind.keeps)
        except Exception as error:
            found, wrong = fate.Fate(status="traceback"), [f"traceback: {error!r}"]
    out: dict[str, object] = {
        "kind": kind.name, "family": kind.family, "origin": "made" if kind.is_made else "real",
        "status": found.status, "refusal": found.refusal.replace(f"{path.parent}/", ""),
    }  # fmt: skip
    for name in ("residues", "atoms", "molecules"):
        out[f"{name}_in"], out[f"{name}_out"] = getattr(found, name)
    out |= {
        "lost": told("/".join(place) for place in found.lost),
        "lost_not_said": len(found.unsaid),
        "left_out": told(f"{count} {what}" for what, count in found.left_out.items()),
        "names_changed": told(f"{count} {what}" for what, count in found.renamed.items()),
        "elements_changed": told(found.elements),
        "heavy_atoms_added": found.added_heavy, "hydrogens_added": found.added_hydrogens,
        "hydrogens_lost": found.lost_hydrogens, "heavy_atoms_moved": found.moved,
    }  # fmt: skip
    out["charge_in"], out["charge_in_pdb"], out["charge_in_mmcif"] = found.charge
    out |= {
        "bonds_beside": told("-".join("/".join(place) for place in pair) for pair in found.links),
        "metal_bonds": len(found.metal), "bonds_odd": told(found.strange),
        "bonds_not_made": told(found.unmade), "stereocentres_changed": told(found.hands),
        "cis_in": found.cis[0], "cis_out": found.cis[1], "twisted_in": found.twisted[0],
        "twisted_out": found.twisted[1], "peptides_turned": told(found.turned),
        "ids_lost": told(found.ids), "energy_kj_mol": found.stated or None,
    }  # fmt: skip
    for suffix, name in ((".pdb", "pdb"), (".cif", "mmcif")):
        here, there = found.energy.get(suffix, (None, None))
        out[f"energy_{name}_kj_mol"], out[f"energy_{name}_again_kj_mol"] = here, there
        known = here is not None and there is not None
        out[f"difference_{name}"] = abs(there - here) / max(abs(here), 1.0) if known else None
        out[f"differs_{name}"] = found.again.get(suffix, "")
    out |= {
        "metal_drift_angstrom": round(found.drift, 3), "changed": " | ".join(found.changes),
        "said": " ".join(found.said), "faults": len(wrong),
        "wrong": told(wrong), "seconds": round(perf_counter() - began, 2),
    }  # fmt: skip
    return {name: one_line(value) for name, value in out.items()}


def told(lines: Iterable[str]) -> str:
    """Some lines as one, the first of them if there are many."""
    given = list(lines)
    return "; ".join(given[:8]) + (f"; and {len(given) - 8} more" if len(given) > 8 else "")


def one_line(value: object) -> object:
    return " ".join(value.split())[:LONGEST] if isinstance(value, str) else value


FAMILIES = tuple(dict.fromkeys(kind.family for kind in file_kinds.KINDS))


def parser() -> argparse.ArgumentParser:
    own = made.parser(__doc__)
    own.add_argument("--processes", type=int, default=1, metavar="N", help="kinds at once; 1")
    own.add_argument("--every", type=int, default=1, metavar="N", help="each Nth kind; 1")
    own.add_argument("--only", nargs="+", metavar="FAMILY", choices=FAMILIES, help=", ".join(FAMILIES))
    return own


def main() -> None:
    options = parser().parse_args()
    families = options.only or FAMILIES
    chosen = [kind for kind in file_kinds.KINDS if kind.is_here and kind.family in families][:: options.every]
    if options.quick:
        chosen = [kind for kind in chosen if kind.name in ("plain", "sep", "covalent-stated", "c-alphas")]
    rows = []
    with ProcessPoolExecutor(options.processes) as pool:
        for each in pool.map(row, [kind.name for kind in chosen]):
            rows.append(each)
            print(f"{each['family']:24} {each['kind']:44} {each['status']:12} {each['wrong']}", flush=True)
    table = pd.DataFrame(rows)
    refused, wrong = (table["refusal"] != "").sum(), (table["faults"] > 0).sum()
    unsaid, tracebacks = (table["lost_not_said"] > 0).sum(), (table["status"] == "traceback").sum()
    print(f"{len(table)} kinds: {refused} refused, {wrong} with faults, {tracebacks} tracebacks,", end=" ")
    print(f"{unsaid} with atoms lost that are not named")
    if options.output:
        inputs = ["kinds of analysis/bench/files/file_kinds.py"]
        made.write(table, options.output / "kinds.csv", inputs, options.processes)


if __name__ == "__main__":
    main()
