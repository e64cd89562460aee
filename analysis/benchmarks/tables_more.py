"""The tables of dynamics, engines, files, mechanics, batches and tests; the others are in tables.py."""

from pathlib import Path

import pandas as pd
from tables import digits, markdown, of_rows, paragraph, ratio, ratio_of, table


@table("dynamics-energy")
def dynamics_energy(results: Path) -> str:
    """Error, drift and cost by integrator and step."""
    rows = pd.read_csv(results / "dynamics_energy.csv")
    return of_rows(
        rows[(rows["status"] == "completed") & (rows["step_fs"] >= 1)],
        ("integrator", "{integrator}"), ("step fs", "{step_fs:g}"), ("over ps", "{time_ps:g}"),
        ("error kJ/mol", "{error_kj_mol:.2g}"),
        ("drift kJ/mol/ps per 100 atoms", "{drift_kj_mol_ps_100_atoms:.0e}"),
        ("ms per step", lambda r: digits(r["ms_per_step"])),
    )  # fmt: skip


MODELS = {
    "phi psi chi": "phi psi chi",
    "+ omega": "and omega",
    "+ rotors": "and rotors",
    "+ rotors, 4 amu hydrogens": "and rotors, hydrogens of 4 amu",
    "+ angles": "and bond angles at N and C-alpha",
    "all": "all of them",
}


@table("dynamics-steps")
def dynamics_steps(results: Path) -> str:
    """Largest steps by hinges."""
    return of_rows(
        pd.read_csv(results / "dynamics_steps.csv"),
        ("hinges", lambda r: MODELS[r["hinges"]]), ("degrees of freedom", "{freedoms}"),
        ("drift below 0.01", "{quiet_fs} fs"), ("stable", "{stable_fs} fs"),
    )  # fmt: skip


@table("dynamics-cost")
def dynamics_cost(results: Path) -> str:
    """The rest of a step beside its energy."""
    return of_rows(
        pd.read_csv(results / "dynamics_cost.csv"),
        ("structure", "{structure}"), ("atoms", "{atoms}"), ("hinges", "{hinges}"),
        ("energy and torques", "{energy_and_torques_ms:.2f}"), ("rest of the step", "{rest_ms:.2f}"),
        ("relative to the energy", "{rest_percent:.1f} %"),
    )  # fmt: skip


SOLVENTS = {"obc2": "OBC2", "gbn2": "GBn2", "vacuum": "vacuum"}


@table("dynamics-speed")
def dynamics_speed(results: Path) -> str:
    """Nanoseconds a day."""
    columns = [("OpenMM 2 fs", "openmm_2_fs"), ("with GBSAOBCForce", "gbsaobc_2_fs")]
    columns += [(f"{h} fs", f"ours_{h}_fs") for h in (2, 4, 8)]
    ratios = [(f"ratio at {h} fs" if h == 2 else f"at {h} fs", ratio_of(f"ratio_{h}_fs")) for h in (2, 4, 8)]
    return of_rows(
        pd.read_csv(results / "dynamics_speed.csv"),
        ("structure", "{structure}"), ("residues", "{residues}"),
        ("solvent", lambda r: SOLVENTS[r["solvent"]]),
        *((heading, lambda r, name=name: digits(r[name])) for heading, name in columns), *ratios,
    )  # fmt: skip


@table("dynamics-short")
def dynamics_short(results: Path) -> str:
    """Nanoseconds a day in OBC2 at 4 fs, and the rest of a step."""
    rows = pd.read_csv(results / "dynamics_speed.csv")
    rest = pd.read_csv(results / "dynamics_cost.csv")[["structure", "rest_percent"]]
    return of_rows(
        rows[rows["solvent"] == "obc2"].merge(rest, on="structure"),
        ("structure", "{structure}"), ("residues", "{residues}"),
        ("OpenMM", lambda r: digits(r["gbsaobc_2_fs"])), ("protochain", lambda r: digits(r["ours_4_fs"])),
        ("ratio", ratio_of("ratio_4_fs")),
        ("rest of the step, relative to the energy", "{rest_percent:.1f} %"),
    )  # fmt: skip


