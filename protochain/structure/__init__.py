"""Read, build, prepare, convert and write protein structures."""

from protochain.structure.build import from_sequence
from protochain.structure.convert import as_structure, to_mdanalysis, to_mdtraj
from protochain.structure.ligand_files import save_ligands
from protochain.structure.molecule.model import Structure
from protochain.structure.preparation.prepare import load
from protochain.structure.superpose import ca_rmsd
from protochain.structure.write import save

__all__ = [
    "Structure",
    "as_structure",
    "ca_rmsd",
    "from_sequence",
    "load",
    "save",
    "save_ligands",
    "to_mdanalysis",
    "to_mdtraj",
]
