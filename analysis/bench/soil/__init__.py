"""Piles of boxes and their soil, in which the scenes ``bucket`` and ``backhoe`` dig."""
