"""Energies on a device: OpenMM's CUDA, HIP and OpenCL platforms, and the processor if one fails."""

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

PLATFORMS = {"cuda": "CUDA", "hip": "HIP", "opencl": "OpenCL"}  # Devices and their OpenMM platforms.
_OFTEN_A_PROCESSOR = "opencl"
"""Device that ``auto`` does not choose, because pocl runs OpenCL on the processor, slower than our kernels.
OpenMM's minimiser does not run there, because pocl 3.1 cannot compile it and ends the process."""

_SPRING = "0.5*held*k*((x-x0)^2+(y-y0)^2+(z-z0)^2)"
LOCKS = Path(tempfile.gettempdir())
"""Folder of the locks by which processes detect that another process uses a device."""
_VISIBLE = ("CUDA_VISIBLE_DEVICES", "HIP_VISIBLE_DEVICES", "ROCR_VISIBLE_DEVICES")


class DeviceError(Exception):
    """Reason for which a device does not compute, in one line."""


class Springs(Protocol):
    """Springs from atoms to points."""

    @property
    def weight(self) -> Floats:
        """(na,) kJ/mol/nm^2."""

    @property
    def home(self) -> Floats:
        """(na, 3) nm."""


def choose_device(device: str, n_atoms: int, fewest: int = defaults.DEVICE_FROM) -> str:
    """Device for an energy of a number of atoms. ``auto`` is a GPU if there is one and it is faster."""
    if device != "auto":
        return device
    usable = (name for name in PLATFORMS if name != _OFTEN_A_PROCESSOR and name in _loaded_devices())
    return next(usable, "cpu") if n_atoms >= fewest else "cpu"


def devices() -> list[str]:
    """List the devices that OpenMM supports.

    Returns
    -------
    list of str
        A line per device. It starts with the name, then versions and hardware, or ``none`` and the reason.

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
            except (AttributeError, openmm.OpenMMException) as error:  # Older versions, or no driver.
                names = [f"its devices are not known ({_one_line(error)})"]
            lines.append(f"{device}: {', '.join(filter(None, [f'OpenMM {gpu.getOpenMMVersion()}', *names]))}")
        else:
            reasons = (_one_line(text) for text in failures if platform.lower() in text.lower())
            lines.append(f"{device}: none, {next(reasons, f'OpenMM has no platform {platform}')}")
    return lines


def _loaded_devices() -> set[str]:
    """Devices whose platforms OpenMM has loaded."""
    names = {openmm.Platform.getPlatform(k).getName() for k in range(openmm.Platform.getNumPlatforms())}
    return {device for device, platform in PLATFORMS.items() if platform in names}


def _one_line(error: object) -> str:
    return " ".join(str(error).split())


@cache
def _lock(name: str, folder: Path, process: int) -> Any:
    from filelock import FileLock

    return FileLock(folder / f"protochain-{getuser()}-{name}.lock")


def prepare_energy(energy: Energy, x: Floats) -> Energy:
    """The energy that a run from x (na, 3), nm, evaluates: on the processor if a device fails."""
    return energy.prepare(x) if isinstance(energy, DeviceEnergy) else energy


class DeviceEnergy(OpenMMEnergy):
    """Energy of an OpenMM System on a device, in mixed precision, and on the processor after it fails."""

    # processor: The same energy on the processor. It judges ends and continues beyond single precision.
    # accuracy: Accuracy of the processor's far pairs after the device fails.

    def __init__(
        self, processor: Energy, by_openmm: OpenMMEnergy, device: str, accuracy: float | None = None
    ) -> None:
        super().__init__(by_openmm.system, PLATFORMS[device], None, *by_openmm._names)
        self.processor, self.by_openmm, self.accuracy = processor, by_openmm, accuracy
        self.device, self.threads = device, by_openmm.threads
        self._current: tuple[Integers, openmm.Context] | None = None
        """Fixed atoms that have mass, and the context."""
        self._active_springs: Springs | None = None
        self.failed = ""

    def __reduce__(self) -> tuple[Any, ...]:
        """Rebuild the energy, because contexts cannot be pickled."""
        return DeviceEnergy, (self.processor, self.by_openmm, self.device, self.accuracy)

    @property
    def reason(self) -> str:
        """Platform and precision, or the reason of the processor's energy after a failure."""
        if self.failed:
            return self.processor.reason
        text = f"OpenMM {self.platform} platform, mixed precision"
        return f"{text}; {self.note}" if self.note else text

    @property
    def exact(self) -> Energy:
        """The same energy by the processor, in double precision, with all pairs one by one."""
        return self.processor.exact

    @property
    def terms(self) -> Terms:
        """Terms of the energy as arrays, if the native engine supports them."""
        processor: Any = self.processor
        return processor.terms

    @property
    def minimises(self) -> bool:
        """Whether OpenMM's minimiser runs on the device."""
        return self.device != _OFTEN_A_PROCESSOR and not self.failed

    def prepare(self, x: Floats) -> Energy:
        """The energy that a run from x (na, 3), nm, evaluates: itself, or the processor's if it fails."""
        try:
            if not self.failed:
                self._context_of(None)
        except DeviceError as error:
            self._fall_back(error, x)
        return self.processor if self.failed else self

    @cached_property
    def _massive(self) -> NDArray[np.bool_]:
        """(na,) bool: atoms with mass. Obstacles have none."""
        system = self.system
        return np.array([system.getParticleMass(k)._value > 0 for k in range(system.getNumParticles())])

    def _context_of(self, moving: NDArray[np.bool_] | None) -> openmm.Context:
        """Context in which atoms (na,) may move. None means any atoms."""
        fixed = None if moving is None else np.flatnonzero(~moving & self._massive)
        if self._current is not None and (fixed is None or np.array_equal(fixed, self._current[0])):
            return self._current[1]
        fixed = np.empty(0, np.int64) if fixed is None else fixed
        self._current = self._active_springs = None  # The device has memory for one context.
        visible = "-".join(filter(None, (os.environ.get(name) for name in _VISIBLE))).replace(os.sep, "_")
        try:
            # The lock remains until the process ends.
            lock = _lock(f"{self.device}{visible}", LOCKS, os.getpid())
            if not lock.is_locked:
                lock.acquire(timeout=0)
        except TimeoutError:  # From filelock.
            raise DeviceError("another process of protochain computes on it") from None
        except OSError:  # No folder can be written.
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
            raise DeviceError(_one_line(error)) from None
        self._current = fixed, context
        return context

    @property
    def _properties(self) -> dict[str, str]:
        return {"Precision": "mixed"}

    @property
    def _context(self) -> openmm.Context:
        return self._context_of(None)

    def _fall_back(self, error: Exception, x: Floats) -> None:
        """Switch to the processor from x (na, 3), nm, on, with a warning."""
        self.failed, self._current = f"not by {self.platform}: {_one_line(error)}", None
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
        """Positions after up to n iterations of OpenMM's minimiser from x (na, 3), nm, None if it fails."""
        # The positions stay on the device. Tolerance is in kJ/mol/nm, RMS over the moving components.
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
            # OpenMM uses the RMS length over all atoms.
            lengths = tolerance * np.sqrt(3 * moving.sum() / len(moving))
            openmm.LocalEnergyMinimizer.minimize(context, lengths, n)
            context.setParameter("held", 0.0)
            positions = context.getState(positions=True).getPositions(asNumpy=True)._value
        except (DeviceError, openmm.OpenMMException) as error:
            if "nan" not in str(error).lower():  # As for coincident atoms: our minimiser continues.
                self._fall_back(error, x)
            return None
        return np.asarray(positions, dtype=np.float64)
