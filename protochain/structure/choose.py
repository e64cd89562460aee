"""Which model of a file, and which of its chains, are used."""

from collections.abc import Sequence

import gemmi

from protochain.core.errors import StructureError
from protochain.structure.apart import refuse_copies
from protochain.structure.draft import Draft
from protochain.structure.files import number_atoms
from protochain.structure.repairs import Kind


def assemble(draft: Draft, structure: gemmi.Structure, name: str) -> None:
    """Build a biological assembly in the place of the molecules as filed."""
    there = [each.name for each in structure.assemblies]
    if name not in there:
        known = f"it has {', '.join(there)}" if there else "it states none"
        raise StructureError(f"{draft.source}: has no assembly {name}; {known}")
    before = {chain.name for chain in structure[0]}
    structure.transform_to_assembly(name, gemmi.HowToNameCopiedChain.Short)
    structure.merge_chain_parts()
    number_atoms(structure)
    made = [chain.name for chain in structure[0]]
    draft.note(Kind.ASSEMBLY, name=name, before=len(before), chains=tuple(made))


def choose_model(draft: Draft, structure: gemmi.Structure, number: int | None) -> gemmi.Model:
    """Return the model of that number, or the first; the draft's repairs tell of the others."""
    numbers = [model.num for model in structure]
    refuse_absent(draft.source, numbers, [] if number is None else [number])
    chosen = 0 if number is None else numbers.index(number)
    if len(structure) > 1:
        if number is None:
            draft.note(Kind.MODELS_LEFT_OUT, used=structure[0].num, count=len(structure) - 1)
        draft.left_out["models"] = len(structure) - 1
    draft.model_number = structure[chosen].num
    return structure[chosen]


def choose_chains(draft: Draft, model: gemmi.Model, names: Sequence[str]) -> list[gemmi.Chain]:
    """Return the chains of these names, or all, in the order of the file."""
    for chain in model:
        chain.name = chain.name.strip()
    there = [chain.name for chain in model]
    absent = next((name for name in names if name not in there), None)
    if absent is not None:
        known = ", ".join(name or "(blank)" for name in dict.fromkeys(there))
        raise StructureError(f"{draft.source}: has no chain {absent}; its chains are {known}")
    used = [chain for chain in model if not names or chain.name in names]
    refuse_copies(used, draft.source)
    draft.left_out["chains"] = len(there) - len(used)
    return used


def refuse_absent(source: str, numbers: Sequence[int], asked: Sequence[int]) -> None:
    """Refuse the first model asked for that is not among those of a file."""
    absent = next((number for number in asked if number not in numbers), None)
    if absent is not None:
        in_row = list(numbers) == list(range(numbers[0], numbers[-1] + 1))
        listed = f"{numbers[0]} to {numbers[-1]}" if in_row else ", ".join(map(str, numbers))
        its = f"its only model is {numbers[0]}" if len(numbers) == 1 else f"its models are {listed}"
        raise StructureError(f"{source}: has no model {absent}; {its}")
