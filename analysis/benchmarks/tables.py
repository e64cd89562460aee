"""What makes each table and paragraph of the pages from the tables of results; put there by pages.py."""

import textwrap
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pandas as pd
from made import RECORD

WHERE = ("machine", "versions")
TABLES: dict[str, Callable[[Path], str]] = {}
Cell = str | Callable[[pd.Series], str]


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


def of_rows(rows: pd.DataFrame, *columns: tuple[str, Cell]) -> str:
    """A table of Markdown: each column a heading, and a format of a row's fields or a function of the row.

    What is not a number is "-", what is infinite "never".
    """

    def cell(row: pd.Series, made_by: Cell) -> str:
        text = made_by.format(**row) if isinstance(made_by, str) else made_by(row)
        return {"nan": "-", "nanx": "-", "inf": "never"}.get(text, text)

    body = ([cell(row, made_by) for _, made_by in columns] for _, row in rows.iterrows())
    return markdown([heading for heading, _ in columns], body)


def paragraph(*sentences: str) -> str:
    """Sentences as a paragraph of a page."""
    return textwrap.fill(" ".join(sentences), 140, break_long_words=False, break_on_hyphens=False) + "\n"


def ratio(value: float) -> str:
    """A ratio as it is quoted: two digits, never for zero."""
    if not value > 0:
        return "never"
    return f"{value:.2g}x" if value < 0.995 else f"{value:.1f}x" if value < 9.95 else f"{value:.0f}x"


def ratio_of(name: str) -> Cell:
    """Column of ratios."""
    return lambda row: "-" if pd.isna(row[name]) else ratio(row[name])


def digits(value: float) -> str:
    """A time or rate with three digits."""
    if not np.isfinite(value):
        return "-" if np.isnan(value) else "never"
    return f"{value:.0f}" if value >= 99.95 else f"{value:.1f}" if value >= 9.995 else f"{value:.2f}"


def between(values: pd.Series, unit: str = "") -> str:
    """A range of counts or ratios, in whole numbers from ten on."""
    low, high = (f"{v:.0f}" if v >= 9.95 else f"{v:.1f}" for v in (values.min(), values.max()))
    return f"{low} to {high}{unit}"


@table("made")
def made(results: Path) -> str:
    """How every table was made."""
    record = pd.read_csv(results / RECORD, dtype=str, keep_default_na=False)
    lines = ["| table | command | commit | threads | load |", "|---|---|---|--:|--:|"]
    for r in record.itertuples():
        cells = (f"[{r.table}](results/{r.table})", f"`{r.command}`", r.commit, r.threads, r.load)
        lines.append(f"| {' | '.join(cells)} |")
    machines, versions = ("; ".join(filter(None, dict.fromkeys(record[k]))) for k in WHERE)
    said = paragraph(f"{machines}; {versions}.", _old(results))
    return "\n".join([*lines, "", said])


def _old(results: Path) -> str:
    """Which tables are typed, for their results are not there."""
    names = []
    for name, make in TABLES.items():
        try:
            if make is not made:
                make(results)
        except FileNotFoundError:
            names.append(name)
    if not names:
        return ""
    return (
        "Without a record, and typed as measured with earlier versions, in which minimisers and energies were"
        f" slower: {', '.join(names)}."
    )


# Minimisers


TORSIONS = ("kcm", "kcm-adaptive", "kcm-metric", "kcm-stiffness", "newton", "lbfgs")
CARTESIAN = ("cartesian", "hybrid", "openmm")


def _needed(results: Path, cost: str) -> pd.DataFrame:
    """Median and quartiles by method and level, as quoted."""
    rows = pd.read_csv(results / "precision.csv")
    rows = rows[rows["cost"] == cost].set_index(["method", "above_kj_mol_per_100_residues"])

    def shown(row: pd.Series) -> str:
        number = (lambda v: f"{v:.0f}" if np.isfinite(v) else "never") if cost == "evaluations" else digits
        middle, low, high = (number(row[name]) for name in ("median", "first_quartile", "third_quartile"))
        return middle if low == high == "never" else f"{middle} ({low} to {high})"

    return rows.assign(shown=rows.apply(shown, axis=1))["shown"].unstack()


def _ends(results: Path) -> pd.DataFrame:
    """Runs that converged, of how many, median RMSD, and ends near the lowest, by method."""
    ends = pd.read_csv(results / "precision_ends.csv")
    of = ends.groupby("method")
    done = of["status"].apply(lambda s: f"{(s == 'converged').sum()} of {len(s)}")
    return pd.DataFrame({"converged": done, "rmsd": of["ca_rmsd_angstrom"].median(), "lowest": _lowest(ends)})


