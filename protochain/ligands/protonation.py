"""Charges of acids and bases at a pH: the most populated state of each site.

Sites and their pKa are dimorphite-dl's [1]_, corrected by ``RULES``. The pKa of phenols and thiophenols
follow from the substituents by Hammett's equation [2]_. The pKa of other aromatic hydroxyls, and of nitrogens
that lose a proton, are means of classes with deviations of three units. These sites lose the proton only if
the pH is above by one deviation. If the net charge at pH 7 is known, the pH is shifted until the sites agree.

.. [1] Ropp, Kaminsky, Yablonski, Durrant, J. Cheminform. 11:14 (2019).
.. [2] Perrin, Dempsey, Serjeant, pKa Prediction for Organic Acids and Bases (1981).
"""

import csv
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from protochain.core.arrays import Value, read_only
from protochain.core.errors import StructureError
from protochain.core.optional_libraries import library
from protochain.core.units import ANGSTROM_PER_NM
from protochain.ligands.molecule import Molecule, from_rdkit, quietly, to_rdkit


@dataclass(frozen=True)
class Charged(Value):
    """An atom whose formal charge was changed."""

    atom: str
    before: int
    after: int


@dataclass(frozen=True)
class Rule(Value):
    """A site whose pKa dimorphite-dl lacks, or has from too wide a class."""

    # -1: the pattern has the proton, which is lost above the pKa. 1: one without, which is gained below it.
    gain: int
    # Its first atom is the site. Rules are applied in their order, each until it matches no more, so that a
    # pattern may say how neighbours are charged.
    smarts: str
    pka: float
    source: str


def _rows(name: str) -> list[dict[str, str]]:
    with Path(__file__).with_name(name).open(encoding="utf-8") as lines:
        return [*csv.DictReader(lines)]


RULES = tuple(
    Rule(int(row["gain"]), row["smarts"], float(row["pka"]), row["source"])
    for row in _rows("protonation_rules.csv")
)
"""Corrections of dimorphite-dl.

[1] Perrin, Ionisation Constants of Inorganic Acids and Bases (1982). [2] Alberty, Goldberg, Biochemistry
31:10610 (1992). [3] Yount, Babcock, Ballantyne, Ojala, Biochemistry 10:2484 (1971). [4] Perrin, Dissociation
Constants of Organic Bases (1965); Albert, Serjeant, The Determination of Ionization Constants (1984).
[5] Prankerd, Profiles Drug Subst. 33:1 (2007). [6] Bell, He, Wachter, Tonge, Biochemistry 39:4423 (2000).
[7] Dawson et al. (1986), as of ``net_charges``. [8] Jaffe, Cohn, Biochemistry 17:652 (1978). [9] Blackburn,
Kent, J. Chem. Soc. Perkin 1:913 (1986). [10] Martell, Smith, Critical Stability Constants (1974-1989).
[11] Macon, Wolfenden, Biochemistry 7:3453 (1968). [12] Serjeant, Dempsey, Ionisation Constants of Organic
Acids (1979). [13] Brauner-Osborne et al., J. Med. Chem. 43:2609 (2000). [14] Kohara et al., J. Med. Chem.
39:5228 (1996). [15] Catalan, Abboud, Elguero, Adv. Heterocycl. Chem. 41:187 (1987). [16] Wasik et al., J.
Phys. Chem. B 116:7259 (2012). [17] Bishop, Indicators (1972). [18] Sjoback, Nygren, Kubista, Spectrochim.
Acta A 51:L7 (1995): 6.43. [19] Meloun, Ferencikova, Netolicka, Pekarek, J. Chem. Eng. Data 56:3848 (2011):
10.74 of ibandronate. The abstracts of [18] and [19] were read. Values of [8] to [17] could not be verified.
Imide and methylene analogues of ATP have a last pKa of 7.7 and 8.4 without a metal. In sites they hold
magnesium and have the charge -4, as ATP, whose rule they share.
"""
_SIGMA = tuple(
    (row["smarts"], (float(row["ortho"]), float(row["meta"]), float(row["para"])))
    for row in _rows("substituents.csv")
)
"""Constants of substituents at the carbon that a pattern begins with: ortho, meta, para to the hydroxyl.

They are of phenols, from Perrin, Dempsey, Serjeant (1981) or as (9.92 - pKa) / 2.23 of the phenol with this
substituent alone, in [12]. The first pattern that matches counts.
"""
_HAMMETT = {"O": (9.92, 2.23), "S": (6.61, 1.5)}
"""pKa without substituents, and its change by sigma: of phenols (Perrin 1981), and the line through
thiophenol and 4-nitrothiophenol of [12]."""
_UNSURE = 0.4  # Deviations of a class of dimorphite-dl, in units of pH about one for its widest classes.
_AT_METAL = "[$([CH]#N),$([#7+;!H0]),$([NX3;!H0]-S(=O)=O),$([SX2H]),$([OX2H]-[!$([CX4])])]"
"""Sites that lose a proton to a metal. An alcohol, as of a sugar at calcium, retains its proton."""
_KNOWN_AT = 7.0
_SHIFTS = sorted((0.25 * k for k in range(-20, 21)), key=abs)
"""pH by which rules are shifted to a charge that is known."""


