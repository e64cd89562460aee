"""Libraries of optional dependencies."""

import importlib
from typing import Any

from protochain.core.errors import ProtochainError


def library(name: str, extra: str = "ligands") -> Any:
    """Import a library of an extra at its first use."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise ProtochainError(
            f'{name.partition(".")[0]} is not installed: pip install "protochain[{extra}]"'
        ) from None
