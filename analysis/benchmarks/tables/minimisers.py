"""Minimisers: work against precision, how far minima lie, the race with OpenMM's, the stiffness model."""

import numpy as np
import pandas as pd
from made import RECORD
from scipy.stats import bootstrap

from tables import (
    between,
    digits,
    digits_of,
    made_by,
    markdown,
    of_rows,
    paragraph,
    ratio,
    table,
    table_of_rows,
)

TORSIONS = ("kcm", "kcm-adaptive", "kcm-metric", "kcm-stiffness", "newton", "lbfgs")
CARTESIAN = ("cartesian", "hybrid", "openmm")
LEVELS = (100.0, 10.0, 1.0)
SAME = 1.0
"""kJ/mol, within which two ends are one."""


def _needed(rows: pd.DataFrame, cost: str) -> pd.Series:
    """Median and quartiles of a cost by method and level, as quoted."""
    number = (lambda v: f"{v:.0f}" if np.isfinite(v) else "never") if cost == "evaluations" else digits

    def shown(row: pd.Series) -> str:
        middle, low, high = (number(row[name]) for name in ("median", "first_quartile", "third_quartile"))
        return middle if low == high == "never" else f"{middle} ({low} to {high})"

    of = rows[rows["cost"] == cost].set_index(["method", "above_kj_mol_per_100_residues"])
    return of.apply(shown, axis=1)


def lowest(ends: pd.DataFrame) -> pd.Series:
    """In how many structures each method ends within 1 kJ/mol per 100 residues of the lowest of its kind."""
    kind = ends["method"].isin(CARTESIAN)
    energy = ends["energy_end_reference_kj_mol"]
    above = (energy - energy.groupby([ends["structure"], kind]).transform("min")) * 100.0 / ends["residues"]
    return (above <= 1.0).groupby(ends["method"]).sum()


@table("precision", "precision.csv", "precision_ends.csv")
def precision(rows: pd.DataFrame, ends: pd.DataFrame) -> str:
    """Evaluations and seconds to within levels, and how runs ended."""
    of, low = ends.groupby("method"), lowest(ends)
    done = of["status"].apply(lambda s: f"{(s == 'converged').sum()} of {len(s)}")
    rmsd = of["ca_rmsd_angstrom"].median()

    def part(cost: str, headings: tuple[str, ...], *more: dict[str, object]) -> str:
        needed = _needed(rows, cost)
        lines = [
            [f"`{m}`", *(needed[m, level] for level in LEVELS), *(values[m] for values in more)]
            for m in (*TORSIONS, *CARTESIAN)
        ]
        lines.insert(len(TORSIONS), [""] * len(lines[0]))
        return markdown((f"{cost} to within", *(f"{level:g} kJ/mol" for level in LEVELS), *headings), lines)

    ended = (dict(done), dict(low), {m: f"{v:.2f}" for m, v in rmsd.items()})
    first = part("evaluations", ("converged", "lowest", "RMSD angstrom"), *ended)
    return f"{first}\n{part('seconds', ())}"


# How far minima lie


METHODS = ("cartesian", "hybrid", "lbfgs", "openmm")
DEFAULT, REFERENCE, TOLERANCE = "cartesian", "openmm", 10.0
"""The default method and its tolerance, kJ/mol/nm, and what it is compared with."""
ALLOWED = 0.2
"""angstrom. Median RMSD above the reference's."""


@table("near", "near.csv")
def near(rows: pd.DataFrame) -> str:
    """Medians of RMSD, energy and seconds against tolerance, of structures in which all methods met it."""
    tolerances = sorted(rows["tolerance"].unique(), reverse=True)
    of = rows.groupby(["method", "tolerance"])
    met = rows[rows["met_by_all"]].groupby(["method", "tolerance"])
    kinds = {
        "RMSD, angstrom": met["ca_rmsd_angstrom"].median().map("{:.2f}".format),
        "energy, kJ/mol per 100 residues": met["above_kj_mol_per_100_residues"].median().map("{:.0f}".format),
        "CPU seconds": met["cpu_seconds"].median().map(digits),
        "structures that met it": of["energy_kj_mol"].count(),
    }
    cells = ([kind, f"`{m}`", *values[m][tolerances]] for kind, values in kinds.items() for m in METHODS)
    return markdown(("median", "method", *(f"{t:g}" for t in tolerances)), cells)


