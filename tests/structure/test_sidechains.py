"""Side chains built by hand: ideal geometries, rotamers, the choice among them, and hands."""

from itertools import combinations, product

import gemmi
import numpy as np
import pytest
from fixtures.samples import STRUCTURES, load

import protochain as pc
from protochain.core.arrays import dihedral
from protochain.core.markup import abridge
from protochain.structure.molecule import residues
from protochain.structure.molecule.chirality import (
    centres,
    changed_stereocentres,
    chirality,
    inverted_atoms,
    volume,
)
from protochain.structure.molecule.member import Member, atom
from protochain.structure.molecule.templates import templates
from protochain.structure.preparation.prepare import read
from protochain.structure.sidechains import arms, packing
from protochain.structure.sidechains.arms import wrap_angle
from protochain.structure.sidechains.ideal import (
    Site,
    beta_carbon,
    bridge_gaps,
    build_atoms,
    conformers,
    fixed_chi,
    ideal,
    place_points,
    unit,
)
from protochain.structure.sidechains.packing import Choices, candidate_conformers, pack
from protochain.structure.sidechains.packing_energies import Kinds, rarity, table
from protochain.structure.sidechains.rotamers import rotamers

NAMES = tuple(residues.STANDARD)
ORIGIN = np.zeros(3)


def degrees(*angles):
    return pytest.approx(np.deg2rad(angles), abs=1e-9)


# --- Geometry


def test_dihedrals_are_positive_clockwise_from_the_front():
    a, b, c = np.array([1.0, 0, 0]), ORIGIN, np.array([0, 0, 1.0])
    turns = np.deg2rad([-170.0, -60.0, 0.0, 30.0, 90.0, 150.0])
    d = np.stack([np.cos(turns), np.sin(turns), 1.0 + 0 * turns], axis=1)
    assert dihedral(a, b, c, d) == pytest.approx(turns)
    assert unit(np.array([[0.0, 3.0, 4.0], [0, 0, 0]])).tolist() == [[0, 0.6, 0.8], [0, 0, 0]]


def test_points_are_placed_at_a_distance_an_angle_and_dihedrals():
    random = np.random.default_rng(3)
    a, b, c = random.normal(size=(3, 3))
    turns = np.deg2rad([-120.0, 0.0, 75.0])
    x = place_points(a, b, c, 1.5, np.deg2rad(110.0), turns)
    assert np.linalg.norm(x - c, axis=1) == pytest.approx(1.5)
    assert unit(x - c) @ unit(b - c) == pytest.approx(np.cos(np.deg2rad(110.0)))
    assert dihedral(a, b, c, x) == pytest.approx(turns)


@pytest.mark.parametrize("name", NAMES)
def test_bonds_of_ideal_residues_are_those_of_the_force_field(name):
    known = templates()[{"HIS": "HIE"}.get(name, name)]
    wanted = {frozenset(bond) for bond in known.bonds if not any(known.element[end] == "H" for end in bond)}
    geometry = ideal(name)
    assert {frozenset((a, b)) for a, others in geometry.bonds.items() for b in others} == wanted
    assert set(geometry.x) == set(known.heavy)
    assert all(branch.element == known.element[branch.name] for branch in geometry.branches)
    assert {b.name for b in geometry.branches} == set(known.heavy) - {"N", "CA", "C", "O", "CB"}


@pytest.mark.parametrize("name", NAMES)
def test_branches_and_dihedrals_of_ideal_residues_repeat_their_positions(name):
    geometry = ideal(name)
    for branch in geometry.branches:
        a, b, c = (geometry.x[each] for each in branch.before)
        (x,) = place_points(a, b, c, branch.length, branch.angle, np.array([branch.dihedral]))
        assert x == pytest.approx(geometry.x[branch.name], abs=1e-6)
        assert set(branch.before[1:]) <= geometry.within(branch.name, 2)
    quartets = residues.CHI.get(name, ())
    if name != "PRO":
        assert geometry.chi == pytest.approx(
            [float(dihedral(*(geometry.x[n] for n in quartet))) for quartet in quartets]
        )
    assert name == "GLY" or volume(np.array([geometry.x[n] for n in ("CA", "N", "C", "CB")])) > 2.0
    for centre, beside in centres(name).items():
        if name != "GLY":
            assert volume(np.array([geometry.x[n] for n in (centre, *beside)])) > 2.0


