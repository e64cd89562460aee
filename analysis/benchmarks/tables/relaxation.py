"""RelaxSettings predicted models."""

import numpy as np
import pandas as pd
from made import RECORD

from tables import Cell, between, made_by, of_rows, paragraph, ratio_of, table, table_of_rows


def _minus(ours: str, theirs: str) -> Cell:
    """Column of differences of energies, kJ/mol."""
    return lambda r: "-" if pd.isna(r[ours]) or pd.isna(r[theirs]) else f"{r[ours] - r[theirs]:+.0f}"


_MODEL = (("model", "{model}"), ("residues", "{residues}"))
_ENDS = (
    ("violations", "{violations_start}"), ("after OpenMM", "{violations_openmm:.0f}"),
    ("after `relax`", "{violations_relax:.0f}"), ("RMSD angstrom, OpenMM", "{ca_rmsd_angstrom_openmm:.2f}"),
    ("`relax`", "{ca_rmsd_angstrom_relax:.2f}"),
)  # fmt: skip
_SECONDS = (("OpenMM s", "{seconds_openmm:.1f}"), ("`relax` s", "{seconds_relax:.2f}"),
            ("ratio", ratio_of("times_sooner")))  # fmt: skip

table_of_rows(
    "relax", "relax.csv", *_MODEL, *_ENDS,
    ("ff14SB, OBC2, kJ/mol", _minus("energy_ff14sb_obc2_relax", "energy_ff14sb_obc2_openmm")),
    ("amber99sb, kJ/mol",
     _minus("energy_amber99sb_vacuum_relax_alphafold", "energy_amber99sb_vacuum_openmm")),
    *_SECONDS, ("of CPU seconds", ratio_of("times_less_cpu")),
)  # fmt: skip


CLOSED = "6lfo_gap_model"
"""Model whose chain gaps OpenMM's run closed: the two programs solved different problems."""


@table("relax-short", "relax.csv", RECORD)
def relax_short(rows: pd.DataFrame, record: pd.DataFrame) -> str:
    """Relaxation compared with AlphaFold's, for the README."""
    short = of_rows(rows[rows["model"] != CLOSED], *_MODEL, *_ENDS, *_SECONDS)
    note = f"{CLOSED} is not shown: OpenMM's run closed its chain gaps, and so solved a different problem."
    return f"{short}\n{paragraph(note)}\n{made_by(record, 'relax.csv')}"


@table("relax-words", "relax.csv")
def relax_words(r: pd.DataFrame) -> str:
    """What the table of relaxation says."""
    n = len(r)
    left = (r["violations_relax"] <= r["violations_openmm"]).sum()
    fold = (r["ca_rmsd_angstrom_relax"] <= r["ca_rmsd_angstrom_openmm"] + 0.02).sum()
    obc2 = (r["energy_ff14sb_obc2_relax"] - r["energy_ff14sb_obc2_openmm"]).dropna()
    vacuum = (r["energy_amber99sb_vacuum_relax_alphafold"] - r["energy_amber99sb_vacuum_openmm"]).dropna()
    damaged = r["model"].str.startswith("1hel-")
    files, copies = r["times_sooner"][~damaged & (r["model"] != CLOSED)], r["times_sooner"][damaged]
    return paragraph(
        f"`relax` leaves no more violations than OpenMM in {left} of {n} models. Its RMSD is at most",
        f"0.02 angstrom above OpenMM's in {fold} of {n}. Its energy is lower in {(obc2 < 0).sum()} of",
        f"{len(obc2)} in ff14SB and OBC2, and in {(vacuum < 0).sum()} of {len(vacuum)} in amber99sb and",
        f"vacuum. It is {between(files)} times as fast on the files, and {between(copies)} times on the",
        "copies of lysozyme. For these the start of the program needs a second or more. The factor on the",
        f"files does not include {CLOSED}, because OpenMM's run closed its chain gaps.",
    )


