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
from tables.relaxation import CLOSED

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


def interval(values: pd.Series) -> tuple[float, float]:
    """Of the median, 95 %, by resampling; of one value there is none."""
    if len(values) < 2:
        return np.nan, np.nan
    found = bootstrap(
        (values,), np.median, method="percentile", n_resamples=10_000, rng=np.random.default_rng(0)
    ).confidence_interval
    return float(found.low), float(found.high)


# How far minima lie


METHODS = ("cartesian", "hybrid", "lbfgs", "openmm")
REFERENCE = "cartesian"
"""The default method, which is compared with OpenMM's own ends."""
COMPARED = {
    "the ends of both runs": "end", "where `cartesian` has OpenMM's RMS force": "equal_force",
    "where `cartesian` is lowest, no farther from the start": "equal_distance",
}  # fmt: skip
"""Comparisons with OpenMM's own end, and how their columns begin."""


@table("near", "near.csv")
def near(rows: pd.DataFrame) -> str:
    """Medians of RMSD, energy above the minimum and evaluations against tolerance."""
    rows = rows.assign(above=rows["above_kj_mol"] / rows["residues"])
    tolerances = sorted(rows["tolerance"].unique(), reverse=True)
    of = rows.groupby(["method", "tolerance"])
    kinds = {
        "RMSD, angstrom": of["ca_rmsd_angstrom"].median().map("{:.2f}".format),
        "energy, kJ/mol per residue": of["above"].median().map("{:.2f}".format),
        "evaluations": of["evaluations"].median().map("{:.0f}".format),
        "structures that met it": of["energy_kj_mol"].count().astype(str),
    }
    cells = (
        [kind, f"`{m}`", *(values[m].get(t, "-") for t in tolerances)]
        for kind, values in kinds.items()
        for m in METHODS
    )
    return markdown(("median", "method", *(f"{t:g}" for t in tolerances)), cells)


@table("near-tolerance", "near.csv")
def near_tolerance(rows: pd.DataFrame) -> str:
    """What a tolerance of the default method costs and leaves, of each the median and the range."""
    own = rows[rows["method"] == REFERENCE].assign(above=rows["above_kj_mol"] / rows["residues"])
    shown = {"above": "{:.2f}", "ca_rmsd_angstrom": "{:.2f}", "evaluations": "{:.0f}"}

    def cell(values: pd.Series, form: str) -> str:
        middle, low, high = (form.format(v) for v in (values.median(), values.min(), values.max()))
        return f"{middle} ({low} to {high})"

    lines = [
        (f"{tolerance:g}", *(cell(of[name], form) for name, form in shown.items()))
        for tolerance, of in sorted(own.groupby("tolerance"), reverse=True)
    ]
    return markdown(
        ("tolerance, kJ/mol/nm", "above its minimum, kJ/mol per residue", "RMSD from the start, angstrom",
         "evaluations"), lines,
    )  # fmt: skip


@table("near-ends", "near_ends.csv")
def near_ends(rows: pd.DataFrame) -> str:
    """`cartesian` against OpenMM's own ends, in three ways."""
    lines = []
    for tolerance, of in sorted(rows.groupby("tolerance"), reverse=True):
        for name, start in COMPARED.items():
            apart = of[f"{start}_kj_mol"] - of["openmm_kj_mol"]
            low, high = interval(apart)
            shares = (apart < -SAME, apart.abs() <= SAME, apart > SAME)
            lines.append([
                f"{tolerance:g}", name, *(int(share.sum()) for share in shares),
                f"{apart.median():+.1f} ({low:+.1f} to {high:+.1f})", f"{apart.max():+.0f}",
                f"{of[f'{start}_ca_rmsd_angstrom'].median():.2f}",
                f"{of['openmm_ca_rmsd_angstrom'].median():.2f}",
            ])  # fmt: skip
    return markdown(
        ("tolerance, kJ/mol/nm", "compared with OpenMM's own end", "lower", "the same", "higher",
         "median difference, kJ/mol (95 %)", "highest", "RMSD angstrom", "OpenMM"), lines,
    )  # fmt: skip