def at_ph(
    molecule: Molecule, ph: float, donors: Collection[str] = ()
) -> tuple[Molecule, tuple[Charged, ...]]:
    """Return a molecule in its state at a pH, and the changes. Metal donors and other hydrogens remain."""
    neutral = library("rdkit.Chem.MolStandardize.rdMolStandardize").Uncharger()
    mol, rank = _number_heavy(molecule)
    smiles = library("rdkit.Chem").MolToSmiles(quietly(neutral.uncharge, mol))
    charge = net_charges().get(skeleton(molecule))
    shift = 0.0 if charge is None else _shift(smiles, charge, rank)
    state = _state(smiles, ph + shift, rank)
    if state is None or {_number(atom) for atom in state.GetAtoms()} != set(molecule.heavy.tolist()):
        raise StructureError(f"{molecule.source}: cannot be charged for pH {ph:g}; give it as it is there")
    for atom in state.GetAtoms():
        k = _number(atom)
        if molecule.names[k] in donors:
            atom.SetFormalCharge(int(molecule.formal_charges[k]))
            ends = molecule.bonds[(molecule.bonds == k).any(axis=1)]
            atom.SetNumExplicitHs(int((molecule.elements[ends] == 1).sum()))
            atom.SetNoImplicit(True)
    return _in_state(molecule, state)


def unsure(molecule: Molecule, ph: float) -> tuple[str, ...]:
    """Names of atoms whose charge at a pH is doubtful: their wide class has this pKa, no rule covers them."""
    if skeleton(molecule) in net_charges():
        return ()
    chem, (mol, _) = library("rdkit.Chem"), _number_heavy(molecule)
    neutral = quietly(library("rdkit.Chem.MolStandardize.rdMolStandardize").Uncharger().uncharge, mol)
    states = _states(chem.MolToSmiles(neutral), ph, _UNSURE)
    charges = [{_number(a): a.GetFormalCharge() for a in state.GetAtoms()} for state in states]
    sites = {k for by_atom in charges for k, charge in by_atom.items() if charge != charges[0].get(k)}
    for smarts in (*(rule.smarts for rule in RULES), _PHENOL):
        for form in (mol, neutral, *states):
            sites -= {_number(form.GetAtomWithIdx(match[0])) for match in _matches(form, smarts)}
    return tuple(molecule.names[k] for k in sorted(sites))


def at_metal(molecule: Molecule, holding: Collection[int]) -> tuple[Molecule, tuple[Charged, ...]]:
    """Return a molecule without the protons that metals displace, and the changes. Azoles retain theirs."""
    if not holding:
        return molecule, ()
    state, rank = _number_heavy(molecule)
    _apply(state, _AT_METAL, -1, rank, holding)
    for site in [atom for atom in state.GetAtoms() if _number(atom) in holding]:
        if site.GetSymbol() == "N" and site.GetIsAromatic() and site.GetTotalNumHs():
            _move_proton(state, site, rank, holding)
    return _in_state(molecule, state)


