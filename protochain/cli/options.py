"""Options that commands share, and how each command prepares its input."""

import inspect
import math
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from protochain import defaults
from protochain.checks import NO_BONDS
from protochain.errors import Angle, Argument, ProtochainError
from protochain.markup import counted
from protochain.setup import Setup

if TYPE_CHECKING:
    from protochain.chain import Chain
    from protochain.energies import Energy
    from protochain.structure import Structure

CONVERGED, FAILED, BAD_INPUT, UNCONVERGED = 0, 1, 2, 3
"""Exit statuses: 1 when nothing usable was made, 3 when a usable result is not converged."""

STANDARD_OUTPUT = "-"
"""Name of an output that is printed instead of written to a file."""

_SHOWN_OVERLAPS = 5
"""Overlaps reported before a run; ``info`` lists all."""

Input = Annotated[
    Path, typer.Argument(metavar="IN", help="PDB or mmCIF file, packed or not; - is standard input.")
]
MaxRmsd = Annotated[float | None, typer.Option(help="Largest C-alpha RMSD to the start, angstrom.")]
OwnTolerance = Annotated[
    float | None,
    typer.Option(
        "--tolerance",
        help="RMS force at convergence where all atoms move [default: 10 kJ/mol/nm, 1 with --starts], "
        "or largest torque [default: 1 kJ/mol/rad].",
    ),
]
Tolerance = Annotated[
    float,
    typer.Option(
        help="Largest torque (kJ/mol/rad) at convergence, or RMS force (kJ/mol/nm) where all atoms move."
    ),
]
MaxEvaluations = Annotated[int, typer.Option(help="Energy evaluations allowed for each method.")]
Restrain = Annotated[
    str, typer.Option(help="Restraints to the start, kJ/mol/nm^2, one after the other: '1000 100 0'.")
]
Starts = Annotated[
    int, typer.Option(help="Number of starts, from dihedrals perturbed at random; the best end is written.")
]
_DEGREES = f"{math.degrees(defaults.SPREAD):.1f}"
Spread = Annotated[
    float | None, typer.Option(help=f"Standard deviation of a perturbation, degrees [default: {_DEGREES}].")
]
Hop = Annotated[
    float | None, typer.Option(help="Basin hopping: start from the last minimum accepted at this K.")
]
NoCurvature = Annotated[
    bool,
    typer.Option("--no-curvature", help="Do not look whether a run in torsions ends at a saddle point."),
]
Seed = Annotated[int, typer.Option(help="Seed of methods that draw random numbers.")]
Manifest = Annotated[Path | None, typer.Option(help="CSV with a column path, and any settings as columns.")]
Scheduler = Annotated[str | None, typer.Option(help="Address of a Dask cluster to use instead.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output.")]


def _option(kind: Any, text: str, *names: str, **more: Any) -> Any:
    return Annotated[kind, typer.Option(*names, help=text, **more)]


_SETUP = {
    "hinges": _option(str, "Degrees of freedom: any of phi psi omega chi rotors angles."),
    "move": _option(
        str, "What may move, in MDAnalysis's selection language, with sidechain and interface: 'resid 5:20'."
    ),
    "forcefield": _option(
        str, "amber14, amber19, amber99sb, amber99sbildn, charmm36, an OpenMM XML file, or several (a,b)."
    ),
    "solvent": _option(str, "vacuum, obc2 or gbn2."),
    "engine": _option(str, "auto, native or openmm."),
    "cutoff": _option(str, "Distance in nm up to which pairs act, none, or auto: none below 20,000 atoms."),
    "threads": _option(int | None, "Threads to compute on [default: all]."),
    "trust_forcefield": _option(bool, "Allow a force-field file to run its scripts.", "--trust-forcefield"),
    "model": _option(
        str, "Number of the model [default: the first]; minimise, relax, batch and validate also take all, "
        "or 1-5,8.",
    ),
    "chains": _option(
        str, "Chains to take, with commas between [default: all].", "--chain", "--chains", metavar="A,B"
    ),
    "altloc": _option(str, "Alternate location to prefer [default: of highest occupancy]."),
    "keep": _option(
        str, "Molecules to keep in place, with commas: near (all but waters within 5 angstrom of it), "
        "none, all, water, ions, nucleic, ligands, or names of residues [default: near].",
    ),
    "disulfide": _option(
        list[str] | None, "Disulfide bond beside those where sulphurs are near; repeat for more.",
        metavar="A:3-A:40",
    ),
    "no_disulfide": _option(
        bool, "No disulfide bonds but those of --disulfide.", "--no-disulfide"
    ),
    "ph": _option(float, "pH for residues whose protonation the file does not show.", "--ph"),
    "strict": _option(bool, "Refuse chain breaks and incomplete backbones.", "--strict"),
}  # fmt: skip
"""Options of a :class:`Setup`, in the order of the help."""

_DEFAULTS: dict[str, Any] = vars(Setup()) | {"keep": None, "chains": None, "no_disulfide": False}


def with_setup(without: str = "") -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Replace a command's last parameter, ``setup``, by the options of a :class:`Setup`.

    Options named in ``without``, and those that the command has itself, are left out.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        *own, _ = inspect.signature(command).parameters.values()
        taken = {*without.split(), *(parameter.name for parameter in own)}
        options = [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=_DEFAULTS[name], annotation=kind)
            for name, kind in _SETUP.items()
            if name not in taken
        ]

        @wraps(command)
        def run(**given: Any) -> None:
            chosen = {option.name: given.pop(option.name) for option in options}
            command(**given, setup=_setup(**chosen))

        run.__signature__ = inspect.Signature([*own, *options])  # type: ignore[attr-defined]  # known at run time only
        return run

    return decorate


