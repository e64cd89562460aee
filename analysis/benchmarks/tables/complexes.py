"""Ligands, DNA and RNA relaxed with their proteins."""

import pandas as pd

from tables import markdown, paragraph, table, table_of_rows

_WAYS = {"before": "before", "frozen": "ligand alone, by OpenMM", "relax": "`relax`, the whole complex"}


@table("complexes-poses", "complexes_poses.csv")
def poses(rows: pd.DataFrame) -> str:
    """Poses that pass, by way."""
    crystal = rows["pose"] == "crystal"
    lines = []
    for way, name in _WAYS.items():
        valid = rows[f"valid_{way}"]
        passed = [f"{valid[which].sum()} of {which.sum()}" for which in (crystal, ~crystal)]
        if way == "before":
            lines.append([name, *passed, "-", "-", "-"])
            continue
        moved, seconds = rows[f"moved_{way}_angstrom"], rows[f"seconds_{way}"]
        of_kinds = [f"{moved[which].median():.2f}" for which in (crystal, ~crystal)]
        lines.append([name, *passed, *of_kinds, f"{seconds.median():.1f}"])
    headings = ("", "crystal poses that pass", "moved poses that pass")
    return markdown((*headings, "crystal poses moved by, angstrom", "moved ones", "seconds, median"), lines)


@table("complexes-words", "complexes_poses.csv")
def words(rows: pd.DataFrame) -> str:
    """What the table of poses says."""
    moved = rows[rows["pose"] != "crystal"]
    before, frozen, ours = (int(moved[f"valid_{way}"].sum()) for way in _WAYS)
    ratio = (rows["seconds_relax"] / rows["seconds_frozen"]).median()
    left = sorted({each for row in rows["failed_relax"].dropna() for each in row.split(";")})
    which = f"What fails is {', '.join(left)}." if left else "No test fails after `relax`."
    than = "more" if ratio > 1.0 else "less"
    return paragraph(
        f"Of {len(moved)} moved poses {before} pass as they are, {frozen} after the ligand alone was moved,",
        f"and {ours} after `relax`. {which} `relax` takes {ratio:.2f} times the seconds of the other in the",
        f"median, {than} than it: it moves all atoms, in a solvent model.",
    )


table_of_rows(
    "complexes-models", "complexes_models.csv", ("model", "{model}"), ("residues", "{residues}"),
    ("ligands that move", "{ligands_that_move}"), ("atoms in place", "{atoms_fixed}"),
    ("clashes", "{clashes_start:.1f}"), ("after", "{clashes_end:.1f}"),
    ("overlaps", "{overlaps_start}"), ("after", "{overlaps_end}"),
    ("base pairs kept", lambda r: f"{r['base_pairs_kept']} of {r['base_pairs']}" if r["base_pairs"] else "-"),
    ("P moved by", "{p_moved_median_angstrom:.2f}"), ("ligands by", "{ligand_moved_median_angstrom:.2f}"),
    ("wrong hands", "{wrong_hands_start}"), ("after", "{wrong_hands_end}"), ("seconds", "{seconds:.1f}"),
)  # fmt: skip


@table("complexes-models-words", "complexes_models.csv")
def models(rows: pd.DataFrame) -> str:
    """What the table of models says."""
    n, clean = len(rows), int((rows["clashes_end"] == 0).sum())
    slow = rows.loc[rows["seconds"].idxmax()]
    fixed = rows[rows["atoms_fixed"] > 0]["model"].tolist()
    return paragraph(
        f"{clean} of {n} have no clash left; in the others at most {rows['clashes_end'].max():.1f} per 1000",
        f"atoms remain. The longest, {slow['model']} of {slow['residues']} residues, takes",
        f"{slow['seconds']:.0f} s. Atoms stay in place in {len(fixed)}: {', '.join(fixed)}.",
    )