def _lowest(ends: pd.DataFrame) -> pd.Series:
    """In how many structures each method ends within 1 kJ/mol per 100 residues of the lowest of its kind."""
    kind = ends["method"].isin(CARTESIAN)
    energy = ends["energy_end_reference_kj_mol"]
    above = (energy - energy.groupby([ends["structure"], kind]).transform("min")) * 100.0 / ends["residues"]
    return (above <= 1.0).groupby(ends["method"]).sum()


@table("precision")
def precision(results: Path) -> str:
    """Evaluations and seconds to within levels, and how runs ended."""
    needed, ends = _needed(results, "evaluations"), _ends(results)
    rows = [
        [
            f"`{m}`", *needed.loc[m, [100.0, 10.0, 1.0]], ends.loc[m, "converged"],
            str(ends.loc[m, "lowest"]), f"{ends.loc[m, 'rmsd']:.2f}",
        ]
        for m in (*TORSIONS, *CARTESIAN)
    ]  # fmt: skip
    rows.insert(len(TORSIONS), [""] * 7)
    levels = ("100 kJ/mol", "10 kJ/mol", "1 kJ/mol")
    first = markdown(("evaluations to within", *levels, "converged", "lowest", "RMSD angstrom"), rows)
    needed = _needed(results, "seconds")
    rows = [[f"`{m}`", *needed.loc[m, [100.0, 10.0, 1.0]]] for m in (*TORSIONS, *CARTESIAN)]
    rows.insert(len(TORSIONS), [""] * 4)
    return f"{first}\n{markdown(('seconds to within', *levels), rows)}"


@table("precision-short")
def precision_short(results: Path) -> str:
    """Medians to within 10 kJ/mol per 100 residues."""
    methods = ("kcm", "kcm-stiffness", "newton", "lbfgs", *CARTESIAN)
    rows = [[cost, *(_needed(results, cost).loc[m, 10.0].split(" (")[0] for m in methods)]
            for cost in ("evaluations", "seconds")]  # fmt: skip
    rows.append(["converged", *(_ends(results).loc[m, "converged"] for m in methods)])
    return markdown(("", *(f"`{m}`" for m in methods)), rows)


FORCES = {"gbsa": "OBC2, GBSAOBCForce", "obc2": "OBC2, CustomGBForce", "gbn2": "GBn2", "vacuum": "vacuum"}


def _races(results: Path) -> pd.DataFrame:
    paths = sorted(results.glob("race_*.csv"))
    if not paths:
        raise FileNotFoundError("race_*.csv")
    return pd.concat(pd.read_csv(path) for path in paths)


@table("race-medians")
def race_medians(results: Path) -> str:
    """Median ratios of the race, by force and tolerance."""
    rows = []
    for (force, tolerance), of in _races(results).groupby(["force", "tolerance"]):
        cells = [FORCES[force], f"{tolerance:g}"]
        for method in ("cartesian", "hybrid"):
            own = of[of["method"] == method]
            cells += [ratio(own["stop"].median()), ratio(own["passage"].median())]
            cells += [f"{(own['stop'] > 1).sum()} of {len(own)}"]
        rows.append(cells)
    return markdown(
        ("OpenMM's force", "tolerance kJ/mol/nm", "`cartesian`, to its stop", "to passage", "first",
         "`hybrid`, to its stop", "to passage", "first"), rows,
    )  # fmt: skip


@table("race-range")
def race_range(results: Path) -> str:
    """How much sooner ours are where they come as low, and how much higher they end where not."""
    lines = []
    for (force, tolerance), of in _races(results).groupby(["force", "tolerance"]):
        met = of[of["stop"] > 0]
        above = (of["end_kj_mol"] - of["openmm_end_kj_mol"])[of["stop"] == 0]
        line = f"- {FORCES[force]}, {tolerance:g} kJ/mol/nm: as low in {len(met)} of {len(of)} runs"
        line += f", {between(met['stop'])} times sooner" if len(met) else ""
        line += f"; in the others {between(above)} kJ/mol above OpenMM's end" if len(above) else ""
        lines.append(f"{line}.\n")
    return "".join(lines)


