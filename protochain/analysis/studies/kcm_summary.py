"""Summary of the study of KCM against dynamics: tables, figures and answers, from its table of runs alone."""

from collections.abc import Iterator, Mapping
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binomtest, bootstrap

from protochain.analysis.studies.kcm_cases import KEY, METHODS
from protochain.analysis.studies.kcm_plots import plot_shares, plot_traces
from protochain.results.tables import save
from protochain.structure.superpose import rmsd_angstrom

START = ["protein", "model", "solvent", "start", "seed", "max_evaluations"]
SCOPE = ["model", "solvent", "start"]
SAME_ANGSTROM, SAME_POLISHED, SAME_RAW = 0.1, 0.1, 1.0
"""C-alpha RMSD, and kJ/mol: two ends nearer than both are one minimum. Raw ends, to a torque of 1 kJ/mol/rad,
still have some energy to lose."""
FEW = 5
"""Starts below which nothing is concluded."""
PAIRS: Mapping[str, tuple[str, str]] = {
    "KCM and dynamics": ("kcm-0.005", "md-10"), "angle": ("kcm-0.005", "kcm-0.01"),
    "rule": ("kcm-0.005", "kcm-adaptive"), "metric": ("kcm-adaptive", "kcm-metric"),
    "friction 100": ("kcm-metric", "md-100"), "friction 10": ("kcm-metric", "md-10"),
    "friction 1": ("kcm-metric", "md-1"),
}  # fmt: skip
"""What two methods differ in. The control, KCM in the metric of masses, is overdamped motion of the chain: it
differs from KCM with the same rule by the metric alone, and from dynamics by the inertia that friction, per
ps, leaves."""
DIFFERENCES = {
    "KCM and dynamics, less rule": ("KCM and dynamics", "rule"),
    "metric, less friction 1": ("metric", "friction 1"),
}
"""Of shares: below 0 the first of the two changes more minima than the second."""
RISE = "dynamics above KCM, kJ/mol"
_RESAMPLES = 2000


def write(output: Path, runs: pd.DataFrame, planned: set[tuple[Any, ...]]) -> Iterator[pd.DataFrame]:
    """Write and yield what follows from the runs: tables, figures, and ``summary.md``."""
    order = {method: k for k, method in enumerate(METHODS)}
    runs = runs.sort_values("method", key=lambda names: names.map(order), kind="stable")
    done = runs[runs["polished_energy_kj_mol"].notna()] if len(runs) else runs
    if done.empty:
        return
    by_method, pairs = ends(done), compared(done)
    tables = {"ends": by_method, "cost": cost(done), "deposited": deposited(done)}
    if not pairs.empty:
        tables |= {"shares": shares(pairs), "contrasts": contrasts(pairs)}
    save(output, {f"{name}.csv": table for name, table in tables.items()})
    save(output, {"traces.png": plot_traces(_above(_complete(done)))})
    if not pairs.empty:
        save(output, {"shares.png": plot_shares(tables["shares"])})
    lines = [counts(runs, planned), *unfinished(done)]
    lines += (
        answers(tables["contrasts"]) if "contrasts" in tables else ["No two methods have run from one start."]
    )
    save(output, {"summary.md": page(lines, tables)})
    yield tables["cost"]
    if "contrasts" in tables:
        yield tables["contrasts"]
    yield pd.DataFrame({"summary": lines})


def counts(runs: pd.DataFrame, planned: set[tuple[Any, ...]]) -> str:
    """How many of the runs planned there are, and of which proteins."""
    keys = set(runs[list(KEY)].itertuples(index=False, name=None))
    of = f"{len(keys & planned)} of {len(planned)} runs planned"
    others = f", and {len(keys - planned)} others" if keys - planned else ""
    refused = int(runs["polished_energy_kj_mol"].isna().sum())
    failed = f"; {refused} were refused" if refused else ""
    starts = runs[START].drop_duplicates()["protein"].value_counts(sort=False)
    named = ", ".join(f"{name} {n}" for name, n in starts.items())
    return f"This summary is of {of}{others}{failed}. Starts by protein: {named}."


