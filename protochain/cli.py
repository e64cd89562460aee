"""Parse, call, print. Heavy imports wait until a command runs, so that --help answers at once."""

import json
import math
import signal
import sys
from collections import Counter
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.exceptions import TyperException

from protochain.errors import ProtochainError
from protochain.terminal import print_distribution, print_table, progress

if TYPE_CHECKING:
    from protochain.chain import Chain
    from protochain.energies import Energy
    from protochain.minimisers.solution import Watcher

CONVERGED, FAILED, BAD_INPUT, UNCONVERGED = 0, 1, 2, 3
"""Exit statuses: 1 when nothing usable was made, 3 when a usable result is not converged."""

_SHOWN_OVERLAPS = 5
"""Of all that are found before a run; ``info`` lists the rest."""

app = typer.Typer(
    help="Minimise the energy of protein chains, and compare how.",
    rich_markup_mode=None,
    add_completion=False,
    pretty_exceptions_enable=False,
)

Input = Annotated[Path, typer.Argument(metavar="IN", help="PDB or mmCIF file.")]
Forcefield = Annotated[
    str, typer.Option(help="amber14, amber19, amber99sb, amber99sbildn, charmm36, or an OpenMM XML file.")
]
Solvent = Annotated[str, typer.Option(help="vacuum, obc2 or gbn2.")]
Hinges = Annotated[str, typer.Option(help="Freedoms: any of phi psi omega chi rotors angles.")]
Engine = Annotated[str, typer.Option(help="auto, native or openmm.")]
Method = Annotated[
    str, typer.Option(help="hybrid, cartesian, lbfgs, newton, kcm, openmm ...: an unknown one lists them.")
]
Move = Annotated[
    str, typer.Option(help="What may move, as MDAnalysis selects: 'resid 5:20', 'not backbone'.")
]
Restrain = Annotated[
    str, typer.Option(help="Springs to the start, kJ/mol/nm^2, one strength after the other: '1000 100 0'.")
]
MaxRmsd = Annotated[
    float | None, typer.Option(help="C-alpha RMSD to the start that is not passed, angstrom.")
]
Tolerance = Annotated[
    float,
    typer.Option(
        help="At convergence: largest torque (kJ/mol/rad), or RMS force (kJ/mol/nm) where all atoms move."
    ),
]
MaxEvaluations = Annotated[int, typer.Option(help="Energy evaluations allowed for each method.")]
Seed = Annotated[int, typer.Option(help="Seed of random methods; recorded.")]
Threads = Annotated[int | None, typer.Option(help="Threads to compute on [default: all].")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output.")]
Force = Annotated[bool, typer.Option("--force", help="Allow an output to replace the input.")]
Trust = Annotated[bool, typer.Option("--trust-forcefield", help="Let a force-field file run its scripts.")]


@app.command()
def minimise(
    source: Input,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="PDB or mmCIF [default: NAME.METHOD.pdb].")
    ] = None,
    method: Method = "hybrid",
    solvent: Solvent = "obc2",
    forcefield: Forcefield = "amber14",
    hinges: Hinges = "phi psi chi",
    engine: Engine = "auto",
    tolerance: Tolerance = 1.0,
    max_evaluations: MaxEvaluations = 5000,
    move: Move = "all",
    restrain: Restrain = "",
    max_rmsd: MaxRmsd = None,
    starts: Annotated[
        int,
        typer.Option(help="Minimise this often, from dihedrals perturbed at random; the best is written."),
    ] = 1,
    spread: Annotated[float, typer.Option(help="Degrees by which starts differ, standard deviation.")] = 11.5,
    hop: Annotated[
        float | None, typer.Option(help="Start from the minimum before; kept as Metropolis at this K.")
    ] = None,
    checkpoint: Annotated[Path | None, typer.Option(help="Write what it takes to go on, .npz.")] = None,
    resume: Annotated[Path | None, typer.Option(help="Go on from a checkpoint.")] = None,
    trace: Annotated[Path | None, typer.Option(help="CSV with a row an iteration.")] = None,
    trajectory: Annotated[Path | None, typer.Option(help="DCD or XTC with a frame an iteration.")] = None,
    seed: Seed = 0,
    threads: Threads = None,
    as_json: AsJson = False,
    force: Force = False,
    trust_forcefield: Trust = False,
) -> None:
    """Minimise the energy of one structure."""
    from protochain.minimisers import explore
    from protochain.minimisers import minimise as run
    from protochain.minimisers.api import check_settings
    from protochain.minimisers.stages import read_hold
    from protochain.structure.trajectory import TrajectoryFile
    from protochain.structure.write import check_fits, check_format, write_atomically

    hold = read_hold(restrain, max_rmsd)
    check_settings(method, tolerance, max_evaluations, hold, bool(checkpoint or resume))
    if starts > 1 and (checkpoint or resume or trajectory):
        raise ProtochainError("starts: a checkpoint or trajectory is of one run; give one start")
    if starts == 1 and hop is not None:
        raise ProtochainError("hop: goes from minimum to minimum; give --starts 2 or more")
    suffix = ".cif" if source.suffix.lower() in (".cif", ".mmcif") else ".pdb"
    output = output or Path(f"{source.stem}.{method}{suffix}")
    check_format(output)
    _check_outputs(source, [path for path in (output, trace, trajectory, checkpoint) if path], force)
    chain, energy, preparation = _prepare(
        source, hinges, forcefield, solvent, engine, threads, trust_forcefield, move
    )
    check_fits(chain.structure, output)
    with ExitStack() as stack:
        show = stack.enter_context(progress(method, max_evaluations))
        frames = stack.enter_context(TrajectoryFile(trajectory)) if trajectory else None

        def watch(row: dict[str, float], x: Any) -> None:
            show(row, x)
            if frames:
                frames.append(x)

        settings: dict[str, Any] = {
            "tolerance": tolerance, "max_evaluations": max_evaluations, "restraint": hold.restraint,
            "max_rmsd": hold.max_rmsd, "watch": watch,
        }  # fmt: skip
        if starts == 1:
            solution = run(chain, energy, method, seed=seed, checkpoint=checkpoint, resume=resume, **settings)
            distribution: dict[str, Any] = {}
        else:
            found = explore(
                chain, energy, method, starts, seed=seed, spread=math.radians(spread), hop_temperature=hop,
                **settings,
            )  # fmt: skip
            solution, distribution = found.best, found.overall()
    if not solution.is_usable:
        raise SystemExit(_fail(f"{source}: {solution.message}"))
    solution.save(output)
    if trace:
        write_atomically(trace, lambda to: solution.trace.to_csv(to, index=False))
    record = {
        **solution.record(),
        **distribution,
        "input": str(source),
        "output": str(output),
        "seconds_preparation": preparation,
    }
    if as_json:
        print(json.dumps(record, allow_nan=False))
    else:
        print_table([record])
        if distribution:
            print_distribution(distribution["starts_summary"])
        print(f"written: {output}")
    raise typer.Exit(CONVERGED if solution.status == "converged" else UNCONVERGED)


