"""Residue templates of OpenMM's Amber files, with every synonym of an atom's name.

Names, elements, charges and bonds are read from the files. Scripts in them are never run.
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
from protochain.structure.molecule.residues import CAPS, LETTERS, LINKED, NUCLEOTIDES, STANDARD, STATE_PARENT

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
"""Parameters of glycans, with atom types of the protein force field."""
HAS_GLYCAM = "amber14"
"""Force field of proteins for these glycans."""
HAS_SAGE = "amber19"
"""Another force field of proteins that Sage is combined with."""
_BONDED = 2.2  # Angstrom. Largest bond length of an amino acid (C-S 1.8, S-S 2.0).
SMIRNOFF = "SMIRNOFF"
"""Root of OpenFF's .offxml files."""
NO_XML = "not a force-field XML file"
NO_OPENMM = "an OpenFF (SMIRNOFF) file, which only the OpenFF toolkit can apply"
CONVERT = (
    "give OpenMM XML: for a ligand with GAFF or OpenFF parameters that which openmmforcefields writes "
    "(debug_ffxml_filename), as amber14,ligand.xml"
)
PHOSPHATE_END = "5'-P-"
"""Prefix of the first nucleotide of a strand, with its phosphate."""
_FILES = ("protein.ff14SB.xml", "DNA.OL15.xml", "RNA.OL3.xml", "tip3p.xml")
_WATERS = ("SPCE", "TP3M", "TIP5", "OPC")  # Names of water in other programs, missing from OpenMM's table.
_KINDS = ("DNA-", "RNA-")  # Prefixes of atom types in OpenMM's files.
_EXTRA_POINT = "EP"  # Class of virtual sites, without a prefix.
_AT_ENDS = {"OXT", "OT1", "OT2", "P", "OP1", "OP2", "OP3", "O1P", "O2P", "O3P"}
"""Heavy atoms that depend on the place of a residue in a chain or at its end."""


@dataclass(frozen=True, eq=False)
class Template:
    """Residue template of a force field."""

    name: str  # Name in the force field: ``ALA``, ``NALA`` at the start of a chain, ``HIE``.
    element: Mapping[str, str]  # Element of each atom, by PDB name.
    charge: Mapping[str, float]  # e.
    bonds: tuple[tuple[str, str], ...]  # Bonds within the residue.
    # PDB name of every other name of an atom.
    synonyms: Mapping[str, str] = field(default_factory=dict)
    # Atom type of each atom in the force field, by PDB name.
    type: Mapping[str, str] = field(default_factory=dict)
    is_users: bool = False  # Whether it is from a file of the user.

    @cached_property
    def heavy(self) -> list[str]:
        """Names of the heavy atoms."""
        return [name for name, element in self.element.items() if element != "H"]

    @cached_property
    def outward(self) -> list[tuple[str, str]]:
        """Bonds in the order that names two hydrogens of a carbon: N and C last."""
        return sorted(self.bonds, key=lambda bond: max("ABGDEZHNC".find(name[1:2] or name) for name in bond))

    def neighbours(self, name: str) -> set[str]:
        """Names of the atoms bonded to an atom."""
        return {end for bond in self.bonds if name in bond for end in bond} - {name}

    def without_hydrogen(self, parent: str) -> "Template":
        """Return the template without the last hydrogen of a heavy atom, which another bond replaces."""
        cut = self.hydrogens.get(parent, [])[-1:]
        atoms = {name: element for name, element in self.element.items() if name not in cut}
        return replace(self, element=atoms, bonds=tuple(bond for bond in self.bonds if not {*bond} & {*cut}))

    def exchange(self, first: str, second: str) -> "Template":
        """Return the template with the names of two atoms of one element exchanged."""
        new = {first: second, second: first}
        return replace(
            self,
            charge={new.get(name, name): charge for name, charge in self.charge.items()},
            bonds=tuple((new.get(a, a), new.get(b, b)) for a, b in self.bonds),
            type={new.get(name, name): kind for name, kind in self.type.items()},
        )

    @cached_property
    def hydrogens(self) -> dict[str, list[str]]:
        """Names of the hydrogens bonded to each heavy atom."""
        children: dict[str, list[str]] = {}
        for first, second in self.bonds:
            for parent, child in ((first, second), (second, first)):
                if self.element[child] == "H" and self.element[parent] != "H":
                    children.setdefault(parent, []).append(child)
        return children


