"""A protein as a tree of rigid bodies: where its atoms are at q, and what forces on them do at the hinges."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protochain import multibody
from protochain.arrays import Floats, Integers, floats, frozen, read_only
from protochain.multibody import Frames, Tree
from protochain.multibody.algebra import add, add_pair, cross, kernel, matrix, put, subtract, turned, vector
from protochain.structure.model import Structure


@dataclass(frozen=True)
class Hinge:
    """One freedom: where it is, what it is called, and the atoms that measure it.

    Parameters
    ----------
    chain, residue_name, residue_number, insertion_code : str
        The residue the dihedral belongs to, as the file names it.
    kind : str
        ``phi``, ``psi``, ``omega``, ``chi1`` ... ``chi5`` or ``rotor``; ``angle N`` or ``angle CA``.
    atoms : tuple of int
        Four of a dihedral, whose bond atoms[1]-atoms[2] turns; three of a bond angle at atoms[1].
    """

    chain: str
    residue_name: str
    residue_number: str
    insertion_code: str
    kind: str
    atoms: tuple[int, ...]

    @property
    def is_angle(self) -> bool:
        """Whether it is a bond angle that opens, and not a bond that turns."""
        return len(self.atoms) == 3

    @property
    def on_axis(self) -> tuple[int, ...]:
        """Atoms on its axis."""
        return self.atoms[1:2] if self.is_angle else self.atoms[1:3]

    def __str__(self) -> str:
        number = f"{self.residue_number}{self.insertion_code}"
        return f"{self.kind} of {self.residue_name} {number} chain {self.chain}"


@dataclass(frozen=True, eq=False)
class Chain:
    """A protein as a tree of rigid bodies.

    Parameters
    ----------
    structure : Structure
        What it was built from; its positions are ``pose(chain, chain.q0).x``.
    tree : Tree
    atom_body : (na,) int
        Body of each atom.
    atom_local : (na, 3) float, nm
        Position of each atom in its body's frame.
    hinges : tuple of Hinge
        ``hinges[i]`` is the i-th revolute hinge in body order.
    hinge_body : (n_hinges,) int
        The body each hinge carries; its coordinate is ``q[tree.q_start[hinge_body[i]]]``.
    loops : (n_loops, 2) int
        Bonds where a loop was cut open (disulfides and other cross-links): held by the force field.
    q0 : (n_q,) float
        Coordinates of the input pose; a hinge's is its measured dihedral.
    opened, root, move : str
        The kinds of hinge and of root, and the selection of what may move, it was built with.
    moving : (na,) bool
        Atoms that may move by themselves, in methods that move atoms: the selection.
    hydrogen_mass : float or None, amu
        Mass that hydrogens were given.
    """

    structure: Structure
    tree: Tree
    atom_body: Integers
    atom_local: Floats
    hinges: tuple[Hinge, ...]
    hinge_body: Integers
    loops: Integers
    q0: Floats
    opened: str
    root: str
    move: str
    moving: NDArray[np.bool_]
    hydrogen_mass: float | None = None

    @property
    def n_atoms(self) -> int:
        """Number of atoms."""
        return len(self.atom_body)

    @property
    def n_bodies(self) -> int:
        """Number of rigid bodies."""
        return self.tree.n_bodies

    @property
    def n_hinges(self) -> int:
        """Number of turning bonds."""
        return len(self.hinges)

    @property
    def n_q(self) -> int:
        """Number of coordinates: one a hinge, seven a free root."""
        return self.tree.n_q

    @property
    def n_v(self) -> int:
        """Number of freedoms: one a hinge, six a free root."""
        return self.tree.n_v

    def __repr__(self) -> str:
        return f"<Chain of {self.structure.name}: {self.n_bodies} bodies, {self.n_hinges} hinges>"


@dataclass(frozen=True, eq=False)
class Pose:
    """A chain at one q: a value, so nothing in it can be stale.

    Parameters
    ----------
    q : (n_q,) float
    frames : Frames
    x : (na, 3) float, nm
        Positions of the atoms.
    """

    q: Floats
    frames: Frames
    x: Floats


def pose(chain: Chain, q: Floats) -> Pose:
    """World frames and atom positions at q.

    Parameters
    ----------
    chain : Chain
    q : (n_q,) float, rad (quaternion and nm for free roots)

    Returns
    -------
    Pose
        Rebuilt from q and fixed body-frame coordinates, so bond lengths and angles cannot drift. O(n).
    """
    frames = multibody.pose(chain.tree, q)
    return Pose(read_only(q), frames, place_atoms(chain, frames))


def place_atoms(chain: Chain, frames: Frames) -> Floats:
    """Positions (na, 3) in nm of the atoms, from the frames of their bodies."""
    x = np.empty((chain.n_atoms, 3))
    _place_atoms(chain.atom_body, chain.atom_local, frames.rotation, frames.origin, x)
    return frozen(x)


def rigid_groups(chain: Chain) -> Integers:
    """Bodies that each atom keeps its place in, whatever the hinges do.

    Parameters
    ----------
    chain : Chain

    Returns
    -------
    (na, k) int
        The atom's own body first, then bodies joined to it by a hinge on whose axis it lies; -1 for none.
    """
    at = pose(chain, chain.q0)
    groups = [{int(body)} for body in chain.atom_body]
    bonds = list(zip(chain.hinge_body.tolist(), chain.tree.parent[chain.hinge_body].tolist(), strict=True))
    members: dict[int, set[int]] = {body: set() for body in range(chain.n_bodies)}
    for atom, body in enumerate(chain.atom_body.tolist()):
        members[body].add(atom)
    grown = True
    while grown:
        grown = False
        for body, parent in bonds:
            for own, other in ((body, parent), (parent, body)):
                new = np.array(sorted(members[own] - members[other]), dtype=np.int64)
                place = (at.x[new] - at.frames.origin[body]) @ at.frames.rotation[body]
                for atom in new[np.hypot(place[:, 0], place[:, 1]) < _ON_HINGE].tolist():
                    members[other].add(atom)
                    groups[atom].add(other)
                    grown = True
    wide = max(len(its) for its in groups)
    own = chain.atom_body.tolist()
    rows = [[body, *sorted(its - {body})] for body, its in zip(own, groups, strict=True)]
    return np.array([row + [-1] * (wide - len(row)) for row in rows], dtype=np.int64)


_ON_HINGE = 1e-9
"""nm. An atom nearer to an axis than this lies on it: positions are rounded to 1e-15."""


def pull_back(chain: Chain, pose: Pose, f: Floats) -> Floats:
    """Joint torques of Cartesian forces: tau = J^T f = -dE/dq.

    Parameters
    ----------
    chain : Chain
    pose : Pose
    f : (na, 3) float, kJ/mol/nm
        Forces on the atoms, minus the gradient of an energy.

    Returns
    -------
    (n_v,) float, kJ/mol/rad
        A free root has (moment, force) about its frame's origin, the force in kJ/mol/nm. O(n).
    """
    wrench = np.zeros((chain.n_bodies, 6))
    f = floats(f, (chain.n_atoms, 3), "f")
    _gather_loads(chain.atom_body, pose.frames.origin, pose.x, f, wrench)
    return multibody.pull_back(chain.tree, pose.frames, wrench)


def mass_matrix(chain: Chain, pose: Pose) -> Floats:
    """Mass matrix M(q): kinetic energy is qd^T M qd / 2.

    Parameters
    ----------
    chain : Chain
    pose : Pose

    Returns
    -------
    (n_v, n_v) float, amu nm^2
        By composite rigid bodies; see :func:`protochain.multibody.mass_matrix`.
    """
    return multibody.mass_matrix(chain.tree, pose.frames)


def solve_mass(chain: Chain, pose: Pose, tau: Floats, method: multibody.Method = "articulated") -> Floats:
    """M^-1 tau in O(n), without forming M.

    Parameters
    ----------
    chain : Chain
    pose : Pose
    tau : (n_v,) float, kJ/mol/rad
    method : str
        ``articulated`` or ``fixman``; see :func:`protochain.multibody.solve_mass`.

    Returns
    -------
    (n_v,) float, rad/ps^2
    """
    return multibody.solve_mass(chain.tree, pose.frames, tau, method)


def log_det_mass(chain: Chain, pose: Pose, method: multibody.Method = "articulated") -> float:
    """Ln det M in O(n), without forming M.

    Parameters
    ----------
    chain : Chain
    pose : Pose
    method : str
        ``articulated`` or ``fixman``; see :func:`protochain.multibody.log_det_mass`.

    Returns
    -------
    float
        Of M in amu nm^2.
    """
    return multibody.log_det_mass(chain.tree, pose.frames, method)


def dihedral(x: Floats) -> float:
    """Angle from -pi to pi of four points, by atan2, which is accurate at every angle.

    Parameters
    ----------
    x : (4, 3) float

    Returns
    -------
    float, rad
        IUPAC sign: positive when the far bond is clockwise of the near one, seen along the middle bond.
    """
    b1, b2, b3 = np.diff(x, axis=0)
    n1, n2 = np.cross(b1, b2), np.cross(b2, b3)
    return float(np.arctan2(np.linalg.norm(b2) * np.dot(b1, n2), np.dot(n1, n2)))


@kernel
def _place_atoms(
    atom_body: Integers, atom_local: Floats, rotation: Floats, origin: Floats, x: Floats
) -> None:
    for a in range(len(atom_body)):
        b = atom_body[a]
        put(add(vector(origin, b), turned(matrix(rotation, b), vector(atom_local, a))), x, a, 0)


@kernel
def _gather_loads(atom_body: Integers, origin: Floats, x: Floats, f: Floats, wrench: Floats) -> None:
    for a in range(len(atom_body)):
        b = atom_body[a]
        force = vector(f, a)
        add_pair(cross(subtract(vector(x, a), vector(origin, b)), force), force, wrench, b)
