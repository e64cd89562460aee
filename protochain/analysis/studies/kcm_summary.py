"""Answers of the study of KCM against dynamics: contrasts, tables and words, from its table of runs alone.

A contrast is a pair of methods that differ in one thing. It counts starts from which both are finished, and
no others. Its baseline is how often a method ends in the minimum of its own control: the same method with
half the step, another seed, or a start moved by rounding. Only what exceeds that is an effect. Intervals are
95 %, by resampling the proteins, each with all of its starts: they speak of proteins like these.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binomtest, bootstrap

from protochain.analysis.studies import kcm_plots
from protochain.analysis.studies.kcm_cases import (
    AT,
    KEY,
    LEFT,
    METHODS,
    SAME_ANGSTROM,
    SAME_KJ_MOL,
)
from protochain.results.tables import save
from protochain.structure.superpose import rmsd_angstrom

START = ["protein", "model", "energy", "start", "seed"]
FEW = 3
"""Proteins below which nothing is concluded."""
CONTROLS: Mapping[str, Mapping[str, str]] = {
    "half the step": {
        "kcm-0.005": "kcm-0.0025", "kcm-adaptive": "kcm-adaptive-half", "kcm-metric": "kcm-metric-half",
        "md-1": "md-1-half", "md-10": "md-10-half",
    },
    "another order of sums": {
        name: f"{name}-nudged" for name in ("kcm-0.005", "kcm-adaptive", "kcm-metric", "md-1")
    },
    "another seed": {"md-cooled": "md-cooled-reseeded"},
}  # fmt: skip
"""By kind: methods and what they are without, for all that is known, any difference."""


@dataclass(frozen=True)
class Contrast:
    """Two methods, and what they differ in.

    Parameters
    ----------
    what, a, b : str
    is_control : bool
        Whether nothing should depend on the difference.
    """

    what: str
    a: str
    b: str
    is_control: bool = False


CONTRASTS = (
    *(Contrast(f"KCM and dynamics, friction {f}", "kcm-0.005", f"md-{f}") for f in (1, 10, 100)),
    Contrast("metric", "kcm-adaptive", "kcm-metric"),
    *(Contrast(f"inertia, friction {f}", "kcm-metric", f"md-{f}") for f in (1, 10, 100)),
    Contrast("rule: adaptive angle", "kcm-0.005", "kcm-adaptive"),
    Contrast("rule: constant compliance", "kcm-0.005", "kcm-proportional"),
    Contrast("rule: by signs", "kcm-0.005", "kcm-sign"),
    Contrast("twice the step of kcm-0.005", "kcm-0.005", "kcm-0.01", True),
    *(
        Contrast(f"{kind} of {a}", a, b, True)
        for kind, pairs in CONTROLS.items()
        for a, b in pairs.items()
    ),
)  # fmt: skip
"""KCM in the metric of masses is overdamped motion of the chain: it differs from KCM with the same rule by
the metric alone, and from dynamics by the inertia that friction, per ps, leaves. The rules of KCM turn along
the same torques: a fixed largest angle, one that adapts, one compliance for all, or, by signs, all hinges by
one angle."""
SECONDS = (0.1, 1.0, 10.0)
_RESAMPLES = 4000


def write(output: Path, runs: pd.DataFrame, planned: set[tuple[Any, ...]]) -> Iterator[pd.DataFrame]:
    """Write and yield what follows from the runs: tables, the figure, and ``summary.md``."""
    made = tables(runs)
    if not made:
        return
    save(output, {f"{name}.csv": table for name, table in made.items()})
    traces = output / "traces.csv"
    figure = kcm_plots.plot(made, pd.read_csv(traces) if traces.exists() else None)
    lines = [counts(runs, planned), *words(runs, made["contrasts"])]
    save(output, {"kcm.png": figure, "summary.md": "\n\n".join(["# KCM against dynamics", *lines]) + "\n"})
    yield made["contrasts"]
    yield pd.DataFrame({"summary": lines})


def tables(runs: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Tables by name: ``contrasts``, ``cost`` and ``deposited``; none without runs."""
    done = runs[runs["energy_kj_mol"].notna()] if len(runs) else runs
    if done.empty:
        return {}
    return {"contrasts": contrasts(done), "cost": cost(done), "deposited": deposited(done)}


