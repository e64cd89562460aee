"""Mechanisms of rigid bodies by name: hinges, springs, dampers, bushings, drives, loads and events.

A :class:`Mechanism` is the builder, its :meth:`~Mechanism.build` gives a frozen :class:`Model`, and
:meth:`Model.simulate` a :class:`Run` with a table and an audit. Knows nothing of proteins. Any consistent set
of units will do.
"""

from protochain.mechanisms.bodies import Bodies, State
from protochain.mechanisms.elements import Acting, Conservative, Element
from protochain.mechanisms.mechanism import Mechanism
from protochain.mechanisms.model import Model
from protochain.mechanisms.run import Audit, Happened, Run

__all__ = [
    "Acting",
    "Audit",
    "Bodies",
    "Conservative",
    "Element",
    "Happened",
    "Mechanism",
    "Model",
    "Run",
    "State",
]
