"""Answers of the study of KCM against dynamics: contrasts, tables and words, from its table of runs alone.

A contrast is a pair of methods that differ in one thing. It counts starts from which both are finished, and
no others. Its controls are both methods against themselves, with half the step and from starts moved by
rounding; of these the worst counts, the one that comes back to its minimum least often. Only what exceeds it
is an effect. Energies and sizes are not pooled. Intervals are 95 %, by resampling the proteins, each with all
of its starts: they speak of proteins like these. Whether there is an effect is decided by exact sign-flip
tests over proteins, with Holm's correction for all effects of a table.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binomtest, bootstrap

from bench.studies import kcm_plots, lowest, paths
from bench.studies.kcm_cases import (
    AT,
    BODIES,
    BOUNDS,
    CONTROLS,
    KEY,
    LEFT,
    METHODS,
    METRICS,
    MODELS,
    OF_BODIES,
    SAME_KJ_MOL,
    SMALL,
    TIME_STEPS,
    TRIALS,
    fixes_plane,
    same_minimum,
)
from bench.studies.kcm_statistics import LEVEL, MOST, POWER, holm, proteins_needed, sign_flip
from protochain.results.figures import write_figure
from protochain.results.tables import save

START = ["protein", "model", "energy", "start", "seed"]
FEW = 3
"""Proteins below which nothing is concluded."""


@dataclass(frozen=True)
class Contrast:
    """Two methods, and what they differ in.

    is_control: Whether nothing should depend on the difference.
    """

    what: str
    a: str
    b: str
    is_control: bool = False


CONTRASTS = (
    *(Contrast(f"KCM and dynamics, friction {f:g}", "kcm-0.005", f"md-{f:g}") for f in TIME_STEPS),
    Contrast("metric of masses", "kcm-adaptive", "kcm-metric"),
    Contrast("metric of stiffness", "kcm-adaptive", "kcm-stiffness"),
    *(Contrast(f"inertia, friction {f:g}", "kcm-metric", f"md-{f:g}") for f in TIME_STEPS),
    Contrast("root, without inertia", "kcm-metric", "kcm-metric-fixed"),
    Contrast("root, friction 10", "md-10", "md-10-fixed"),
    Contrast("stiffness and masses", "kcm-stiffness", "kcm-metric"),
    Contrast("stiffness and dynamics, friction 10", "kcm-stiffness", "md-10"),
    Contrast("rule: adaptive angle", "kcm-0.005", "kcm-adaptive"),
    Contrast("rule: constant compliance", "kcm-0.005", "kcm-proportional"),
    Contrast("rule: by signs", "kcm-0.005", "kcm-sign"),
    *(
        Contrast(f"bound {bound:g}, {metric}", "kcm-0.005", f"entropy-{metric}-{bound:g}")
        for metric, bound in product(METRICS, BOUNDS)
    ),
    *(
        Contrast(f"bound {BOUNDS[-1]:g}, {metric}, and dynamics", f"entropy-{metric}-{BOUNDS[-1]:g}", "md-10")
        for metric in METRICS
    ),
    *(
        Contrast(f"{kind} of {name}", name, f"{name}-{end}", True)
        for name in TRIALS
        for kind, end in CONTROLS.items()
        if f"{name}-{end}" in TRIALS and not fixes_plane(name)
    ),
)
"""KCM in the metric of masses is overdamped motion of the chain: it differs from KCM with the same rule by
the metric alone, and from dynamics by the inertia that friction, per ps, leaves. The rules of KCM turn along
the same torques: a fixed largest angle, one that adapts, one compliance for all, or, by signs, all hinges by
one angle."""
FIXED: Mapping[str, str] = {
    "fixed": "C-alpha of the middle residue", **{body: f"{body} peptide plane" for body in BODIES}
}  # fmt: skip
"""Bodies that are fixed, by the ends of the names of methods."""
INERTIA: Mapping[str, str] = dict(zip(OF_BODIES, ("without inertia", "friction 10"), strict=True))
BODY_CONTRASTS = (
    *(
        Contrast(f"{body}, {inertia}", name, f"{name}-{end}")
        for name, inertia in INERTIA.items()
        for end, body in FIXED.items()
    ),
    *(
        Contrast(f"{kind} of {name}", name, f"{name}-{end}", True)
        for name in [*INERTIA, *(f"{name}-{body}" for name in INERTIA for body in FIXED)]
        for kind, end in CONTROLS.items()
    ),
)
"""The free root against each fixed body."""
SCOPES: Mapping[str, Mapping[str, Any]] = {
    "OBC2": {"energy": "obc2", "model": MODELS[0], "is_small": True},
    f"OBC2, more than {SMALL} residues": {"energy": "obc2", "model": MODELS[0], "is_small": False},
    "OBC2, rigid side chains": {"energy": "obc2", "model": MODELS[1], "is_small": True},
    "vacuum": {"energy": "vacuum", "model": MODELS[0], "is_small": True},
    "no dihedral terms": {"energy": "nonbonded", "model": MODELS[0], "is_small": True},
}
"""Runs that are counted together."""
MAIN, IN_WORDS = next(iter(SCOPES)), list(SCOPES)[:2]
"""Scope with a table alone, and scopes whose contrasts are put in words."""
RISES = ("KCM and", "inertia", "root", "metric of")
"""Beginnings of the contrasts whose ends are compared by energy."""
SECONDS = (0.1, 1.0, 10.0)
_RESAMPLES = 4000


def write(
    output: Path, runs: pd.DataFrame, planned: set[tuple[Any, ...]], paper: Path | None = None
) -> Iterator[pd.DataFrame]:
    """Write and yield what follows from the runs: tables, the figure, and ``summary.md``."""
    searches = output / "lowest.csv"
    made = tables(runs, lowest.stored(searches))
    if not made:
        return
    if (output / "paths.csv").exists():
        rows = lowest.stored(output / "paths.csv", paths.COLUMNS)
        points = pd.read_csv(output / "path_points.csv")
        made["methods"] = methods(runs, made["above"], rows)
        save(output, {"kcm-paths.png": kcm_plots.plot_paths(points, rows)})
    save(output, {f"{name}.csv": table for name, table in made.items()})
    traces = output / "traces.csv"
    draw = partial(kcm_plots.plot, made, pd.read_csv(traces) if traces.exists() else None)
    if paper:
        write_figure(paper, draw)
    lines = [counts(runs, planned), *words(runs, made["contrasts"]), *body_words(made["choices"])]
    save(output, {"kcm.png": draw(), "summary.md": "\n\n".join(["# KCM against dynamics", *lines]) + "\n"})
    yield made["contrasts"]
    yield pd.DataFrame({"summary": lines})


def tables(runs: pd.DataFrame, searches: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Tables by name, from runs and searches for the lowest minima; none without runs."""
    done = runs[runs["energy_kj_mol"].notna()] if len(runs) else runs
    if done.empty:
        return {}
    pairs, minima = compared(done), lowest_known(done, searches)
    return {
        "contrasts": contrasts(pairs), "proteins": by_protein(pairs), "cost": cost(done),
        "deposited": deposited(done), "bodies": bodies(done), "choices": choices(done),
        "minima": minima, "above": above(done, minima),
    }  # fmt: skip


