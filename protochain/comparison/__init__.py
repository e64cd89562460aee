"""Comparison of methods: tables, and figures drawn from them."""

from protochain.comparison.comparing import compare
from protochain.comparison.comparison import Comparison

__all__ = ["Comparison", "compare"]