def _dipeptide(results: Path) -> pd.DataFrame:
    return pd.read_csv(results / "dipeptide.csv").set_index(["method", "basin"])


@table("dipeptide")
def dipeptide(results: Path) -> str:
    """Shares of basins."""
    rows = _dipeptide(results)
    basins = {
        "beta, PII (phi < 0, psi > 60 or < -150)": "beta and PII (phi < 0; psi > 60 or < -150)",
        "alpha R (phi < 0, -150 < psi < 60)": "alpha R (phi < 0; psi between)",
        "phi > 0": "phi > 0",
    }

    def share(method: str, basin: str) -> str:
        r = rows.loc[(method, basin)]
        return f"{r.share_percent:.1f} +- {r.error_percent:.1f} %" if r.share_percent else "not visited"

    return markdown(
        ("basin", "rigid, quadrature", "rigid, Monte Carlo", "flexible, OpenMM"),
        ((shown, f"{rows.loc[('quadrature, Fixman', basin)].share_percent:.1f} %",
          share("rigid, Monte Carlo", basin), share("flexible, OpenMM", basin))
         for basin, shown in basins.items()),
    )  # fmt: skip


@table("dipeptide-words")
def dipeptide_words(results: Path) -> str:
    """What the shares say."""
    rows = _dipeptide(results)
    basin = rows.index[0][1]
    rigid, flexible = (rows.loc[(name, basin)] for name in ("rigid, Monte Carlo", "flexible, OpenMM"))
    without, wrong = (
        rows.loc[(f"quadrature, {name}", basin)].share_percent for name in ("no Fixman", "wrong sign")
    )
    return paragraph(
        f"Monte Carlo is {abs(rigid.errors_from_quadrature):.1f} standard errors from quadrature; some",
        f"{rigid.samples_per_independent_one:.0f} trajectories count as one independent one. Without",
        f"Fixman's potential the first share would be {without:.1f} %, with a wrong sign {wrong:.1f} %: this",
        "molecule cannot tell, other tests do ([numbers you can check](#numbers-you-can-check)). Of the",
        f"first basin OpenMM's seeds say between {flexible.lowest_seed_percent:.0f} and",
        f"{flexible.highest_seed_percent:.0f} %: of the flexible molecule runs of this length say little.",
    )


@table("engines")
def engines(results: Path) -> str:
    """One energy, native against OpenMM."""
    return of_rows(
        pd.read_csv(results / "engines.csv"),
        ("structure", "{structure}"), ("atoms", "{atoms}"), ("OpenMM's force", "{solvent}"),
        ("OpenMM CPU ms", "{openmm_ms:.2f}"), ("native ms", "{native_ms:.2f}"), ("ratio", ratio_of("ratio")),
        ("ns per pair", "{ns_a_pair:.2f}"), ("times the floor", "{times_the_floor:.1f}"),
    )  # fmt: skip


@table("engines-short")
def engines_short(results: Path) -> str:
    """Ratios of one energy by structure."""
    rows = pd.read_csv(results / "engines.csv").pivot(
        index=["atoms", "structure"], columns="solvent", values="ratio"
    )
    forces = ("vacuum", "OBC2", "OBC2, GBSAOBCForce", "GBn2")
    return markdown(
        ("structure", "atoms", *forces),
        ((name, atoms, *(ratio(row[force]) for force in forces)) for (atoms, name), row in rows.iterrows()),
    )


@table("engines-cutoff")
def engines_cutoff(results: Path) -> str:
    """Time for each atom with a cutoff."""
    return of_rows(
        pd.read_csv(results / "engines_cutoff.csv").astype({"atoms": str}),
        ("atoms", "{atoms}"), ("cutoff 1.0 nm, vacuum: us per atom", "{vacuum_us_an_atom:.2f}"),
        ("OBC2: us per atom", "{obc2_us_an_atom:.2f}"), ("OBC2, lists anew", "{anew_us_an_atom:.2f}"),
    )  # fmt: skip