def crystal():
    """Places of the heavy atoms, by name, of the whole residues of three crystals."""
    found = {}
    for file in ("1ubq.pdb", "4pti.pdb", "1hel.pdb"):
        for member in read(STRUCTURES / file).members:
            at = {a.name: np.array(a.pos.tolist()) for a in member.atoms if not a.is_hydrogen()}
            if member.name in NAMES and set(ideal(member.name).x) <= at.keys():
                found.setdefault(member.name, []).append(at)
    return found


def test_ideal_residues_are_like_those_of_crystals():
    """Bonds, distances of atoms two bonds apart, and on which side of two others a third hangs."""
    seen = crystal()
    assert set(seen) == set(NAMES)
    for name, copies in seen.items():
        geometry = ideal(name)
        for first, second in combinations(geometry.x, 2):
            near = [n for n in (1, 2) if second in geometry.within(first, n)]
            if near:
                apart = np.median([np.linalg.norm(at[first] - at[second]) for at in copies])
                wanted = np.linalg.norm(geometry.x[first] - geometry.x[second])
                assert wanted == pytest.approx(apart, abs=(0.05, 0.1)[near[0] - 1]), (name, first, second)
        for centre, beside in geometry.bonds.items():
            if len(beside) == 3:
                atoms = (centre, *beside)
                own = volume(np.array([geometry.x[n] for n in atoms]))
                there = np.median([volume(np.array([at[n] for n in atoms])) for at in copies])
                assert own == pytest.approx(there, abs=0.3), (name, centre)


@pytest.mark.parametrize("name", ["PHE", "TYR"])
def test_both_sides_of_a_ring_are_alike(name):
    x = ideal(name).x
    for a, b in (("CD", "CG"), ("CE", "CG"), ("CE", "CZ"), ("CD", "CZ")):
        one, other = (np.linalg.norm(x[f"{a}{side}"] - x[b]) for side in (1, 2))
        assert one == pytest.approx(other, abs=0.01), (a, b)


def test_atoms_within_some_bonds_are_counted_along_the_bonds():
    serine = ideal("SER")
    assert serine.within("OG", 1) == {"CB"} and serine.within("OG", 2) == {"CB", "CA"}
    assert serine.within("OG", 3) == {"CB", "CA", "N", "C"} and serine.within("OG", 0) == set()


# --- Rotamers


@pytest.mark.parametrize("name", NAMES)
def test_rotamers_have_the_dihedrals_of_their_residue_and_frequencies_of_sum_one(name):
    for backbone in ((), (-65.0, -40.0), (179.0, -179.0)):
        chi, frequency = rotamers(name, *backbone)
        if name in ("ALA", "GLY"):
            assert not len(chi) and not len(frequency)
            continue
        # The fifth chi of arginine is planar, and of proline's ring one chi is enough.
        assert chi.shape == (len(frequency), min(4, len(residues.CHI.get(name, [()]))))
        assert frequency.sum() == pytest.approx(1.0) and frequency.min() > 0.0028
        assert np.all(np.diff(frequency) <= 0.0)
        assert not chi.flags.writeable and not frequency.flags.writeable


