"""Modified residues that no force field has: the backbone of alanine, side chains by SMIRNOFF.

Their chemistry is that of the Chemical Component Dictionary, capped as in a chain by acetyl and methylamide.
"""

from functools import lru_cache

import gemmi

from protochain.core import defaults
from protochain.core.checks import CHARGE_RULES
from protochain.core.errors import ProtochainError, StructureError
from protochain.ligands import Ligand, parametrised
from protochain.ligands.molecule import Molecule, assembled, from_rdkit, library, quietly
from protochain.ligands.protonation import at_ph
from protochain.ligands.sources import from_dictionary
from protochain.structure.bound import Chemistry
from protochain.structure.draft import Member, Part
from protochain.structure.repairs import Why
from protochain.structure.templates import Template

_H, _C, _N, _O = 1, 6, 7, 8
PREVIOUS, FOLLOWING = ("CA-", "C-", "O-"), ("N+",)
"""Heavy atoms of the caps that stand for the neighbours in the chain; no term needs the methyl at N+."""
_METHYL = "CA+"


def settle(part: Part, i: int, chemistry: Chemistry) -> Why | None:
    """Give a modified residue of a chain its chemistry, or say why it has none."""
    member, first, last = part.members[i], i == 0 and not part.cyclic, i == len(part.members) - 1
    try:
        ligand = _capped(
            member.name,
            chemistry.charges if chemistry.charges in CHARGE_RULES else defaults.LIGAND_CHARGES,
            chemistry.ph,
        )
    except (ProtochainError, ValueError):  # RDKit's, of rings that it cannot kekulize once charged.
        return Why.PARENT
    molecule = ligand.molecule
    is_lactam, is_tertiary = PREVIOUS[1] not in molecule.names, "H" not in molecule.names
    if (is_lactam and not first) or (first and is_tertiary):
        return Why.END
    template = _template(member, ligand, first and not is_lactam, last and not part.cyclic)
    heavy = {atom.name for atom in member.atoms if not atom.is_hydrogen()}
    if heavy - {"OXT"} != {*template.heavy} - {"OXT"}:
        return Why.INCOMPLETE
    member.own, member.capped = template, ligand
    return None


def _template(member: Member, ligand: Ligand, charged: bool, acid: bool) -> Template:
    """Atoms of the residue, with a charged amine at the start of a chain, and a carboxylate at its end."""
    molecule = ligand.molecule
    charges = dict(zip(molecule.names, ligand.parameters.charge.tolist(), strict=True))
    caps = {*PREVIOUS, *FOLLOWING, _METHYL}
    bonds = [(molecule.names[i], molecule.names[j]) for i, j in molecule.bonds.tolist()]
    light = {n for n, z in zip(molecule.names, molecule.elements.tolist(), strict=True) if z == _H}
    caps |= {end for bond in bonds if {*bond} & caps for end in bond if end in light}
    element = {
        name: gemmi.Element(int(z)).name
        for name, z in zip(molecule.names, molecule.elements, strict=True)
        if name not in caps
    }
    bonds = [bond for bond in bonds if not {*bond} & caps]
    if charged:
        del element["H"]
        element |= dict.fromkeys(("H1", "H2", "H3"), "H")
        bonds = [bond for bond in bonds if "H" not in bond] + [("N", name) for name in ("H1", "H2", "H3")]
    if acid:
        element["OXT"] = "O"
        bonds.append(("C", "OXT"))
    # These only turn hydroxyls while hydrogens are placed; 0.3 e is about that of an ammonium's.
    known = {name: charges.get(name, -0.8 if name == "OXT" else 0.3) for name in element}
    return Template(member.name, element, known, tuple(bonds), {}, is_users=True)


@lru_cache(maxsize=64)
def _capped(name: str, charges: str, ph: float) -> Ligand:
    """Chemistry of a residue as it is in a chain.

    Raises
    ------
    ProtochainError
        If the dictionary lacks it, it is no amino acid, or a library or parameters lack.
    """
    made, charged = at_ph(_in_chain(name, from_dictionary(name)), ph)
    return parametrised(made, charges, charged=charged)


def _in_chain(name: str, free: Molecule) -> Molecule:
    """A free amino acid with caps in place of a hydrogen of its amine and of its hydroxyl."""
    atoms = {
        n: [int(z), int(q)] for n, z, q in zip(free.names, free.elements, free.formal_charges, strict=True)
    }
    bonds = {
        frozenset((free.names[i], free.names[j])): int(order)
        for (i, j), order in zip(free.bonds.tolist(), free.orders.tolist(), strict=True)
    }

    def near(atom: str) -> list[str]:
        return [end for bond in bonds if atom in bond for end in bond if end != atom]

    def hydrogens(atom: str) -> list[str]:
        return [each for each in near(atom) if atoms[each][0] == _H]

    def drop(gone: list[str]) -> None:
        for each in gone:
            del atoms[each]
        for bond in [bond for bond in bonds if bond & {*gone}]:
            del bonds[bond]

    if not {"N", "CA", "C", "O", "OXT"} <= atoms.keys() or not {"N", "C"} <= {*near("CA")}:
        raise StructureError(f"{name}: is no amino acid with the names of the archive")
    drop(hydrogens("OXT"))
    drop(["OXT"])
    atoms |= {"N+": [_N, 0], _METHYL: [_C, 0]}
    bonds |= {frozenset(("C", "N+")): 1, frozenset(("N+", _METHYL)): 1}
    acyl = any(bonds.get(frozenset((c, o))) == 2 and atoms[o][0] == _O for c in near("N") for o in near(c))
    if not acyl:
        drop(hydrogens("N")[1 if len(near("N")) - len(hydrogens("N")) == 1 else 0 :])
        atoms["N"][1] = 0
        atoms |= {"CA-": [_C, 0], "C-": [_C, 0], "O-": [_O, 0]}
        bonds |= {
            frozenset(pair): order
            for pair, order in ((("N", "C-"), 1), (("C-", "O-"), 2), (("C-", "CA-"), 1))
        }
    names = [*atoms]
    called = dict(zip(names, names, strict=True))
    called |= dict.fromkeys(hydrogens("N"), "H")
    alpha = hydrogens("CA")
    called |= dict(zip(alpha, ("HA2", "HA3") if len(alpha) == 2 else ("HA",), strict=False))
    made = assembled(
        [called[n] for n in names], [atoms[n][0] for n in names], [atoms[n][1] for n in names],
        [sorted(map(names.index, bond)) for bond in bonds], [*bonds.values()], None,
    )  # fmt: skip
    try:
        quietly(library("rdkit.Chem").SanitizeMol, made)
    except ValueError:
        raise StructureError(f"{name}: cannot be capped as in a chain") from None
    return from_rdkit(made, free.source)
