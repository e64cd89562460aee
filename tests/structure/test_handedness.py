"""Rebuilt side chains: of the right hand, on rotamers, without overlaps; and hands that a run changed."""

from collections import Counter

import gemmi
import numpy as np
import pytest
from fixtures.repairs import sentences
from fixtures.samples import MORE_STRUCTURES, STRUCTURES, load, shared

import protochain as pc
from protochain.chains.contacts import near_pairs
from protochain.minimisers.loop import Stop
from protochain.minimisers.verdict import Status, verdict
from protochain.structure.molecule import residues
from protochain.structure.molecule.residues import D_NAMES
from protochain.structure.preparation.prepare import prepare, read

BACKBONE = ("N", "CA", "C", "O", "OXT")
OVERLAP, CHI = 0.6, 40.0
SHARED = sorted(path.name for path in MORE_STRUCTURES.glob("*.[pc][di][bf]"))
REFUSED = ("ubiquitin_ca_only.pdb",)
CRYSTALS = ("1ubq.pdb", "4pti.pdb", "1hel.pdb", "3i40.pdb")
MORE_CRYSTALS = (
    "1ake_A.pdb", "1us0_altlocs.pdb", "4cup_missing.cif", "1orc_icode.pdb", "1fas_fasciculin.cif",
)  # fmt: skip


def places(residue):
    """Positions (angstrom) of the heavy atoms of a residue, by name."""
    return {a.name: np.array(a.pos.tolist()) for a in residue.atoms if not a.is_hydrogen()}


def cut(draft, chosen, keep=BACKBONE):
    """Remove side chains of the residues chosen by their number in the row; return what they were."""
    members = [m for part in draft.parts if not part.obstacle for m in part.members]
    before = {}
    for k, member in enumerate(m for m in members if m.name in residues.STANDARD and m.name != "GLY"):
        if chosen(k):
            was = before[id(member)] = places(member)
            near = {
                id(a): min(was, key=lambda n: np.linalg.norm(was[n] - a.pos.tolist())) for a in member.atoms
            }
            member.atoms = [a for a in member.atoms if near[id(a)] in keep]
    return before


def rebuilt(path, chosen, keep=BACKBONE):
    """The prepared structure, and for each residue that was cut its name, and its atoms before and now."""
    draft = read(path)
    before = cut(draft, chosen, keep)
    structure = prepare(draft)
    now = [{} for _ in draft.members]
    for atom, residue in enumerate(structure.atom_residue):
        now[residue][structure.atom_name[atom]] = 10 * structure.positions[atom]
    whole = [(m, before[id(m)], now[r]) for r, m in enumerate(draft.members) if id(m) in before]
    return structure, whole


def spin(at, centre, neighbours):
    """Sign of the determinant of three bonds, by the textbook; None where atoms are missing."""
    if not {centre, *neighbours} <= at.keys():
        return None
    return np.sign(np.linalg.det([at[name] - at[centre] for name in neighbours]))


def spins(name, at):
    beta = {"THR": ("CA", "OG1", "CG2"), "ILE": ("CA", "CG1", "CG2")}.get(name)
    return spin(at, "CA", ("N", "C", "CB")), spin(at, "CB", beta) if beta else None


def changed(whole):
    """Residues whose CA, or CB of THR and ILE, is of another hand than in the file."""
    return [
        str(member)
        for member, was, now in whole
        if any(
            a is not None and a != b
            for a, b in zip(spins(member.name, was), spins(member.name, now), strict=True)
        )
    ]


def turn(a, b, c, d):
    u, v, w = b - a, c - b, d - c
    return np.degrees(np.arctan2(np.linalg.norm(v) * u @ np.cross(v, w), np.cross(u, v) @ np.cross(v, w)))