def counts(runs: pd.DataFrame, planned: set[tuple[Any, ...]]) -> str:
    """How many of the runs planned there are."""
    keys = set(runs[list(KEY)].itertuples(index=False, name=None))
    others = f", and {len(keys - planned)} others" if keys - planned else ""
    return f"{len(keys & planned)} of {len(planned)} runs planned{others}."


def compared(runs: pd.DataFrame, which: Sequence[Contrast] = CONTRASTS) -> pd.DataFrame:
    """Contrasts of every start: whether both are finished, one minimum, and how far b ends above a."""
    rows = []
    for key, own in runs.groupby(START, sort=False):
        ends = {row["method"]: row for row in own.to_dict("records")}
        for each in which:
            if each.a not in ends or each.b not in ends:
                continue
            a, b = ends[each.a], ends[each.b]
            rise = b["energy_kj_mol"] - a["energy_kj_mol"]
            rows.append(
                dict(zip(START, key, strict=True))
                | {
                    "residues": a["residues"], "what": each.what,
                    "finished": bool(a["finished"] and b["finished"]),
                    "same": float(same_minimum(_torsions(a), _torsions(b), rise)), "rise_kj_mol": rise,
                }
            )  # fmt: skip
    return pd.DataFrame(rows, columns=[*START, "residues", "what", "finished", "same", "rise_kj_mol"])


