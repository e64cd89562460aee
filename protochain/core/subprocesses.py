"""Processes of our own: Python with this protochain, and with nothing of the folder it is started in."""

import sys
from pathlib import Path


def own_python(statement: str) -> list[str]:
    """Command that runs a statement. ``-P`` ignores a ``gemmi.py`` in the current folder."""
    first = "import sys; sys.path.append(sys.argv.pop(1)); "
    return [sys.executable, "-P", "-c", first + statement, str(Path(__file__).parents[2])]
