"""Residue templates of OpenMM's Amber files, with every synonym of an atom's name.

Names, elements, charges and bonds are read from the files; scripts in them are never run.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import gemmi
from openmm import app

from protochain.core.errors import StructureError
from protochain.ligands.dictionary import heavy_atoms
from protochain.structure.molecule.residues import CAPS, LINKED, NUCLEOTIDES, STANDARD, STATE_PARENT

_DATA = Path(app.__file__).parent / "data"
PHOSPHATES = {
    name: Path(__file__).parents[1] / "forcefields" / file
    for name, file in (("amber14", "phosaa14SB.xml"), ("amber19", "phosaa19SB.xml"))
}
"""Parameters of phosphorylated residues, by the force field of the others."""
PROTEIN = _DATA / "amber14" / "protein.ff14SB.xml"
"""The default force field of proteins."""
DNA, RNA = _DATA / "amber14" / "DNA.OL15.xml", _DATA / "amber14" / "RNA.OL3.xml"
GLYCAM = _DATA / "amber14" / "GLYCAM_06j-1.xml"
"""Parameters of glycans, with the atom types of the protein's."""
HAS_GLYCAM = "amber14"
"""The force field that they were made for."""
HAS_SAGE = "amber19"
"""The other one whose residues Sage goes with."""
_BONDED = 2.2
"""Angstrom: no bond of an amino acid is longer (C-S 1.8, S-S 2.0)."""
SMIRNOFF = "SMIRNOFF"
"""Root of OpenFF's .offxml files."""
NO_XML = "not a force-field XML file"
NO_OPENMM = "an OpenFF (SMIRNOFF) file, which only the OpenFF toolkit can apply"
CONVERT = (
    "give OpenMM XML: for a ligand with GAFF or OpenFF parameters that which openmmforcefields writes "
    "(debug_ffxml_filename), as amber14,ligand.xml"
)
PHOSPHATE_END = "5'-P-"
"""Before the name of a nucleotide: the first one of a strand, with its phosphate."""
_FILES = ("protein.ff14SB.xml", "DNA.OL15.xml", "RNA.OL3.xml", "tip3p.xml")


@dataclass(frozen=True, eq=False)
class Template:
    """Residue template of a force field."""

    name: str  # Name in the force field: ``ALA``, ``NALA`` at the start of a chain, ``HIE``.
    element: Mapping[str, str]  # Element of each atom, by PDB name.
    charge: Mapping[str, float]  # e.
    bonds: tuple[tuple[str, str], ...]  # Bonds within the residue.
    synonyms: Mapping[str, str]  # PDB name of every other name of an atom.
    # Atom type of each atom in the force field, by PDB name.
    type: Mapping[str, str] = field(default_factory=dict)
    is_users: bool = False  # Whether it is from a file of the user's.

    @cached_property
    def heavy(self) -> list[str]:
        """Names of the heavy atoms."""
        return [name for name, element in self.element.items() if element != "H"]

    @cached_property
    def outward(self) -> list[tuple[str, str]]:
        """Its bonds in the order by which two hydrogens of a carbon are named: N and C last."""
        return sorted(self.bonds, key=lambda bond: max("ABGDEZHNC".find(name[1:2] or name) for name in bond))

    def neighbours(self, name: str) -> set[str]:
        """Names of the atoms bonded to an atom."""
        return {end for bond in self.bonds if name in bond for end in bond} - {name}

    def without_hydrogen(self, parent: str) -> "Template":
        """Return the template without the last hydrogen of a heavy atom, whose place another bond takes."""
        gone = self.hydrogens.get(parent, [])[-1:]
        kept = {name: element for name, element in self.element.items() if name not in gone}
        return replace(self, element=kept, bonds=tuple(bond for bond in self.bonds if not {*bond} & {*gone}))

    def exchange(self, first: str, second: str) -> "Template":
        """Return the template with the names of two atoms of one element exchanged."""
        new = {first: second, second: first}
        return replace(
            self,
            charge={new.get(name, name): charge for name, charge in self.charge.items()},
            bonds=tuple((new.get(a, a), new.get(b, b)) for a, b in self.bonds),
            type={new.get(name, name): its for name, its in self.type.items()},
        )

    @cached_property
    def hydrogens(self) -> dict[str, list[str]]:
        """Names of the hydrogens bonded to each heavy atom."""
        found: dict[str, list[str]] = {}
        for first, second in self.bonds:
            for parent, child in ((first, second), (second, first)):
                if self.element[child] == "H" and self.element[parent] != "H":
                    found.setdefault(parent, []).append(child)
        return found