@table("near-words", "near.csv")
def near_words(rows: pd.DataFrame) -> str:
    """Whether the default is as near as the reference and as low, at each tolerance."""
    parts = []
    for tolerance in (TOLERANCE, 1.0):
        of = rows[rows["tolerance"] == tolerance].pivot(index="structure", columns="method")
        both = of[of["energy_kj_mol"][[DEFAULT, REFERENCE]].notna().all(axis=1)]
        away, energy = both["ca_rmsd_angstrom"].median(), both["energy_kj_mol"]
        low = (energy[DEFAULT] <= energy[REFERENCE]).mean()
        meets = away[DEFAULT] <= away[REFERENCE] + ALLOWED
        parts.append(
            f"At {tolerance:g} kJ/mol/nm `{DEFAULT}` ends {away[DEFAULT]:.2f} angstrom from the start and "
            f"OpenMM {away[REFERENCE]:.2f} (medians of {len(both)}; the difference is "
            f"{'within' if meets else 'above'} {ALLOWED:g}), and its energy is no higher in {low:.0%}."
        )
    n = rows.groupby("start")["structure"].nunique()
    far = rows[(rows["tolerance"] == TOLERANCE) & (rows["ca_rmsd_angstrom"] > 2.0)].groupby("method").size()
    counts = ", ".join(f"{far.get(method, 0)} by `{method}`" for method in METHODS)
    return paragraph(
        f"{n['deposited']} structures as deposited and {n['relaxed']} relaxed models.", *parts,
        f"Ends more than 2 angstrom away at {TOLERANCE:g}: {counts}.",
    )  # fmt: skip


@table("near-basins", "near_basins.csv")
def near_basins(rows: pd.DataFrame) -> str:
    """Share of ends in the minimum to which steepest descent leads."""
    of = rows[rows["apart_angstrom"].notna()].astype({"same": bool}).groupby("method", sort=False)
    shares = pd.DataFrame({"same": of["same"].sum(), "n": of.size(), "apart": of["apart_angstrom"].median(),
                           "above": of["above_kj_mol"].median()}).reset_index()  # fmt: skip
    return of_rows(
        shares, ("method", "`{method}`"), ("in the minimum of steepest descent", "{same} of {n}"),
        ("median distance from it, angstrom (all atoms)", "{apart:.2f}"),
        ("median energy above it, kJ/mol", "{above:+.1f}"),
    )  # fmt: skip


# The race


FORCES = {"gbsa": "OBC2, GBSAOBCForce", "obc2": "OBC2, CustomGBForce", "gbn2": "GBn2", "vacuum": "vacuum"}


@table("ends", "ends.csv")
def ends(rows: pd.DataFrame) -> str:
    """Ends of each method less those of OpenMM from the same start, and whether zero is likely."""
    of = rows.pivot(index=["structure", "residues", "start"], columns="method", values="end_kj_mol")
    lines, open_ = [], []
    for method in ("cartesian", "hybrid", "scipy"):
        apart = of[method] - of["openmm"]
        middle = apart.groupby("structure").median()
        low, high = bootstrap(
            (middle,), np.median, method="percentile", n_resamples=10_000, rng=np.random.default_rng(0)
        ).confidence_interval
        open_ += [method] if low <= 0.0 <= high else []
        same = apart.abs() <= SAME
        shares = (~same & (apart < 0.0), same, ~same & (apart > 0.0))
        lines.append([
            f"`{method}`",
            *(f"{100 * share.groupby('structure').mean().mean():.0f}" for share in shares),
            f"{middle.median():+.1f} ({low:+.1f} to {high:+.1f})",
        ])  # fmt: skip
    scatter = rows.groupby(["structure", "method"])["end_kj_mol"].agg(np.ptp).gt(SAME).mean()
    table = markdown(
        ("against `openmm`", "lower, %", "the same, %", "higher, %", "difference, kJ/mol (95 %)"), lines
    )
    found = ", ".join(f"`{method}`" for method in open_) or "none"
    starts = rows.groupby("structure")["start"].nunique()
    number = " to ".join(str(n) for n in sorted({starts.min(), starts.max()}))
    return f"{table}\n" + paragraph(
        f"{len(starts)} structures, {number} starts each, which count as one;",
        "medians of the structures' medians, and intervals by resampling structures. Zero is in the interval",
        f"of {found}: which end is lower is then chance, as far as these can tell. Starts of a structure end",
        f"more than {SAME:g} kJ/mol apart in {100 * scatter:.0f} % of all pairs of structure and method.",
    )


