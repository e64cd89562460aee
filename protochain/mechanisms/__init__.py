"""Mechanisms of rigid bodies by name: hinges, springs, dampers, bushings, drives, loads, contacts and events.

A :class:`Mechanism` is the builder, its :meth:`~Mechanism.build` gives a frozen :class:`Model`, and
:meth:`Model.simulate` a :class:`Run` with a table and an audit. Knows nothing of proteins. Any consistent set
of units will do.
"""

from protochain.mechanisms.bodies import Bodies, State
from protochain.mechanisms.contact import (
    Contact,
    Friction,
    Law,
    flores,
    lankarani_nikravesh,
    real_restitution,
)  # fmt: skip
from protochain.mechanisms.elements import Acting, Conservative, Element, Memory
from protochain.mechanisms.mechanism import Mechanism
from protochain.mechanisms.model import Model
from protochain.mechanisms.run import Audit, Happened, Run
from protochain.mechanisms.search import BoxTree, box_tree, overlapping, touching
from protochain.mechanisms.shapes import Ball, Plane, Surface

__all__ = [
    "Acting", "Audit", "Ball", "Bodies", "BoxTree", "Conservative", "Contact", "Element", "Friction",
    "Happened", "Law", "Mechanism", "Memory", "Model", "Plane", "Run", "State", "Surface", "box_tree",
    "flores", "lankarani_nikravesh", "overlapping", "real_restitution", "touching",
]  # fmt: skip