def test_rotamers_are_those_of_the_backbone():
    """Known of crystals: valine is t; threonine is m in helices, where O of the turn before binds OG1;
    leucine is mt and then tp in helices, nearly nothing else."""
    for angles in ((-60.0, -40.0), (-120.0, 130.0)):
        chi, frequency = rotamers("VAL", *angles)
        assert np.rad2deg(chi[0, 0]) == pytest.approx(175.0, abs=8.0) and frequency[0] > 0.6
    assert np.rad2deg(rotamers("THR", -60.0, -40.0)[0][0, 0]) == pytest.approx(-62.0, abs=5.0)
    chi, frequency = rotamers("LEU", -60.0, -40.0)
    assert np.rad2deg(chi[:2]) == pytest.approx(np.array([[-69, 173], [-179, 60]]), abs=3.0)
    assert frequency[:2].sum() > 0.95
    # Bins are 10 degrees wide, around their angles, and go round.
    assert rotamers("VAL", -64.9, -44.9)[0] is rotamers("VAL", -55.1, -35.1)[0]
    assert rotamers("VAL", 180.0, -176.0)[0] is rotamers("VAL", -180.0, 184.0)[0]
    assert rotamers("VAL", -60.0, -40.0)[0] is not rotamers("VAL", -60.0, -30.0)[0]


def test_conformers_are_rotamers_puckers_or_the_only_one():
    chi, frequency = conformers("PRO", -65.0, 140.0)
    pucker = np.array(ideal("PRO").chi)
    assert chi.shape == (2, 2) and frequency.sum() == pytest.approx(1.0)
    assert {tuple(row) for row in chi.tolist()} == {tuple(pucker.tolist()), tuple((-pucker).tolist())}
    # In a helix the pucker whose chi1 is negative is the usual one.
    assert conformers("PRO", -60.0, -30.0)[0][0, 0] < 0.0
    for name in ("ALA", "GLY"):
        chi, frequency = conformers(name)
        assert chi.shape == (1, 0) and frequency.tolist() == [1.0]
    assert conformers("LEU")[0] is rotamers("LEU")[0]


# --- Building


def backbone(name):
    return {n: ideal(name).x[n] for n in ("N", "CA", "C", "O")}


@pytest.mark.parametrize("name", [name for name in NAMES if name not in ("GLY", "PRO")])
def test_side_chains_grow_with_the_dihedrals_given(name):
    chi, _ = conformers(name)
    made = build_atoms(name, backbone(name), chi)
    assert set(made) == set(ideal(name).x) - {"N", "CA", "C", "O"}
    at = backbone(name) | made
    for k, quartet in enumerate(residues.CHI.get(name, ())[: chi.shape[1]]):
        off = wrap_angle(dihedral(*(at[n] for n in quartet)) - chi[:, k])
        assert off == pytest.approx(0.0, abs=1e-6)
    for centre, beside in centres(name).items():
        x = [np.broadcast_to(at[n], (len(chi), 3)) for n in (centre, *beside)]
        assert np.all(volume(np.stack(x, axis=1)) > 2.0) or name == "GLY"
    for branch in ideal(name).branches:
        apart = np.linalg.norm(at[branch.name] - at[branch.before[2]], axis=1)
        assert apart == pytest.approx(branch.length, abs=1e-6)
    whole = {n: np.broadcast_to(x, (len(chi), 3))[-1] for n, x in at.items()}
    assert build_atoms(name, whole, chi) == {}
    fixed = fixed_chi(name, whole)
    assert all(wrap_angle(fixed[k] - chi[-1, k]) == pytest.approx(0.0, abs=1e-6) for k in range(chi.shape[1]))