@app.command()
def compare(
    source: Input,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Folder [default: NAME-comparison].")
    ] = None,
    methods: Annotated[str, typer.Option(help="Methods, with commas between.")] = "kcm,lbfgs,hybrid,openmm",
    solvent: Solvent = "obc2",
    forcefield: Forcefield = "amber14",
    hinges: Hinges = "phi psi chi",
    engine: Engine = "auto",
    tolerance: Tolerance = 1.0,
    max_evaluations: MaxEvaluations = 5000,
    seed: Seed = 0,
    threads: Threads = None,
    as_json: AsJson = False,
    trust_forcefield: Trust = False,
) -> None:
    """Minimise one structure by several methods; write tables, plots, structures and report.html."""
    from protochain.analysis import compare as run
    from protochain.minimisers.api import check_settings
    from protochain.structure.write import check_writable

    chosen = tuple(dict.fromkeys(name.strip() for name in methods.split(",")))
    for method in chosen:
        check_settings(method, tolerance, max_evaluations)
    output = output or Path(f"{source.stem}-comparison")
    # A name with the method's added cannot be the input's own.
    check_writable(output / "report.html")
    chain, energy, preparation = _prepare(
        source, hinges, forcefield, solvent, engine, threads, trust_forcefield
    )
    with ExitStack() as shown:

        def watch(method: str) -> "Watcher":
            shown.close()
            return shown.enter_context(progress(method, max_evaluations))

        comparison = run(chain, chosen, energy, tolerance, max_evaluations, seed, watch=watch)
    comparison = replace(comparison, origin={"input": str(source), "seconds_preparation": preparation})
    page = comparison.report(output)
    summary = comparison.summary()
    missing = chosen[len(comparison.solutions) :]
    if missing:
        print(f"protochain: interrupted: {', '.join(missing)} left out", file=sys.stderr)
    if as_json:
        print(json.dumps(summary | {"output": str(output)}, allow_nan=False))
    else:
        print_table(summary["results"])
        print(f"written: {page} and the tables, plots and structures beside it")
    if not any(solution.is_usable for solution in comparison.solutions):
        raise SystemExit(_fail(f"{source}: no method made anything usable; the page says why"))
    converged = all(solution.status == "converged" for solution in comparison.solutions)
    raise typer.Exit(CONVERGED if converged else UNCONVERGED)


