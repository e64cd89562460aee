"""A structure made by hand, column by column; superposition, selection and sequences."""

import hashlib
from dataclasses import replace

import numpy as np
import pytest
from fixtures.molecules import ring
from openmm import app

import protochain as pc
from protochain.structure.molecule.member import Member, atom
from protochain.structure.molecule.model import Tie, per_positions
from protochain.structure.molecule.templates import Template
from protochain.structure.preparation.prepare import _bonds, _indices, _refuse_coincident, user_files
from protochain.structure.preparation.sites import Link
from protochain.structure.preparation.structure_draft import Draft, Evidence, Part
from protochain.structure.select import select
from protochain.structure.superpose import ca_rmsd, motion, rmsd, rmsd_angstrom, superpose

S = ring()


def test_columns_are_those_of_the_topology():
    assert (S.n_atoms, S.n_residues, S.n_chains) == (14, 4, 1)
    assert " ".join(S.atom_name) == "N CA C SG N CA C N CA C SG O H1 H2"
    assert "".join(S.atom_element) == "NCCSNCCNCCSOHH"
    assert S.atom_mass[[0, 1, 3, 11, 12]] == pytest.approx([14.007, 12.011, 32.06, 15.999, 1.008], abs=0.01)
    assert S.atom_residue.tolist() == [0] * 4 + [1] * 3 + [2] * 4 + [3] * 3
    assert S.residue_name.tolist() == ["CYS", "GLY", "CYS", "HOH"]
    assert S.residue_number.tolist() == ["1", "2", "3", "4"]
    assert S.residue_insertion_code.tolist() == ["", "", "B", ""]
    assert S.residue_chain.tolist() == ["A", "A", "A", ""] and S.residue_chain_index.tolist() == [0, 0, 0, 1]
    # The smaller index first, also where the topology has it second.
    assert S.bonds.tolist() == [[0, 1], [1, 2], [2, 4], [6, 7], [0, 9], [3, 10], [11, 12], [11, 13]]
    assert S.alpha_carbons.tolist() == [1, 5, 8]
    assert S.describe(7) == "atom N of A:CYS3B"
    assert S.describe_residue(3) == "HOH4"
    for column in (
        S.positions,
        S.atom_mass,
        S.atom_residue,
        S.bonds,
        S.alpha_carbons,
        S.b_factor,
        S.obstacle,
        S.occupancy,
        S.kept,
        S.formal_charge,
    ):
        assert not column.flags.writeable


def calcium():
    topology = app.Topology()
    residue = topology.addResidue("CA", topology.addChain("A"), "1")
    topology.addAtom("CA", app.Element.getBySymbol("Ca"), residue, formalCharge=2)
    return topology


def test_what_is_not_given_is_empty():
    bare = pc.Structure("x", calcium(), np.zeros((1, 3)))
    assert bare.b_factor.tolist() == [0.0] and bare.obstacle.tolist() == [False]
    assert bare.obstacle.dtype == bool and dict(bare.left_out) == {} and bare.repairs == ()
    assert bare.occupancy.tolist() == [1.0] and bare.kept.tolist() == [False]
    assert (bare.residue_label, bare.header, bare.model_number, bare.ties) == ((), "", 1, ())
    assert bare.bonds.shape == (0, 2) and bare.alpha_carbons.tolist() == []
    with pytest.raises(TypeError):
        bare.left_out["x"] = 1


def test_what_springs_hold_is_beside_the_protein():
    """Of the water, the hydrogens are obstacles; the oxygen and a C-alpha are tied, and may move."""
    ties = (Tie((3, 11), 0.2, 1.0), Tie((2, 5), 0.2, 1.0), Tie((2, 3, 11), 2.0, 1.0))
    held = replace(S, obstacle=np.arange(14) >= 12, ties=ties)
    assert np.flatnonzero(held.kept).tolist() == [5, 11, 12, 13] and held.n_chains == 1
    assert np.flatnonzero(held.obstacle).tolist() == [12, 13] and held.alpha_carbons.tolist() == [1, 8]
    assert np.flatnonzero(S.kept).tolist() == [11, 12, 13] and not S.formal_charge.any()
    assert replace(held, ties=()).n_chains == 2
    assert pc.Structure("x", calcium(), np.zeros((1, 3))).formal_charge.tolist() == [2]


