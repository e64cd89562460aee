"""The study of KCM against constrained dynamics, and what fixed angles leave."""

from collections.abc import Iterator

import pandas as pd

from bench.studies import kcm_summary
from bench.studies.kcm_cases import BOUNDS
from tables import Cell, digits, markdown, paragraph, percent, table, table_of_rows


def small(name: str) -> Cell:
    """Column of numbers down to 1e-6, without exponents."""
    return lambda row: f"{row[name]:.2g}" if row[name] >= 1e-3 else f"{row[name]:.6f}"


table_of_rows(
    "compliance-angles", "compliance_angles.csv",
    ("$h$, rad", "{angle_rad:g}"), ("largest torque left, kJ/mol/rad", "{torque_left_kj_mol_rad:.2g}"),
    ("energy left, kJ/mol", small("energy_left_kj_mol")),
    (r"$\tfrac12\kappa(h/2)^2$", small("predicted_kj_mol")),
    ("steps to within 1 kJ/mol", "{steps_to_1_kj_mol:.0f}"),
)  # fmt: skip
table_of_rows(
    "kcm-cost", "kcm_cost.csv",
    ("method", "`{method}`"), ("starts", "{starts}"), ("finished", "{finished:.0%}"),
    ("evaluations", "{evaluations:.0f}"), ("after 10", "{at_10:.1f}"), ("100", "{at_100:.1f}"),
    ("1000", "{at_1000:.2f}"), ("10,000", "{at_10000:.2f}"), ("0.1 s", "{at_100_ms:.1f}"),
    ("1 s", "{at_1000_ms:.1f}"), ("10 s", "{at_10000_ms:.1f}"), ("left at the end", "{left_kj_mol:.2f}"),
    ("its minimum", "{minimum_kj_mol:.2f}"),
)  # fmt: skip
table_of_rows(
    "kcm-deposited", "kcm_deposited.csv", ("method", "`{method}`"), ("starts", "{starts}"),
    ("median, angstrom", "{median_angstrom:.2f}"), ("largest", "{largest_angstrom:.2f}"),
)  # fmt: skip


@table("compliance-starts", "compliance_starts.csv")
def compliance_starts(rows: pd.DataFrame) -> str:
    """Where every setting ends from random starts."""

    def cells(setting: str, of: pd.DataFrame) -> tuple[str, ...]:
        name, comma, angle = setting.partition(", ")
        done = 100 * (of["stop"] == "TOLERANCE").mean()
        torque = "" if done == 100 else digits(of["torque_end_kj_mol_rad"].median())
        return f"`{name}`{comma}{angle}", f"{done:.0f} %", torque, f"{of['evaluations'].median():.0f}"

    heads = ("variant", "converged", "median largest torque at the end", "median evaluations")
    return markdown(heads, (cells(str(name), of) for name, of in rows.groupby("setting", sort=False)))


@table("kcm-contrasts", "kcm_contrasts.csv")
def kcm_contrasts(contrasts: pd.DataFrame) -> str:
    """Shares of finished pairs that end in one minimum, raw and by protein, and what exceeds the controls."""
    return _of_contrasts(contrasts[contrasts["scope"] == _first(contrasts)], "differ in")


@table("kcm-bodies", "kcm_bodies.csv")
def kcm_bodies(bodies: pd.DataFrame) -> str:
    """The free root against each choice of a fixed body."""
    return _of_contrasts(bodies[bodies["effect_p"].notna()], "fixed body")


@table("kcm-choices", "kcm_choices.csv")
def kcm_choices(rows: pd.DataFrame) -> str:
    """How many minima the choice of the body leads to."""
    return "\n".join(f"- {sentence}" for sentence in kcm_summary.body_words(rows)) + "\n"


@table("kcm-above", "kcm_above.csv")
def kcm_above(rows: pd.DataFrame) -> str:
    """How far the methods end above the lowest known minimum."""

    def cells(row: pd.Series) -> Iterator[str]:
        yield f"`{row['method']}`"
        yield f"{row['peptides']:.0f} ({row['left_out']:.0f})"
        yield f"{row['lowest']:.0f}"
        low, high = row["above_kj_mol_low"], row["above_kj_mol_high"]
        yield f"{row['above_kj_mol']:.1f} ({low:.1f} to {high:.1f})"
        yield f"{row['median_kj_mol']:.1f}"
        yield f"{row['largest_kj_mol']:.1f}"

    heads = (
        "method",
        "peptides (left out)",
        "in the lowest minimum",
        "mean above it, kJ/mol",
        "median",
        "largest",
    )
    return markdown(heads, (cells(row) for _, row in rows.iterrows()))


