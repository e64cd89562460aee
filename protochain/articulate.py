"""Structure -> Chain: rigid bodies, hinges and loops. The one place that knows proteins and mechanics."""

from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from protochain import defaults, residues
from protochain.arrays import Floats, Integers, read_only
from protochain.chain import Chain, Hinge, dihedral
from protochain.errors import ChainError
from protochain.multibody import Frames, HingeKind, Tree, rigid_bodies
from protochain.structure.convert import as_structure
from protochain.structure.model import Structure
from protochain.structure.select import select

HINGES = ("phi", "psi", "omega", "chi", "rotors", "angles")
"""Kinds of hinge that can be opened."""

ON_AXIS = np.deg2rad(5.0)
"""A hinge is closed if all it carries lies this near its axis: the threshold of cctbx's scitbx/rigid_body."""


def build_chain(
    structure: Structure,
    hinges: str = defaults.HINGES,
    root: str = defaults.ROOT,
    *,
    move: str = defaults.MOVE,
    hydrogen_mass: float | None = None,
) -> Chain:
    """Cut a structure into rigid bodies joined by hinges.

    Parameters
    ----------
    structure : Structure
    hinges : str
        Kinds of bond that turn, of ``phi psi omega chi rotors``; with ``angles``, the backbone's bond angles
        at N and C-alpha open too, wherever phi or psi beside them turns. Rings are always rigid.
    root : str
        ``fixed``, ``free``, or ``auto``: free where several chains move against one another. A chain with
        atoms that may not move is always fixed.
    move : str
        What may move, in the selection language of MDAnalysis: a hinge turns if the third atom of its
        dihedral is selected (``resid 5:20``: all dihedrals of these residues; ``not backbone``: side chains
        only). Turning one carries along all that hangs on it; atoms that are not selected stay where they are
        only in methods that move single atoms, and between hinges that are all closed.
    hydrogen_mass : float, optional, amu
        Mass of a hydrogen, taken from the atom it is bonded to: light rotors turn slower, and dynamics can
        take longer steps. Equilibria do not change, only how fast they are reached.

    Returns
    -------
    Chain
        One tree for each chain, rooted at the C-alpha unit of its middle residue; with a selection, at the
        largest body that is not of it.

    Raises
    ------
    ChainError
        If a kind of hinge is unknown, nothing can turn, or hydrogens would take more than there is.
    StructureError
        If the selection cannot be read or names no atom.
    """
    kinds = hinges.split()
    unknown = [kind for kind in kinds if kind not in HINGES]
    if unknown:
        raise ChainError(f"hinges {unknown[0]!r} is not a kind of hinge; choose from {' '.join(HINGES)}")
    if root not in ("auto", "fixed", "free"):
        raise ChainError(f"root {root!r} is not known; choose auto, fixed or free")

    moving = ~structure.obstacle if move == "all" else select(structure, move) & ~structure.obstacle
    cut = _is_loop(structure)
    bonds = structure.bonds[~cut]
    wanted = [hinge for hinge in _hinges(structure, kinds) if moving[hinge.atoms[2]]]
    turning, group = _turning(structure, bonds, wanted)
    if not turning:
        of = "" if move == "all" else f" in {move!r}"
        raise ChainError(f"{structure.name}: no bond turns with hinges {hinges!r}{of}; open more of them")
    molecule = _components(structure.n_atoms, bonds)
    if structure.obstacle.any():
        # All that is kept beside the protein is one body, which stands still.
        molecule[structure.obstacle], group[structure.obstacle] = molecule.max() + 1, group.max() + 1
        molecule, group = (np.unique(of, return_inverse=True)[1] for of in (molecule, group))
    parts = [np.flatnonzero(molecule == m) for m in range(molecule.max() + 1)]
    roots = [_root_atom(structure, atoms, moving, group) for atoms in parts]
    # What holds atoms that are to stay does not move as a whole either.
    loose = root == "free" or (root == "auto" and len(roots) > 1)
    free = [loose and bool(moving[atoms].all()) for atoms in parts]
    tree, atom_body, atom_local, carried, q0 = _walk(
        structure, _masses(structure, hydrogen_mass), turning, group, roots, free, "angles" in kinds
    )
    return Chain(
        structure=structure,
        tree=tree,
        atom_body=read_only(atom_body, np.int64),
        atom_local=read_only(atom_local),
        hinges=tuple(hinge for _, hinge in carried),
        hinge_body=read_only([body for body, _ in carried], np.int64),
        loops=read_only(structure.bonds[cut], np.int64),
        q0=read_only(q0),
        opened=hinges,
        root=root,
        move=move,
        moving=read_only(moving, np.bool_),
        hydrogen_mass=hydrogen_mass,
    )


def as_chain(source: Any) -> Chain:
    """Return a chain as it is, or cut with the default hinges what :func:`as_structure` can prepare."""
    return source if isinstance(source, Chain) else build_chain(as_structure(source))


