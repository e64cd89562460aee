"""The line that counts the changes of a file."""

from fixtures.samples import STRUCTURES

import protochain as pc
from protochain.structure.molecule.repairs import counts_of_changes


def test_the_charge_of_a_ligand_is_in_the_line():
    s = pc.load(STRUCTURES / "5awl.pdb", ligands=str(STRUCTURES / "1P2Y_NCT.sdf"))
    assert "charge of B:LIG1 +1" in counts_of_changes(s.repairs)
