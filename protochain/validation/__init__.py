"""Validation: what is wrong with a structure, by itself."""

from protochain.validation.api import MEASURES, measures

__all__ = ["MEASURES", "measures"]