def test_atoms_in_place_decide_their_dihedrals_and_what_hangs_beside_them():
    chi, _ = conformers("LYS")
    one = {n: np.array(x[4]) for n, x in build_atoms("LYS", backbone("LYS"), chi).items()}
    known = backbone("LYS") | {n: one[n] for n in ("CB", "CG", "CD")}
    fixed = fixed_chi("LYS", known)
    assert set(fixed) == {0, 1} and wrap_angle(np.array([fixed[0], fixed[1]]) - chi[4, :2]) == degrees(0, 0)
    assert set(build_atoms("LYS", known, chi)) == {"CE", "NZ"} and fixed_chi("LYS", backbone("LYS")) == {}
    for name, there, gone in (("VAL", "CG2", "CG1"), ("LEU", "CD2", "CD1"), ("ASP", "OD2", "OD1")):
        geometry = ideal(name)
        known = {n: x for n, x in geometry.x.items() if n != gone}
        chi, _ = conformers(name)
        built = build_atoms(name, known, chi)[gone]
        assert there in known and built == pytest.approx(np.tile(geometry.x[gone], (len(chi), 1)), abs=1e-6)
        last = len(geometry.chi) - 1
        assert fixed_chi(name, known)[last] == pytest.approx(geometry.chi[last])


def test_the_beta_carbon_follows_its_backbone_wherever_it_is():
    turn, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    x = {n: turn @ at + [3.0, -2.0, 9.0] for n, at in ideal("LEU").x.items()}
    assert beta_carbon("LEU", x) == pytest.approx(x["CB"], abs=1e-9)
    # A wider angle at CA leaves it on the bisecting plane.
    x["N"] = x["CA"] + 2.0 * (x["N"] - x["CA"])
    assert beta_carbon("LEU", x) == pytest.approx(x["CB"], abs=1e-9)


@pytest.mark.parametrize(
    ("name", "gone", "built"),
    [
        ("SER", ("CB",), ("CB",)), ("LYS", ("CD",), ("CD",)), ("LYS", ("CG", "CD"), ("CG", "CD")),
        ("PHE", ("CG",), ("CG",)), ("TYR", ("CZ",), ("CZ",)), ("ILE", ("CB",), ("CB",)),
        # Nothing beyond them, or only what hangs beside them.
        ("LYS", ("NZ",), ()), ("VAL", ("CG1",), ()), ("LEU", ("CG", "CD1", "CD2"), ()),
        ("LYS", ("CG", "NZ"), ("CG",)),
    ],
)  # fmt: skip
def test_atoms_between_others_are_fitted_to_them(name, gone, built):
    geometry = ideal(name)
    found = bridge_gaps(name, {n: x for n, x in geometry.x.items() if n not in gone})
    assert set(found) == set(built)
    for atom_name, x in found.items():
        limit = 0.02 if len(built) == 1 else 0.6
        assert np.linalg.norm(x - geometry.x[atom_name]) < limit


# --- Choice


def test_angles_are_wrapped_and_disulfides_gain():
    assert wrap_angle(np.array([0.5, 2 * np.pi - 0.1, -4.0, 3 * np.pi])) == pytest.approx(
        [0.5, -0.1, 2 * np.pi - 4.0, -np.pi]
    )
    sulphurs = np.array([2.05, 2.2, 1.9, 4.0])
    wanted = [-40.0, -40.0 * np.exp(-0.5), -40.0 * np.exp(-0.5), 0.0]
    for betas, near in ((3.1, False), (3.3, True), (4.6, True), (4.8, False)):
        found = packing._disulfide(sulphurs, betas)
        assert found == pytest.approx(wanted if near else [0.0] * 4, abs=1e-6)


def made(name, at, number=1, chain="A", is_d=False):
    atoms = [atom(n, n[0], np.asarray(x, dtype=float).tolist()) for n, x in at.items()]
    return Member(name, str(number), "", chain, atoms, is_d=is_d)


