"""Charges of acids and bases at a pH: the most populated state of each site, by dimorphite-dl's table.

Ropp, Kaminsky, Yablonski, Durrant, J. Cheminform. 11:14 (2019).
"""

from dataclasses import dataclass

from protochain.core.arrays import Value
from protochain.core.errors import StructureError
from protochain.ligands.molecule import Molecule, from_rdkit, library, to_rdkit


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
    for atom in made.GetAtoms():
        atom.SetAtomMapNum(atom.GetIdx() + 1 if atom.GetAtomicNum() != 1 else 0)
    smiles = chem.MolToSmiles(chem.RemoveAllHs(made))
    # Without a margin each site has one state, but one whose pKa is the pH itself, which may be either.
    states = library("dimorphite_dl").protonate_smiles(
        smiles, ph_min=ph, ph_max=ph, precision=0.0, max_variants=1
    )
    charged = chem.MolFromSmiles(states[0]) if states else chem.Mol()
    chem.Kekulize(charged, clearAromaticFlags=True)
    chem.Kekulize(made, clearAromaticFlags=True)
    wanted = {atom.GetAtomMapNum() - 1: atom for atom in charged.GetAtoms()}
    if wanted.keys() != set(molecule.heavy.tolist()):
        raise StructureError(f"{molecule.source}: cannot be charged for pH {ph:g}; give it as it is there")
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
    for bond in charged.GetBonds():
        ends = (bond.GetBeginAtom().GetAtomMapNum() - 1, bond.GetEndAtom().GetAtomMapNum() - 1)
        made.GetBondBetweenAtoms(*ends).SetBondType(bond.GetBondType())
    for number in sorted(surplus, reverse=True):
        made.RemoveAtom(number)
    chem.SanitizeMol(made)
    return from_rdkit(made, molecule.source), tuple(sorted(changed, key=lambda each: each.atom))
