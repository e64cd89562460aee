"""Preparation of a structure: :data:`PASSES` is its table of contents.

Atoms are placed by geometry, and missing side chains on rotamers. The same file gives the same coordinates,
bit for bit.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import gemmi
import numpy as np
from openmm import app

from protochain.core import defaults
from protochain.core.arrays import Floats, Integers
from protochain.core.checks import acidity_or_auto, check_arguments, file_name, force_field_parts
from protochain.core.checks import bonds as bonds_of
from protochain.core.checks import path as as_path
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.formats.files import STANDARD_INPUT, parse, places_in_file, split_name
from protochain.structure.formats.records import springs
from protochain.structure.molecule.hydrogens import place_hydrogens
from protochain.structure.molecule.links import Link
from protochain.structure.molecule.member import Member
from protochain.structure.molecule.model import BoundLigand, Origin, Structure
from protochain.structure.molecule.repairs import Kind, Repair
from protochain.structure.molecule.templates import Template
from protochain.structure.preparation import (
    complete,
    fragments,
    hetero_molecules,
    ligand_chemistry,
    model_choice,
    periodic,
    protonate,
    sites,
    terminal_caps,
)
from protochain.structure.preparation import read as chain_passes
from protochain.structure.preparation.structure_draft import Chemistry, Draft, Omission, Part, Reading

Pass = Callable[[Draft], Iterable[Repair | Omission]]
"""A step of a preparation, which changes a draft and yields the changes."""

READING: tuple[Pass, ...] = (
    model_choice.build_assembly,  # The requested assembly, instead of the molecules as filed.
    model_choice.choose_model,
    model_choice.remove_pseudo_atoms,
    periodic.make_whole,  # Molecules that a periodic box cuts.
    model_choice.correct_atoms,  # Occupancies, deuterium, elements.
    chain_passes.read_bonds,  # Bonds that the file states.
    model_choice.choose_chains,
    model_choice.choose_altlocs,
    chain_passes.split_chains,  # Residues of the protein, in unbroken pieces, and hetero molecules.
    chain_passes.join_chains,  # Pieces whose ends are bonded.
    chain_passes.add_poses,  # Molecules of the user.
    hetero_molecules.choose_hetero,  # Hetero molecules to include, and their kinds.
    hetero_molecules.require_chain,
    sites.find_links,  # Bonds between the protein and hetero molecules.
    fragments.assign_chemistry,  # Residues that no template fits.
    sites.report_links,
    ligand_chemistry.parametrise_ligands,  # Small molecules.
    hetero_molecules.report_hetero,
    chain_passes.order_parts,
    terminal_caps.cap_ends,
)
"""Passes from a file to molecules of known chemistry."""
COMPLETING: tuple[Pass, ...] = (
    sites.list_bonds,  # Bonds that are not along a chain, and mobile molecules.
    ligand_chemistry.assign_ligand_templates,  # Templates of mobile ligands.
    complete.add_heavy_atoms,
    sites.bond_disulfides,
    protonate.protonate,
    ligand_chemistry.put_hydrogens,  # Hydrogens of ligands, as in their molecules.
)
"""Passes from molecules to all of their atoms."""
PASSES = READING + COMPLETING
"""The table of contents of a preparation."""
_SHORTEST = 0.02  # nm. A fifth of the shortest bond.
_FIRST = {Kind.LEFT_OUT: 0, Kind.WATERS_LEFT_OUT: 0, Kind.KEPT: 1, Kind.KEPT_BY_ELEMENT: 1}


@check_arguments()
def load(
    path: str | Path,
    *,
    model: int | None = None,
    assembly: str = "",
    altloc: str = "",
    keep: str | Sequence[str] = defaults.KEEP,
    disulfide: str | Sequence[str | tuple[str, str]] | None = None,
    ph: float | str = defaults.PH,
    strict: bool = False,
    forcefield: str | Path | None = None,
    chains: str | Sequence[str] = (),
    ligands: Mapping[str, str | Path] | str | Path | Sequence[str | Path] = (),
    ligand_charges: str | Path = defaults.LIGAND_CHARGES,
    standard_residues: bool = False,
    cap: str = defaults.CAP,
) -> Structure:
    """Read a PDB or mmCIF file and prepare its protein: complete, all-atom, one conformation.

    Waters and other alternate locations are removed. Hetero molecules near the protein are included. Chains
    are split at breaks, and head-to-tail cyclic peptides are closed. Modified residues without parameters
    become their standard parents. Missing side-chain atoms are built on rotamers, L or D by residue name.
    Disulfides and metal sites are found by distance, and missing hydrogens are placed by geometry. The same
    file gives the same coordinates, bit for bit.

    Parameters
    ----------
    path : path-like
        PDB or mmCIF, judged by content, also compressed by gzip, bzip2 or xz. ``-`` is standard input.
    model : int, optional
        Number of the model in the file. The default is the first one.
    assembly : str
        Name of the biological assembly to build, as the file states it. The default is the molecules as
        filed. ``models`` joins the models of a file under free chain ids.
    altloc : str
        Preferred alternate location, which some atom must have. The location of highest occupancy is the
        default, also for residues without the preferred one.
    keep : str or sequence of str
        Hetero molecules to include: ``near`` for all but waters that have an atom within 5 angstrom of the
        protein or of a user's ligand, ``none``, ``all``, ``water``, ``ions``, ``nucleic``, ``ligands``, or
        residue names. Small molecules of known chemistry move, and so do glycans in GLYCAM-06j and molecules
        with parameters in ``forcefield``. Other molecules are fixed obstacles. Without parameters in any
        force field they are described by element.
    disulfide : str, or sequence of pairs of str, optional
        Disulfide bonds in addition to the bonds of close sulphurs, as ``[("A:3", "A:40")]`` or
        ``"A:3-A:40"``. With ``"none"`` only the listed bonds are made.
    ph : float or str
        Sets the protonation by the pKa of the kind of residue, if hydrogens or names in the file do not show
        it. ``"auto"`` is pH 7 with the pKa of each residue by PROPKA (``pip install "protochain[pka]"``).
    strict : bool
        Refuse chain breaks and incomplete backbones.
    forcefield : path-like, optional
        Force-field file whose residues stay unmodified, or several separated by commas, also with names of
        bundled ones. A hetero molecule moves if its parameters are in it.
    chains : str or sequence of str
        Chains to read, as ``"A,B"`` or ``("A", "B")``. The default is all chains.
    ligands : mapping of str to path-like or str, or sequence
        Chemistry of hetero molecules by residue name: an SDF or MOL2 file, or SMILES. ``"NAME=FILE"`` or a
        list of such strings is accepted, too. A file without a name is a pose, which is added
        (``"FILE.sdf#2"`` is its second molecule). Other molecules have the bonds that the file states
        (``_chem_comp_bond``, CONECT records with orders), or else the Chemical Component Dictionary's.
        Their force field is the same as in :func:`protochain.ligand`, which needs
        ``pip install "protochain[ligands]"``.
    ligand_charges : str or path-like
        Partial charges of ligands, as ``charges`` of :func:`protochain.ligand`.
    standard_residues : bool
        Convert modified residues to their standard parents, also phosphorylated residues with parameters in
        amber14 and amber19.
    cap : str
        Ends of chains at which acetyl (ACE) and methylamide (NME) replace charged termini: ``breaks``,
        ``ends`` for the first and last residues, unless the sequence in the file ends there, or ``all``.

    Returns
    -------
    Structure
        Prepared protein, whose ``repairs`` list every change.

    Raises
    ------
    StructureError
        If the file cannot be used: one line naming the file, the place and the remedy.

    Examples
    --------
    >>> s = pc.load("structures/1l2y.pdb")
    >>> s.n_residues, s.n_atoms
    (20, 304)
    """
    options = {name: value for name, value in locals().items() if name != "path"}
    return prepare(read(as_path(path, "path"), reading_of(**options)))


def reading_of(
    *,
    keep: Any = defaults.KEEP,
    disulfide: str | Sequence[str | tuple[str, str]] | None = None,
    ph: float | str = defaults.PH,
    forcefield: str | Path | None = None,
    ligands: Any = (),
    ligand_charges: str | Path = defaults.LIGAND_CHARGES,
    **options: Any,
) -> Reading:
    """Check the options of :func:`load`."""
    ph = acidity_or_auto(ph, "ph")
    acidity = defaults.PH if isinstance(ph, str) else ph
    return Reading(
        keep=keep,
        disulfide=bonds_of(disulfide, "disulfide"),
        ph=ph,
        forcefield=user_files(forcefield),
        chemistry=Chemistry.parse(ligands, ligand_charges, acidity, parts_of(forcefield)),
        **options,
    )


def user_files(forcefield: str | Path | None) -> tuple[Path, ...]:
    """Return the paths of a user's files in a force field, without the names of bundled ones."""
    return tuple(Path(name) for name in parts_of(forcefield) if Path(name).is_file())


