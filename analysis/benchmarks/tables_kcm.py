"""Tables and words of the study of KCM against constrained dynamics."""

from pathlib import Path

import pandas as pd
from tables import of_rows, paragraph, table

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


@table("kcm-contrasts")
def kcm_contrasts(results: Path) -> str:
    """Share of starts in which methods that differ in one thing reach one minimum."""
    rows = pd.read_csv(results / "kcm_contrasts.csv")
    shares = rows[(rows["model"] == "all") & rows["what"].isin(PAIRS)]
    percent = {name: 100 * shares[name] for name in ("value", "low", "high")}
    return of_rows(
        shares.assign(**percent),
        ("differ in", lambda row: PAIRS[row.what]), ("starts", "{starts}"),
        ("one minimum", "{value:.0f} %"), ("interval", "{low:.0f} to {high:.0f} %"),
    )  # fmt: skip


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


@table("kcm-words")
def kcm_words(results: Path) -> str:
    """What the study's shares say."""
    runs, rows = pd.read_csv(results / "kcm_runs.csv"), pd.read_csv(results / "kcm_contrasts.csv")
    of = rows[rows["model"] == "all"].set_index("what")
    starts = runs[["protein", "start", "seed"]].drop_duplicates()
    extended = int((starts["start"] == "extended").sum())

    def moved(what: str) -> str:
        return f"{100 * (1 - of['value'][what]):.0f} %"

    def share(what: str) -> str:
        return (
            f"{100 * of['value'][what]:.0f} % ({100 * of['low'][what]:.0f} to {100 * of['high'][what]:.0f})"
        )

    pairs = pd.read_csv(results / "kcm_shares.csv")
    pairs = pairs[(pairs["model"] == "all") & (pairs["a"] == "kcm-0.005")].set_index("b")

    def with_other(method: str) -> str:
        return f"{100 * pairs['polished_share'][method]:.0f} %"

    rise = of.loc["dynamics above KCM, kJ/mol"]
    lower = f"{rise['value']:+.0f} ({rise['low']:+.0f} to {rise['high']:+.0f})"
    return paragraph(
        f"Of {len(runs)} runs from {len(starts)} starts, {extended} of them extended peptides of 5 to 20",
        "residues: KCM with a fixed angle of 0.005 rad reaches the same minimum as with 0.01",
        f"({share('angle')} of starts), 0.05 ({with_other('kcm-0.05')}) and adaptive steps",
        f"({share('rule')}), but in proportion",
        f"from {with_other('kcm-proportional')}, and by signs from {with_other('kcm-sign')}.",
        f"KCM and dynamics reach one minimum from {share('KCM and dynamics')}. The metric alone",
        f"changes the minimum from {moved('metric')} of the starts; inertia alone, added to it, from",
        f"{moved('friction 100')} at a friction of 100 per ps, {moved('friction 10')} at 10 and",
        f"{moved('friction 1')} at 1; whether the metric does more than inertia at 1 is open. So is which",
        f"minimum is lower: those of dynamics lie {lower} kJ/mol above those of KCM. Dynamics that is cooled",
        "from 300 K ends lowest, L-BFGS soonest. From deposited structures there are too few runs for an",
        "answer.",
    )
