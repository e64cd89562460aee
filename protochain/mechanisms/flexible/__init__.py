"""Bodies that bend: rows of rigid sections, moved by shapes in a floating frame."""

from protochain.mechanisms.flexible.dynamics import canonical_rates
from protochain.mechanisms.flexible.flexible import Flexible, Shapes

__all__ = ["Flexible", "Shapes", "canonical_rates"]
