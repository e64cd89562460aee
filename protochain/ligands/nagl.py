"""Charges close to AM1-BCC by OpenFF NAGL's model openff-gnn-am1bcc-1.0.0, which belongs to Sage 2.3.0.

Six GraphSAGE layers (Hamilton, Ying, Leskovec, arXiv:1706.02216) have a readout of an initial charge, an
electronegativity and a hardness of each atom. These are equilibrated to the molecule's charge (Gilson,
Gilson, Potter, J. Chem. Inf. Comput. Sci. 43:1982, 2003). The model also has a table of the charges of
molecules with up to three heavy atoms, and a domain outside which it was not trained. See NOTICE.
"""

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.special import expit

from protochain.core.arrays import Floats
from protochain.core.graph import both_ways
from protochain.core.optional_libraries import library
from protochain.core.processors import one_blas_thread
from protochain.ligands.molecule import Molecule, in_mdl_aromaticity, quietly

_MODEL = Path(__file__).with_name("openff-gnn-am1bcc-1.0.0.npz")
_TABLE = _MODEL.with_suffix(".txt")  # Lines of InChI, SMILES, and charges in its order.
_LARGEST_TABULATED = 3  # Heavy atoms.
_DECIMALS = 6
"""Of e: atoms alike are alike in the last bit, and so is a molecule in another order of its atoms."""

