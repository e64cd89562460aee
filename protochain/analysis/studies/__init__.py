"""Studies to repeat on any machine: ``protochain bench NAME``. A new one is a module, and its name here."""

from importlib import import_module
from typing import Any

from protochain.errors import ProtochainError

STUDIES = ("precision", "stability", "kcm", "scenes")


def study(name: str) -> Any:
    """Return the module of a study, whose ``run(output, inputs)`` yields its tables.

    Parameters
    ----------
    name : str
        One of ``STUDIES``.

    Returns
    -------
    module
        Imported on demand.

    Raises
    ------
    ProtochainError
        If there is no such study.
    """
    if name not in STUDIES:
        raise ProtochainError(f"there is no study {name!r}; choose from {', '.join(STUDIES)}")
    return import_module(f"protochain.analysis.studies.{name}")
