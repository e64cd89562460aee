"""Minimise the energy of protein chains in torsion space, and compare how.

Names are imported on first use, so that ``import protochain`` and ``protochain --help`` are quick. Their
modules are in ``__init__.pyi``, which type checkers and editors read, too.
"""

from typing import Any

import lazy_loader

_get_public, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("protochain")
    return _get_public(name)
