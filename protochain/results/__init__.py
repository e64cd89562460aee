"""What results are told by: columns and records, provenance, tables, figures, pages and the viewer.

It knows structures, whose looks it shows, and nothing of how a result was made.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
