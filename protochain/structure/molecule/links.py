"""Bonds and possible bonds between the protein and hetero molecules, and their lengths."""

from dataclasses import dataclass

import gemmi

from protochain.structure.molecule.member import Member
from protochain.structure.molecule.residues import Atom

_OXYGEN_DISTANCE = {
    "Na": 2.38, "Mg": 2.07, "K": 2.74, "Ca": 2.36, "Mn": 2.15, "Fe": 2.04, "Co": 2.05, "Ni": 2.06,
    "Cu": 1.99, "Zn": 1.99,
}  # fmt: skip
"""Angstrom, usual distance of oxygen in proteins (Harding, Acta Cryst. D62:678, 2006), of Ni by radius."""
_OTHER_METAL = 2.3  # Angstrom. Usual distance of oxygen for metals outside the table.
_SLACK = {"O": 0.5, "N": 0.5, "S": 0.75, "Se": 0.85}
"""Angstrom. Largest excess of a bonded donor over the usual distance of oxygen. Sulphur is larger."""
_AXIAL = 1.2
"""Angstrom. Excess for methionine at blue copper, at 2.8 to 3.1 angstrom (Guss, Freeman, J. Mol. Biol.
169:521, 1983)."""
_TRIPLE = 1.35  # Angstrom. Largest distance of the only heavy neighbour of the carbon of cyanide or CO.
_TOO_NEAR = 0.6  # Angstrom. A donor closer to a metal than usual by more overlaps the metal.


@dataclass(frozen=True, eq=False)
class Link:
    """Atom of the protein and atom of a hetero molecule, bonded or perhaps bonded."""

    member: Member
    atom: gemmi.Atom
    hetero: Member  # Hetero molecule.
    hetero_atom: gemmi.Atom
    stated: bool = False  # Whether the file states a bond.

    def __str__(self) -> str:
        return " and ".join(map(str, self.atoms))

    @property
    def atoms(self) -> tuple[Atom, Atom]:
        """Names of the atoms in files."""
        return Atom(self.atom.name, self.member.residue), Atom(self.hetero_atom.name, self.hetero.residue)

    @property
    def is_metal(self) -> bool:
        """Whether a metal is bonded."""
        return is_metal(self.hetero_atom.element.name)

    @property
    def is_coordinated(self) -> bool:
        """Whether an atom coordinates a metal: a donor at a usual distance, or a bond stated by the file."""
        usual = _OXYGEN_DISTANCE.get(self.hetero_atom.element.name, _OTHER_METAL)
        if self.stated or self.length < usual - _TOO_NEAR:
            return self.length >= usual - _TOO_NEAR
        slack = _SLACK.get("N" if self._is_carbonyl else self.atom.element.name)
        if (self.atom.name, self.hetero_atom.element.name) == ("SD", "Cu"):
            slack = _AXIAL
        # An amide nitrogen of the chain has no free pair of electrons.
        is_amide = self.atom.name == "N" and bool(self.member.atom("CA"))
        return slack is not None and not is_amide and self.length <= usual + slack

    @property
    def _is_carbonyl(self) -> bool:
        """Whether the donor is the carbon of cyanide, an isocyanide or carbon monoxide."""
        near = [a for a in self.member.heavy if a is not self.atom and self.atom.pos.dist(a.pos) <= _TRIPLE]
        symbols = [a.element.name for a in near if not a.element.is_metal]
        return self.atom.element.name == "C" and symbols in (["N"], ["O"])

    @property
    def length(self) -> float:
        """Distance, angstrom."""
        return float(self.atom.pos.dist(self.hetero_atom.pos))

    @property
    def excess(self) -> float:
        """Excess of the distance over a usual covalent bond, angstrom."""
        return self.length - usual_length(self.atom.element.name, self.hetero_atom.element.name)

    @property
    def ends(self) -> tuple[int, int]:
        """``id`` of the atoms."""
        return id(self.atom), id(self.hetero_atom)

    @property
    def owners(self) -> tuple[int, int]:
        """``id`` of the residues."""
        return id(self.member), id(self.hetero)


def is_metal(symbol: str) -> bool:
    """Whether an element is a metal."""
    return bool(gemmi.Element(symbol).is_metal)


def usual_length(first: str, second: str) -> float:
    """Sum of the covalent radii of two elements, angstrom."""
    return float(gemmi.Element(first).covalent_r + gemmi.Element(second).covalent_r)