@table("engines-moving")
def engines_moving(results: Path) -> str:
    """What leaving out constant terms saves."""
    return of_rows(
        pd.read_csv(results / "engines_moving.csv"),
        ("structure", "{structure}"), ("solvent", lambda r: SOLVENTS[r["solvent"]]), ("hinges", "{hinges}"),
        ("moves", "{move}"), ("freedoms", "{freedoms}"), ("all ms", "{all_ms:.2f}"),
        ("moving terms ms", "{moving_ms:.2f}"), ("ratio", "{ratio:.2f}"), ("sweeps ms", "{sweeps_ms:.3f}"),
        ("share", "{sweeps_percent:.1f} %"),
    )  # fmt: skip


@table("threads")
def threads(results: Path) -> str:
    """One energy on one thread and on two, beside other work."""
    return of_rows(
        pd.read_csv(results / "threads.csv"),
        ("structure", "{structure}"), ("atoms", "{atoms}"), ("cores busy with other work", "{cores_busy}"),
        ("one thread ms", "{one_thread_ms:.2f}"), ("two ms", "{two_threads_ms:.2f}"),
        ("two over one", "{ratio:.2f}"),
    )  # fmt: skip


@table("large")
def large(results: Path) -> str:
    """Copies of one structure side by side, minimised in all atoms."""
    rows, slopes = pd.read_csv(results / "large.csv"), pd.read_csv(results / "large_exponents.csv")
    shown = of_rows(
        rows,
        ("atoms", "{atoms}"), ("prepared s", "{prepare_s:.2f}"), ("an energy s", "{energy_s:.3f}"),
        ("evaluations", "{evaluations}"), ("minimisation s", "{minimise_s:.1f}"),
        ("shell to shell s", "{shell_s:.0f}"), ("memory MB", "{memory_mb:.0f}"), ("status", "{status}"),
    )  # fmt: skip
    exponent = slopes.set_index("seconds_of")["exponent"]
    said = paragraph(
        f"Exponents with the number of atoms: preparation {exponent['prepare_s']:.2f}, an energy "
        f"{exponent['energy_s']:.2f}, the minimisation {exponent['minimise_s']:.2f}."
    )
    return f"{shown}\n{said}"


@table("startup")
def startup(results: Path) -> str:
    """Shell to shell, with kernels to compile and without."""
    return of_rows(
        pd.read_csv(results / "startup.csv"),
        ("command", "`{command}`"), ("state", "{state}"), ("s", "{seconds:.1f}"),
        ("processor s", "{cpu_seconds:.1f}"),
    )  # fmt: skip


@table("files-speed")
def files_speed(results: Path) -> str:
    """Seconds to prepare a file."""
    return of_rows(
        pd.read_csv(results / "files_speed.csv"),
        ("structure", lambda r: r["structure"].replace("_A", ", chain A").split("_")[0]),
        ("residues", "{residues}"), ("atoms", "{atoms}"), ("seconds", "{seconds:.2f}"),
        ("PDBFixer and addHydrogens", "{openmm_seconds:.2f}"),
    )  # fmt: skip


@table("files-closures")
def files_closures(results: Path) -> str:
    """Lengths of bonds that close loops."""

    def of(name: str):
        def shown(row: pd.Series) -> str:
            low, high = (f"{row[f'{name}_{which}_angstrom']:.3f}" for which in ("shortest", "longest"))
            return low if low == high else f"{low} to {high}"

        return shown

    methods = ("kcm", "lbfgs", "md", "hybrid", "openmm")
    return of_rows(
        pd.read_csv(results / "files_closures.csv"),
        ("structure", lambda r: r["structure"].replace("_", ", ")), ("loops", "{loops}"),
        ("start", of("start")),
        *((f"`{method}`", of(method)) for method in methods),
    )  # fmt: skip