def test_atoms_touch_by_their_kinds():
    kinds = Kinds([("LEU", "CD1", ""), ("SER", "OG", ""), ("LYS", "NZ", ""), ("HEM", "FE", "Fe")])
    contact, depth = kinds.pair_parameters(Kinds([("ASP", "OD1", ""), ("PRO", "N", ""), ("ALA", "N", "")]))
    # A hydroxyl gives to the acid and takes from the amide, which proline lacks; the amine gives to the acid.
    assert contact == pytest.approx(np.array(
        [[1.96 + 1.40, 1.96 + 1.70, 1.96 + 1.42], [2.8, 1.43 + 1.70, 2.8], [2.8, 1.69 + 1.70, 1.69 + 1.42],
         [0.6 + 1.40, 0.6 + 1.70, 0.6 + 1.42]]
    ))  # fmt: skip
    assert depth[0] == pytest.approx(np.sqrt(0.48 * np.array([0.07, 0.48, 0.08])))
    # Linear within contact, 12-6 beyond, deepest at the sixth root of two, nothing from 7 angstrom on.
    apart = np.array([0.0, 1.5, 3.0, 3.0 * 2 ** (1 / 6), 4.0, 7.0])
    x = np.zeros((6, 1, 3))
    x[:, 0, 2] = apart
    found = table(x, np.zeros((1, 1, 3)), np.array([[3.0]]), np.array([[0.5]]))[:, 0]
    far = 0.7 * 4 * 0.5 * ((3 / 4) ** 12 - (3 / 4) ** 6)
    assert found == pytest.approx([10.0, 5.0, 0.0, -0.7 * 0.5, far, 0.0])
    assert not table(x, np.zeros((1, 1, 3)), np.array([[0.0]]), np.array([[0.5]])).any()


@pytest.mark.parametrize("name", NAMES)
def test_kinds_are_those_of_hydrogens_bonds_and_rings(name):
    """Of FASPR; only where hydrogens do not decide it does the residue."""
    known = templates()[{"HIS": "HIE"}.get(name, name)]
    ring = name in ("PHE", "TYR", "TRP", "HIS")
    carbons = {0: (1.43, 0.07), 1: (2.30, 0.30), 2: (1.91, 0.37), 3: (1.96, 0.48)}
    usual = {"CA": (1.78, 0.25), "C": (1.40, 0.14), "N": (1.70, 0.48) if name == "PRO" else (1.42, 0.08)}
    usual |= {"O": (1.48, 0.22), "SG": (2.15, 0.44), "SD": (1.74, 0.40)}
    for atom_name in known.heavy:
        symbol, n_hydrogens = known.element[atom_name], len(known.hydrogens.get(atom_name, ()))
        found = Kinds([(name, atom_name, "")])
        if symbol == "C":
            other = (1.73, 0.38) if ring and atom_name != "CB" else carbons[n_hydrogens]
        elif symbol == "N":
            other = (1.69, 0.24)
        else:
            other = (1.43, 0.12) if n_hydrogens else (1.40, 0.07) if name in ("ASP", "GLU") else (1.44, 0.27)
        other = {"CYS CB": (1.99, 0.38), "HIS NE2": (1.56, 0.46)}.get(f"{name} {atom_name}", other)
        assert (found.radius[0], found.depth[0]) == usual.get(atom_name, other), atom_name
        donates = (symbol == "O" and n_hydrogens > 0) or (symbol == "N" and (name, atom_name) != ("PRO", "N"))
        accepts = symbol == "O" or (name, atom_name) == ("HIS", "NE2")
        assert (found.donates[0], found.accepts[0]) == (donates, accepts), atom_name


def test_conformers_unlike_the_atoms_in_place_cost():
    chi, frequency = rotamers("LEU")
    bare_chi, cost = candidate_conformers(Site(made("LEU", backbone("LEU")), 1, None, None))
    n, turn = len(chi), np.deg2rad(9.0)
    turned = np.repeat(chi, 3, axis=0)
    turned[:, 0] += np.tile([0.0, -turn, turn], n)
    strain = np.tile([0.0, 0.5, 0.5], n) * (9.0 / 9.5) ** 2
    rare = 0.7 * 2.0 * np.log(frequency[0] / frequency)
    assert bare_chi == pytest.approx(turned) and cost == pytest.approx(np.repeat(rare, 3) + strain)
    grew = {n: x[1] for n, x in build_atoms("LEU", backbone("LEU"), chi + np.deg2rad(10.0)).items()}
    known = backbone("LEU") | {n: grew[n] for n in ("CB", "CG")}
    _, strained = candidate_conformers(Site(made("LEU", known), 1, None, None))
    off = wrap_angle(bare_chi[:, 0] - chi[1, 0] - np.deg2rad(10.0)) / np.deg2rad(20.0)
    assert strained - cost == pytest.approx(0.5 * off**2, abs=1e-4) and (strained - cost)[3] < 0.13