_ELEMENTS = [6, 8, 1, 7, 16, 9, 35, 17, 53, 15]
_RINGS = (3, 4, 5, 6)
_MOST_BONDS = 6
_FORBIDDEN = (
    "[#15]#*", "[#15]-[#53]", "[#15]:*", "[#15]=[!#6&!#7&!#8&!#16]", "[#16]#*", "[#16]-[#35,#53]",
    "[#16]=[!#15&!#6&!#7&!#8]", "[#17]#,:,=*", "[#17]-[!#15&!#16&!#6&!#7&!#8]", "[#1]#,:,=*", "[#1]-[#1]",
    "[#35]#,:,=*", "[#35]-[!#15&!#6&!#7&!#8]", "[#53]#,:,=*", "[#53]-[!#53&!#6&!#7&!#8]", "[#7]#[!#7&!#6]",
    "[#8]#*", "[#9]#,:,=*", "[#9]-[!#15&!#16&!#6&!#7&!#8]",
)  # fmt: skip
"""Bonds that the model was not trained on."""
_NORMALISATIONS = (
    "[N,P,As,Sb;X3:1](=[O,S,Se,Te:2])=[O,S,Se,Te:3]>>[*+1:1](-[*-1:2])=[*:3]",
    "[S+2:1]([O-:2])([O-:3])>>[S+0:1](=[O-0:2])(=[O-0:3])",
    "[nH0+0:1]=[OH0+0:2]>>[n+:1]-[O-:2]",
    "[*:1][N:2]=[N:3]#[N:4]>>[*:1][N:2]=[N+:3]=[N-:4]",
    "[*:1]=[N:2]#[N:3]>>[*:1]=[N+:2]=[N-:3]",
    "[!O:1][S+0;X3:2](=[O:3])[!O:4]>>[*:1][S+1:2]([O-:3])[*:4]",
    "[O,S,Se,Te;-1:1][P+;D4:2][O,S,Se,Te;-1:3]>>[*+0:1]=[P+0;D5:2][*-1:3]",
    "[C,S&!$([S+]-[O-]);X3+1:1]([NX3:2])[NX3!H0:3]>>[*+0:1]([N:2])=[N+:3]",
    "[P;X4+1:1]([NX3:2])[NX3!H0:3]>>[*+0:1]([N:2])=[N+:3]",
    "[CX4:1][NX3H:2]-[NX3H:3][CX4:4][NX2+:5]#[NX1:6]>>[CX4:1][NH0:2]=[NH+:3][C:4][N+0:5]=[NH:6]",
    "[N,P,As,Sb,O,S,Se,Te;-1:1]-[A+0:2]=[N,P,As,Sb,O,S,Se,Te;+1:3]>>[*-0:1]=[*:2]-[*+0:3]",
    "[n,o,p,s;-1:1]:[a:2]=[N,O,P,S;+1:3]>>[*-0:1]:[*:2]-[*+0:3]",
    "[N,O,P,S;-1:1]-[a:2]:[n,o,p,s;+1:3]>>[*-0:1]=[*:2]:[*+0:3]",
    "[N,P,As,Sb,O,S,Se,Te;-1:1]-[A+0:2]=[A:3]-[A:4]=[N,P,As,Sb,O,S,Se,Te;+1:5]"
    ">>[*-0:1]=[*:2]-[*:3]=[*:4]-[*+0:5]",
    "[n,o,p,s;-1:1]:[a:2]:[a:3]:[c:4]=[N,O,P,S;+1:5]>>[*-0:1]:[*:2]:[*:3]:[c:4]-[*+0:5]",
    "[N,O,P,S;-1:1]-[c:2]:[a:3]:[a:4]:[n,o,p,s;+1:5]>>[*-0:1]=[c:2]:[*:3]:[*:4]:[*+0:5]",
    "[N,O;+0!H0:1]-[A:2]=[N!$(*[O-]),O;+1H0:3]>>[*+1:1]=[*:2]-[*+0:3]",
    "[n;+0!H0:1]:[c:2]=[N!$(*[O-]),O;+1H0:3]>>[*+1:1]:[*:2]-[*+0:3]",
    "[N,O;+0!H0:1]-[A:2]=[A:3]-[A:4]=[N!$(*[O-]),O;+1H0:5]>>[*+1:1]=[*:2]-[*:3]=[*:4]-[*+0:5]",
    "[n;+0!H0:1]:[a:2]:[a:3]:[c:4]=[N!$(*[O-]),O;+1H0:5]>>[n+1:1]:[*:2]:[*:3]:[*:4]-[*+0:5]",
    "[F,Cl,Br,I,At;-1:1]=[O:2]>>[*-0:1]-[O-:2]",
    "[N,P,As,Sb;-1:1]=[C+;v3:2]>>[*+0:1]#[C+0:2]",
)
"""Reactions of one molecule with itself, each repeated: nitro as N+(O-)=O, separated charges recombined."""
_KINDS = {
    (8, 0, (2,)): (False, 0), (8, -1, (1,)): (True, 5), (16, 0, (2,)): (False, 0), (16, -1, (1,)): (True, 5),
    (7, 1, (1, 1, 2)): (False, 5), (7, 0, (1, 1, 1)): (True, 0), (7, 0, (1, 2)): (False, 0),
    (7, -1, (1, 1)): (True, 5), (7, 0, (3,)): (False, 0), (7, -1, (2,)): (True, 5),
}  # fmt: skip
"""Whether an atom gives an electron pair to a resonance form, or accepts one, and its energy (Gilson et al.),
by element, charge and orders of its bonds. Afterwards it has the other of the two energies."""
_PAIR = 5  # Sum of the two.

Form = tuple[tuple[int, ...], tuple[int, ...]]
"""Charges of all atoms and orders of all bonds."""


def charges(molecule: Molecule) -> Floats:
    """Return the charges (na,), e, of the table, or as predicted, independent of the order of the atoms."""
    mol = in_mdl_aromaticity(molecule)
    tabulated = _look_up(molecule, mol)
    return np.round(_predict(molecule, _features(mol)) if tabulated is None else tabulated, _DECIMALS)


def outside(molecule: Molecule) -> tuple[str, ...]:
    """Return the names of the atoms that put a molecule outside the domain of the model."""
    mol = in_mdl_aromaticity(molecule)
    if _look_up(molecule, mol) is not None:
        return ()
    chem = library("rdkit.Chem")
    strange = {i for i, z in enumerate(molecule.elements.tolist()) if z not in _ELEMENTS}
    strange |= {atom.GetIdx() for atom in mol.GetAtoms() if atom.GetDegree() > _MOST_BONDS}
    for pattern in _FORBIDDEN:
        strange |= {i for match in mol.GetSubstructMatches(chem.MolFromSmarts(pattern)) for i in match}
    return tuple(molecule.names[i] for i in sorted(strange))


