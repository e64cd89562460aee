"""Options that commands share, and what each does with a file before its work."""

import re
import sys
from collections import Counter
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from protochain.errors import ProtochainError

if TYPE_CHECKING:
    from protochain.chain import Chain
    from protochain.energies import Energy

CONVERGED, FAILED, BAD_INPUT, UNCONVERGED = 0, 1, 2, 3
"""Exit statuses: 1 when nothing usable was made, 3 when a usable result is not converged."""

_SHOWN_OVERLAPS = 5
"""Of all that are found before a run; ``info`` lists the rest."""

Input = Annotated[
    Path, typer.Argument(metavar="IN", help="PDB or mmCIF file, gzipped or not; - is standard input.")
]
Model = Annotated[str, typer.Option(help="Number of the model to take [default: the first].")]
Altloc = Annotated[str, typer.Option(help="Alternate location to prefer [default: of highest occupancy].")]
Keep = Annotated[
    str, typer.Option(help="Kept where it is: water, ions, nucleic, all, or names, with commas between.")
]
Disulfide = Annotated[
    list[str] | None,
    typer.Option(
        metavar="A:3-A:40", help="A disulfide bond, one an option [default: where sulphurs are near]."
    ),
]
NoDisulfide = Annotated[bool, typer.Option("--no-disulfide", help="No disulfide bonds.")]
PH = Annotated[float, typer.Option("--ph", help="Of protonation, where the file does not show it.")]
Strict = Annotated[bool, typer.Option("--strict", help="Refuse chain breaks and incomplete backbones.")]
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


def fail(message: str, status: int = FAILED) -> int:
    """Say on standard error what went wrong, in one line, and return the exit status."""
    print(f"protochain: {' '.join(message.split())}", file=sys.stderr)
    return status


def reading(
    model: str,
    altloc: str,
    keep: str,
    disulfide: list[str] | None,
    no_disulfide: bool,
    ph: float,
    strict: bool,
) -> dict[str, Any]:
    """Say in the words of :func:`protochain.load` what is to be taken of a file."""
    if model and not model.lstrip("-").isdigit():
        raise ProtochainError(f"model {model!r}: give its number")
    if disulfide and no_disulfide:
        raise ProtochainError("disulfide: asked for and refused at once; give one of the two options")
    pairs = None if not (disulfide or no_disulfide) else [_pair(given) for given in disulfide or []]
    return {
        "model": int(model) if model else None,
        "altloc": altloc,
        "keep": tuple(word.strip() for word in keep.split(",") if word.strip()),
        "disulfide": pairs,
        "ph": ph,
        "strict": strict,
    }


def _pair(given: str) -> tuple[str, str]:
    """Read ``A:3-A:40``, where numbers may be negative."""
    found = re.fullmatch(r"(\S*:-?\d+\w?)-(\S*:-?\d+\w?)", given)
    if not found:
        raise ProtochainError(f"disulfide {given!r}: give chain:number-chain:number, as A:3-A:40")
    return found[1], found[2]


def named_after(source: Path) -> tuple[str, str]:
    """Name and suffix for outputs named after an input."""
    inner = Path(source.stem) if source.suffix.lower() == ".gz" else source
    suffix = ".cif" if inner.suffix.lower() in (".cif", ".mmcif") else ".pdb"
    return ("stdin" if str(source) == "-" else inner.stem), suffix


def prepare(
    source: Path,
    taken: dict[str, Any],
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
    from protochain.contacts import overlaps
    from protochain.energies import energy as build_energy
    from protochain.structure import load

    began = perf_counter()
    structure = load(source, forcefield=forcefield, **taken)
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


def check_outputs(source: Path, outputs: list[Path], force: bool) -> None:
    """Refuse, before any work, outputs that would replace the input or one another or cannot be written."""
    from protochain.storage import check_writable

    for output, count in Counter(path.absolute() for path in outputs).items():
        if count > 1:
            raise ProtochainError(f"{output}: named for two outputs; give each its own")
    for output in outputs:
        if output.exists() and source.exists() and output.samefile(source) and not force:
            raise ProtochainError(f"{output}: is the input; give another name, or --force to replace it")
        check_writable(output)
