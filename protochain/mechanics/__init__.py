"""Mechanics of trees of bodies, of any kind and in any units: multibody, and motion in time."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
