"""What a command does not need is not imported: each start of the program would wait for it."""

import subprocess
import sys
from pathlib import Path

import pytest

SAMPLE = Path(__file__).parents[2] / "structures" / "ala10.pdb"
WITHOUT = {
    # Of one command, no other one, and nothing that computes.
    "from protochain.cli import app; app(['info', '--help'], standalone_mode=False)": (
        "protochain.cli.relax", "protochain.cli.minimise", "numpy", "numba", "scipy", "openmm",
    ),
    f"from protochain.cli import app; app(['info', {str(SAMPLE)!r}], standalone_mode=False)": (
        "pandas", "matplotlib", "mdtraj", "rdkit",
    ),
    "import protochain.minimisers.minimise_structure": (
        "protochain.dynamics.loop", "protochain.mechanics.motion", "pandas",
    ),
    "import protochain.batches.cluster": (
        "protochain.batches.batch_structures", "numpy", "numba", "distributed",
    ),
    "import protochain.batches.frame_tasks": ("protochain.batches.page", "matplotlib", "pandas"),
}  # fmt: skip


@pytest.mark.parametrize(("statement", "absent"), WITHOUT.items())
def test_imports_wait_until_they_are_needed(statement, absent):
    told = f"import sys; {statement}; print(sorted(set(sys.modules) & {set(absent)!r}))"
    done = subprocess.run([sys.executable, "-c", told], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
