"""Ligands, DNA and RNA relaxed with their proteins."""

import pandas as pd

from tables import markdown, paragraph, table, table_of_rows

_WAYS = {
    "before": "before",
    "frozen": "ligand alone, by OpenMM",
    "rigid": "`relax --rigid-protein`",
    "relax": "`relax`, the whole complex",
}
_KINDS = {"crystal": "crystal poses", "moved": "moved", "rough": "rough"}


@table("complexes-poses", "complexes_poses.csv")
def poses(rows: pd.DataFrame) -> str:
    """Poses that pass, by way and charges."""
    lines = []
    for way, name in _WAYS.items():
        for charges, of_charges in rows.dropna(subset=f"valid_{way}").groupby("charges", sort=False):
            of = [of_charges[of_charges["pose"].str.startswith(kind)] for kind in _KINDS]
            passed = [f"{each[f'valid_{way}'].sum()} of {len(each)}" for each in of]
            away = [f"{each[f'rmsd_{way}_angstrom'].median():.2f}" for each in of]
            if way == "before":
                lines = [[name, "-", *passed, *away, "-", "-"]]
                continue
            costs = [f"{of_charges[f'{clock}_{way}'].median():.1f}" for clock in ("seconds", "cpu_seconds")]
            lines.append([name, charges, *passed, *away, *costs])
    headings = ("", "charges", *(f"{name} that pass" for name in _KINDS.values()))
    headings += tuple(f"{name}, RMSD to the crystal's" for name in _KINDS.values())
    return markdown((*headings, "seconds, median", "of a processor"), lines)


@table("complexes-words", "complexes_poses.csv")
def words(rows: pd.DataFrame) -> str:
    """What the table of poses says."""
    moved = rows[(rows["pose"] != "crystal") & (rows["charges"] == rows["charges"].iloc[0])]
    before, frozen, rigid, ours = (int(moved[f"valid_{way}"].sum()) for way in _WAYS)
    left = {
        way: sorted({each for row in moved[f"failed_{way}"].dropna() for each in row.split(";")})
        for way in ("rigid", "relax")
    }
    which = (f"Failed tests after {_WAYS[way]}: {', '.join(tests) or 'none'}." for way, tests in left.items())
    return paragraph(
        f"Of {len(moved)} moved and rough poses {before} pass at the start. After OpenMM moved only the",
        f"ligand, {frozen} pass. After `relax --rigid-protein` {rigid} pass, and after `relax` {ours}.",
        f"{' '.join(which)} `relax` needs at most {rows['cpu_seconds_relax'].max():.0f} processor seconds,",
        f"for up to {rows['residues'].max()} residues.",
    )


table_of_rows(
    "complexes-models", "complexes_models.csv", ("model", "{model}"), ("residues", "{residues}"),
    ("ligands that move", "{ligands_that_move}"), ("fixed atoms", "{atoms_fixed}"),
    ("clashes", "{clashes_start:.1f}"), ("after", "{clashes_end:.1f}"),
    ("overlaps", "{overlaps_start}"), ("after", "{overlaps_end}"),
    ("base pairs", lambda r: f"{r['base_pairs_kept']} of {r['base_pairs']}" if r["base_pairs"] else "-"),
    ("P moved by", "{p_moved_median_angstrom:.2f}"), ("ligands by", "{ligand_moved_median_angstrom:.2f}"),
    ("inverted stereocentres", "{inverted_stereocentres_start}"), ("after", "{inverted_stereocentres_end}"),
    ("seconds", "{seconds:.1f}"),
)  # fmt: skip


@table("complexes-models-words", "complexes_models.csv")
def models(rows: pd.DataFrame) -> str:
    """What the table of models says."""
    n, clean = len(rows), int((rows["clashes_end"] == 0).sum())
    slow = rows.loc[rows["seconds"].idxmax()]
    fixed = rows[rows["atoms_fixed"] > 0]["model"].tolist()
    return paragraph(
        f"{clean} of {n} models end without clashes. In the others at most {rows['clashes_end'].max():.1f}",
        f"per 1000 atoms remain. The slowest, {slow['model']} of {slow['residues']} residues, needs",
        f"{slow['seconds']:.0f} s. {len(fixed)} models have fixed atoms: {', '.join(fixed)}.",
    )
