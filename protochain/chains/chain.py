"""A protein as a tree of rigid bodies: atom positions at q, and the hinge torques of forces on the atoms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from protochain.chains.hinges import Hinge
from protochain.core.arrays import Floats, Integers, Value, floats, freeze, read_only
from protochain.core.checks import instance, number, text
from protochain.core.errors import ChainError, refusal
from protochain.core.settings import document_fields
from protochain.mechanics import multibody
from protochain.mechanics.multibody import Frames, Tree, algebra
from protochain.mechanics.multibody.algebra import add, cross, kernel, subtract
from protochain.structure.molecule.model import Structure

_ON_HINGE = 1e-9  # nm. Atoms nearer to an axis than this are on it. Rounding of positions is 1e-15.
_WAYS = 1 << 20  # Pairs of an atom and a hinge in one batch, which bounds the memory.


@document_fields
@dataclass(frozen=True, eq=False)
class Chain(Value):
    """A protein as a tree of rigid bodies.

    Examples
    --------
    >>> chain = pc.build_chain(pc.from_sequence("GAG"))
    >>> chain.n_hinges, chain.hinges[0].kind
    (5, 'phi')
    """

    structure: Structure  # Structure of the chain, whose positions are ``pose(chain, chain.q0).x``.
    tree: Tree  # Bodies, hinges and inertia.
    atom_body: Integers  # (na,) int: Body of each atom.
    atom_local: Floats  # (na, 3) float, nm: Position of each atom in its body's frame.
    hinges: tuple[Hinge, ...]  # ``hinges[i]`` is the i-th revolute hinge in body order.
    # (n_hinges,) int: Body beyond each hinge, whose coordinate is ``q[tree.q_start[hinge_body[i]]]``.
    hinge_body: Integers
    # (n_loops, 2) int: Bonds at which loops were cut (disulfides and other cross-links). The force field
    # still has them.
    loops: Integers
    q0: Floats  # (n_q,) float: Coordinates of the input pose. Hinges have measured dihedrals.
    opened: str  # Argument ``hinges`` of :func:`build_chain`.
    root: str  # Argument of :func:`build_chain`.
    move: str  # Argument of :func:`build_chain`.
    moving: NDArray[np.bool_]  # (na,) bool: Selected atoms, which methods that move single atoms may move.
    hydrogen_mass: float | None = None  # amu: Mass of hydrogens after repartitioning.

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
        """Number of coordinates: one for each hinge, seven for each free root."""
        return self.tree.n_q

    @property
    def n_v(self) -> int:
        """Number of degrees of freedom: one for each hinge, six for each free root."""
        return self.tree.n_v

    def hinge(self, name: str) -> int:
        """Number of the only hinge of a name, as ``phi A:3``, ``chi1@B:12A``."""
        full_name = " ".join(text(name, "hinge").replace("@", " ").split())
        matches = [i for i, hinge in enumerate(self.hinges) if hinge.name == full_name]
        if len(matches) == 1:
            return matches[0]
        _, _, place = full_name.rpartition(" ")
        alternatives = [hinge.name for hinge in self.hinges if hinge.name.endswith(f" {place}")]
        alternatives = alternatives or [hinge.name for hinge in self.hinges[:2]]
        reason = (
            f"{len(matches)} have this name" if matches else f"does not turn; {', '.join(alternatives)} do"
        )
        raise ChainError(f"{self.structure.name}: hinge {name!r}: {reason}")

    def set(self, values: Mapping[str, float], q: Floats | None = None) -> Floats:
        """Coordinates with some hinges at other values.

        Parameters
        ----------
        values : mapping of str to float, degrees
            Values by the names of hinges, as ``{"phi A:3": -60.0}``.
        q : (n_q,) float, optional
            Coordinates of all other hinges. By default, the input pose.

        Returns
        -------
        (n_q,) float
            Coordinates for :func:`pose`, :func:`protochain.minimise` and :func:`protochain.simulate`.

        Raises
        ------
        ProtochainError
            If no hinge of a name turns, or a value is not finite.
        """
        coordinates = np.array(self.q0 if q is None else floats(q, (self.n_q,), "q"))
        for name, value in values.items():
            angle = np.deg2rad(number(value, "values"))
            if not np.isfinite(angle):
                raise refusal("values", f"{name}: {value}", "give finite numbers, in degrees")
            coordinates[self.tree.q_start[self.hinge_body[self.hinge(name)]]] = angle
        return coordinates

    @cached_property
    def rigid_groups(self) -> Integers:
        """(na, k) int: bodies in which each atom is at rest, its own body first, padded with -1."""
        at, n = pose(self, self.q0), self.n_bodies
        parent = self.tree.parent[self.hinge_body]
        # Crossings of hinges, sorted by the body of their start.
        start, end = np.concatenate([self.hinge_body, parent]), np.concatenate([parent, self.hinge_body])
        order = np.argsort(start, kind="stable")
        end, hinged = end[order], np.tile(self.hinge_body, 2)[order]
        first = np.searchsorted(start[order], np.arange(n + 1))
        pairs = left = np.arange(self.n_atoms) * n + self.atom_body
        while len(left):
            atom, body = np.divmod(left, n)
            last = np.cumsum(first[body + 1] - first[body])
            batch = slice(max(1, int(np.searchsorted(last, _WAYS))))
            atom, body, last, left = atom[batch], body[batch], last[batch], left[batch.stop :]
            ways = first[body + 1] - first[body]
            way = np.repeat(first[body] - last + ways, ways) + np.arange(last[-1])
            atom, by = np.repeat(atom, ways), hinged[way]
            place = np.einsum("ai,aij->aj", at.x[atom] - at.frames.origin[by], at.frames.rotation[by])
            near = np.hypot(place[:, 0], place[:, 1]) < _ON_HINGE
            new = np.setdiff1d(atom[near] * n + end[way[near]], pairs)
            pairs, left = np.union1d(pairs, new), np.concatenate([left, new])
        atom, body = np.divmod(pairs, n)
        body = body[np.lexsort([body, body != self.atom_body[atom], atom])]
        count = np.bincount(atom, minlength=self.n_atoms)
        rows = np.full((self.n_atoms, count.max()), -1, dtype=np.int64)
        rows[np.arange(count.max()) < count[:, None]] = body
        return rows

    def __repr__(self) -> str:
        return f"<Chain of {self.structure.name}: {self.n_bodies} bodies, {self.n_hinges} hinges>"


@dataclass(frozen=True, eq=False)
class Pose(Value):
    """Configuration of a chain at one q, an immutable value."""

    q: Floats  # (n_q,): Coordinates.
    frames: Frames  # World frames of the bodies.
    x: Floats  # (na, 3) nm: Positions of the atoms.


_chain = instance(Chain, "pc.build_chain(structure)")
_pose = instance(Pose, "pc.pose(chain, q)")


def pose(chain: Chain, q: Floats) -> Pose:
    """World frames and atom positions at q.

    Parameters
    ----------
    chain : Chain
        Chain of rigid bodies.
    q : (n_q,) float, rad (quaternion and nm for free roots)
        Coordinates.

    Returns
    -------
    Pose
        Computed from q and constant body-frame coordinates, so bond lengths and angles cannot drift. O(n).

    Examples
    --------
    >>> c = pc.build_chain(pc.from_sequence("GAG"))
    >>> pc.pose(c, c.q0).x.shape
    (27, 3)
    """
    frames = multibody.pose(_chain(chain, "chain").tree, q)
    return Pose(read_only(q), frames, place_atoms(chain, frames))


def place_atoms(chain: Chain, frames: Frames) -> Floats:
    """Positions (na, 3) in nm of the atoms, from the frames of their bodies."""
    x = np.empty((chain.n_atoms, 3))
    _place_atoms(chain.atom_body, chain.atom_local, frames.rotation, frames.origin, x)
    return freeze(x)


def pull_back(chain: Chain, pose: Pose, f: Floats) -> Floats:
    """Joint torques of Cartesian forces: tau = J^T f = -dE/dq.

    Parameters
    ----------
    chain, pose : Chain, Pose
        Chain of rigid bodies, and its pose at q.
    f : (na, 3) float, kJ/mol/nm
        Forces on the atoms, minus the gradient of an energy.

    Returns
    -------
    (n_v,) float, kJ/mol/rad
        Torques. A free root has (moment, force) about its frame's origin, the force in kJ/mol/nm. O(n).

    Examples
    --------
    >>> c = pc.build_chain(pc.from_sequence("GAG"))
    >>> at = pc.pose(c, c.q0)
    >>> pc.pull_back(c, at, np.ones_like(at.x)).shape
    (5,)
    """
    wrench = np.zeros((_chain(chain, "chain").n_bodies, 6))
    f = floats(f, (chain.n_atoms, 3), "f", "kilojoule_per_mole/nanometer")
    _gather_loads(chain.atom_body, _pose(pose, "pose").frames.origin, pose.x, f, wrench)
    return multibody.pull_back(chain.tree, pose.frames, wrench)


def mass_matrix(chain: Chain, pose: Pose) -> Floats:
    """Mass matrix M(q): kinetic energy is qd^T M qd / 2.

    Parameters
    ----------
    chain, pose : Chain, Pose
        Chain of rigid bodies, and its pose at q.

    Returns
    -------
    (n_v, n_v) float, amu nm^2
        M by the composite-rigid-body algorithm of :func:`protochain.mechanics.multibody.mass_matrix`.

    Examples
    --------
    >>> c = pc.build_chain(pc.from_sequence("GAG"))
    >>> m = pc.mass_matrix(c, pc.pose(c, c.q0))
    >>> bool(np.all(np.linalg.eigvalsh(m) > 0.0))
    True
    """
    return multibody.mass_matrix(_chain(chain, "chain").tree, _pose(pose, "pose").frames)


def solve_mass(chain: Chain, pose: Pose, tau: Floats, method: multibody.Method = "articulated") -> Floats:
    """Solve M x = tau in O(n), without forming M.

    Parameters
    ----------
    chain, pose : Chain, Pose
        Chain of rigid bodies, and its pose at q.
    tau : (n_v,) float, kJ/mol/rad
        Torques.
    method : str
        ``articulated`` or ``fixman``, as in :func:`protochain.mechanics.multibody.solve_mass`.

    Returns
    -------
    (n_v,) float, rad/ps^2
        Accelerations from rest.

    Examples
    --------
    >>> c = pc.build_chain(pc.from_sequence("GAG"))
    >>> at = pc.pose(c, c.q0)
    >>> a = pc.solve_mass(c, at, np.ones(c.n_v))
    >>> bool(np.allclose(pc.mass_matrix(c, at) @ a, 1.0))
    True
    """
    return multibody.solve_mass(_chain(chain, "chain").tree, _pose(pose, "pose").frames, tau, method)


def log_det_mass(chain: Chain, pose: Pose, method: multibody.Method = "articulated") -> float:
    """Logarithm of det M in O(n), without forming M.

    Parameters
    ----------
    chain, pose : Chain, Pose
        Chain of rigid bodies, and its pose at q.
    method : str
        ``articulated`` or ``fixman``, as in :func:`protochain.mechanics.multibody.log_det_mass`.

    Returns
    -------
    float
        Value of ln det M, with M in amu nm^2.

    Examples
    --------
    >>> c = pc.build_chain(pc.from_sequence("GAG"))
    >>> at = pc.pose(c, c.q0)
    >>> bool(np.isclose(pc.log_det_mass(c, at), np.linalg.slogdet(pc.mass_matrix(c, at))[1]))
    True
    """
    return multibody.log_det_mass(_chain(chain, "chain").tree, _pose(pose, "pose").frames, method)


@kernel
def _place_atoms(
    atom_body: Integers, atom_local: Floats, rotation: Floats, origin: Floats, x: Floats
) -> None:
    for a in range(len(atom_body)):
        b = atom_body[a]
        arm = algebra.rotate(algebra.matrix(rotation, b), algebra.vector(atom_local, a))
        algebra.put(add(algebra.vector(origin, b), arm), x, a, 0)


@kernel
def _gather_loads(atom_body: Integers, origin: Floats, x: Floats, f: Floats, wrench: Floats) -> None:
    for a in range(len(atom_body)):
        b = atom_body[a]
        force, arm = algebra.vector(f, a), subtract(algebra.vector(x, a), algebra.vector(origin, b))
        algebra.add_pair(cross(arm, force), force, wrench, b)