def templates(user_files: Sequence[Path] = ()) -> Mapping[str, Template]:
    """Templates by name: proteins, caps, nucleic acids, water and ions."""
    # A user's file may change between calls.
    own = {name: replace(each, is_users=True) for name, each in _read(user_files).items()}
    return {**own, **_phosphates(), **_amber()}


def residue_names(user_files: Sequence[Path]) -> set[str]:
    """Names of the residues of force-field files."""
    return {*_read(user_files)}


@cache
def _phosphates() -> Mapping[str, Template]:
    known = _read([PROTEIN, PHOSPHATES["amber14"]])
    return {name: template for name, template in known.items() if name not in _amber()}


@cache
def _amber() -> Mapping[str, Template]:
    known: dict[str, Template] = {}
    for name in _FILES:
        known = {**_read([_DATA / "amber14" / name]), **known}
    ends = (_with_phosphate(known[name], known[f"{name}5"]) for name in sorted(NUCLEOTIDES))
    return known | {each.name: each for each in ends}


def _with_phosphate(inner: Template, end: Template) -> Template:
    """Template of a 5' end with its phosphate, without hydrogens (pKa 1, 6); its oxygens are equal."""
    oxygens = ("OP1", "OP2", "OP3")
    rest = sum(charge for name, charge in inner.charge.items() if name not in oxygens)
    share = (sum(end.charge.values()) - 2.0 - rest) / len(oxygens)
    return replace(
        inner,
        name=PHOSPHATE_END + inner.name,
        element={**inner.element, "OP3": "O"},
        charge={**inner.charge, **dict.fromkeys(oxygens, share)},
        bonds=(*inner.bonds, ("P", "OP3")),
        synonyms={**inner.synonyms, "O3P": "OP3"},
        type={**inner.type, "OP3": inner.type["OP1"]},
    )


@cache
def phosphate_ends() -> bytes:
    """Return the 5' ends with phosphates as OpenMM XML, with the atom types of OL15, OL21 and OL3."""
    root = ElementTree.Element("ForceField")
    residues = ElementTree.SubElement(root, "Residues")
    for name in sorted(NUCLEOTIDES):
        its = _amber()[PHOSPHATE_END + name]
        node = ElementTree.SubElement(residues, "Residue", name=its.name)
        for each, charge in its.charge.items():
            ElementTree.SubElement(node, "Atom", name=each, type=its.type[each], charge=repr(charge))
        for first, second in its.bonds:
            ElementTree.SubElement(node, "Bond", atomName1=first, atomName2=second)
        ElementTree.SubElement(node, "ExternalBond", atomName="O3'")
    return ElementTree.tostring(root)


@cache
def strand_junctions(*files: str) -> bytes:
    """Return the terms of bonds between DNA and RNA as OpenMM XML, from the files of both.

    Both have AMBER's atom types, under prefixes. A term with O3'-P is repeated with one side in the types of
    the other kind, as in LEaP, where the types of OL3 and OL15 are of one set.
    """
    root = ElementTree.Element("ForceField")
    for file in files:
        source = ElementTree.parse(file).getroot()
        for section in ("HarmonicBondForce", "HarmonicAngleForce", "PeriodicTorsionForce"):
            terms = source.find(section)
            assert terms is not None
            node = ElementTree.SubElement(root, section, terms.attrib)
            for term in terms:
                keys = [key for n in "1234" for key in (f"type{n}", f"class{n}") if key in term.attrib]
                if any(term.attrib[key] == _EXTRA_POINT for key in keys):
                    continue
                bare = [term.attrib[key][len(_KINDS[0]) :] for key in keys]
                values = {key: value for key, value in term.attrib.items() if key not in keys}
                own = next(term.attrib[key] for key in keys if term.attrib[key])[: len(_KINDS[0])]
                for k, ends in enumerate(pairwise(bare), 1):
                    if {*ends} != {"OS", "P"}:
                        continue
                    # Of the nucleotide with more of the atoms; of equal ones, that of O3'.
                    is_first = 2 * k > len(bare) or (2 * k == len(bare) and ends[0] == "OS")
                    other = _KINDS[own == _KINDS[0]]
                    kinds = (own, other) if is_first else (other, own)
                    mixed = {f"type{i + 1}": name and kinds[i >= k] + name for i, name in enumerate(bare)}
                    ElementTree.SubElement(node, term.tag, values | mixed)
    return ElementTree.tostring(root)