def recovered(whole):
    """For every rebuilt residue with a chi1: whether that of the file was found again."""
    found = []
    for member, was, now in whole:
        quartet = residues.CHI.get(member.name, [()])[0]
        if quartet and set(quartet) <= was.keys():
            off = turn(*(was[n] for n in quartet)) - turn(*(now[n] for n in quartet))
            found.append(abs((off + 180.0) % 360.0 - 180.0) < CHI)
    return found


def crowded(structure, whole):
    """Overlaps of atoms that were built with any others."""
    pairs, _ = near_pairs(structure, structure.positions, OVERLAP)
    made = {str(member) for member, _, _ in whole}
    built = [
        structure.describe_residue(r) in made and name not in (*BACKBONE, "H", "HA", "H1", "H2", "H3")
        for r, name in zip(structure.atom_residue, structure.atom_name, strict=True)
    ]
    return [
        tuple(structure.describe(k) for k in pair) for pair in pairs.tolist() if any(built[k] for k in pair)
    ]


@pytest.mark.parametrize(("name", "keep"), [("1ubq.pdb", BACKBONE), ("1l2y.pdb", (*BACKBONE, "CB"))])
def test_side_chains_cut_from_a_file_come_back_with_the_hand_they_had(name, keep):
    structure, whole = rebuilt(STRUCTURES / name, lambda k: k % 3 == 0, keep)
    assert len(whole) > 5 and not changed(whole) and not crowded(structure, whole)
    assert {member.name for member, _, _ in whole} & {"THR", "ILE"}


def test_random_atoms_cut_from_a_file_come_back_with_the_hand_it_had():
    random = np.random.default_rng(7)
    for _ in range(2):
        some = random.random(200) < 0.3
        keep = (*BACKBONE, *random.choice(["CB", "CG", "CG1", "CG2", "OG1", "CD", "CD1"], 4))
        _, whole = rebuilt(STRUCTURES / "1ubq.pdb", lambda k, some=some: some[k], keep)
        assert whole and not changed(whole)
        for _, was, now in whole:
            stayed = [name for name in was if name in keep]
            assert all(now[name] == pytest.approx(was[name], abs=1e-9) for name in stayed)


def test_all_side_chains_of_a_crystal_are_found_again_without_overlaps():
    structure, whole = rebuilt(STRUCTURES / "4pti.pdb", lambda k: True)
    assert not changed(whole) and not crowded(structure, whole)
    assert np.mean(recovered(whole)) > 0.7
    assert sum(structure.atom_name[a] == structure.atom_name[b] == "SG" for a, b in structure.bonds) == 3


@pytest.fixture(scope="module")
def mirrored(tmp_path_factory):
    """Crambin in the mirror, its residues under the names of D-amino acids."""
    file = gemmi.read_structure(str(STRUCTURES / "1ejg.pdb"))
    file.remove_alternative_conformations()
    for chain in file[0]:
        for residue in chain:
            residue.name = D_NAMES.get(residue.name, residue.name)
            for atom in residue:
                atom.pos = gemmi.Position(*(-np.array(atom.pos.tolist())).tolist())
    path = tmp_path_factory.mktemp("mirror") / "mirrored.pdb"
    file.write_pdb(str(path))
    return path


def test_side_chains_of_d_amino_acids_come_back_as_d(mirrored):
    _, whole = rebuilt(mirrored, lambda k: True)
    assert len(whole) > 40 and not changed(whole)
    assert all(spins(member.name, now)[0] == -1 for member, _, now in whole)
    # In a mirror the same choices are made.
    as_l = rebuilt(STRUCTURES / "1ejg.pdb", lambda k: True)[1]
    assert np.mean(recovered(whole)) > 0.6 and Counter(recovered(whole)) == Counter(recovered(as_l))


def test_d_amino_acids_under_names_of_l_are_known_by_the_rest_of_their_chain():
    """Gramicidin A: every second residue is D, under the name of L, and has a positive phi."""
    structure, whole = rebuilt(shared("1grm_gramicidin.pdb"), lambda k: k % 3 == 0)
    assert not changed(whole)
    said = [line for line in sentences(structure) if "built as a D-amino acid" in line]
    d = [str(member) for member, was, _ in whole if spins(member.name, was)[0] == -1]
    assert len(d) == len(said) == 4 and all(any(name in line for line in said) for name in d)


