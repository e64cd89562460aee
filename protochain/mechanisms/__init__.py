"""Mechanisms of rigid bodies by name: hinges, springs, dampers, bushings, drives, loads, contacts and events.

A :class:`Mechanism` is the builder, its :meth:`~Mechanism.build` gives a frozen :class:`Model`, and
:meth:`Model.simulate` a :class:`Run` with a table and an audit. Knows nothing of proteins. Any consistent set
of units will do.
"""

from protochain.mechanisms.assumed import assumed_modes
from protochain.mechanisms.bending import bending
from protochain.mechanisms.bodies import Bodies, State
from protochain.mechanisms.bushing import Bushing
from protochain.mechanisms.closing import Closing
from protochain.mechanisms.contact import (
    Contact,
    Friction,
    Law,
    flores,
    lankarani_nikravesh,
    real_restitution,
)
from protochain.mechanisms.drawing import Block, Rod
from protochain.mechanisms.elements import Acting, Conservative, CustomForce, Element, Memory, Named
from protochain.mechanisms.event import Event, Happened
from protochain.mechanisms.hinge_friction import HingeFriction
from protochain.mechanisms.hinge_springs import Stop, Torsion
from protochain.mechanisms.linear import Linear, frequencies, linearise, state_matrix
from protochain.mechanisms.linear_springs import Spring
from protochain.mechanisms.loads import AppliedForce, HingeTorque
from protochain.mechanisms.loop_joints import ClosedEquations
from protochain.mechanisms.mechanism import Mechanism
from protochain.mechanisms.model import Model
from protochain.mechanisms.motors import Motor
from protochain.mechanisms.pictures import Movie
from protochain.mechanisms.rosenbrock import Rosenbrock
from protochain.mechanisms.run import Audit, Run
from protochain.mechanisms.search import BoxTree, box_tree, overlapping, touching
from protochain.mechanisms.segments import Beam, Segments, add_beam
from protochain.mechanisms.shapes import Ball, Plane, Surface

__all__ = [
    "Acting", "AppliedForce", "Audit", "Ball", "Beam", "Block", "Bodies", "BoxTree", "Bushing",
    "ClosedEquations", "Closing", "Conservative", "Contact", "CustomForce", "Element", "Event",
    "Friction", "Happened", "HingeFriction", "HingeTorque", "Law", "Linear", "Mechanism", "Memory",
    "Model", "Motor", "Movie", "Named", "Plane", "Rod", "Rosenbrock", "Run", "Segments", "Spring",
    "State", "Stop", "Surface", "Torsion", "add_beam", "assumed_modes", "bending", "box_tree", "flores",
    "frequencies", "lankarani_nikravesh", "linearise", "overlapping", "real_restitution",
    "state_matrix", "touching",
]  # fmt: skip