def test_positions_have_their_shape_and_are_numbers():
    with pytest.raises(pc.ProtochainError) as refused:
        S.with_positions(np.zeros((13, 3)))
    assert str(refused.value) == "ring: 14 atoms but positions of shape (13, 3)"
    x = S.positions.copy()
    x[9, 2], x[12, 0] = np.inf, np.nan
    with pytest.raises(pc.ProtochainError) as refused:
        S.with_positions(x)
    assert str(refused.value) == "ring: atom C of A:CYS3B: its position is not a number"
    moved = S.with_positions(S.positions + 1.0)
    assert np.array_equal(moved.positions, S.positions + 1.0) and np.array_equal(moved.b_factor, S.b_factor)
    assert moved.topology is S.topology and moved.name == "ring"
    told = replace(S, occupancy=S.b_factor, residue_label=(("A", 1),) * 4, header="data_x", model_number=2)
    told = replace(told, ties=(Tie((3, 11), 0.25, 1.5),))
    moved = told.with_positions(S.positions + 1.0)
    assert np.array_equal(moved.occupancy, S.b_factor)
    for name in ("residue_label", "header", "model_number", "ties"):
        assert getattr(moved, name) == getattr(told, name), name


def test_a_fingerprint_covers_what_determines_an_energy_and_nothing_else():
    seen = hashlib.sha256()
    for column in (
        S.atom_name, S.atom_element, S.atom_residue, S.residue_name, S.residue_chain_index, S.bonds,
        S.obstacle, S.formal_charge,
    ):  # fmt: skip
        seen.update(f"{column.dtype.str}{column.shape}".encode() + column.tobytes())
    ties = (Tie((3, 11), 0.25, 1.5),)
    tied = seen.copy()
    tied.update(b"(Tie(atoms=(3, 11), rest=0.25, stiffness=1.5),)")
    seen.update(b"()")
    assert replace(S, ties=ties).fingerprint == tied.hexdigest()
    told = replace(S, occupancy=S.b_factor, residue_label=(("A", 1),) * 4, header="data_x", model_number=2)
    assert told.fingerprint == S.fingerprint
    assert S.fingerprint == seen.hexdigest() == S.with_positions(S.positions + 1.0).fingerprint
    free = pc.Structure("ring", S.topology, S.positions)
    assert free.fingerprint != S.fingerprint


TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
SQUARE = np.array([[1.0, 0, 0], [0, 2, 0], [-3, 0, 0], [0, 0, 4], [0, -1, 1]])


def test_points_are_superposed_by_a_rotation_and_never_by_a_reflection():
    moved = SQUARE @ TURN.T + [5.0, -6.0, 7.0]
    turn, shift = motion(SQUARE, moved)
    assert np.allclose(turn, TURN, atol=1e-12) and np.allclose(shift, [5.0, -6.0, 7.0], atol=1e-12)
    assert np.allclose(superpose(SQUARE, moved), moved, atol=1e-12) and rmsd(SQUARE, moved) < 1e-12
    turn, _ = motion(SQUARE, SQUARE * [1, 1, -1])
    assert np.linalg.det(turn) == pytest.approx(1.0) and rmsd(SQUARE, SQUARE * [1, 1, -1]) > 0.5


def test_the_rmsd_of_two_points_is_half_the_difference_of_their_distances():
    short, long = np.array([[0.0, 0, 0], [1, 0, 0]]), np.array([[0.0, 0, 0], [0, 3, 0]])
    assert rmsd(short, long) == pytest.approx(1.0) and rmsd_angstrom(short, long) == pytest.approx(10.0)
    x = S.positions.copy()
    x[0] += 5.0
    assert ca_rmsd(S, x, S.positions) == pytest.approx(0.0, abs=1e-6)
    x[S.alpha_carbons] *= 2.0
    expected = rmsd(2.0 * S.positions[S.alpha_carbons], S.positions[S.alpha_carbons])
    assert ca_rmsd(S, x, S.positions) == pytest.approx(10.0 * expected) and expected > 0.01


def test_selected_atoms_are_a_mask():
    assert np.flatnonzero(select(S, "name CA")).tolist() == [1, 5, 8]
    for ranges in ("index 1:3", "index 0:0 5:8 7:9"):  # read here; in brackets by MDAnalysis
        assert np.array_equal(select(S, ranges), select(S, f"({ranges})"))
    mask = select(S, "resid 2 or element H")
    assert mask.dtype == bool and mask.shape == (14,) and np.flatnonzero(mask).tolist() == [4, 5, 6, 12, 13]
    with pytest.raises(pc.ProtochainError) as refused:
        select(S, "name QQ")
    assert str(refused.value) == "ring: selection 'name QQ' selects no atom; change it"
    with pytest.raises(
        pc.ProtochainError, match=r"^ring: selection ' ' selects no atom"
    ):  # without a warning
        select(S, " ")
    with pytest.raises(pc.ProtochainError, match=r"^selection 'nme CA' cannot be read: [^\n]+$"):
        select(S, "nme CA")


