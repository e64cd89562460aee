"""Predicted and damaged models made clean, the fold kept."""

from protochain.relaxation.api import relax
from protochain.relaxation.presets import PRESETS, PROTOCOLS, Preset
from protochain.relaxation.result import Relaxation
from protochain.relaxation.rounds import Round
from protochain.relaxation.settings import Relaxing

__all__ = ["PRESETS", "PROTOCOLS", "Preset", "Relaxation", "Relaxing", "Round", "relax"]
