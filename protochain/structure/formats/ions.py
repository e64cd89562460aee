"""Element and charge of monatomic ions, from their names in the PDB and in simulation programs."""

from collections.abc import Iterable

import gemmi

_ARCHIVE = {
    "0BE": ("Be", 2), "3CO": ("Co", 3), "3NI": ("Ni", 3), "4MO": ("Mo", 4), "4PU": ("Pu", 4),
    "4TI": ("Ti", 4), "6MO": ("Mo", 6), "AG": ("Ag", 1), "AL": ("Al", 3), "AM": ("Am", 3), "AR": ("Ar", 0),
    "AU": ("Au", 1), "AU3": ("Au", 3), "BA": ("Ba", 2), "BR": ("Br", -1), "BRO": ("Br", 0), "BS3": ("Bi", 3),
    "CA": ("Ca", 2), "CD": ("Cd", 2), "CE": ("Ce", 3), "CF": ("Cf", 3), "CL": ("Cl", -1), "CLO": ("Cl", 0),
    "CO": ("Co", 2), "CR": ("Cr", 3), "CS": ("Cs", 1), "CU": ("Cu", 2), "CU1": ("Cu", 1), "CU3": ("Cu", 3),
    "DY": ("Dy", 3), "ER3": ("Er", 3), "EU": ("Eu", 2), "EU3": ("Eu", 3), "F": ("F", -1), "FE": ("Fe", 3),
    "FE2": ("Fe", 2), "FLO": ("F", 0), "GA": ("Ga", 3), "GD": ("Gd", 0), "GD3": ("Gd", 3), "HG": ("Hg", 2),
    "HO": ("Ho", 0), "HO3": ("Ho", 3), "IDO": ("I", 0), "IN": ("In", 3), "IOD": ("I", -1), "IR": ("Ir", 4),
    "IR3": ("Ir", 3), "K": ("K", 1), "KR": ("Kr", 0), "LA": ("La", 3), "LI": ("Li", 1), "LU": ("Lu", 3),
    "MG": ("Mg", 2), "MN": ("Mn", 2), "MN3": ("Mn", 3), "MO": ("Mo", 0), "NA": ("Na", 1), "ND": ("Nd", 3),
    "NI": ("Ni", 2), "OS": ("Os", 3), "OS4": ("Os", 4), "PB": ("Pb", 2), "PD": ("Pd", 2), "PR": ("Pr", 3),
    "PT": ("Pt", 2), "PT4": ("Pt", 4), "RB": ("Rb", 1), "RE": ("Re", 0), "RH": ("Rh", 1), "RH3": ("Rh", 3),
    "RHF": ("Rh", 2), "RU": ("Ru", 3), "SB": ("Sb", 3), "SM": ("Sm", 3), "SR": ("Sr", 2), "TA0": ("Ta", 0),
    "TB": ("Tb", 3), "TH": ("Th", 4), "TL": ("Tl", 1), "U1": ("U", 0), "V": ("V", 3), "W": ("W", 6),
    "XE": ("Xe", 0), "Y1": ("Y", 2), "YB": ("Yb", 3), "YB2": ("Yb", 2), "YT3": ("Y", 3), "ZCM": ("Cm", 3),
    "ZN": ("Zn", 2), "ZN2": ("Zn", 2), "ZR": ("Zr", 4), "ZTM": ("Ac", 3),
}  # fmt: skip
"""Monatomic components of the Chemical Component Dictionary (Westbrook et al., Bioinformatics 31:1274,
2015), except hydrogen, nitrogen and the oxygen group."""
_PROGRAMS = {
    "LIT": ("Li", 1), "SOD": ("Na", 1), "POT": ("K", 1), "RUB": ("Rb", 1), "CES": ("Cs", 1),
    "CAL": ("Ca", 2), "BAR": ("Ba", 2), "CD2": ("Cd", 2), "CLA": ("Cl", -1), "I": ("I", -1), "C0": ("Ca", 2),
    "IB": ("Na", 1), "IP": ("Na", 1), "IM": ("Cl", -1), "CIO": ("Cs", 1), "SN": ("Sn", 2), "HF": ("Hf", 4),
    "RA": ("Ra", 2), "MG2": ("Mg", 2), "CA2": ("Ca", 2), "ER": ("Er", 3), "Y": ("Y", 3),
}  # fmt: skip
"""Names in CHARMM (toppar_water_ions.str), Amber (atomic_ions.lib) and GROMACS (ions.itp)."""
_IONS = _ARCHIVE | _PROGRAMS
_ION_CHARGE = dict(_IONS.values()) | {
    element: charge for name, (element, charge) in _IONS.items() if name == element.upper()
}
"""Charge of each element's ion. A component with the name of the element has priority."""
_OXIDATION_STATES = {"Fe": 2, "Co": 3, "Mn": 3, "Ni": 2, "Cu": 2, "Mo": 4, "Ru": 2, "V": 4}
"""Oxidation states that differ from ions: ferrous hemes, cobalamins as cob(III)alamin, Mn porphyrins."""
_OXIDATION_STATES_BY_NAME = {("F43", "Ni"): 1, ("MNH", "Mn"): 2, ("COH", "Co"): 2, ("SIR", "Co"): 2}
"""Oxidation states by component: F430 as in active methyl-coenzyme M reductase (Goubeaud, Schreiner,
Thauer, Eur. J. Biochem. 243:110, 1997), porphyrins by their names."""
_CLUSTERS = {
    "SF4": (3, 3, 2, 2), "FES": (3, 3), "F3S": (3, 3, 3), "CUA": (2, 1), "CUZ": (2, 1, 1, 1), "CLF": (2,) * 8,
    "ICS": (3, 3, 3, 3, 3, 2, 2, 2), "OEX": (2, 3, 3, 4, 4), "FEO": (3, 3), "NCO": (3,), "RHD": (3,),
    "IRI": (3,), "CPT": (2,),
}  # fmt: skip
"""Oxidation states of the metals of clusters, in any order: [Fe4S4]2+, [Fe2S2]2+, [Fe3S4]1+ (Beinert, Holm,
Munck, Science 277:653, 1997), CuA 3+, CuZ and the copper-sulphide site (Solomon et al., Chem. Rev. 114:3659,
2014), P cluster 2+ and cofactor 1- of nitrogenase (Van Stappen et al., Chem. Rev. 120:5005, 2020), S1 of
photosystem II (Krewald et al., Chem. Sci. 6:1676, 2015). Ammines are from the dictionary."""
_ANIONS = {"S": -2, "O": -2, "Cl": -1, "C": -4}
_CHARGE = "+-0123456789"
_GENERIC_NAMES = ("ION", "IONS")  # Residue names that GROMACS uses for every ion.


