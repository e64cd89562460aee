"""Choice of assembly, model, chains, atoms, and one conformation of each residue in a file."""

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from math import dist, isfinite, nan
from typing import NamedTuple

import gemmi
import numpy as np
from scipy.spatial import KDTree

from protochain.core.errors import Argument, StructureError
from protochain.core.graph import components
from protochain.structure.formats.chain_splitting import chain_names, refuse_copies
from protochain.structure.formats.files import in_file_order, number_atoms
from protochain.structure.molecule.header import read_header
from protochain.structure.molecule.member import residue_in_file
from protochain.structure.molecule.repairs import Kind, Repair
from protochain.structure.molecule.residues import CAPS, NUCLEOTIDES, STANDARD, STATE_PARENT, Atom
from protochain.structure.molecule.templates import Template, standard_name, template_name, templates
from protochain.structure.preparation.structure_draft import Changes, Draft, Omission

MODELS = "models"
"""Name of the assembly of all models of a file."""
_COPY_RMSD = 0.02  # Angstrom. Copies differ only by rounding in the file, models of an experiment by more.
_OVERLAP, _ION_OVERLAP = 1.0, 2.0
"""Angstrom. Atoms closer than the first, or ions closer than the second, exclude each other."""
_MAX_SHARED = 0.05  # Largest fraction of overlapping atoms in copies.
_CONTACT = 2.5  # Angstrom. Alternate locations closer than this belong to one state or exclude each other.
_NO_ALTLOC = "whole-"  # Prefix of the letter of a molecule with partial occupancy but without altloc.
_ELEMENT_LETTERS = "CHNOSPD"
"""First letters of atom names in amino acids and nucleotides, without leading digits."""
_PSEUDO = re.compile(r"PS\d*|CEN|NV\d*|ORIG")
_PADDING = re.compile(r"V[0-8]")
_SITE_NAME = re.compile(r"[MELVX]|DO|OM")  # First letters of the names of virtual sites of a water.


def build_assembly(draft: Draft) -> Changes:
    """Replace the deposited molecules by a biological assembly, or join the models."""
    structure, name = draft.file, draft.reading.assembly
    if name:
        before = {chain.name for chain in structure[0]}
        _join_models(draft, structure) if name == MODELS else _transform(draft, structure, name)
        number_atoms(structure)
        chains = tuple(chain.name for chain in structure[0])
        yield Repair.of(Kind.ASSEMBLY, name=name, before=len(before), chains=chains)


def _transform(draft: Draft, structure: gemmi.Structure, name: str) -> None:
    """Build an assembly that is defined in the file."""
    assembly_names = [assembly.name for assembly in structure.assemblies]
    if name not in assembly_names:
        available = f"it has {', '.join(assembly_names)}" if assembly_names else "it states none"
        raise draft.error(f"has no assembly {name}; {available}")
    structure.transform_to_assembly(name, gemmi.HowToNameCopiedChain.Short)
    structure.merge_chain_parts()


def _join_models(draft: Draft, structure: gemmi.Structure) -> None:
    """Add the chains of all models to the first one, under free ids."""
    if len(structure) < 2:
        raise draft.error("has one model: there are none to join; change or omit assembly")
    used = {chain.name for chain in structure[0]}
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
    del structure[1:]
    structure.merge_chain_parts()


def _are_copies(structure: gemmi.Structure) -> bool:
    """Return whether all models are displaced rigid copies of the first. Frames of a rigid body overlap."""
    models = [[*model.all()] for model in structure]
    atom_ids = [[(str(p.residue.seqid), p.residue.name, p.atom.name) for p in model] for model in models]
    first = [place.atom.pos for place in models[0]]
    tree = KDTree([position.tolist() for position in first])
    for names, model in zip(atom_ids[1:], models[1:], strict=True):
        places = [place.atom.pos for place in model]
        if names != atom_ids[0] or gemmi.superpose_positions(first, places).rmsd > _COPY_RMSD:
            return False
        distance, _ = tree.query([position.tolist() for position in places])
        if np.mean(distance < _OVERLAP) > _MAX_SHARED:
            return False
    return True