def counts(runs: pd.DataFrame, planned: set[tuple[Any, ...]]) -> str:
    """How many of the runs planned there are."""
    keys = set(runs[list(KEY)].itertuples(index=False, name=None))
    others = f", and {len(keys - planned)} others" if keys - planned else ""
    return f"{len(keys & planned)} of {len(planned)} runs planned{others}."


def compared(runs: pd.DataFrame) -> pd.DataFrame:
    """Contrasts of every start: whether both are finished, one minimum, and how far b ends above a."""
    rows = []
    for key, own in runs.groupby(START, sort=False):
        ends = {row["method"]: row for row in own.to_dict("records")}
        for each in CONTRASTS:
            if each.a not in ends or each.b not in ends:
                continue
            a, b = ends[each.a], ends[each.b]
            apart = rmsd_angstrom(_alphas(a), _alphas(b))
            rise = b["energy_kj_mol"] - a["energy_kj_mol"]
            rows.append(
                dict(zip(START, key, strict=True))
                | {
                    "what": each.what, "finished": bool(a["finished"] and b["finished"]),
                    "same": float(apart < SAME_ANGSTROM and abs(rise) < SAME_KJ_MOL), "rise_kj_mol": rise,
                }
            )  # fmt: skip
    return pd.DataFrame(rows, columns=[*START, "what", "finished", "same", "rise_kj_mol"])


def contrasts(runs: pd.DataFrame) -> pd.DataFrame:
    """Shares of finished pairs that end in one minimum, their baselines and effects.

    One row an energy (``all`` together), kind of start and contrast. ``pairs`` counts the finished pairs,
    ``left_out`` the others. ``same`` is the mean over proteins of their shares; ``baseline`` that of the
    controls of both methods, from the same starts; ``effect`` their difference, of the starts that have a
    baseline; ``rise_kj_mol`` how far the second's minima lie above the first's; each has its limits, ``_low``
    and ``_high``. ``proteins_needed``: how many would tell the effect from 0, were they like these.
    """
    pairs = compared(runs)
    rows = []
    for scope, own in _scopes(pairs):
        finished = own[own["finished"].astype(bool)].set_index([*START, "what"])
        wide = finished["same"].unstack("what") if len(finished) else finished
        by_what = dict(iter(own.groupby("what", sort=False)))
        effects: dict[str, pd.Series] = {}
        for each in CONTRASTS:
            if each.what not in by_what:
                continue
            every = by_what[each.what]
            row = {**scope, "what": each.what, "starts": len(every), "pairs": int(every["finished"].sum())}
            row["left_out"] = row["starts"] - row["pairs"]
            if row["pairs"] == 0:
                rows.append(row)
                continue
            same = wide[each.what].dropna()
            row["proteins"] = same.index.get_level_values("protein").nunique()
            row |= _interval("same", same, 0.0)
            if not each.is_control:
                baseline = _baseline(wide, each).reindex(same.index).dropna()
                if len(baseline):
                    effects[each.what] = baseline - same.reindex(baseline.index)
                    row |= _interval("baseline", baseline, 0.0) | _interval(
                        "effect", effects[each.what], -1.0
                    )
                    row["proteins_needed"] = _needed(effects[each.what])
                rises = finished["rise_kj_mol"].xs(each.what, level="what")
                row |= _interval("rise_kj_mol", rises)
            rows.append(row)
        rows += [
            {**scope, "what": f"metric less {what}", "starts": len(both), "pairs": len(both), "left_out": 0,
             "proteins": both.index.get_level_values("protein").nunique(), **_interval("effect", both, -1.0),
             "proteins_needed": _needed(both)}
            for what, both in _differences(effects)
        ]  # fmt: skip
    names = [f"{name}{end}" for name in ("same", "baseline", "effect", "rise_kj_mol") for end in ("", *_ENDS)]
    columns = [
        "energy",
        "start",
        "what",
        "starts",
        "pairs",
        "left_out",
        "proteins",
        *names,
        "proteins_needed",
    ]
    return pd.DataFrame(rows, columns=columns)


