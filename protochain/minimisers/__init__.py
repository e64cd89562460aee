"""One loop for all minimisers; directions times step rules; OpenMM's minimiser as the reference."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
