"""What residues are made of: the templates of OpenMM's Amber files, read under every name an atom goes by.

The files are data: names, elements, charges and bonds are taken from them, and nothing in them is run.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from xml.etree import ElementTree

import gemmi
from openmm import app

from protochain.errors import StructureError
from protochain.residues import CAPS, NUCLEOTIDES, STANDARD, STATE_PARENT
from protochain.structure.draft import Part

_DATA = Path(app.__file__).parent / "data"
_FILES = ("protein.ff14SB.xml", "DNA.OL15.xml", "RNA.OL3.xml", "tip3p.xml")


@dataclass(frozen=True, eq=False)
class Template:
    """A residue as a force field has it.

    Parameters
    ----------
    name : str
        As the force field calls it: ``ALA``, ``NALA`` at the start of a chain, ``HIE``.
    element : mapping of str to str
        Element of each atom, by the name the PDB gives it.
    charge : mapping of str to float, e
    bonds : tuple of pairs of str
        Within the residue.
    synonyms : mapping of str to str
        Every other name of an atom to the PDB's.
    """

    name: str
    element: Mapping[str, str]
    charge: Mapping[str, float]
    bonds: tuple[tuple[str, str], ...]
    synonyms: Mapping[str, str]

    @cached_property
    def heavy(self) -> list[str]:
        """Names of the atoms that are not hydrogens."""
        return [name for name, element in self.element.items() if element != "H"]

    @cached_property
    def hydrogens(self) -> dict[str, list[str]]:
        """Names of the hydrogens of each heavy atom that has any."""
        found: dict[str, list[str]] = {}
        for first, second in self.bonds:
            for parent, child in ((first, second), (second, first)):
                if self.element[child] == "H" and self.element[parent] != "H":
                    found.setdefault(parent, []).append(child)
        return found


def templates(own: Path | None = None) -> Mapping[str, Template]:
    """Templates by name: proteins, caps, nucleic acids, water and ions.

    Parameters
    ----------
    own : Path, optional
        A force-field file of the user's, whose residues are added.

    Raises
    ------
    StructureError
        If that file cannot be read.
    """
    if own is None:
        return _amber()
    # A user's file may change between calls.
    return {**_read(own), **_amber()}


@cache
def _amber() -> Mapping[str, Template]:
    known: dict[str, Template] = {}
    for name in _FILES:
        known = {**_read(_DATA / "amber14" / name), **known}
    return known


def _read(file: Path) -> dict[str, Template]:
    try:
        root = ElementTree.parse(file).getroot()
    except (OSError, ElementTree.ParseError) as error:
        raise StructureError(f"{file}: not a force-field XML file ({error})") from None
    elements = {node.get("name"): node.get("element", "") for node in root.iter("Type")}
    try:
        made = [_template(node, elements) for node in root.iterfind("Residues/Residue")]
    except (KeyError, ValueError, IndexError) as error:
        raise StructureError(f"{file}: a residue in it cannot be read ({error!r})") from None
    return {template.name: template for template in made}


def _template(node: ElementTree.Element, elements: Mapping[str | None, str]) -> Template:
    name = node.get("name", "")
    atoms = [atom for atom in node.iterfind("Atom") if elements.get(atom.get("type"), "")]
    order = [atom.get("name", "") for atom in atoms]
    primary, others = _names(standard_name(name)[0])
    called = {own: _called(own, primary) for own in order}
    synonyms: dict[str, str] = {}
    for own in order:
        for other in (own, primary.get(own, own), *others.get(primary.get(own, own), ())):
            synonyms.setdefault(other, called[own])
    bonds = []
    for bond in node.iterfind("Bond"):
        ends = [bond.get(f"atomName{i}") for i in (1, 2)]
        if None in ends:
            ends = [order[int(bond.get(end, ""))] for end in ("from", "to")]
        if ends[0] in called and ends[1] in called:
            bonds.append((called[str(ends[0])], called[str(ends[1])]))
    return Template(
        name,
        {called[own]: elements[atom.get("type")] for own, atom in zip(order, atoms, strict=True)},
        {called[own]: float(atom.get("charge", 0.0)) for own, atom in zip(order, atoms, strict=True)},
        tuple(bonds),
        {other: own for other, own in synonyms.items() if other not in set(called.values())},
    )


def _called(own: str, primary: Mapping[str, str]) -> str:
    """Name in the PDB, where the first hydrogen of a charged N terminus is H1."""
    return own if own == "H1" and primary.get(own) == "H" else primary.get(own, own)


@cache
def _alternatives() -> dict[str, tuple[str, dict[str, list[str]]]]:
    """Of each residue in OpenMM's table of names: its kind, and the alternatives of its atoms."""
    root = ElementTree.parse(_DATA / "pdbNames.xml").getroot()
    return {
        node.get("name", ""): (
            node.get("type", ""),
            {
                atom.get("name", ""): [value for key, value in atom.items() if key != "name"]
                for atom in node.iterfind("Atom")
            },
        )
        for node in root.iterfind("Residue")
    }