def _differences(effects: Mapping[str, pd.Series]) -> Iterator[tuple[str, pd.Series]]:
    """How much more the metric changes than inertia, from starts that have both."""
    for what, inertia in effects.items():
        if what.startswith("inertia") and "metric" in effects:
            both = (effects["metric"] - inertia).dropna()
            if len(both):
                yield what, both


def _baseline(wide: pd.DataFrame, contrast: Contrast) -> pd.Series:
    """By start: the share of the controls of both methods that end in their minimum."""
    of = [
        f"{kind} of {method}"
        for kind, pairs in CONTROLS.items()
        for method in (contrast.a, contrast.b)
        if method in pairs
    ]
    return wide.reindex(columns=of).mean(axis=1)


def words(runs: pd.DataFrame, table: pd.DataFrame) -> Iterator[str]:
    """Sentences that the contrasts carry; where an interval leaves it open, they say so."""
    done = runs[runs["energy_kj_mol"].notna()]
    n_starts = len(done[START].drop_duplicates())
    named = ", ".join(done["protein"].unique())
    yield (
        f"{len(runs)} runs from {n_starts} starts (each of a model with an energy) of these "
        f"{done['protein'].nunique()} proteins: {named}. Only finished pairs count: both runs within "
        f"{LEFT:g} kJ/mol of the minimum that their own continuation leads to."
    )
    together = table[(table["start"] == "all") & (table["energy"] == "all")]
    for row in together.to_dict("records"):
        if said := sentence_of(row):
            yield said


_SAID = {each.what: each for each in CONTRASTS if not each.is_control}


def sentence_of(row: Mapping[Any, Any]) -> str:
    """Say what a row of the contrasts shows, in numbers; empty for a control."""
    what = str(row["what"])
    if what.startswith("metric less"):
        verdict = _verdict(row, "inertia does more", "the metric does more")
        friction = what.rsplit(" ", 1)[1]
        return f"Metric against inertia at a friction of {friction} per ps: {verdict}{_more(row)}."
    if what not in _SAID:
        return ""
    pair = f"`{_SAID[what].a}` and `{_SAID[what].b}` ({what})"
    left = f"{row['left_out']} of {row['starts']} starts left out"
    if not row["pairs"]:
        return f"{pair}: no finished pair; {left}."
    shares = f"one minimum from {_percent(row, 'same')} of {row['pairs']} finished pairs"
    if row["proteins"] < FEW:
        return f"{pair}: {shares}, of too few proteins for an answer; {left}."
    if not np.isfinite(row["effect"]):
        return f"{pair}: {shares}, without a baseline; {left}."
    verdict = _verdict(row, "more alike than their controls", "an effect")
    return (
        f"{pair}: {shares}, their controls {_percent(row, 'baseline')}: a difference of "
        f"{_percent(row, 'effect')}, {verdict}{_more(row)}; {left}."
    )


def _verdict(row: Mapping[Any, Any], below: str, above: str) -> str:
    if row["proteins"] < FEW:
        return "too few proteins"
    if row["effect_high"] < 0.0:
        return below
    return above if row["effect_low"] > 0.0 else "open"


def _more(row: Mapping[Any, Any]) -> str:
    """How many proteins would settle what is open."""
    is_open = row["proteins"] >= FEW and row["effect_low"] <= 0.0 <= row["effect_high"]
    if not is_open:
        return ""
    needed = row["proteins_needed"]
    return f" ({needed:.0f} proteins like these would settle it)" if np.isfinite(needed) else ""


def _percent(row: Mapping[Any, Any], name: str) -> str:
    low, high = (100.0 * row[f"{name}{end}"] for end in _ENDS)
    return f"{100.0 * row[name]:.0f} % ({low:.0f} to {high:.0f})"