def test_rotamers_cost_by_how_rare_they_are():
    frequency = np.array([0.8, 0.1, 0.001])
    assert rarity("TRP", frequency) == pytest.approx(0.7 * 3.5 * np.array([0.0, np.log(8.0), 5.0]))
    assert rarity("GLU", frequency)[1] == pytest.approx(0.7 * np.log(8.0))


def test_cysteines_turn_in_steps_of_ten_degrees():
    chi, cost = candidate_conformers(Site(made("CYS", backbone("CYS")), 1, None, None))
    assert chi[:, 0] == degrees(*range(-180, 180, 10))
    rotamer = np.rad2deg(rotamers("CYS")[0][0, 0])
    assert np.rad2deg(chi[np.argmin(cost), 0]) == pytest.approx(rotamer, abs=5.1)


def test_a_site_tells_phi_and_psi_of_the_l_amino_acid():
    members, s = read(STRUCTURES / "1ubq.pdb").members, load("1ubq.pdb")
    found = {}
    for k in (0, 5, 40, 75):
        at = {str(s.atom_name[i]): i for i in np.flatnonzero(s.atom_residue == k)}
        ends = (members[k - 1] if k else None, members[k + 1] if k < 75 else None)
        found[k] = Site(members[k], 1, *ends), Site(members[k], -1, *ends)
        assert found[k][0].backbone == pytest.approx(
            arms.backbone_of(s.neighbours, at, s.positions, 1), abs=0.1
        )
        mirrored = arms.backbone_of(s.neighbours, at, s.positions * [-1, 1, 1], -1)
        assert found[k][0].backbone == pytest.approx(mirrored, abs=0.1)
    before = {k: left.backbone for k, (left, _) in found.items()}
    for atom_of in [a for m in members for a in m.atoms]:
        atom_of.pos = gemmi.Position(-atom_of.pos.x, atom_of.pos.y, atom_of.pos.z)
    assert all(right.backbone == pytest.approx(before[k]) for k, (_, right) in found.items())
    # Where the first begins and the last ends, and of ubiquitin's first helix (23 to 34).
    assert before[0][0] == -60.0 and before[75][1] == 60.0
    helix = Site(members[27], -1, members[26], members[28]).backbone
    assert helix == pytest.approx((-63.0, -42.0), abs=12.0)


def test_what_a_site_knows_is_its_heavy_atoms_in_its_hand():
    one = made("SER", {"N": [1, 2, 3], "H": [4, 5, 6]})
    assert {n: x.tolist() for n, x in Site(one, 1, None, None).heavy_positions.items()} == {"N": [1, 2, 3]}
    assert Site(one, -1, None, None).heavy_positions["N"].tolist() == [-1, -2, -3]


def test_atoms_within_three_bonds_along_the_chain_do_not_repel():
    before, one, after = (made(n, backbone(n), k) for k, n in enumerate(("GLY", "SER", "GLY")))
    own = id(one)
    found = packing._nearby(Site(one, 1, before, after))
    assert found["OG"] == {(own, n) for n in ("OG", "CB", "CA", "N", "C")}
    near = {(own, n) for n in ("CB", "OG", "CA", "N", "C", "O")}
    assert found["CB"] == near | {(id(before), "C"), (id(after), "N")}
    assert packing._nearby(Site(one, 1, None, None))["CB"] == near
    edge = packing._nearby(Site(one, 1, before, after))["C"]
    assert (id(after), "CA") in edge and (id(before), "C") in edge and (id(before), "CA") not in edge
    assert {(id(before), n) for n in ("C", "CA", "O")} <= packing._nearby(Site(one, 1, before, after))["N"]


