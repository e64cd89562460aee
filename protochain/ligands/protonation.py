"""Charges of acids and bases at a pH: the most populated state of each site.

Sites and their pKa are dimorphite-dl's [1]_, corrected by ``RULES``. Its pKa of phenols, and of nitrogens
that lose a proton, are means of classes with deviations of three units: these lose theirs only if the pH is
above by one deviation. Where the net charge at pH 7 is known, the pH is shifted until the sites agree.

.. [1] Ropp, Kaminsky, Yablonski, Durrant, J. Cheminform. 11:14 (2019).
"""

import csv
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from protochain.core.arrays import Value, read_only
from protochain.core.errors import StructureError
from protochain.core.extras import library
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

    # -1: the site is matched with its proton, and loses it if the pH is above; 1: without, and takes one.
    gain: int
    # Its first atom is the site. Rules are applied in their order, each until it matches no more, so that a
    # pattern may say how neighbours are charged.
    smarts: str
    pka: float
    source: str


_PLAIN = "[c;!$(c-[!#6;!#1]);!$(c-C=[O,N,S]);!$(c-C#N)]"
"""An aromatic carbon with nothing that draws electrons."""
RULES = (
    Rule(-1, "[OX2H,SX2H]-[PX4;!$(P-[O-,S-])]", 2.0, "phosphates, phosphonates, thiophosphates, first: [1]"),
    # Of imides and methylenes alone it is 7.7 and 8.4; in sites they hold magnesium, as ATP, and have -4.
    Rule(-1, "[OX2H,SX2H]-[PX4;$(P-[O-,S-])]-[O,N,C,S]-P", 6.5, "ATP, last: [2]; its analogues: [3]"),
    Rule(1, "[O-]-P(=O)(-[O-])-O-P(=O)(-[O-])-[O-]", 9.4, "diphosphate, last: [1]"),
    Rule(1, "[O-]-P(=O)(-[O-])-O-P(=O)(-[O-])-O-P(=O)(-[O-])-[O-]", 9.2, "triphosphate, last: [1]"),
    Rule(-1, "[OX2H]-S(=O)=O", -2.0, "sulphuric and sulphonic acids: [1]"),
    Rule(-1, "[SX2H]-C#N", -1.8, "thiocyanic acid: [1]"),
    Rule(-1, "[NX2H]=C=S", -1.8, "thiocyanic acid: [1]"),
    Rule(1, "[O-]-C(=O)-[O-]", 10.3, "hydrogencarbonate: [1]"),
    Rule(-1, "[NX4+;!H0]-[CX3]=[CX3]-[CX3]=O", 1.0, "vinylogous amides, dihydropyridine of NADH: [4]"),
    Rule(-1, "[NX4+;!H0]1-C-C-[NX4+;!H0]-C-C1", 5.4, "piperazine, second: [4]"),
    Rule(-1, "[NX4+;!H0]-[CX4]-[CX4]-[NX4+;!H0]", 6.8, "1,2-diamines, second: [4]"),
    Rule(-1, "[NX4+;!H0]-[OX2]", 6.0, "hydroxylamines: [4]"),
    Rule(-1, "[NX4+;!H0]-P", 3.0, "phosphoramidates: [4]"),
    Rule(-1, "[N+;!H0]=C-[NX3]-C=[N+;!H0]", 2.8, "biguanides, second: [5]"),
    Rule(-1, "[N+;!H0]=[CX3;!$(C(-N)-N)]-[NX3]-C=O", 2.0, "imidazolinones, GFP's chromophore: [6]"),
    Rule(1, f"[nX2+0]1{_PLAIN}{_PLAIN}c(-[NX3+0;!$(N-[C,S]=[O,S])]){_PLAIN}{_PLAIN}1", 9.1,
         "4-aminopyridines and -quinolines: [4]"),
    Rule(-1, "[NX3H](-S(=O)=O)-[c;r5;$(c:n:[o,n])]", 5.7, "sulphonamides of isoxazole, thiadiazole: [5]"),
    Rule(-1, "[NX3H](-S(=O)=O)-c(:n:[cH]):n:[cH]", 6.5, "sulphadiazine: [5]"),
    Rule(-1, "[OX2H]-c1c(-[#6,#7])c(=O)oc2ccccc12", 5.0, "4-hydroxycoumarins, warfarin: [5]"),
    Rule(-1, "[OX2H]-C=C(-C(=O)-N)-N-S(=O)=O", 4.2, "oxicams: [5]"),
    Rule(-1, "[nH]1c(=O)[nH]c(=O)c2[nH]c(=O)[nH]c12", 5.4, "uric acid, N3: [7]"),
    Rule(1, "[N-;$(N(-C=O)-[#7])]", 12.0, "hydrazides: [4]"),
    Rule(1, "[N-;$(N(-C=O)-[OX2])]", 9.0, "hydroxamic acids: [4]"),
)  # fmt: skip
"""Corrections of dimorphite-dl.

[1] Perrin, Ionisation Constants of Inorganic Acids and Bases (1982). [2] Alberty, Goldberg, Biochemistry
31:10610 (1992). [3] Yount, Babcock, Ballantyne, Ojala, Biochemistry 10:2484 (1971). [4] Perrin, Dissociation
Constants of Organic Bases (1965); Albert, Serjeant, The Determination of Ionization Constants (1984).
[5] Prankerd, Profiles Drug Subst. 33:1 (2007). [6] Bell, He, Wachter, Tonge, Biochemistry 39:4423 (2000).
[7] Dawson et al. (1986), as of ``net_charges``.
"""
_AT_METAL = "[$([CH]#N),$([#7+;!H0]),$([NX3;!H0]-S(=O)=O),$([SX2H]),$([OX2H]-[!$([CX4])])]"
"""Sites that lose a proton to a metal. An alcohol, as of a sugar at calcium, keeps its own."""
_KNOWN = Path(__file__).with_name("net_charges.csv")
_KNOWN_AT = 7.0
_SHIFTS = sorted((0.25 * k for k in range(-20, 21)), key=abs)
"""pH by which rules are shifted to a charge that is known."""


