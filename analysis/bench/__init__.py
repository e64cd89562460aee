"""Evidence: studies of proteins and scenes of mechanisms, how cases are judged, and what they cost.

:mod:`.cases` holds values against oracles and judges extremes, :mod:`.cost` times calls, :mod:`.fits` fits
orders and exponents.
"""

from bench.cost import Timed, in_turn
from bench.fits import exponent

__all__ = ["Timed", "exponent", "in_turn"]
