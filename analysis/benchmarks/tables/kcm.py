"""The study of KCM against constrained dynamics, and what fixed angles leave."""

import pandas as pd

from tables import Cell, digits, markdown, paragraph, percent, table, table_of_rows

PAIRS = {
    "KCM and dynamics": "KCM (0.005 rad) and dynamics (friction 10 per ps)",
    "angle": "angle: 0.005 and 0.01 rad",
    "rule": "rule: fixed angle and adaptive",
    "metric": "metric: adaptive, of the angles and of masses",
    "friction 100": "inertia: metric of masses and friction 100 per ps",
    "friction 10": "inertia: metric of masses and friction 10 per ps",
    "friction 1": "inertia: metric of masses and friction 1 per ps",
}
"""What two methods of the study differ in, and which they are."""


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
    ("method", "`{method}`"), ("starts", "{starts}"), ("converged", "{converged_share:.0%}"),
    ("evaluations", "{evaluations:.0f}"), ("after 10", "{at_10:.1f}"), ("100", "{at_100:.1f}"),
    ("1000", "{at_1000:.2f}"), ("10,000", "{at_10000:.2f}"), ("left at the end", "{left_kj_mol:.2f}"),
    ("after the polish", "{polished_above_kj_mol:.2f}"),
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


def _of_all(contrasts: pd.DataFrame) -> pd.DataFrame:
    """Contrasts of all models, by kind of start and question."""
    return contrasts[contrasts["model"] == "all"].set_index(["start", "what"])


@table("kcm-contrasts", "kcm_contrasts.csv")
def kcm_contrasts(contrasts: pd.DataFrame) -> str:
    """Share of starts in which methods that differ in one thing reach one minimum, by kind of start."""
    of = _of_all(contrasts)
    kinds = list(dict.fromkeys(of.index.get_level_values("start")))
    return markdown(
        ["differ in", *(f"{kind}, {of.loc[kind]['starts'].iloc[0]} starts" for kind in kinds)],
        ([name, *(percent(of.loc[kind, what]) for kind in kinds)] for what, name in PAIRS.items()),
    )


@table("kcm-words", "kcm_runs.csv", "kcm_contrasts.csv", "kcm_shares.csv", "kcm_cost.csv")
def kcm_words(runs: pd.DataFrame, contrasts: pd.DataFrame, shares: pd.DataFrame, cost: pd.DataFrame) -> str:
    """What the study's shares say."""
    rows = _of_all(contrasts)
    starts = runs[["protein", "start", "seed"]].drop_duplicates()["start"].value_counts(sort=False)
    kinds = [kind for kind in starts.index if kind in rows.index]

    def share(what: str, kind: str = "all") -> str:
        return percent(rows.loc[kind, what])

    def moved(what: str) -> str:
        return f"{100 * (1 - rows.loc['all', what]['value']):.0f} %"

    def above(kind: str) -> str:
        row = rows.loc[kind, "dynamics above KCM, kJ/mol"]
        return f"{row['value']:+.0f} ({row['low']:+.0f} to {row['high']:+.0f})"

    pairs = shares[(shares["start"] == "all") & (shares["a"] == "kcm-0.005")].set_index("b")

    def with_other(method: str) -> str:
        return f"{100 * pairs['polished_share'][method]:.0f} %"

    cost = cost.set_index("method")
    lowest, fewest = cost["polished_above_kj_mol"].idxmin(), cost["evaluations"].idxmin()
    apart = rows.loc["all", "metric, less friction 1"]
    more = (
        "the metric matters more than inertia at 1" if apart["high"] < 0.0
        else "inertia at 1 matters more than the metric" if apart["low"] > 0.0
        else "whether the metric matters more than inertia at 1 is open"
    )  # fmt: skip
    counted = ", ".join(f"{n} {kind}" for kind, n in starts.items())
    both = "; ".join(f"{share('KCM and dynamics', kind)} of {kind} starts" for kind in kinds)
    return paragraph(
        f"{len(runs)} runs from {starts.sum()} starts ({counted}).",
        "KCM with a fixed angle of 0.005 rad reaches the same minimum as with 0.01",
        f"({share('angle')} of starts), with 0.05 ({with_other('kcm-0.05')}) and with adaptive steps",
        f"({share('rule')}), but the same as in proportion from only",
        f"{with_other('kcm-proportional')}, and the same as by signs from {with_other('kcm-sign')}.",
        f"KCM and dynamics reach one minimum from {share('KCM and dynamics')}:",
        f"{both}.",
        f"The metric alone changes the minimum from {moved('metric')} of the starts; inertia alone, added to",
        f"it, from {moved('friction 100')} at a friction of 100 per ps, {moved('friction 10')} at 10 and",
        f"{moved('friction 1')} at 1; {more}. Minima of dynamics lie {above('all')} kJ/mol above those of",
        f"KCM ({'; '.join(f'{kind} {above(kind)}' for kind in kinds)}). In the medians `{lowest}` ends",
        f"lowest, and `{fewest}` needs the fewest evaluations.",
    )
