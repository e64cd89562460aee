"""``protochain info`` and ``protochain build``."""

import json
from collections import Counter
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import typer

from protochain.cli.options import (
    PH,
    Altloc,
    AsJson,
    Disulfide,
    Forcefield,
    Hinges,
    Input,
    Keep,
    Model,
    NoDisulfide,
    Solvent,
    Strict,
    Trust,
    reading,
)


def info(
    source: Input,
    hinges: Hinges = "phi psi chi",
    solvent: Solvent = "obc2",
    forcefield: Forcefield = "amber14",
    as_json: AsJson = False,
    model: Model = "",
    altloc: Altloc = "",
    keep: Keep = "",
    disulfide: Disulfide = None,
    no_disulfide: NoDisulfide = False,
    ph: PH = 7.0,
    strict: Strict = False,
    trust_forcefield: Trust = False,
) -> None:
    """Show what a file holds, what was changed to prepare it, and how it is cut into bodies."""
    taken = reading(model, altloc, keep, disulfide, no_disulfide, ph, strict)
    began = perf_counter()
    from protochain.articulate import build_chain
    from protochain.contacts import overlaps
    from protochain.energies import energy as build_energy
    from protochain.structure import load

    imported = perf_counter()
    structure = load(source, forcefield=forcefield, **taken)
    loaded = perf_counter()
    chain = build_chain(structure, hinges)
    built = perf_counter()
    whole = build_energy(structure, forcefield, solvent, trust_forcefield=trust_forcefield)
    energy = whole.without_constants(chain.rigid_groups, structure.positions)
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


def build(
    sequence: Annotated[
        str, typer.Argument(metavar="SEQUENCE", help="One-letter codes of the 20 amino acids.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="PDB or mmCIF file.")],
) -> None:
    """Build an extended all-atom chain from a sequence."""
    from protochain.storage import check_writable
    from protochain.structure import from_sequence, save
    from protochain.structure.write import check_format

    check_format(output)
    check_writable(output)
    structure = from_sequence(sequence)
    save(structure, output)
    print(f"written: {output} ({structure.n_residues} residues, {structure.n_atoms} atoms)")
