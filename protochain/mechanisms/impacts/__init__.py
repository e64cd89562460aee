"""Impacts: instantaneous changes of velocities, with friction, of any tree, with and without loops."""

from protochain.mechanisms.impacts.bodies import Bending
from protochain.mechanisms.impacts.impact import Impact, close_loops, friction_bound, impact
from protochain.mechanisms.impacts.points import ContactPoint
from protochain.mechanisms.impacts.stress import impulse_stress

__all__ = ["Bending", "ContactPoint", "Impact", "close_loops", "friction_bound", "impact", "impulse_stress"]