@lru_cache(maxsize=1)
def _weights() -> dict[str, Floats]:
    """Arrays of the model in double precision, so that rounded results do not depend on the order of sums."""
    with np.load(_MODEL) as stored:
        return {name: stored[name].astype(float) for name in stored}


@lru_cache(maxsize=1)
def _table() -> dict[str, list[str]]:
    rows = (line.split() for line in _TABLE.read_text(encoding="ascii").splitlines())
    return {row[0]: row[1:] for row in rows}


@lru_cache(maxsize=1)
def _reactions() -> list[Any]:
    parse = library("rdkit.Chem.rdChemReactions").ReactionFromSmarts
    return [parse(smarts) for smarts in _NORMALISATIONS]


def _predict(molecule: Molecule, features: Floats) -> Floats:
    """Charges by the network, of features (na, 22)."""
    w, n = _weights(), molecule.n_atoms
    i, j = both_ways(molecule.bonds).T
    mean = csr_array((1.0 / np.bincount(i, minlength=n)[i], (i, j)), shape=(n, n))
    h = features
    with one_blas_thread():  # Threads wait longer for each other than they compute.
        for k in range(6):
            h = np.maximum(h @ w[f"self{k}"].T + mean @ h @ w[f"near{k}"].T + w[f"bias{k}"], 0.0)
        h = expit(h @ w["dense0"].T + w["dense_bias0"])
        initial, electronegativity, hardness = (h @ w["dense1"].T + w["dense_bias1"]).T
    free = initial - electronegativity / hardness
    charges: Floats = free + (molecule.charge - free.sum()) / hardness / np.sum(1.0 / hardness)
    return charges


def _look_up(molecule: Molecule, mol: Any) -> Floats | None:
    """Charges of the table, averaged over equivalent atoms. None for a molecule that it lacks."""
    if len(molecule.heavy) > _LARGEST_TABULATED:
        return None
    chem = library("rdkit.Chem")
    row = _table().get(quietly(chem.MolToInchi, mol, "/LargeMolecules /FixedH"))
    if row is None:
        return None
    reading = chem.SmilesParserParams()
    reading.removeHs = reading.sanitize = False
    target, entry = chem.RWMol(mol), chem.RWMol(chem.MolFromSmiles(row[0], reading))
    chem.Kekulize(target, clearAromaticFlags=True)
    matches = target.GetSubstructMatches(entry, uniquify=False)
    if not matches:  # One InChI has several ways to draw charges and orders of bonds.
        for drawing in (target, entry):
            for bond in drawing.GetBonds():
                bond.SetBondType(chem.BondType.SINGLE)
            for atom in drawing.GetAtoms():
                atom.SetFormalCharge(0)
        matches = target.GetSubstructMatches(entry, uniquify=False)
    values = np.array(row[1:], dtype=float)
    return np.mean([values[np.argsort(match)] for match in matches], axis=0)


def _features(mol: Any) -> Floats:
    """Element, number of bonds, charge over resonance forms, and rings of each atom: (na, 22)."""
    charge = _resonant_charges(_normalise(mol))
    rows = []
    for atom, q in zip(mol.GetAtoms(), charge, strict=True):
        element = [float(atom.GetAtomicNum() == z) for z in _ELEMENTS]
        degree = [float(atom.GetDegree() == k) for k in range(_MOST_BONDS + 1)]
        rows.append([*element, *degree, q, *(float(atom.IsInRingSize(k)) for k in _RINGS)])
    return np.array(rows)


def _normalise(mol: Any) -> Any:
    """The molecule with charges and orders of bonds as the model was trained on, kekulised."""
    chem = library("rdkit.Chem")
    mol = chem.RWMol(mol)
    for reaction in _reactions():
        for _ in range(mol.GetNumAtoms()):
            if not reaction.RunReactantInPlace(mol):
                break
            mol.UpdatePropertyCache(strict=False)
    chem.SanitizeMol(mol, chem.SANITIZE_SYMMRINGS)
    chem.Kekulize(mol)
    return mol


