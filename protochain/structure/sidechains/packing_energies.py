"""Energies of side chains that are packed: heavy atoms, with the hydrogens that they bear.

Contact distances and depths are those of FASPR (Huang, Pearce, Zhang, Bioinformatics 36:3758, 2020), as are
the weights of frequencies; repulsion is linear, for rotamers are rigid. Attraction and frequencies count 0.7
times as much as there: that, and the turns of ``packing``, was chosen on 19 crystals, none of which is in a
benchmark of this repository (``analysis/benchmarks/sidechains.py`` names them). Energies have no unit.
"""

from collections.abc import Sequence

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.compilation import njit

REACH = 7.0
"""Angstrom: no atoms further apart touch."""
_STEEPNESS = 10.0
"""Repulsion at distance zero."""
_ATTRACTION = 0.7
_POLAR = 2.8
"""Angstrom: contact of a donor and an acceptor of a hydrogen bond."""
_ION = (0.6, 0.1)
"""Radius, depth of an element that is not of organic chemistry: a metal, which oxygens touch at 2.2."""

_CARBON = {
    "CH": (2.30, 0.30), "CH2": (1.91, 0.37), "CH3": (1.96, 0.48), "ring": (1.73, 0.38),
    "carboxyl": (1.43, 0.07), "CB of CYS": (1.99, 0.38), "CA": (1.78, 0.25), "C": (1.40, 0.14),
}  # fmt: skip
_NITROGEN = {
    "amide": (1.42, 0.08), "polar": (1.69, 0.24), "NE2 of HIS": (1.56, 0.46), "of PRO": (1.70, 0.48),
}  # fmt: skip
_OXYGEN = {
    "peptide": (1.48, 0.22), "amide": (1.44, 0.27), "carboxyl": (1.40, 0.07), "hydroxyl": (1.43, 0.12),
}  # fmt: skip
_SULPHUR = {"SG": (2.15, 0.44), "SD": (1.74, 0.40)}
"""Radius, angstrom, and depth of each kind of atom."""
_BRANCHED = {("VAL", "CB"), ("ILE", "CB"), ("THR", "CB"), ("LEU", "CG")}
_METHYL = {
    ("ALA", "CB"), ("VAL", "CG1"), ("VAL", "CG2"), ("LEU", "CD1"), ("LEU", "CD2"), ("ILE", "CD1"),
    ("ILE", "CG2"), ("THR", "CG2"), ("MET", "CE"),
}  # fmt: skip
_PLANAR = {("ASP", "CG"), ("ASN", "CG"), ("GLU", "CD"), ("GLN", "CD"), ("ARG", "CZ")}
_AROMATIC = {"PHE", "TYR", "TRP", "HIS"}
_ELEMENTS = {
    "C": _CARBON["CH2"], "N": _NITROGEN["polar"], "O": _OXYGEN["amide"], "S": _SULPHUR["SD"],
    "P": (2.0, 0.3), "F": (1.5, 0.2), "CL": (1.9, 0.3), "BR": (2.0, 0.3), "I": (2.1, 0.3),
}  # fmt: skip
"""Of atoms outside the protein."""
_WEIGHTS = {
    "CYS": 5.5, "ASP": 2.0, "GLU": 1.0, "PHE": 1.5, "HIS": 3.0, "ILE": 1.0, "LYS": 2.0, "LEU": 2.0,
    "MET": 1.5, "ASN": 2.0, "PRO": 1.5, "GLN": 2.5, "ARG": 1.5, "SER": 1.5, "THR": 2.0, "VAL": 2.0,
    "TRP": 3.5, "TYR": 1.5,
}  # fmt: skip
_FREQUENCY = 0.7
_RAREST = 5.0
"""Logarithm of how much rarer than the most frequent one a rotamer is, at most."""