@table("metric")
def metric(results: Path) -> str:
    """Springs over near terms, medians."""
    rows = pd.read_csv(results / "metric.csv")
    costs = [f"{cost}_to_{above}" for above in (10, 1) for cost in ("evaluations", "seconds")]
    of = {name: part.set_index(["structure", "method"])[costs] for name, part in rows.groupby("metric")}
    medians = (of["springs"] / of["near terms"]).groupby("method").median()
    shown = markdown(
        (
            "method",
            *(f"{cost} to {above} kJ/mol" for above in (10, 1) for cost in ("evaluations", "seconds")),
        ),
        ((f"`{name}`", *map(ratio, row)) for name, row in medians.iterrows()),
    )
    ends = rows.pivot_table(index=["method", "structure"], columns="metric", values="end_kj_mol")
    above = (ends["near terms"] - ends["springs"]).groupby("method")
    ranges = ", ".join(
        f"{values.median():+.1f} ({values.min():+.0f} to {values.max():+.0f}) `{name}`"
        for name, values in above
    )
    n = rows["structure"].nunique()
    said = paragraph(
        f"Medians over {n} structures of the cost with springs over that with near terms, to within 10 and 1 "
        "kJ/mol per 100 residues of the end; seconds are processor seconds on one thread:"
    )
    ended = paragraph(
        f"The two end in different minima. Those by near terms lie higher by, in kJ/mol, {ranges}: medians "
        "and ranges."
    )
    return f"{said}\n{shown}\n{ended}"


@table("compliance-evaluations")
def compliance_evaluations(results: Path) -> str:
    """Evaluations to 1 kJ/mol/rad."""
    rows = pd.read_csv(results / "compliance_evaluations.csv")
    methods = [name for name in rows.columns if name not in ("structure", "hinges")]

    def count(name: str) -> Cell:
        return lambda r: "-" if pd.isna(r[name]) else f"{r[name]:.0f}" if np.isfinite(r[name]) else "> 4000"

    heads = [name if name == "L-BFGS-B" else f"`{name}`" for name in methods]
    columns = [(head, count(name)) for head, name in zip(heads, methods, strict=True)]
    return of_rows(rows, ("structure", "{structure}"), ("hinges", "{hinges}"), *columns)


@table("compliance-starts")
def compliance_starts(results: Path) -> str:
    """Where every setting ends from random starts."""
    of = pd.read_csv(results / "compliance_starts.csv").groupby("setting", sort=False)
    done = of["stop"].apply(lambda stop: 100 * (stop == "TOLERANCE").mean())
    rows = (
        (f"`{name.split(', ')[0]}`{', ' + name.split(', ')[1] if ', ' in name else ''}",
         f"{done[name]:.0f} %", "" if done[name] == 100 else digits(part.torque_end_kj_mol_rad.median()),
         f"{part.evaluations.median():.0f}")
        for name, part in of
    )  # fmt: skip
    return markdown(("variant", "converged", "median largest torque at the end", "median evaluations"), rows)


def small(name: str) -> Cell:
    """Column of numbers down to 1e-6, without exponents."""
    return lambda row: f"{row[name]:.2g}" if row[name] >= 1e-3 else f"{row[name]:.6f}"


@table("compliance-angles")
def compliance_angles(results: Path) -> str:
    """What a fixed angle leaves."""
    return of_rows(
        pd.read_csv(results / "compliance_angles.csv"),
        ("$h$, rad", "{angle_rad:g}"), ("largest torque left, kJ/mol/rad", "{torque_left_kj_mol_rad:.2g}"),
        ("energy left, kJ/mol", small("energy_left_kj_mol")),
        (r"$\tfrac12\kappa(h/2)^2$", small("predicted_kj_mol")),
        ("steps to within 1 kJ/mol", "{steps_to_1_kj_mol:.0f}"),
    )  # fmt: skip


# Relaxation


def _more(ours: float, theirs: float) -> str:
    """Difference of energies, kJ/mol; none without one of them."""
    return "-" if pd.isna(ours) or pd.isna(theirs) else f"{ours - theirs:+.0f}"


@table("relax")
def relax(results: Path) -> str:
    """Relaxation beside AlphaFold's."""
    return of_rows(
        pd.read_csv(results / "relax.csv"),
        ("model", "{model}"), ("residues", "{residues}"), ("violations", "{violations_start}"),
        ("after OpenMM", "{violations_openmm:.0f}"), ("after `relax`", "{violations_relax:.0f}"),
        ("RMSD angstrom, OpenMM", "{ca_rmsd_angstrom_openmm:.2f}"),
        ("`relax`", "{ca_rmsd_angstrom_relax:.2f}"),
        ("ff14SB, OBC2, kJ/mol", lambda r: _more(r.energy_ff14sb_obc2_relax, r.energy_ff14sb_obc2_openmm)),
        ("amber99sb, kJ/mol",
         lambda r: _more(r.energy_amber99sb_vacuum_relax_alphafold, r.energy_amber99sb_vacuum_openmm)),
        ("OpenMM s", "{seconds_openmm:.1f}"), ("`relax` s", "{seconds_relax:.2f}"),
        ("sooner", ratio_of("times_sooner")), ("less CPU", ratio_of("times_less_cpu")),
    )  # fmt: skip