def choose_model(draft: Draft) -> Changes:
    """Use the requested model, or the first, and report the other models."""
    structure, number = draft.file, draft.reading.model
    draft.header = read_header(structure, draft.header)
    numbers = [model.num for model in structure]
    refuse_absent(draft.source, numbers, [] if number is None else [number])
    if len(structure) > 1:
        if number is None:
            kind = Kind.MODELS_ARE_COPIES if _are_copies(structure) else Kind.MODELS_LEFT_OUT
            remedy = Argument("assembly", MODELS)
            yield Repair.of(kind, used=structure[0].num, count=len(structure) - 1, remedy=remedy)
        yield Omission("models", len(structure) - 1)
    draft.model = structure[0 if number is None else numbers.index(number)]
    draft.model_number = draft.model.num
    draft.file_atoms = tuple(name for name, _ in in_file_order(draft.model))
    _check_altloc(draft)


def choose_chains(draft: Draft) -> Changes:
    """Use the requested chains, or all, in the order of the file."""
    names = draft.reading.chains
    for chain in draft.model:
        chain.name = chain.name.strip()
    ids = [chain.name for chain in draft.model]
    absent = next((name for name in names if name not in ids), None)
    if absent is not None:
        available = ", ".join(name or "(blank)" for name in dict.fromkeys(ids))
        raise draft.error(f"has no chain {absent}; its chains are {available}")
    draft.chains = [chain for chain in draft.model if not names or chain.name in names]
    refuse_copies(draft.chains, draft.source)
    if n := len(ids) - len(draft.chains):
        yield Omission("chains", n)


def choose_altlocs(draft: Draft) -> Changes:
    """Choose one state for residues in contact. If two molecules exclude each other, remove one."""
    places = [(chain.name, group) for chain in draft.chains for group in group_alternates(chain)]
    letters, discarded = resolve_altlocs([group for _, group in places], draft.reading.altloc)
    draft.places = {chain.name: [] for chain in draft.chains}
    for k, (name, group) in enumerate(places):
        if k not in discarded:
            draft.places[name].append((group, letters[k]))
            continue
        yield Omission("alternate locations", 1)
        residue, retained = (residue_in_file(places[p][0], places[p][1][0]) for p in (k, discarded[k]))
        if not group[0].is_water():
            yield Repair.of(Kind.EXCLUDED, residue=residue, other=retained, occupancy=group[0][0].occ)


def refuse_absent(source: str, numbers: Sequence[int], requested: Sequence[int]) -> None:
    """Refuse the first requested model number that a file does not have."""
    absent = next((number for number in requested if number not in numbers), None)
    if absent is not None:
        in_row = list(numbers) == list(range(numbers[0], numbers[-1] + 1))
        listed = f"{numbers[0]} to {numbers[-1]}" if in_row else ", ".join(map(str, numbers))
        available = f"its only model is {numbers[0]}" if len(numbers) == 1 else f"its models are {listed}"
        raise StructureError(f"{source}: has no model {absent}; {available}")


@dataclass(frozen=True, eq=False)
class Conformation:
    """Selected conformation of a residue."""

    residue: gemmi.Residue  # Without alternate locations.
    altloc: str
    occupancy: float  # Mean over the atoms of the selected location.
    unused_altlocs: list[str]  # Names and letters: ``SER B``.
    repeated: list[str]  # Names of atoms that occurred more than once.