def ends(runs: pd.DataFrame) -> pd.DataFrame:
    """Medians of the ends of each method, by protein and scope, with the number of runs.

    ``left_kj_mol`` is what the polish took off, and ``above_kj_mol`` how far the polished end lies above the
    lowest of all torsion methods from the same start.
    """
    found = _above(runs)
    groups = found.groupby(["protein", *SCOPE, "method"], sort=False)
    medians = groups[
        ["energy_kj_mol", "torque_max_kj_mol_rad", "torque_rms_kj_mol_rad", "rmsd_start_angstrom",
         "rmsd_native_angstrom", "evaluations", "seconds", "left_kj_mol", "polished_energy_kj_mol",
         "above_kj_mol", "polished_rmsd_start_angstrom", "polished_rmsd_native_angstrom"]
    ].median()  # fmt: skip
    share = found.assign(converged=found["status"] == "converged").groupby(
        ["protein", *SCOPE, "method"], sort=False
    )["converged"].mean()  # fmt: skip
    medians.insert(0, "converged_share", share)
    medians.insert(0, "runs", groups.size())
    return medians.reset_index()


def cost(runs: pd.DataFrame) -> pd.DataFrame:
    """Lowest energy for equal cost, by method: medians over all starts that every method has run from.

    Energies, in kJ/mol, are above the lowest polished end of all torsion methods from the same start.
    """
    found = _above(_complete(runs))
    names = [str(name) for name in found if str(name).startswith("energy_at_")]
    above = found[names].sub(found["lowest_kj_mol"], axis=0).rename(columns=lambda name: name[7:])
    above = above.assign(
        method=found["method"],
        converged=found["status"] == "converged",
        evaluations=found["evaluations"],
        left_kj_mol=found["left_kj_mol"],
        polished_above_kj_mol=found["above_kj_mol"],
    )
    groups = above[above["method"] != "openmm"].groupby("method", sort=False)
    table = groups.median().rename(columns={"converged": "converged_share"})
    table["converged_share"] = groups["converged"].mean()
    table.insert(0, "starts", groups.size())
    return table.reset_index()


def deposited(runs: pd.DataFrame) -> pd.DataFrame:
    """C-alpha RMSD from deposited structures to the minima, of starts that every method has run from.

    Ends are polished in torsions; those of ``openmm``, which moves all atoms, are as it leaves them.
    """
    own = _complete(runs[runs["start"] == "deposited"])
    away = own["polished_rmsd_start_angstrom"].where(own["method"] != "openmm", own["rmsd_start_angstrom"])
    of = away.groupby(own["method"], sort=False)
    found = {"starts": of.size(), "median_angstrom": of.median(), "largest_angstrom": of.max()}
    return pd.DataFrame(found).reset_index(names="method")


def compared(runs: pd.DataFrame) -> pd.DataFrame:
    """Every two torsion methods from every start: RMSD, difference of energy, whether it is one minimum."""
    rows = []
    torsional = runs[runs["method"] != "openmm"]
    for key, own in torsional.groupby(START, sort=False):
        ends = {row["method"]: row for row in own.to_dict("records")}
        alphas = {
            (name, prefix): np.array(row[f"{prefix}alphas_pm"].split(), dtype=float).reshape(-1, 3) / 1000.0
            for name, row in ends.items()
            for prefix in ("", "polished_")
        }
        for a, b in combinations([name for name in METHODS if name in ends], 2):
            row = dict(zip(START, key, strict=True)) | {"a": a, "b": b}
            for prefix, most in (("", SAME_RAW), ("polished_", SAME_POLISHED)):
                apart = rmsd_angstrom(alphas[a, prefix], alphas[b, prefix])
                rise = ends[b][f"{prefix}energy_kj_mol"] - ends[a][f"{prefix}energy_kj_mol"]
                row[f"{prefix}rmsd_angstrom"], row[f"{prefix}rise_kj_mol"] = apart, rise
                row[f"{prefix}same"] = apart < SAME_ANGSTROM and abs(rise) < most
            rows.append(row)
    return pd.DataFrame(rows)


def shares(pairs: pd.DataFrame) -> pd.DataFrame:
    """Share of starts in which two methods reach one minimum, raw and polished, with 95 % intervals."""
    rows = []
    for scope, own in _scopes(pairs):
        for (a, b), both in own.groupby(["a", "b"], sort=False):
            row = {**scope, "a": a, "b": b, "starts": len(both), "raw_share": both["same"].mean()}
            row |= _interval("polished_share", _by_start(both, "polished_same"), 0.0)
            row |= {"rmsd_median_angstrom": both["polished_rmsd_angstrom"].median()}
            rows.append(row | _interval("b_above_a_kj_mol", _by_start(both, "polished_rise_kj_mol")))
    return pd.DataFrame(rows)