def rarity(residue: str, frequency: Floats) -> Floats:
    """(n,) float: what rotamers cost that are of these frequencies."""
    rare = np.minimum(np.log(frequency.max() / np.maximum(frequency, 1e-9)), _RAREST)
    return np.asarray(_FREQUENCY * _WEIGHTS.get(residue, 1.0) * rare)


def kind(residue: str, name: str, element: str = "") -> tuple[float, float]:
    """Radius, angstrom, and depth of an amino acid's atom; with an element, of one outside the protein."""
    if element:
        return _ELEMENTS.get(element.upper(), _ION)
    if name in ("CA", "C"):
        return _CARBON[name]
    if name[0] == "N":
        if name == "N":
            return _NITROGEN["of PRO" if residue == "PRO" else "amide"]
        return _NITROGEN.get(f"{name} of {residue}", _NITROGEN["polar"])
    if name[0] == "O":
        if name in ("O", "OXT"):
            return _OXYGEN["peptide"]
        if name in ("OG", "OG1", "OH"):
            return _OXYGEN["hydroxyl"]
        return _OXYGEN["carboxyl" if residue in ("ASP", "GLU") else "amide"]
    if name[0] == "S":
        return _SULPHUR.get(name, _SULPHUR["SD"])
    of, at = _CARBON, (residue, name)
    if residue in _AROMATIC and name != "CB":
        return of["ring"]
    if at in _PLANAR:
        return of["carboxyl"]
    if at == ("CYS", "CB"):
        return of["CB of CYS"]
    return of["CH3" if at in _METHYL else "CH" if at in _BRANCHED else "CH2"]


def donates_accepts(residue: str, name: str) -> tuple[bool, bool]:
    """Whether an atom of an amino acid may give, and take, a hydrogen bond."""
    if name in ("OG", "OG1", "OH") or (residue, name) == ("HIS", "NE2"):
        return True, True
    return name[0] == "N" and (residue, name) != ("PRO", "N"), name[0] == "O"


class Kinds:
    """Kinds of atoms: residue, name, and element of those outside the protein."""

    def __init__(self, of: Sequence[tuple[str, str, str]]) -> None:
        known = np.array([kind(*each) for each in of]).reshape(-1, 2)
        self.radius, self.depth = known.T
        polar = [(False, False) if each[2] else donates_accepts(*each[:2]) for each in of]
        self.donates, self.accepts = np.array(polar, dtype=bool).reshape(-1, 2).T

    def beside(self, other: "Kinds") -> tuple[Floats, Floats]:
        """Contact distances, angstrom, and depths (n, m) of all pairs with others."""
        bound = self.donates[:, None] & other.accepts | self.accepts[:, None] & other.donates
        contact = np.where(bound, _POLAR, self.radius[:, None] + other.radius)
        return contact, np.sqrt(self.depth[:, None] * other.depth)


@njit(cache=True, error_model="numpy")
def table(x: Floats, others: Floats, contact: Floats, depth: Floats) -> Floats:
    """Energies (n, m) of x (n, k, 3) and others (m, l, 3), angstrom, by ``contact``, ``depth`` (k, l)."""
    found = np.zeros((len(x), len(others)))
    for k in range(x.shape[1]):
        for m in range(others.shape[1]):
            if contact[k, m] <= 0.0:
                continue
            square, deep = contact[k, m] ** 2, 4.0 * _ATTRACTION * depth[k, m]
            for r in range(len(x)):
                for s in range(len(others)):
                    d0 = x[r, k, 0] - others[s, m, 0]
                    d1 = x[r, k, 1] - others[s, m, 1]
                    d2 = x[r, k, 2] - others[s, m, 2]
                    r2 = d0 * d0 + d1 * d1 + d2 * d2
                    if r2 >= REACH**2:
                        continue
                    if r2 < square:
                        found[r, s] += _STEEPNESS * (1.0 - np.sqrt(r2 / square))
                    else:
                        s6 = (square / r2) ** 3
                        found[r, s] += deep * (s6 - 1.0) * s6
    return found
