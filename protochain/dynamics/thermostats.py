"""Thermostats: applied after each step of an integrator, each keeps the canonical distribution exactly."""

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from protochain import defaults
from protochain.arrays import Floats, read_only
from protochain.dynamics.system import Phase, System
from protochain.multibody.articulated import sample


@dataclass(frozen=True, eq=False)
class Bath:
    """What a thermostat remembers.

    Parameters
    ----------
    energy : float, kJ/mol
        What the system has given to it: with the total energy, the conserved quantity.
    memory : (k,) float
        The thermostat's own.
    """

    energy: float
    memory: Floats


class Thermostat(Protocol):
    """Exchanges energy with a system.

    ``freedoms`` is how many velocities share the kinetic energy, ``thermal_energy`` kT in kJ/mol.
    """

    undoes: ClassVar[bool] = False
    """Whether it takes back a step that has failed, which has an infinite potential then."""

    def init(self, at: Phase) -> Bath:
        """Return the bath at the start: where nothing has been taken, and nothing is remembered."""
        return Bath(0.0, np.empty(0))

    def apply(
        self, system: System, at: Phase, bath: Bath, time_step: float, rng: np.random.Generator
    ) -> tuple[Phase, Bath]:
        """Act for one time step; rng is this step's own."""


@dataclass(frozen=True)
class Isolated(Thermostat):
    """No thermostat: constant energy."""

    def apply(
        self, system: System, at: Phase, bath: Bath, time_step: float, rng: np.random.Generator
    ) -> tuple[Phase, Bath]:
        """Do nothing."""
        return at, bath


@dataclass(frozen=True)
class Langevin(Thermostat):
    """Friction and noise in the mass metric: qd -> c qd + sqrt(1 - c^2) of a thermal velocity.

    The exact solution of dp = -friction p dt + sqrt(2 friction kT) M^1/2 dW at constant q, in turn with the
    leapfrog (as in Leimkuhler, Matthews, *Molecular Dynamics*, 2015, chapter 7). At 0 K it only damps.

    Parameters
    ----------
    thermal_energy : float, kJ/mol
    friction : float, 1/ps
    """

    thermal_energy: float
    friction: float = defaults.FRICTION

    def apply(
        self, system: System, at: Phase, bath: Bath, time_step: float, rng: np.random.Generator
    ) -> tuple[Phase, Bath]:
        """Damp, and kick at random."""
        keep = np.exp(-self.friction * abs(time_step))
        noise = np.sqrt((1.0 - keep * keep) * self.thermal_energy) * rng.standard_normal(system.tree.n_v)
        after = system.moving(at, keep * at.qd + sample(at.factors, noise))
        return after, Bath(bath.energy + at.kinetic - after.kinetic, bath.memory)


@dataclass(frozen=True)
class Rescaling(Thermostat):
    """All velocities by one factor, drawn so that the kinetic energy is canonical.

    Bussi, Donadio, Parrinello, J. Chem. Phys. 126:014101 (2007), equation A7.

    Parameters
    ----------
    thermal_energy : float, kJ/mol
    freedoms : int
    friction : float, 1/ps
    """

    thermal_energy: float
    freedoms: int
    friction: float = defaults.FRICTION

    def apply(
        self, system: System, at: Phase, bath: Bath, time_step: float, rng: np.random.Generator
    ) -> tuple[Phase, Bath]:
        """Scale the velocities."""
        if at.kinetic == 0.0:
            return at, bath
        keep, share = np.exp(-2.0 * self.friction * abs(time_step)), 0.5 * self.thermal_energy
        one, others = rng.standard_normal(), 2.0 * rng.standard_gamma(0.5 * (self.freedoms - 1))
        wanted = (
            keep * at.kinetic
            + (1.0 - keep) * share * (one * one + others)
            + 2.0 * one * np.sqrt(keep * (1.0 - keep) * share * at.kinetic)
        )
        after = system.moving(at, np.sqrt(wanted / at.kinetic) * at.qd)
        return after, Bath(bath.energy + at.kinetic - after.kinetic, bath.memory)


_CHAIN = 3
_OUTER = 1.0 / (2.0 - 2.0 ** (1.0 / 3.0))
_YOSHIDA = (_OUTER, 1.0 - 2.0 * _OUTER, _OUTER)