_KINDS = ("DNA-", "RNA-")
"""Prefixes of the atom types of OpenMM's files."""
_EXTRA_POINT = "EP"
"""Class of virtual sites, without a prefix."""


def _read(files: Sequence[Path]) -> dict[str, Template]:
    roots = {}
    for file in files:
        try:
            roots[file] = ElementTree.parse(file).getroot()
        except (OSError, ElementTree.ParseError) as error:
            raise StructureError(f"{file}: {NO_XML} ({error}); {CONVERT}") from None
        if roots[file].tag == SMIRNOFF:
            raise StructureError(f"{file}: {NO_OPENMM}; {CONVERT}")
    elements = {node.get("name"): node.get("element", "") for r in roots.values() for node in r.iter("Type")}
    made = []
    for file, root in roots.items():
        try:
            made += [_template(node, elements) for node in root.iterfind("Residues/Residue")]
        except (KeyError, ValueError, IndexError) as error:
            raise StructureError(f"{file}: a residue in it cannot be read ({error!r})") from None
    return {template.name: template for template in made}


def _template(node: ElementTree.Element, elements: Mapping[str | None, str]) -> Template:
    name = node.get("name", "")
    atoms = [atom for atom in node.iterfind("Atom") if elements.get(atom.get("type"), "")]
    order = [atom.get("name", "") for atom in atoms]
    primary, others = _names(standard_name(name)[0]) if _is_listed(name, order) else ({}, {})
    called = {given: _called(given, primary) for given in order}
    synonyms: dict[str, str] = {}
    for given in order:
        for other in (given, primary.get(given, given), *others.get(primary.get(given, given), ())):
            synonyms.setdefault(other, called[given])
    bonds = []
    for bond in node.iterfind("Bond"):
        ends = [bond.get(f"atomName{i}") for i in (1, 2)]
        if None in ends:
            ends = [order[int(bond.get(end, ""))] for end in ("from", "to")]
        if ends[0] in called and ends[1] in called:
            bonds.append((called[str(ends[0])], called[str(ends[1])]))
    return Template(
        name,
        {called[given]: elements[atom.get("type")] for given, atom in zip(order, atoms, strict=True)},
        {called[given]: float(atom.get("charge", 0.0)) for given, atom in zip(order, atoms, strict=True)},
        tuple(bonds),
        {other: pdb_name for other, pdb_name in synonyms.items() if other not in set(called.values())},
        {called[given]: atom.get("type", "") for given, atom in zip(order, atoms, strict=True)},
    )


def _is_listed(name: str, atoms: Sequence[str]) -> bool:
    """Whether atoms may have the other names of amino acids and nucleotides: a ligand's O1 is not its O."""
    is_terminal = len(name) == 4 and name[0] in "NC"
    return is_terminal or standard_name(name)[0] in _alternatives() or {"N", "CA"} <= {*atoms}


def _called(given: str, primary: Mapping[str, str]) -> str:
    """PDB name of an atom; the first hydrogen of a charged N terminus is H1."""
    return given if given == "H1" and primary.get(given) == "H" else primary.get(given, given)


@cache
def _alternatives() -> dict[str, tuple[str, dict[str, list[str]]]]:
    """Kind of each residue in OpenMM's table of names, and the alternative names of its atoms."""
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
    """PDB name of every alternative name, and alternatives of every PDB name, in a residue."""
    table = _alternatives()
    kind, names = table.get(residue, ("Protein", {}))
    others = {**table.get(kind, ("", {}))[1], **names}
    others = {name: [each for each in given if each not in names] for name, given in others.items()}
    if residue == "ILE":
        others.setdefault("CD1", []).append("CD")
    return {other: name for name, given in others.items() for other in given}, others


