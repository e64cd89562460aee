"""Structure -> Chain: rigid bodies, hinges and loops. Proteins and mechanics meet only here."""

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from protochain.chains.chain import Chain
from protochain.chains.hinges import HINGES, Hinge, cross_links, find_hinges, turning_hinges
from protochain.core import defaults
from protochain.core.arrays import Floats, Integers, angle, cross, dihedral, dots, read_only
from protochain.core.checks import check_arguments, kinds, one_of, quantity, selection
from protochain.core.errors import Argument, ChainError
from protochain.core.graph import components, group_members
from protochain.core.settings import inheriting
from protochain.core.timings import part
from protochain.energies import Energy, as_energy
from protochain.mechanics.multibody import Frames, HingeKind, Tree, rigid_bodies
from protochain.structure.convert import as_structure
from protochain.structure.molecule.model import Structure
from protochain.structure.select import move_argument
from protochain.structure.select import moving_mask as moving_atoms

_SINGLE = ("phi", "psi", "omega", "chi")  # Kinds whose single hinges can be opened or frozen by name.
_STRAIGHT = 0.05  # Carbon dioxide with rounded coordinates is straight, water (0.5) is not.


def _as_of(build: Callable[..., Chain], source: Any, arguments: dict[str, Any]) -> Chain:
    """Build the chain of a source. Arguments without a name are those from the chain of the source."""
    chain: Any = getattr(source, "chain", source)
    brought: dict[str, Any] = move_argument(source)
    if isinstance(chain, Chain):
        brought |= {"hinges": chain.opened, "root": chain.root, "hydrogen_mass": chain.hydrogen_mass}
    return build(source, **(brought | arguments))