def _move_proton(state: Any, site: Any, rank: list[int], holding: Collection[int]) -> None:
    """Move the proton of an azole's nitrogen to another of its ring without one, or else away."""
    rings = [ring for ring in state.GetRingInfo().AtomRings() if site.GetIdx() in ring]
    ring_atoms = (state.GetAtomWithIdx(k) for ring in rings for k in ring)
    free = [a for a in ring_atoms if a.GetSymbol() == "N" and a.GetDegree() == 2 and not a.GetTotalNumHs()]
    free = sorted((a for a in free if _number(a) not in holding), key=lambda a: rank[_number(a)])
    if not free:
        _change(site, -1)
        return
    site.SetNumExplicitHs(0)
    free[0].SetNumExplicitHs(1)
    state.UpdatePropertyCache(strict=False)


def _number_heavy(molecule: Molecule) -> tuple[Any, list[int]]:
    """Heavy atoms numbered by isotopes, since dimorphite-dl drops map numbers, and the rank of each atom."""
    chem, mol = library("rdkit.Chem"), to_rdkit(molecule)
    rank = list(chem.CanonicalRankAtoms(mol))
    for atom in mol.GetAtoms():
        atom.SetIsotope(atom.GetIdx() + 1 if atom.GetAtomicNum() != 1 else 0)
    return chem.RemoveAllHs(mol), rank


def _in_state(molecule: Molecule, state: Any) -> tuple[Molecule, tuple[Charged, ...]]:
    """The molecule with charges, hydrogens and orders of bonds as its numbered heavy atoms have them."""
    chem, mol = library("rdkit.Chem"), to_rdkit(molecule)
    chem.Kekulize(state)
    surplus, changed = [], []
    for as_is in state.GetAtoms():
        number = _number(as_is)
        atom = mol.GetAtomWithIdx(number)
        hydrogens = [near.GetIdx() for near in atom.GetNeighbors() if near.GetAtomicNum() == 1]
        n = as_is.GetTotalNumHs()
        surplus += hydrogens[n:]
        if as_is.GetFormalCharge() != atom.GetFormalCharge():
            changed.append(Charged(molecule.names[number], atom.GetFormalCharge(), as_is.GetFormalCharge()))
        atom.SetFormalCharge(as_is.GetFormalCharge())
        atom.SetNumExplicitHs(max(0, n - len(hydrogens)))
    if not surplus and not any(atom.GetNumExplicitHs() for atom in mol.GetAtoms()):
        return molecule, ()
    # Not by Kekulize: a ring with a hydrogen too many, as of histidinium made neutral, has no such form yet.
    for part in (*mol.GetAtoms(), *mol.GetBonds()):
        part.SetIsAromatic(False)
    for bond in state.GetBonds():
        ends = _number(bond.GetBeginAtom()), _number(bond.GetEndAtom())
        mol.GetBondBetweenAtoms(*ends).SetBondType(bond.GetBondType())
    for number in sorted(surplus, reverse=True):
        mol.RemoveAtom(number)
    chem.SanitizeMol(mol)
    return from_rdkit(mol, molecule.source), tuple(sorted(changed, key=lambda change: change.atom))


@lru_cache(maxsize=1)
def net_charges() -> Mapping[str, int]:
    """Net charges at pH 7 that the literature gives, by the skeleton of the molecule.

    Sources: ChEBI, major species at pH 7.3 (Hastings et al., Nucleic Acids Res. 44:D1214, 2016), except its
    dUTP(3-) and lysine(0). MetaCyc, at pH 7.3 (Caspi et al., Nucleic Acids Res. 48:D445, 2020). ``groups``:
    by the pKa of their groups, as of acids and phosphates elsewhere in the table. From pKa: Dawson,
    Elliott, Elliott, Jones, Data for Biochemical Research (1986). Goldberg, Kishore, Lennen, J. Phys. Chem.
    Ref. Data 31:231 (2002). Massey, Biochem. Soc. Trans. 28:283 (2000), of flavins, whose N3 has 10. Perrin
    (1965, 1982), Prankerd (2007) and Yount (1971) as for ``RULES``.
    """
    return {row["skeleton"]: int(row["charge"]) for row in _rows("net_charges.csv")}