def contrasts(pairs: pd.DataFrame, which: Sequence[Contrast] = CONTRASTS) -> pd.DataFrame:
    """Shares of pairs that end in one minimum, their controls and effects, from what ``compared`` returns.

    One row a scope and contrast. ``pairs`` counts the finished pairs, ``left_out`` the others, ``same_pairs``
    those that end in one minimum. ``same`` is the mean over proteins of their shares; ``baseline`` that of
    the worst control, named in ``control``, from the same starts; ``effect`` their difference, of the starts
    that have that control; ``rise_kj_mol`` how far the second's minima lie above the first's; each has its
    limits, ``_low`` and ``_high``. ``effect_p`` and ``rise_kj_mol_p`` are exact, of sign flips of the
    proteins' means; ``effect_p_scope`` and ``effect_p_all`` are corrected by Holm's method for the effects of
    the scope and of all scopes, ``rise_kj_mol_p_all`` for the rises of ``RISES``. ``proteins_needed``: how
    many like these resolve an effect that is not resolved in words, with a chance of ``POWER``.
    """
    rows = []
    means: list[np.ndarray] = []
    for scope, own in _scopes(pairs):
        finished = own[own["finished"].astype(bool)].set_index([*START, "what"])
        wide = finished["same"].unstack("what") if len(finished) else finished
        by_what = dict(iter(own.groupby("what", sort=False)))
        effects: dict[str, pd.Series] = {}
        for each in which:
            if each.what not in by_what:
                continue
            every, effect = by_what[each.what], np.empty(0)
            row: dict[str, Any] = {"scope": scope, "what": each.what, "starts": len(every)}
            row["pairs"] = int(every["finished"].sum())
            row["left_out"] = row["starts"] - row["pairs"]
            if row["pairs"]:
                same = wide[each.what].dropna()
                row["same_pairs"] = int(same.sum())
                row["proteins"] = same.index.get_level_values("protein").nunique()
                row |= _interval("same", same, 0.0)
                if not each.is_control:
                    row["control"], baseline = _worst_control(wide, each, same.index, which)
                    if len(baseline):
                        effects[each.what] = baseline - same.reindex(baseline.index)
                        row |= _interval("baseline", baseline, 0.0)
                        row |= _interval("effect", effects[each.what], -1.0)
                        effect = _by_protein(effects[each.what])
                    rises = finished["rise_kj_mol"].xs(each.what, level="what")
                    row |= _interval("rise_kj_mol", rises)
                    row["rise_kj_mol_p"] = _tested(_by_protein(rises))
            rows.append(row)
            means.append(effect)
        for what, both in _differences(effects):
            rows.append(
                {"scope": scope, "what": f"metric less {what}", "starts": len(both), "pairs": len(both),
                 "left_out": 0, "proteins": both.index.get_level_values("protein").nunique(),
                 **_interval("effect", both, -1.0)}
            )  # fmt: skip
            means.append(_by_protein(both))
    names = [f"{name}{end}" for name in ("same", "baseline", "effect", "rise_kj_mol") for end in ("", *_ENDS)]
    columns = ["scope", "what", "starts", "pairs", "left_out", "same_pairs", "proteins", "control"]
    return _corrected(pd.DataFrame(rows, columns=[*columns, *names, "rise_kj_mol_p"]), means)


