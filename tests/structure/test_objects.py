"""Objects of other libraries, made by hand: every attribute that is taken from them or given to them."""

from types import SimpleNamespace

import numpy as np
import pytest
from fixtures.molecules import ring

import protochain as pc
from protochain.structure.convert import to_mdanalysis
from protochain.structure.formats import foreign

S = ring()


def table(made):
    """Atoms of a gemmi structure of one model."""
    assert len(made) == 1 and made[0].num == 1
    return [
        (
            chain.name, residue.name, str(residue.seqid).strip(), a.name, a.element.name, a.occ,
            None if np.isnan(a.b_iso) else a.b_iso,
            *np.round(a.pos.tolist(), 4).tolist(),
        )
        for chain in made[0]
        for residue in chain
        for a in residue
    ]  # fmt: skip


def test_every_column_goes_to_mdanalysis():
    atoms = to_mdanalysis(S).atoms
    size = (4, 3, 4, 3)
    chains, codes = np.repeat(["A", "A", "A", ""], size), np.repeat(["", "", "B", ""], size)
    for name, values in (
        ("names", S.atom_name), ("elements", S.atom_element), ("masses", S.atom_mass), ("icodes", codes),
        ("chainIDs", chains), ("segids", chains), ("resids", np.repeat([1, 2, 3, 4], size)),
        ("resnames", np.repeat(["CYS", "GLY", "CYS", "HOH"], size)), ("tempfactors", S.b_factor),
    ):  # fmt: skip
        assert list(getattr(atoms, name)) == list(values), name
    assert sorted(atoms.bonds.indices.tolist()) == sorted(S.bonds.tolist())
    assert np.allclose(atoms.positions, 10.0 * S.positions, atol=1e-5)
    assert len(atoms.residues) == 4 and len(atoms.segments) == 2


class Group(list):
    """Atoms as MDAnalysis holds them, without most attributes."""

    def __init__(self, atoms, residues, **more):
        super().__init__(atoms)
        self.residues, self.resindices = residues, np.array([a.resindex for a in atoms])
        vars(self).update(more)

    def __getitem__(self, key):
        if isinstance(key, int):
            return super().__getitem__(key)
        return [a for a, chosen in zip(self, key, strict=True) if chosen]


def simple(name, resindex, **more):
    return SimpleNamespace(name=name, resindex=resindex, position=np.array([1.0, 2.0, 3.0]), **more)


def test_what_mdanalysis_does_not_know_is_read_from_names():
    residues = [
        SimpleNamespace(resname="ALA", resid=k + 5, resindex=k, segid="S", icode=" C ") for k in (0, 1)
    ]
    atoms = [simple("CA", 0), simple("1HB", 0), simple("OXT", 1)]
    group = Group(atoms, residues)
    at = (1.0, None, 1.0, 2.0, 3.0)
    assert table(foreign._from_mdanalysis(group)) == [
        ("S", "ALA", "5", "CA", "C", *at), ("S", "ALA", "5", "1HB", "H", *at),
        ("S", "ALA", "6", "OXT", "O", *at),
    ]  # fmt: skip
    more = {"chainID": "B", "element": "N", "tempfactor": 4.0}
    atoms = [simple("CA", 0, **more), simple("CB", 1, **more | {"chainID": "", "element": ""})]
    group = Group(atoms, residues, chainIDs=1, elements=1, tempfactors=1, icodes=1)
    at = (1.0, 4.0, 1.0, 2.0, 3.0)
    assert table(foreign._from_mdanalysis(group)) == [
        ("B", "ALA", "5C", "CA", "N", *at), ("S", "ALA", "6C", "CB", "C", *at),
    ]  # fmt: skip


@pytest.mark.parametrize(
    "wrong", [(S.topology,), (1, 2), SimpleNamespace(xyz=1), SimpleNamespace(atoms=1), 7, [*range(99)]]
)
def test_other_objects_are_refused(wrong):
    with pytest.raises(pc.ProtochainError, match=r"^[^\n]{1,80}: give a file, a Structure,[^\n]*$"):
        pc.as_structure(wrong)