@table("near-words", "near_ends.csv")
def near_words(rows: pd.DataFrame) -> str:
    """How many structures, where OpenMM's runs end, and what that leaves of the comparison."""
    parts = []
    for tolerance, of in sorted(rows.groupby("tolerance"), reverse=True):
        size, ours = of["openmm_rms_force_kj_mol_nm"], of["end_rms_force_kj_mol_nm"]
        apart = of["end_kj_mol"] - of["openmm_kj_mol"]
        distant = of["equal_distance_kj_mol"] - of["openmm_kj_mol"]
        parts.append(
            f"At a tolerance of {tolerance:g} OpenMM ends at an RMS force of {size.min():.2g} to"
            f" {size.max():.2g} kJ/mol/nm, `{REFERENCE}` at {ours.min():.2g} to {ours.max():.2g}. The latter"
            f" is higher in {(apart > SAME).sum()} of {len(of)}, by up to {max(0.0, apart.max()):.0f} kJ/mol,"
            f" and lower in {(apart < -SAME).sum()}, by up to {max(0.0, -apart.min()):.0f}. Within the"
            f" distance of OpenMM's end from the start, it is higher in {(distant > SAME).sum()}, by up to"
            f" {max(0.0, distant.max()):.0f}, and lower in {(distant < -SAME).sum()}."
        )
    atoms = rows["atoms"]
    return paragraph(
        f"The set has {rows['structure'].nunique()} structures of {atoms.min()} to {atoms.max():,} atoms.",
        *parts, f"Energies within {SAME:g} kJ/mol count as the same.",
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


@table("ends", "ends.csv")
def ends(rows: pd.DataFrame) -> str:
    """Ends of each method less those of OpenMM from the same start, and whether zero is likely."""
    of = rows.pivot(index=["structure", "residues", "start"], columns="method", values="end_kj_mol")
    lines, open_ = [], []
    for method in ("cartesian", "hybrid", "scipy"):
        apart = of[method] - of["openmm"]
        middle = apart.groupby("structure").median()
        low, high = interval(middle)
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
        f"The table has {len(starts)} structures with {number} starts each. The starts of a structure count",
        "as one: medians are over the structures' medians, and intervals resample structures. Zero is in the",
        f"interval of {found}. Within this precision the lower end is then chance. In {100 * scatter:.0f} %",
        f"of all pairs of structure and method the ends differ by more than {SAME:g} kJ/mol.",
    )


FORCES = ("gbsa", "obc2", "vacuum")
"""Of the race, in the order of its tables."""
GOALS = {"energy": "its energy", "force": "its RMS force"}


def _named(row: pd.Series) -> str:
    """OpenMM's force: the solvent, and the class that computes it."""
    if row["force"] == "vacuum":
        return "no implicit solvent"
    return f"{'GBn2' if row['force'] == 'gbn2' else 'OBC2'}, {row['gb_class']}"


def _raced(races: pd.DataFrame) -> pd.DataFrame:
    """Races with OpenMM's force in words, and OpenMM's seconds over ours: 0 where ours never get there."""
    races = races.assign(named=races.apply(_named, axis=1))
    for goal in GOALS:
        for part in ("loop", "whole"):
            races[f"{goal}_{part}"] = races[f"openmm_{part}_s"] / races[f"{goal}_{part}_s"]
    return races


def _medians(races: pd.DataFrame) -> str:
    lines = []
    for (named, tolerance, method), of in _raced(races).groupby(["named", "tolerance", "method"]):
        ratios = (ratio(of[f"{goal}_{part}"].median()) for goal in GOALS for part in ("loop", "whole"))
        never = (of["energy_loop"] == 0).sum()
        lines.append((named, f"{tolerance:g}", f"`{method}`", *ratios, f"{never} of {len(of)}"))
    heads = (f"to {goal}, {part}" for goal in GOALS.values() for part in ("loop", "whole call"))
    return markdown(("OpenMM's force", "its tolerance", "method", *heads, "never as low"), lines)


@table("race-medians", "race_*.csv")
def race_medians(races: pd.DataFrame) -> str:
    """Median ratios of the race, by force, tolerance and method."""
    return _medians(races)


README_RACES = (("OBC2, GBSAOBCForce", 10), ("OBC2, GBSAOBCForce", 1), ("no implicit solvent", 10))
"""Force and tolerance of the races in the README."""


