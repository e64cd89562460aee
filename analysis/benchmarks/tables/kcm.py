"""The study of KCM against constrained dynamics, and what fixed angles leave."""

from collections.abc import Iterator

import pandas as pd

from protochain.analysis.studies import kcm_summary
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
    """Shares of finished pairs that end in one minimum, their baselines, and the effects by energy."""
    named = {"vacuum": "vacuum", "obc2": "OBC2", "nonbonded": "no dihedral terms"}
    of = contrasts[contrasts["start"] == "all"].set_index(["energy", "what"])
    energies = [name for name in named if name in of.index.get_level_values("energy")]

    def cells(what: str, row: pd.Series) -> Iterator[str]:
        yield what
        yield f"{row['pairs']:.0f} ({row['left_out']:.0f})"
        for name in ("same", "baseline", "effect"):
            yield share(row, name)
        for name in energies:
            yield share(of.loc[name, what], "effect") if (name, what) in of.index else "-"

    heads = ["differ in", "finished pairs (left out)", "one minimum", "their controls", "effect"]
    heads += [f"effect, {named[name]}" for name in energies]
    return markdown(heads, (cells(what, row) for what, row in of.loc["all"].iterrows()))


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
    own = contrasts[(contrasts["start"] == "all") & contrasts["rise_kj_mol"].notna()]
    own = own[own["what"].str.startswith("KCM and") & (own["proteins"] >= kcm_summary.FEW)]

    def cells(row: pd.Series) -> Iterator[str]:
        yield f"{row['what']}, {row['energy']}"
        yield f"{row['pairs']:.0f}"
        yield f"{row['rise_kj_mol']:+.1f} ({row['rise_kj_mol_low']:+.1f} to {row['rise_kj_mol_high']:+.1f})"

    heads = ("minima of dynamics above those of KCM", "finished pairs", "kJ/mol")
    return markdown(heads, (cells(row) for _, row in own.iterrows()))
