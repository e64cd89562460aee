"""Objects of other libraries, made by hand: every attribute that is taken from them or given to them."""

from types import SimpleNamespace

import mdtraj
import numpy as np
import pytest
from fixtures.molecules import ring
from openmm import app, unit

import protochain as pc
from protochain.structure import convert, foreign
from protochain.structure.convert import to_mdanalysis, to_mdtraj

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


def expected(b_factor=False):
    """The atoms of the ring."""
    number = [f"{n}{c}" for n, c in zip(S.residue_number, S.residue_insertion_code, strict=True)]
    return [
        (
            str(S.residue_chain[r]) or " ", str(S.residue_name[r]), number[r], str(S.atom_name[k]),
            str(S.atom_element[k]), 1.0, float(S.b_factor[k]) if b_factor else 0.0,
            *np.round(10.0 * S.positions[k], 4).tolist(),
        )
        for k, r in enumerate(S.atom_residue)
    ]  # fmt: skip


def test_a_topology_with_positions_of_any_unit_is_taken():
    for positions in (S.positions, S.positions.tolist(), 10.0 * S.positions * unit.angstrom):
        assert table(foreign.as_gemmi((S.topology, positions))) == expected()
    assert table(foreign.as_gemmi([S.topology, S.positions.ravel()])) == expected()
    topology = app.Topology()
    residue = topology.addResidue("HOH", topology.addChain("W"), "7")
    topology.addAtom("M", None, residue)
    assert table(foreign.as_gemmi((topology, [[0.1, 0.2, 0.3]]))) == [
        ("W", "HOH", "7", "M", "X", 1.0, 0.0, 1.0, 2.0, 3.0)
    ]
    with pytest.raises(pc.ProtochainError) as refused:
        foreign.as_gemmi((S.topology, S.positions[:13]))
    assert str(refused.value) == "13 positions do not fit a topology of 14 atoms"


def test_the_first_frame_of_a_trajectory_is_taken():
    held = to_mdtraj(S, np.array([S.positions, S.positions + 9.0]))
    # mdtraj knows neither insertion codes nor blank chains.
    found = [row[1:2] + row[3:] for row in table(foreign.as_gemmi(held))]
    assert found == [row[1:2] + row[3:] for row in expected()]
    assert held.xyz.dtype == np.float32 and np.allclose(held.xyz[1], S.positions + 9.0, atol=1e-6)
    one = to_mdtraj(S)
    assert isinstance(one, mdtraj.Trajectory) and np.allclose(one.xyz, [S.positions], atol=1e-6)
    assert [a.name for a in one.topology.atoms] == S.atom_name.tolist() and one.topology.n_bonds == 8


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


def test_every_column_comes_from_mdanalysis():
    universe = to_mdanalysis(S)
    assert table(foreign.as_gemmi(universe)) == expected(b_factor=True)
    # A group in another order: residues in the order of the universe, of them only the atoms of the group.
    part = foreign.as_gemmi(universe.select_atoms("resid 3:4 and not name C SG H1"))
    assert table(part) == [
        row for row in expected(b_factor=True) if row[2] in ("3B", "4") and row[3] not in ("C", "SG", "H1")
    ]


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


def test_what_is_handed_in_is_not_changed():
    held = foreign.as_gemmi((S.topology, S.positions))
    again = foreign.as_gemmi(held)
    assert again is not held and table(again) == table(held)


@pytest.fixture
def calls(monkeypatch):
    """What is read and prepared."""
    seen = {}

    def read(made, draft, reading):
        seen.update(made=made, draft=draft, reading=reading)
        return draft

    def prepare(draft, disulfide, ph, forcefield):
        seen.update(prepared=(draft, disulfide, ph, forcefield))
        return S

    monkeypatch.setattr(convert, "read_structure", read)
    monkeypatch.setattr(convert, "prepare", prepare)
    return seen


def test_settings_are_divided_between_reading_and_preparation(calls, tmp_path):
    own = tmp_path / "own.xml"
    own.write_text("")
    held = S.topology, S.positions
    settings = {"keep": ["water"], "altloc": "B", "model": 3, "strict": True}
    assert pc.as_structure(held, "held", **settings, forcefield=own, ph=5.0, disulfide=[("A:1", "A:3B")]) is S
    reading = calls["reading"]
    assert (reading.keep, reading.altloc, reading.model, reading.strict) == (("water",), "B", 3, True)
    assert reading.forcefield == (own,) and (calls["draft"].name, calls["draft"].source) == ("held", "held")
    assert calls["prepared"] == (calls["draft"], [("A:1", "A:3B")], 5.0, (own,))
    pc.as_structure(held)
    assert calls["prepared"] == (calls["draft"], None, 7.0, ()) and calls["draft"].name == "structure"
    assert (calls["reading"].keep, calls["reading"].forcefield) == (("near",), ())
    for ph in (15.0, -1.0, float("nan")):
        with pytest.raises(pc.ProtochainError, match=f"pH {ph:g}: give a number from 0 to 14"):
            pc.Setup(ph=ph)
    for wrong, why in (({"ph": 15.0}, "pH 15"), ({"ph": -1.0}, "pH -1")):
        with pytest.raises(pc.ProtochainError, match=why):
            pc.as_structure(held, **wrong)


def test_parts_of_a_chain_are_joined_and_positions_checked(calls):
    topology = app.Topology()
    for k, name in enumerate("ABA"):
        residue = topology.addResidue("GLY", topology.addChain(name), str(k + 1))
        topology.addAtom("CA", app.Element.getBySymbol("C"), residue)
    pc.as_structure((topology, np.zeros((3, 3))))
    assert [(chain.name, len(chain)) for chain in calls["made"][0]] == [("A", 2), ("B", 1)]
    with pytest.raises(pc.ProtochainError, match=r"^name: the position of atom CA of residue 1 GLY"):
        pc.as_structure((topology, np.full((3, 3), 1e6)), "name")


def test_a_file_is_loaded_with_its_settings(monkeypatch, tmp_path):
    monkeypatch.setattr(convert, "load", lambda path, **settings: (path, settings))
    assert pc.as_structure("x.pdb", model=2) == ("x.pdb", {"model": 2})
    assert pc.as_structure(tmp_path, "unused") == (tmp_path, {})
    assert pc.as_structure(S, model=9) is S


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ((S.topology,), "(<Topology; 2 chains, 4 residues, 14 atoms, 8 bonds>,)"),
        ((1, 2), "(1, 2)"),
        (SimpleNamespace(xyz=1), "namespace(xyz=1)"),
        (SimpleNamespace(atoms=1), "namespace(atoms=1)"),
        (7, "7"),
        (list(range(99)), "of type list"),
    ],
)
def test_other_objects_are_refused(wrong, said):
    with pytest.raises(pc.ProtochainError) as refused:
        pc.as_structure(wrong)
    assert str(refused.value) == (
        f"{said}: give a file, a Structure, a gemmi Structure, an mdtraj Trajectory, an "
        "MDAnalysis Universe or AtomGroup, or an OpenMM Topology with its positions"
    )