def templates(user_files: Sequence[Path] = ()) -> Mapping[str, Template]:
    """Templates by name: proteins, caps, nucleic acids, water and ions."""
    # Not cached because a user's file may change between calls.
    users = {name: replace(template, is_users=True) for name, template in _read(user_files).items()}
    return {**users, **_phosphates(), **_amber()}


def residue_names(user_files: Sequence[Path]) -> set[str]:
    """Names of the residues of force-field files."""
    return {*_read(user_files)}


@cache
def _phosphates() -> Mapping[str, Template]:
    loaded = _read([PROTEIN, PHOSPHATES["amber14"]])
    return {name: template for name, template in loaded.items() if name not in _amber()}


@cache
def _amber() -> Mapping[str, Template]:
    loaded: dict[str, Template] = {}
    for name in _FILES:
        loaded = {**_read([_DATA / "amber14" / name]), **loaded}
    ends = (_with_phosphate(loaded[name], loaded[f"{name}5"]) for name in sorted(NUCLEOTIDES))
    return loaded | {end.name: end for end in ends}


def _with_phosphate(inner: Template, end: Template) -> Template:
    """Template of a 5' end with its phosphate, without hydrogens (pKa 1, 6), with equal oxygens."""
    oxygens = ("OP1", "OP2", "OP3")
    other_charge = sum(charge for name, charge in inner.charge.items() if name not in oxygens)
    share = (sum(end.charge.values()) - 2.0 - other_charge) / len(oxygens)
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
        template = _amber()[PHOSPHATE_END + name]
        node = ElementTree.SubElement(residues, "Residue", name=template.name)
        for atom, charge in template.charge.items():
            ElementTree.SubElement(node, "Atom", name=atom, type=template.type[atom], charge=repr(charge))
        for first, second in template.bonds:
            ElementTree.SubElement(node, "Bond", atomName1=first, atomName2=second)
        ElementTree.SubElement(node, "ExternalBond", atomName="O3'")
    return ElementTree.tostring(root)


