"""C-alpha traces, for measurements of files without other atoms."""

import gemmi
import numpy as np
from openmm import app

from protochain.core.errors import StructureError
from protochain.core.units import ANGSTROM_PER_NM
from protochain.structure.molecule import residues
from protochain.structure.molecule.model import Structure
from protochain.structure.preparation.model_choice import group_alternates, pick_altloc
from protochain.structure.preparation.read import standard_parent


def alpha_trace(parsed: gemmi.Structure, source: str, model: int) -> Structure:
    """Return the C-alpha atoms of the amino acids of a model as a structure."""
    topology, x = app.Topology(), list[list[float]]()
    carbon = app.Element.getBySymbol("C")
    for chain in next(m for m in parsed if m.num == model):
        added_chain = topology.addChain(chain.name.strip())
        for group in group_alternates(chain):
            residue = pick_altloc(group, "").residue
            name = standard_parent(residue.name.strip().upper())
            atom = residue.find_atom("CA", "*")
            if name in residues.STANDARD and atom:
                code = residue.seqid.icode.strip()
                place = topology.addResidue(name, added_chain, str(residue.seqid.num), code)
                topology.addAtom("CA", carbon, place)
                x.append([coordinate / ANGSTROM_PER_NM for coordinate in atom.pos.tolist()])
    if not x:
        raise StructureError(f"{source}: no C-alpha atom found; give a file with amino acids")
    return Structure(source, topology, np.array(x))