@pytest.mark.parametrize(
    ("sequence", "why"),
    [
        (" ", "the sequence is empty; give one-letter codes such as NLYIQWLKDGG"),
        ("A", "sequence: give at least 2 residues; force fields lack free amino acids"),
        ("AAb", "sequence: letter 3 is 'B'; use the 20 codes ACDEFGHIKLMNPQRSTVWY"),
    ],
)
def test_sequences_that_cannot_be_built_are_refused(sequence, why):
    with pytest.raises(pc.ProtochainError) as refused:
        pc.from_sequence(sequence)
    assert str(refused.value) == why
    assert len(pc.from_sequence("AG").residue_name) == 2


def test_bonds_are_of_templates_chains_rings_strands_and_disulfides():
    inner = Template("X", {}, {}, (("N", "C"), ("SG", "N"), ("C", "Q")), {})
    strand = Template("Y", {}, {}, (("P", "O3'"),), {})

    def made(names):
        return Member("X", "1", "", "A", [atom(name, name[0], [0.0] * 3) for name in names])

    a, b, c = (made(("N", "C", "SG")) for _ in range(3))
    d, e = made(("P", "O3'")), made(("P", "O3'"))
    parts = [Part("A", [a, b]), Part("A", [c], cyclic=False), Part("A", [d, e], evidence=Evidence.ELEMENTS)]
    draft = Draft("x", "x", parts)
    draft.states = [(m, strand if m in (d, e) else inner) for m in (a, b, c, d, e)]
    at = _indices(draft)
    assert at[id(a)] == {"N": 0, "C": 1, "SG": 2} and at[id(e)] == {"P": 11, "O3'": 12} and len(at) == 5
    draft.other_links, draft.bridges = [Link(b, b.atoms[1], e, e.atoms[0])], [(c, a)]
    pairs = _bonds(draft, at).tolist()
    assert sorted(pairs) == [
        [0, 1], [0, 2], [1, 3], [2, 8], [3, 4], [3, 5], [4, 11], [6, 7], [6, 8], [9, 10], [10, 11], [11, 12],
    ]  # fmt: skip
    parts[0].cyclic = True
    assert [0, 4] in _bonds(draft, at).tolist() and [0, 4] not in pairs


def test_bonded_atoms_in_one_place_are_named():
    one = Member("GLY", "4", "", "A", [atom(name, "C", [0.0] * 3) for name in ("CA", "C", "O")])
    owners = [(one, name) for name in ("CA", "C", "O")]
    bonds = np.array([[0, 1], [1, 2]])
    for length, refused in ((0.0199, True), (0.0201, False)):
        x = np.array([[0.0, 0, 0], [0.15, 0, 0], [0.15, length, 0]])
        if refused:
            with pytest.raises(pc.ProtochainError) as error:
                _refuse_coincident(Draft("x", "x"), owners, x, bonds)
            assert str(error.value) == "x: A:GLY4: atoms C and O coincide; correct their coordinates"
        else:
            _refuse_coincident(Draft("x", "x"), owners, x, bonds)
    _refuse_coincident(Draft("x", "x"), owners, np.zeros((3, 3)), bonds[:0])


def test_a_force_field_is_a_users_if_it_is_a_file(tmp_path):
    (tmp_path / "own.xml").write_text("")
    (tmp_path / "own,or.xml").write_text("")
    assert user_files(str(tmp_path / "own.xml")) == (tmp_path / "own.xml",)
    assert user_files(f"amber14, {tmp_path}/own.xml,{tmp_path}/no.xml") == (tmp_path / "own.xml",)
    assert user_files(tmp_path / "own,or.xml") == (tmp_path / "own,or.xml",)
    assert user_files("amber14-all") == user_files(None) == user_files(tmp_path) == ()


def test_what_is_found_at_positions_is_kept_for_the_last_two():
    asked = []

    @per_positions
    def first(structure, x):
        asked.append(x[0, 0])
        return float(x[0, 0])

    x, y, z = S.positions, S.positions + 1.0, S.positions + 2.0
    moved = S.with_positions(y)
    assert [first(S, x), first(moved, y), first(S, x.copy()), first(moved, y)] == [x[0, 0], y[0, 0]] * 2
    assert len(asked) == 2
    assert first(S, z) == z[0, 0] and first(S, x) == x[0, 0]
    assert len(asked) == 4
    y[0, 0] = 7.0
    assert first(S, y) == 7.0