@table("relax-many", "relax_many.csv", "relax_throughput.csv")
def relax_many(r: pd.DataFrame, rates: pd.DataFrame) -> str:
    """How many models of a folder ended, and the rate."""
    ended = r["status"].fillna("no result").value_counts()
    total = {name: (r[f"{name}_start"].sum(), r[f"{name}_end"].sum()) for name in
             ("violations", "overlaps", "threaded_rings", "inverted_stereocentres")}  # fmt: skip
    of = {name: f"{start:.0f} to {end:.0f}" for name, (start, end) in total.items()}
    rate = rates.iloc[0]
    return paragraph(
        f"Of {len(r)} models, {', '.join(f'{k} end `{name}`' for name, k in ended.items())}. Residues with",
        f"violations fall from {of['violations']}, overlaps from {of['overlaps']}, threaded rings from",
        f"{of['threaded_rings']}, inverted stereocentres from {of['inverted_stereocentres']}.",
        f"It needed {rate['seconds_relax']:.0f} s, or {rate['models_an_hour_relax']:.0f} models an hour.",
        f"AlphaFold's protocol in two processes of one thread relaxes {rate['models_an_hour_openmm']:.0f} an",
        f"hour, estimated from {rate['sample_openmm']:.0f} models. The ratio is {rate['times_sooner']:.1f}.",
    )


@table("relax-crystals", "relax_crystals.csv")
def relax_crystals(r: pd.DataFrame) -> str:
    """What relaxing does to crystal structures."""
    clash, rmsd = r["clashscore_per_1000_atoms_start"], r["ca_rmsd_angstrom"]
    worse = (r["ramachandran_favoured_percent_end"] < r["ramachandran_favoured_percent_start"]).sum()
    outliers = [r[f"ramachandran_outliers_{when}"].sum() for when in ("start", "end")]
    return paragraph(
        f"The set has {len(r)} crystal structures of {between(r['n_residues'])} residues. Clashscores of",
        f"{between(clash)} (hydrogens as added) fall to {r['clashscore_per_1000_atoms_end'].max():.1f} at",
        f"most. The number of Ramachandran outliers is {outliers[0]} before and {outliers[1]} after. C-alpha",
        f"RMSDs are {rmsd.min():.2f} to {rmsd.max():.2f} angstrom. {worse} of {len(r)} structures",
        f"{'has' if worse == 1 else 'have'} fewer favoured residues than the input.",
    )


_PLACED = (
    ("", "{way}"), ("structures", "{structures}"), ("side chains", "{side_chains}"),
    ("chi1 right, %", "{chi1_percent:.1f}"),
    ("chi1 and chi2, %", "{chi12_percent:.1f}"), ("error of chi1, degrees", "{chi1_error_degrees:.1f}"),
    ("chi2", "{chi2_error_degrees:.1f}"), ("chi3", "{chi3_error_degrees:.1f}"),
    ("chi4", "{chi4_error_degrees:.1f}"), ("RMSD, angstrom", "{rmsd_angstrom:.2f}"),
    ("core: chi1 right, %", "{core_chi1_percent:.1f}"), ("RMSD", "{core_rmsd_angstrom:.2f}"),
)  # fmt: skip


@table("sidechains", "sidechains_all.csv", "sidechains_faspr.csv")
def sidechains(ours: pd.DataFrame, theirs: pd.DataFrame) -> str:
    """Errors of side chains by way."""
    return of_rows(pd.concat([ours, theirs]), *_PLACED)


@table("sidechains-words", "sidechains.csv", "sidechains_residues.csv")
def sidechains_words(rows: pd.DataFrame, kinds: pd.DataFrame) -> str:
    """Structures, seconds, clashes and kinds of residues."""
    built = kinds[kinds["way"] == "built"].sort_values("chi1_error_degrees")
    usual = rows["seconds"] / rows["residues"]
    best, worst = (
        ", ".join(f"{r.residue.title()} {r.chi1_error_degrees:.0f}" for r in each.itertuples())
        for each in (built.head(4), built[::-1].head(4))
    )
    left = int((rows["overlaps_relaxed"] > 0).sum())
    clean = int((rows["violations_relaxed"] == 0).sum())
    clashes = rows["clashscore_relaxed_per_1000_atoms"]
    return paragraph(
        f"The set has {len(rows)} crystals of {rows['chains'].sum()} chains and {rows['side_chains'].sum()}",
        f"side chains. Errors of chi1, in degrees, are least for {best}, and largest for {worst}.",
        f"Loading needed {rows['seconds'].sum():.0f} s, a median of {1000 * usual.median():.0f} ms per",
        f"residue. Loading the complete files needs {rows['seconds_complete'].sum():.0f} s of this. Relaxing",
        f"needed {rows['seconds_relax'].sum():.0f} s. After relaxing, {left} of {len(rows)} structures have",
        f"overlaps, and {clean} of {len(rows)} are free of violations. Clashscores are {clashes.min():.1f}",
        f"to {clashes.max():.1f}, with a median of {clashes.median():.1f}.",
    )