def group_alternates(chain: gemmi.Chain) -> list[list[gemmi.Residue]]:
    """Group the residues of a chain that share a number and have altlocs, as in microheterogeneity."""
    groups: list[list[gemmi.Residue]] = []
    amino: dict[str, list[gemmi.Residue]] = {}
    for residue in map(gemmi.Residue.clone, chain):
        number, has_altloc = str(residue.seqid), residue[0].has_altloc()
        if has_altloc and number in amino and residue.get_ca():
            # All atoms of one state may precede the atoms of the next.
            amino[number].append(residue)
        elif groups and groups[-1][0].seqid == residue.seqid and has_altloc:
            groups[-1].append(residue)
        else:
            groups.append([residue])
            if has_altloc and residue.get_ca():
                amino[number] = groups[-1]
    return groups


class _Partial(NamedTuple):
    """Atom of one state: index of the residue group, altloc letter, occupancy, position (angstrom)."""

    place: int
    letter: str
    occupancy: float
    x: list[float]


def resolve_altlocs(places: Sequence[list[gemmi.Residue]], altloc: str) -> tuple[list[str], dict[int, int]]:
    """Choose altlocs of groups in contact (of most molecules, then occupancy), and map discarded groups."""
    letters, discarded = [altloc] * len(places), dict[int, int]()
    atoms = [atom for k, group in enumerate(places) for atom in _partial(k, group)]
    if not atoms:
        return letters, discarded
    touching = [
        (atoms[i], atoms[j], length)
        for i, j in KDTree([atom.x for atom in atoms]).query_pairs(_CONTACT)
        if atoms[i].place != atoms[j].place
        and (
            (length := dist(atoms[i].x, atoms[j].x)) < _OVERLAP
            or not any(atoms[k].letter.startswith(_NO_ALTLOC) for k in (i, j))
        )
    ]
    pairs = np.array([(a.place, b.place) for a, b, _ in touching], dtype=np.int64).reshape(-1, 2)
    group = components(pairs, len(places))
    for g in np.unique(group[pairs]).tolist():
        group_atoms = [atom for atom in atoms if group[atom.place] == g]
        occupancies: dict[str, list[float]] = {}
        places_with: dict[str, set[int]] = {}
        for atom in group_atoms:
            occupancies.setdefault(atom.letter, []).append(atom.occupancy)
            is_water = places[atom.place][0].is_water()
            places_with.setdefault(atom.letter, set()).update([] if is_water else [atom.place])
        rank = {a: (a == altloc, len(places_with[a]), np.mean(occupancies[a])) for a in places_with}
        for atom in group_atoms:
            letters[atom.place] = max(rank, key=rank.__getitem__)
    present = {(atom.place, atom.letter) for atom in atoms}
    for a, b, length in touching:
        for first, second in ((a, b), (b, a)):
            has, lacks = ((atom.place, letters[atom.place]) in present for atom in (first, second))
            if (
                first.letter == letters[first.place] and has and not lacks
                and length < (_ION_OVERLAP if len(places[second.place][0]) == 1 else _OVERLAP)
                and not places[second.place][0].get_ca()
            ):  # fmt: skip
                discarded[second.place] = first.place
    return letters, discarded


def _partial(place: int, group: list[gemmi.Residue]) -> Iterator[_Partial]:
    """Yield heavy atoms with altlocs, or all of a molecule with partial occupancy and without altlocs."""
    heavy = [atom for residue in group for atom in residue if not atom.is_hydrogen()]
    is_molecule = not any(atom.has_altloc() for atom in heavy) and not group[0].get_ca()
    for atom in heavy:
        if atom.has_altloc() or (is_molecule and 0.0 < atom.occ < 1.0):
            letter = atom.altloc if atom.has_altloc() else f"{_NO_ALTLOC}{place}"
            yield _Partial(place, letter, atom.occ, atom.pos.tolist())


def _check_altloc(draft: Draft) -> None:
    """Refuse an alternate location that no atom has."""
    altloc = draft.reading.altloc
    altlocs = {cra.atom.altloc for cra in draft.model.all() if cra.atom.has_altloc()}
    if altloc and altloc not in altlocs:
        available = f"its atoms have {', '.join(sorted(altlocs))}" if altlocs else "no atom of it has one"
        raise draft.error(
            f"has no alternate location {altloc!r}: {available}; change or omit ", Argument("altloc")
        )