@table("readme", "relax.csv", "race_*.csv", RECORD)
def readme(relaxed: pd.DataFrame, races: pd.DataFrame, record: pd.DataFrame) -> str:
    """Whole commands and calls compared with OpenMM, five rows."""
    relaxed = relaxed[relaxed["model"] != CLOSED]
    damaged = relaxed["model"].str.startswith("1hel-")
    lines = []
    for models, of in (
        ("predicted models", relaxed[~damaged]),
        ("damaged copies of lysozyme", relaxed[damaged]),
    ):
        equal = (of["violations_relax"] <= of["violations_openmm"]).sum()
        result = f"no more violations in {equal} of {len(of)}"
        lines.append(
            (f"relax {models}", result, ratio(of["times_sooner"].median()), between(of["times_sooner"]))
        )
    raced = _raced(races[races["method"] == REFERENCE]).groupby(["named", "tolerance"])
    for force, tolerance in README_RACES:
        of = raced.get_group((force, tolerance))
        reached = of[of["energy_loop"] > 0]["energy_whole"]
        result = f"energy as low in {len(reached)} of {len(of)}"
        task = f"minimise, {force}, OpenMM's tolerance {tolerance}"
        lines.append((task, result, ratio(of["energy_whole"].median()), between(reached)))
    note = (
        "In the median, structures without an equally low energy count as infinitely slow.",
        "The range omits them.",
        f"{CLOSED} is not included. OpenMM's run closed its chain gaps, a different problem.",
    )
    files = ("relax.csv", *(f"race_{force}.csv" for force in FORCES))
    heads = ("task", "result", "ratio, median", "ratio, range")
    return f"{markdown(heads, lines)}\n{paragraph(*note)}\n{made_by(record, *files)}"


@table("race-rows", "race_*.csv")
def race_rows(races: pd.DataFrame) -> str:
    """Seconds of the default method in every race."""
    own = _raced(races[races["method"] == REFERENCE]).sort_values(["named", "tolerance", "atoms"])
    seconds = (
        (f"{who}, {shown}", digits_of(f"{column}_{part}_s"))
        for part, shown in (("loop", "loop"), ("whole", "whole call"))
        for who, column in (("OpenMM", "openmm"), ("to its energy", "energy"), ("to its RMS force", "force"))
    )
    return of_rows(
        own, ("structure", "{structure}"), ("atoms", "{atoms}"), ("OpenMM's force", "{named}"),
        ("its tolerance", "{tolerance:g}"), ("RMS force at its end", "{openmm_rms_force_kj_mol_nm:.2g}"),
        *seconds, ("OpenMM, shell", digits_of("openmm_shell_s")),
        ("to its RMS force, shell", digits_of("shell_s")),
    )  # fmt: skip


@table("race-range", "race_*.csv")
def race_range(races: pd.DataFrame) -> str:
    """How many times as fast the default method is, and where it is never as low as OpenMM's end."""
    lines = []
    for (named, tolerance), of in _raced(races[races["method"] == REFERENCE]).groupby(["named", "tolerance"]):
        met, never = of[of["energy_loop"] > 0], of[of["energy_loop"] == 0]
        line = f"- {named}, {tolerance:g} kJ/mol/nm: as low in {len(met)} of {len(of)}"
        line += f", whole calls {between(met['energy_whole'])} times as fast" if len(met) else ""
        line += f". To its RMS force, whole calls {between(of['force_whole'])} times"
        above = never["end_kj_mol"] - never["openmm_end_kj_mol"]
        names = ", ".join(
            f"{name} (+{v:.1f} kJ/mol)" for name, v in zip(never["structure"], above, strict=True)
        )
        line += f". Never as low, though in a minimum: {names}" if len(never) else ""
        lines.append(f"{line}.\n")
    shell = races[races["shell_s"].notna()]
    for tolerance, of in shell.groupby("tolerance"):
        ratios = of["openmm_shell_s"] / of["shell_s"]
        lines.append(
            f"- From shell to shell at {tolerance:g} kJ/mol/nm, to its RMS force: {between(ratios)} times as"
            f" fast ({len(of)} structures, GBSAOBCForce).\n"
        )
    return "".join(lines)


SECONDS = {
    "imports": "imports, kernels read", "reading": "reading", "system": "System", "chain": "chains",
    "judging": "judging", "loop": "loop", "evaluations": "evaluations", "metric": "metric",
    "writing": "writing", "others": "others", "shell": "shell to shell",
}  # fmt: skip
table_of_rows(
    "minimise-parts", "minimise_parts.csv", ("atoms", "{atoms:,.0f}"),
    *((f"{name} in it" if part in ("evaluations", "metric") else name, digits_of(f"{part}_s"))
      for part, name in SECONDS.items()),
)  # fmt: skip


# The stiffness model


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
        f"From 76 residues on, the time grows as their number to the power of {whole:.2f}. An evaluation of",
        f"the energy grows with the power {own:.2f}, so that {whole - own:.2f} is in addition to the energy.",
        f"The largest residual, $|Ka-w^2Ma|$ relative to $|K||a|$, is {worst:.0e}.",
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