@table("mechanics-scaling")
def mechanics_scaling(results: Path) -> str:
    """Time and memory of a hinge."""
    return of_rows(
        pd.read_csv(results / "mechanics_scaling.csv").astype({"hinges": str}),
        ("hinges", "{hinges}"), ("forward dynamics ns per hinge", "{ns_per_hinge:.0f}"),
        ("bytes per hinge", "{bytes_per_hinge:.0f}"),
    )  # fmt: skip


def _against(own: str, other: str):
    def shown(row: pd.Series) -> str:
        return "-" if pd.isna(row[other]) else f"{row[other]:.1f} ({row[other] / row[own]:.2f}x)"

    return shown


@table("mechanics")
def mechanics(results: Path) -> str:
    """The mass matrix beside two libraries."""
    return of_rows(
        pd.read_csv(results / "mechanics.csv").astype({"hinges": str}),
        ("hinges", "{hinges}"), ("forward dynamics us", "{forward_us:.1f}"),
        ("pin.aba", _against("forward_us", "pinocchio_us")), ("DART", _against("forward_us", "dart_us")),
        ("M^-1 tau us", "{solve_us:.1f}"), ("pin.aba", _against("solve_us", "pinocchio_us")),
    )  # fmt: skip


@table("mechanics-short")
def mechanics_short(results: Path) -> str:
    """Forward dynamics beside two libraries."""
    return of_rows(
        pd.read_csv(results / "mechanics.csv").astype({"hinges": str}),
        ("hinges", "{hinges}"), ("protochain us", "{forward_us:.1f}"),
        ("Pinocchio", _against("forward_us", "pinocchio_us")), ("DART", _against("forward_us", "dart_us")),
    )  # fmt: skip


@table("stability")
def stability(results: Path) -> str:
    """Time and backward error of M^-1 tau by three algorithms."""
    rows = pd.read_csv(results / "stability.csv").set_index(["bodies", "route"])
    names = {"dense Cholesky": "dense Cholesky", "articulated": "articulated", "fixman": "Fixman"}

    def shown(n: int, route: str) -> str:
        if (n, route) not in rows.index:
            return "-"
        r = rows.loc[(n, route)]
        ms = f"{r.ms:.2g} ms" if r.ms < 99.5 else f"{r.ms / 1000:.2g} s"
        return f"{ms}, {r.backward_error_eps:.1g}"

    sizes = [n for n in (10, 100, 1000, 10_000, 100_000) if n in rows.index.get_level_values(0)]
    return markdown(
        ("bodies", *names.values()), ((f"{n:,}", *(shown(n, route) for route in names)) for n in sizes)
    )


@table("stability-grid")
def stability_grid(results: Path) -> str:
    """Verdicts of the grid by row, with the largest error of its bound."""
    cells = pd.read_csv(results / "stability_cells.csv")
    share = (cells["error"] / cells["bound"]).where(cells["error"] > 0, 0.0)

    def line(name: str, own: pd.DataFrame) -> tuple[str, ...]:
        worst = cells.loc[share[own.index].idxmax()]
        counted = (f"{(own['verdict'] == v).sum()}" for v in ("right", "refused", "wrong"))
        what = f"{share[own.index].max():.2g} of its bound ({worst['case']}, {worst['parameters']})"
        return name, f"{len(own)}", *counted, what

    rows = [line(str(name), own) for name, own in cells.groupby("row", sort=False)]
    heads = ("row", "cells", "right", "refused, as expected", "wrong", "largest error")
    return markdown(heads, [*rows, line("all", cells)])


@table("batch-words")
def batch_words(results: Path) -> str:
    """Rate of a batch, for the README."""
    r = pd.read_csv(results / "batch.csv").iloc[-1]
    return paragraph(
        f"**A batch**: {r.structures:.0f} structures, {r.without_result:.0f} of them broken, at",
        f"{r.a_second:.1f} per second on {r.workers:.0f} single-threaded workers, {r.ratio:.1f} times the",
        f"rate of one worker; the client has {r.client_mb_first:.0f} MB at first and",
        f"{r.client_mb_last:.0f} MB at the end ([costs](analysis/docs/cluster.md#costs)).",
    )