@table("race-medians", "race_*.csv")
def race_medians(races: pd.DataFrame) -> str:
    """Median ratios of the race, by force and tolerance."""
    rows = []
    for (force, tolerance), of in races.groupby(["force", "tolerance"]):
        cells = [FORCES[force], f"{tolerance:g}"]
        for method in ("cartesian", "hybrid"):
            own = of[of["method"] == method]
            cells += [ratio(own["stop"].median()), ratio(own["passage"].median())]
            cells += [f"{(own['stop'] > 1).sum()} of {len(own)}"]
        rows.append(cells)
    return markdown(
        ("OpenMM's force", "tolerance kJ/mol/nm", "`cartesian`, to its end", "near its end", "faster",
         "`hybrid`, to its end", "near its end", "faster"), rows,
    )  # fmt: skip


@table("race-short", "race_*.csv", RECORD)
def race_short(races: pd.DataFrame, record: pd.DataFrame) -> str:
    """The same with its commands, for the README."""
    return f"{race_medians(races)}\n{made_by(record, *(f'race_{force}.csv' for force in FORCES))}"


@table("race-range", "race_*.csv")
def race_range(races: pd.DataFrame) -> str:
    """How much faster ours are where they end as low, and how much higher they end where not."""
    lines = []
    for (force, tolerance), of in races.groupby(["force", "tolerance"]):
        met = of[of["stop"] > 0]
        above = (of["end_kj_mol"] - of["openmm_end_kj_mol"])[of["stop"] == 0]
        line = f"- {FORCES[force]}, {tolerance:g} kJ/mol/nm: as low in {len(met)} of {len(of)} runs"
        line += f", {between(met['stop'])} times as fast" if len(met) else ""
        line += f"; in the others {between(above)} kJ/mol above OpenMM's end" if len(above) else ""
        lines.append(f"{line}.\n")
    return "".join(lines)


# The stiffness model


@table("metric", "metric.csv")
def metric(rows: pd.DataFrame) -> str:
    """Springs over near terms, medians."""
    costs = [f"{cost}_to_{above}" for above in (10, 1) for cost in ("evaluations", "seconds")]
    of = {name: part.set_index(["structure", "method"])[costs] for name, part in rows.groupby("metric")}
    medians = (of["springs"] / of["near terms"]).groupby("method").median()
    heads = (f"{cost} to {above} kJ/mol" for above in (10, 1) for cost in ("evaluations", "seconds"))
    shown = markdown(("method", *heads), ((f"`{m}`", *map(ratio, row)) for m, row in medians.iterrows()))
    ends = rows.pivot_table(index=["method", "structure"], columns="metric", values="end_kj_mol")
    above = (ends["near terms"] - ends["springs"]).groupby("method")
    ranges = ", ".join(f"{v.median():+.1f} ({v.min():+.0f} to {v.max():+.0f}) `{m}`" for m, v in above)
    said = paragraph(
        f"Medians over {rows['structure'].nunique()} structures of the cost with springs divided by that with"
        " near terms, to within 10 and 1 kJ/mol per 100 residues of the end; seconds are CPU seconds on one"
        " thread:"
    )
    ended = paragraph(
        "The two end in different minima. Energies with near terms minus those with springs, kJ/mol, medians"
        f" and ranges: {ranges}."
    )
    return f"{said}\n{shown}\n{ended}"