def searched(form: str) -> Cell:
    """Column of a search, empty if there is none."""
    return lambda row: form.format(**row) if row["csa_evaluations"] else "-"


table_of_rows(
    "kcm-minima", "kcm_minima.csv",
    ("peptide", "{protein}"), ("residues", "{residues:.0f}"),
    ("evaluations of csa", searched("{csa_evaluations:.0f}")),
    ("lowest of csa, kJ/mol", searched("{csa_kj_mol:.2f}")), ("runs of the study", "{runs:.0f}"),
    ("lowest of these", "{runs_kj_mol:.2f}"), ("lowest known", "{lowest_kj_mol:.2f}"), ("by", "`{source}`"),
)  # fmt: skip


def _of_contrasts(rows: pd.DataFrame, head: str) -> str:
    """Contrasts of one scope with their effects, the p of these, and the p corrected for this table."""

    def cells(row: pd.Series) -> Iterator[str]:
        yield row["what"]
        yield f"{row['pairs']:.0f} ({row['left_out']:.0f})"
        yield _raw(row)
        for name in ("same", "baseline", "effect"):
            yield share(row, name)
        for name in ("effect_p", "effect_p_scope"):
            yield kcm_summary.p_value(row[name])
        yield row["control"] if isinstance(row["control"], str) else "-"

    heads = (head, "finished pairs (left out)", "one minimum, of pairs", "by protein", "worst control")
    more = ("effect", "p", "adjusted p", "that control")
    return markdown((*heads, *more), (cells(row) for _, row in rows.iterrows()))


@table("kcm-scopes", "kcm_contrasts.csv")
def kcm_scopes(contrasts: pd.DataFrame) -> str:
    """Effects of the contrasts in each scope, which are not pooled."""
    of = contrasts[contrasts["effect"].notna()].set_index(["scope", "what"])
    scopes = list(dict.fromkeys(of.index.get_level_values("scope")))

    def cells(what: str) -> Iterator[str]:
        yield what
        for scope in scopes:
            row = of.loc[scope, what] if (scope, what) in of.index else None
            yield "-" if row is None else _in_scope(row)

    whats = dict.fromkeys(of.index.get_level_values("what"))
    return markdown(("differ in", *scopes), (cells(what) for what in whats))


def _in_scope(row: pd.Series) -> str:
    adjusted = kcm_summary.p_value(row["effect_p_all"])
    return f"{share(row, 'effect')}, {row['pairs']:.0f}, {adjusted}"


@table("kcm-proteins", "kcm_proteins.csv")
def kcm_proteins(proteins: pd.DataFrame) -> str:
    """Pairs that end in one minimum, of finished ones, by protein."""
    shown = {
        "KCM and dynamics, friction 10": "KCM, dynamics at 10",
        "metric of masses": "metric of masses",
        "inertia, friction 10": "inertia at 10",
        "inertia, friction 1": "inertia at 1",
        "root, without inertia": "root",
        "stiffness and dynamics, friction 10": "stiffness, dynamics at 10",
    }
    own = proteins[proteins["scope"].isin(list(kcm_summary.SCOPES)[:2])]
    sorts = own.sort_values("residues", kind="stable")

    def cells(name: str, rows: pd.DataFrame) -> Iterator[str]:
        yield name
        yield f"{rows['residues'].iloc[0]:.0f}"
        of = rows.set_index("what")
        for what in shown:
            yield f"{of['same_pairs'][what]} of {of['pairs'][what]}" if what in of.index else "-"

    heads = ("protein", "residues", *shown.values())
    return markdown(heads, (cells(str(name), rows) for name, rows in sorts.groupby("protein", sort=False)))


def _first(contrasts: pd.DataFrame) -> str:
    return str(contrasts["scope"].iloc[0])


def _raw(row: pd.Series) -> str:
    if not row["pairs"] or pd.isna(row["same_pairs"]):
        return "-"
    return f"{row['same_pairs']:.0f} of {row['pairs']:.0f}, {100 * row['same_pairs'] / row['pairs']:.0f} %"


def share(row: pd.Series, name: str) -> str:
    """A share with its interval, if there is one and it is of enough proteins."""
    if pd.isna(row[name]):
        return "-"
    if row["proteins"] < kcm_summary.FEW:
        return f"of {row['proteins']:.0f}"
    return percent(pd.Series({"value": row[name], "low": row[f"{name}_low"], "high": row[f"{name}_high"]}))