def _resonant_charges(mol: Any) -> Floats:
    """Formal charges (na,), each the mean over the resonance forms of lowest energy."""
    atoms = list(mol.GetAtoms())
    form = (
        tuple(atom.GetFormalCharge() for atom in atoms),
        tuple(int(bond.GetBondTypeAsDouble()) for bond in mol.GetBonds()),
    )
    mean = np.array(form[0], dtype=float)
    # Hydrogen and saturated carbon pass on no electron pair.
    left = {
        atom.GetIdx()
        for atom in atoms
        if atom.GetAtomicNum() != 1
        and (atom.GetAtomicNum() != 6 or atom.GetDegree() != 4 or atom.GetFormalCharge())
    }
    while left:
        group = [left.pop()]
        for i in group:
            new = {near.GetIdx() for near in atoms[i].GetNeighbors()} & left
            left -= new
            group.extend(new)
        mean[group] = np.mean([charge for charge, _ in _lowest(form, [atoms[i] for i in group])], 0)[group]
    return mean


def _lowest(form: Form, group: list[Any]) -> list[Form]:
    """Forms of lowest energy of conjugated atoms."""
    # Two forms differ along paths that share no atom, whose differences in energy add up. Each is a move from
    # donor to acceptor, or one of donors and one of acceptors are two moves together: from a form that is not
    # lowest one or two moves lead to a lower one, and at one energy from each lowest to all.
    while (lower := next((new_form for cost, new_form in _steps(form, group) if cost < 0), None)) is not None:
        form = lower
    forms = {form[0]: form}
    reached = [form]
    for current in reached:
        for cost, new_form in _steps(current, group):
            if cost == 0 and new_form[0] not in forms:
                forms[new_form[0]] = new_form
                reached.append(new_form)
    return reached


def _steps(form: Form, group: list[Any]) -> Iterator[tuple[int, Form]]:
    """Forms one or two moves away that are not higher, with their costs."""
    for cost, new_form in _moves(form, group, 2 * _PAIR):
        if cost <= 0:
            yield cost, new_form
        else:
            yield from ((cost + second_cost, last) for second_cost, last in _moves(new_form, group, -cost))


def _moves(form: Form, group: list[Any], limit: int) -> Iterator[tuple[int, Form]]:
    """Forms after a pair moved from donor to acceptor along bonds whose orders alternate, and cost."""
    charge, order = form
    bonds = {
        atom.GetIdx(): {bond.GetOtherAtomIdx(atom.GetIdx()): bond.GetIdx() for bond in atom.GetBonds()}
        for atom in group
    }
    gives, cost = {}, {}
    for atom in group:
        i = atom.GetIdx()
        around = tuple(sorted(order[k] for k in bonds[i].values()))
        if (kind := _KINDS.get((atom.GetAtomicNum(), charge[i], around))) is not None:
            gives[i], cost[i] = kind[0], _PAIR - 2 * kind[1]
    for donor in (i for i in gives if gives[i]):
        acceptors = {i for i in gives if not gives[i] and cost[i] + cost[donor] <= limit}
        paths: list[tuple[tuple[int, ...], tuple[int, ...]]] = [((donor,), ())]
        while paths and acceptors:
            path, along = paths.pop()
            step = 1 if len(along) % 2 else -1
            for i, bond in bonds[path[-1]].items():
                if i not in bonds or i in path or (along and order[bond] - order[along[-1]] != step):
                    continue
                paths.append(((*path, i), (*along, bond)))
                if step > 0 and i in acceptors:
                    acceptors.remove(i)
                    orders, charges = list(order), list(charge)
                    for k, bond_index in enumerate((*along, bond)):
                        orders[bond_index] += -1 if k % 2 else 1
                    charges[donor] += 1
                    charges[i] -= 1
                    yield cost[donor] + cost[i], (tuple(charges), tuple(orders))