def remove_pseudo_atoms(draft: Draft) -> Changes:
    """Remove particles that are not atoms from amino acids, nucleotides and waters, and report them.

    PyMOL writes PS, CYANA Q (averages of hydrogens), Rosetta CEN, NV and V1, GROMACS M (virtual sites),
    RFdiffusion3 V0 to V8, CHARMM LP (lone pairs) and D before the name of an atom (Drude particles).
    """
    all_templates, sites, waters = templates(), 0, 0
    for chain in draft.model:
        for residue in chain:
            name = standard_name(residue.name.strip().upper())[0]
            is_known = name in STANDARD or name in CAPS or name in NUCLEOTIDES
            template = all_templates.get(template_name(name)) if is_known else None
            of_water = [] if is_known else _virtual_sites(residue)
            places = of_water or _pseudo_atoms(residue, template)
            names = tuple(dict.fromkeys(residue[k].name for k in places))
            for k in reversed(places):
                del residue[k]
            if of_water:
                # As in the archive, where T4P, a water of four sites, is a ligand.
                residue.name = "HOH"
                for atom in residue:
                    atom.name = "O" if atom.name.lstrip("0123456789").startswith("O") else atom.name
                sites, waters = sites + len(places), waters + 1
            elif places:
                yield Repair.of(Kind.VIRTUAL, residue=residue_in_file(chain.name, residue), atoms=names)
    if sites:
        yield Repair.of(Kind.SITES, count=sites, waters=waters)


def _pseudo_atoms(residue: gemmi.Residue, template: Template | None) -> list[int]:
    """Return the indices of pseudo-atoms. Names count only in amino acids and nucleotides without beads."""
    is_atomic = {"CA", "C1'", "C1*", "CH3"} & {atom.name for atom in residue}
    template = template if is_atomic else None
    atoms = {*template.element, *template.synonyms} if template else set()
    heavy = {*template.heavy} if template else set()
    return [
        k
        for k, atom in enumerate(residue)
        if atom.calc_flag == gemmi.CalcFlag.Dummy
        or (_PADDING.fullmatch(atom.name) and "CA" in residue)
        or (template and atom.name not in atoms and _is_pseudo_name(atom.name, heavy))
    ]


def _is_pseudo_name(name: str, heavy: Collection[str]) -> bool:
    """Whether an unknown name names a pseudo-atom: a Drude particle has a heavy atom's name after D."""
    letter = name.lstrip("0123456789")[:1]
    if name == "X":
        # The reader gives this name to an atom without one.
        return False
    is_drude = letter == "D" and name[1:] in heavy
    return letter not in _ELEMENT_LETTERS or is_drude or bool(_PSEUDO.fullmatch(name))


def _virtual_sites(residue: gemmi.Residue) -> list[int]:
    """Return the indices of a water's virtual sites, if its other sites are one oxygen and two hydrogens."""
    names = [atom.name.lstrip("0123456789") for atom in residue]
    sites = [k for k, name in enumerate(names) if _SITE_NAME.match(name) and not residue[k].element.is_metal]
    letters = sorted(name[:1] for k, name in enumerate(names) if k not in sites)
    return sites if letters in (["H", "H", "O"], ["D", "D", "O"]) else []


def correct_atoms(draft: Draft) -> Changes:
    """Correct invalid occupancies, deuterium, and elements that contradict atom names."""
    unknown = 0
    for place in draft.model.all():
        atom = place.atom
        atom.b_iso = atom.b_iso if isfinite(atom.b_iso) else nan
        if not abs(atom.occ) < 1000.0:  # Larger values do not fit the PDB columns.
            unknown += 1
            atom.occ = 0.0
    if unknown:
        yield Repair.of(Kind.NOT_A_NUMBER, count=unknown)
    if heavy := _replace_deuterium(draft.model):
        yield Repair.of(Kind.DEUTERIUM, count=heavy)
    if corrected := _correct_elements(draft.model):
        yield Repair.of(Kind.ELEMENTS, count=len(corrected), atom=corrected[0])