@table("kcm-words", "kcm_runs.csv", "kcm_contrasts.csv")
def kcm_words(runs: pd.DataFrame, contrasts: pd.DataFrame) -> str:
    """What the contrasts say."""
    first, *said = kcm_summary.words(runs, contrasts)
    return "\n".join([paragraph(first), *(f"- {sentence}" for sentence in said)]) + "\n"


@table("kcm-rise", "kcm_contrasts.csv")
def kcm_rise(contrasts: pd.DataFrame) -> str:
    """How far minima of one method lie above those of another."""
    own = contrasts[contrasts["rise_kj_mol"].notna() & (contrasts["proteins"] >= kcm_summary.FEW)]
    own = own[own["what"].str.startswith(kcm_summary.RISES)]

    def cells(row: pd.Series) -> Iterator[str]:
        yield row["what"]
        yield row["scope"]
        yield f"{row['pairs']:.0f}"
        yield f"{row['rise_kj_mol']:+.1f} ({row['rise_kj_mol_low']:+.1f} to {row['rise_kj_mol_high']:+.1f})"
        for name in ("rise_kj_mol_p", "rise_kj_mol_p_all"):
            yield kcm_summary.p_value(row[name])

    heads = ("the second's minima above the first's", "energy, size", "finished pairs", "kJ/mol")
    return markdown((*heads, "p", "adjusted p"), (cells(row) for _, row in own.iterrows()))


@table("kcm-sentence", "kcm_contrasts.csv", "kcm_above.csv")
def kcm_sentence(contrasts: pd.DataFrame, above: pd.DataFrame) -> str:
    """The answers of the study in a few sentences, whose numbers and verdicts are those of the tables."""
    of = contrasts[contrasts["scope"] == _first(contrasts)].set_index("what", drop=False)

    def pairs(what: str) -> str:
        row = of.loc[what]
        verdict = "" if kcm_summary.resolved(row) else "not resolved, "
        adjusted = kcm_summary.p_value(row["effect_p_scope"])
        return f"{row['same_pairs']:.0f} of {row['pairs']:.0f} pairs ({verdict}adjusted p {adjusted})"

    both, without, at_10, at_100, at_1, root, of_dynamics = map(
        pairs,
        ("KCM and dynamics, friction 10", "metric of masses", "inertia, friction 10", "inertia, friction 100",
         "inertia, friction 1", "root, without inertia", "root, friction 10"),
    )  # fmt: skip
    control = 100 * of["baseline"]["KCM and dynamics, friction 10"]
    ends = above.set_index("method")

    def lowest(method: str) -> str:
        row = ends.loc[method]
        return f"`{method}` in {row['lowest']:.0f} of {row['peptides']:.0f}"

    paragraphs = (
        "From one start, with one force field and the same rigid bodies, KCM along the torques and damped "
        f"dynamics with a friction of 10 per ps end in one minimum in {both}. The worst repetition of either "
        f"method returns to its minimum in {control:.0f} % (by protein).",
        "The masses alone have an effect of that size. KCM in their metric, without inertia, and KCM along "
        f"the torques end in one minimum in {without}. Inertia has this effect on KCM in the metric of "
        f"masses: one minimum in {at_10} at a friction of 10, in {at_100} at 100, and in {at_1} at 1.",
        "A fixed middle C-alpha is not part of either method. The fixed and the free root end in one minimum "
        f"in {root} without inertia, and in {of_dynamics} in dynamics. The lowest known minimum of a peptide "
        f"is the end of {lowest('kcm-0.005')} peptides, of {lowest('md-10')}, and of {lowest('lbfgs')}.",
    )
    return "\n".join(map(paragraph, paragraphs))


@table("kcm-methods", "kcm_methods.csv")
def kcm_methods(rows: pd.DataFrame) -> str:
    """Ends and paths of the methods over the extended peptides."""

    def mean(row: pd.Series, name: str, form: str) -> str:
        if pd.isna(row[name]):
            return "-"
        value, low, high = (form.format(row[f"{name}{end}"]) for end in ("", "_low", "_high"))
        return f"{value} ({low} to {high})"

    def cells(row: pd.Series) -> Iterator[str]:
        yield f"`{row['method']}`"
        yield f"{row['finished']:.0f} of {row['peptides']:.0f}"
        is_same = not pd.isna(row["same_pairs"])
        yield f"{row['same_pairs']:.0f} of {row['pairs']:.0f}, {percent_of(row)}" if is_same else "-"
        yield mean(row, "above_kj_mol", "{:.1f}")
        yield f"{row['evaluations']:.0f}"
        yield mean(row, "path_rad", "{:.2f}")
        yield mean(row, "path_nm", "{:.2f}")
        yield mean(row, "largest_step_nm", "{:.2g}")
        yield mean(row, "entropy_loss_j_mol_k", "{:.0f}")

    def percent_of(row: pd.Series) -> str:
        return f"{100 * row['same']:.0f} % ({100 * row['same_low']:.0f} to {100 * row['same_high']:.0f})"

    heads = (
        "method", "finished", "one minimum with `md-10`", "above the lowest, kJ/mol", "evaluations",
        "path, rad", "path, nm", "largest step, nm", "entropy loss, J/mol/K",
    )  # fmt: skip
    return markdown(heads, (cells(row) for _, row in rows.iterrows()))