def at_ph(
    molecule: Molecule, ph: float, donors: Collection[str] = ()
) -> tuple[Molecule, tuple[Charged, ...]]:
    """Return a molecule as it is at a pH, and what was changed: Hydrogens that stay are where they were.

    The donors of a metal of the molecule do not change.
    """
    neutral = library("rdkit.Chem.MolStandardize.rdMolStandardize").Uncharger()
    made, rank = _numbered(molecule)
    smiles = library("rdkit.Chem").MolToSmiles(quietly(neutral.uncharge, made))
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


def at_metal(molecule: Molecule, holding: Collection[int]) -> tuple[Molecule, tuple[Charged, ...]]:
    """Return a molecule without the protons that metals displace, and what changed; azoles keep theirs."""
    if not holding:
        return molecule, ()
    state, rank = _numbered(molecule)
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


def _numbered(molecule: Molecule) -> tuple[Any, list[int]]:
    """Heavy atoms numbered by isotopes, since dimorphite-dl drops map numbers, and the rank of each atom."""
    chem, made = library("rdkit.Chem"), to_rdkit(molecule)
    rank = list(chem.CanonicalRankAtoms(made))
    for atom in made.GetAtoms():
        atom.SetIsotope(atom.GetIdx() + 1 if atom.GetAtomicNum() != 1 else 0)
    return chem.RemoveAllHs(made), rank


