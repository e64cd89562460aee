"""Energies and forces of proteins by compiled kernels in double precision."""

from protochain.energies.native.engine import NativeEnergy
from protochain.energies.native.far import Opening
from protochain.energies.native.reading import UnsupportedForceError

__all__ = ["NativeEnergy", "Opening", "UnsupportedForceError"]