@dataclass(frozen=True)
class NoseHoover(Thermostat):
    """A chain of three friction coefficients with inertia: deterministic, and time-reversible.

    Martyna, Tuckerman, Tobias, Klein, Mol. Phys. 87:1117 (1996), with Yoshida's weights of order four. The
    bath's memory holds the coefficients (1/ps) and then their integrals.

    Parameters
    ----------
    thermal_energy : float, kJ/mol
    freedoms : int
    friction : float, 1/ps
        Frequency of the chain: inertias are kT / friction^2.
    """

    thermal_energy: float
    freedoms: int
    friction: float = defaults.FRICTION

    @property
    def _inertia(self) -> Floats:
        each = np.full(_CHAIN, self.thermal_energy / self.friction**2)
        each[0] *= self.freedoms
        return each

    def init(self, at: Phase) -> Bath:
        """Begin without friction."""
        return Bath(0.0, np.zeros(2 * _CHAIN))

    def apply(
        self, system: System, at: Phase, bath: Bath, time_step: float, rng: np.random.Generator
    ) -> tuple[Phase, Bath]:
        """Let the chain act on the velocities, and they on it."""
        xi, eta, inertia = bath.memory[:_CHAIN].copy(), bath.memory[_CHAIN:].copy(), self._inertia
        twice, scale = 2.0 * at.kinetic, 1.0
        for weight in _YOSHIDA:
            h = 0.5 * weight * time_step
            for i in reversed(range(_CHAIN)):
                self._kick(xi, inertia, i, twice, h)
            factor = np.exp(-2.0 * h * xi[0])
            scale, twice = scale * factor, twice * factor * factor
            eta += 2.0 * h * xi
            for i in range(_CHAIN):
                self._kick(xi, inertia, i, twice, h)
        shares = np.array([self.freedoms, *[1] * (_CHAIN - 1)])
        energy = 0.5 * inertia @ xi**2 + self.thermal_energy * shares @ eta
        return system.moving(at, scale * at.qd), Bath(float(energy), read_only([*xi, *eta]))

    def _kick(self, xi: Floats, inertia: Floats, i: int, twice: float, h: float) -> None:
        """Change the i-th coefficient for h, by what drives it and by the friction of the next."""
        drive = twice if i == 0 else inertia[i - 1] * xi[i - 1] ** 2
        force = (drive - (self.freedoms if i == 0 else 1) * self.thermal_energy) / inertia[i]
        brake = np.exp(-0.5 * h * xi[i + 1]) if i + 1 < _CHAIN else 1.0
        xi[i] = (xi[i] * brake + h * force) * brake


@dataclass(frozen=True)
class HybridMonteCarlo(Thermostat):
    """Trajectories of some steps from thermal velocities, kept or undone by Metropolis' rule.

    Duane, Kennedy, Pendleton, Roweth, Phys. Lett. B 195:216 (1987). With a reversible, volume-preserving
    integrator the distribution is exact at any time step; with Fixman's potential it is that of the force
    field in torsions. A trajectory with a step that fails is undone. The memory holds steps since the last
    test, trajectories kept and tried, the total energy and q where the present one began.

    Parameters
    ----------
    thermal_energy : float, kJ/mol
    length : int
        Steps a trajectory.
    """

    thermal_energy: float
    length: int = defaults.TRAJECTORY_LENGTH
    undoes: ClassVar[bool] = True

    def init(self, at: Phase) -> Bath:
        """Begin a trajectory."""
        return Bath(0.0, read_only([0.0, 0.0, 0.0, at.total, *at.q]))

    def apply(
        self, system: System, at: Phase, bath: Bath, time_step: float, rng: np.random.Generator
    ) -> tuple[Phase, Bath]:
        """Count a step; at the end of a trajectory keep or undo it, and draw new velocities."""
        steps, kept, tried, began = bath.memory[:4]
        if steps + 1 < self.length:
            return at, Bath(bath.energy, read_only([steps + 1, *bath.memory[1:]]))
        climbed = at.total - began
        keep = climbed <= 0.0 or (
            self.thermal_energy > 0.0 and rng.random() < np.exp(-climbed / self.thermal_energy)
        )
        before = at.total if keep else began
        if not keep:
            at = system.at(bath.memory[4:], np.zeros(system.tree.n_v))
        noise = np.sqrt(self.thermal_energy) * rng.standard_normal(system.tree.n_v)
        at = system.moving(at, sample(at.factors, noise))
        energy = bath.energy + before - at.total
        return at, Bath(energy, read_only([0.0, kept + keep, tried + 1, at.total, *at.q]))
