"""Every table, picture and notebook, made again, and the pages that show them.

    python analysis/bench all [--minutes N] [--again] [--quick] [--only NAME ...] [-o DIR]
                              [--more FOLDER] [--list]

Runs the commands of JOBS one after the other, each in a process of its own. One that fails stops nothing; it
is named at the end, and the exit status is 1. Tables go to analysis/results, and into the pages; with -o DIR
to DIR, and pages made from them to DIR/pages. Pictures and notebooks that a job collects go to their folders,
or to DIR. Before each job it waits until other programs leave the processors idle, half an hour at most.

A job is left out if all its tables were made by its command from the code of today, as made.csv has it,
without changes that were not committed; --again repeats it. So a call after one that was stopped goes on
where it was. With --minutes, no job is begun that would not end in that time, and one that keeps what it has
done is stopped at its end: call it again until the exit status is no longer 3, and all tables are of one
state of the code. --list shows which are, and the minutes that they took. What is apart, --only runs.

MORE stands for a folder of further structures (--more), which are not in the repository; KEPT for one of what
a long job has done, below analysis/results/parts, of the commit.
"""

import argparse
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic

import made
import pages
import pandas as pd
import psutil
from looks import GALLERY
from made import HELD_OUT, MORE, RESULTS, ROOT


@dataclass(frozen=True)
class Job:
    """One command, as the pages quote it."""

    name: str
    command: str
    minutes: float
    """On two cores."""
    quick: str = ""
    """What --quick runs instead; by default the same with --quick."""
    collects: dict[str, tuple[str, tuple[str, ...]]] = field(default_factory=dict)
    """Of a command that writes no made.csv: file, name here, columns of a table (empty: all)."""

    threads: int | None = None
    """Of such a command; as many as there are processors, by default."""
    writes: str = ""
    """Names of its tables and pictures; by default one table of its own name, or the collected files."""
    continues: bool = False
    """Whether it goes on where it was stopped: from its folder KEPT, or from the tables that it collects."""
    after: str = ""
    """Job whose tables it reads."""
    apart: bool = False
    """Whether it runs only where --only names it: it takes hours, or a program that pip cannot install."""

    @property
    def tables(self) -> list[str]:
        """Files with a row in made.csv: tables, pictures and notebooks."""
        if self.collects:
            return [name for name, _ in self.collects.values()]
        names = (self.writes or self.name.replace("-", "_")).split()
        return [name if "." in name else f"{name}.csv" for name in names]

    @property
    def inputs(self) -> list[str]:
        """Files that the command names."""
        words = [word.partition(":")[0] for word in self.command.split()]
        return [word for word in words if word.endswith((".pdb", ".cif"))]

    @property
    def needs_more(self) -> bool:
        """Whether it reads files that are not in the repository."""
        return "MORE" in self.command