def _tested(means: np.ndarray) -> float:
    """Exact p of the means (n,) of proteins; NaN of too few."""
    return sign_flip(means) if len(means) >= FEW else np.nan


def _corrected(table: pd.DataFrame, means: Sequence[np.ndarray]) -> pd.DataFrame:
    """Contrasts with their p, those of one table corrected together, and numbers of proteins."""
    table["effect_p"] = [_tested(effect) for effect in means]
    scopes = table.groupby("scope", sort=False)["effect_p"]
    table["effect_p_scope"] = scopes.transform(lambda p: holm(p.to_numpy()))
    table["effect_p_all"] = holm(table["effect_p"].to_numpy())
    is_shown = table["what"].str.startswith(RISES)
    table["rise_kj_mol_p_all"] = holm(table["rise_kj_mol_p"].where(is_shown).to_numpy())
    table["proteins_needed"] = np.nan
    for scope in IN_WORDS:
        family = table["scope"].eq(scope) if scope == MAIN else table["scope"].notna()
        is_open = family & (table[_corrected_for(scope)] > LEVEL)
        for k in table.index[is_open & table["scope"].eq(scope)]:
            # Holm's method tests the least p of the unresolved effects at this level.
            table.loc[k, "proteins_needed"] = proteins_needed(means[k], LEVEL / is_open.sum())
    return table


def _corrected_for(scope: Any) -> str:
    """Column of the corrected p by which a scope's effects are put in words."""
    return "effect_p_scope" if scope == MAIN else "effect_p_all"


def by_protein(pairs: pd.DataFrame) -> pd.DataFrame:
    """Finished pairs of each protein, and those that end in one minimum, by scope and contrast."""
    rows = []
    for scope, own in _scopes(pairs):
        finished = own[own["finished"].astype(bool)]
        for (protein, what), each in finished.groupby(["protein", "what"], sort=False):
            rows.append((scope, protein, each["residues"].iloc[0], what, len(each), int(each["same"].sum())))
    return pd.DataFrame(rows, columns=["scope", "protein", "residues", "what", "pairs", "same_pairs"])


def _differences(effects: Mapping[str, pd.Series]) -> Iterator[tuple[str, pd.Series]]:
    """How much more the metric of masses changes than inertia, from starts that have both."""
    for what, inertia in effects.items():
        if what.startswith("inertia") and "metric of masses" in effects:
            both = (effects["metric of masses"] - inertia).dropna()
            if len(both):
                yield what, both


def _worst_control(
    wide: pd.DataFrame, contrast: Contrast, starts: pd.Index, which: Sequence[Contrast]
) -> tuple[str, pd.Series]:
    """Control of either method with the least share of one minimum from these starts, and its outcomes."""
    of = {
        each.what: wide[each.what].reindex(starts).dropna()
        for each in which
        if each.is_control and each.a in (contrast.a, contrast.b) and each.what in wide
    }
    known = {what: values for what, values in of.items() if len(values)}
    if not known:
        return "", pd.Series(dtype=float)
    return min(known.items(), key=lambda item: float(_by_protein(item[1]).mean()))


def words(runs: pd.DataFrame, table: pd.DataFrame) -> Iterator[str]:
    """Sentences that the contrasts carry; what the tests do not resolve is called so."""
    done = runs[runs["energy_kj_mol"].notna()]
    n_starts = len(done[START].drop_duplicates())
    named = ", ".join(done["protein"].unique())
    yield (
        f"{len(runs)} runs from {n_starts} starts (each of a model with an energy) of these "
        f"{done['protein'].nunique()} proteins: {named}. Only finished pairs count: both runs within "
        f"{LEFT:g} kJ/mol of the minimum that their own continuation leads to."
    )
    for row in table[table["scope"].isin(IN_WORDS)].to_dict("records"):
        if sentence := sentence_of(row):
            yield sentence


_WORDED = {each.what: each for each in CONTRASTS if not each.is_control}


