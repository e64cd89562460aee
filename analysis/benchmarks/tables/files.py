"""Preparing files, kinds of file, start-up, large structures and batches."""

import pandas as pd

from tables import markdown, of_rows, paragraph, table, table_of_rows

table_of_rows(
    "files-speed", "files_speed.csv",
    ("structure", lambda r: r["structure"].replace("_A", ", chain A").split("_")[0]),
    ("residues", "{residues}"), ("atoms", "{atoms}"), ("seconds", "{seconds:.2f}"),
    ("PDBFixer and addHydrogens", "{openmm_seconds:.2f}"),
)  # fmt: skip


EQUAL = 1e-6
"""Relative difference of energies that count as equal."""


def _differences(rows: pd.DataFrame) -> pd.Series:
    """Energies read again against those written, relative, of both formats."""
    return pd.concat([pd.to_numeric(rows[f"difference_{name}"]) for name in ("pdb", "mmcif")]).dropna()


@table("kinds", "kinds.csv", keep_default_na=False)
def kinds(rows: pd.DataFrame) -> str:
    """What became of the kinds of file, by family."""

    def line(family: str, own: pd.DataFrame) -> tuple[object, ...]:
        apart = _differences(own)
        return (
            family, len(own), (own["refusal"] != "").sum(), (own["lost"] != "").sum(),
            (own["lost_not_said"] > 0).sum(), (own["names_changed"] != "").sum(), len(apart),
            (apart <= EQUAL).sum(), (own["faults"] > 0).sum(),
        )  # fmt: skip

    heads = (
        "family", "kinds", "refused, in one line", "with atoms lost", "of them not reported",
        "with names changed", "energies read again", "of them equal to 1e-6", "with faults",
    )  # fmt: skip
    lines = [line(str(family), own) for family, own in rows.groupby("family", sort=False)]
    return markdown(heads, [*lines, line("all", rows)])


@table("kinds-words", "kinds.csv", keep_default_na=False)
def kinds_words(rows: pd.DataFrame) -> str:
    """What the kinds of file say in all."""
    made, taken = rows["origin"] == "made", rows["refusal"] == ""
    drift = pd.to_numeric(rows["metal_drift_angstrom"]).max()
    turned = (rows["stereocentres_changed"] != "").sum()
    return paragraph(
        f"Of {made.sum()} kinds made by recipes and {(~made).sum()} real files, {taken.sum()} are accepted",
        f"and {(~taken).sum()} refused. Relative differences of energies read again are at most",
        f"{_differences(rows).max():.0e}. C-alphas change chirality in {turned} files. Metals move by at",
        f"most {drift:.2f} angstrom.",
    )


@table("flips", "flips.csv")
def flips(rows: pd.DataFrame) -> str:
    """Flipped side chains that a preparation puts back, for both halves of the crystals."""
    halves = rows[rows["structure"] == "all"].copy()
    halves["crystals"] = [int((rows["half"] == half).sum()) - 1 for half in halves["half"]]
    return of_rows(
        halves,
        ("half", "{half}"), ("crystals", "{crystals}"), ("sites", "{sites}"), ("put back", "{put_back}"),
        ("deciding sites", "{deciding}"), ("put back", "{deciding_put_back}"), ("%", "{percent:.1f}"),
        ("turned in the file as it is", "{turned}"), ("of these deciding", "{wrongly_turned}"),
    )  # fmt: skip


@table("flips-words", "flips.csv")
def flips_words(rows: pd.DataFrame) -> str:
    """Share of the deciding sites of both halves."""
    total = rows[rows["structure"] == "all"][["deciding", "deciding_put_back"]].sum()
    share = 100.0 * total["deciding_put_back"] / total["deciding"]
    return paragraph(
        f"In all, {total['deciding_put_back']} of {total['deciding']} deciding sites are put back,",
        f"{share:.0f} %. The goal of 95 % is {'' if share >= 95.0 else 'not '}met.",
    )


