"""Processes of our own: Python with this protochain, and with nothing of the folder it is started in."""

import sys
from pathlib import Path


def own_python(statement: str) -> list[str]:
    """Command, for :class:`subprocess.Popen`, that runs a statement, which imports what it needs.

    Without ``-P`` a module of the current folder, such as a ``gemmi.py`` among somebody's structures, would
    run in place of an installed one.
    """
    first = "import sys; sys.path.append(sys.argv.pop(1)); "
    return [sys.executable, "-P", "-c", first + statement, str(Path(__file__).parents[2])]
