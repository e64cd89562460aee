"""A file or a sequence -> Structure, and back to a file."""

from protochain.structure.build import from_sequence
from protochain.structure.model import Structure
from protochain.structure.prepare import load
from protochain.structure.superpose import ca_rmsd
from protochain.structure.write import save

__all__ = ["Structure", "ca_rmsd", "from_sequence", "load", "save"]