@table("startup", "startup.csv", keep_default_na=False)
def startup(rows: pd.DataFrame) -> str:
    """Commands from the wheel on, and the seconds to the first relaxed model."""
    shown = of_rows(
        rows,
        ("command", "`{command}`"), ("state", "{state}"), ("s", "{seconds:.1f}"),
        ("CPU s", "{cpu_seconds:.1f}"),
    )  # fmt: skip
    first = rows[(rows["state"] == "") | ((rows["command"] == "relax") & (rows["state"] == "cold"))]
    total = first["seconds"].sum()
    return f"{shown}\n{paragraph(f'From the wheel to the first relaxed model: {total:.0f} s.')}"


@table("large", "large.csv", "large_exponents.csv")
def large(rows: pd.DataFrame, slopes: pd.DataFrame) -> str:
    """Copies of one structure side by side, minimised in all atoms."""
    shown = of_rows(
        rows,
        ("atoms", "{atoms}"), ("prepared s", "{prepare_s:.2f}"), ("an energy s", "{energy_s:.3f}"),
        ("evaluations", "{evaluations}"), ("minimisation s", "{minimise_s:.1f}"),
        ("whole command s", "{shell_s:.0f}"), ("memory MB", "{memory_mb:.0f}"), ("status", "{status}"),
    )  # fmt: skip
    of = slopes.set_index("seconds_of")["exponent_by_tree"]
    said = paragraph(
        "The exponents of time in the number of atoms, from 5,000 on, are: preparation "
        f"{of['prepare_s']:.2f}, an energy {of['energy_s']:.2f}, an evaluation of the minimisation "
        f"{of['evaluation_s']:.2f}, the whole command {of['shell_s']:.2f}."
    )
    return f"{shown}\n{said}"


table_of_rows(
    "batch", "batch.csv",
    ("workers", "{workers:.0f}"), ("structures", "{structures:.0f}"),
    ("of them broken", "{without_result:.0f}"), ("structures per second", "{a_second:.2f}"),
    ("ratio", lambda r: "" if r["ratio"] == 1 else f"{r['ratio']:.2f}x"),
    ("MB of the client after the first structure", "{client_mb_first:.0f}"),
    ("after the last", "{client_mb_last:.0f}"),
)  # fmt: skip
table_of_rows(
    "batch-costs", "batch_costs.csv",
    ("structures", "{structures:.0f}"), ("mean residues", "{residues:.0f}"),
    ("preparation s", "{seconds_preparation:.2f}"), ("`lbfgs` s", "{seconds:.2f}"),
    ("KB per result", "{kb_structure:.0f}"), ("KB per page", "{kb_page:.1f}"),
    ("KB in `summary.csv`", "{kb_summary:.1f}"), ("KB in `traces.csv`", "{kb_traces:.1f}"),
)  # fmt: skip


@table("fuzz", "fuzz.csv")
def fuzz(rows: pd.DataFrame) -> str:
    """What became of damaged files and odd options."""
    made_of = rows["kind"].str.extract("^(PDB|mmCIF|options)", expand=False)
    group = made_of.replace({"PDB": "PDB files", "mmCIF": "mmCIF files", "options": "sets of options"})
    how = dict.fromkeys(("files", "taken", "refused", "faults"), "sum") | {
        "seconds": "max",
        "megabytes": "max",
    }
    sums = rows.groupby(group.fillna(rows["kind"]), sort=False).agg(how)
    sums.loc["all"] = rows.agg(how)
    return of_rows(
        sums.rename_axis("group").reset_index(),
        ("damaged", "{group}"), ("number", "{files:.0f}"), ("accepted", "{taken:.0f}"),
        ("refused, in one line", "{refused:.0f}"), ("faults", "{faults:.0f}"),
        ("longest, CPU s", "{seconds:.1f}"), ("most memory, MB", "{megabytes:.0f}"),
    )  # fmt: skip
