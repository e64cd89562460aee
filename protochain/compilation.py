"""The compiler of all kernels, with its settings, which numba keeps for the whole process."""

from typing import Any

from numba import config, njit
from numba.core.codegen import get_host_cpu_features

__all__ = ["njit"]

# LLVM's superword-level vectoriser, off by default in numba, makes sweeps 1.4 times faster. Code rounds
# differently with and without it: set later than the first kernel is compiled, as by a module that not every
# program imports first, it would make results depend on the order of imports and calls.
_SETTINGS: Any = config
_SETTINGS.SLP_VECTORIZE = 1


def _wide() -> None:
    """Use vectors of eight doubles where the processor has them, though LLVM prefers four on most of these.

    It makes the pairs' kernels 1.3 to 1.5 times faster. NUMBA_CPU_NAME or NUMBA_CPU_FEATURES, if set, decide.
    """
    features = get_host_cpu_features()
    if _SETTINGS.CPU_NAME is None and _SETTINGS.CPU_FEATURES is None and "+avx512f" in features:
        _SETTINGS.CPU_FEATURES = features + ",-prefer-256-bit"


_wide()