def sentence_of(row: Mapping[Any, Any]) -> str:
    """Say what a row of the contrasts shows, in numbers; empty for a control."""
    what = str(row["what"])
    if what.startswith("metric less"):
        verdict = _verdict(row, "inertia does more", "the metric does more")
        friction = what.rsplit(" ", 1)[1]
        compared = f"metric against inertia at a friction of {friction} per ps"
        return f"{row['scope']}: {compared}: a difference of {_percent(row, 'effect')}, {verdict}."
    if what not in _WORDED:
        return ""
    pair = f"{row['scope']}: `{_WORDED[what].a}` and `{_WORDED[what].b}` ({what})"
    left = f"{row['left_out']} of {row['starts']} starts left out"
    if not row["pairs"]:
        return f"{pair}: no finished pair; {left}."
    raw = f"{row['same_pairs']:.0f} of {row['pairs']} finished pairs"
    shares = f"one minimum from {raw}, {100 * row['same_pairs'] / row['pairs']:.0f} %; by protein "
    shares += _percent(row, "same")
    if row["proteins"] < FEW:
        return f"{pair}: {shares}, of too few proteins for an answer; {left}."
    if not np.isfinite(row["effect"]):
        return f"{pair}: {shares}, without a control; {left}."
    verdict = _verdict(row, "more alike than the control", "an effect")
    return (
        f"{pair}: {shares}; the worst control, {row['control']}, {_percent(row, 'baseline')}: "
        f"a difference of {_percent(row, 'effect')}, {verdict}; {left}."
    )


def resolved(row: Mapping[Any, Any]) -> bool:
    """Whether the test of a row of the contrasts concludes an effect."""
    return bool(row[_corrected_for(row["scope"])] <= LEVEL)


def _verdict(row: Mapping[Any, Any], below: str, above: str) -> str:
    """Conclusion of the test, with its p, and how many proteins an effect that is not resolved needs."""
    if row["proteins"] < FEW:
        return "too few proteins"
    verdict = "not resolved" if not resolved(row) else above if row["effect"] > 0.0 else below
    needed = row["proteins_needed"]
    number = f"{needed:.0f}" if np.isfinite(needed) else f"more than {MOST}"
    more = "" if np.isnan(needed) else f", {number} proteins like these give {100 * POWER:.0f} % power"
    adjusted = row[_corrected_for(row["scope"])]
    return f"{verdict} (p {p_value(row['effect_p'])}, adjusted {p_value(adjusted)}{more})"


def p_value(p: float) -> str:
    """A p in two digits, without exponents."""
    return "-" if np.isnan(p) else f"{p:.2g}" if p >= 1e-4 else "< 0.0001"


def _percent(row: Mapping[Any, Any], name: str) -> str:
    low, high = (100.0 * row[f"{name}{end}"] for end in _ENDS)
    return f"{100.0 * row[name]:.0f} % ({low:.0f} to {high:.0f})"


def _with_bodies(runs: pd.DataFrame) -> pd.DataFrame:
    """Runs from the starts from which all bodies have been fixed."""
    names = {f"{name}-{end}" for name in OF_BODIES for end in FIXED}
    is_complete = runs.groupby(START, sort=False)["method"].transform(lambda methods: names <= set(methods))
    return runs[is_complete.astype(bool)]


def bodies(runs: pd.DataFrame) -> pd.DataFrame:
    """Contrasts of the free root with each fixed body, with the same controls as all others."""
    return contrasts(compared(_with_bodies(runs), BODY_CONTRASTS), BODY_CONTRASTS)


def choices(runs: pd.DataFrame) -> pd.DataFrame:
    """Different minima to which a method leads from a start, with the free root and each fixed body.

    ``minima_N`` counts the starts with N different minima, of those from which all runs are finished.
    """
    rows = []
    for name, inertia in INERTIA.items():
        methods = [name, *(f"{name}-{end}" for end in FIXED)]
        numbers = []
        for _, start_runs in _with_bodies(runs).groupby(START, sort=False):
            ends = start_runs.set_index("method").loc[methods]
            if ends["finished"].all():
                numbers.append(_different(ends.to_dict("records")))
        row: dict[str, Any] = {"method": name, "inertia": inertia, "starts": len(numbers)}
        rows.append(row | {f"minima_{n}": numbers.count(n) for n in range(1, len(methods) + 1)})
    return pd.DataFrame(rows)


