"""Thermostats, applied after each step of an integrator. Each preserves the canonical distribution."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Protocol

import numpy as np

from protochain.core import defaults
from protochain.core.arrays import Floats, read_only
from protochain.core.settings import document_fields
from protochain.mechanics.motion.system import Phase, System
from protochain.mechanics.multibody.articulated import sample

Random = Callable[[], np.random.Generator]
"""Returns a generator on demand. Most steps draw nothing, and it costs a tenth of the step of a peptide."""


@dataclass(frozen=True, eq=False)
class Bath:
    """Heat bath: state of a thermostat."""

    energy: float  # kJ/mol: Energy received from the system: with the total energy, the conserved quantity.
    memory: Floats  # (k,): Variables of the thermostat.


PhaseAndBath = tuple[Phase, Bath]


class Thermostat(Protocol):
    """Exchange of energy with a heat bath.

    The fields of a thermostat are settings of the simulation, ``thermal_energy`` (kT in kJ/mol) and
    ``freedoms``, the number of degrees of freedom.
    """

    conserves_momentum: ClassVar[bool] = False
    """Whether it conserves zero total momentum, so that centre-of-mass motion can be removed."""
    metropolis: ClassVar[bool] = False
    """Whether it accepts or rejects trajectories, which requires a reversible integrator. A failed step then
    has an infinite potential and is rejected."""

    def init(self, at: Phase) -> Bath:
        """Return the bath at the start of a simulation."""
        return Bath(0.0, np.empty(0))

    def apply(self, system: System, at: Phase, bath: Bath, time_step: float, random: Random) -> PhaseAndBath:
        """Act for one time step. ``random`` returns the random generator of this step."""


@dataclass(frozen=True)
class Isolated(Thermostat):
    """No thermostat: constant energy."""

    conserves_momentum: ClassVar[bool] = True

    def apply(self, system: System, at: Phase, bath: Bath, time_step: float, random: Random) -> PhaseAndBath:
        """Do nothing."""
        return at, bath


@document_fields
@dataclass(frozen=True)
class Langevin(Thermostat):
    """Langevin thermostat in the mass metric: qd -> c qd + sqrt(1 - c^2) times a thermal velocity.

    Exact solution of dp = -friction p dt + sqrt(2 friction kT) M^1/2 dW at constant q, alternating with the
    leapfrog (as in Leimkuhler, Matthews, *Molecular Dynamics*, 2015). At 0 K it only damps.
    """

    thermal_energy: float  # kJ/mol: Value of kT.
    friction: float = defaults.FRICTION  # 1/ps: Friction coefficient.

    def apply(self, system: System, at: Phase, bath: Bath, time_step: float, random: Random) -> PhaseAndBath:
        """Apply friction and noise."""
        c = np.exp(-self.friction * abs(time_step))
        noise = np.sqrt((1.0 - c * c) * self.thermal_energy) * random().standard_normal(system.tree.n_v)
        after = system.with_velocities(at, c * at.qd + sample(at.factors, noise))
        return after, Bath(bath.energy + at.kinetic - after.kinetic, bath.memory)


@document_fields
@dataclass(frozen=True)
class Rescaling(Thermostat):
    """Stochastic velocity rescaling: one random factor that makes the kinetic energy canonical.

    Bussi, Donadio, Parrinello, J. Chem. Phys. 126:014101 (2007), equation A7.
    """

    conserves_momentum: ClassVar[bool] = True

    thermal_energy: float  # kJ/mol: Value of kT.
    freedoms: int  # Number of degrees of freedom.
    friction: float = defaults.FRICTION  # 1/ps: Relaxation rate of the velocities.

    def apply(self, system: System, at: Phase, bath: Bath, time_step: float, random: Random) -> PhaseAndBath:
        """Scale the velocities."""
        if at.kinetic == 0.0:
            return at, bath
        c, share = np.exp(-2.0 * self.friction * abs(time_step)), 0.5 * self.thermal_energy
        rng = random()
        one, squares = rng.standard_normal(), 2.0 * rng.standard_gamma(0.5 * (self.freedoms - 1))
        kinetic = (
            c * at.kinetic
            + (1.0 - c) * share * (one * one + squares)
            + 2.0 * one * np.sqrt(c * (1.0 - c) * share * at.kinetic)
        )
        after = system.with_velocities(at, np.sqrt(kinetic / at.kinetic) * at.qd)
        return after, Bath(bath.energy + at.kinetic - after.kinetic, bath.memory)


_CHAIN = 3
_OUTER = 1.0 / (2.0 - 2.0 ** (1.0 / 3.0))
_YOSHIDA = (_OUTER, 1.0 - 2.0 * _OUTER, _OUTER)


@document_fields
@dataclass(frozen=True)
class NoseHoover(Thermostat):
    """Nose-Hoover chain of three thermostats: deterministic and time-reversible.

    Martyna, Tuckerman, Tobias, Klein, Mol. Phys. 87:1117 (1996), with Yoshida's weights of order four. The
    bath's memory contains the friction coefficients (1/ps), then their integrals.
    """

    conserves_momentum: ClassVar[bool] = True

    thermal_energy: float  # kJ/mol: Value of kT.
    freedoms: int  # Number of degrees of freedom.
    # 1/ps: Frequency of the chain: thermostat masses are kT / friction^2.
    friction: float = defaults.FRICTION

    @property
    def _inertia(self) -> Floats:
        inertia = np.full(_CHAIN, self.thermal_energy / self.friction**2)
        inertia[0] *= self.freedoms
        return inertia

    def init(self, at: Phase) -> Bath:
        """Return a bath with friction coefficients of zero."""
        return Bath(0.0, np.zeros(2 * _CHAIN))

    def apply(self, system: System, at: Phase, bath: Bath, time_step: float, random: Random) -> PhaseAndBath:
        """Advance the chain and scale the velocities."""
        xi, eta, inertia = bath.memory[:_CHAIN].copy(), bath.memory[_CHAIN:].copy(), self._inertia
        twice, scale = 2.0 * at.kinetic, 1.0
        for weight in _YOSHIDA:
            h = 0.5 * weight * time_step
            for i in reversed(range(_CHAIN)):
                self._advance(xi, inertia, i, twice, h)
            factor = np.exp(-2.0 * h * xi[0])
            scale, twice = scale * factor, twice * factor * factor
            eta += 2.0 * h * xi
            for i in range(_CHAIN):
                self._advance(xi, inertia, i, twice, h)
        shares = np.array([self.freedoms, *[1] * (_CHAIN - 1)])
        energy = 0.5 * inertia @ xi**2 + self.thermal_energy * shares @ eta
        return system.with_velocities(at, scale * at.qd), Bath(float(energy), read_only([*xi, *eta]))

    def _advance(self, xi: Floats, inertia: Floats, i: int, twice: float, h: float) -> None:
        """Advance the i-th friction coefficient by h, driven by its force and damped by the next one."""
        drive = twice if i == 0 else inertia[i - 1] * xi[i - 1] ** 2
        force = (drive - (self.freedoms if i == 0 else 1) * self.thermal_energy) / inertia[i]
        brake = np.exp(-0.5 * h * xi[i + 1]) if i + 1 < _CHAIN else 1.0
        xi[i] = (xi[i] * brake + h * force) * brake


@document_fields
@dataclass(frozen=True)
class HybridMonteCarlo(Thermostat):
    """Hybrid Monte Carlo: short trajectories from thermal velocities, accepted by Metropolis' criterion.

    Duane, Kennedy, Pendleton, Roweth, Phys. Lett. B 195:216 (1987). With a reversible, volume-preserving
    integrator the distribution is exact at any time step. With Fixman's potential it is the force field's
    distribution in torsions. A trajectory with a failed or irreversible step is rejected. The memory contains
    the steps since the last test, the numbers of accepted and tried trajectories, and the total energy and q
    at the last start.
    """

    thermal_energy: float  # kJ/mol: Value of kT.
    trajectory_length: int = defaults.TRAJECTORY_LENGTH  # Number of steps of a trajectory.
    metropolis: ClassVar[bool] = True

    def init(self, at: Phase) -> Bath:
        """Return a bath at the start of a trajectory."""
        return Bath(0.0, read_only([0.0, 0.0, 0.0, at.total, *at.q]))

    def apply(self, system: System, at: Phase, bath: Bath, time_step: float, random: Random) -> PhaseAndBath:
        """Count a step. At the end of a trajectory, accept or reject it and draw new velocities."""
        steps, accepted, tried, began = bath.memory[:4]
        if steps + 1 < self.trajectory_length:
            return at, Bath(bath.energy, read_only([steps + 1, *bath.memory[1:]]))
        rise, rng = at.total - began, random()
        accept = rise <= 0.0 or (
            self.thermal_energy > 0.0 and rng.random() < np.exp(-rise / self.thermal_energy)
        )
        before = at.total if accept else began
        if not accept:
            at = system.at(bath.memory[4:], np.zeros(system.tree.n_v))
        noise = np.sqrt(self.thermal_energy) * rng.standard_normal(system.tree.n_v)
        at = system.with_velocities(at, sample(at.factors, noise))
        energy = bath.energy + before - at.total
        return at, Bath(energy, read_only([0.0, accepted + accept, tried + 1, at.total, *at.q]))


THERMOSTATS: dict[str, type[Thermostat]] = {
    "none": Isolated,
    "langevin": Langevin,
    "nose-hoover": NoseHoover,
    "rescale": Rescaling,
    "hmc": HybridMonteCarlo,
}


def build_thermostat(settings: Mapping[str, Any], thermal_energy: float, freedoms: int) -> Thermostat:
    """Thermostat of the settings for this number of degrees of freedom, with fields set by name."""
    kind: Any = THERMOSTATS[settings["thermostat"]]
    values = {**settings, "thermal_energy": thermal_energy, "freedoms": freedoms}
    return kind(**{field.name: values[field.name] for field in fields(kind)})
