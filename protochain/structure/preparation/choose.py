"""Which model of a file, and which of its chains, are used."""

from collections.abc import Sequence

import gemmi
import numpy as np
from scipy.spatial import KDTree

from protochain.core.errors import Argument, StructureError
from protochain.structure.formats.apart import chain_names, refuse_copies
from protochain.structure.formats.files import number_atoms
from protochain.structure.molecule.repairs import Kind
from protochain.structure.preparation.draft import Draft

MODELS = "models"
"""Name of the assembly of all models of a file."""
_SAME = 0.02
"""Angstrom: copies differ by the digits of a file alone; models of an experiment by more."""
_UPON, _SHARED = 1.0, 0.05
"""Angstrom between atoms in one place, and the largest share of such atoms in copies."""


def assemble(draft: Draft, structure: gemmi.Structure, name: str) -> None:
    """Build a biological assembly in the place of the molecules as filed, or join its models."""
    if name == MODELS:
        return _join_models(draft, structure)
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


def _join_models(draft: Draft, structure: gemmi.Structure) -> None:
    """Add the chains of all models to the first one, under free ids."""
    if len(structure) < 2:
        raise StructureError(
            f"{draft.source}: has one model: there are none to join; change or omit assembly"
        )
    before = [chain.name for chain in structure[0]]
    used = {*before}
    for k in range(1, len(structure)):
        names: dict[str, str] = {}
        for chain in structure[k]:
            if chain.name not in names:
                free = chain_names(used)
                names[chain.name] = next(free)
                used.add(names[chain.name])
            copy = chain.clone()
            copy.name = names[chain.name]
            structure[0].add_chain(copy)
    while len(structure) > 1:
        del structure[1]
    structure.merge_chain_parts()
    number_atoms(structure)
    chains = tuple(chain.name for chain in structure[0])
    draft.note(Kind.ASSEMBLY, name=MODELS, before=len({*before}), chains=chains)


def _are_copies(structure: gemmi.Structure) -> bool:
    """Whether all models are rigid copies of the first beside it, as assemblies in the PDB format.

    Frames of a rigid body overlap. Copies share no more than what lies on an axis of symmetry.
    """
    models = [[*model.all()] for model in structure]
    named = [[(str(p.residue.seqid), p.residue.name, p.atom.name) for p in model] for model in models]
    first = [place.atom.pos for place in models[0]]
    tree = KDTree([position.tolist() for position in first])
    for names, model in zip(named[1:], models[1:], strict=True):
        places = [place.atom.pos for place in model]
        if names != named[0] or gemmi.superpose_positions(first, places).rmsd > _SAME:
            return False
        apart, _ = tree.query([position.tolist() for position in places])
        if np.mean(apart < _UPON) > _SHARED:
            return False
    return True


def choose_model(draft: Draft, structure: gemmi.Structure, number: int | None) -> gemmi.Model:
    """Return the model of that number, or the first; the draft's repairs tell of the others."""
    numbers = [model.num for model in structure]
    refuse_absent(draft.source, numbers, [] if number is None else [number])
    chosen = 0 if number is None else numbers.index(number)
    if len(structure) > 1:
        if number is None:
            kind = Kind.MODELS_ARE_COPIES if _are_copies(structure) else Kind.MODELS_LEFT_OUT
            remedy = Argument("assembly", MODELS)
            draft.note(kind, used=structure[0].num, count=len(structure) - 1, remedy=remedy)
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