def _different(ends: Sequence[Mapping[Any, Any]]) -> int:
    """Number of different minima among ends."""
    different: list[Mapping[Any, Any]] = []
    for end in ends:
        if not any(
            same_minimum(_torsions(end), _torsions(other), end["energy_kj_mol"] - other["energy_kj_mol"])
            for other in different
        ):
            different.append(end)
    return len(different)


def body_words(table: pd.DataFrame) -> Iterator[str]:
    """Sentences on how many minima the choice of the fixed body leads to."""
    for row in table[table["starts"] > 0].to_dict("records"):
        more = row["starts"] - row["minima_1"] - row["minima_2"]
        yield (
            f"`{row['method']}` ({row['inertia']}): the free root and the {len(FIXED)} fixed bodies lead to "
            f"one minimum from {row['minima_1']} of {row['starts']} starts. They lead to two minima from "
            f"{row['minima_2']} starts, and to three or more from {more}."
        )


def _peptides(runs: pd.DataFrame) -> pd.DataFrame:
    """Runs in the rigid bodies of the extended chain, in solvent, of up to ``SMALL`` residues."""
    is_one = (runs["energy"] == "obc2") & (runs["model"] == MODELS[0]) & (runs["start"] == "extended")
    return runs[is_one & (runs["residues"] <= SMALL) & (runs["method"] != "openmm")]


def lowest_known(runs: pd.DataFrame, searches: pd.DataFrame) -> pd.DataFrame:
    """Lowest known minimum of each peptide: of the searches, if there are any, and of all runs.

    ``source`` is ``csa`` or the first method that leads there, with a margin of ``SAME_KJ_MOL`` for the
    search.
    """
    rows = []
    for protein, ends in _peptides(runs).groupby("protein", sort=False):
        walks = searches[searches["protein"] == protein]
        best = ends.iloc[int(ends["energy_kj_mol"].argmin())]
        csa, run = float(walks["energy_kj_mol"].min()), float(best["energy_kj_mol"])
        is_csa = csa < run + SAME_KJ_MOL
        rows.append(
            {"protein": protein, "residues": best["residues"], "csa_evaluations": walks["evaluations"].sum(),
             "csa_kj_mol": csa, "runs": len(ends), "runs_kj_mol": run, "lowest_kj_mol": np.fmin(csa, run),
             "source": "csa" if is_csa else best["method"]}
        )  # fmt: skip
    columns = ["protein", "residues", "csa_evaluations", "csa_kj_mol", "runs", "runs_kj_mol", "lowest_kj_mol"]
    return pd.DataFrame(rows, columns=[*columns, "source"])


def above(runs: pd.DataFrame, minima: pd.DataFrame) -> pd.DataFrame:
    """How far finished runs from extended chains end above the lowest known minimum, by method.

    ``above_kj_mol`` is the mean over peptides, with limits ``_low`` and ``_high``; ``lowest`` counts the
    peptides whose run ends within ``SAME_KJ_MOL`` of the lowest known minimum, and ``lowest_high`` is the
    upper limit of their share (exact, 95 %).
    """
    ends = _peptides(runs)
    ends = ends[(ends["seed"] == 0) & ends["protein"].isin(minima["protein"])]
    known = minima.set_index("protein")["lowest_kj_mol"]
    rows = []
    for method in METHODS:
        method_ends = ends[ends["method"] == method].set_index("protein")
        finished = method_ends[method_ends["finished"].astype(bool)]
        if method.endswith(tuple(CONTROLS.values())) or finished.empty:
            continue
        rise = finished["energy_kj_mol"] - known.reindex(finished.index)
        n, reached = len(rise), int((rise < SAME_KJ_MOL).sum())
        high = binomtest(reached, n).proportion_ci(0.95, "exact").high
        rows.append(
            {"method": method, "peptides": n, "left_out": len(method_ends) - n, "lowest": reached,
             "lowest_high": high, **_interval("above_kj_mol", rise), "median_kj_mol": rise.median(),
             "largest_kj_mol": rise.max()}
        )  # fmt: skip
    names = ["above_kj_mol", *(f"above_kj_mol{end}" for end in _ENDS), "median_kj_mol", "largest_kj_mol"]
    return pd.DataFrame(rows, columns=["method", "peptides", "left_out", "lowest", "lowest_high", *names])


