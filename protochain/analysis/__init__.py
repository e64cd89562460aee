"""Comparison of methods: numbers first, pictures from the numbers."""

from protochain.analysis.comparison import Comparison, compare

__all__ = ["Comparison", "compare"]
