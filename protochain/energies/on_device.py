"""Energies on a device: OpenMM's CUDA, HIP and OpenCL platforms, and the processor where one fails."""

import copy
import os
import tempfile
import warnings
from functools import cache, cached_property
from getpass import getuser
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import openmm
from numpy.typing import NDArray

from protochain.core import defaults
from protochain.core.arrays import Floats, Integers, floats
from protochain.core.errors import DeviceWarning
from protochain.energies.native import NativeEnergy
from protochain.energies.native.terms import Terms
from protochain.energies.openmm_engine import OpenMMEnergy
from protochain.energies.protocol import Energy

PLATFORMS = {"cuda": "CUDA", "hip": "HIP", "opencl": "OpenCL"}
"""Devices and their platforms of OpenMM."""

_OFTEN_A_PROCESSOR = "opencl"
"""Device that ``auto`` does not choose, for pocl runs OpenCL on the processor, slower than our kernels; and
where OpenMM's minimiser does not run, which pocl 3.1 cannot compile: it ends the process."""

_SPRING = "0.5*held*k*((x-x0)^2+(y-y0)^2+(z-z0)^2)"
LOCKS = Path(tempfile.gettempdir())
"""Folder of the locks by which processes see that another computes on a device."""
_VISIBLE = ("CUDA_VISIBLE_DEVICES", "HIP_VISIBLE_DEVICES", "ROCR_VISIBLE_DEVICES")


class DeviceError(Exception):
    """Why a device does not compute, in one line."""


class Springs(Protocol):
    """Springs from atoms to points."""

    @property
    def weight(self) -> Floats:
        """(na,) kJ/mol/nm^2."""

    @property
    def home(self) -> Floats:
        """(na, 3) nm."""


def choose_device(device: str, n_atoms: int, fewest: int = defaults.DEVICE_FROM) -> str:
    """Device that computes an energy of so many atoms; of ``auto`` a GPU, if there is one and it pays."""
    if device != "auto":
        return device
    usable = (name for name in PLATFORMS if name != _OFTEN_A_PROCESSOR and name in _loaded_devices())
    return next(usable, "cpu") if n_atoms >= fewest else "cpu"


def devices() -> list[str]:
    """What there is of each device that OpenMM knows.

    Returns
    -------
    list of str
        A line each, which begins with its name: versions and hardware, or ``none`` and why.

    Examples
    --------
    >>> [line.split(":")[0] for line in pc.energies.devices()]
    ['cuda', 'hip', 'opencl']
    """
    failures, lines = openmm.Platform.getPluginLoadFailures(), list[str]()
    for device, platform in PLATFORMS.items():
        if device in _loaded_devices():
            gpu = openmm.Platform.getPlatform(platform)
            try:
                names = [dict(properties).get("DeviceName", "") for properties in gpu.getDevices()]
            except (AttributeError, openmm.OpenMMException) as error:  # Of older versions; without a driver.
                names = [f"its devices are not known ({_line(error)})"]
            lines.append(f"{device}: {', '.join(filter(None, [f'OpenMM {gpu.getOpenMMVersion()}', *names]))}")
        else:
            reasons = (_line(text) for text in failures if platform.lower() in text.lower())
            lines.append(f"{device}: none, {next(reasons, f'OpenMM has no platform {platform}')}")
    return lines


def _loaded_devices() -> set[str]:
    """Devices whose platforms OpenMM has loaded."""
    names = {openmm.Platform.getPlatform(k).getName() for k in range(openmm.Platform.getNumPlatforms())}
    return {device for device, platform in PLATFORMS.items() if platform in names}


def _line(error: object) -> str:
    return " ".join(str(error).split())


@cache
def _lock(name: str, folder: Path, process: int) -> Any:
    from filelock import FileLock

    return FileLock(folder / f"protochain-{getuser()}-{name}.lock")


def prepare_energy(energy: Energy, x: Floats) -> Energy:
    """The energy as a run from x (na, 3), nm, evaluates it: the processor's where a device cannot."""
    return energy.prepare(x) if isinstance(energy, DeviceEnergy) else energy


