"""Comparison of methods: numbers first, pictures from the numbers."""

from protochain.analysis.comparing import compare
from protochain.analysis.comparison import Comparison

__all__ = ["Comparison", "compare"]