@table("relax-short")
def relax_short(results: Path) -> str:
    """Relaxation beside AlphaFold's, for the README."""
    return of_rows(
        pd.read_csv(results / "relax.csv"),
        ("model", "{model}"), ("residues", "{residues}"), ("sooner", ratio_of("times_sooner")),
        ("violations", "{violations_start}"), ("after OpenMM", "{violations_openmm:.0f}"),
        ("after `relax`", "{violations_relax:.0f}"),
        ("RMSD angstrom, OpenMM", "{ca_rmsd_angstrom_openmm:.2f}"),
        ("`relax`", "{ca_rmsd_angstrom_relax:.2f}"),
    )  # fmt: skip


@table("relax-words")
def relax_words(results: Path) -> str:
    """What the table of relaxation says."""
    r = pd.read_csv(results / "relax.csv")
    n = len(r)
    left = (r["violations_relax"] <= r["violations_openmm"]).sum()
    fold = (r["ca_rmsd_angstrom_relax"] <= r["ca_rmsd_angstrom_openmm"] + 0.02).sum()
    obc2 = (r["energy_ff14sb_obc2_relax"] - r["energy_ff14sb_obc2_openmm"]).dropna()
    vacuum = (r["energy_amber99sb_vacuum_relax_alphafold"] - r["energy_amber99sb_vacuum_openmm"]).dropna()
    damaged = r["model"].str.startswith("1hel-")
    files, copies = r["times_sooner"][~damaged], r["times_sooner"][damaged]
    return paragraph(
        f"`relax` leaves no more violations than OpenMM in {left} of {n} models, and the RMSD is at most",
        f"OpenMM's + 0.02 angstrom in {fold} of {n}. Its energy is the lower in {(obc2 < 0).sum()} of",
        f"{len(obc2)} in ff14SB and OBC2, and in {(vacuum < 0).sum()} of {len(vacuum)} in amber99sb and",
        f"vacuum. It is {between(files)} times sooner on the files, and {between(copies)} times on the",
        "copies of lysozyme, where a second or more is the start of the program.",
    )


@table("relax-many")
def relax_many(results: Path) -> str:
    """How many models of a folder ended."""
    r = pd.read_csv(results / "relax_many.csv")
    ended = r["status"].fillna("no result").value_counts()
    total = {name: (r[f"{name}_start"].sum(), r[f"{name}_end"].sum()) for name in
             ("violations", "overlaps", "threaded_rings", "wrong_hands")}  # fmt: skip
    of = {name: f"{start:.0f} to {end:.0f}" for name, (start, end) in total.items()}
    return paragraph(
        f"Of {len(r)} models, {', '.join(f'{k} end `{name}`' for name, k in ended.items())}. Residues with",
        f"violations fall from {of['violations']}, overlaps from {of['overlaps']}, threaded rings from",
        f"{of['threaded_rings']}, chiral atoms of the wrong hand from {of['wrong_hands']}.",
        *_rates(results),
    )


def _rates(results: Path) -> list[str]:
    """Models an hour, if they were measured."""
    if not (results / "relax_throughput.csv").exists():
        return []
    r = pd.read_csv(results / "relax_throughput.csv").iloc[0]
    return [
        f"It took {r['seconds_relax']:.0f} s, {r['models_an_hour_relax']:.0f} models an hour; OpenMM's",
        f"protocol in two processes of one thread, by a sample of {r['sample_openmm']:.0f},",
        f"{r['models_an_hour_openmm']:.0f} an hour: {r['times_sooner']:.1f} times.",
    ]


@table("relax-crystals")
def relax_crystals(results: Path) -> str:
    """What relaxing does to crystal structures."""
    r = pd.read_csv(results / "relax_crystals.csv")
    clash, rmsd = r["clashscore_per_1000_atoms_start"], r["ca_rmsd_angstrom"]
    worse = (r["ramachandran_favoured_percent_end"] < r["ramachandran_favoured_percent_start"]).sum()
    outliers = [r[f"ramachandran_outliers_{when}"].sum() for when in ("start", "end")]
    return paragraph(
        f"Of {len(r)} crystal structures of {between(r['n_residues'])} residues, clashscores of",
        f"{between(clash)} (hydrogens as added) become {r['clashscore_per_1000_atoms_end'].max():.1f} at",
        f"most; Ramachandran outliers were {outliers[0]} and are {outliers[1]}; C-alphas move by",
        f"{rmsd.min():.2f} to {rmsd.max():.2f} angstrom; {worse} of {len(r)}",
        f"{'has' if worse == 1 else 'have'} fewer favoured residues than the input.",
    )
