"""The compiler of all kernels, with its settings, which numba keeps for the whole process."""

from typing import Any

from numba import config, njit

__all__ = ["njit"]

# LLVM's superword-level vectoriser, off by default in numba, makes sweeps 1.4 times faster. Code rounds
# differently with and without it: set later than the first kernel is compiled, as by a module that not every
# program imports first, it would make results depend on the order of imports and calls.
_SETTINGS: Any = config
_SETTINGS.SLP_VECTORIZE = 1