def methods(runs: pd.DataFrame, above: pd.DataFrame, rows: pd.DataFrame) -> pd.DataFrame:
    """Ends and paths of each method over the extended peptides, with the rows of ``paths.csv``.

    ``same`` is the share of finished pairs with ``md-10`` that end in one minimum. Lengths, steps and
    entropies are means over the peptides with a finished path. Limits, ``_low`` and ``_high``, resample the
    peptides (95 %).
    """
    ends = _peptides(runs)
    ends = ends[ends["seed"] == 0]
    heights = above.set_index("method")
    table = []
    for method in paths.METHODS:
        method_paths = rows[(rows["method"] == method) & (rows["start"] == "extended")].set_index("protein")
        finished = method_paths[method_paths["finished"].astype(bool)]
        if finished.empty:
            continue
        row: dict[str, Any] = {
            "method": method, "peptides": len(method_paths), "finished": len(finished),
            "evaluations": finished["evaluations"].median(),
        }  # fmt: skip
        pairs = compared(ends, [Contrast("dynamics", method, "md-10")])
        pairs = pairs[pairs["finished"].astype(bool)].set_index("protein")
        if len(pairs) and method != "md-10":
            row |= {"pairs": len(pairs), "same_pairs": int(pairs["same"].sum())}
            row |= _interval("same", pairs["same"], 0.0)
        if method in heights.index:
            names = [f"above_kj_mol{end}" for end in ("", *_ENDS)]
            row |= dict(zip(names, heights.loc[method, names], strict=True))
        for name in ("path_rad", "path_nm", "largest_step_nm", "entropy_loss_j_mol_k"):
            row |= _interval(name, finished[name].dropna())
        table.append(row)
    return pd.DataFrame(table)


def _without_bounds(runs: pd.DataFrame) -> pd.DataFrame:
    """Runs without those of bounded KCM, which start from the extended peptides only."""
    return runs[~runs["method"].str.startswith("entropy-")]


def cost(runs: pd.DataFrame) -> pd.DataFrame:
    """Lowest energy for equal cost, by method: medians over starts from which all in torsions have run.

    Energies, in kJ/mol, are above the lowest minimum of all methods in torsions from the same start, after so
    many evaluations and so many seconds; ``minimum`` is where the run leads.
    """
    torsional = _without_bounds(runs)
    torsional = torsional[(torsional["method"] != "openmm") & ~torsional["method"].map(fixes_plane)]
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
    own = _without_bounds(runs)
    own = own[(own["start"] == "deposited") & (own["energy"] != "nonbonded")]
    n = own["method"].nunique()
    own = own[own.groupby(START)["method"].transform("nunique") == n]
    of = own["rmsd_start_angstrom"].groupby(own["method"], sort=False)
    found = {"starts": of.size(), "median_angstrom": of.median(), "largest_angstrom": of.max()}
    return pd.DataFrame(found).reset_index(names="method")


def _torsions(row: Mapping[Any, Any]) -> np.ndarray:
    """(n_hinges,) float, degrees: torsions of a row."""
    return np.array(str(row["torsions_deg"]).split(), dtype=float)


def _scopes(pairs: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
    """Runs that are counted together, where there are any."""
    small = pairs["residues"] <= SMALL
    for name, of in SCOPES.items():
        own = pairs[
            (pairs["energy"] == of["energy"]) & (pairs["model"] == of["model"]) & (small == of["is_small"])
        ]
        if len(own):
            yield name, own


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
