"""Comparison of methods: tables, and figures drawn from them."""

from protochain.analysis.comparing import compare
from protochain.analysis.comparison import Comparison

__all__ = ["Comparison", "compare"]