@cache
def strand_junctions(*files: str) -> bytes:
    """Return the terms of bonds between DNA and RNA as OpenMM XML, from the files of both.

    Both have AMBER's atom types, with prefixes. A term with O3'-P is repeated with one side in the types of
    the other kind. In LEaP, the types of OL3 and OL15 are of one set.
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
                prefix = next(term.attrib[key] for key in keys if term.attrib[key])[: len(_KINDS[0])]
                for k, ends in enumerate(pairwise(bare), 1):
                    if {*ends} != {"OS", "P"}:
                        continue
                    # The nucleotide with more of the atoms decides, or the nucleotide of O3' if equal.
                    is_first = 2 * k > len(bare) or (2 * k == len(bare) and ends[0] == "OS")
                    other_prefix = _KINDS[prefix == _KINDS[0]]
                    kinds = (prefix, other_prefix) if is_first else (other_prefix, prefix)
                    mixed = {f"type{i + 1}": name and kinds[i >= k] + name for i, name in enumerate(bare)}
                    ElementTree.SubElement(node, term.tag, values | mixed)
    return ElementTree.tostring(root)


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
    residues = []
    for file, root in roots.items():
        try:
            residues += [_template(node, elements) for node in root.iterfind("Residues/Residue")]
        except (KeyError, ValueError, IndexError) as error:
            raise StructureError(f"{file}: a residue in it cannot be read ({error!r})") from None
    return {template.name: template for template in residues}


def _template(node: ElementTree.Element, elements: Mapping[str | None, str]) -> Template:
    name = node.get("name", "")
    atoms = [atom for atom in node.iterfind("Atom") if elements.get(atom.get("type"), "")]
    order = [atom.get("name", "") for atom in atoms]
    primary, alternatives = _names(standard_name(name)[0]) if _is_listed(name, order) else ({}, {})
    names = {raw: primary.get(raw, raw) for raw in order}
    if names.get("H1") == "H":
        names["H1"] = "H1"  # The first hydrogen of a charged N terminus.
    synonyms: dict[str, str] = {}
    for raw in order:
        for synonym in (raw, primary.get(raw, raw), *alternatives.get(primary.get(raw, raw), ())):
            synonyms.setdefault(synonym, names[raw])
    bonds = []
    for bond in node.iterfind("Bond"):
        ends = [bond.get(f"atomName{i}") for i in (1, 2)]
        if None in ends:
            ends = [order[int(bond.get(end, ""))] for end in ("from", "to")]
        if ends[0] in names and ends[1] in names:
            bonds.append((names[str(ends[0])], names[str(ends[1])]))
    return Template(
        name,
        {names[raw]: elements[atom.get("type")] for raw, atom in zip(order, atoms, strict=True)},
        {names[raw]: float(atom.get("charge", 0.0)) for raw, atom in zip(order, atoms, strict=True)},
        tuple(bonds),
        {synonym: pdb_name for synonym, pdb_name in synonyms.items() if synonym not in set(names.values())},
        {names[raw]: atom.get("type", "") for raw, atom in zip(order, atoms, strict=True)},
    )


def _is_listed(name: str, atoms: Sequence[str]) -> bool:
    """Whether atoms may have synonyms of amino acids and nucleotides, unlike O1 of a ligand."""
    is_terminal = len(name) == 4 and name[0] in "NC"
    return is_terminal or standard_name(name)[0] in _alternatives() or {"N", "CA"} <= {*atoms}


@cache
def _alternatives() -> dict[str, tuple[str, dict[str, list[str]]]]:
    """Kind of each residue in OpenMM's table of names, and the alternative names of its atoms."""
    root = ElementTree.parse(_DATA / "pdbNames.xml").getroot()
    table = {}
    for node in root.iterfind("Residue"):
        atoms = {atom.get("name", ""): atom for atom in node.iterfind("Atom")}
        names = {name: [a for key, a in atom.items() if key != "name"] for name, atom in atoms.items()}
        table[node.get("name", "")] = node.get("type", ""), names
    return table


@cache
def _names(residue: str) -> tuple[dict[str, str], dict[str, list[str]]]:
    """PDB name of every alternative name, and alternatives of every PDB name, in a residue."""
    table = _alternatives()
    kind, names = table.get(residue, ("Protein", {}))
    aliases = {**table.get(kind, ("", {}))[1], **names}
    aliases = {name: [a for a in row if a not in names] for name, row in aliases.items()}
    if residue == "ILE":
        aliases.setdefault("CD1", []).append("CD")
    return {a: name for name, row in aliases.items() for a in row}, aliases


@cache
def _residue_names() -> dict[str, str]:
    root = ElementTree.parse(_DATA / "pdbNames.xml").getroot()
    names = dict.fromkeys(_WATERS, "HOH")
    for node in root.iterfind("Residue"):
        for key, value in node.items():
            if key.startswith("alt"):
                names[value] = node.get("name", "")
    return names


