"""A protein as a tree of rigid bodies: where its atoms are at q, and what forces on them do at the hinges."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from protochain import multibody
from protochain.arrays import Floats, Integers, read_only
from protochain.multibody import Frames, Tree
from protochain.structure.model import Structure


@dataclass(frozen=True)
class Hinge:
    """One turning bond: where it is, what it is called, and the four atoms that measure it.

    Parameters
    ----------
    chain, residue_name, residue_number, insertion_code : str
        The residue the dihedral belongs to, as the file names it.
    kind : str
        ``phi``, ``psi``, ``omega``, ``chi1`` ... ``chi5`` or ``rotor``.
    atoms : tuple of 4 int
        The bond that turns is atoms[1]-atoms[2].
    """

    chain: str
    residue_name: str
    residue_number: str
    insertion_code: str
    kind: str
    atoms: tuple[int, int, int, int]

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
    opened, root : str
        The kinds of hinge and of root it was built with.
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
    x = np.empty((chain.n_atoms, 3))
    _place_atoms(chain.atom_body, chain.atom_local, frames.rotation, frames.origin, x)
    return Pose(read_only(q), frames, read_only(x))


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
    moment = np.zeros((chain.n_bodies, 3))
    force = np.zeros((chain.n_bodies, 3))
    f = np.ascontiguousarray(f, dtype=np.float64)
    _gather_loads(chain.atom_body, pose.frames.origin, pose.x, f, moment, force)
    return multibody.pull_back(chain.tree, pose.frames, moment, force)


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


@njit(cache=True)
def _place_atoms(
    atom_body: Integers, atom_local: Floats, rotation: Floats, origin: Floats, x: Floats
) -> None:
    for a in range(len(atom_body)):
        b = atom_body[a]
        for i in range(3):
            x[a, i] = origin[b, i] + (
                rotation[b, i, 0] * atom_local[a, 0]
                + rotation[b, i, 1] * atom_local[a, 1]
                + rotation[b, i, 2] * atom_local[a, 2]
            )


@njit(cache=True)
def _gather_loads(
    atom_body: Integers, origin: Floats, x: Floats, f: Floats, moment: Floats, force: Floats
) -> None:
    for a in range(len(atom_body)):
        b = atom_body[a]
        rx, ry, rz = x[a, 0] - origin[b, 0], x[a, 1] - origin[b, 1], x[a, 2] - origin[b, 2]
        moment[b, 0] += ry * f[a, 2] - rz * f[a, 1]
        moment[b, 1] += rz * f[a, 0] - rx * f[a, 2]
        moment[b, 2] += rx * f[a, 1] - ry * f[a, 0]
        for i in range(3):
            force[b, i] += f[a, i]