@check_arguments(
    hinges=kinds, root=one_of(("auto", "fixed", "free")), move=selection, hydrogen_mass=quantity("dalton")
)
@inheriting(_as_of)
@part("chain")
def build_chain(
    structure: Any,
    hinges: str | Iterable[str] = defaults.HINGES,
    root: str = defaults.ROOT,
    *,
    move: str = defaults.MOVE,
    hydrogen_mass: float | None = None,
) -> Chain:
    """Divide a structure into rigid bodies joined by hinges.

    Parameters
    ----------
    structure : Structure, path, or any argument of :func:`protochain.as_structure`
        Structure with all its hydrogens. A chain or a result supplies all arguments that are not given.
    hinges : str or sequence of str
        Kinds of bond that turn: any of ``phi psi omega chi rotors``. ``polar`` is the rotors of O-H, S-H and
        N-H groups. ``angles`` adds the backbone bond angles at N and C-alpha next to a phi or psi that turns.
        ``nucleic`` is the backbone and the bases of DNA and RNA, ``ligand`` the single bonds of ligands,
        ``glycan`` the links of sugars. Rings are always rigid. ``phi@A:3`` opens one dihedral of a backbone
        or side chain, and ``-phi@A:3`` freezes it.
    root : str
        ``fixed``, ``free``, or ``auto``. With ``auto``, several chains are free to move relative to one
        another and to hetero molecules that have parameters. If there are obstacles, the largest chain stays
        in place. Methods with masses (``md``, ``anneal``, ``kcm-metric``, ``fire``, ``quench``, simulations,
        modes) free the roots that ``auto`` has fixed, because a fixed body has infinite mass. A chain with
        atoms outside the selection is always fixed.
    move : str
        Selection of mobile residues or atoms, in the selection language of MDAnalysis. A hinge turns if the
        third atom of its dihedral is selected. ``resid 5:20`` selects all dihedrals of these residues,
        ``sidechain`` the side chains, ``interface`` residues that touch another chain. All atoms beyond a
        hinge move with it. Methods that move single atoms move only selected atoms.
    hydrogen_mass : float, optional, amu
        Mass of every hydrogen, by hydrogen mass repartitioning from its heavy atom. Light rotors turn slower,
        so that time steps can be longer. Equilibrium averages do not change.

    Returns
    -------
    Chain
        One tree for each chain. Its root is at the C-alpha of the middle residue, or at the largest rigid
        body outside the selection.

    Raises
    ------
    ChainError
        If a kind of hinge is unknown, nothing can turn, or a heavy atom has too little mass.
    StructureError
        If the selection cannot be read or selects no atom.

    Examples
    --------
    >>> c = pc.build_chain(pc.from_sequence("GAG"))
    >>> c.n_bodies, c.n_hinges
    (6, 5)
    """
    structure, opened = as_structure(structure), str(hinges).split()
    open_kinds = [word for word in opened if "@" not in word]
    if unknown := [kind for kind in open_kinds if kind not in HINGES]:
        raise ChainError(f"hinges {unknown[0]!r} is not a kind of hinge; choose from {' '.join(HINGES)}")

    moving = moving_atoms(structure, move)
    cut = cross_links(structure)
    bonds = structure.bonds[~cut]
    single = {word.replace("@", " ") for word in opened if "@" in word}
    possible = find_hinges(structure, (*open_kinds, *(_SINGLE if single else ())))
    if strange := {name.removeprefix("-") for name in single} - {hinge.name for hinge in possible}:
        raise ChainError(
            f"{structure.name}: there is no hinge {min(strange)!r}; name it as phi@A:3 or chi1@A:3"
        )
    requested_kinds = [
        hinge for hinge in possible if moving[hinge.atoms[2]] and _is_requested(hinge, open_kinds, single)
    ]
    turning, group = turning_hinges(structure, bonds, requested_kinds)
    # A molecule without a backbone or side chain to turn, as ACE-NME, is one free body.
    is_body = not (requested_kinds or structure.mobile.any()) and move == defaults.MOVE
    is_body = is_body and " ".join(opened) == defaults.HINGES
    if not turning and not structure.mobile.any() and not is_body:
        of = "" if move == "all" else f" in {move!r}"
        raise ChainError(f"{structure.name}: no bond turns with hinges {hinges!r}{of}; open more kinds")
    # Molecules, a root atom of each, and the freedom of each root.
    molecule = components(bonds, structure.n_atoms)
    if structure.obstacle.any():
        # All obstacles form one fixed body.
        molecule[structure.obstacle], group[structure.obstacle] = molecule.max() + 1, group.max() + 1
        molecule, group = (np.unique(of, return_inverse=True)[1] for of in (molecule, group))
    parts = group_members(molecule)
    roots = [_root_atom(structure, atoms, moving, group) for atoms in parts]
    # A molecule with fixed atoms cannot translate or rotate as a whole.
    chains = [
        i
        for i, atoms in enumerate(parts)
        if not structure.obstacle[atoms].all()
        and not (structure.mobile[atoms].all() and _is_straight(structure.positions[atoms]))
    ]
    loose = root == "free" or (root == "auto" and (len(chains) > 1 or is_body))
    free = [loose and i in chains and bool(moving[atoms].all()) for i, atoms in enumerate(parts)]
    if root == "auto" and chains and len(chains) < len(parts):
        # The frame is fixed by obstacles, so that the largest chain must not drift away from them.
        free[max(chains, key=lambda i: len(parts[i]))] = False
    bodies, atom_body = _walk(structure.name, turning, group, roots, free, "angles" in opened)
    mass = _masses(structure, hydrogen_mass)
    tree, atom_local, q0 = _tree(structure.positions, mass, bodies, group, atom_body)
    return Chain(
        structure=structure,
        tree=tree,
        atom_body=read_only(atom_body, np.int64),
        atom_local=read_only(atom_local),
        hinges=tuple(body.hinge for body in bodies if body.hinge),
        hinge_body=read_only([b for b, body in enumerate(bodies) if body.hinge], np.int64),
        loops=read_only(structure.bonds[cut & ~structure.obstacle[structure.bonds].all(axis=1)], np.int64),
        q0=read_only(q0),
        opened=" ".join(opened),
        root=root,
        move=move,
        moving=read_only(moving, np.bool_),
        hydrogen_mass=hydrogen_mass,
    )


