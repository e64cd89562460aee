"""One loop for all minimisers: directions combined with step rules. OpenMM's minimiser is the reference."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
