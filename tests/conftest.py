"""Where the structures are, what is loaded once, and every tolerance with its reason."""

import functools
import os
import signal
from pathlib import Path
from typing import Any

# Threads of several test processes that spin while they wait take the cores from one another.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import numpy as np
import pytest

import protochain as pc
from protochain.core import interrupts
from protochain.mechanics.multibody import Tree
from protochain.structure.repairs import Kind, Repair

ROOT = Path(__file__).parent.parent

STRUCTURES = ROOT / "structures"
MORE_STRUCTURES = ROOT.parent / "shared" / "structures"
SAMPLES = (
    "1l2y.pdb",
    "1vii.pdb",
    "1ejg.pdb",
    "4pti.pdb",
    "1ubq.pdb",
    "1ubq.cif",
    "1hel.pdb",
    "3i40.pdb",
    "ala10.pdb",
)

ROUND_OFF = 1e-12
"""Relative, for a few dozen double-precision operations on numbers of order one."""


def round_off(tree: Tree) -> float:
    """Relative. A sweep of n bodies does some ten rounded operations a body, whose errors add up at worst."""
    return 100 * np.finfo(float).eps * tree.n_bodies


ROUND_OFF_NM = 1e-11
"""Positions of a chain some hundred hinges deep: a few eps of some nm for every hinge."""

GEOMETRY_NM, GEOMETRY_RAD = 1e-9, 1e-9
"""Bond lengths and angles of a torsion-space result: rebuilt from fixed body coordinates, they cannot
drift; what is left is round-off at coordinates of some nm, a thousand times below this."""

DIFFERENCE = 1e-5
"""Of the norm of the torques. Central differences of a Reference-platform energy with a step of 1e-5 rad:
truncation ~ step^2 and cancellation ~ eps |E| / step, each about 1e-6 of the torques here."""

RIGID_MOTION = 1e-6
"""Relative. Turned and moved coordinates are rounded anew; energies of the Reference platform follow."""

AUDITED = 1e-8
"""Of the energy in motion. What is asked of smooth mechanisms, whose steps are short enough for it."""

ELEMENT_DIFFERENCE = 1e-7
"""Of the norm of the torques of elements of mechanisms. Central differences with a step of 1e-6: truncation
1e-12, and cancellation eps / step = 2e-10 of energies up to a hundred times their gradients."""

SAME_KERNEL = 1e-8
"""Relative, GBSAOBCForce against the CustomGBForce it replaces. Charges are scaled for the Coulomb
constant; the surface-area constants (2.25936 x 4 pi against 28.3919551) agree to 1e-8 of a term that is
a thousandth of the whole."""

NATIVE_ENERGY = 1e-10
"""Relative to the sum of the parts' sizes, native kernels against the Reference platform: both in double
precision, some million terms, polynomials of 1e-14."""

NATIVE_FORCE = 1e-10
"""Of the norm of the forces."""

SPRING_ENERGY = 1e-12
"""Relative. A sum of a few hundred squares."""

LEFT_OUT = 1e-10
"""Of the norm of the torques, with constant terms left out: their forces cancel to round-off."""

REVERSED = 1e-9
"""Back at the start after some dozen steps there and back: fixed points are solved to 1e-12 of a velocity,
and neighbouring paths part by a factor of a hundred meanwhile."""

RMSD_ANGSTROM = 1e-5
"""Against mdtraj and MDAnalysis. mdtraj works in single precision: 1e-7 of some nm^2 under a root."""

READ_AGAIN = 1e-6
"""Relative. A result read again has the energy that was said of it: mmCIF has nine digits of a coordinate."""

PDB_ROUNDING_NM = 0.5e-4
"""Half a unit in the third decimal of an angstrom."""


@functools.cache
def load(name: str) -> pc.Structure:
    return pc.load(STRUCTURES / name)


@functools.cache
def chain(name: str, hinges: str = "phi psi chi", root: str = "auto") -> pc.Chain:
    return pc.build_chain(load(name), hinges, root)


@functools.cache
def energy(name: str, **options: str):
    return pc.energy(load(name), **options)


@pytest.fixture
def interruptible():
    """Interrupts as the command line has them."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    assert signal.signal(signal.SIGINT, before) is signal.default_int_handler


def is_held() -> bool:
    """Whether interrupts are noted, not raised."""
    return isinstance(signal.getsignal(signal.SIGINT), interrupts._Noted)


def sentences(of: Any) -> list[str]:
    """Repairs of a structure, or of a draft, in words."""
    return [str(repair) for repair in of.repairs]


def noted(text: str) -> Repair:
    """A repair whose words end with a text."""
    return Repair(Kind.WRONG_HAND, {"atoms": (text,)})


def shared(name: str) -> Path:
    """A structure of the larger collection, or skip."""
    path = MORE_STRUCTURES / name
    if not path.exists():
        pytest.skip(f"{name} is not here")
    return path