def inverted(draft, number, centre, first, second):
    """Exchange two neighbours of an atom, which changes its hand."""
    (member,) = [m for m in draft.members if m.seqid == str(number)]
    at = places(member)
    for name, other in ((first, second), (second, first)):
        way = at[other] - at[centre]
        x = at[centre] + way * np.linalg.norm(at[name] - at[centre]) / np.linalg.norm(way)
        member.atom(name).pos = gemmi.Position(*x.tolist())
    return member


def test_a_wrong_hand_of_the_file_is_kept_and_said_in_one_line():
    draft = read(STRUCTURES / "1ubq.pdb")
    inverted(draft, 9, "CB", "OG1", "CG2")
    was = places(inverted(draft, 36, "CB", "CG1", "CG2"))
    lines = [line for line in sentences(prepare(draft)) if "inverted" in line]
    assert lines == ["inverted stereocentres in the file: CB of A:THR9, CB of A:ILE36"]
    assert was["CG1"].tolist() == draft.members[35].atom("CG1").pos.tolist()
    assert not any("inverted" in line for line in sentences(load("1ubq.pdb")))


def test_a_side_chain_goes_on_from_the_atoms_of_the_file_even_if_these_are_of_the_wrong_hand():
    draft = read(STRUCTURES / "1ubq.pdb")
    lysine = next(m for m in draft.members if m.name == "LYS")
    at = places(lysine)
    normal = np.cross(at["N"] - at["CA"], at["C"] - at["CA"])
    normal /= np.linalg.norm(normal)
    mirror = at["CB"] - 2 * ((at["CB"] - at["CA"]) @ normal) * normal
    lysine.atoms = [a for a in lysine.atoms if a.name in (*BACKBONE, "CB")]
    lysine.atom("CB").pos = gemmi.Position(*mirror.tolist())
    structure = prepare(draft)
    assert any("in the file: CA of A:LYS6" in line for line in sentences(structure))
    assert spins("LYS", places(lysine))[0] == -1 and "NZ" in places(lysine)
    assert places(lysine)["CB"] == pytest.approx(mirror)


@pytest.mark.parametrize("name", ["CB", "CG", "CE1", "O", "CD", "SG"])
def test_a_single_missing_atom_comes_back_near_its_place(name):
    """The atoms beyond it are there and fix it; the last of a branch follows from those beside it."""
    draft = read(STRUCTURES / "1ubq.pdb" if name != "SG" else STRUCTURES / "4pti.pdb")
    lacking = [m for m in draft.members[:-1] if m.atom(name)]
    was = [places(m)[name] for m in lacking]
    beyond = [len(places(m)) for m in lacking]
    for member in lacking:
        member.atoms = [a for a in member.atoms if a.name != name]
    structure = prepare(draft)
    off = [np.linalg.norm(places(m)[name] - x) for m, x in zip(lacking, was, strict=True)]
    assert lacking and [len(places(m)) for m in lacking] == beyond
    assert np.median(off) < (0.3 if name not in ("CD", "SG") else 0.6)
    assert structure.n_residues == len(draft.members)


def test_prolines_ring_is_closed_and_a_last_oxygen_finds_room():
    draft = read(STRUCTURES / "1l2y.pdb")
    cut(draft, lambda k: True)
    last = draft.members[-1]
    last.atoms = [a for a in last.atoms if a.name not in ("O", "OXT")]
    structure = prepare(draft)
    for member in draft.members:
        if member.name == "PRO":
            at = places(member)
            assert np.linalg.norm(at["CD"] - at["N"]) == pytest.approx(1.48, abs=0.05)
    at = places(last)
    assert np.linalg.norm(at["O"] - at["OXT"]) == pytest.approx(2.2, abs=0.1)
    assert not near_pairs(structure, structure.positions, OVERLAP)[0].size