def _is_requested(hinge: Hinge, kinds: Sequence[str], single: set[str]) -> bool:
    """Whether a hinge is of a kind that is open, or opened by its name, and not frozen."""
    kind = hinge.kind.rstrip("12345")
    of_kind = kind in kinds or kind not in _SINGLE
    return (of_kind or hinge.name in single) and f"-{hinge.name}" not in single


def turned_atoms(chain: Chain) -> NDArray[np.bool_]:
    """Atoms (na,) that hinges and free roots move, selected or not."""
    return np.asarray(chain.tree.kind[chain.atom_body] != HingeKind.FIXED)


def _is_straight(x: Floats) -> bool:
    """Whether positions (n, 3) are one point or nearly on a line, about which a body could turn freely."""
    across = np.linalg.svd(x - x.mean(axis=0), compute_uv=False)
    return len(x) < 3 or bool(across[1] <= _STRAIGHT * across[0])


def with_energy(source: Any, energy: Any = None) -> tuple[Chain, Energy]:
    """Chain and energy of any argument of :func:`as_structure`. Results are divided again at their end."""
    chain = source if isinstance(source, Chain) else build_chain(source)
    return chain, as_energy(energy, chain.structure, source)


def run_identity(chain: Chain, energy: Energy) -> dict[str, Any]:
    """Properties of the input that a run must share with the checkpoint from which it resumes."""
    return {
        "hinges": chain.opened,
        "root": chain.root,
        "move": chain.move,
        "hydrogen_mass": chain.hydrogen_mass,
        "engine": energy.engine,
        "device": energy.device,
        "double_precision": energy.is_exact,
        "accuracy": energy.settings.get("accuracy"),
        "system": energy.fingerprint,
        "start": chain.structure.positions_fingerprint,
    }


def with_free_root(chain: Chain, hydrogen_mass: float | None = None) -> Chain:
    """Chain with free roots unless ``root`` is ``fixed``, and with another hydrogen mass if given."""
    mass = chain.hydrogen_mass if hydrogen_mass is None else hydrogen_mass
    if chain.root != "auto" and mass == chain.hydrogen_mass:
        return chain
    root = "free" if chain.root == "auto" else chain.root
    return build_chain(chain, root=root, hydrogen_mass=mass)


def transfer_coordinates(chain: Chain, target: Chain, q: Floats) -> Floats:
    """Convert coordinates q to a chain of the same bodies, whose roots may be free."""
    start = target.q0.copy()
    old, new = chain.tree.q_start, target.tree.q_start
    start[new[target.hinge_body]] = q[old[chain.hinge_body]]
    for b in np.flatnonzero(chain.tree.kind == HingeKind.FREE):
        start[new[b] : new[b] + 7] = q[old[b] : old[b] + 7]
    return start


def _masses(structure: Structure, hydrogen_mass: float | None) -> Floats:
    """Mass of each atom, amu, after hydrogen mass repartitioning."""
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
        raise ChainError(
            Argument("hydrogen_mass"), f" {hydrogen_mass:g} amu: give a mass above 0 and at most about 4"
        )
    return mass


