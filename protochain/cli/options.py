"""Options that commands share, and how each command prepares its input."""

import inspect
import sys
from collections import Counter
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from protochain.errors import ProtochainError
from protochain.setup import Setup

if TYPE_CHECKING:
    from protochain.chain import Chain
    from protochain.energies import Energy

CONVERGED, FAILED, BAD_INPUT, UNCONVERGED = 0, 1, 2, 3
"""Exit statuses: 1 when nothing usable was made, 3 when a usable result is not converged."""

_SHOWN_OVERLAPS = 5
"""Overlaps reported before a run; ``info`` lists all."""

Input = Annotated[
    Path, typer.Argument(metavar="IN", help="PDB or mmCIF file, gzipped or not; - is standard input.")
]
MaxRmsd = Annotated[float | None, typer.Option(help="Largest C-alpha RMSD to the start, angstrom.")]
Tolerance = Annotated[
    float,
    typer.Option(
        help="Largest torque (kJ/mol/rad) at convergence, or RMS force (kJ/mol/nm) where all atoms move."
    ),
]
MaxEvaluations = Annotated[int, typer.Option(help="Energy evaluations allowed for each method.")]
Seed = Annotated[int, typer.Option(help="Seed of methods that draw random numbers.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output.")]


def _option(kind: Any, text: str, *names: str, **more: Any) -> Any:
    return Annotated[kind, typer.Option(*names, help=text, **more)]


_SETUP = {
    "hinges": _option(str, "Degrees of freedom: any of phi psi omega chi rotors angles."),
    "move": _option(str, "What may move, in MDAnalysis's selection language: 'resid 5:20', 'not backbone'."),
    "forcefield": _option(
        str, "amber14, amber19, amber99sb, amber99sbildn, charmm36, or an OpenMM XML file."
    ),
    "solvent": _option(str, "vacuum, obc2 or gbn2."),
    "engine": _option(str, "auto, native or openmm."),
    "threads": _option(int | None, "Threads to compute on [default: all]."),
    "trust_forcefield": _option(bool, "Allow a force-field file to run its scripts.", "--trust-forcefield"),
    "model": _option(str, "Number of the model [default: the first]; minimise and batch also take all."),
    "altloc": _option(str, "Alternate location to prefer [default: of highest occupancy]."),
    "keep": _option(
        str, "Molecules to keep in place, with commas: near (all but waters within 5 angstrom of it), "
        "none, all, water, ions, nucleic, ligands, or names of residues [default: near].",
    ),
    "disulfide": _option(
        list[str] | None, "Disulfide bond; repeat for more [default: where sulphurs are near each other].",
        metavar="A:3-A:40",
    ),
    "no_disulfide": _option(bool, "No disulfide bonds.", "--no-disulfide"),
    "ph": _option(float, "pH for residues whose protonation the file does not show.", "--ph"),
    "strict": _option(bool, "Refuse chain breaks and incomplete backbones.", "--strict"),
}  # fmt: skip
"""Options of a :class:`Setup`, in the order of the help."""

_DEFAULTS: dict[str, Any] = vars(Setup()) | {"keep": None, "no_disulfide": False}


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

        run.__signature__ = inspect.Signature([*own, *options])  # type: ignore[attr-defined]
        return run

    return decorate


def _setup(no_disulfide: bool = False, **chosen: Any) -> Setup:
    """Make a setup of options; those that are not given keep its defaults."""
    chosen = {name: value for name, value in chosen.items() if value not in (None, [])}
    if no_disulfide and "disulfide" in chosen:
        raise ProtochainError(
            "disulfide: --disulfide and --no-disulfide exclude each other; give one of them"
        )
    return Setup(**chosen | ({"disulfide": ()} if no_disulfide else {}))


def fail(message: str, status: int = FAILED) -> int:
    """Report an error on standard error in one line, and return the exit status."""
    print(f"protochain: {' '.join(message.split())}", file=sys.stderr)
    return status


def named_after(source: Path) -> tuple[str, str]:
    """Return stem and suffix for outputs named after an input."""
    from protochain.structure.files import SUFFIXES

    inner = Path(source.stem) if source.suffix.lower() == ".gz" else source
    suffix = ".cif" if SUFFIXES.get(inner.suffix.lower()) == "mmCIF" else ".pdb"
    return ("stdin" if str(source) == "-" else inner.stem), suffix


def prepare(source: Path, setup: Setup) -> tuple["Chain", "Energy", float]:
    """Prepare a file; report repairs and overlaps on standard error. Return also the seconds taken."""
    from protochain.contacts import overlaps

    began = perf_counter()
    structure, chain, energy = setup.prepare(source)
    for line in structure.repairs:
        print(f"{source}: {line}", file=sys.stderr)
    found = overlaps(structure, structure.positions, chain)
    for overlap in found[:_SHOWN_OVERLAPS]:
        print(f"{source}: {overlap}; {overlap.remedy}", file=sys.stderr)
    if len(found) > _SHOWN_OVERLAPS:
        print(f"{source}: and {len(found) - _SHOWN_OVERLAPS} more overlaps", file=sys.stderr)
    return chain, energy, perf_counter() - began


def check_outputs(source: Path, outputs: list[Path], force: bool) -> None:
    """Refuse, before any work, outputs that would replace the input or one another or cannot be written."""
    from protochain.storage import check_writable

    for output, count in Counter(path.absolute() for path in outputs).items():
        if count > 1:
            raise ProtochainError(f"{output}: is given for two outputs; give each its own")
    for output in outputs:
        if output.exists() and source.exists() and output.samefile(source) and not force:
            raise ProtochainError(f"{output}: is the input; give another name, or --force to replace it")
        check_writable(output)