def parts_of(forcefield: str | Path | None) -> tuple[str, ...]:
    """Return the names and paths that a force field consists of. None has no parts."""
    return () if forcefield is None else tuple(force_field_parts(file_name(forcefield, "forcefield")))


def read(path: str | Path, reading: Reading | None = None) -> Draft:
    """Read the molecules of one model of a PDB or mmCIF file."""
    path = Path(path)
    structure, overlooked, is_ended, records = parse(path)
    name = "stdin" if path == STANDARD_INPUT else split_name(path)[0]
    source = "standard input" if path == STANDARD_INPUT else str(path)
    draft = Draft(name, source, reading=reading or Reading(), file=structure, is_ended=is_ended)
    draft.repairs, draft.header = overlooked, records
    draft.springs = springs(records)
    return run(draft, READING)


def run(draft: Draft, passes: Sequence[Pass]) -> Draft:
    """Run passes over a draft, and collect their changes."""
    for step in passes:
        for change in step(draft):
            if isinstance(change, Omission):
                draft.left_out[change.kind] += change.number
                continue
            draft.repairs.append(change)
            for loss in change.lost:
                if not loss.why.is_of_whole:
                    draft.left_out[f"atoms of {loss.name}"] += len(loss.atoms)
    # The contents of a structure come before its changes.
    draft.repairs.sort(key=lambda repair: _FIRST.get(repair.kind, len(_FIRST)))
    return draft


