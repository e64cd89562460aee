"""Springs on hinges, and dampers with the random torques that belong to them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from protochain.chains.chain import Chain
from protochain.chains.hinges import Hinge
from protochain.core.arrays import Floats, Integers
from protochain.core.errors import ChainError
from protochain.dynamics.simulate_settings import HingeSpring
from protochain.mechanics.motion.system import Phase, System
from protochain.mechanics.multibody.articulated import Articulated, solve


@dataclass(frozen=True, eq=False)
class HingeSprings:
    """Springs on hinges: E = k (1 - cos(q - q0)) for dihedrals, k/2 (q - q0)^2 for bond angles."""

    n_v: int  # Number of freedoms.
    at_q: Integers  # at_q, at_v: (m,) int: Their coordinates and freedoms.
    at_v: Integers
    stiffness: Floats  # (m,) kJ/mol/rad^2.
    rest_values: Floats  # (m,) rad: Values without torque.
    is_angle: np.ndarray  # (m,) bool: Whether each is a bond angle.

    def potential(self, q: Floats, factors: Articulated) -> tuple[float, Floats]:
        """Energy and torques (n_v,)."""
        deviation = q[self.at_q] - self.rest_values
        # 2 sin^2(x/2) is 1 - cos x without cancellation.
        energy = np.where(self.is_angle, 0.5 * deviation**2, 2.0 * np.sin(0.5 * deviation) ** 2)
        torque = np.zeros(self.n_v)
        np.add.at(torque, self.at_v, -self.stiffness * np.where(self.is_angle, deviation, np.sin(deviation)))
        return float(self.stiffness @ energy), torque


@dataclass(frozen=True, eq=False)
class Dampers:
    """Dampers of hinges: torques -c qd, and sqrt(2 c kT) times white noise.

    At constant q torques at the hinges S change their rates u = S^T qd by W = S^T M^-1 S, so that
    du = -W C u dt + W sqrt(2 kT C) dw. With C^1/2 W C^1/2 = V L V^T these are m scalar equations for
    z = V^T C^1/2 u. Each solution over a time t is z exp(-L t) plus a normal number of variance
    kT L (1 - exp(-2 L t)). The impulse at the hinges is C^1/2 V (z(t) - z(0)) / L. This damps fast motion at
    once, for any c, and preserves the canonical distribution. Half a step of it on either side of an
    integrator's step is of order two (Strang, SIAM J. Numer. Anal. 5:506, 1968).
    """

    at_v: Integers  # (m,) int: Their freedoms, unique.
    damping: Floats  # (m,) kJ/mol ps/rad^2: Constants c, above 0.
    thermal_energy: float  # kJ/mol: Value of kT, 0 for no noise.

    def apply(self, system: System, at: Phase, time: float, rng: np.random.Generator | None) -> Phase:
        """Phase after the dampers alone have acted for a time. Without ``rng`` they have no noise."""
        root, rate, modes = _modes(self, system, at.factors)
        decayed = -np.expm1(-rate * time)
        # If closed loops prevent a motion, its rate is 0, and the quotients are their limits.
        is_still = rate < 1e-12 * rate.max(initial=0.0) + 1e-300
        safe = np.where(is_still, 1.0, rate)
        impulse = -np.where(is_still, time, decayed / safe) * (modes.T @ (root * at.qd[self.at_v]))
        if rng is not None and self.thermal_energy > 0.0:
            spread = np.where(is_still, 2.0 * time, decayed * (2.0 - decayed) / safe)
            impulse += np.sqrt(self.thermal_energy * spread) * rng.standard_normal(len(rate))
        p = np.zeros_like(at.qd)
        p[self.at_v] = root * (modes @ impulse)
        return system.with_velocities(at, at.qd + _velocity_change(system, at.factors, p))


@lru_cache(maxsize=1)
def _modes(dampers: Dampers, system: System, factors: Articulated) -> tuple[Floats, Floats, Floats]:
    """Roots of c (m,), rates L (m,) and modes V (m, m), cached: a step begins at the end of the last."""
    root, n_v = np.sqrt(dampers.damping), system.tree.n_v
    responses = np.array([_velocity_change(system, factors, unit) for unit in np.eye(n_v)[dampers.at_v]])
    response = root[:, None] * responses[:, dampers.at_v] * root
    rate, modes = np.linalg.eigh(0.5 * (response + response.T))
    return root, np.maximum(rate, 0.0), modes


def _velocity_change(system: System, factors: Articulated, p: Floats) -> Floats:
    """Velocities (n_v,) of momenta p (n_v,), projected if loops are closed."""
    if system.constraint is None:
        return solve(factors, p)
    return system.constraint.project_velocities(factors, p)


def hinges_of(spring: HingeSpring, chain: Chain) -> Integers:
    """Numbers of the hinges of a chain to which a spring applies."""
    if "@" in spring.kind or " " in spring.kind:
        return np.array([chain.hinge(spring.kind)])
    hinges = np.flatnonzero([_is_kind(hinge, spring.kind) for hinge in chain.hinges])
    if not len(hinges):
        opened = " ".join(dict.fromkeys([*chain.opened.split(), spring.kind]))
        raise ChainError(
            f"{chain.structure.name}: hinge spring {spring.kind}: no hinge of this kind turns; "
            f"open them with hinges {opened!r}"
        )
    return hinges


def _is_kind(hinge: Hinge, kind: str) -> bool:
    if kind == "angles":
        return hinge.is_angle
    return hinge.kind.rstrip("12345") == kind.removesuffix("s")


def hinge_springs(springs: Sequence[HingeSpring], chain: Chain, q: Floats) -> HingeSprings | None:
    """Springs of these settings for a chain, with zero torque at its start q, or None without any."""
    if not springs:
        return None
    groups = [hinges_of(spring, chain) for spring in springs]
    hinges = np.concatenate(groups)
    body = chain.hinge_body[hinges]
    at_q = chain.tree.q_start[body]
    stiffness = np.repeat([float(spring.stiffness) for spring in springs], [len(group) for group in groups])
    is_angle = np.array([chain.hinges[i].is_angle for i in hinges])
    return HingeSprings(chain.n_v, at_q, chain.tree.v_start[body], stiffness, np.asarray(q)[at_q], is_angle)


def dampers(springs: Sequence[HingeSpring], chain: Chain, thermal_energy: float) -> Dampers | None:
    """Dampers of these settings for a chain, with noise for kT in kJ/mol (0: none), or None without any."""
    damping = np.zeros(chain.n_v)
    for spring in springs:
        damping[chain.tree.v_start[chain.hinge_body[hinges_of(spring, chain)]]] += spring.damping
    (at_v,) = np.nonzero(damping)
    return Dampers(at_v, damping[at_v], thermal_energy) if len(at_v) else None