def standard_name(name: str) -> tuple[str, str]:
    """Return the PDB name of a residue, and the protonation state that the name (HIE, HSE) implies."""
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
    code: str, atoms: Collection[gemmi.Atom], library: Mapping[str, Template], stated: Collection[str] = ()
) -> tuple[str, str]:
    """Apply :func:`standard_name` if the atoms agree with its result, else return the name unchanged.

    ``stated`` are components with bonds in the file. The atoms of another residue do not rename them.

    Names have several meanings. ``NLN`` is asparagine with a sugar in GLYCAM, and norleucine's amide in the
    PDB archive. ``HSE`` is histidine in CHARMM, and homoserine. ``HIP`` is histidine in Amber, and its
    phosphate. ``NHE`` is a cap, and a buffer. ``CYN`` is cysteine, and cyanide. ``DCY`` is deoxycytidine in
    OpenMM's table, and D-cysteine.
    """
    name, state = standard_name(code)
    if name == code and name in (*STANDARD, *CAPS, "HOH"):
        return code, ""
    heavy = {atom.name for atom in atoms if not atom.is_hydrogen()}
    if (name == code or name in NUCLEOTIDES) and code not in stated and (match := _from_atoms(code, heavy)):
        return match, ""
    if name == code:
        return code, ""
    if name == "HOH":
        fits = [atom.element.name for atom in atoms if atom.element.atomic_number > 1] == ["O"]
    elif name in NUCLEOTIDES:
        fits = bool(heavy & {"C1'", "C1*"})
    else:
        template = library["HIP" if name == "HIS" else template_name(name)]
        like = (template, library["NALA"], library["CALA"])
        strange = heavy - {name for t in like for name in (*t.element, *t.synonyms)}
        lacking = {*template.heavy} - {template.synonyms.get(name, name) for name in heavy}
        # A complete amino acid with extra atoms has its name, unless the archive has a modified one so named.
        is_cut = lacking or code in LINKED or name not in STANDARD or archive_parent(code)
        fits = not (strange and is_cut) and (name not in STANDARD or "CA" in heavy)
    return (name, state) if fits else (code, "")


def _from_atoms(code: str, heavy: set[str]) -> str:
    """Standard residue with these heavy atoms (GLUP, ARN, RA ...), unless an archive's component has them."""
    if code == "UNK" and {"N", "CA", "C"} <= heavy <= {"N", "CA", "C", "O", "CB", *_AT_ENDS}:
        return "ALA" if "CB" in heavy else "GLY"
    is_nucleic, is_amino = bool(heavy & {"C1'", "C1*"}), {"N", "CA", "C", "O", "CB"} < heavy
    if (
        not (is_nucleic or is_amino)
        or (code in _amber() and standard_name(code)[0] not in NUCLEOTIDES)
        or archive_parent(code)
    ):
        return ""
    for name in sorted(NUCLEOTIDES) if is_nucleic else STANDARD:
        template = _amber()["HIP" if name == "HIS" else name]
        if {template.synonyms.get(name, name) for name in heavy} - _AT_ENDS == {*template.heavy} - _AT_ENDS:
            # A nucleotide of the archive may be incomplete, or another arrangement of the same atoms.
            present, listed = heavy - _AT_ENDS, heavy_atoms(code) - _AT_ENDS
            is_listed = present <= listed if is_nucleic and code not in NUCLEOTIDES else present == listed
            return "" if is_listed and code not in NUCLEOTIDES else name
    return ""


def archive_parent(name: str) -> str:
    """Return the standard parent of an amino acid of the PDB archive, or an empty string."""
    if name in _PARENTS:
        return _PARENTS[name]
    info = gemmi.find_tabulated_residue(name)
    if info is not None and info.is_amino_acid():
        return _PARENT_OF_LETTER.get(info.one_letter_code.upper(), "")
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
"""Parents from PDBFixer 1.12 (see NOTICE). The archive lacks the parents of most of these names."""
_PARENT_OF_LETTER = LETTERS | {"U": "CYS", "O": "LYS", "B": "ASN", "Z": "GLN"}
"""Selenocysteine, pyrrolysine, B and Z become the standard residues like them."""


def template_name(residue: str) -> str:
    """Return Amber's name of a residue of the PDB."""
    return "NHE" if residue == "NH2" else residue


def other_names(atoms: Iterable[gemmi.Atom], template: Template) -> Iterator[str]:
    """Yield synonyms of the parent's atom names: O1 of a modified residue is O, but not in a sulphate."""
    present = {atom.name: atom for atom in atoms}
    for synonym, name in template.synonyms.items():
        if synonym in present and name not in present:
            partners = [end for bond in template.bonds if name in bond for end in bond if end != name]
            partner_positions = [present[end].pos for end in partners if end in present]
            if any(present[synonym].pos.dist(at) < _BONDED for at in partner_positions):
                yield synonym


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