def _masses(structure: Structure, hydrogen_mass: float | None) -> Floats:
    """Mass of each atom, amu, with hydrogens made as heavy as is asked for."""
    mass = structure.atom_mass.copy()
    if hydrogen_mass is None:
        return mass
    light = structure.atom_element == "H"
    for bond in structure.bonds:
        for hydrogen, heavy in (bond, bond[::-1]):
            if light[hydrogen] and not light[heavy]:
                mass[heavy] -= hydrogen_mass - mass[hydrogen]
                mass[hydrogen] = hydrogen_mass
    if not (hydrogen_mass > 0.0 and np.all(mass > 0.0)):
        raise ChainError(f"hydrogen-mass {hydrogen_mass:g} amu: give a mass above 0 and at most about 4")
    return mass


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
            a, b, c, d = (atom_at(r, name) for name in names)
            if kind in kinds and a is not None and b is not None and c is not None and d is not None:
                yield Hinge(
                    str(structure.residue_chain[r]),
                    str(residue_name),
                    str(structure.residue_number[r]),
                    str(structure.residue_insertion_code[r]),
                    label,
                    (a, b, c, d),
                )


def _turning(structure: Structure, bonds: Integers, hinges: list[Hinge]) -> tuple[list[Hinge], Integers]:
    """Hinges that turn something, and the rigid groups they join.

    A hinge that carries one group with all atoms near its own axis turns nothing that could be told: without
    inertia against it, it would spin at any rate (a phantom hinge). It is closed, and the rest looked at
    again.
    """
    while True:
        group = _rigid_groups(structure.n_atoms, bonds, hinges)
        hinges = [hinge for hinge in hinges if group[hinge.atoms[1]] != group[hinge.atoms[2]]]
        touching = Counter(int(group[atom]) for hinge in hinges for atom in hinge.atoms[1:3])
        real = [
            hinge
            for hinge in hinges
            if not any(
                touching[int(group[end])] == 1 and _on_axis(structure.positions, group, start, end)
                for start, end in (hinge.atoms[1:3], hinge.atoms[2:0:-1])
            )
        ]
        if len(real) == len(hinges):
            return hinges, group
        hinges = real


def _on_axis(x: Floats, group: Integers, start: int, end: int) -> bool:
    """Whether all atoms of the end's group lie within ON_AXIS of the axis, seen from the end atom."""
    axis = (x[end] - x[start]) / np.linalg.norm(x[end] - x[start])
    arms = x[group == group[end]] - x[end]
    across = np.linalg.norm(np.cross(arms, axis), axis=1)
    return bool(np.all(across <= np.sin(ON_AXIS) * np.linalg.norm(arms, axis=1)))


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


def _root_atom(structure: Structure, atoms: Integers, moving: np.ndarray, group: Integers) -> int:
    """Return an atom of the body that stays: the largest held one, or the middle."""
    held = atoms[~moving[atoms]]
    if len(held):
        return int(held[np.argmax(np.bincount(group[held])[group[held]])])
    return _middle_atom(structure, atoms)


