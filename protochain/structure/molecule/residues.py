"""Tables of chemistry: known residues, and the four atoms that define each dihedral.

Dihedrals follow IUPAC-IUB (Biochemistry 9:3471, 1970). A trailing ``+`` or ``-`` on an atom name means
the next or the previous residue of the chain.
"""

from dataclasses import dataclass

STANDARD = {
    "ALA": "A", "ARG": "R", "ASN": "N", "ASP": "D", "CYS": "C", "GLN": "Q", "GLU": "E", "GLY": "G",
    "HIS": "H", "ILE": "I", "LEU": "L", "LYS": "K", "MET": "M", "PHE": "F", "PRO": "P", "SER": "S",
    "THR": "T", "TRP": "W", "TYR": "Y", "VAL": "V",
}  # fmt: skip
"""The 20 standard amino acids and their one-letter codes."""
LETTERS = {letter: name for name, letter in STANDARD.items()}

CAPS = frozenset({"ACE", "NME", "NH2"})
"""Terminal caps with force-field parameters."""

NUCLEOTIDES = frozenset({"A", "C", "G", "U", "DA", "DC", "DG", "DT"})
"""Residue names of RNA and DNA."""

STATE_PARENT = {
    "HID": ("HIS", "HID"), "HIE": ("HIS", "HIE"), "HIP": ("HIS", "HIP"), "HSD": ("HIS", "HID"),
    "HSE": ("HIS", "HIE"), "HSP": ("HIS", "HIP"), "CYX": ("CYS", ""), "CYM": ("CYS", "CYM"),
    "ASH": ("ASP", "ASH"), "GLH": ("GLU", "GLH"), "LYN": ("LYS", "LYN"),
    "HISA": ("HIS", "HID"), "HISD": ("HIS", "HID"), "HISB": ("HIS", "HIE"), "HISE": ("HIS", "HIE"),
    "HISH": ("HIS", "HIP"), "LYSH": ("LYS", ""), "CYSH": ("CYS", ""), "CYS2": ("CYS", ""),
    "ASPH": ("ASP", "ASH"), "GLUH": ("GLU", "GLH"), "ASPP": ("ASP", "ASH"), "GLUP": ("GLU", "GLH"),
    "LSN": ("LYS", "LYN"), "LYSN": ("LYS", "LYN"), "HIS1": ("HIS", "HID"), "CYN": ("CYS", ""),
    "S1P": ("SEP", "S1P"), "T1P": ("TPO", "T1P"), "Y1P": ("PTR", "Y1P"),
}  # fmt: skip
"""Standard residue and protonation state of the state names of Amber, CHARMM and GROMACS."""

LINKED = {"NLN": "ASN", "OLS": "SER", "OLT": "THR", "OLP": "HYP"}
"""GLYCAM names of glycosylated residues."""

PHOSPHORYLATED = frozenset({"SEP", "TPO", "PTR"})
"""Phosphates of serine, threonine and tyrosine."""

D_NAMES = {
    "ALA": "DAL", "ARG": "DAR", "ASN": "DSG", "ASP": "DAS", "CYS": "DCY", "GLN": "DGN", "GLU": "DGL",
    "HIS": "DHI", "ILE": "DIL", "LEU": "DLE", "LYS": "DLY", "MET": "MED", "PHE": "DPN", "PRO": "DPR",
    "SER": "DSN", "THR": "DTH", "TRP": "DTR", "TYR": "DTY", "VAL": "DVA",
}  # fmt: skip
"""Names of the mirror images of the standard amino acids in the PDB archive."""

VAN_DER_WAALS = {"H": 0.110, "C": 0.170, "N": 0.155, "O": 0.152, "S": 0.180}
"""nm: Mantina, Chamberlin, Valero, Cramer, Truhlar, J. Phys. Chem. A 113:5806 (2009)."""

PKA = {
    "ASP": (4.4, "ASH"), "GLU": (4.4, "GLH"), "HIS": (6.5, "HIP"),
    "SEP": (5.6, "S1P"), "TPO": (5.9, "T1P"), "PTR": (5.9, "Y1P"),
}  # fmt: skip
"""pKa, and the state at or below it, from OpenMM's ``hydrogens.xml``, and the second pKa of phosphates
(Xie, Jiang, Ben-Amotz, Anal. Biochem. 343:223, 2005)."""
PKA_BASE = {"CYS": (8.5, "CYM"), "LYS": (10.0, "LYN")}
"""pKa, and the state above it."""

OF_ALANINE = frozenset({"N", "H", "H1", "H2", "H3", "CA", "HA", "HA2", "HA3", "C", "O", "OXT"})
"""Atoms of a modified residue with the parameters of alanine, or of glycine without CB."""

BACKBONE = ("N", "CA", "C")
"""Atoms required to rebuild a residue."""

PHI = ("C-", "N", "CA", "C")
PSI = ("N", "CA", "C", "N+")
PSI_TERMINAL = ("N", "CA", "C", "O")
"""psi of the last residue, defined by the first oxygen of its carboxylate."""
OMEGA = ("CA", "C", "N+", "CA+")