SAMPLES = " ".join(
    f"structures/{n}.pdb" for n in ("ala10", "1l2y", "1vii", "1ejg", "3i40", "4pti", "1ubq", "1hel")
)
SMALL = " ".join(
    f"MORE/{name}"
    for name in (
        "1le1_trpzip2.pdb", "a6pa6_alpha.pdb", "aaqaa3_capped.pdb", "1as5_conotoxin.cif",
        "neopetrosiamide.pdb",
    )
)  # fmt: skip
STARTED = " ".join(
    [*(f"structures/{name}.pdb" for name in ("1l2y", "1vii", "1ejg", "4pti", "1ubq")), SMALL]
    + [f"MORE/{name}" for name in ("1ajj_ldlr.pdb", "1bx8_hirustasin.pdb", "1orc_icode.pdb")]
)
IN_PATHS = " ".join(f"structures/{name}.pdb" for name in ("1l2y", "1vii", "1ejg", "4pti", "1ubq"))
IN_PATHS += " MORE/1orc_icode.pdb"
ENDED = " ".join(f"structures/{name}.pdb" for name in ("ala10", "1l2y", "1vii", "1ejg", "3i40"))
HELD = " ".join(f"MORE/{name}" for name in HELD_OUT[:-1])
"""Without the largest, in which OpenMM's minimiser takes more than ten minutes to a tolerance of 1."""
HELD_OUT_FILES = " ".join(f"MORE/{name}" for name in HELD_OUT)
DESCENDED = "structures/ala10.pdb structures/1l2y.pdb MORE/1le1_trpzip2.pdb"
RELAXED = " ".join(
    f"MORE/{name}"
    for name in (
        "af_with_violations.pdb", "af_multiple_disulfides.pdb", "src_1yi6_start.pdb", "6lfo_gap_model.pdb",
        "boltz2_5ht2c.cif",
    )
)  # fmt: skip
CRYSTALS = " ".join(
    f"MORE/{name}"
    for name in (
        "1a8o_mse.pdb", "1ajj_ldlr.pdb", "1ake_A.pdb", "1bx8_hirustasin.pdb", "1ejg_crambin.pdb",
        "1fas_fasciculin.cif", "1hel_lysozyme.pdb", "1orc_icode.pdb", "1ubq_ubiquitin.pdb",
        "2ptc_I_bpti_occ0.pdb", "3i40_insulin.pdb", "3u7t_crambin_neutron.cif", "4cup_missing.cif",
        "4pti_bpti.pdb", "5pti_bpti.cif",
    )
)  # fmt: skip
OF_B_FACTORS = " ".join(
    f"MORE/{name}.pdb"
    for name in (
        "1ubq_ubiquitin", "4pti_bpti", "3i40_insulin", "1hel_lysozyme", "1ejg_crambin", "1ake_A", "1ajj_ldlr",
        "1bx8_hirustasin", "1orc_icode", "1us0_altlocs",
    )
)  # fmt: skip
LARGE = "structures/1ake.pdb.gz MORE/1us0_altlocs.pdb MORE/3enl_enolase.pdb"
OF_CRYSTALS = (
    "structure", "status", "n_residues", "violations_start", "violations_end",
    "clashscore_per_1000_atoms_start", "clashscore_per_1000_atoms_end", "ramachandran_outliers_start",
    "ramachandran_outliers_end", "ramachandran_favoured_percent_start", "ramachandran_favoured_percent_end",
    "cbeta_outliers_start", "cbeta_outliers_end", "twisted_peptides_start", "twisted_peptides_end",
    "ca_rmsd_angstrom",
)  # fmt: skip
CURVES = "solvers,energies,integrators,sampling,closures,fixman,hessians"
HERE = "python analysis/benchmarks"
FIGURES = (
    "comparison", "dynamics-energy", "engines-accuracy", "integrators", "kcm", "kcm-paths", "limit-cycle",
    "near", "omissions", "stability",
)  # fmt: skip
"""Names of figures.py, which reads tables of other jobs."""
COMPARED = "kcm,md,lbfgs,hybrid,cartesian,openmm"
NOTEBOOKS, SCENES = (
    sorted(path.stem for path in (ROOT / "analysis" / kind).glob("*.ipynb"))
    for kind in ("notebooks", "scenes")
)
KCM_RUNS = " ".join(
    f"analysis/results/{name}.csv"
    for name in ("kcm_runs", "kcm_traces", "lowest", "kcm_paths", "kcm_path_points")
)
KCM_TABLES = ("contrasts", "proteins", "cost", "deposited", "bodies", "choices", "minima", "above", "methods")

