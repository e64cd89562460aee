"""Studies to repeat on any machine: ``protochain bench NAME``. A new one is a module, and its line here."""

from importlib import import_module
from typing import Any

from protochain.core.errors import ProtochainError

STUDIES = {
    "precision": "error against run time of everything that approximates or iterates",
    "stability": "a grid of stiff and extreme cases, each right, refused or wrong",
    "kcm": "whether the compliance method and constrained dynamics end in different minima",
    "omissions": "what runs leave out, with proof that the answer is the same, and what that saves",
}
"""One line on each, by name; their modules are imported on use."""


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
