"""The laboratory of studies and scenes: cases and how they are judged, what they cost, tables and pictures.

:mod:`.cases` holds values against oracles and judges extremes, :mod:`.cost` times calls, :mod:`.fits` tells
orders and exponents, :mod:`.report` draws and writes, :mod:`.provenance` says where results come from. It
knows neither proteins nor mechanics.
"""

from protochain.lab.cost import Timed, in_turn
from protochain.lab.fits import exponent
from protochain.lab.provenance import commit, processor
from protochain.lab.report import draw_lines

__all__ = ["Timed", "commit", "draw_lines", "exponent", "in_turn", "processor"]