def test_conformers_feel_others_beyond_three_bonds_and_not_their_own_residue():
    one = made("LYS", {"N": [10.0, 1, 0], "CA": [-9.0, 0, 0]})
    water = made("HOH", {"O": [12.0, 1, 0]}, 2)
    before = made("GLY", {"C": [10.0, 0.1, 0], "CA": [12.0, 0, 0]}, 0)
    x = np.array([[[10.0, 0, 0], [12.0, 0, 0]], [[10.0, -50, 0], [12.0, -50, 0]]])
    felt = packing._Surroundings([one, water, before]).energies(Site(one, 1, before, None), ("CB", "NZ"), x)
    own = Kinds([("LYS", "CB", ""), ("LYS", "NZ", "")])
    contact, depth = own.pair_parameters(Kinds([("HOH", "O", "O"), ("GLY", "CA", ""), ("GLY", "C", "")]))
    # C before is three bonds from CB, and five from NZ.
    contact[0, 2] = 0.0
    others = np.array([[[12.0, 1, 0], [12.0, 0, 0], [10.0, 0.1, 0]]])
    assert felt == pytest.approx(table(x, others, contact, depth)[:, 0]) and felt[0] > 5.0 and felt[1] == 0.0


@pytest.mark.parametrize("seed", range(8))
def test_no_other_choice_costs_less(seed):
    random = np.random.default_rng(seed)
    site = Site(made("SER", backbone("SER")), 1, None, None)
    choices = [
        Choices(
            site, ("CB", "OG"), np.zeros((4, 1)), random.uniform(0, 5, (4, 2, 3)), random.uniform(0, 9, 4)
        )
        for _ in range(5)
    ]
    contact = {("CB", "CB"): 3.82, ("CB", "OG"): 3.34, ("OG", "CB"): 3.34, ("OG", "OG"): 2.8}
    depth = {"CB": 0.37, "OG": 0.12}

    def total(taken):
        cost = sum(each.cost[k] for each, k in zip(choices, taken, strict=True))
        for (one, i), (other, j) in combinations(list(zip(choices, taken, strict=True)), 2):
            for (m, first), (n, second) in product(enumerate(one.names), enumerate(other.names)):
                s = contact[first, second] / np.linalg.norm(one.x[i, m] - other.x[j, n])
                deep = 0.7 * 4 * np.sqrt(depth[first] * depth[second])
                cost += 10.0 * (1.0 - 1.0 / s) if s > 1.0 else deep * (s**12 - s**6)
        return cost

    found = packing._choose_conformers(choices)
    least = min(total(taken) for taken in product(range(4), repeat=5))
    assert found.is_proven and total(found.states) == pytest.approx(least, abs=1e-6)


def test_a_conformer_that_overlaps_is_not_taken():
    alone = made("SER", backbone("SER"))
    site = Site(alone, 1, None, None)
    (free,) = pack([alone], [site]).places
    assert set(free) == {"CB", "OG"} and pack([alone], []).places == []
    water = made("HOH", {"O": free["OG"], "H1": [0, 0, 0]}, 2)
    (moved,) = pack([alone, water], [site]).places
    assert moved["CB"] == pytest.approx(free["CB"]) and np.linalg.norm(moved["OG"] - free["OG"]) > 2.0
    # Its hydrogens alone would not matter.
    water.atoms = [atom("H", "H", free["OG"].tolist())]
    (again,) = pack([alone, water], [site]).places
    assert again["OG"] == pytest.approx(free["OG"])
    mirrored = made("SER", {n: -x for n, x in backbone("SER").items()})
    (d,) = pack([mirrored], [Site(mirrored, -1, None, None)]).places
    assert all(d[n] == pytest.approx(-free[n]) for n in free)


