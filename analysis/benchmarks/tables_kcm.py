"""Tables and words of the study of KCM against constrained dynamics."""

from pathlib import Path

import pandas as pd
from tables import markdown, of_rows, paragraph, table

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
RISE = "dynamics above KCM, kJ/mol"


@table("kcm-contrasts")
def kcm_contrasts(results: Path) -> str:
    """Share of starts in which methods that differ in one thing reach one minimum, by kind of start."""
    rows = pd.read_csv(results / "kcm_contrasts.csv")
    rows = rows[rows["model"] == "all"]
    kinds = list(dict.fromkeys(rows["start"]))
    of = rows.set_index(["start", "what"])

    def cell(kind: str, what: str) -> str:
        row = of.loc[kind, what]
        return f"{100 * row['value']:.0f} % ({100 * row['low']:.0f} to {100 * row['high']:.0f})"

    return markdown(
        ["differ in", *(f"{kind}, {of.loc[kind]['starts'].iloc[0]} starts" for kind in kinds)],
        ([name, *(cell(kind, what) for kind in kinds)] for what, name in PAIRS.items()),
    )


@table("kcm-cost")
def kcm_cost(results: Path) -> str:
    """Energies of the study for equal cost, above the lowest polished end of each start."""
    return of_rows(
        pd.read_csv(results / "kcm_cost.csv"),
        ("method", "`{method}`"), ("starts", "{starts}"), ("converged", lambda r: f"{r.converged_share:.0%}"),
        ("evaluations", "{evaluations:.0f}"), ("after 10", "{at_10:.1f}"), ("100", "{at_100:.1f}"),
        ("1000", "{at_1000:.2f}"), ("10,000", "{at_10000:.2f}"), ("left at the end", "{left_kj_mol:.2f}"),
        ("after the polish", "{polished_above_kj_mol:.2f}"),
    )  # fmt: skip


@table("kcm-deposited")
def kcm_deposited(results: Path) -> str:
    """How far minima lie from deposited structures, by method."""
    return of_rows(
        pd.read_csv(results / "kcm_deposited.csv"), ("method", "`{method}`"), ("starts", "{starts}"),
        ("median, angstrom", "{median_angstrom:.2f}"), ("largest", "{largest_angstrom:.2f}"),
    )  # fmt: skip


@table("kcm-words")
def kcm_words(results: Path) -> str:
    """What the study's shares say."""
    runs, rows = pd.read_csv(results / "kcm_runs.csv"), pd.read_csv(results / "kcm_contrasts.csv")
    rows = rows[rows["model"] == "all"].set_index(["start", "what"])
    starts = runs[["protein", "start", "seed"]].drop_duplicates()["start"].value_counts(sort=False)
    of = rows.loc["all"]

    def moved(what: str) -> str:
        return f"{100 * (1 - of['value'][what]):.0f} %"

    def share(what: str, kind: str = "all") -> str:
        row = rows.loc[kind, what]
        return f"{100 * row['value']:.0f} % ({100 * row['low']:.0f} to {100 * row['high']:.0f})"

    def above(kind: str) -> str:
        row = rows.loc[kind, RISE]
        return f"{row['value']:+.0f} ({row['low']:+.0f} to {row['high']:+.0f})"

    pairs = pd.read_csv(results / "kcm_shares.csv")
    pairs = pairs[(pairs["start"] == "all") & (pairs["a"] == "kcm-0.005")].set_index("b")

    def with_other(method: str) -> str:
        return f"{100 * pairs['polished_share'][method]:.0f} %"

    cost = pd.read_csv(results / "kcm_cost.csv").set_index("method")
    lowest, soonest = cost["polished_above_kj_mol"].idxmin(), cost["evaluations"].idxmin()
    apart = of.loc["metric, less friction 1"]
    more = (
        "the metric does more than inertia at 1" if apart["high"] < 0.0
        else "inertia at 1 does more than the metric" if apart["low"] > 0.0
        else "whether the metric does more than inertia at 1 is open"
    )  # fmt: skip
    kinds = [kind for kind in starts.index if kind in rows.index]
    counted = ", ".join(f"{n} {kind}" for kind, n in starts.items())
    both = "; ".join(f"{share('KCM and dynamics', kind)} of {kind} starts" for kind in kinds)
    return paragraph(
        f"Of {len(runs)} runs from {starts.sum()} starts ({counted}):",
        "KCM with a fixed angle of 0.005 rad reaches the same minimum as with 0.01",
        f"({share('angle')} of starts), 0.05 ({with_other('kcm-0.05')}) and adaptive steps",
        f"({share('rule')}), but in proportion",
        f"from {with_other('kcm-proportional')}, and by signs from {with_other('kcm-sign')}.",
        f"KCM and dynamics reach one minimum from {share('KCM and dynamics')}:",
        f"{both}.",
        f"The metric alone changes the minimum from {moved('metric')} of the starts; inertia alone, added to",
        f"it, from {moved('friction 100')} at a friction of 100 per ps, {moved('friction 10')} at 10 and",
        f"{moved('friction 1')} at 1; {more}. Minima of dynamics lie {above('all')} kJ/mol above those of",
        f"KCM ({'; '.join(f'{kind} {above(kind)}' for kind in kinds)}). In the medians `{lowest}` ends",
        f"lowest, and `{soonest}` needs the fewest evaluations.",
    )