_WATERS = ("SPCE", "TP3M", "TIP5", "OPC")
"""Names of programs that OpenMM's table lacks."""


@cache
def _residue_names() -> dict[str, str]:
    root = ElementTree.parse(_DATA / "pdbNames.xml").getroot()
    found = dict.fromkeys(_WATERS, "HOH")
    for node in root.iterfind("Residue"):
        for key, value in node.items():
            if key.startswith("alt"):
                found[value] = node.get("name", "")
    return found


def standard_name(name: str) -> tuple[str, str]:
    """Return the PDB name of a residue, and the protonation state that the given name (HIE, HSE) implies."""
    if name in STATE_PARENT:
        return STATE_PARENT[name]
    if name in LINKED:
        return LINKED[name], ""
    if name in STANDARD or name in CAPS or name in NUCLEOTIDES:
        return name, ""
    if len(name) == 4 and name[0] in "NC" and name[1:] in {*STANDARD, *STATE_PARENT, *LINKED}:
        return standard_name(name[1:])
    return _residue_names().get(name, name), ""


def name_by_atoms(
    given: str, atoms: Collection[gemmi.Atom], known: Mapping[str, Template], own: Collection[str] = ()
) -> tuple[str, str]:
    """Return what :func:`standard_name` does of a name that has this meaning with these atoms, or as given.

    ``own`` are components whose bonds the file states: another name's atoms do not make them that.

    Names mean several things: ``NLN`` is asparagine with a sugar in GLYCAM, and norleucine's amide in the PDB
    archive; ``HSE`` histidine in CHARMM, and homoserine; ``HIP`` histidine in Amber, and its phosphate;
    ``NHE`` a cap, and a buffer; ``CYN`` cysteine, and cyanide; ``DCY`` deoxycytidine in OpenMM's table, and
    D-cysteine.
    """
    name, state = standard_name(given)
    if name == given and name in (*STANDARD, *CAPS, "HOH"):
        return given, ""
    heavy = {atom.name for atom in atoms if not atom.is_hydrogen()}
    if (name == given or name in NUCLEOTIDES) and given not in own and (found := _of_atoms(given, heavy)):
        return found, ""
    if name == given:
        return given, ""
    if name == "HOH":
        fits = [atom.element.name for atom in atoms if atom.element.atomic_number > 1] == ["O"]
    elif name in NUCLEOTIDES:
        fits = bool(heavy & {"C1'", "C1*"})
    else:
        template = known["HIP" if name == "HIS" else template_name(name)]
        like = (template, known["NALA"], known["CALA"])
        strange = heavy - {name for each in like for name in (*each.element, *each.synonyms)}
        lacking = {*template.heavy} - {template.synonyms.get(each, each) for each in heavy}
        # A whole amino acid with another atom is that, or a modified one if the archive has one so named.
        is_cut = lacking or given in LINKED or name not in STANDARD or archive_parent(given)
        fits = not (strange and is_cut) and (name not in STANDARD or "CA" in heavy)
    return (name, state) if fits else (given, "")


def _of_atoms(given: str, heavy: set[str]) -> str:
    """Standard residue with these heavy atoms (GLUP, ARN, RA ...), unless an archive's component has them."""
    if given == "UNK" and {"N", "CA", "C"} <= heavy <= {"N", "CA", "C", "O", "CB", *_OF_ENDS}:
        return "ALA" if "CB" in heavy else "GLY"
    is_nucleic, is_amino = bool(heavy & {"C1'", "C1*"}), {"N", "CA", "C", "O", "CB"} < heavy
    if (
        not (is_nucleic or is_amino)
        or (given in _amber() and standard_name(given)[0] not in NUCLEOTIDES)
        or archive_parent(given)
    ):
        return ""
    for name in sorted(NUCLEOTIDES) if is_nucleic else STANDARD:
        template = _amber()["HIP" if name == "HIS" else name]
        if {template.synonyms.get(each, each) for each in heavy} - _OF_ENDS == {*template.heavy} - _OF_ENDS:
            # A nucleotide of the archive may be incomplete here, or another arrangement of the same atoms.
            own, its = heavy - _OF_ENDS, heavy_atoms(given) - _OF_ENDS
            is_its = own <= its if is_nucleic and given not in NUCLEOTIDES else own == its
            return "" if is_its and given not in NUCLEOTIDES else name
    return ""


