"""``protochain info`` and ``protochain build``."""

import sys
from collections import Counter
from importlib import import_module
from pathlib import Path
from time import perf_counter
from typing import Annotated, TypedDict

import typer

from protochain.cli.options import STANDARD_OUTPUT, AsJson, Input, as_option, print_json, with_settings
from protochain.core.markup import counted
from protochain.setup import Setup


class Facts(TypedDict):
    """What ``protochain info`` tells."""

    input: str
    n_chains: int
    n_residues: int
    n_atoms: int
    n_bodies: int
    n_hinges: int
    n_q: int
    n_v: int
    hinges: dict[str, int]
    loops: list[str]
    left_out: dict[str, int]
    lost_atoms: list[str]
    repairs: list[str]
    overlaps: list[str]
    engine: str
    engine_reason: str
    threads: int | None
    constant_terms: dict[str, int]
    seconds_import: float
    seconds_preparation: float
    seconds_chain: float
    seconds_energy: float


@with_settings(setup="engine move rigid_protein")
def info(source: Input, as_json: AsJson = False, *, setup: Setup) -> None:
    """Show the contents of a file, the repairs to its structure, and its rigid bodies and hinges."""
    began = perf_counter()
    for name in ("articulate", "energies"):
        # Loaded here, so that the other times are those of the work alone.
        import_module(f"protochain.{name}")
    from protochain.contacts import overlaps
    from protochain.structure.losses import lost_atoms

    imported = perf_counter()
    structure = setup.load(source)
    loaded = perf_counter()
    chain = setup.chain(structure)
    built = perf_counter()
    energy = setup.energy(structure).without_constants(chain.rigid_groups, structure.positions)
    facts: Facts = {
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
        "lost_atoms": lost_atoms(structure.losses),
        "repairs": [each.told(str if as_json else as_option) for each in structure.repairs],
        "overlaps": [f"{each}; {each.remedy}" for each in overlaps(structure, structure.positions, chain)],
        "engine": energy.engine,
        "engine_reason": energy.reason,
        "threads": energy.threads,
        "constant_terms": dict(energy.left_out),
        "seconds_import": imported - began,
        "seconds_preparation": loaded - imported,
        "seconds_chain": built - loaded,
        "seconds_energy": perf_counter() - built,
    }
    if as_json:
        print_json(facts)
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


def build(
    sequence: Annotated[
        str, typer.Argument(metavar="SEQUENCE", help="One-letter codes of the 20 amino acids.")
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", help="PDB or mmCIF file; - is standard output, in PDB format.")
    ],
) -> None:
    """Build an extended all-atom chain from a sequence."""
    from protochain.core.storage import check_writable
    from protochain.structure import from_sequence, save
    from protochain.structure.write import as_text, check_format, common_suffix

    printed = str(output) == STANDARD_OUTPUT
    if not printed:
        check_format(output)
        check_writable(output)
    structure = from_sequence(sequence)
    if printed:
        sys.stdout.write(as_text(structure, common_suffix([structure])))
    else:
        save(structure, output)
    size = f"{counted(structure.n_residues, 'residue')}, {counted(structure.n_atoms, 'atom')}"
    where = "standard output" if printed else output
    print(f"written: {where} ({size})", file=sys.stderr if printed else sys.stdout)
