"""Mechanisms of rigid bodies by name: hinges, springs, dampers, bushings, drives, loads and events.

A :class:`Mechanism` is the builder, its :meth:`~Mechanism.build` gives a frozen :class:`Model`, and
:meth:`Model.simulate` a :class:`Run` with a table and an audit. Knows nothing of proteins. Any consistent set
of units will do.
"""

from protochain.mechanisms.bodies import Bodies, State
from protochain.mechanisms.elements import Acting, Conservative, Element
from protochain.mechanisms.linear import frequencies, state_matrix
from protochain.mechanisms.mechanism import Mechanism
from protochain.mechanisms.model import Model
from protochain.mechanisms.run import Audit, Happened, Run
from protochain.mechanisms.segments import Beam, Segments, add_beam

__all__ = [
    "Acting",
    "Audit",
    "Beam",
    "Bodies",
    "Conservative",
    "Element",
    "Happened",
    "Mechanism",
    "Model",
    "Run",
    "Segments",
    "State",
    "add_beam",
    "frequencies",
    "state_matrix",
]
