"""Packing energies of side chains: heavy atoms, with the hydrogens that they bear.

Contact distances, depths and weights of frequencies are from FASPR (Huang, Pearce, Zhang, Bioinformatics
36:3758, 2020). Repulsion is linear because rotamers are rigid. Attraction and frequencies have 0.7 times the
weight in FASPR. This factor and the turns of ``packing`` were chosen on 19 crystals, which are not in any
benchmark of this repository (``analysis/benchmarks/sidechains.py`` names them). Energies have no unit.
"""

from collections.abc import Sequence

import numpy as np

from protochain.core.arrays import Floats
from protochain.core.compilation import njit

REACH = 7.0
"""Angstrom. Cutoff of pair energies."""
_STEEPNESS = 10.0  # Repulsion at distance zero.
_ATTRACTION = 0.7
_POLAR = 2.8  # Angstrom: contact of a donor and an acceptor of a hydrogen bond.
_ION = (0.6, 0.1)  # Radius, depth of elements outside organic chemistry: metals, which oxygens touch at 2.2.

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
"""Radius, angstrom, and depth of each kind of carbon, nitrogen, oxygen and sulphur."""
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
"""Radius, angstrom, and depth of atoms outside the protein."""
_WEIGHTS = {
    "CYS": 5.5, "ASP": 2.0, "GLU": 1.0, "PHE": 1.5, "HIS": 3.0, "ILE": 1.0, "LYS": 2.0, "LEU": 2.0,
    "MET": 1.5, "ASN": 2.0, "PRO": 1.5, "GLN": 2.5, "ARG": 1.5, "SER": 1.5, "THR": 2.0, "VAL": 2.0,
    "TRP": 3.5, "TYR": 1.5,
}  # fmt: skip
_FREQUENCY = 0.7
_RAREST = 5.0  # Largest logarithm of the ratio of the highest frequency to another.


def rarity(residue: str, frequency: Floats) -> Floats:
    """(n,) float: costs of rotamers of these frequencies."""
    rare = np.minimum(np.log(frequency.max() / np.maximum(frequency, 1e-9)), _RAREST)
    return np.asarray(_FREQUENCY * _WEIGHTS.get(residue, 1.0) * rare)


def kind(residue: str, name: str, element: str = "") -> tuple[float, float]:
    """Radius, angstrom, and depth of an amino acid's atom, or of an element outside the protein."""
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
    carbon, atom = _CARBON, (residue, name)
    if residue in _AROMATIC and name != "CB":
        return carbon["ring"]
    if atom in _PLANAR:
        return carbon["carboxyl"]
    if atom == ("CYS", "CB"):
        return carbon["CB of CYS"]
    return carbon["CH3" if atom in _METHYL else "CH" if atom in _BRANCHED else "CH2"]


def donates_accepts(residue: str, name: str) -> tuple[bool, bool]:
    """Whether an atom of an amino acid may donate, and accept, a hydrogen bond."""
    if name in ("OG", "OG1", "OH") or (residue, name) == ("HIS", "NE2"):
        return True, True
    return name[0] == "N" and (residue, name) != ("PRO", "N"), name[0] == "O"


class Kinds:
    """Kinds of several atoms, by residue, name, and the element of atoms outside the protein (else empty)."""

    def __init__(self, atoms: Sequence[tuple[str, str, str]]) -> None:
        parameters = np.array([kind(*atom) for atom in atoms]).reshape(-1, 2)
        self.radius, self.depth = parameters.T
        polar = [(False, False) if atom[2] else donates_accepts(*atom[:2]) for atom in atoms]
        self.donates, self.accepts = np.array(polar, dtype=bool).reshape(-1, 2).T

    def pair_parameters(self, second: "Kinds") -> tuple[Floats, Floats]:
        """Contact distances, angstrom, and depths (n, m) of all pairs with other atoms."""
        is_hydrogen_bond = self.donates[:, None] & second.accepts | self.accepts[:, None] & second.donates
        contact = np.where(is_hydrogen_bond, _POLAR, self.radius[:, None] + second.radius)
        return contact, np.sqrt(self.depth[:, None] * second.depth)


@njit(cache=True, error_model="numpy")
def table(x: Floats, y: Floats, contact: Floats, depth: Floats) -> Floats:
    """Energies (n, m) of x (n, k, 3) and y (m, l, 3), angstrom, by ``contact``, ``depth`` (k, l)."""
    energies = np.zeros((len(x), len(y)))
    for k in range(x.shape[1]):
        for m in range(y.shape[1]):
            if contact[k, m] <= 0.0:
                continue
            square, deep = contact[k, m] ** 2, 4.0 * _ATTRACTION * depth[k, m]
            for r in range(len(x)):
                for s in range(len(y)):
                    d0 = x[r, k, 0] - y[s, m, 0]
                    d1 = x[r, k, 1] - y[s, m, 1]
                    d2 = x[r, k, 2] - y[s, m, 2]
                    r2 = d0 * d0 + d1 * d1 + d2 * d2
                    if r2 >= REACH**2:
                        continue
                    if r2 < square:
                        energies[r, s] += _STEEPNESS * (1.0 - np.sqrt(r2 / square))
                    else:
                        s6 = (square / r2) ** 3
                        energies[r, s] += deep * (s6 - 1.0) * s6
    return energies