JOBS = (
    Job("mechanics", f"{HERE}/mechanics.py -o DIR", 1, writes="mechanics mechanics_scaling mechanics_steps"),
    Job("engines", f"{HERE}/engines.py energies -o DIR", 6),
    Job("engines-accuracy", f"{HERE}/engines.py accuracy -o DIR", 8, threads=1),
    Job("engines-moving", f"{HERE}/engines.py moving -o DIR", 1),
    Job("device", f"{HERE}/device.py -o DIR", 3),
    Job("large", f"{HERE}/large.py -o DIR", 5, writes="large large_exponents"),
    Job("threads", f"{HERE}/threads.py -o DIR", 1),
    Job("terms", f"{HERE}/terms.py -o DIR", 1, threads=1),
    Job("search", f"{HERE}/search.py -o DIR", 1, writes="search search_lists"),
    Job(
        "mechanisms", f"{HERE}/mechanisms.py -o DIR", 12,
        writes="mechanisms mechanisms_checks mechanisms_left_out mechanisms_work",
    ),
    Job("loops", f"{HERE}/loops.py -o DIR", 2, writes="loops loops_costs"),
    Job("loads", f"{HERE}/loads.py -o DIR", 1, writes="loads_costs"),
    Job("minima-found", f"{HERE}/minima.py found --seeds 3 -o DIR", 9),
    Job("minima-truth", f"{HERE}/minima.py truth -o DIR", 4),
    Job("minima-cost", f"{HERE}/minima.py cost -o DIR", 2, threads=1),
    Job("guide", f"{HERE}/guide.py -o DIR", 1),
    Job("startup", f"{HERE}/startup.py --install -o DIR", 6, writes="startup startup_parts"),
    Job("files-speed", f"{HERE}/files.py speed --more MORE -o DIR", 2),
    Job("kinds", f"{HERE}/kinds.py --every 3 --processes 2 -o DIR", 8),
    Job("fuzz", f"{HERE}/fuzz.py -o DIR", 90, apart=True),
    Job("race", f"{HERE}/race.py {HELD} --custom 450 -o DIR", 13, writes="race_gbsa race_obc2 race_vacuum"),
    Job("race-parts", f"{HERE}/parts.py -o DIR", 1, writes="minimise_parts"),
    Job(
        "near", f"{HERE}/near.py {HELD_OUT_FILES} --kept KEPT -o DIR", 40,
        threads=1, writes="near near_ends", continues=True,
    ),
    Job(
        "basins", f"{HERE}/near.py --basins {DESCENDED} -o DIR", 6,
        f"{HERE}/near.py --basins structures/ala10.pdb --quick -o DIR", threads=1, writes="near_basins",
    ),
    Job(
        "precision", f"python analysis/bench precision --only minimisers {SAMPLES} {SMALL} -o DIR",
        9,
        "python analysis/bench precision --only minimisers structures/ala10.pdb -o DIR",
        {"precision.csv": ("precision.csv", ()), "ends.csv": ("precision_ends.csv", ())},
    ),
    Job(
        "curves", f"python analysis/bench precision --only {CURVES} -o DIR", 5,
        collects={"curves.csv": ("precision_curves.csv", ())}, threads=1,
    ),
    Job("ends", f"{HERE}/ends.py {ENDED} --kept KEPT -o DIR", 8, threads=1, continues=True),
    Job(
        "modes",
        f"{HERE}/modes.py {OF_B_FACTORS} --pairs MORE --as-is {LARGE} -o DIR",
        7,
        f"{HERE}/modes.py --quick -o DIR",
        writes="modes_b_factors modes_cost modes_pairs modes_steps",
    ),
    Job(
        "compliance", f"{HERE}/compliance.py -o DIR", 4,
        writes="compliance_angles compliance_evaluations compliance_starts",
    ),
    Job(
        "runs-kcm", f"python analysis/bench kcm {STARTED} --starts 2 -o DIR --jobs 2 --minutes 20", 25,
        "python analysis/bench kcm --quick -o DIR",
        {"runs.csv": ("kcm_runs.csv", ()), "traces.csv": ("kcm_traces.csv", ())}, continues=True,
    ),
    Job(
        "lowest", "python analysis/bench lowest MORE/a6pa6_alpha.pdb -o DIR --minutes 20", 20,
        "python analysis/bench lowest --quick -o DIR", {"lowest.csv": ("lowest.csv", ())}, continues=True,
    ),
    Job(
        "paths-kcm", f"python analysis/bench paths {IN_PATHS} -o DIR --minutes 40", 40,
        "python analysis/bench paths --quick -o DIR",
        {"paths.csv": ("kcm_paths.csv", ()), "path_points.csv": ("kcm_path_points.csv", ())}, continues=True,
    ),
    Job(
        "kcm", f"python analysis/bench kcm {KCM_RUNS} -o DIR --minutes 0", 1,
        f"python analysis/bench kcm {KCM_RUNS} -o DIR --minutes 0",
        {f"{name}.csv": (f"kcm_{name}.csv", ()) for name in KCM_TABLES},
        after="runs-kcm",
    ),
    Job("relax", f"{HERE}/relax.py {RELAXED} --made 2 --repeats 2 -o DIR", 8),
    Job(
        "relax-many", f"{HERE}/relax.py --many 300 --sample 10 -o DIR", 5,
        writes="relax_many relax_throughput",
    ),
    Job(
        "relax-crystals", f"protochain relax {CRYSTALS} --preset crystal -o DIR", 2,
        "protochain relax structures/ala10.pdb structures/1l2y.pdb --preset crystal -o DIR",
        {"relaxed.csv": ("relax_crystals.csv", OF_CRYSTALS)},
    ),
    Job(
        "sidechains", f"{HERE}/sidechains.py built --more MORE -o DIR", 4,
        writes="sidechains sidechains_all sidechains_residues",
    ),
    Job("sidechains-faspr", f"{HERE}/sidechains.py faspr --more MORE -o DIR", 1, apart=True),
    Job("flips", f"{HERE}/flips.py --more MORE -o DIR", 2),
    Job(
        "ddg", f"{HERE}/ddg.py -o DIR --more MORE --kept KEPT", 18,
        writes="ddg ddg_programs ddg_pairs ddg_antisymmetry", continues=True,
    ),
    Job("frames", f"{HERE}/frames.py --more MORE -o DIR", 6, writes="frames_memory frames_speed"),
    Job(
        "complexes", f"{HERE}/complexes.py --more MORE -o DIR", 10,
        writes="complexes_models complexes_poses",
    ),
    Job(
        "interfaces", f"{HERE}/interfaces.py --more MORE -o DIR", 7,
        writes="interfaces_columns interfaces_cost interfaces_moved",
    ),
    Job("dynamics-energy", f"{HERE}/dynamics.py energy -o DIR", 4),
    Job("dynamics-steps", f"{HERE}/dynamics.py steps -o DIR", 5),
    Job("dynamics-cost", f"{HERE}/dynamics.py cost --more MORE -o DIR", 2),
    Job("dynamics-speed", f"{HERE}/dynamics.py speed --more MORE -o DIR", 5),
    Job("dipeptide", f"{HERE}/dipeptide.py --trajectories 5000 --ns 1 --kept KEPT -o DIR", 5, continues=True),
    Job("batch", f"{HERE}/batch.py --more MORE -o DIR", 4, writes="batch batch_costs"),
    Job(
        "omissions", "python analysis/bench omissions structures/1hel.pdb -o DIR", 5,
        "python analysis/bench omissions structures/1l2y.pdb --quick -o DIR",
        {"omissions.csv": ("scenes.csv", ())},
    ),
    Job(
        "stability", "python analysis/bench stability -o DIR", 8,
        "python analysis/bench stability --quick -o DIR",
        {"error_against_time.csv": ("stability.csv", ()), "cells.csv": ("stability_cells.csv", ())},
    ),
    Job(
        "comparison",
        f"protochain compare structures/1ubq.pdb --methods {COMPARED} -o DIR", 1,
        "protochain compare structures/ala10.pdb --methods lbfgs,cartesian -o DIR",
        {"traces.csv": ("comparison.csv", ("method", "evaluations", "seconds", "energy_kj_mol"))},
    ),
    Job(
        "figures", f"{HERE}/figures.py -o DIR", 1, f"{HERE}/figures.py -o DIR",
        writes=" ".join(f"{name}.svg" for name in FIGURES),
    ),
    Job(
        "relaxation", f"{HERE}/pocket.py structures/6bj9_model_0.cif.gz -o DIR", 1,
        collects={"relaxation.webp": ("relaxation.webp", ())},
    ),
    *(
        Job(
            f"gallery-{stage}", f"python analysis/looks.py DIR/pages --gallery DIR --stage {stage}", 10,
            collects={name: (name, ()) for kind in GALLERY for name in [f"{kind}-{stage}.webp"]},
            apart=True,
        )
        for stage in ("before", "after")
    ),
    *(
        Job(
            kind, f"python analysis/remake.py {' '.join(names)} -o DIR", minutes,
            f"python analysis/remake.py {names[0]} -o DIR",
            {f"{name}.ipynb": (f"{name}.ipynb", ()) for name in names},
        )
        for kind, minutes, names in (("notebooks", 10, NOTEBOOKS), ("scenes", 20, SCENES))
    ),
)  # fmt: skip
"""The one table of commands."""