def _root_atom(structure: Structure, atoms: Integers, moving: np.ndarray, group: Integers) -> int:
    """Return an atom of the root body: of the largest fixed group, or of the middle residue."""
    fixed = atoms[~moving[atoms]]
    if len(fixed):
        return int(fixed[np.argmax(np.bincount(group[fixed])[group[fixed]])])
    # The C-alpha of the molecule's middle residue: a shallow tree accumulates least round-off.
    present = np.unique(structure.atom_residue[atoms])
    middle = atoms[structure.atom_residue[atoms] == present[len(present) // 2]]
    alpha = middle[structure.atom_name[middle] == "CA"]
    return int(alpha[0] if len(alpha) else middle[0])


class _Body(NamedTuple):
    """Parent of a body, and the hinge between them. A root has no hinge and is named by one of its atoms."""

    parent: int
    kind: HingeKind
    hinge: Hinge | None
    inner: int
    outer: int


def _walk(
    name: str, hinges: list[Hinge], group: Integers, roots: list[int], free: list[bool], angles: bool
) -> tuple[list[_Body], Integers]:
    """Bodies in breadth-first order from the group of each root atom, and the body of each atom."""
    crossings: dict[int, list[tuple[Hinge, int, int]]] = {}
    for hinge in hinges:
        _, b, c, _ = hinge.atoms
        crossings.setdefault(int(group[b]), []).append((hinge, b, c))
        crossings.setdefault(int(group[c]), []).append((hinge, c, b))
    bodies: list[_Body] = []
    body_of: dict[int, int] = {}
    for root, is_free in zip(roots, free, strict=True):
        queue = deque([int(group[root])])
        body_of[queue[0]] = len(bodies)
        bodies.append(_Body(-1, HingeKind.FREE if is_free else HingeKind.FIXED, None, root, root))
        while queue:
            inboard = queue.popleft()
            for hinge, inner, outer in crossings.get(inboard, []):
                outboard = int(group[outer])
                if outboard in body_of:
                    continue
                queue.append(outboard)
                body_of[outboard] = body_of[inboard]
                for freedom in _freedoms(hinge, inner, angles):
                    bodies.append(_Body(body_of[outboard], HingeKind.REVOLUTE, freedom, inner, outer))
                    body_of[outboard] = len(bodies) - 1
    hinges_used = {body.hinge for body in bodies}
    unused = next((hinge for hinge in hinges if hinge not in hinges_used), None)
    if unused is not None:
        raise ChainError(f"{name}: {unused} is in a ring of rotatable bonds; do not open hinges of its kind")
    return bodies, np.array([body_of[int(g)] for g in group])


def _freedoms(hinge: Hinge, inner: int, angles: bool) -> list[Hinge]:
    """Hinges from the inner atom of a bond outward: dihedral, with ``angles`` a bond angle, too."""
    if not angles or hinge.kind not in ("phi", "psi"):
        return [hinge]
    name = "angle N" if hinge.kind == "phi" else "angle CA"
    angle = replace(hinge, kind=name, atoms=hinge.atoms[:3])
    return [angle, hinge] if inner == hinge.atoms[1] else [hinge, angle]


def _tree(
    x: Floats, atom_mass: Floats, bodies: list[_Body], group: Integers, atom_body: Integers
) -> tuple[Tree, Floats, Floats]:
    """Return the tree, positions (na, 3) of atoms in their bodies' frames, and q0."""
    # The frame of a root is aligned with the world in the input pose; the z axis of any other body lies along
    # its hinge, from the inner to the outer atom, so that its dihedral grows with q in either direction.
    parents, kinds = np.array([body.parent for body in bodies]), np.array([body.kind for body in bodies])
    hinged = parents >= 0
    rotation, placement = np.tile(np.eye(3), (2, len(bodies), 1, 1))
    offset, origin = np.zeros((2, len(bodies), 3))
    members = group_members(group)
    q0 = [np.empty(0) for _ in bodies]
    for b in np.flatnonzero(~hinged).tolist():
        origin[b] = x[members[group[bodies[b].outer]]].mean(axis=0)
        if kinds[b] == HingeKind.FREE:
            q0[b] = np.array([1.0, 0.0, 0.0, 0.0, *origin[b]])
        else:
            offset[b] = origin[b]
    axis, at, q = _axes(x, [body for body in bodies if body.hinge])
    rotation[hinged], origin[hinged] = _frames_along(axis), x[at]
    parent = parents[hinged]
    inward = rotation[parent].swapaxes(1, 2)
    offset[hinged] = (inward @ (x[at] - origin[parent])[:, :, None])[:, :, 0]
    back = Rotation.from_rotvec(-q[:, None] * [0.0, 0.0, 1.0]).as_matrix()
    placement[hinged] = inward @ rotation[hinged] @ back
    for b, value in zip(np.flatnonzero(hinged).tolist(), q, strict=True):
        q0[b] = value[None]
    frames = Frames(rotation, origin)
    mass, com, inertia = _inertias(x, atom_mass, atom_body, bodies, frames)
    tree = Tree(parents, kinds, offset, placement, mass, com, inertia)
    return tree, _in_frames(frames, atom_body, x), np.concatenate(q0)


def _axes(x: Floats, bodies: Sequence[_Body]) -> tuple[Floats, Integers, Floats]:
    """Directions (n, 3) of axes, about which the outer atoms turn as q grows, an atom on each, and q."""
    ends = np.array([(body.inner, body.outer) for body in bodies], dtype=np.int64).reshape(-1, 2)
    of = [body.hinge.atoms for body in bodies if body.hinge]
    axis, at, q = x[ends[:, 1]] - x[ends[:, 0]], ends[:, 1], np.empty(len(of))
    bent = np.array([len(atoms) == 3 for atoms in of], dtype=bool)
    q[~bent] = dihedral(*x[np.array([atoms for atoms in of if len(atoms) == 4], int).reshape(-1, 4).T])
    before, middle, after = np.array([atoms for atoms in of if len(atoms) == 3], int).reshape(-1, 3).T
    normal = cross(x[before] - x[middle], x[after] - x[middle])
    outward = ends[bent, 0] == middle
    axis[bent], at[bent] = np.where(outward[:, None], normal, -normal), middle
    q[bent] = angle(x[before], x[middle], x[after])
    return axis, at, q


def _frames_along(axis: Floats) -> Floats:
    """Rotations (n, 3, 3) whose third columns lie along axes (n, 3)."""
    z = axis / np.sqrt(dots(axis, axis))[:, None]
    x = cross(np.eye(3)[np.argmin(np.abs(z), axis=1)], z)
    x /= np.sqrt(dots(x, x))[:, None]
    return np.stack([x, cross(z, x), z], axis=2)


def _in_frames(frames: Frames, body: Integers, x: Floats) -> Floats:
    """Positions x (n, 3) in the frames of their bodies."""
    return np.asarray(np.einsum("aji,aj->ai", frames.rotation[body], x - frames.origin[body]))


def _inertias(
    x: Floats, atom_mass: Floats, atom_body: Integers, bodies: Sequence[_Body], frames: Frames
) -> tuple[Floats, Floats, Floats]:
    """Mass, centre of mass and inertia of each body."""
    # An atom on a hinge's axis is at rest in both bodies, so its mass may be assigned to either. Equal shares
    # give bodies of one atom or of a line of atoms a full inertia, and leave M(q) unchanged.
    holders: dict[int, set[int]] = {}
    for b, body in enumerate(bodies):
        for atom in body.hinge.on_axis if body.hinge else ():
            holders.setdefault(atom, set()).update((b, body.parent))
    atoms = np.arange(len(x))
    alone = ~np.isin(atoms, list(holders))
    shares = [(atom, body, 1.0 / len(owners)) for atom, owners in holders.items() for body in sorted(owners)]
    point_atom = np.concatenate([atoms[alone], np.array([a for a, _, _ in shares], dtype=np.int64)])
    point_body = np.concatenate([atom_body[alone], np.array([b for _, b, _ in shares], dtype=np.int64)])
    part = np.concatenate([np.ones(alone.sum()), [share for _, _, share in shares]])
    local = _in_frames(frames, point_body, x[point_atom])
    return rigid_bodies(point_body, local, part * atom_mass[point_atom], len(frames.origin))