def contrasts(pairs: pd.DataFrame) -> pd.DataFrame:
    """Shares of one minimum of methods that differ in one thing, and differences of these shares.

    Only starts count from which all of these methods have run. One row a scope and ``what``, of ``PAIRS``,
    ``DIFFERENCES`` and ``RISE``, with ``value`` and the limits ``low`` and ``high``.
    """
    rows = []
    for scope, own in _scopes(pairs):
        wide = own.pivot(index=START, columns=["a", "b"], values=["polished_same", "polished_rise_kj_mol"])
        if not all(("polished_same", *pair) in wide for pair in PAIRS.values()):
            continue
        table = pd.DataFrame({what: wide["polished_same", *pair] for what, pair in PAIRS.items()})
        table = table.dropna().astype(float)
        for what, (more, less) in DIFFERENCES.items():
            table[what] = table[more] - table[less]
        table[RISE] = wide["polished_rise_kj_mol", *PAIRS["KCM and dynamics"]].astype(float)
        table = table.reset_index()
        for what in (*PAIRS, *DIFFERENCES, RISE) if len(table) else ():
            least = 0.0 if what in PAIRS else -1.0 if what in DIFFERENCES else -np.inf
            values = _by_start(table, what)
            found = _interval("value", values, least)
            limits = {"value": found["value"], "low": found["value_low"], "high": found["value_high"]}
            rows.append({**scope, "starts": len(values), "what": what, **limits})
    return pd.DataFrame(rows, columns=[*SCOPE, "starts", "what", "value", "low", "high"])


def answers(table: pd.DataFrame) -> Iterator[str]:
    """Sentences that the contrasts carry; where an interval leaves it open, they say so."""
    for key, own in table.groupby([*SCOPE, "starts"], sort=False):
        scope: Any = key
        where = ", ".join(name for name in scope[:3] if name != "all") or "All together"
        if scope[3] < FEW:
            yield f"{where}: {scope[3]} starts are too few for an answer."
            continue
        rows: dict[str, Any] = {row["what"]: row for row in own.to_dict("records")}
        share = {
            what: f"{rows[what]['value']:.0%} ({rows[what]['low']:.0%} to {rows[what]['high']:.0%})"
            for what in PAIRS
        }
        both, rise = rows["KCM and dynamics"], rows[RISE]
        found = _verdict(both, 0.5, "less than half", "more than half")
        apart = _verdict(rows["KCM and dynamics, less rule"], 0.0, "more often", "less often")
        why = _verdict(rows["metric, less friction 1"], 0.0, "the metric does more", "inertia does more")
        yield (
            f"{where}, {scope[3]} starts. KCM (0.005 rad) and dynamics (friction 10 per ps) end in one "
            f"minimum from {share['KCM and dynamics']}, {found}. Two angles of KCM (0.005 and 0.01 rad) do "
            f"from {share['angle']}, the fixed and the adaptive angle from {share['rule']}: {apart}. A "
            "change of the metric alone, to that of masses without inertia, leaves the minimum in "
            f"{share['metric']}; inertia added to that leaves it in {share['friction 100']} at a friction "
            f"of 100 per ps, in {share['friction 10']} at 10 and in {share['friction 1']} at 1. Metric "
            f"against inertia, at 1: {why}. Minima of dynamics lie {rise['value']:+.2f} "
            f"({rise['low']:+.2f} to {rise['high']:+.2f}) kJ/mol above those of KCM."
        )


def unfinished(runs: pd.DataFrame) -> Iterator[str]:
    """Say which methods were mostly still on their way, or circling, when they were stopped."""
    left = _above(runs).groupby("method", sort=False)["left_kj_mol"].median()
    named = [f"{name} {value:.1f}" for name, value in left.items() if value > SAME_RAW and name != "openmm"]
    if named:
        yield (
            "Stopped above a minimum: of these methods the polish took off more than "
            f"{SAME_RAW:g} kJ/mol in the median, and it, too, chose their minimum: {', '.join(named)}."
        )


def _verdict(row: Mapping[str, Any], level: float, below: str, above: str) -> str:
    """What an interval says of a level."""
    if row["high"] < level:
        return below
    return above if row["low"] > level else "these starts leave it open"