PARTS = RESULTS / "parts"
"""Of what long jobs have done; git ignores it."""


def words_of(job: Job, output: Path, more: Path, quick: bool, kept: Path = PARTS) -> list[str]:
    """Words of a command, with its folders."""
    line = (job.quick or f"{job.command} --quick") if quick else job.command
    folders = {"DIR": str(output), "KEPT": str(kept)}
    program, *words = shlex.split(line)
    folders["MORE"] = str(more)
    given = [re.sub(r"^(DIR|KEPT|MORE)(?=$|/)", lambda place: folders[place[1]], word) for word in words]
    return [sys.executable if program == "python" else shutil.which(program) or program, *given]


def is_done(job: Job, output: Path, more: Path) -> bool:
    """Whether all its tables are there, made by its command from the code of today."""
    record = output / made.RECORD
    if not record.exists():
        return False
    rows = pd.read_csv(record, dtype=str).set_index("table")
    command = made.command(words_of(job, output, more, False))
    return all(
        name in rows.index and rows["command"][name] == command and made.is_of_today(rows["commit"][name])
        for name in job.tables
    )


def measured(output: Path, tables: list[str]) -> float:
    """Seconds that tables took."""
    if not tables:
        return 0.0
    rows = pd.read_csv(output / made.RECORD).set_index("table")
    return float(rows.loc[tables, "seconds"].sum())