@table("polar", "polar.csv")
def polar(rows: pd.DataFrame) -> str:
    """Energy gained by polar rotors, and evaluations, medians and quartiles."""
    gained = (rows["end_polar_kj_mol"] - rows["end_usual_kj_mol"]) / rows["residues"]
    cost = rows["evaluations_polar"] / rows["evaluations_usual"]
    more = rows["bonds_polar"] - rows["bonds_usual"]
    lines = []
    for method, part in rows.groupby("method"):
        quartiles = (each[part.index].quantile([0.5, 0.25, 0.75]) for each in (gained, cost, more))
        lines.append((f"`{method}`", *(f"{m:.2g} ({low:.2g} to {high:.2g})" for m, low, high in quartiles)))
    heads = ("method", "kJ/mol a residue", "evaluations, with over without", "hydrogen bonds more")
    return markdown(heads, lines)


@table("compliance-evaluations", "compliance_evaluations.csv")
def compliance_evaluations(rows: pd.DataFrame) -> str:
    """Evaluations to 1 kJ/mol/rad."""
    methods = [name for name in rows.columns if name not in ("structure", "hinges")]

    def count(value: float) -> str:
        return "-" if pd.isna(value) else f"{value:.0f}" if np.isfinite(value) else "> 4000"

    columns = [
        (name if name == "L-BFGS-B" else f"`{name}`", lambda r, name=name: count(r[name])) for name in methods
    ]
    return of_rows(rows, ("structure", "{structure}"), ("hinges", "{hinges}"), *columns)


def _shares(row: pd.Series, method: str) -> str:
    return f"{row[f'first_{method}']:.2f}, {row[f'ten_{method}']:.2f}"


@table("modes-pairs", "modes_pairs.csv")
def modes_pairs(rows: pd.DataFrame) -> str:
    """Shares of the change between two crystals of the first mode, and of ten, with the mean of ten."""
    methods = {
        "force_field": "force field, torsions", "tirion": "Tirion's network, torsions",
        "prody": "ProDy, ANM", "springcraft": "springcraft, Hinsen",
    }  # fmt: skip
    lines = [
        (
            f"{r.pair}, {r.start} to {r.end}",
            r.residues,
            f"{r.rmsd_angstrom:.1f}",
            *(_shares(r, m) for m in methods),
        )
        for _, r in rows.iterrows()
    ]  # fmt: skip
    means = ("mean of ten modes", "", "", *(f"{rows[f'ten_{method}'].mean():.3f}" for method in methods))
    return markdown(("change", "residues", "RMSD, angstrom", *methods.values()), [*lines, means])


@table("modes-b-factors", "modes_b_factors.csv")
def modes_b_factors(rows: pd.DataFrame) -> str:
    """Correlations with B factors, and their medians."""
    methods = {
        "force_field": "force field, torsions", "tirion": "Tirion's network, torsions",
        "prody_anm": "ANM", "prody_gnm": "GNM",
    }  # fmt: skip
    lines = [(r.structure, r.residues, *(_or_dash(r[m]) for m in methods)) for _, r in rows.iterrows()]
    medians = ("median", "", *(f"{rows[method].median():.2f}" for method in methods))
    return markdown(("crystal", "residues", *methods.values()), [*lines, medians])


def _or_dash(value: float) -> str:
    return "-" if pd.isna(value) else f"{value:.2f}"


table_of_rows(
    "modes-cost", "modes_cost.csv",
    ("structure", "{structure}"), ("residues", "{residues}"), ("freedoms", "{freedoms}"),
    ("seconds", digits_of("seconds")),
    ("of one evaluation", lambda r: f"{r.seconds / r.evaluation_seconds:.0f}"), ("peak, MB", "{peak_mb:.0f}"),
)  # fmt: skip


@table("modes-growth", "modes_cost.csv")
def modes_growth(rows: pd.DataFrame) -> str:
    """Exponents of the growth of cost with the number of residues, by least squares."""
    rows = rows[rows["residues"] > 70]
    size = np.log(rows["residues"])
    whole, own = (np.polyfit(size, np.log(rows[c]), 1)[0] for c in ("seconds", "evaluation_seconds"))
    worst = rows["residual"].max()
    return paragraph(
        f"From 76 residues on, time grows as their number to the power of {whole:.2f}, and an",
        f"evaluation of the energy to that of {own:.2f}: {whole - own:.2f} is beyond the energy's own. The",
        f"largest residual, $|Ka-w^2Ma|$ of $|K||a|$, is {worst:.0e}.",
    )