def page(lines: list[str], tables: Mapping[str, pd.DataFrame]) -> str:
    """Text of ``summary.md``."""
    parts = ["# KCM against constrained dynamics", *lines]
    parts.append(
        f"One minimum: C-alpha RMSD below {SAME_ANGSTROM} angstrom and energies within {SAME_POLISHED} "
        "kJ/mol, after the polish that all ends get. Intervals: 95 %, by bootstrap over starts (runs of one "
        "start in several models count as one), exact binomial where all starts agree. They speak of more "
        "starts of these proteins, not of other proteins."
    )
    if "contrasts" in tables:
        parts += ["## Starts that reach one minimum", _markdown(tables["contrasts"])]
    shown = ["method", "starts", "converged_share", "evaluations", "left_kj_mol", "polished_above_kj_mol"]
    few = {f"at_{n}": f"after {n}" for n in (10, 100, 1000, 10_000)}
    parts += [
        "## Lowest energy for equal cost",
        "Medians, in kJ/mol above the lowest polished end of the start; `left` is what the polish took off.",
        _markdown(tables["cost"][[*shown, *few]].rename(columns=few)),
    ]
    if len(tables["deposited"]):
        parts += [
            "## How far minima lie from deposited structures",
            "C-alpha RMSD; minima in torsions, after the polish, and of `openmm` in all atoms.",
            _markdown(tables["deposited"]),
        ]
    return "\n\n".join(parts) + "\n"


def _markdown(table: pd.DataFrame) -> str:
    head = "| " + " | ".join(table.columns) + " |\n|" + "---|" * len(table.columns)
    cells = [[f"{v:.3g}" if isinstance(v, float) else str(v) for v in row] for row in table.to_numpy()]
    return "\n".join([head, *("| " + " | ".join(row) + " |" for row in cells)])


def _scopes(pairs: pd.DataFrame) -> Iterator[tuple[dict[str, Any], pd.DataFrame]]:
    """All together; by kind of start; by model, solvent and kind of start."""
    together = dict.fromkeys(SCOPE, "all")
    yield together, pairs
    if pairs["start"].nunique() > 1:
        for kind, own in pairs.groupby("start", sort=False):
            yield {**together, "start": kind}, own
    for key, own in pairs.groupby(SCOPE, sort=False):
        yield dict(zip(SCOPE, key, strict=True)), own


def _by_start(table: pd.DataFrame, column: str) -> np.ndarray:
    """Values by start: the mean over its models and solvents, which are no independent samples."""
    grouped = table[column].astype(float).groupby([table["protein"], table["start"], table["seed"]])
    return np.asarray(grouped.mean())


def _interval(name: str, values: np.ndarray, least: float = -np.inf) -> dict[str, float]:
    """Mean of values, with its 95 % interval by bootstrap (percentiles).

    ``least`` is that of a share (0) or of a difference of shares (-1): where all starts agree nothing varies,
    and the interval is as wide as the exact binomial one of none in so many.
    """
    mean = low = high = float(np.mean(values))
    if np.ptp(values) > 0.0:
        random = np.random.default_rng(0)
        found = bootstrap((values,), np.mean, n_resamples=_RESAMPLES, method="percentile", rng=random)
        low, high = found.confidence_interval
    elif np.isfinite(least):
        width = binomtest(0, len(values)).proportion_ci(0.95, "exact").high
        low, high = max(least, mean - width), min(1.0, mean + width)
    return {name: mean, f"{name}_low": float(low), f"{name}_high": float(high)}


def _complete(runs: pd.DataFrame) -> pd.DataFrame:
    """Runs of starts from which every method has run that ran from any."""
    n = runs["method"].nunique()
    return runs[runs.groupby(START)["method"].transform("nunique") == n]


def _above(runs: pd.DataFrame) -> pd.DataFrame:
    """Runs with the lowest polished end of torsion methods from their start, and differences to it."""
    torsional = runs["polished_energy_kj_mol"].where(runs["method"] != "openmm")
    lowest = torsional.groupby([runs[name] for name in START]).transform("min")
    return runs.assign(
        lowest_kj_mol=lowest,
        above_kj_mol=runs["polished_energy_kj_mol"] - lowest,
        left_kj_mol=runs["energy_kj_mol"] - runs["polished_energy_kj_mol"],
    )