def prepare(draft: Draft) -> Structure:
    """Complete a draft that was read: heavy atoms, disulfides, hydrogens."""
    if not draft.file_atoms:
        for k, atom in enumerate((atom for member in draft.members for atom in member.atoms), 1):
            atom.fraction = k
    run(draft, COMPLETING)
    for member in draft.members:
        if repeated := [name for name, n in Counter(atom.name for atom in member.atoms).items() if n > 1]:
            raise draft.error(f"{member}: {repeated[0]} is there under two elements; correct columns 77-78")
    # Hydrogens without a position are placed when all bonds are known.
    atoms = [atom for member in draft.members for atom in member.atoms]
    elements = [atom.element.name for atom in atoms]
    at = _indices(draft)
    bonds = _bonds(draft, at)
    charge = np.array([t.charge.get(atom.name, 0.0) for m, t in draft.states for atom in m.atoms])
    x = np.array([atom.pos.tolist() for atom in atoms]) / ANGSTROM_PER_NM
    place = np.where(np.isnan(x[:, 0]), -1, places_in_file(atoms))
    x = place_hydrogens(x, elements, charge, bonds)
    owners = [(member, atom.name) for member in draft.members for atom in member.atoms]
    _refuse_coincident(draft, owners, x, bonds)
    roles = [
        (part.obstacle and not part.mobile and not sites.moves(draft, member, draft.links), part.mobile)
        for part in draft.parts for member in part.members
    ]  # fmt: skip
    fixed, mobile = np.repeat(roles, [len(member.atoms) for member in draft.members], axis=0).T
    # Bonds of hetero molecules, and springs for the bonds without parameters.
    metals = [link for link in draft.metal_links if link.member is not link.hetero]
    links = _distinct(draft, [*draft.links, *draft.other_links, *sites.stated_hetero_links(draft), *metals])
    sprung = [*draft.links, *draft.metal_links]
    ties = sites.stated_ties(draft, sprung, at) or sites.ties(sprung, at, x, elements, bonds)
    residue_parts = [part for part in draft.parts for _ in part.members]
    return Structure(
        name=draft.name,
        topology=_topology(draft, bonds),
        positions=x,
        repairs=tuple(draft.repairs),
        left_out=draft.left_out,
        b_factor=np.array([atom.b_iso for atom in atoms]),
        obstacle=fixed,
        occupancy=_occupancies(atoms),
        residue_label=tuple(member.label for member in draft.members),
        header=draft.header,
        model_number=draft.model_number,
        ties=ties,
        mobile=mobile,
        links=np.array(_link_indices(links, at), np.int64).reshape(-1, 2),
        mirrored=np.array([member.is_d for member in draft.members]),
        built=np.array([k < 0 and element != "H" for k, element in zip(place, elements, strict=True)]),
        ligands=tuple(_index_ligand(part, at) for part in draft.parts if part.ligand is not None),
        fragments=tuple(BoundLigand(f.ligand, f.atoms(at), core=f.core) for f in draft.fragments),
        glycans={r: part.glycam_code for r, part in enumerate(residue_parts) if part.glycam_code},
        origin=Origin(draft.file_atoms, place, charge) if draft.file_atoms and (place >= 0).any() else None,
    )


