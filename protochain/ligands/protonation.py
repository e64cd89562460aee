"""Charges of acids and bases at a pH: the most populated state of each site, by dimorphite-dl's table.

Its pKa of phenols, and of nitrogens that lose a proton, are means of classes with deviations of three units:
these lose theirs only if the pH is above by one deviation.

Ropp, Kaminsky, Yablonski, Durrant, J. Cheminform. 11:14 (2019).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from protochain.core.arrays import Value, read_only
from protochain.core.errors import StructureError
from protochain.core.units import ANGSTROM_PER_NM
from protochain.ligands.molecule import Molecule, from_rdkit, library, quietly, to_rdkit


@dataclass(frozen=True)
class Charged(Value):
    """An atom whose formal charge was changed.

    Parameters
    ----------
    atom : str
    before, after : int
    """

    atom: str
    before: int
    after: int


def at_ph(molecule: Molecule, ph: float) -> tuple[Molecule, tuple[Charged, ...]]:
    """Return a molecule as it is at a pH, and what was changed.

    Hydrogens that stay are where they were.

    Raises
    ------
    StructureError
        If the table makes another molecule of it.
    """
    chem = library("rdkit.Chem")
    made = to_rdkit(molecule)
    # Isotopes number the atoms: dimorphite-dl drops map numbers of atoms that it neutralises.
    for atom in made.GetAtoms():
        atom.SetIsotope(atom.GetIdx() + 1 if atom.GetAtomicNum() != 1 else 0)
    neutral = library("rdkit.Chem.MolStandardize.rdMolStandardize").Uncharger()
    smiles = chem.MolToSmiles(quietly(neutral.uncharge, chem.RemoveAllHs(made)))
    states = _states(smiles, ph, 0.0)
    if not states or states[0].keys() != set(molecule.heavy.tolist()):
        raise StructureError(f"{molecule.source}: cannot be charged for pH {ph:g}; give it as it is there")
    wanted, unsure = states[0], _states(smiles, ph, 1.0)
    bonds = next(iter(wanted.values())).GetOwningMol().GetBonds()
    for number, atom in wanted.items():
        aromatic = atom.GetAtomicNum() == 7 or any(near.GetIsAromatic() for near in atom.GetNeighbors())
        if atom.GetFormalCharge() < 0 and aromatic:
            other = (state[number] for state in unsure if not state[number].GetFormalCharge())
            wanted[number] = next(other, atom)
    surplus, changed = [], []
    for number, as_is in wanted.items():
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
    for bond in bonds:
        ends = (bond.GetBeginAtom().GetIsotope() - 1, bond.GetEndAtom().GetIsotope() - 1)
        made.GetBondBetweenAtoms(*ends).SetBondType(bond.GetBondType())
    for atom in made.GetAtoms():
        atom.SetIsotope(0)
    for number in sorted(surplus, reverse=True):
        made.RemoveAtom(number)
    chem.SanitizeMol(made)
    return from_rdkit(made, molecule.source), tuple(sorted(changed, key=lambda each: each.atom))


def with_hydrogens(molecule: Molecule, count: Mapping[int, int]) -> Molecule | None:
    """Return a molecule with these numbers of hydrogens, each more or less a charge; None if they do not fit.

    They fit if carbons keep theirs, and others gain or lose one, all alike: of a tautomer bonds would change.

    Parameters
    ----------
    molecule : Molecule
        With positions.
    count : mapping of int to int
        Of every heavy atom.
    """
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


def _states(smiles: str, ph: float, precision: float) -> list[dict[int, Any]]:
    """Atoms of each state by number; sites whose pKa is within so many standard deviations have two."""
    chem, most = library("rdkit.Chem"), 128 if precision else 1
    made = library("dimorphite_dl").protonate_smiles(
        smiles, ph_min=ph, ph_max=ph, precision=precision, max_variants=most
    )
    read = [chem.MolFromSmiles(each) for each in made]
    for each in read:
        chem.Kekulize(each)
    return [{atom.GetIsotope() - 1: atom for atom in each.GetAtoms()} for each in read]