def _in_state(molecule: Molecule, state: Any) -> tuple[Molecule, tuple[Charged, ...]]:
    """The molecule with charges, hydrogens and orders of bonds as its numbered heavy atoms have them."""
    chem, made = library("rdkit.Chem"), to_rdkit(molecule)
    chem.Kekulize(state)
    surplus, changed = [], []
    for as_is in state.GetAtoms():
        number = _number(as_is)
        atom = made.GetAtomWithIdx(number)
        hydrogens = [near.GetIdx() for near in atom.GetNeighbors() if near.GetAtomicNum() == 1]
        n = as_is.GetTotalNumHs()
        surplus += hydrogens[n:]
        if as_is.GetFormalCharge() != atom.GetFormalCharge():
            changed.append(Charged(molecule.names[number], atom.GetFormalCharge(), as_is.GetFormalCharge()))
        atom.SetFormalCharge(as_is.GetFormalCharge())
        atom.SetNumExplicitHs(max(0, n - len(hydrogens)))
    if not surplus and not any(atom.GetNumExplicitHs() for atom in made.GetAtoms()):
        return molecule, ()
    # Not by Kekulize: a ring with a hydrogen too many, as of histidinium made neutral, has no such form yet.
    for each in (*made.GetAtoms(), *made.GetBonds()):
        each.SetIsAromatic(False)
    for bond in state.GetBonds():
        ends = _number(bond.GetBeginAtom()), _number(bond.GetEndAtom())
        made.GetBondBetweenAtoms(*ends).SetBondType(bond.GetBondType())
    for number in sorted(surplus, reverse=True):
        made.RemoveAtom(number)
    chem.SanitizeMol(made)
    return from_rdkit(made, molecule.source), tuple(sorted(changed, key=lambda each: each.atom))


@lru_cache(maxsize=1)
def net_charges() -> Mapping[str, int]:
    """Net charges at pH 7 that the literature gives, by the skeleton of the molecule.

    Its sources: ChEBI, major species at pH 7.3 (Hastings et al., Nucleic Acids Res. 44:D1214, 2016), whose
    dUTP(3-) and lysine(0) are not taken; MetaCyc, at pH 7.3 (Caspi et al., Nucleic Acids Res. 48:D445, 2020);
    ``groups``, by the pKa of theirs as of acids and phosphates elsewhere in the table; and from pKa, Dawson,
    Elliott, Elliott, Jones, Data for Biochemical Research (1986); Goldberg, Kishore, Lennen, J. Phys. Chem.
    Ref. Data 31:231 (2002); Massey, Biochem. Soc. Trans. 28:283 (2000), of flavins, whose N3 has 10; Perrin
    (1965, 1982), Prankerd (2007) and Yount (1971) as for ``RULES``.
    """
    with _KNOWN.open() as lines:
        return {row["skeleton"]: int(row["charge"]) for row in csv.DictReader(lines)}


def skeleton(molecule: Molecule) -> str:
    """First block of the InChIKey: the same for an acid and its anion, tautomers and stereoisomers."""
    return str(quietly(library("rdkit.Chem").MolToInchiKey, to_rdkit(molecule)))[:14]


def with_hydrogens(molecule: Molecule, count: Mapping[int, int]) -> Molecule | None:
    """Return a molecule with these numbers of hydrogens, each a charge; None unless carbons keep theirs."""
    # Others gain or lose one, all alike: of a tautomer bonds would change.
    chem = library("rdkit.Chem")
    made = to_rdkit(molecule)
    more = set()
    surplus = []
    for i, wanted in count.items():
        here = made.GetAtomWithIdx(i)
        hydrogens = [near.GetIdx() for near in here.GetNeighbors() if near.GetAtomicNum() == 1]
        change = wanted - len(hydrogens)
        if change:
            more.add(change)
            if here.GetAtomicNum() == 6:
                return None
        here.SetFormalCharge(here.GetFormalCharge() + change)
        here.SetNumExplicitHs(max(change, 0))
        surplus += hydrogens[wanted:]
    if not more:
        return molecule
    if more not in ({1}, {-1}):
        return None
    for i in sorted(surplus, reverse=True):
        made.RemoveAtom(i)
    try:
        quietly(chem.SanitizeMol, made)
        made = chem.AddHs(made, addCoords=True)
        x = made.GetConformer().GetPositions() / ANGSTROM_PER_NM
        # The stereo is that of the source: at these positions it may be another.
        made.RemoveAllConformers()
        return replace(from_rdkit(made, molecule.source), positions=read_only(x))
    except (ValueError, StructureError):
        return None