class DeviceEnergy(OpenMMEnergy):
    """Energy of an OpenMM System on a device, in mixed precision; on the processor once the device fails.

    processor: The same energy there, which judges, and goes on where single precision ends.
    accuracy: Of its far pairs where it computes in place of the device.
    """

    def __init__(
        self, processor: Energy, by_openmm: OpenMMEnergy, device: str, accuracy: float | None = None
    ) -> None:
        super().__init__(by_openmm.system, PLATFORMS[device], None, *by_openmm._names)
        self.processor, self.by_openmm, self.accuracy = processor, by_openmm, accuracy
        self.device, self.threads = device, by_openmm.threads
        self._current: tuple[Integers, openmm.Context] | None = None
        """Atoms that are fixed beside those without mass, and the context."""
        self._active_springs: Springs | None = None
        self.failed = ""

    def __reduce__(self) -> tuple[Any, ...]:
        """Made anew: contexts cannot be pickled."""
        return DeviceEnergy, (self.processor, self.by_openmm, self.device, self.accuracy)

    @property
    def reason(self) -> str:
        """Platform and precision, and why the processor computes, if it does."""
        if self.failed:
            return self.processor.reason
        text = f"OpenMM {self.platform} platform, mixed precision"
        return f"{text}; {self.note}" if self.note else text

    @property
    def exact(self) -> Energy:
        """The same energy by the processor, in double precision, all pairs one by one."""
        return self.processor.exact

    @property
    def terms(self) -> Terms:
        """Terms as arrays; none where the native engine does not know them."""
        processor: Any = self.processor
        return processor.terms

    @property
    def minimises(self) -> bool:
        """Whether OpenMM's own minimiser runs there."""
        return self.device != _OFTEN_A_PROCESSOR and not self.failed

    def prepare(self, x: Floats) -> Energy:
        """The energy as a run from x (na, 3), nm, evaluates it: itself, or the processor's if it fails."""
        try:
            if not self.failed:
                self._context_of(None)
        except DeviceError as error:
            self._fall_back(error, x)
        return self.processor if self.failed else self

    @cached_property
    def _massive(self) -> NDArray[np.bool_]:
        """(na,) bool: obstacles have no mass."""
        system = self.system
        return np.array([system.getParticleMass(k)._value > 0 for k in range(system.getNumParticles())])

    def _context_of(self, moving: NDArray[np.bool_] | None) -> openmm.Context:
        """Context in which atoms (na,) may move; None: any."""
        fixed = None if moving is None else np.flatnonzero(~moving & self._massive)
        if self._current is not None and (fixed is None or np.array_equal(fixed, self._current[0])):
            return self._current[1]
        fixed = np.empty(0, np.int64) if fixed is None else fixed
        self._current = self._active_springs = None  # Memory of the device holds one.
        visible = "-".join(filter(None, (os.environ.get(name) for name in _VISIBLE))).replace(os.sep, "_")
        try:
            # Held until the process ends.
            lock = _lock(f"{self.device}{visible}", LOCKS, os.getpid())
            if not lock.is_locked:
                lock.acquire(timeout=0)
        except TimeoutError:  # Of filelock.
            raise DeviceError("another process of protochain computes on it") from None
        except OSError:  # Nowhere to leave a lock.
            pass
        system = copy.deepcopy(self.system)
        for atom in fixed.tolist():
            system.setParticleMass(atom, 0.0)
        springs = openmm.CustomExternalForce(_SPRING)
        springs.addGlobalParameter("held", 0.0)
        for name in ("k", "x0", "y0", "z0"):
            springs.addPerParticleParameter(name)
        for atom in range(system.getNumParticles()):
            springs.addParticle(atom, [0.0] * 4)
        self._springs = springs
        system.addForce(springs)
        try:
            platform = openmm.Platform.getPlatform(self.platform)
            context = openmm.Context(system, openmm.VerletIntegrator(0.001), platform, self._properties)
        except openmm.OpenMMException as error:
            raise DeviceError(_line(error)) from None
        self._current = fixed, context
        return context

    @property
    def _properties(self) -> dict[str, str]:
        return {"Precision": "mixed"}

    @property
    def _context(self) -> openmm.Context:
        return self._context_of(None)

    def _fall_back(self, error: Exception, x: Floats) -> None:
        """From now on the processor computes, from x (na, 3), nm, on; says so."""
        self.failed, self._current = f"not by {self.platform}: {_line(error)}", None
        self.by_openmm.note = f"{self.by_openmm.note}; {self.failed}".removeprefix("; ")
        if self.accuracy is not None and isinstance(self.processor, NativeEnergy):
            self.processor = self.processor.to_accuracy(self.accuracy, x)
        warnings.warn(f"{self.failed}; the processor computes instead", DeviceWarning, stacklevel=4)

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        """Energy in kJ/mol and forces (na, 3) in kJ/mol/nm at positions x (na, 3) in nm."""
        if not self.failed:
            try:
                return super().__call__(x)
            except (DeviceError, openmm.OpenMMException) as error:
                self._fall_back(error, x)
        return self.processor(x)

    def parts(self, x: Floats) -> tuple[dict[str, float], Floats]:
        """Energies by kind, and forces, on the processor."""
        return self.processor.parts(x)

    def descend(
        self, x: Floats, moving: NDArray[np.bool_], springs: Springs | None, tolerance: float, n: int
    ) -> Floats | None:
        """Positions after at most n iterations of OpenMM's minimiser from x (na, 3), nm; None if it fails.

        The positions stay on the device. Tolerance kJ/mol/nm, RMS over the components that may move.
        """
        x = floats(x, (len(moving), 3), "x", "nanometer")
        try:
            context = self._context_of(moving)
            if springs is not None and springs is not self._active_springs:
                for atom, (k, home) in enumerate(zip(springs.weight, springs.home, strict=True)):
                    self._springs.setParticleParameters(atom, atom, [k, *home])
                self._springs.updateParametersInContext(context)
                self._active_springs = springs
            context.setPositions(x)
            context.setParameter("held", float(springs is not None))
            # OpenMM takes the RMS length over all atoms.
            lengths = tolerance * np.sqrt(3 * moving.sum() / len(moving))
            openmm.LocalEnergyMinimizer.minimize(context, lengths, n)
            context.setParameter("held", 0.0)
            positions = context.getState(positions=True).getPositions(asNumpy=True)._value
        except (DeviceError, openmm.OpenMMException) as error:
            if "nan" not in str(error).lower():  # As where atoms coincide: ours goes on from there.
                self._fall_back(error, x)
            return None
        return np.asarray(positions, dtype=np.float64)