def run(job: Job, output: Path, more: Path, quick: bool, seconds: float | None = None) -> str | None:
    """Run a job, its tables written to a folder; return why it failed, "", or None if it was stopped."""
    if job.needs_more and not quick and not more.is_dir():
        return f"its files are not in {more}; name their folder by --more"
    with tempfile.TemporaryDirectory() as scratch:
        kept = Path(scratch) / "kept"
        if job.continues and not quick and " " not in made.COMMIT:  # else nobody knows of which code
            kept = PARTS / made.COMMIT / job.name
        place = (kept if job.continues else Path(scratch) / "out") if job.collects else output
        words = words_of(job, place, more, quick, kept)
        path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
        began = monotonic()
        status = called(words, os.environ | {"PYTHONPATH": path}, seconds if job.continues else None)
        if status is None:
            return None
        # 3: usable, not all converged.
        if status and not (job.collects and status == 3):
            return f"exit status {status}"
        for name, (kept_as, columns) in job.collects.items():
            if not (place / name).exists():
                return f"wrote no {name}"
            threads = job.threads or len(os.sched_getaffinity(0))
            about = (job.inputs, threads, words, (monotonic() - began) / len(job.tables))
            if name.endswith(".csv"):
                table = pd.read_csv(place / name)
                made.write(table[list(columns)] if columns else table, output / kept_as, *about)
            else:
                target = folder_of(kept_as, output) / kept_as
                shutil.copy(place / name, target)
                made.record(target, output, *about)
        places = {name: {output / name, folder_of(name, output) / name} for name in job.tables}
        missing = [name for name, paths in places.items() if not (quick or any(p.exists() for p in paths))]
        return f"wrote no {missing[0]}" if missing else ""


def folder_of(name: str, output: Path) -> Path:
    """Folder of a picture or notebook that a job collects, for a folder of tables."""
    if output != RESULTS:
        return output
    kinds = {**dict.fromkeys(NOTEBOOKS, "notebooks"), **dict.fromkeys(SCENES, "scenes")}
    kinds |= {f"{kind}-{stage}": "results" for kind in GALLERY for stage in ("before", "after")}
    return ROOT / "analysis" / kinds.get(Path(name).stem, "docs")


def called(words: list[str], env: dict[str, str], seconds: float | None) -> int | None:
    """Exit status of a command; None if it took too long, and was stopped with the processes it began."""
    with subprocess.Popen(words, cwd=ROOT, env=env, start_new_session=True) as process:
        try:
            return process.wait(seconds)
        except subprocess.TimeoutExpired:
            return None
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)