def _index_ligand(part: Part, at: dict[int, dict[str, int]]) -> BoundLigand:
    assert part.ligand is not None
    index = at[id(part.members[0])]
    atoms = np.array([index[name] for name in part.ligand.molecule.names])
    return BoundLigand(part.ligand, atoms, part.inverted, posed=part.posed)


def _link_indices(links: list[Link], at: dict[int, dict[str, int]]) -> list[tuple[int, int]]:
    return [(at[id(x.member)][x.atom.name], at[id(x.hetero)][x.hetero_atom.name]) for x in links]


def _distinct(draft: Draft, links: list[Link]) -> list[Link]:
    """Return each bond of hetero molecules once, bonds to the protein first."""
    protein = {id(member) for part in draft.parts if not part.obstacle for member in part.members}
    unique = {frozenset(link.ends): link for link in links if not {*link.owners} <= protein}
    return sorted(unique.values(), key=lambda link: id(link.member) not in protein)


def _occupancies(atoms: list[gemmi.Atom]) -> Floats:
    """Return the occupancies. A hydrogen without a position yet has its parent's, which it follows."""
    parent, occupancies = 1.0, []
    for atom in atoms:
        parent = parent if atom.is_hydrogen() else atom.occ
        occupancies.append(parent if atom.is_hydrogen() and np.isnan(atom.pos.x) else atom.occ)
    return np.array(occupancies)


def _indices(draft: Draft) -> dict[int, dict[str, int]]:
    """Return the index of each atom, by ``id`` of its residue and by name."""
    at: dict[int, dict[str, int]] = {}
    n = 0
    for member in draft.members:
        at[id(member)] = {atom.name: n + k for k, atom in enumerate(member.atoms)}
        n += len(member.atoms)
    return at


def _bonds(draft: Draft, at: dict[int, dict[str, int]]) -> Integers:
    """Return the bonds (nbonds, 2) of templates and chains, disulfides, and links of hetero molecules."""
    pairs: list[tuple[int, int]] = []
    for member, template in draft.states:
        index = at[id(member)]
        pairs += [(index[a], index[b]) for a, b in template.outward if a in index and b in index]
    for part in draft.parts:
        following = part.members[1:] + ([part.members[0]] if part.cyclic else [])
        for member, following_member in zip(part.members, following, strict=False):
            end, start = ("O3'", "P") if part.obstacle else ("C", "N")
            pairs.append((at[id(member)][end], at[id(following_member)][start]))
    pairs += _link_indices([*draft.links, *draft.other_links, *draft.metal_links], at)
    pairs += [(at[id(first)]["SG"], at[id(second)]["SG"]) for first, second in draft.bridges]
    return np.sort(np.array(pairs, dtype=np.int64).reshape(-1, 2), axis=1)


def _topology(draft: Draft, bonds: Integers) -> app.Topology:
    topology = app.Topology()
    atoms, element_of = [], cache(app.Element.getBySymbol)
    templates_of = {id(member): template for member, template in draft.states}
    for part in draft.parts:
        chain, is_hetero = None, part.obstacle
        for member in part.members:
            if chain is None or chain.id != member.chain_id:
                chain = topology.addChain(member.chain_id)
            residue = topology.addResidue(member.name, chain, member.number, member.insertion_code)
            for atom in member.atoms:
                name, element, charge = atom.name, element_of(atom.element.name), 0
                if is_hetero or name == "SG":
                    charge = _formal_charge(atom, member, templates_of[id(member)], is_hetero)
                atoms.append(topology.addAtom(name, element, residue, formalCharge=charge))
    for first, second in bonds.tolist():
        topology.addBond(atoms[first], atoms[second])
    return topology


def _formal_charge(atom: gemmi.Atom, member: Member, template: Template, is_hetero: bool) -> int:
    """Return the formal charge of a hetero atom in the file, of an ion, or of a thiolate."""
    if is_hetero:
        return int(atom.charge or (round(template.charge[atom.name]) if len(member.atoms) == 1 else 0))
    is_thiolate = template.name.endswith("CYM") and not member.metals and not member.links
    return -1 if atom.name == "SG" and is_thiolate else 0


def _refuse_coincident(draft: Draft, owners: list[tuple[Member, str]], x: Floats, bonds: Integers) -> None:
    """Refuse bonded atoms that coincide, because their bond has no direction."""
    lengths = np.linalg.norm(x[bonds[:, 0]] - x[bonds[:, 1]], axis=1)
    if not len(lengths) or lengths.min() > _SHORTEST:
        return
    first, second = bonds[int(np.argmin(lengths))]
    a, b = owners[first], owners[second]
    raise draft.error(f"{a[0]}: atoms {a[1]} and {b[1]} coincide; correct their coordinates")