@cache
def _names(residue: str) -> tuple[dict[str, str], dict[str, list[str]]]:
    """PDB name of every alternative, and alternatives of every PDB name, in a residue."""
    table = _alternatives()
    kind, own = table.get(residue, ("Protein", {}))
    others = {**table.get(kind, ("", {}))[1], **own}
    others = {name: [each for each in given if each not in own] for name, given in others.items()}
    if residue == "ILE":
        others.setdefault("CD1", []).append("CD")
    return {other: name for name, given in others.items() for other in given}, others


@cache
def _residue_names() -> dict[str, str]:
    root = ElementTree.parse(_DATA / "pdbNames.xml").getroot()
    found = {}
    for node in root.iterfind("Residue"):
        for key, value in node.items():
            if key.startswith("alt"):
                found[value] = node.get("name", "")
    return found


def standard_name(name: str) -> tuple[str, str]:
    """Return the PDB's name of a residue, and the protonation state that the given name says.

    Amber's HIE and NHIE, CHARMM's HSE and the PDB's HIS are one residue; WAT, TIP3 and HOH are another.
    """
    if name in STATE_PARENT:
        return STATE_PARENT[name]
    if name in STANDARD or name in CAPS or name in NUCLEOTIDES:
        return name, ""
    if len(name) == 4 and name[0] in "NC" and (name[1:] in STANDARD or name[1:] in STATE_PARENT):
        return standard_name(name[1:])
    return _residue_names().get(name, name), ""


def template_name(residue: str) -> str:
    """Return what Amber calls a residue of the PDB."""
    return "NHE" if residue == "NH2" else residue


def base_template(known: Mapping[str, Template], part: Part, i: int, state: str = "") -> Template | None:
    """Template of a residue in its place, without its hydrogens' state unless one is given.

    The first residue of a chain that is no ring is ``N...``, its last ``C...``, unless capped; first and last
    nucleotides have the names of their ends.
    """
    member = part.members[i]
    name = state or {"HIS": "HIE"}.get(member.name, template_name(member.name))
    ends = (i == 0, i == len(part.members) - 1)
    if member.name in NUCLEOTIDES:
        return known.get(
            member.name + {(True, True): "N", (True, False): "5", (False, True): "3"}.get(ends, "")
        )
    if part.obstacle or part.cyclic or member.is_cap or not any(ends):
        return known.get(name)
    return known.get(("N" if ends[0] else "C") + name)


def rename(atoms: list[gemmi.Atom], template: Template) -> list[str]:
    """Give atoms the PDB's names, where they have others.

    Returns
    -------
    list of str
        What was renamed: ``CD to CD1``.
    """
    present = {atom.name for atom in atoms}
    changed = []
    for atom in atoms:
        name = template.synonyms.get(atom.name)
        if atom.name not in template.element and name is not None and name not in present:
            changed.append(f"{atom.name} to {name}")
            present.add(name)
            atom.name = name
    return changed
