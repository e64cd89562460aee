"""Structure -> Chain: rigid bodies, hinges and loops. The one place that knows proteins and mechanics."""

from collections import deque
from collections.abc import Iterator

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from protochain import residues
from protochain.arrays import Floats, Integers, read_only
from protochain.chain import Chain, Hinge, dihedral
from protochain.errors import ChainError
from protochain.multibody import HingeKind, Tree
from protochain.structure.model import Structure

HINGES = ("phi", "psi", "omega", "chi", "rotors")
"""Kinds of hinge that can be opened."""


def build_chain(structure: Structure, hinges: str = "phi psi chi", root: str = "auto") -> Chain:
    """Cut a structure into rigid bodies joined by hinges.

    Parameters
    ----------
    structure : Structure
    hinges : str
        Kinds of bond that turn, of ``phi psi omega chi rotors``. Rings are always rigid.
    root : str
        ``fixed``, ``free``, or ``auto``: free where several chains move against one another.

    Returns
    -------
    Chain
        One tree for each chain, rooted at the C-alpha unit of its middle residue.

    Raises
    ------
    ChainError
        If a kind of hinge is unknown or nothing can turn.
    """
    kinds = hinges.split()
    unknown = [kind for kind in kinds if kind not in HINGES]
    if unknown:
        raise ChainError(f"hinges {unknown[0]!r} is not a kind of hinge; choose from {' '.join(HINGES)}")
    if root not in ("auto", "fixed", "free"):
        raise ChainError(f"root {root!r} is not known; choose auto, fixed or free")

    cut = _is_loop(structure)
    bonds = structure.bonds[~cut]
    opened = list(_hinges(structure, kinds))
    group = _rigid_groups(structure.n_atoms, bonds, opened)
    turning = [hinge for hinge in opened if group[hinge.atoms[1]] != group[hinge.atoms[2]]]
    if not turning:
        raise ChainError(f"{structure.name}: no bond turns with hinges {hinges!r}; open more kinds of hinge")
    molecule = _components(structure.n_atoms, bonds)
    roots = [_middle_atom(structure, np.flatnonzero(molecule == m)) for m in range(molecule.max() + 1)]
    free = root == "free" or (root == "auto" and len(roots) > 1)
    tree, atom_body, origin, carried, q0 = _walk(structure, turning, group, roots, free)
    return Chain(
        structure=structure,
        tree=tree,
        atom_body=read_only(atom_body, np.int64),
        atom_local=read_only(structure.positions - origin[atom_body]),
        hinges=tuple(hinge for _, hinge in carried),
        hinge_body=read_only([body for body, _ in carried], np.int64),
        loops=read_only(structure.bonds[cut], np.int64),
        q0=read_only(q0),
        opened=hinges,
        root=root,
    )


def _is_loop(structure: Structure) -> np.ndarray:
    """(nbonds,) bool: bonds between residues other than the peptide bond to the next residue."""
    first, second = structure.bonds.T
    r1, r2 = structure.atom_residue[first], structure.atom_residue[second]
    peptide = (r2 == r1 + 1) & (structure.atom_name[first] == "C") & (structure.atom_name[second] == "N")
    return (r1 != r2) & ~peptide


def _hinges(structure: Structure, kinds: list[str]) -> Iterator[Hinge]:
    """Yield every hinge whose four atoms are present, in residue order."""
    index = [dict[str, int]() for _ in range(structure.n_residues)]
    for atom, (name, residue) in enumerate(zip(structure.atom_name, structure.atom_residue, strict=True)):
        index[residue][str(name)] = atom
    chain_index = structure.residue_chain_index

    def atom_at(residue: int, name: str) -> int | None:
        other = residue + {"+": 1, "-": -1}.get(name[-1], 0)
        if not 0 <= other < structure.n_residues or chain_index[other] != chain_index[residue]:
            return None
        return index[other].get(name.rstrip("+-"))

    for r, residue_name in enumerate(structure.residue_name):
        table: list[tuple[str, str, tuple[str, ...]]] = [("phi", "phi", residues.PHI)]
        terminal = atom_at(r, "N+") is None
        table.append(("psi", "psi", residues.PSI_TERMINAL if terminal else residues.PSI))
        table.append(("omega", "omega", residues.OMEGA))
        chis = residues.CHI.get(str(residue_name), ())
        table += [("chi", f"chi{i}", names) for i, names in enumerate(chis, 1)]
        rotors = (*residues.ROTORS.get(str(residue_name), ()), residues.ROTOR_N_TERMINAL)
        table += [("rotors", "rotor", names) for names in rotors]
        for kind, label, names in table:
            atoms = tuple(atom_at(r, name) for name in names)
            if kind in kinds and None not in atoms:
                yield Hinge(
                    str(structure.residue_chain[r]),
                    str(residue_name),
                    str(structure.residue_number[r]),
                    str(structure.residue_insertion_code[r]),
                    label,
                    atoms,  # type: ignore[arg-type]
                )