def test_hydrogens_where_a_side_chain_was_cut_give_way_to_it():
    """A file cut at CB may hold HB1, HB2 and HB3, as of alanine: one is where CG goes."""
    draft = read(STRUCTURES / "1l2y.pdb")
    leucine = next(m for m in draft.members if m.name == "LEU")
    at = {a.name: a for a in leucine.atoms}
    gone = at["CG"].clone()
    gone.name, gone.element = "HB1", gemmi.Element("H")
    way = np.array(gone.pos.tolist()) - at["CB"].pos.tolist()
    gone.pos = gemmi.Position(*(np.array(at["CB"].pos.tolist()) + 1.09 * way / np.linalg.norm(way)).tolist())
    kept = (*BACKBONE, "CB", "H", "HA", "HB2", "HB3")
    leucine.atoms = [a for a in leucine.atoms if a.name in kept] + [gone]
    structure = prepare(draft)
    assert not crowded(structure, [(leucine, {}, {})])
    assert structure.n_atoms == load("1l2y.pdb").n_atoms


def exchanged(structure, number, centre, first, second):
    """Positions in which two neighbours of an atom have changed places, with all that hangs on neither."""
    x = structure.positions.copy()
    at = {
        structure.atom_name[k]: k
        for k in np.flatnonzero(structure.residue_number[structure.atom_residue] == str(number))
    }
    x[[at[first], at[second]]] = x[[at[second], at[first]]]
    return x


def test_a_run_that_changes_a_hand_ends_in_an_error_status():
    structure = load("1l2y.pdb")
    flipped = exchanged(structure, 2, "CA", "HA", "CB")
    for stop, met in ((Stop.TOLERANCE, True), (Stop.BUDGET, False)):
        status, message = verdict(stop, met, "measured", structure, flipped, 5)
        assert status is Status.INVERTED
        assert message.startswith("inverted: CA of A:LEU2 inverted; ") and "\n" not in message
    status, message = verdict(Stop.INTERRUPTED, True, "measured", structure, flipped, 5)
    assert status is Status.INTERRUPTED and "A:LEU2 inverted" in message
    assert verdict(Stop.TOLERANCE, True, "measured", structure, structure.positions, 5)[0] is Status.CONVERGED


def test_a_minimum_of_the_other_hand_is_no_success_and_not_the_best_of_several():
    structure = pc.from_sequence("AA")
    target = exchanged(structure, 1, "CA", "HA", "CB")

    def pulled(x):
        return 500.0 * float(((x - target) ** 2).sum()), -1000.0 * (x - target)

    solution = pc.minimise(structure, pulled, "cartesian")
    assert solution.status == "inverted" and "CA of A:ALA1 inverted" in solution.message
    assert not solution.to_scipy().success
    kept = pc.minimise(structure, pc.energy(structure), "cartesian", max_evaluations=5)
    assert pc.minimisers.Starts(solution.chain, (solution, kept)).best is kept


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in SHARED if name not in REFUSED])
def test_no_residue_of_any_shared_structure_changes_hand(name):
    _, whole = rebuilt(shared(name), lambda k: k % 3 == 0)
    assert whole and not changed(whole)


@pytest.mark.slow
def test_a_thousand_side_chains_of_crystals_are_built_with_few_overlaps_and_mostly_found_again():
    found, overlaps, n = [], 0, 0
    paths = [STRUCTURES / name for name in CRYSTALS] + [shared(name) for name in MORE_CRYSTALS]
    for path in paths:
        structure, whole = rebuilt(path, lambda k: True)
        assert not changed(whole)
        found += recovered(whole)
        overlaps += len(crowded(structure, whole))
        n += len(whole)
    # The search packs heavy atoms: hydrogens of three residues overlap.
    assert n > 1000 and np.mean(found) > 0.7 and overlaps <= 3