IDLE, PATIENCE = 0.2, 1800.0
"""Share of the processors that others may use, and how many seconds it waits for that."""


def wait_until_idle() -> None:
    """Wait while other programs use the processors."""
    until = monotonic() + PATIENCE
    while (used := psutil.cpu_percent(2.0) / 100.0) > IDLE and monotonic() < until:
        print(f"other programs use {used:.0%} of the processors", end="\r", flush=True)


def parser() -> argparse.ArgumentParser:
    own = made.parser(__doc__ or "", more=True)
    names = [job.name for job in JOBS]
    own.add_argument("--only", nargs="+", metavar="NAME", help=f"of {', '.join(names)}, or how some begin")
    own.add_argument("--minutes", type=float, metavar="N", help="no job is begun that would end later")
    own.add_argument("--again", action="store_true", help="also what was made from the code of today")
    own.add_argument("--list", action="store_true", help="commands, their minutes, which are done, and stop")
    return own


def chosen(only: list[str] | None) -> list[Job]:
    """Jobs of these names, or that begin so.

    Raises
    ------
    SystemExit
        If there is none of a name.
    """
    if not only:
        return [job for job in JOBS if not job.apart]
    for name in only:
        if not any(job.name == name or job.name.startswith(f"{name}-") for job in JOBS):
            sys.exit(f"there is no benchmark {name!r}; --list shows them")
    return [job for job in JOBS if any(job.name == n or job.name.startswith(f"{n}-") for n in only)]


def main(words: list[str] | None = None) -> int:
    """Run what is to be done; exit status 1 if a job failed, 3 if one is left."""
    options = parser().parse_args(words)
    jobs = chosen(options.only)
    output, more = (options.output or RESULTS).absolute(), options.more.absolute()
    done = {job.name for job in jobs if not options.quick and is_done(job, output, more)}
    if options.list:
        for job in jobs if options.only else JOBS:
            state = "done" if job.name in done else "apart" if job.apart else ""
            print(f"{job.name:<16} {job.minutes:>3g} min  {state:<5} {job.command}")
        to_do = sum(job.minutes for job in jobs if job.name not in done)
        took = measured(output, [name for job in jobs if job.name in done for name in job.tables]) / 60.0
        print(f"{'all':<16} {to_do:>3g} min  to do, {took:.0f} done; MORE: {MORE.name}, by --more FOLDER")
        return 0
    if options.quick and not options.output:
        sys.exit("with --quick, say where its tables go: -o DIR; they are not what pages quote")
    failed, left = {}, {}
    until = monotonic() + 60.0 * options.minutes if options.minutes is not None else float("inf")
    for job in jobs:
        began = monotonic()
        if job.name in done and not options.again:
            print(f"=== {job.name}: was made from the code of today", flush=True)
            continue
        if job.after in failed or job.after in left:
            left[job.name] = f"after {job.after}"
        elif not job.continues and began + 60.0 * job.minutes > until:
            left[job.name] = f"takes {job.minutes:g} min"
        elif began >= until:
            left[job.name] = f"takes {job.minutes:g} min, in parts"
        if job.name in left:
            continue
        if not options.quick:
            wait_until_idle()
        print(f"\n=== {job.name}: {(options.quick and job.quick) or job.command}", flush=True)
        why = run(job, output, more, options.quick, None if until == float("inf") else until - monotonic())
        if why is None:
            left[job.name] = "goes on where it was stopped"
        elif why:
            failed[job.name] = why
        print(f"=== {job.name}: {left.get(job.name) or why or 'done'}, {(monotonic() - began) / 60:.1f} min")
    for page in pages.write(output, ROOT if output == RESULTS else output / "pages"):
        print(f"made: {page}")
    for name, why in failed.items():
        print(f"failed: {name}: {why}", file=sys.stderr)
    for name, why in left.items():
        print(f"left: {name}: {why}", file=sys.stderr)
    return 1 if failed else 3 if left else 0


if __name__ == "__main__":
    sys.exit(main())
