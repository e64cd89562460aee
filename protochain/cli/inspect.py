"""``protochain info`` and ``protochain build``."""

from collections import Counter
from importlib import import_module
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import typer

from protochain.chains.setup import Setup
from protochain.cli import options
from protochain.cli.lines import is_verbose, with_detail
from protochain.core.checks import designs, force_field_parts
from protochain.core.errors import ProtochainError
from protochain.core.markup import plural


@with_detail
@options.with_settings(
    setup="engine device move rigid_protein terms calculator solvent salt cutoff accuracy threads"
)
def info(
    source: options.Input,
    energy: Annotated[
        bool, typer.Option("--energy", help="Build the default energy, too, and report its engine.")
    ] = False,
    device: Annotated[
        bool, typer.Option("--device", help="List the GPUs, and the device for the energy.")
    ] = False,
    as_json: options.AsJson = False,
    *,
    setup: Setup,
) -> None:
    """Show the contents of a file, and repairs to its structure."""
    began = perf_counter()
    # Imported here, so that the other times do not include it.
    import_module("protochain.chains.articulate")
    from protochain.chains.contacts import overlaps
    from protochain.energies.factory import checked_files
    from protochain.structure.molecule.repairs import Kind, lost_atoms
    from protochain.validation.violations import violations

    checked_files(force_field_parts(setup.forcefield), setup.trust_forcefield)
    imported = perf_counter()
    structure = setup.load(source)
    loaded = perf_counter()
    chain = setup.chain(structure)
    built = perf_counter()
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
        "lost_atoms": lost_atoms(structure.losses),
        "repairs": [item.sentence(str if as_json else options.as_option) for item in structure.repairs],
        "violations": violations(structure).lines(structure),
        "overlaps": [f"{item}; {item.remedy}" for item in overlaps(structure, structure.positions, chain)],
        "seconds_import": imported - began,
        "seconds_preparation": loaded - imported,
        "seconds_chain": built - loaded,
    }
    gaps = [repair.facts for repair in structure.repairs if repair.kind is Kind.GAP]
    if breaks := [gap for gap in gaps if gap["goes_on"]]:
        facts["breaks"] = [
            f"{gap['last'].place}-{gap['first'].number} ({gap['length']:.1f} angstrom)" for gap in breaks
        ]
    if energy:
        began = perf_counter()
        used = setup.energy(structure).without_constants(chain.rigid_groups, structure.positions)
        facts |= {
            "engine": used.engine, "engine_reason": used.reason, "threads": used.threads,
            "constant_terms": dict(used.left_out), "seconds_energy": perf_counter() - began,
        }  # fmt: skip
    if device:
        from protochain.energies.on_device import choose_device, devices

        facts |= {"device": choose_device(setup.device, structure.n_atoms), "devices": devices()}
    if as_json:
        options.print_json(facts)
        return
    for name, value in facts.items():
        if name in _DETAILS and not is_verbose():
            continue
        key = _NAMES.get(name, name.removeprefix("n_").replace("_", " "))
        if isinstance(value, list):
            print(f"{key}: {len(value)}")
            for line in value:
                print(f"  {line}")
        elif isinstance(value, dict):
            print(f"{key}: {', '.join(f'{count} {name}' for name, count in value.items()) or 'nothing'}")
        else:
            print(f"{key}: {value:.2f}" if isinstance(value, float) else f"{key}: {value}")


_NAMES = {"loops": "ring closures", "hinges": "kinds of hinges", "breaks": "breaks that --cap breaks caps"}
_DETAILS = {"n_bodies", "n_q", "n_v", "seconds_import", "seconds_preparation", "seconds_chain"}
"""Facts that only ``--verbose`` and ``--json`` print."""


def build(
    sequence: Annotated[
        str,
        typer.Argument(metavar="SEQUENCE", help="One-letter codes of the 20 amino acids, or a FASTA file."),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", help="PDB or mmCIF file, or folder for several records. - is standard output."
        ),
    ],
    as_json: options.AsJson = False,
) -> None:
    """Build an extended all-atom chain from a sequence, or from each record of a FASTA file."""
    from protochain.structure import from_sequence

    records = designs(sequence, of_backbone=False)
    if len(records) > 1:
        return _build_records(sequence, records, output, as_json)
    sequence = records[0][1] if records else sequence
    options.check_names(output, None, None, as_json)
    options.check_outputs([], [output])
    structure = from_sequence(sequence)
    options.write_models([structure], output, ".pdb", ())
    if as_json:
        facts = {"n_residues": structure.n_residues, "n_atoms": structure.n_atoms}
        return options.print_json({"output": str(output), **facts})
    with options.redirect_messages(output):
        where = "standard output" if str(output) == options.STANDARD_OUTPUT else output
        size = f"{plural(structure.n_residues, 'residue')}, {plural(structure.n_atoms, 'atom')}"
        print(f"written: {where} ({size})")


def _build_records(source: str, records: list[tuple[str, str]], folder: Path, as_json: bool) -> None:
    """Build the chain of each record of a FASTA file into a folder."""
    from protochain.cli.rows import print_rows
    from protochain.structure import from_sequence

    options.check_folder(folder, "records")
    rows, structures = list[dict[str, Any]](), []
    for name, letters in records:
        try:
            structures.append(from_sequence(letters))
        except ProtochainError as error:
            raise ProtochainError(f"{source}: record {name}: ", *error.parts) from error
        size = {"n_residues": structures[-1].n_residues, "n_atoms": structures[-1].n_atoms}
        rows.append({"record": name, "output": str(folder / f"{name}.pdb"), **size})
    options.check_outputs([source], [row["output"] for row in rows])
    folder.mkdir(parents=True, exist_ok=True)
    for row, structure in zip(rows, structures, strict=True):
        options.write_models([structure], Path(row["output"]), ".pdb", ())
    if as_json:
        return options.print_json({"results": rows})
    print_rows([*rows[0]], ([*row.values()] for row in rows), texts=2)