def skeleton(molecule: Molecule) -> str:
    """First block of the InChIKey: the same for an acid and its anion, tautomers and stereoisomers."""
    return str(quietly(library("rdkit.Chem").MolToInchiKey, to_rdkit(molecule)))[:14]


def with_hydrogens(molecule: Molecule, count: Mapping[int, int]) -> Molecule | None:
    """Return a molecule with these numbers of hydrogens, each a charge. None if carbons gain or lose any."""
    # Others gain or lose one, all alike: of a tautomer bonds would change.
    chem = library("rdkit.Chem")
    mol = to_rdkit(molecule)
    changes = set()
    surplus = []
    for i, n_hydrogens in count.items():
        atom = mol.GetAtomWithIdx(i)
        hydrogens = [near.GetIdx() for near in atom.GetNeighbors() if near.GetAtomicNum() == 1]
        change = n_hydrogens - len(hydrogens)
        if change:
            changes.add(change)
            if atom.GetAtomicNum() == 6:
                return None
        atom.SetFormalCharge(atom.GetFormalCharge() + change)
        atom.SetNumExplicitHs(max(change, 0))
        surplus += hydrogens[n_hydrogens:]
    if not changes:
        return molecule
    if changes not in ({1}, {-1}):
        return None
    for i in sorted(surplus, reverse=True):
        mol.RemoveAtom(i)
    try:
        quietly(chem.SanitizeMol, mol)
        mol = chem.AddHs(mol, addCoords=True)
        x = mol.GetConformer().GetPositions() / ANGSTROM_PER_NM
        # The stereo is that of the source: at these positions it may be another.
        mol.RemoveAllConformers()
        return replace(from_rdkit(mol, molecule.source), positions=read_only(x))
    except (ValueError, StructureError):
        return None


def _shift(smiles: str, charge: int, rank: list[int]) -> float:
    """Smallest shift of the pH that gives a molecule its charge at pH 7, 0 if no shift does."""
    for shift in _SHIFTS:
        state = _state(smiles, _KNOWN_AT + shift, rank)
        if state is not None and sum(atom.GetFormalCharge() for atom in state.GetAtoms()) == charge:
            return shift
    return 0.0


def _state(smiles: str, ph: float, rank: list[int]) -> Any:
    """RDKit's molecule in its most populated state, isotopes as in the SMILES. None without a state."""
    state = next(iter(_states(smiles, ph, 0.0)), None)
    if state is None:
        return None
    unlikely = [
        atom for atom in state.GetAtoms()
        if atom.GetFormalCharge() < 0
        and (atom.GetAtomicNum() == 7 or any(near.GetIsAromatic() for near in atom.GetNeighbors()))
    ]  # fmt: skip
    unsure = _states(smiles, ph, 1.0) if unlikely else []
    uncertain = {_number(a) for form in unsure for a in form.GetAtoms() if not a.GetFormalCharge()}
    for atom in unlikely:
        if _number(atom) in uncertain:
            _change(atom, 1)
    _settle_phenols(state, ph)
    for rule in RULES:
        if ph > rule.pka if rule.gain < 0 else ph < rule.pka:
            _apply(state, rule.smarts, rule.gain, rank)
    return state


_PHENOL = "[O,S;$([X2H]),$([X1-])]-c1ccccc1"