table_of_rows(
    "modes-steps", "modes_steps.csv",
    ("structure", "{structure}"), ("hinges", "{hinges}"), ("2/w, fs", "{predicted_fs:.1f}"),
    ("found, fs", "{found_fs:.1f}"), ("found/predicted", "{ratio:.3f}"),
)  # fmt: skip


def _slope(row: pd.Series) -> str:
    """Slope of energy histograms over the canonical one."""
    return "-" if np.isnan(row["slope"]) else f"{row['slope']:.3f} ± {row['slope_error']:.3f}"


def _reached(row: pd.Series) -> str:
    """Median and quartiles of evaluations to the lowest minimum."""
    first, middle, third = (
        "never" if np.isinf(row[name]) else f"{row[name]:.0f}"
        for name in ("first_quartile", "median", "third_quartile")
    )
    return f"{middle} ({first} to {third})"


table_of_rows(
    "minima-found", "minima_found.csv",
    ("method", "{method}"),
    ("evaluations of a walk", "{evaluations:,.0f}"),
    ("reached", "{reached:.0f} of {walks:.0f}"),
    ("evaluations, median (quartiles)", _reached),
    ("lowest of all walks", "{lowest_kj_mol:.2f}"),
    ("median walk above it", "{above_lowest_median_kj_mol:.1f}"),
    ("worst", "{above_lowest_worst_kj_mol:.1f}"),
    ("seconds a walk", "{seconds_of_a_core:.0f}"),
)  # fmt: skip
table_of_rows(
    "minima-populations", "minima_populations.csv",
    ("start", "{start}"),
    ("temperature, K", "{temperature_k:.0f}"),
    ("energy, kJ/mol", "{energy_kj_mol:.1f} ± {energy_error_kj_mol:.1f}"),
    ("helix, %", lambda row: f"{100 * row['helix_share']:.1f} ± {100 * row['helix_share_error']:.1f}"),
    ("exchanges, %", lambda row: "-" if np.isnan(row["exchanges"]) else f"{100 * row['exchanges']:.0f}"),
    ("slope", _slope),
)  # fmt: skip
table_of_rows(
    "minima-folds", "minima_folds.csv",
    ("protein", "{protein}"),
    ("walk", "{walk}"),
    ("evaluations", "{evaluations:,.0f}"),
    ("minutes of a core", "{minutes_of_a_core:.1f}"),
    ("all atoms minimised, kJ/mol", "{energy_kj_mol:.0f}"),
    ("above the native", lambda row: f"{row['energy_kj_mol'] - row['native_kj_mol']:.0f}"),
    ("C-alpha RMSD to the native, angstrom", "{ca_rmsd_to_native_angstrom:.1f}"),
)  # fmt: skip
table_of_rows(
    "minima-truth", "minima_truth.csv",
    ("temperature, K", "{temperature_k:.0f}"),
    ("mean energy, kJ/mol", "{energy_kj_mol:.3f} ± {energy_error_kj_mol:.3f}"),
    ("by quadrature", "{by_quadrature_kj_mol:.3f}"),
    ("errors away", "{errors_away:.1f}"),
    ("slope", _slope),
)  # fmt: skip
table_of_rows(
    "minima-cost", "minima_cost.csv",
    ("replica exchange", "{engine}"),
    ("replicas", "{replicas}"),
    ("ms a step", "{ms_a_step:.2f}"),
    ("fs a step", "{fs_a_step:.0f}"),
    ("ps between exchanges", "{ps_a_round:.2f}"),
    ("rounds a second", "{rounds_a_second:.1f}"),
    ("ps a second, of each replica", "{ps_a_second:.1f}"),
    ("exchanges, %", lambda row: f"{100 * row['exchanges']:.0f}"),
)  # fmt: skip
