"""The chemistry of ligands bonded to the protein in the files written: read again, the same energy."""

import numpy as np
import pytest
from fixtures.samples import ROOT

import protochain as pc

pytest.importorskip("rdkit.Chem")
CASES = ROOT.parent / "shared" / "cases" / "chemistry5"
SOTORASIB = "C=CC(=O)N1CCN([C@@H](C)C1)c1nc(=O)n(-c2c(C)ccnc2C(C)C)c2nc(-c3c(O)cccc3F)c(F)cc12"


@pytest.mark.skipif(not CASES.exists(), reason="needs ../shared")
@pytest.mark.parametrize("suffix", [".cif", ".pdb"])
def test_a_bonded_ligand_read_again_is_the_same_molecule(tmp_path, suffix):
    before = pc.load(CASES / "cov_Z9Q.cif", keep="all", ligands={"Z9Q": SOTORASIB})
    path = tmp_path / f"out{suffix}"
    pc.save(before, path)
    after = pc.load(path, keep="all")
    assert after.n_atoms == before.n_atoms
    # PDB rounds positions, and may have other atoms first: the energies are of the same positions.
    key = {
        (int(r), str(name)): k
        for k, (r, name) in enumerate(zip(after.atom_residue, after.atom_name, strict=True))
    }
    at = [key[int(r), str(name)] for r, name in zip(before.atom_residue, before.atom_name, strict=True)]
    x = np.empty_like(before.positions)
    x[at] = before.positions
    energies = [pc.energy(s)(y)[0] for s, y in ((before, before.positions), (after, x))]
    assert energies[1] == pytest.approx(energies[0], abs=1e-6)