def _setup(no_disulfide: bool = False, **chosen: Any) -> Setup:
    """Make a setup of options; those that are not given keep its defaults."""
    chosen = {name: value for name, value in chosen.items() if value not in (None, [])}
    if no_disulfide:
        chosen["disulfide"] = [NO_BONDS, *chosen.get("disulfide", [])]
    return Setup(**chosen)


def fail(message: str, status: int = FAILED) -> int:
    """Report an error on standard error in one line, and return the exit status."""
    print(f"protochain: {' '.join(message.split())}", file=sys.stderr)
    return status


def named_after(source: Path) -> tuple[str, str]:
    """Return stem and suffix for outputs named after an input."""
    from protochain.structure.files import format_of, split_name

    suffix = ".cif" if format_of(source) == "mmCIF" else ".pdb"
    return ("stdin" if str(source) == "-" else split_name(source)[0]), suffix


def prepare(source: Path, setup: Setup) -> tuple["Chain", "Energy", float]:
    """Prepare a file; report changes and overlaps on standard error. Return also the seconds taken."""
    from protochain.contacts import overlaps

    began = perf_counter()
    structure, chain, energy = setup.prepare(source)
    print_changes(source, structure)
    for line in said_of_move(structure, setup.move, chain):
        print(f"{source}: {line}", file=sys.stderr)
    found = overlaps(structure, structure.positions, chain)
    for overlap in found[:_SHOWN_OVERLAPS]:
        print(f"{source}: {overlap}; {overlap.remedy}", file=sys.stderr)
    if len(found) > _SHOWN_OVERLAPS:
        print(f"{source}: and {counted(len(found) - _SHOWN_OVERLAPS, 'more overlap')}", file=sys.stderr)
    return chain, energy, perf_counter() - began


def said_of_move(structure: "Structure", move: str, chain: "Chain | None" = None) -> list[str]:
    """Say what a selection moves: atoms and residues, and the hinges of a chain; nothing of all."""
    from protochain.articulate import turned_atoms
    from protochain.structure.select import moving

    if move == defaults.MOVE:
        return []
    free = moving(structure, move)
    rest = f"the other {_counted(structure, ~free)} are fixed"
    if chain is None:
        return [f"{_counted(structure, free)} move, {rest}"]
    hinges = counted(chain.n_hinges, "hinge turns", "hinges turn")
    turned = f"{hinges}, which moves {_counted(structure, turned_atoms(chain))}"
    return [f"{turned}; where all atoms move, {_counted(structure, free)} do, and {rest}"]


def _counted(structure: "Structure", atoms: Any) -> str:
    residues = len({*structure.atom_residue[atoms].tolist()})
    return f"{counted(int(atoms.sum()), 'atom')} of {counted(residues, 'residue')}"


def print_changes(source: Path, structure: "Structure") -> None:
    """Say on standard error what was changed to prepare a file, losses first."""
    from protochain.structure.repairs import summarised

    changes = summarised(structure.repairs, as_option)
    for line in changes:
        print(f"{source}: {line}", file=sys.stderr)
    if len(changes) < len(structure.repairs):
        print(f"{source}: protochain info lists all {len(structure.repairs)} changes", file=sys.stderr)


def print_lost(rows: "Iterable[Mapping[Any, Any]]") -> None:
    """Print what the structures of records, or of rows of a table, lost."""
    from protochain.structure.losses import told

    for line in told(rows, as_option):
        print(line)


RENAMED = {
    "n_steps": "steps", "n_starts": "starts", "hop_temperature": "hop", "restraint": "restrain",
    "hinge_springs": "hinge_spring",
}  # fmt: skip
"""Options with other names than the arguments of the library."""


def as_option(part: Argument | Angle) -> str:
    """Part of a message in the words of the command line: an argument is an option, angles are in degrees."""
    if isinstance(part, Angle):
        return f"{math.degrees(part.radians):g} degrees"
    option = f"--{RENAMED.get(part.name, part.name).replace('_', '-')}"
    return option if part.value in (None, True) else f"{option} {part.value}"


def inputs_of(setup: Setup, *given: str | Path | None) -> list[Path]:
    """All files that a command reads: those given, and the user's among those of the force field."""
    from protochain.structure.prepare import user_files

    return [*(Path(each) for each in given if each is not None), *user_files(setup.forcefield)]


def check_outputs(inputs: Sequence[Path], outputs: Sequence[Path], force: bool | None = None) -> None:
    """Refuse, before any work, outputs that would replace an input or one another or cannot be written.

    Parameters
    ----------
    inputs : sequence of Path
        All files that the command reads, as of :func:`inputs_of`.
    outputs : sequence of Path
        All that it may write; of a folder, the files that it may write there.
    force : bool, optional
        Whether ``--force`` was given; None for a command that has no such option.
    """
    from protochain.storage import check_writable

    outputs = [path for path in outputs if str(path) != STANDARD_OUTPUT]
    for output, count in Counter(path.absolute() for path in outputs).items():
        if count > 1:
            raise ProtochainError(f"{output}: is given for two outputs; give each its own")
    for output in outputs:
        same = output.exists() and any(each.exists() and output.samefile(each) for each in inputs)
        if same and not force:
            instead = "" if force is None else ", or --force to replace it"
            raise ProtochainError(f"{output}: is the input; give another name{instead}")
        check_writable(output)