def name_ions(structure: gemmi.Structure) -> None:
    """Set element and charge of monatomic residues from their names. gemmi reads SOD as sulphur."""
    for model in structure:
        for residue in (residue for chain in model for residue in chain):
            if len({atom.name for atom in residue}) == 1:
                ion = _ion(residue.name.strip().upper(), residue[0].name.upper())
                for atom in residue:
                    if ion:
                        atom.element = gemmi.Element(ion[0])
                    atom.charge = atom.charge or (ion[1] if ion else _ION_CHARGE.get(atom.element.name, 0))


def oxidation_state(name: str, element: str) -> int:
    """Return the oxidation state of a metal in a complex, from its component and its element."""
    usual = _OXIDATION_STATES.get(element, _ION_CHARGE.get(element, 0))
    return _OXIDATION_STATES_BY_NAME.get((name, element), usual)


def charge_cluster(name: str, atoms: Iterable[gemmi.Atom]) -> None:
    """Set the formal charges of the atoms of a metal cluster, unless the file has charges."""
    atoms = [*atoms]
    if name not in _CLUSTERS or any(a.charge for a in atoms):
        return
    states = iter(_CLUSTERS[name])
    for a in atoms:
        a.charge = next(states, 0) if a.element.is_metal else _ANIONS.get(a.element.name, 0)


def has_known_charge(atom: gemmi.Atom) -> bool:
    """Return whether the charge of an isolated atom is known, as of nonmetals and listed metal ions."""
    return bool(atom.charge) or not atom.element.is_metal or atom.element.name in _ION_CHARGE


def _ion(residue: str, atom: str) -> tuple[str, int] | None:
    """Return element and charge of a monatomic residue, from its residue and atom names."""
    name = atom if residue in _GENERIC_NAMES else residue
    for spelling in (name, name.rstrip(_CHARGE)):
        ion = _IONS.get(spelling)
        if ion and atom.rstrip(_CHARGE) in {name, spelling, spelling.rstrip(_CHARGE), ion[0].upper()}:
            return ion
    return None