def cost(runs: pd.DataFrame) -> pd.DataFrame:
    """Lowest energy for equal cost, by method: medians over starts from which all in torsions have run.

    Energies, in kJ/mol, are above the lowest minimum of all methods in torsions from the same start, after so
    many evaluations and so many seconds; ``minimum`` is where the run leads.
    """
    torsional = runs[runs["method"] != "openmm"]
    n = torsional["method"].nunique()
    found = torsional[torsional.groupby(START)["method"].transform("nunique") == n]
    lowest = found.groupby(START)["energy_kj_mol"].transform("min")
    names = [f"energy_at_{k}" for k in AT]
    above = found[names].sub(lowest, axis=0).set_axis([f"at_{k}" for k in AT], axis=1)
    energies = found[names].to_numpy()
    for seconds in SECONDS:
        # Seconds a run takes are in proportion to its evaluations.
        reached = found["evaluations"] * np.minimum(1.0, seconds / found["seconds"])
        place = np.maximum(np.searchsorted(AT, reached, side="right") - 1, 0)
        above[f"at_{1000.0 * seconds:g}_ms"] = energies[np.arange(len(found)), place] - lowest
    above = above.assign(
        method=found["method"], finished=found["finished"].astype(float), evaluations=found["evaluations"],
        left_kj_mol=found["left_kj_mol"], minimum_kj_mol=found["energy_kj_mol"] - lowest,
    )  # fmt: skip
    groups = above.groupby("method", sort=False)
    table = groups.median()
    table["finished"] = groups["finished"].mean()
    table.insert(0, "starts", groups.size())
    return table.reindex([name for name in METHODS if name in table.index]).reset_index()


def deposited(runs: pd.DataFrame) -> pd.DataFrame:
    """C-alpha RMSD from deposited structures to the minima, of starts that every method has run from."""
    own = runs[(runs["start"] == "deposited") & (runs["energy"] != "nonbonded")]
    n = own["method"].nunique()
    own = own[own.groupby(START)["method"].transform("nunique") == n]
    of = own["rmsd_start_angstrom"].groupby(own["method"], sort=False)
    found = {"starts": of.size(), "median_angstrom": of.median(), "largest_angstrom": of.max()}
    return pd.DataFrame(found).reset_index(names="method")


def _alphas(row: Mapping[Any, Any]) -> np.ndarray:
    """(n, 3) float, nm: C-alphas of a row."""
    return np.array(row["alphas_pm"].split(), dtype=float).reshape(-1, 3) / 1000.0


def _scopes(pairs: pd.DataFrame) -> Iterator[tuple[dict[str, Any], pd.DataFrame]]:
    """All together; by kind of start; by energy."""
    yield {"energy": "all", "start": "all"}, pairs
    for kind, own in pairs.groupby("start", sort=False):
        yield {"energy": "all", "start": kind}, own
    for energy, own in pairs.groupby("energy", sort=False):
        yield {"energy": energy, "start": "all"}, own


_ENDS = ("_low", "_high")


def _by_protein(values: pd.Series) -> np.ndarray:
    return np.asarray(values.groupby(level="protein", sort=False).mean(), dtype=float)


def _interval(name: str, values: pd.Series, least: float = -np.inf) -> dict[str, float]:
    """Mean over proteins of values by start, with its 95 % interval by resampling proteins (percentiles).

    ``least`` is that of a share (0) or of a difference of shares (-1): where all proteins agree nothing
    varies, and the interval is as wide as the exact binomial one of none in so many.
    """
    means = _by_protein(values)
    mean = low = high = float(means.mean())
    if np.ptp(means) > 0.0:
        random = np.random.default_rng(0)
        found = bootstrap((means,), np.mean, n_resamples=_RESAMPLES, method="percentile", rng=random)
        low, high = found.confidence_interval
    elif np.isfinite(least):
        width = binomtest(0, len(means)).proportion_ci(0.95, "exact").high
        low, high = max(least, mean - width), min(1.0, mean + width)
    return {name: mean, f"{name}_low": float(low), f"{name}_high": float(high)}


def _needed(values: pd.Series) -> float:
    """Number of proteins whose interval would not hold 0, if mean and spread stayed as they are."""
    means = _by_protein(values)
    if len(means) < FEW or not means.mean():
        return np.nan
    return float(np.ceil((1.96 * means.std(ddof=1) / means.mean()) ** 2))