def _replace_deuterium(model: gemmi.Model) -> int:
    """Convert deuterium to hydrogen, in element and name, and return the number of atoms."""
    heavy = [place for place in model.all() if place.atom.element.name == "D"]
    for place in heavy:
        place.atom.element = gemmi.Element("H")
        name = place.atom.name.replace("D", "H", 1)
        namesakes = [atom for atom in place.residue if atom.name == name]
        # Hydrogen and deuterium at one site are alternate locations.
        if all(namesake.has_altloc() and namesake.altloc != place.atom.altloc for namesake in namesakes):
            place.atom.name = name
    return len(heavy)


def _correct_elements(model: gemmi.Model) -> list[Atom]:
    """Set the elements of atoms of standard residues by name, and return the corrected atoms."""
    standard = {name: t for name, t in templates().items() if name in {*STANDARD, *STATE_PARENT}}
    corrected = []
    for place in model.all():
        residue, atom = place.residue, place.atom
        if (template := standard.get(residue.name)) is None:
            continue
        element = template.element.get(template.synonyms.get(atom.name, atom.name), atom.element.name)
        if element != atom.element.name:
            atom.element = gemmi.Element(element)
            corrected.append(Atom(atom.name, residue_in_file(place.chain.name, residue)))
    return corrected


def pick_altloc(group: list[gemmi.Residue], preferred: str) -> Conformation:
    """Choose the preferred altloc, or the one of highest occupancy (the first of equal ones)."""
    names = [atom.name for atom in group[0] if not atom.has_altloc()]
    if len(group) == 1 and len({*names}) == len(group[0]):
        return Conformation(group[0], "", 1.0, [], [])
    weights: dict[tuple[int, str], list[float]] = {}
    for i, residue in enumerate(group):
        for atom in residue:
            if atom.has_altloc():
                weights.setdefault((i, atom.altloc), []).append(atom.occ)
    matching = [place for place in weights if place[1] == preferred]
    best, altloc = max(matching or weights, key=lambda place: float(np.mean(weights[place])), default=(0, ""))
    chosen = group[best]
    _complete_backbone(chosen, group)
    # Keep atoms that only another location has, and the first of two with one name.
    ranked = sorted(range(len(chosen)), key=lambda i: chosen[i].altloc not in (altloc, "\0"))
    index_of: dict[str, int] = {}
    for i in ranked:
        index_of.setdefault(chosen[i].name, i)
    repeated = sorted({chosen[i].name for i in set(ranked) - set(index_of.values())})
    # Delete hydrogens of another location, because their parent atom has another position there.
    of_others = [i for i in ranked if chosen[i].is_hydrogen() and chosen[i].altloc not in (altloc, "\0")]
    for i in sorted({*(set(ranked) - set(index_of.values())), *of_others}, reverse=True):
        del chosen[i]
    for atom in chosen:
        atom.altloc = "\0"
    unused = sorted({f"{group[i].name} {a}" for i, a in weights} - {f"{chosen.name} {altloc}"})
    occupancy = float(np.mean(weights.get((best, altloc), [1.0])))
    return Conformation(chosen, altloc, occupancy, unused, repeated)


def _complete_backbone(chosen: gemmi.Residue, group: list[gemmi.Residue]) -> None:
    """Add shared backbone atoms that the file lists with only one of the alternatives."""
    for residue in group:
        present = {atom.name for atom in chosen}
        for atom in residue:
            if atom.name in ("N", "CA", "C", "O") and atom.name not in present and residue is not chosen:
                chosen.add_atom(atom)
