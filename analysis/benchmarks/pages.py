"""The tables of README.md and analysis/README.md, from the tables of analysis/results.

    python analysis/benchmarks/pages.py [--check]

A table of a page stands between `<!-- table NAME -->` and `<!-- end -->`, and is made anew by the function of
that name. With --check nothing is written, and the exit status is 1 if a page and its results differ.
"""

import argparse
import re
import sys
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

import pandas as pd
from made import RECORD, RESULTS, ROOT

PAGES = (ROOT / "README.md", ROOT / "analysis" / "README.md")
MARKED = re.compile(r"(<!-- table ([\w-]+) -->\n)(.*?)(<!-- end -->)", re.DOTALL)
TABLES: dict[str, Callable[[Path], str]] = {}


def table(name: str) -> Callable[[Callable[[Path], str]], Callable[[Path], str]]:
    """Register what makes a table of a page from the folder of results."""

    def register(make: Callable[[Path], str]) -> Callable[[Path], str]:
        TABLES[name] = make
        return make

    return register


def markdown(headings: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """A table of Markdown, its first column text and the others numbers, aligned right."""
    head = list(headings)
    lines = [f"| {' | '.join(head)} |", "|---|" + "--:|" * (len(head) - 1)]
    lines += [f"| {' | '.join(map(str, row))} |" for row in rows]
    return "\n".join(lines) + "\n"


def ratio(value: float) -> str:
    """A ratio as it is quoted: two digits, never for zero."""
    return "never" if not value > 0 else f"{value:.2g}x" if value < 9.95 else f"{value:.0f}x"


def made(results: Path, name: str) -> str:
    """A sentence that says how a table of results was made."""
    record = pd.read_csv(results / RECORD, dtype=str, keep_default_na=False).set_index("table")
    row = record.loc[name]
    machine = f"{row['machine']}, {row['threads']} threads, load {row['load']}"
    return f"[results/{name}](results/{name}): `{row['command']}` at commit {row['commit']} ({machine}).\n"


@table("race-medians")
def race_medians(results: Path) -> str:
    """Median ratios of the race, by force and tolerance."""
    races = pd.concat(pd.read_csv(path) for path in sorted(results.glob("race_*.csv")))
    forces = {"gbsa": "OBC2, GBSAOBCForce", "obc2": "OBC2, CustomGBForce", "gbn2": "GBn2", "vacuum": "vacuum"}
    rows = []
    for (force, tolerance), of in races.groupby(["force", "tolerance"]):
        cells = [forces[force], f"{tolerance:g}"]
        for method in ("cartesian", "hybrid"):
            own = of[of["method"] == method]
            cells += [ratio(own["stop"].median()), ratio(own["passage"].median())]
            cells += [f"{(own['stop'] > 1).sum()} of {len(own)}"]
        rows.append(cells)
    return markdown(
        ("OpenMM's force", "tolerance kJ/mol/nm", "`cartesian`, to its stop", "to passage", "first",
         "`hybrid`, to its stop", "to passage", "first"), rows,
    )  # fmt: skip


@table("race-made")
def race_made(results: Path) -> str:
    """How the race was run."""
    return "\n".join(made(results, path.name) for path in sorted(results.glob("race_*.csv")))


@table("engines")
def engines(results: Path) -> str:
    """One energy, native against OpenMM."""
    rows = pd.read_csv(results / "engines.csv")
    return markdown(
        ("structure", "atoms", "OpenMM's force", "OpenMM CPU ms", "native ms", "ratio", "ns per pair",
         "times the floor"),
        ((r.structure, r.atoms, r.solvent, f"{r.openmm_ms:.2f}", f"{r.native_ms:.2f}", ratio(r.ratio),
          f"{r.ns_a_pair:.2f}", f"{r.times_the_floor:.1f}") for r in rows.itertuples()),
    )  # fmt: skip


@table("engines-short")
def engines_short(results: Path) -> str:
    """Ratios of one energy by structure."""
    rows = pd.read_csv(results / "engines.csv").pivot(
        index=["atoms", "structure"], columns="solvent", values="ratio"
    )
    forces = ("vacuum", "OBC2", "OBC2, GBSAOBCForce", "GBn2")
    return markdown(
        ("structure", "atoms", *forces),
        ((name, atoms, *(ratio(row[force]) for force in forces)) for (atoms, name), row in rows.iterrows()),
    )


@table("threads")
def threads(results: Path) -> str:
    """One energy on one thread and on two, beside other work."""
    rows = pd.read_csv(results / "threads.csv")
    return markdown(
        ("structure", "atoms", "cores busy with other work", "one thread ms", "two ms", "two over one"),
        ((r.structure, r.atoms, r.cores_busy, f"{r.one_thread_ms:.2f}", f"{r.two_threads_ms:.2f}",
          f"{r.ratio:.2f}") for r in rows.itertuples()),
    )  # fmt: skip


@table("startup")
def startup(results: Path) -> str:
    """Shell to shell, with kernels to compile and without."""
    rows = pd.read_csv(results / "startup.csv")
    return markdown(
        ("command", "state", "s", "processor s"),
        ((f"`{r.command}`", r.state, f"{r.seconds:.1f}", f"{r.cpu_seconds:.1f}") for r in rows.itertuples()),
    )


def _more(ours: float, theirs: float) -> str:
    """Difference of energies, kJ/mol; none without one of them."""
    return "-" if pd.isna(ours) or pd.isna(theirs) else f"{ours - theirs:+.0f}"


@table("relax")
def relax(results: Path) -> str:
    """Relaxation beside AlphaFold's."""
    rows = pd.read_csv(results / "relax.csv")
    return markdown(
        ("model", "residues", "violations", "after OpenMM", "after `relax`", "RMSD angstrom, OpenMM",
         "`relax`", "ff14SB, OBC2, kJ/mol", "amber99sb, kJ/mol", "OpenMM s", "`relax` s", "sooner",
         "less CPU"),
        ((r.model, r.residues, r.violations_start, int(r.violations_openmm), int(r.violations_relax),
          f"{r.ca_rmsd_angstrom_openmm:.2f}", f"{r.ca_rmsd_angstrom_relax:.2f}",
          _more(r.energy_ff14sb_obc2_relax, r.energy_ff14sb_obc2_openmm),
          _more(r.energy_amber99sb_vacuum_relax_alphafold, r.energy_amber99sb_vacuum_openmm),
          f"{r.seconds_openmm:.1f}", f"{r.seconds_relax:.2f}", ratio(r.times_sooner), ratio(r.times_less_cpu))
         for r in rows.itertuples()),
    )  # fmt: skip


@table("relax-short")
def relax_short(results: Path) -> str:
    """Relaxation beside AlphaFold's, for the README."""
    rows = pd.read_csv(results / "relax.csv")
    return markdown(
        ("model", "residues", "sooner", "violations", "after OpenMM", "after `relax`",
         "RMSD angstrom, OpenMM", "`relax`"),
        ((r.model, r.residues, ratio(r.times_sooner), r.violations_start, int(r.violations_openmm),
          int(r.violations_relax), f"{r.ca_rmsd_angstrom_openmm:.2f}", f"{r.ca_rmsd_angstrom_relax:.2f}")
         for r in rows.itertuples()),
    )  # fmt: skip


for _name in ("engines", "threads", "startup"):
    TABLES[f"{_name}-made"] = partial(made, name=f"{_name}.csv")


def rendered(page: str, results: Path) -> str:
    """A page with its tables made from a folder of results.

    Raises
    ------
    KeyError
        If the page marks a table that nothing makes.
    """
    return MARKED.sub(lambda found: found[1] + TABLES[found[2]](results) + found[4], page)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", action="store_true", help="only say which pages differ")
    options = parser.parse_args()
    differ = []
    for page in PAGES:
        text = page.read_text()
        new = rendered(text, RESULTS)
        if new != text:
            differ.append(page)
            if not options.check:
                page.write_text(new)
    verb = "differs from" if options.check else "made from"
    for page in differ:
        print(f"{page.relative_to(ROOT)}: {verb} analysis/results")
    sys.exit(1 if options.check and differ else 0)


if __name__ == "__main__":
    main()
