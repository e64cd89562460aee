"""Unfolding by a control along soft torsional modes, in the spirit of Chetaev's instability theorem.

Chetaev's function is the sum of the distances of native contacts. The control raises it at every step inside
the subspace of the softest modes, and the other hinges follow their torques without lowering it (theory.md,
"Unfolding"). Mohammadi and Spong's papers on unfolding could not be read: the control is derived here.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import eigh

from protochain.chains.articulate import with_energy
from protochain.chains.chain import Chain, pose, pull_back
from protochain.chains.contacts import alpha_contacts
from protochain.comparison.hessian import torques_at
from protochain.core.arrays import Floats, Integers, Value
from protochain.core.checks import at_least, check_arguments, function, in_range, number
from protochain.core.errors import Fault, ProtochainError
from protochain.core.interrupts import held_interrupts
from protochain.core.lazy_pandas import pd
from protochain.core.settings import document_fields
from protochain.energies import Energy
from protochain.mechanics import multibody
from protochain.structure import Structure

STRETCH = 1.2
"""Relative distance at which a native contact is lost."""
REFRESH = 10
"""Steps with the same soft modes."""
SCALE = 50.0
"""kJ/mol/rad. Relaxing torques above this turn as far as the soft part."""


@dataclass(frozen=True)
class NativeContacts:
    """Pairs of C-alphas in contact in a reference structure."""

    atoms: Integers  # (n, 2) int: Indices of the C-alphas.
    lengths: Floats  # (n,) float, nm: Their distances in the reference.

    @classmethod
    def of_structure(cls, structure: Structure) -> "NativeContacts":
        """Contacts of a structure; raise a ProtochainError if it has none."""
        atoms, x = alpha_contacts(structure, structure.positions), structure.positions
        if not len(atoms):
            raise ProtochainError(f"{structure.name}: no contacts of C-alphas; give a folded structure")
        return cls(atoms, np.linalg.norm(np.diff(x[atoms], axis=1)[:, 0], axis=1))

    def distances(self, x: Floats) -> Floats:
        """Distances (n,) of the pairs at positions x (na, 3), nm."""
        return np.asarray(np.linalg.norm(x[self.atoms[:, 0]] - x[self.atoms[:, 1]], axis=1))

    def share(self, x: Floats) -> float:
        """Share of the contacts that remain at positions x (na, 3), nm."""
        return float(np.mean(self.distances(x) < STRETCH * self.lengths))

    def gradient(self, x: Floats) -> Floats:
        """Gradient (na, 3) of the sum of the distances at positions x."""
        across = x[self.atoms[:, 0]] - x[self.atoms[:, 1]]
        units = across / np.maximum(np.linalg.norm(across, axis=1), 1e-9)[:, None]
        gradient = np.zeros_like(x)
        np.add.at(gradient, self.atoms[:, 0], units)
        np.add.at(gradient, self.atoms[:, 1], -units)
        return gradient


@document_fields
@dataclass(frozen=True, eq=False)
class Unfolding(Value):
    """A path from a folded structure to one that has lost its native contacts."""

    chain: Chain  # Chain of rigid bodies.
    energy_function: Energy  # Energy of the chain.
    contacts: NativeContacts  # Native contacts of the start.
    q: Floats  # (n_q,) float: Coordinates of the end.
    energies: Floats  # (n,) float, kJ/mol: Energy of each step, the start included.
    shares: Floats  # (n,) float: Share of the native contacts that remain at each step.
    rates: Floats  # (n - 1,) float, nm: Predicted increase of the sum of distances in each step, above 0.
    is_unfolded: bool  # Whether the share fell to the limit before the steps were used up.

    @property
    def structure(self) -> Structure:
        """Structure of the end."""
        return self.chain.structure.with_positions(pose(self.chain, self.q).x)

    def table(self) -> "pd.DataFrame":
        """Table with a row a step: ``step``, ``energy_kj_mol``, ``contacts_share``."""
        steps = np.arange(len(self.energies))
        return pd.DataFrame({"step": steps, "energy_kj_mol": self.energies, "contacts_share": self.shares})


@check_arguments(
    modes=at_least(1), max_steps=at_least(1), watch=function("step", "share"),
    angle=in_range(number, lambda angle: 0.0 < angle <= 0.1, "give a number above 0, at most 0.1", "rad"),
    until=in_range(number, lambda share: 0.0 <= share < 1.0, "give a share from 0 to below 1"),
)  # fmt: skip
def unfold(
    chain: Any, energy: Any = None, *, modes: int = 20, angle: float = 0.01, until: float = 0.2,
    max_steps: int = 4000, watch: Callable[[int, float], None] | None = None,
) -> Unfolding:  # fmt: skip
    """Unfold a chain along its softest torsional modes until its native contacts are lost.

    Parameters
    ----------
    chain : Chain, Structure, path, or anything that :func:`protochain.as_structure` takes
        Folded start, as a minimum of :func:`protochain.minimise`.
    energy : Energy or callable, optional
        As in :func:`protochain.minimise`.
    modes : int
        Number of soft modes that are driven.
    angle : float, rad
        Turn of the hinge that turns most along the soft modes, in every step.
    until : float
        Share of the native contacts at which the chain counts as unfolded.
    max_steps : int
        Largest number of steps.
    watch : callable, optional
        Called after each step with its number and the share of native contacts.

    Returns
    -------
    Unfolding
        Path of energies and contacts, and the end.

    Raises
    ------
    ProtochainError
        If the input cannot be used, or has no native contacts, or if its energy is not finite at a step.

    Examples
    --------
    >>> u = pc.unfold("structures/1l2y.pdb", max_steps=20)
    >>> bool(u.shares[-1] <= u.shares[0])
    True
    """
    chain, energy = with_energy(chain, energy)
    contacts = NativeContacts.of_structure(chain.structure)
    torques = torques_at(chain, energy, None)
    # Roots stay in place: the motion of the whole changes no contact.
    hinges = np.flatnonzero(np.isin(np.arange(chain.n_v), chain.tree.v_start[chain.hinge_body]))
    q, soft, rates = chain.q0, np.empty((len(hinges), 0)), list[float]()
    at = pose(chain, q)
    value, forces = energy(at.x)
    energies, shares = [float(value)], [contacts.share(at.x)]
    with held_interrupts() as interrupts:
        while shares[-1] > until and len(rates) < max_steps:
            if interrupts:
                raise KeyboardInterrupt
            if len(rates) % REFRESH == 0:
                last = min(modes, len(hinges)) - 1
                curvatures = replace(torques, q=q).matrix(hinges)
                _require_finite(curvatures)
                soft = eigh(curvatures, subset_by_index=(0, last))[1]
            climb, torque = (pull_back(chain, at, f)[hinges] for f in (contacts.gradient(at.x), forces))
            step = angle * control(soft, climb, torque)
            if not step.any():
                break
            change = np.zeros(chain.n_v)
            change[hinges] = step
            q = multibody.integrate(chain.tree, q, change)
            at = pose(chain, q)
            value, forces = energy(at.x)
            _require_finite(value, forces)
            rates.append(float(climb @ step))
            energies.append(float(value))
            shares.append(contacts.share(at.x))
            if watch:
                watch(len(rates), shares[-1])
    is_unfolded = shares[-1] <= until
    path = np.array(energies), np.array(shares), np.array(rates)
    return Unfolding(chain, energy, contacts, q, *path, is_unfolded)


def _require_finite(*values: Any) -> None:
    """Raise if an energy or its derivatives are not finite."""
    if not all(np.isfinite(value).all() for value in values):
        raise ProtochainError("the energy or its forces are not finite; reduce angle", fault=Fault.NOT_FINITE)


def control(soft: Floats, climb: Floats, torque: Floats) -> Floats:
    """Step that raises Chetaev's function within soft modes, while all other hinges follow their torques.

    Parameters
    ----------
    soft : (n, k) float
        Orthonormal modes.
    climb : (n,) float
        Gradient of Chetaev's function.
    torque : (n,) float
        Torques of the energy.

    Returns
    -------
    (n,) float
        Step whose soft part has a largest turn of 1; zero if the function cannot rise within the modes.
    """
    driven = soft @ (soft.T @ climb)
    largest = float(np.max(np.abs(driven), initial=0.0))
    if largest <= 1e-12:
        return np.zeros_like(climb)
    # The relaxing part is orthogonal to the soft modes and to the rest of the gradient.
    rest = climb - driven
    relaxing = torque - soft @ (soft.T @ torque)
    if (square := float(rest @ rest)) > 0.0:
        relaxing = relaxing - (relaxing @ rest) / square * rest
    # Larger torques than the scale turn as much as the soft part.
    return driven / largest + relaxing / max(float(np.max(np.abs(relaxing), initial=0.0)), SCALE)
