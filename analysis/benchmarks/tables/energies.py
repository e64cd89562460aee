"""Speed of the energy, and what a run leaves out."""

import numpy as np
import pandas as pd

from bench import exponent
from tables import SOLVENTS, Cell, paragraph, ratio_of, table, table_of_rows

ALL, TREE = "all pairs", "tree, 0.001 asked"
COUNTED = ("terms", "pairs", "bodies", "sweeps", "lists", "imports")

table_of_rows(
    "engines", "engines.csv",
    ("structure", "{structure}"), ("atoms", "{atoms}"), ("OpenMM's force", "{solvent}"),
    ("OpenMM CPU ms", "{openmm_ms:.2f}"), ("native ms", "{native_ms:.2f}"), ("ratio", ratio_of("ratio")),
    ("ns per pair", "{ns_a_pair:.2f}"), ("times the lower bound", "{times_the_floor:.1f}"),
)  # fmt: skip
ERRORS: tuple[tuple[str, Cell], ...] = (
    ("ms of a processor", "{processor_ms:.1f}"), ("of all pairs", "{of_all_pairs:.2f}"),
    ("force off kJ/mol/nm", "{rms_force_off_kj_mol_nm:.1e}"),
    ("energy off kJ/mol", "{energy_off_kj_mol:.1e}"),
)  # fmt: skip
table_of_rows(
    "engines-accuracy", "engines_accuracy.csv",
    ("atoms", "{atoms}"), ("solvent", lambda r: SOLVENTS[r["solvent"]]), ("by", "{by}"),
    *ERRORS,
)  # fmt: skip
table_of_rows(
    "device", "device.csv",
    ("structure", "{structure}"), ("atoms", "{atoms}"), ("device", "{device}"), ("by", "{by}"),
    ("context s", "{context_s:.2f}"), ("evaluation ms", "{evaluation_ms:.2f}"),
    ("force off kJ/mol/nm", "{rms_force_off_kj_mol_nm:.2g}"), ("minimise s", "{minimise_s:.2f}"),
    ("evaluations", "{evaluations:.0f}"), ("minimised kJ/mol", "{energy_kj_mol:.1f}"),
    ("relax s", "{relax_s:.2f}"), ("relaxed kJ/mol", "{relaxed_kj_mol:.1f}"), ("s a frame", "{frame_s:.2f}"),
)  # fmt: skip


@table("engines-crossover", "engines_accuracy.csv")
def crossover(rows: pd.DataFrame) -> str:
    """Where a tree becomes quicker than all pairs, and how both grow."""
    said = []
    for solvent, its in rows.groupby("solvent", sort=False):
        ms = its.pivot(index="atoms", columns="by", values="processor_ms")[[ALL, TREE]].dropna()
        large = ms[ms.index >= 4500]
        share = np.log(ms[TREE] / ms[ALL])
        crossed = np.exp(np.interp(0.0, -share, np.log(share.index)))
        since = "the smallest size" if share.iloc[0] < 0 else "by interpolation"
        said.append(
            f"{SOLVENTS[solvent]}: faster than all pairs from {crossed:,.0f} atoms on, {since}. Exponents "
            f"from {large.index[0]:,} to {large.index[-1]:,} atoms: {exponent(large.index, large[TREE]):.2f} "
            f"(tree) and {exponent(large.index, large[ALL]):.2f} (all pairs)."
        )
    return paragraph("The tree has an accuracy of 0.001 kJ/mol/nm.", *said)


table_of_rows(
    "engines-moving", "engines_moving.csv",
    ("structure", "{structure}"), ("solvent", lambda r: SOLVENTS[r["solvent"]]), ("hinges", "{hinges}"),
    ("moves", "{move}"), ("freedoms", "{freedoms}"), ("all ms", "{all_ms:.2f}"),
    ("moving terms ms", "{moving_ms:.2f}"), ("ratio", "{ratio:.2f}"), ("sweeps ms", "{sweeps_ms:.3f}"),
    ("share", "{sweeps_percent:.1f} %"),
)  # fmt: skip
table_of_rows(
    "threads", "threads.csv",
    ("structure", "{structure}"), ("atoms", "{atoms}"), ("cores busy with other work", "{cores_busy}"),
    ("one thread ms", "{one_thread_ms:.2f}"), ("two ms", "{two_threads_ms:.2f}"),
    ("two over one", "{ratio:.2f}"),
)  # fmt: skip
table_of_rows(
    "terms", "terms.csv",
    ("structure", "{structure}"), ("atoms", "{atoms}"), ("force field", "{forcefield}"),
    ("solvent", lambda r: SOLVENTS[r["solvent"]]), ("one evaluation ms", "{evaluation_ms:.2f}"),
    ("terms and residues, evaluations", "{shares_evaluations:.2f}"),
    ("pairs of residues, evaluations", "{pairs_evaluations:.2f}"),
    ("sum off by", "{deviation:.0e}"),
)  # fmt: skip


def _left_out(row: pd.Series) -> str:
    """What a run leaves out, counted."""
    return ", ".join(f"{row[name]:,} {name}" for name in COUNTED if row[name]) or row["message"]


table_of_rows(
    "scenes", "scenes.csv",
    ("run", "{scene}"), ("with", "{against}"), ("ms", "{everything_ms:.3g}"),
    ("left out, ms", "{left_out_ms:.3g}"), ("ratio", "{ratio:.2f}"),
    ("error", lambda r: f"{r['error']:.0e}" if r["error"] else "bits"), ("left out", _left_out),
)  # fmt: skip
