"""Energies and forces from an OpenMM System."""

import copy
import hashlib
from collections.abc import Callable, Mapping
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
import openmm
from openmm import unit

from protochain.core.arrays import Floats, Integers, floats
from protochain.core.errors import ForceFieldError
from protochain.core.processors import processors

_LIGHT = 1.5  # amu. Atoms lighter than this are hydrogens.


class OpenMMEnergy:
    """Energy of an OpenMM System on one platform.

    Parameters
    ----------
    system : openmm.System or callable
        It is not copied: for thousands of atoms a copy is slower than a build. Do not change it later. A
        callable without arguments builds it at its first use.
    platform : str
        ``CPU`` (single precision, fast) or ``Reference`` (double precision).
    threads : int or None
        Threads of the CPU platform, None for all.
    forcefield, solvent, note : str
        Names for reports, and a note on how the System was built.
    atoms : str
        ``Structure.fingerprint`` of the structure, empty if the caller provided the System.
    settings : mapping of str to Any
        Arguments of :func:`protochain.energy` that it was built with, except structure and System.
    """

    engine, device = "openmm", "cpu"
    left_out: Mapping[str, int] = MappingProxyType({})
    lists_at: Floats | None = None

    def __init__(
        self,
        system: openmm.System | Callable[[], openmm.System],
        platform: str = "CPU",
        threads: int | None = None,
        forcefield: str = "custom",
        solvent: str = "custom",
        note: str = "",
        atoms: str = "",
        settings: Mapping[str, Any] = MappingProxyType({}),
    ) -> None:
        self._system = system
        self.platform = platform
        self.threads = (threads or processors()) if platform == "CPU" else 1
        self.forcefield = forcefield
        self.solvent = solvent
        self.note = note
        self.atoms = atoms
        self.settings = dict(settings)

    def __reduce__(self) -> tuple[Any, ...]:
        """Rebuild the energy from its System, because contexts cannot be pickled."""
        return OpenMMEnergy, (self.system, self.platform, self.threads, *self._names)

    @cached_property
    def system(self) -> openmm.System:
        """The System."""
        return self._system if isinstance(self._system, openmm.System) else self._system()

    @property
    def _names(self) -> tuple[Any, ...]:
        return self.forcefield, self.solvent, self.note, self.atoms, self.settings

    @property
    def reason(self) -> str:
        """Platform, precision, threads, and the note on the System."""
        precision = "double" if self.platform == "Reference" else "single"
        text = f"OpenMM {self.platform} platform, {precision} precision, {self.threads} threads"
        return f"{text}; {self.note}" if self.note else text

    @property
    def is_exact(self) -> bool:
        """Whether it computes in double precision."""
        return self.platform == "Reference"

    def without_constants(self, groups: Integers, x: Floats) -> "OpenMMEnergy":
        """Return itself, because OpenMM computes all terms, including constant terms."""
        return self

    def list_at(self, x: Floats) -> None:
        """Do nothing, because OpenMM manages its neighbour lists."""

    @cached_property
    def reference(self) -> "OpenMMEnergy":
        """The same System on the Reference platform."""
        if self.platform == "Reference":
            return self
        return OpenMMEnergy(self.system, "Reference", None, *self._names)

    exact = property(lambda self: self.reference, doc="Its reference.")

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 of the System: energies with equal fingerprints are the same function."""
        return hashlib.sha256(openmm.XmlSerializer.serialize(self.system).encode()).hexdigest()

    def make_context(
        self, system: openmm.System, integrator: openmm.Integrator | None = None
    ) -> openmm.Context:
        """Create a Context for a System on this platform, or raise ForceFieldError."""
        platform = openmm.Platform.getPlatform(self.platform)
        properties = {"Threads": str(self.threads)} if self.platform == "CPU" else {}
        try:
            return openmm.Context(system, integrator or openmm.VerletIntegrator(0.001), platform, properties)
        except openmm.OpenMMException as error:
            reason = " ".join(str(error).split())
            raise ForceFieldError(
                f"force field {self.forcefield!r}: OpenMM cannot compute it: {reason}; correct it"
            ) from None

    @cached_property
    def _context(self) -> openmm.Context:
        return self.make_context(self.system)

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy in kJ/mol and forces (na, 3) in kJ/mol/nm at positions x (na, 3) in nm.

        If OpenMM refuses NaN in positions or forces, the energy is infinite and the forces are NaN. The
        calling loop handles that.
        """
        x = floats(x, (self.system.getNumParticles(), 3), "x", "nanometer")
        try:
            self._context.setPositions(x)
            state = self._context.getState(energy=True, forces=True)
        except openmm.OpenMMException as error:
            if "nan" not in str(error).lower():
                raise
            return np.inf, np.full(x.shape, np.nan)
        value = state.getPotentialEnergy().value_in_unit(unit.kilojoule_per_mole)
        forces = state.getForces(asNumpy=True).value_in_unit(unit.kilojoule_per_mole / unit.nanometer)
        return float(value), np.asarray(forces, dtype=np.float64)

    def parts(self, x: Floats) -> tuple[dict[str, float], Floats]:
        """Evaluate energies by force of the System, as ``HarmonicBondForce``. See :meth:`Energy.parts`."""
        x = floats(x, (self.system.getNumParticles(), 3), "x", "nanometer")
        energies: dict[str, float] = {}
        names = [force.getName() for force in self.system.getForces()]
        # Each force is in a separate System, because OpenMM has only 32 groups of forces.
        for k, name in enumerate(names):
            single = copy.deepcopy(self.system)
            for index in reversed(range(len(names))):
                if index != k:
                    single.removeForce(index)
            context = self.make_context(single)
            context.setPositions(x)
            value = context.getState(energy=True).getPotentialEnergy()
            energies[name] = energies.get(name, 0.0) + value.value_in_unit(unit.kilojoule_per_mole)
        return energies, self(x)[1]

    def __repr__(self) -> str:
        return f"<OpenMMEnergy {self.forcefield}, {self.solvent}: {self.reason}>"


def constrain_hydrogens(system: openmm.System) -> None:
    """Constrain bonds to hydrogen to their equilibrium lengths, as ``constraints=HBonds`` does.

    Parameters
    ----------
    system : openmm.System
        System to change in place.
    """
    # Atoms without mass are fixed and cannot be constrained.
    light = [0.0 < system.getParticleMass(i)._value < _LIGHT for i in range(system.getNumParticles())]
    for force in system.getForces():
        if isinstance(force, openmm.HarmonicBondForce):
            for k in range(force.getNumBonds()):
                i, j, length, _ = force.getBondParameters(k)
                if light[i] != light[j]:
                    system.addConstraint(i, j, length)
                    force.setBondParameters(k, i, j, length, 0.0)