_OF_ENDS = {"OXT", "OT1", "OT2", "P", "OP1", "OP2", "OP3", "O1P", "O2P", "O3P"}
"""Heavy atoms that a residue has or not, as it is within a chain or at its end."""


def archive_parent(name: str) -> str:
    """Return the standard amino acid that one of the PDB archive derives from, or an empty string."""
    if name in _PARENTS:
        return _PARENTS[name]
    info = gemmi.find_tabulated_residue(name)
    if info is not None and info.is_amino_acid():
        return _OF_LETTER.get(info.one_letter_code.upper(), "")
    return ""


_PARENTS = {
    name: parent
    for parent, names in {
        "ASP": "2AS ASA ASB ASK ASL ASQ BHD DAS DSP IAS", "HIS": "3AH DHI HIC HIP MHS NEM NEP",
        "GLU": "5HP CGU DGL GGL GMA PCA", "LYS": "5OW ALY DLY KCX LLP LLY LYM LYZ SHR TRG",
        "ARG": "ACL AGM ARM DAR HAR HMR",
        "ALA": "AIB ALM AYA BNN CHG CSD DAL DHA DNP FLA HAC MAA PRR TIH TPQ", "THR": "ALO BMT DTH TPO",
        "CYS": "BCS BUC C5C C6C CAS CCS CEA CME CSO CSP CSS CSW CSX CY1 CY3 CYG CYM CYQ DCY EFC OCS PEC "
               "PR3 PYX SCH SCS SCY SHC SMC SOC",
        "LEU": "BUG CLE DLE MK8 MLE NLE NLN NLP", "MET": "CXM FME MSE OMT", "PHE": "DAH DPN HPQ PHI PHL",
        "GLN": "DGN", "ILE": "DIL IIL", "VAL": "DIV DVA MVA", "PRO": "DPR HYP",
        "SER": "DSN MIS OAS SAC SEL SEP SET SVA", "TRP": "DTR HTR LTR TPL TRO",
        "TYR": "DTY IYR PAQ PTR STY TYB TYI TYQ TYS TYY", "GLY": "GL3 GLZ GSC MPQ MSA NMC SAR", "ASN": "MEN",
    }.items()
    for name in names.split()
}  # fmt: skip
"""Of PDBFixer 1.12 (see NOTICE); the archive says nothing of the parents of most of these names."""
_OF_LETTER = {letter: name for name, letter in STANDARD.items()} | {
    "U": "CYS", "O": "LYS", "B": "ASN", "Z": "GLN"
}  # fmt: skip
"""Selenocysteine, pyrrolysine, and what is an acid or its amide, become the standard ones like them."""


def template_name(residue: str) -> str:
    """Return Amber's name of a residue of the PDB."""
    return "NHE" if residue == "NH2" else residue


def other_names(atoms: Iterable[gemmi.Atom], template: Template) -> Iterator[str]:
    """Yield names by which atoms of a modified residue mean its parent's: O1 is O, but not in a sulphate."""
    there = {atom.name: atom for atom in atoms}
    for other, name in template.synonyms.items():
        if other in there and name not in there:
            partners = [end for bond in template.bonds if name in bond for end in bond if end != name]
            beside = [there[end].pos for end in partners if end in there]
            if any(there[other].pos.dist(at) < _BONDED for at in beside):
                yield other


def rename(atoms: list[gemmi.Atom], template: Template) -> list[tuple[str, str]]:
    """Rename atoms to their PDB names."""
    present = {atom.name for atom in atoms}
    changed = []
    for atom in atoms:
        name = template.synonyms.get(atom.name)
        if atom.name not in template.element and name is not None and name not in present:
            changed.append((atom.name, name))
            present.add(name)
            atom.name = name
    return changed