def _shift(smiles: str, charge: int, rank: list[int]) -> float:
    """Smallest shift of the pH that gives a molecule its charge at pH 7; none if no shift does."""
    for shift in _SHIFTS:
        state = _state(smiles, _KNOWN_AT + shift, rank)
        if state is not None and sum(atom.GetFormalCharge() for atom in state.GetAtoms()) == charge:
            return shift
    return 0.0


def _state(smiles: str, ph: float, rank: list[int]) -> Any:
    """RDKit's molecule in its most populated state, isotopes as in the SMILES; None if there is none."""
    state = next(iter(_states(smiles, ph, 0.0)), None)
    if state is None:
        return None
    unlikely = [
        atom for atom in state.GetAtoms()
        if atom.GetFormalCharge() < 0
        and (atom.GetAtomicNum() == 7 or any(near.GetIsAromatic() for near in atom.GetNeighbors()))
    ]  # fmt: skip
    unsure = _states(smiles, ph, 1.0) if unlikely else []
    keep = {_number(a) for each in unsure for a in each.GetAtoms() if not a.GetFormalCharge()}
    for atom in unlikely:
        if _number(atom) in keep:
            _change(atom, 1)
    for rule in RULES:
        if ph > rule.pka if rule.gain < 0 else ph < rule.pka:
            _apply(state, rule.smarts, rule.gain, rank)
    return state


def _apply(state: Any, smarts: str, gain: int, rank: list[int], among: Collection[int] | None = None) -> None:
    """Let sites that a pattern matches gain or lose a proton, one by one, until none is left."""
    # The first to lose is the one in most matches, as the middle one of three amines in a row, then the one
    # with more neighbours but one that draw electrons, then the one with fewer hydrogens.
    query = library("rdkit.Chem").MolFromSmarts(smarts)
    while True:
        often = Counter(match[0] for match in state.GetSubstructMatches(query, uniquify=False))
        sites = [state.GetAtomWithIdx(k) for k in often]
        sites = [atom for atom in sites if among is None or _number(atom) in among]
        if not sites:
            return
        site = min(
            sites, key=lambda a: (-often[a.GetIdx()], -_drawing(a), a.GetTotalNumHs(), rank[_number(a)])
        )
        _change(site, gain)
        state.UpdatePropertyCache(strict=False)


def _drawing(atom: Any) -> int:
    """Neighbours of an atom's neighbours that are no saturated carbons."""
    sp3 = library("rdkit.Chem").HybridizationType.SP3
    far = (each for near in atom.GetNeighbors() for each in near.GetNeighbors())
    return sum(each.GetAtomicNum() != 6 or each.GetHybridization() != sp3 for each in far)


def _change(atom: Any, gain: int) -> None:
    atom.SetNumExplicitHs(atom.GetTotalNumHs() + gain)
    atom.SetFormalCharge(atom.GetFormalCharge() + gain)


def _number(atom: Any) -> int:
    """Number of the atom in the molecule, which its isotope tells."""
    return int(atom.GetIsotope()) - 1


def _states(smiles: str, ph: float, precision: float) -> list[Any]:
    """RDKit's molecule of each state; sites whose pKa is within so many standard deviations have two."""
    chem, most = library("rdkit.Chem"), 128 if precision else 1
    made = library("dimorphite_dl").protonate_smiles(
        smiles, ph_min=ph, ph_max=ph, precision=precision, max_variants=most
    )
    return [chem.MolFromSmiles(each) for each in made]
