"""The methods by name: each a setting of a direction and a step rule."""

from collections.abc import Mapping
from types import MappingProxyType

from protochain.energies.protocol import Energy
from protochain.minimisers.annealing import Annealing
from protochain.minimisers.fire import Fire
from protochain.minimisers.kcm import KCM, by_length, by_sign
from protochain.minimisers.lbfgs import LBFGS
from protochain.minimisers.loop import Method
from protochain.minimisers.metrics import Mass, Stiffness
from protochain.minimisers.newton import Newton, PseudoTransient
from protochain.minimisers.steps import AcceptReject, Armijo, Decaying, Fixed

IN_TORSIONS: Mapping[str, Method] = MappingProxyType(
    {
        "kcm": KCM(),
        "kcm-2norm": KCM(Fixed(0.002), norm=by_length),
        "kcm-sign": KCM(Fixed(0.0001), norm=by_sign),
        "kcm-decaying": KCM(Decaying(0.002, 200.0)),
        "kcm-adaptive": KCM(AcceptReject(0.0005)),
        "kcm-armijo": KCM(Armijo(0.0005, window=5)),
        "kcm-transient": PseudoTransient(),
        "kcm-metric": KCM(AcceptReject(0.0005), Mass()),
        "kcm-stiffness": KCM(AcceptReject(0.0005), Stiffness()),
        "fire": Fire(),
        "quench": Fire(mixing=1.0, fade=1.0),
        "md": Annealing(),
        "anneal": Annealing(temperature=600.0, n_steps=2000),
        "newton": Newton(),
        "lbfgs": LBFGS(),
    }
)
"""Methods that turn hinges, bond lengths and angles as they came."""

METHODS = (*IN_TORSIONS, "cartesian", "hybrid", "openmm", "openmm-md")
"""All of them: ``cartesian`` moves all atoms, ``hybrid`` turns hinges first, ``openmm`` is OpenMM's
minimiser, ``openmm-md`` its constrained dynamics between two minimisations."""

BY_OPENMM = ("openmm", "openmm-md")

RANDOM = ("anneal", "openmm-md")
"""Methods that draw from their seed."""


def repeats_exactly(method: str, energy: Energy) -> bool:
    """Whether any run from one start ends in the same bits: no seed is used, and sums have one order.

    OpenMM's CPU platform, which also runs OpenMM's own methods, sums in no fixed order on several threads.
    """
    sums_in_order = energy.threads == 1 or (energy.engine != "openmm" and method not in BY_OPENMM)
    return method not in RANDOM and sums_in_order