_PROGRAMS = {
    "ddg": "`mutate`", "foldx": "FoldX, published", "rosetta": "Rosetta cartesian_ddg, published",
    "mean": "their mean for all",
}  # fmt: skip


def _known(text: str) -> Cell:
    """Cell that is a dash where there is no value."""
    return lambda r: "-" if np.isnan(r["correlation"]) else text.format(**r)


table_of_rows(
    "ddg", "ddg_programs.csv",
    ("", lambda r: _PROGRAMS[r["program"]]), ("mutations", "{mutations}"),
    ("correlation (95 %)", _known("{correlation:.2f} ({lowest:.2f} to {highest:.2f})")),
    ("of ranks", _known("{of_ranks:.2f}")), ("spread / measured", _known("{spread:.1f}")),
    ("error, median", "{error_median:.1f}"), ("mean", "{error_mean:.1f}"), ("RMS", "{error_rms:.1f}"),
    ("right sign, %", "{right_sign_percent:.0f}"),
)  # fmt: skip


table_of_rows(
    "ddg-antisymmetry", "ddg_antisymmetry.csv",
    ("", lambda r: _PROGRAMS[r["program"]]), ("pairs", "{pairs}"),
    ("correlation of the two", "{correlation:.2f}"), ("bias", "{bias:.1f}"),
    ("sum, median", "{sum_median:.1f}"), ("direct and measured, correlation", "{measured_direct:.2f}"),
    ("reverse and measured", "{measured_reverse:.2f}"),
)  # fmt: skip


@table("ddg-words", "ddg.csv")
def ddg_words(rows: pd.DataFrame) -> str:
    """What is not in the table, and how long it took."""
    done = rows["ddg_kcal_mol"].notna()
    unread = rows[rows["status"].isna()]
    return paragraph(
        f"Of {len(rows)} mutations of {rows['structure'].nunique()} structures {done.sum()} are compared.",
        f"{len(unread)} belong to refused files ({', '.join(unread['structure'].unique())}), and",
        f"{len(rows) - done.sum() - len(unread)} to cysteines in disulfide bonds, which lack a reference. A",
        f"mutation needed a median of {rows['seconds'].median():.1f} s of wall time, both sides, on a",
        "machine with many other jobs.",
    )


table_of_rows(
    "frames", "frames_speed.csv",
    ("ensemble", "{ensemble}"), ("frames", "{frames}"), ("with violations", "{frames_with_violations_start}"),
    ("after", "{frames_with_violations_end}"), ("overlaps", "{overlaps_start}"), ("after ", "{overlaps_end}"),
    ("RMSD angstrom", "{ca_rmsd_angstrom:.2f}"), ("`relax`, s a frame", "{seconds_frame:.2f}"),
    ("OpenMM, s a frame", "{seconds_frame_openmm:.2f}"), ("ratio", ratio_of("times_sooner")),
    ("of CPU seconds", ratio_of("times_less_cpu")),
    ("to a command a frame", ratio_of("times_sooner_than_commands")),
)  # fmt: skip


@table("frames-memory", "frames_memory.csv")
def frames_memory(r: pd.DataFrame) -> str:
    """Whether memory grows with the number of frames."""
    parts = [
        f"`{command}` {its['peak_mb'].iloc[0]:.0f} MB for {its['frames'].iloc[0]} frames and"
        f" {its['peak_mb'].iloc[-1]:.0f} MB for {its['frames'].iloc[-1]}"
        for command, its in r.groupby("command", sort=False)
    ]
    return paragraph(f"Peaks of memory, of all processes together, are {', and '.join(parts)}.")
