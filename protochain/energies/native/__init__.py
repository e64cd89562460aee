"""Energies and forces of proteins by kernels of our own, in double precision."""

from protochain.energies.native.engine import NativeEnergy
from protochain.energies.native.reading import UnsupportedForceError

__all__ = ["NativeEnergy", "UnsupportedForceError"]
