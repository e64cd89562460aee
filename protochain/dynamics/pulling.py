"""Spring between two places of a chain, whose rest length changes at constant speed."""

from dataclasses import dataclass, replace

import numpy as np

from protochain.chains.chain import Chain, pose
from protochain.core.arrays import Floats, Integers
from protochain.core.errors import ChainError
from protochain.dynamics.simulate_settings import Pull
from protochain.mechanics import multibody
from protochain.mechanics.motion.system import Applied, Load, Phase, System
from protochain.mechanics.multibody import Frames, HingeKind, Tree
from protochain.mechanics.multibody.articulated import Articulated, solve
from protochain.structure.molecule.model import Structure
from protochain.structure.select import atoms_at

_LEAST = 1e-9
"""nm. At shorter distances the direction between the places is rounding, and the force is 0."""


@dataclass(frozen=True, eq=False)
class MovingSpring:
    """Spring E = k/2 (r - l)^2 between two points, with l = l0 + v t, at least 0.

    The motion of the spring does the work -k v (r - l) dt. This work equals the work of the load on the
    molecule plus the energy in the spring. It is the work in Jarzynski's equation, Phys. Rev. Lett. 78:2690
    (1997), with the spring as part of the system: Hummer, Szabo, Proc. Natl. Acad. Sci. USA 98:3658 (2001).
    """

    tree: Tree  # Rigid bodies.
    body: Integers  # (m,) int: Bodies that carry the two places.
    local: Floats  # (m, 3) nm: Points of these bodies, in their frames.
    share: Floats  # (m,): Weights of the points in the vector from the first place to the second.
    stiffness: float  # stiffness, speed: Constants k and v.
    speed: float
    start: float  # nm: Rest length at time 0, l0.

    def length(self, time: float) -> float:
        """Rest length, nm."""
        return max(0.0, self.start + self.speed * time)

    def tension(self, time: float, frames: Frames) -> tuple[float, float]:
        """Distance of the places in nm, and the force that pulls them apart in kJ/mol/nm."""
        distance = float(np.linalg.norm(self._across(frames)[1]))
        return distance, self.stiffness * (self.length(time) - distance)

    def energy(self, time: float, frames: Frames) -> float:
        """Energy in the spring, kJ/mol."""
        return 0.5 * self.tension(time, frames)[1] ** 2 / self.stiffness

    def row(self, at: Phase) -> dict[str, float]:
        """Columns of the log."""
        distance, tension = self.tension(at.time, at.factors.frames)
        stored = 0.0 if self.speed == 0.0 else self.energy(at.time, at.factors.frames)
        return {
            "pull_distance_nm": distance,
            "pull_extension_nm": distance - self.start,
            "pull_force_kj_mol_nm": tension,
            "pull_work_kj_mol": float(np.sum(at.work)) + stored,
        }

    def load(self) -> Load:
        """Forces of the spring, for integrators that depend on time."""
        return Load(
            lambda time, q, qd, frames: Applied(self._wrenches(time, frames)), depends_on_velocity=False
        )

    def potential(self, q: Floats, factors: Articulated) -> tuple[float, Floats]:
        """Energy and torques (n_v,) of a spring that does not move."""
        frames = factors.frames
        return self.energy(0.0, frames), multibody.pull_back(self.tree, frames, self._wrenches(0.0, frames))

    def _across(self, frames: Frames) -> tuple[Floats, Floats]:
        """Points from the origins of their bodies (m, 3), and the vector from place to place (3,)."""
        arm = np.einsum("mij,mj->mi", frames.rotation[self.body], self.local)
        return arm, self.share @ (arm + frames.origin[self.body])

    def _wrenches(self, time: float, frames: Frames) -> Floats:
        """Moments and forces (nb, 6) on the bodies."""
        arm, across = self._across(frames)
        distance = float(np.linalg.norm(across))
        # With a rest length of 0 the force at any distance is k times the vector itself.
        return self._spread(arm, self.stiffness * (self.length(time) / max(distance, _LEAST) - 1.0) * across)

    def gradient(self, frames: Frames) -> Floats:
        """(n_v,) float: derivatives of the distance along q, the torques of a unit force."""
        arm, across = self._across(frames)
        return multibody.pull_back(self.tree, frames, self._spread(arm, across / np.linalg.norm(across)))

    def _spread(self, arm: Floats, pull: Floats) -> Floats:
        """Moments and forces (nb, 6) of a force (3,) on the second place, and its opposite on the first."""
        force = self.share[:, None] * pull
        out = np.zeros((self.tree.n_bodies, 6))
        np.add.at(out, self.body, np.concatenate([np.cross(arm, force), force], axis=1))
        return out


def places_of(pull: Pull, structure: Structure) -> tuple[Integers, Integers]:
    """Atoms of the two places."""
    first, second = (atoms_at(structure, place) for place in pull.between)
    return first, second


def check_pull(pull: Pull, chain: Chain) -> None:
    """Check that a spring between these places of a chain can pull."""
    first, second = places_of(pull, chain.structure)
    fixed = chain.tree.kind == HingeKind.FIXED
    of_atoms = chain.rigid_groups[np.concatenate([first, second])]
    # Fixed bodies count as one body, the world. -1 fills rows.
    groups = [{-2 if fixed[b] else b for b in row if b >= 0} for row in of_atoms.tolist()]
    if set.intersection(*groups):
        raise ChainError(
            f"{chain.structure.name}: pull {pull}: no hinge changes this distance in one rigid body; "
            "give places farther apart, or open more hinges"
        )
    mass, x = chain.structure.atom_mass, chain.structure.positions
    a, b = (np.average(x[atoms], axis=0, weights=mass[atoms]) for atoms in (first, second))
    if float(np.linalg.norm(b - a)) < _LEAST:
        raise ChainError(f"{chain.structure.name}: pull {pull}: both places coincide; give different places")


def moving_spring(pull: Pull, chain: Chain, q: Floats) -> MovingSpring:
    """Spring of these settings for a chain that starts at q, with its rest length there."""
    # Its places are centres of mass, with one point for each body that has atoms of them.
    mass = chain.structure.atom_mass
    body, local, share = list[int](), list[Floats](), list[float]()
    for atoms, sign in zip(places_of(pull, chain.structure), (-1.0, 1.0), strict=True):
        weight = mass[atoms] / mass[atoms].sum()
        for b in np.unique(chain.atom_body[atoms]).tolist():
            on_body = chain.atom_body[atoms] == b
            body.append(b)
            local.append(np.average(chain.atom_local[atoms[on_body]], axis=0, weights=weight[on_body]))
            share.append(sign * float(weight[on_body].sum()))
    spring = MovingSpring(
        chain.tree, np.array(body), np.array(local), np.array(share), pull.stiffness, pull.speed, 0.0
    )
    return replace(spring, start=spring.tension(0.0, pose(chain, q).frames)[0])


def refuse_fixed(pull: Pull, spring: MovingSpring, system: System, structure: Structure, q: Floats) -> None:
    """Raise an error for places whose distance is constant at q because of closed loops."""
    if system.constraint is None:
        return
    factors = system.factors(q)
    torque = spring.gradient(factors.frames)
    free, constrained = solve(factors, torque), system.constraint.project_velocities(factors, torque)
    # A smaller share of the response without loops is rounding.
    if torque @ constrained < 1e-9 * (torque @ free):
        raise ChainError(
            f"{structure.name}: pull {pull}: closed loops fix this distance; give other places, or open loops"
        )