_CG = ("N", "CA", "CB", "CG")
_CD = ("CA", "CB", "CG", "CD")
CHI: dict[str, tuple[tuple[str, str, str, str], ...]] = {
    "ARG": (_CG, _CD, ("CB", "CG", "CD", "NE"), ("CG", "CD", "NE", "CZ"), ("CD", "NE", "CZ", "NH1")),
    "ASN": (_CG, ("CA", "CB", "CG", "OD1")),
    "ASP": (_CG, ("CA", "CB", "CG", "OD1")),
    "CYS": (("N", "CA", "CB", "SG"),),
    "GLN": (_CG, _CD, ("CB", "CG", "CD", "OE1")),
    "GLU": (_CG, _CD, ("CB", "CG", "CD", "OE1")),
    "HIS": (_CG, ("CA", "CB", "CG", "ND1")),
    "ILE": (("N", "CA", "CB", "CG1"), ("CA", "CB", "CG1", "CD1")),
    "LEU": (_CG, ("CA", "CB", "CG", "CD1")),
    "LYS": (_CG, _CD, ("CB", "CG", "CD", "CE"), ("CG", "CD", "CE", "NZ")),
    "MET": (_CG, ("CA", "CB", "CG", "SD"), ("CB", "CG", "SD", "CE")),
    "PHE": (_CG, ("CA", "CB", "CG", "CD1")),
    "SER": (("N", "CA", "CB", "OG"),),
    "THR": (("N", "CA", "CB", "OG1"),),
    "TRP": (_CG, ("CA", "CB", "CG", "CD1")),
    "TYR": (_CG, ("CA", "CB", "CG", "CD1")),
    "VAL": (("N", "CA", "CB", "CG1"),),
}
"""chi1, chi2, ... of each residue. Proline has none because its ring is rigid."""
SYMMETRIC = frozenset({"ASP", "GLU", "PHE", "TYR"})
"""Residues whose last chi repeats after 180 degrees because two atoms are equal."""

ROTORS: dict[str, tuple[tuple[str, str, str, str], ...]] = {
    "ALA": (("N", "CA", "CB", "HB1"),),
    "ASP": (("CB", "CG", "OD2", "HD2"),),
    "CYS": (("CA", "CB", "SG", "HG"),),
    "GLU": (("CG", "CD", "OE2", "HE2"),),
    "ILE": (("CA", "CB", "CG2", "HG21"), ("CB", "CG1", "CD1", "HD11")),
    "LEU": (("CB", "CG", "CD1", "HD11"), ("CB", "CG", "CD2", "HD21")),
    "LYS": (("CD", "CE", "NZ", "HZ1"),),
    "MET": (("CG", "SD", "CE", "HE1"),),
    "SER": (("CA", "CB", "OG", "HG"),),
    "THR": (("CA", "CB", "CG2", "HG21"), ("CA", "CB", "OG1", "HG1")),
    "TYR": (("CE1", "CZ", "OH", "HH"),),
    "VAL": (("CA", "CB", "CG1", "HG11"), ("CA", "CB", "CG2", "HG21")),
}
"""Methyl, hydroxyl, thiol and amine rotors, each defined by a hydrogen that must be present."""

ROTOR_N_TERMINAL = ("C", "CA", "N", "H1")
"""The charged amine at the start of a chain."""

_BACKBONE_TORSIONS = {
    "alpha": ("O3'-", "P", "O5'", "C5'"), "beta": ("P", "O5'", "C5'", "C4'"),
    "gamma": ("O5'", "C5'", "C4'", "C3'"), "epsilon": ("C4'", "C3'", "O3'", "P+"),
    "zeta": ("C3'", "O3'", "P+", "O5'+"),
}  # fmt: skip
NUCLEIC = {
    name: {
        **_BACKBONE_TORSIONS,
        "base": ("O4'", "C1'", *(("N9", "C4") if name[-1] in "AG" else ("N1", "C2"))),
    }
    for name in sorted(NUCLEOTIDES)
}
"""Torsions of nucleotides (IUPAC-IUB, Eur. J. Biochem. 131:9, 1983) without delta and the torsions of the
sugar, whose ring is rigid. ``base`` is chi."""


BLANK = "(blank)"
"""Name of a chain without an id."""


def name_in_file(name: str, is_d: bool) -> str:
    """Name of a residue in a file. A D-amino acid has its D name, not the name of its mirror image."""
    return D_NAMES.get(name, name) if is_d else name


@dataclass(frozen=True)
class Residue:
    """A residue by its name in a file, with the text ``A:GLU17``."""

    chain: str  # Empty for a chain without an id.
    number: str  # With its insertion code.
    name: str

    def __str__(self) -> str:
        return self.label

    @property
    def chain_name(self) -> str:
        """Name of its chain."""
        return self.chain or BLANK

    @property
    def place(self) -> str:
        """Chain and number: ``A:17``."""
        return f"{self.chain}:{self.number}" if self.chain else self.number

    @property
    def label(self) -> str:
        """Chain, name and number: ``A:GLU17``, or ``A:SO4 301`` if the name ends in a digit."""
        name = f"{self.name} " if self.name[-1:].isdigit() else self.name
        return f"{self.chain}:{name}{self.number}" if self.chain else f"{name}{self.number}"


@dataclass(frozen=True)
class Atom:
    """An atom of a residue, with the text ``CG of A:GLU17``."""

    name: str
    residue: Residue

    def __str__(self) -> str:
        return f"{self.name} of {self.residue}"
