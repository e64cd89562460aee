"""Energies and forces of proteins by compiled kernels in double precision."""

# The first import of numba, which is not to read settings of the current folder.
import protochain.core.compilation  # noqa: F401
from protochain.energies.native.engine import NativeEnergy
from protochain.energies.native.far import Opening
from protochain.energies.native.reading import UnsupportedForceError

__all__ = ["NativeEnergy", "Opening", "UnsupportedForceError"]