@app.command()
def info(
    source: Input,
    hinges: Hinges = "phi psi chi",
    solvent: Solvent = "obc2",
    forcefield: Forcefield = "amber14",
    as_json: AsJson = False,
    trust_forcefield: Trust = False,
) -> None:
    """Show what a file holds, what was changed to prepare it, and how it is cut into bodies."""
    began = perf_counter()
    from protochain.articulate import build_chain
    from protochain.chain import rigid_groups
    from protochain.energies import energy as build_energy
    from protochain.minimisers.contacts import overlaps
    from protochain.structure import load

    imported = perf_counter()
    structure = load(source)
    loaded = perf_counter()
    chain = build_chain(structure, hinges)
    built = perf_counter()
    whole = build_energy(structure, forcefield, solvent, trust_forcefield=trust_forcefield)
    energy = whole.without_constants(rigid_groups(chain), structure.positions)
    facts: dict[str, Any] = {
        "input": str(source),
        "n_chains": structure.n_chains,
        "n_residues": structure.n_residues,
        "n_atoms": structure.n_atoms,
        "n_bodies": chain.n_bodies,
        "n_hinges": chain.n_hinges,
        "n_q": chain.n_q,
        "n_v": chain.n_v,
        "hinges": dict(Counter(hinge.kind for hinge in chain.hinges)),
        "loops": [f"{structure.describe(a)} - {structure.describe(b)}" for a, b in chain.loops.tolist()],
        "left_out": dict(structure.left_out),
        "repairs": list(structure.repairs),
        "overlaps": [f"{each}; {each.remedy}" for each in overlaps(structure, structure.positions, chain)],
        "engine": energy.engine,
        "engine_reason": energy.reason,
        "constant_terms": dict(energy.left_out),
        "seconds_import": imported - began,
        "seconds_preparation": loaded - imported,
        "seconds_chain": built - loaded,
        "seconds_energy": perf_counter() - built,
    }
    if as_json:
        print(json.dumps(facts))
        return
    for key, value in facts.items():
        if isinstance(value, list):
            print(f"{key}: {len(value)}")
            for line in value:
                print(f"  {line}")
        elif isinstance(value, dict):
            print(f"{key}: {', '.join(f'{count} {name}' for name, count in value.items()) or 'nothing'}")
        else:
            print(f"{key}: {value:.2f}" if isinstance(value, float) else f"{key}: {value}")


@app.command()
def build(
    sequence: Annotated[
        str, typer.Argument(metavar="SEQUENCE", help="One-letter codes of the 20 amino acids.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="PDB or mmCIF file.")],
) -> None:
    """Build an extended all-atom chain from a sequence."""
    from protochain.structure import from_sequence, save
    from protochain.structure.write import check_format, check_writable

    check_format(output)
    check_writable(output)
    structure = from_sequence(sequence)
    save(structure, output)
    print(f"written: {output} ({structure.n_residues} residues, {structure.n_atoms} atoms)")


app.command("minimize", hidden=True)(minimise)


def main() -> None:
    """Run the command line: one line on standard error and status 2 for bad input or usage."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if len(sys.argv) == 1:
        sys.argv.append("--help")
    try:
        status = app(standalone_mode=False)
    except ProtochainError as error:
        status = _fail(str(error), BAD_INPUT)
    except TyperException as error:
        status = _fail(f"{error.format_message()} See protochain --help.", BAD_INPUT)
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        status = _fail(f"{where}{error.strerror or error}")
    except KeyboardInterrupt:
        status = _fail("interrupted before there was a result")
    sys.exit(status if isinstance(status, int) else 0)


def _fail(message: str, status: int = FAILED) -> int:
    print(f"protochain: {' '.join(message.split())}", file=sys.stderr)
    return status


def _prepare(
    source: Path,
    hinges: str,
    forcefield: str,
    solvent: str,
    engine: str,
    threads: int | None,
    trust: bool,
    move: str = "all",
) -> tuple["Chain", "Energy", float]:
    """Load a file, build chain and energy; say on standard error what was changed and what overlaps."""
    from protochain.articulate import build_chain
    from protochain.energies import energy as build_energy
    from protochain.minimisers.contacts import overlaps
    from protochain.structure import load

    began = perf_counter()
    structure = load(source)
    chain = build_chain(structure, hinges, move=move)
    energy = build_energy(structure, forcefield, solvent, engine, threads=threads, trust_forcefield=trust)
    for line in structure.repairs:
        print(f"{source}: {line}", file=sys.stderr)
    found = overlaps(structure, structure.positions, chain)
    for overlap in found[:_SHOWN_OVERLAPS]:
        print(f"{source}: {overlap}; {overlap.remedy}", file=sys.stderr)
    if len(found) > _SHOWN_OVERLAPS:
        print(f"{source}: and {len(found) - _SHOWN_OVERLAPS} more overlaps", file=sys.stderr)
    return chain, energy, perf_counter() - began


def _check_outputs(source: Path, outputs: list[Path], force: bool) -> None:
    """Refuse, before any work, outputs that would replace the input or one another or cannot be written."""
    from protochain.structure.write import check_writable

    for output, count in Counter(path.absolute() for path in outputs).items():
        if count > 1:
            raise ProtochainError(f"{output}: named for two outputs; give each its own")
    for output in outputs:
        if output.exists() and source.exists() and output.samefile(source) and not force:
            raise ProtochainError(f"{output}: is the input; give another name, or --force to replace it")
        check_writable(output)