def _settle_phenols(state: Any, ph: float) -> None:
    """Let phenols and thiophenols lose the proton, the most acidic first, by Hammett's equation."""
    for site, *_ in _matches(state, _PHENOL):
        atom = state.GetAtomWithIdx(site)
        _change(atom, -atom.GetFormalCharge())
    while True:
        sigma: dict[int, tuple[float, float, float]] = {}
        for smarts, of_places in _SIGMA:
            for carbon, *_ in _matches(state, smarts):
                sigma.setdefault(carbon, of_places)
        pka: dict[int, float] = {}
        # The ring of a match is in order, from the carbon of the hydroxyl.
        for site, _, *ring in _matches(state, _PHENOL):
            if not state.GetAtomWithIdx(site).GetFormalCharge():
                # Ortho, meta and para, around a ring of six.
                places = zip(ring, (0, 1, 2, 1, 0), strict=True)
                constants = [sigma.get(carbon, (0.0,) * 3)[place] for carbon, place in places]
                alone, slope = _HAMMETT[state.GetAtomWithIdx(site).GetSymbol()]
                pka[site] = min(alone - slope * sum(constants), pka.get(site, np.inf))
        if not pka or min(pka.values()) >= ph:
            return
        _change(state.GetAtomWithIdx(min(pka, key=lambda k: (pka[k], k))), -1)
        state.UpdatePropertyCache(strict=False)


@lru_cache(maxsize=512)
def _query(smarts: str) -> Any:
    return library("rdkit.Chem").MolFromSmarts(smarts)


def _matches(state: Any, smarts: str) -> Any:
    return state.GetSubstructMatches(_query(smarts), uniquify=False)


def _apply(state: Any, smarts: str, gain: int, rank: list[int], among: Collection[int] | None = None) -> None:
    """Let sites that a pattern matches gain or lose a proton, one by one, until none is left."""
    # The first to lose is the one in most matches, as the middle one of three amines in a row, then the one
    # with more neighbours but one that draw electrons, then the one with fewer hydrogens.
    while True:
        often = Counter(match[0] for match in _matches(state, smarts))
        sites = [state.GetAtomWithIdx(k) for k in often]
        sites = [atom for atom in sites if among is None or _number(atom) in among]
        if not sites:
            return
        site = min(
            sites, key=lambda a: (-often[a.GetIdx()], -_drawing(a), a.GetTotalNumHs(), rank[_number(a)])
        )
        _change(site, gain)
        if site.GetSymbol() == "C":
            _draw_enolate(state, site)
        state.UpdatePropertyCache(strict=False)


def _draw_enolate(state: Any, site: Any) -> None:
    """Draw a carbanion next to a carbonyl group as the enolate, as parameters and charges expect."""
    orders = library("rdkit.Chem").BondType
    ends = (m for m in _matches(state, "[C-]-[CX3]=[O,S]") if m[0] == site.GetIdx())
    if (match := next(ends, None)) is None:
        # A carbanion of another kind, as cyanide.
        return
    state.GetBondBetweenAtoms(*match[:2]).SetBondType(orders.DOUBLE)
    state.GetBondBetweenAtoms(*match[1:]).SetBondType(orders.SINGLE)
    site.SetFormalCharge(0)
    state.GetAtomWithIdx(match[2]).SetFormalCharge(-1)


def _drawing(atom: Any) -> int:
    """Number of neighbours of an atom's neighbours, without saturated carbons."""
    sp3 = library("rdkit.Chem").HybridizationType.SP3
    atoms = (second for near in atom.GetNeighbors() for second in near.GetNeighbors())
    return sum(second.GetAtomicNum() != 6 or second.GetHybridization() != sp3 for second in atoms)


def _change(atom: Any, gain: int) -> None:
    atom.SetNumExplicitHs(atom.GetTotalNumHs() + gain)
    atom.SetFormalCharge(atom.GetFormalCharge() + gain)


def _number(atom: Any) -> int:
    """Number of the atom in the molecule, from its isotope."""
    return int(atom.GetIsotope()) - 1


def _states(smiles: str, ph: float, precision: float) -> list[Any]:
    """RDKit's molecule of each state. Sites whose pKa is within so many standard deviations have two."""
    return [library("rdkit.Chem").MolFromSmiles(drawn) for drawn in _state_smiles(smiles, ph, precision)]


@lru_cache(maxsize=64)
def _state_smiles(smiles: str, ph: float, precision: float) -> tuple[str, ...]:
    protonated = library("dimorphite_dl").protonate_smiles
    limit = 128 if precision else 1
    return tuple(protonated(smiles, ph_min=ph, ph_max=ph, precision=precision, max_variants=limit))