def test_rotation_adds_to_a_dihedral():
    a, start, end = np.array([1.0, 0, 0]), ORIGIN, np.array([0, 0, 1.0])
    x = np.array([[[0.5, 0.5, 2.0]], [[0.5, 0.5, 2.0]]])
    turned = arms.rotate(x, start, end, np.deg2rad([90.0, -45.0]))
    assert np.rad2deg(dihedral(a, start, end, turned[:, 0])) == pytest.approx([135.0, 0.0], abs=1e-9)
    assert turned[0, 0] == pytest.approx([-0.5, 0.5, 2.0])


# --- ChiralityRestraint


L_ALANINE = {"CA": ORIGIN, "N": [1.0, 0, 0], "C": [0, 1.0, 0], "CB": [0, 0, 1.0]}


def mirrored(at):
    return {n: [x, y, -z] for n, (x, y, z) in at.items()}


def test_hands_are_signs_of_volumes():
    x = np.array(list(L_ALANINE.values()))
    assert volume(x) == 1.0 and volume(np.stack([x, x[[0, 2, 1, 3]], 2 * x + 7])).tolist() == [1, -1, 8]
    assert chirality(made("ALA", L_ALANINE)) == 1 and chirality(made("ALA", mirrored(L_ALANINE))) == -1
    assert chirality(made("GLY", {n: L_ALANINE[n] for n in ("CA", "N", "C")})) == 0
    threonine = L_ALANINE | {"OG1": [0, 1, 2], "CG2": [1, 0, 2]}
    assert chirality(made("THR", threonine), "CB") == int(
        np.sign(np.linalg.det(np.array([[0, 0, -1.0], [0, 1, 1], [1, 0, 1]])))
    )
    assert chirality(made("SER", threonine), "CB") == 0
    assert set(centres("THR")) == set(centres("ILE")) == {"CA", "CB"} and set(centres("VAL")) == {"CA"}


def test_wrong_hands_are_those_that_a_name_does_not_say():
    left, right = made("ALA", L_ALANINE, 1), made("ALA", mirrored(L_ALANINE), 2)
    d_left, d_right = made("ALA", L_ALANINE, 3, is_d=True), made("ALA", mirrored(L_ALANINE), 4, is_d=True)
    glycine = made("GLY", {"CA": [0, 0, 0]}, 5)
    assert [str(atom) for atom in inverted_atoms([left, right, d_left, d_right, glycine])] == [
        "CA of A:ALA2", "CA of A:DAL3",
    ]  # fmt: skip
    assert abridge([]) == "" and abridge(list("abcdef")) == "a, b, c, d, e, f"
    assert abridge(list("abcdefgh")) == "a, b, c, d, e, f and 2 more"


def test_changed_hands_are_found_atom_by_atom():
    s = load("1ubq.pdb")
    at = {
        (str(s.residue_number[r]), str(n)): i
        for i, (r, n) in enumerate(zip(s.atom_residue, s.atom_name, strict=True))
    }
    x = s.positions.copy()
    for first, second in ((("9", "OG1"), ("9", "CG2")), (("17", "HA"), ("17", "CB"))):
        x[[at[first], at[second]]] = x[[at[second], at[first]]]
    assert changed_stereocentres(s, x, s.positions) == [
        "CB of A:THR9", "CA of A:VAL17",
    ]  # fmt: skip
    assert changed_stereocentres(s, s.positions, s.positions) == [] and changed_stereocentres(s, x, x) == []
    assert len(changed_stereocentres(s, s.positions * [1, 1, -1], s.positions)) == (76 - 6) + 7 + 7
    glycine = pc.from_sequence("GG")
    assert changed_stereocentres(glycine, -glycine.positions, glycine.positions) == []
