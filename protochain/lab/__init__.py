"""The laboratory of studies and scenes: cases, how they are judged, and what they cost.

:mod:`.cases` holds values against oracles and judges extremes, :mod:`.cost` times calls, :mod:`.fits` tells
orders and exponents. It knows neither proteins nor mechanics.
"""

from protochain.lab.cost import Timed, in_turn
from protochain.lab.fits import exponent

__all__ = ["Timed", "exponent", "in_turn"]