def _components(n_atoms: int, bonds: Integers) -> Integers:
    graph = coo_array((np.ones(len(bonds), dtype=np.int8), bonds.T), shape=(n_atoms, n_atoms))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def _rigid_groups(n_atoms: int, bonds: Integers, hinges: list[Hinge]) -> Integers:
    """(na,) int: atoms that stay joined when every hinge bond is taken away.

    Both ends of a ring bond (proline's phi) stay in one group: such a hinge does not turn.
    """
    turning = {frozenset(hinge.atoms[1:3]) for hinge in hinges}
    rigid = np.array([frozenset(bond) not in turning for bond in bonds.tolist()], dtype=bool)
    return _components(n_atoms, bonds[rigid])


def _middle_atom(structure: Structure, atoms: Integers) -> int:
    """Return the C-alpha of a molecule's middle residue: half the depth, half the growth of round-off."""
    present = np.unique(structure.atom_residue[atoms])
    middle = atoms[structure.atom_residue[atoms] == present[len(present) // 2]]
    alpha = middle[structure.atom_name[middle] == "CA"]
    return int(alpha[0] if len(alpha) else middle[0])


def _walk(
    structure: Structure, hinges: list[Hinge], group: Integers, roots: list[int], free: bool
) -> tuple[Tree, Integers, Floats, list[tuple[int, Hinge]], list[float]]:
    """Walk outward from each root atom's group and number the bodies in that order.

    Every frame is aligned with the world in the input pose. A hinge turns what lies outboard about the
    axis from its inner to its outer atom, so its dihedral grows with q whichever way it is passed.

    Returns
    -------
    Tree, (na,) int, (nb, 3) float, list of (int, Hinge), list of float
        The tree, each atom's body, the bodies' origins, the hinge each body hangs on, and q0.
    """
    x = structure.positions
    crossings: dict[int, list[tuple[Hinge, int, int]]] = {}
    for hinge in hinges:
        _, b, c, _ = hinge.atoms
        crossings.setdefault(int(group[b]), []).append((hinge, b, c))
        crossings.setdefault(int(group[c]), []).append((hinge, c, b))

    body_of: dict[int, int] = {}
    parent: list[int] = []
    kind: list[HingeKind] = []
    axis, offset, placement, origin = (list[Floats]() for _ in range(4))
    carried: list[tuple[int, Hinge]] = []
    q0: list[float] = []
    for root in roots:
        centre = x[group == group[root]].mean(axis=0)
        queue = deque([int(group[root])])
        body_of[queue[0]] = len(parent)
        parent.append(-1)
        kind.append(HingeKind.FREE if free else HingeKind.FIXED)
        axis.append(np.zeros(3))
        offset.append(np.zeros(3) if free else centre)
        placement.append(np.eye(3))
        origin.append(centre)
        q0 += [1.0, 0.0, 0.0, 0.0, *centre] if free else []
        while queue:
            inboard = queue.popleft()
            for hinge, inner, outer in crossings.get(inboard, []):
                outboard = int(group[outer])
                if outboard in body_of:
                    continue
                body_of[outboard] = len(parent)
                queue.append(outboard)
                carried.append((len(parent), hinge))
                along = (x[outer] - x[inner]) / np.linalg.norm(x[outer] - x[inner])
                q = dihedral(x[list(hinge.atoms)])
                parent.append(body_of[inboard])
                kind.append(HingeKind.REVOLUTE)
                axis.append(along)
                offset.append(x[outer] - origin[body_of[inboard]])
                placement.append(Rotation.from_rotvec(-q * along).as_matrix())
                origin.append(x[outer])
                q0.append(q)
    if len(carried) < len(hinges):
        walked = {hinge for _, hinge in carried}
        stuck = next(hinge for hinge in hinges if hinge not in walked)
        raise ChainError(f"{structure.name}: {stuck} lies in a ring of turning bonds; leave its kind closed")

    tree = Tree(*map(np.array, (parent, kind, axis, offset, placement)))
    return tree, np.array([body_of[int(g)] for g in group]), np.array(origin), carried, q0