@table("kcm-basins", "kcm_paths.csv")
def kcm_basins(rows: pd.DataFrame) -> str:
    """Ends of equal evaluations from deposited proteins: height, RMSD to the start, and path length."""
    deposited = rows[rows["start"] == "deposited"].sort_values("residues", kind="stable")
    lowest = deposited.groupby("protein")["energy_kj_mol"].min()
    proteins = list(dict.fromkeys(deposited["protein"]))

    def cells(method: str, ends: pd.DataFrame) -> Iterator[str]:
        of = ends.set_index("protein")
        yield f"`{method}`"
        for protein in proteins:
            if protein in of.index:
                row = of.loc[protein]
                yield f"{row['energy_kj_mol'] - lowest[protein]:.1f}, {row['ca_rmsd_angstrom']:.2f}"
            else:
                yield "-"
        yield f"{ends['path_nm'].median():.2f}"
        yield f"{100 * ends['contacts_share'].min():.0f} %"

    sizes = deposited.groupby("protein")["residues"].first()
    heads = (
        "method",
        *(f"{name} ({sizes[name]:.0f})" for name in proteins),
        "median path, nm",
        "least contacts",
    )
    return markdown(heads, (cells(str(name), ends) for name, ends in deposited.groupby("method", sort=False)))


@table("kcm-paths-words", "kcm_methods.csv", "kcm_contrasts.csv")
def kcm_paths_words(rows: pd.DataFrame, contrasts: pd.DataFrame) -> str:
    """What the bounds change, with the verdicts of the contrasts."""
    of = rows.set_index("method")
    main = contrasts[contrasts["scope"] == _first(contrasts)].set_index("what", drop=False)

    def pairs(method: str) -> str:
        return f"{of['same_pairs'][method]:.0f} of {of['pairs'][method]:.0f}"

    def verdict(what: str) -> str:
        row = main.loc[what]
        effect = "" if kcm_summary.resolved(row) else "not resolved, "
        p = kcm_summary.p_value(row["effect_p_scope"])
        return f"{row['same_pairs']:.0f} of {row['pairs']:.0f} pairs ({effect}adjusted p {p})"

    weak, strong = BOUNDS[0], BOUNDS[-1]
    lengths, heights = of["path_nm"], of["above_kj_mol"]
    by_mass = {bound: pairs(f"entropy-mass-{bound:g}") for bound in (weak, strong)}
    paragraphs = (
        "A stronger bound in the metric of masses leads KCM towards dynamics. Without a bound `kcm-0.005` "
        f"and `md-10` end in one minimum in {pairs('kcm-0.005')} peptides. With a bound of {weak:g} nm/rad "
        f"they do in {by_mass[weak]}, with {strong:g} nm/rad in {by_mass[strong]}. "
        f"`kcm-metric` and `md-10` do in {pairs('kcm-metric')}.",
        f"From all starts `kcm-0.005` and its form with the bound of {strong:g} nm/rad by mass end in one "
        f"minimum in {verdict(f'bound {strong:g}, mass')}. With this bound on the C-alphas they do in "
        f"{verdict(f'bound {strong:g}, positions')}. The form bounded by mass and dynamics do in "
        f"{verdict(f'bound {strong:g}, mass, and dynamics')}.",
        f"The mean path has {lengths['kcm-0.005']:.2f} nm without a bound and "
        f"{lengths[f'entropy-mass-{strong:g}']:.2f} nm with this bound by mass. It has "
        f"{lengths['md-10']:.2f} nm in dynamics at a friction of 10 per ps. No method ends near the lowest "
        f"known minimum: the mean heights are {heights.min():.0f} to {heights.max():.0f} kJ/mol.",
    )
    return "\n".join(map(paragraph, paragraphs))