def _middle_atom(structure: Structure, atoms: Integers) -> int:
    """Return the C-alpha of a molecule's middle residue: half the depth, half the growth of round-off."""
    present = np.unique(structure.atom_residue[atoms])
    middle = atoms[structure.atom_residue[atoms] == present[len(present) // 2]]
    alpha = middle[structure.atom_name[middle] == "CA"]
    return int(alpha[0] if len(alpha) else middle[0])


def _walk(
    structure: Structure,
    atom_mass: Floats,
    hinges: list[Hinge],
    group: Integers,
    roots: list[int],
    free: list[bool],
    angles: bool,
) -> tuple[Tree, Integers, Floats, list[tuple[int, Hinge]], list[float]]:
    """Walk outward from each root atom's group and number the bodies in that order.

    A root's frame is aligned with the world in the input pose, another body's has its z axis along its hinge,
    from the inner to the outer atom: so its dihedral grows with q whichever way it is passed.

    Returns
    -------
    Tree, (na,) int, (na, 3) float, list of (int, Hinge), list of float
        The tree, each atom's body and position there, the hinge each body hangs on, and q0.
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
    offset, placement, origin, rotation = (list[Floats]() for _ in range(4))
    carried: list[tuple[int, Hinge]] = []
    q0: list[float] = []
    for root, is_free in zip(roots, free, strict=True):
        centre = x[group == group[root]].mean(axis=0)
        queue = deque([int(group[root])])
        body_of[queue[0]] = len(parent)
        parent.append(-1)
        kind.append(HingeKind.FREE if is_free else HingeKind.FIXED)
        offset.append(np.zeros(3) if is_free else centre)
        placement.append(np.eye(3))
        origin.append(centre)
        rotation.append(np.eye(3))
        q0 += [1.0, 0.0, 0.0, 0.0, *centre] if is_free else []
        while queue:
            inboard = queue.popleft()
            for hinge, inner, outer in crossings.get(inboard, []):
                outboard = int(group[outer])
                if outboard in body_of:
                    continue
                queue.append(outboard)
                above = body_of[inboard]
                for freedom in _crossing(hinge, inner, angles):
                    axis, at = _axis(x, freedom, inner, outer)
                    q = _measure(x, freedom)
                    rotation.append(_frame_along(axis))
                    parent.append(above)
                    kind.append(HingeKind.REVOLUTE)
                    offset.append(rotation[above].T @ (x[at] - origin[above]))
                    back = Rotation.from_rotvec([0.0, 0.0, -q]).as_matrix()
                    placement.append(rotation[above].T @ rotation[-1] @ back)
                    origin.append(x[at])
                    q0.append(q)
                    above = len(parent) - 1
                    carried.append((above, freedom))
                body_of[outboard] = above
    walked = {hinge for _, hinge in carried}
    stuck = next((hinge for hinge in hinges if hinge not in walked), None)
    if stuck is not None:
        raise ChainError(f"{structure.name}: {stuck} lies in a ring of turning bonds; leave its kind closed")

    atom_body = np.array([body_of[int(g)] for g in group])
    frames = Frames(np.array(rotation), np.array(origin))
    mass, com, inertia = _bodies(x, atom_mass, atom_body, np.array(parent), carried, frames)
    tree = Tree(np.array(parent), np.array(kind), np.array(offset), np.array(placement), mass, com, inertia)
    return tree, atom_body, _in_frames(frames, atom_body, x), carried, q0


def _crossing(hinge: Hinge, inner: int, angles: bool) -> list[Hinge]:
    """Freedoms met when a turning bond is crossed from its inner atom: with ``angles`` two of them.

    Between them stands a body that has only shares of the bond's two atoms.
    """
    if not angles or hinge.kind not in ("phi", "psi"):
        return [hinge]
    name = "angle N" if hinge.kind == "phi" else "angle CA"
    angle = replace(hinge, kind=name, atoms=hinge.atoms[:3])
    return [angle, hinge] if inner == hinge.atoms[1] else [hinge, angle]


def _axis(x: Floats, hinge: Hinge, inner: int, outer: int) -> tuple[Floats, int]:
    """Direction of a hinge's axis, about which what lies outside turns as q grows, and an atom on it."""
    if not hinge.is_angle:
        return x[outer] - x[inner], outer
    before, at, after = hinge.atoms if inner == hinge.atoms[1] else hinge.atoms[::-1]
    return np.cross(x[before] - x[at], x[after] - x[at]), at


def _measure(x: Floats, hinge: Hinge) -> float:
    """Value of a dihedral or of a bond angle, rad."""
    if not hinge.is_angle:
        return dihedral(x[list(hinge.atoms)])
    u, v = (x[hinge.atoms[end]] - x[hinge.atoms[1]] for end in (0, 2))
    return float(np.arctan2(np.linalg.norm(np.cross(u, v)), u @ v))


def _frame_along(bond: Floats) -> Floats:
    """Return some rotation whose third column lies along the bond."""
    z = bond / np.linalg.norm(bond)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _in_frames(frames: Frames, body: Integers, x: Floats) -> Floats:
    """Positions x (n, 3) in the frames of their bodies."""
    return np.asarray(np.einsum("aji,aj->ai", frames.rotation[body], x - frames.origin[body]))


def _bodies(
    x: Floats,
    atom_mass: Floats,
    atom_body: Integers,
    parent: Integers,
    carried: list[tuple[int, Hinge]],
    frames: Frames,
) -> tuple[Floats, Floats, Floats]:
    """Mass, centre of mass and inertia of each body.

    An atom on a hinge's axis is at rest in both of its bodies, so its mass may be counted in either. Shared
    equally, it makes bodies of one atom or of a line of atoms full, and leaves M(q) as it is.
    """
    holders: dict[int, set[int]] = {}
    for body, hinge in carried:
        for atom in hinge.on_axis:
            holders.setdefault(atom, set()).update((body, int(parent[body])))
    atoms = np.arange(len(x))
    alone = ~np.isin(atoms, list(holders))
    shares = [(atom, body, 1.0 / len(bodies)) for atom, bodies in holders.items() for body in sorted(bodies)]
    point_atom = np.concatenate([atoms[alone], np.array([a for a, _, _ in shares], dtype=np.int64)])
    point_body = np.concatenate([atom_body[alone], np.array([b for _, b, _ in shares], dtype=np.int64)])
    part = np.concatenate([np.ones(alone.sum()), [share for _, _, share in shares]])
    local = _in_frames(frames, point_body, x[point_atom])
    return rigid_bodies(point_body, local, part * atom_mass[point_atom], len(frames.origin))