@table("batch")
def batch(results: Path) -> str:
    """Rate and memory by number of workers."""
    return of_rows(
        pd.read_csv(results / "batch.csv"),
        ("workers", "{workers:.0f}"), ("structures per second", "{a_second:.2f}"),
        ("ratio", lambda r: "" if r["ratio"] == 1 else f"{r['ratio']:.2f}x"),
        ("MB of the client after the first structure, and after the last",
         "{client_mb_first:.0f}, {client_mb_last:.0f}"),
    )  # fmt: skip


@table("mutants")
def mutants(results: Path) -> str:
    """The score of the tests."""
    return of_rows(
        pd.read_csv(results / "mutants_score.csv"),
        ("folder", "`{folder}`"), ("noticed", "{noticed}"), ("excused", "{excused}"),
        ("not noticed", "{survived}"), ("share", "{share:.2f}"), ("interval", "{low:.2f} to {high:.2f}"),
        ("commit", "{commit}"),
    )  # fmt: skip


@table("fuzz")
def fuzz(results: Path) -> str:
    """What became of damaged files and odd options."""
    rows = pd.read_csv(results / "fuzz.csv")
    made_of = rows["kind"].str.extract("^(PDB|mmCIF|options)", expand=False)
    group = made_of.replace({"PDB": "PDB files", "mmCIF": "mmCIF files", "options": "sets of options"})
    sums = rows.groupby(group.fillna(rows["kind"]), sort=False)[["files", "taken", "refused", "faults"]].sum()
    sums.loc["all"] = sums.sum()
    return of_rows(
        sums.rename_axis("group").reset_index(),
        ("damaged", "{group}"), ("number", "{files}"), ("taken", "{taken}"),
        ("refused, in one line", "{refused}"), ("faults", "{faults}"),
    )  # fmt: skip


@table("kinds")
def kinds(results: Path) -> str:
    """What became of the kinds of file, by family."""
    rows = pd.read_csv(results / "kinds.csv", keep_default_na=False)
    shown = [_of_family(family, own) for family, own in rows.groupby("family", sort=False)]
    shown.append(_of_family("all", rows))
    heads = (
        "family", "kinds", "refused, in one line", "with atoms lost", "of them not said",
        "with names changed", "energies read again", "of them equal to 1e-6", "with faults",
    )  # fmt: skip
    return markdown(heads, shown)


def _of_family(family: str, rows: pd.DataFrame) -> tuple[object, ...]:
    apart = _differences(rows)
    return (
        family, len(rows), (rows["refusal"] != "").sum(), (rows["lost"] != "").sum(),
        (rows["lost_not_said"] > 0).sum(), (rows["names_changed"] != "").sum(), len(apart),
        (apart <= EQUAL).sum(), (rows["faults"] > 0).sum(),
    )  # fmt: skip


EQUAL = 1e-6


def _differences(rows: pd.DataFrame) -> pd.Series:
    """Energies read again against those written, relative, of both formats."""
    return pd.concat([pd.to_numeric(rows[f"difference_{name}"]) for name in ("pdb", "mmcif")]).dropna()


@table("kinds-words")
def kinds_words(results: Path) -> str:
    """What the kinds of file say in all."""
    rows = pd.read_csv(results / "kinds.csv", keep_default_na=False)
    made, taken = rows["origin"] == "made", rows["refusal"] == ""
    apart = _differences(rows)
    drift = pd.to_numeric(rows["metal_drift_angstrom"]).max()
    turned = (rows["hands_changed"] != "").sum()
    return paragraph(
        f"{made.sum()} kinds made by recipes and {(~made).sum()} real files: {taken.sum()} taken,",
        f"{(~taken).sum()} refused. Energies read again differ by at most {apart.max():.0e} of their size;",
        f"C-alphas change hand in {turned}; metals move by at most {drift:.2f} angstrom.",
    )
