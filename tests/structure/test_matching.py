"""Residues of small structures made by hand, paired by number or sequence, and deviations between them."""

from itertools import permutations

import numpy as np
import pytest
import tmtools
from openmm import app
from scipy.spatial.transform import Rotation

import protochain as pc
from protochain.comparison.deviation import deviation
from protochain.structure import matching as module
from protochain.structure.matching import match, tm_score
from protochain.structure.molecule.residues import STANDARD
from protochain.structure.superpose import rmsd

NAMES = {letter: name for name, letter in STANDARD.items()} | {"w": "HOH", "x": "HYP"}


def made(name, *chains, seed=0, atoms=("N", "CA", "C")):
    """Chains (id, one-letter codes, first number) of atoms at random places; w is a water."""
    topology = app.Topology()
    for chain_id, letters, first in chains:
        chain = topology.addChain(chain_id)
        for k, letter in enumerate(letters):
            residue = topology.addResidue(NAMES[letter], chain, str(first + k), "B" if letter == "W" else "")
            for atom in ("O",) if letter == "w" else atoms:
                topology.addAtom(atom, app.Element.getBySymbol(atom[0]), residue)
    x = np.random.default_rng(seed).normal(size=(topology.getNumAtoms(), 3))
    return pc.Structure(name, topology, x)


def pairs(found):
    return list(zip(found.reference.tolist(), found.model.tolist(), strict=True))


def test_residues_of_equal_chain_number_and_name_are_pairs():
    whole = made("r", ("A", "ACDw", 1), ("B", "EF", 1))
    found = match(whole, made("m", ("B", "EF", 1), ("A", "ACD", 1)))
    assert pairs(found) == [(0, 2), (1, 3), (2, 4), (4, 0), (5, 1)]
    assert (found.how, found.identity, found.coverage) == ("numbers", 1.0, 1.0)
    # A part of the reference, in another order; waters are never matched.
    part = match(whole, made("m", ("A", "CDw", 2)))
    assert pairs(part) == [(1, 0), (2, 1)] and (part.how, part.coverage) == ("numbers", 0.4)
    assert pairs(match(made("r", ("A", "CD", 2)), whole)) == [(0, 1), (1, 2)]
    assert match(made("r", ("A", "CD", 2)), whole).how == "numbers"


def test_one_residue_of_another_name_number_or_code_makes_it_an_alignment():
    reference = made("r", ("A", "ACDEWHIK", 1))
    for chains in (("A", "ACDEWHIR", 1), ("A", "ACDEWHIK", 2), ("C", "ACDEWHIK", 1)):
        found = match(reference, made("m", chains))
        assert found.how == "sequence" and pairs(found) == [(k, k) for k in range(8)]
        assert found.identity == (7 / 8 if "R" in chains[1] else 1.0) and found.coverage == 1.0
    # A name that occurs twice in the model says nothing.
    twice = made("m", ("A", "ACDEWHIK", 1), ("A", "K", 8))
    assert match(reference, twice).how == "sequence"


def test_insertions_and_deletions_shift_what_follows():
    reference = made("r", ("A", "MKTAYIAKQRQISFVK", 1))
    short = made("m", ("A", "MKTAYQRQISFVK", 1))
    assert pairs(match(reference, short)) == [(k, k if k < 5 else k - 3) for k in range(16) if not 5 <= k < 8]
    assert match(reference, short).coverage == 13 / 16
    assert pairs(match(short, reference)) == [(k, k if k < 5 else k + 3) for k in range(13)]


def test_chains_are_paired_for_the_best_sum_and_a_broken_chain_is_one_sequence():
    first, second = "MKTAYIAKQR", "WWHHPPGGCC"
    reference = made("r", ("A", first, 1), ("B", second, 1))
    swapped = made("m", ("X", second, 5), ("Y", first[:4], 1), ("Y", first[4:], 30))
    assert pairs(match(reference, swapped)) == [(k, (k + 10) % 20) for k in range(20)]
    assert match(reference, swapped).chains == (("A", "Y"), ("B", "X"))
    assert match(reference, swapped).chain_mapping == "A:Y,B:X"
    parts = made("m", ("Y", "AwC", 1), ("X", "D", 1), ("Y", "E", 9))
    assert module._by_chain(parts) == {"Y": [0, 2, 4], "X": [3]}


def test_equal_chains_are_paired_as_by_trying_all_ways():
    """Where they are known with errors as large as half their distance, too."""
    rng = np.random.default_rng(3)
    letters, atoms = "MKTAYI", ("N", "CA", "C")
    for noise in (0.0, 0.3, 1.0):
        reference = made("r", *((name, letters, 1) for name in "ABCD"), atoms=atoms, seed=1)
        # As in homomers: one shape, at four places.
        shape = rng.normal(size=(18, 3))
        turns, places = Rotation.random(4, rng=rng), rng.normal(scale=2.0, size=(4, 3))
        x = np.vstack([turn.apply(shape) + place for turn, place in zip(turns, places, strict=True)])
        reference = reference.with_positions(x)
        order = rng.permutation(4)
        moved = Rotation.random(rng=rng).apply(x + noise * rng.normal(size=x.shape))
        model = reference.with_positions(np.vstack([np.split(moved, 4)[k] for k in order.tolist()]))
        alpha = np.arange(1, 72, 3).reshape(4, 6)
        ways = {
            way: rmsd(model.positions[alpha[list(way)].ravel()], x[alpha.ravel()])
            for way in permutations(range(4))
        }
        found = match(reference, model)
        best = min(ways, key=ways.__getitem__)
        assert found.chains == tuple(("ABCD"[i], "ABCD"[j]) for i, j in enumerate(best)), noise
        if not noise:
            assert [*best] == np.argsort(order).tolist()


def test_nothing_in_common_is_an_error():
    with pytest.raises(pc.ProtochainError) as refused:
        match(made("r", ("A", "w", 1)), made("m", ("A", "w", 1)))
    assert str(refused.value) == "m: no residue matches r"
    with pytest.raises(pc.ProtochainError) as refused:
        deviation(made("r", ("A", "ACD", 1)), made("m", ("A", "ACD", 1), atoms=("N", "C")), "name CA")
    assert str(refused.value) == "m: no atom of 'name CA' matches r"


TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])


def test_atoms_are_superposed_on_one_selection_and_measured_on_another():
    reference = made("r", ("A", "ACDEF", 1))
    whole = reference.with_positions(reference.positions @ TURN.T + [1.0, 2.0, 3.0])
    x = whole.positions.copy()
    # C of residue 4: 0.4 nm away, the only one of three measured atoms that moved.
    x[11] += [0.0, 0.0, 0.4]
    moved = whole.with_positions(x)
    found = deviation(reference, moved, "name CA", "name C and resid 2:4")
    assert found.rmsd == pytest.approx(4.0 / np.sqrt(3.0)) and (found.n_aligned, found.n_measured) == (5, 3)
    off = 10.0 * (x - reference.positions)[[5, 8, 11]]
    assert found.rmsd_unsuperposed == pytest.approx(np.sqrt((off**2).sum() / 3.0))
    assert deviation(reference, moved).rmsd == pytest.approx(0.0, abs=1e-9)
    same = deviation(reference, whole, "name C", "name C")
    assert same.rmsd == pytest.approx(0.0, abs=1e-9) and same.n_aligned == same.n_measured == 5
    assert found.tm_score == pytest.approx(1.0, abs=1e-4)


def test_atoms_without_a_counterpart_are_left_out():
    reference = made("r", ("A", "ACDEF", 1))
    x = np.delete(reference.positions, [0, 1, 2, 7], axis=0)
    topology = app.Topology()
    chain = topology.addChain("A")
    for number, name in enumerate(("CYS", "ASP", "GLU", "PHE"), 2):
        residue = topology.addResidue(name, chain, str(number))
        for atom in ("N", "CA", "C"):
            if (number, atom) != (3, "CA"):
                topology.addAtom(atom, app.Element.getBySymbol(atom[0]), residue)
    found = deviation(reference, pc.Structure("m", topology, x), "all", "name CA")
    assert (found.n_aligned, found.n_measured, found.match.coverage) == (11, 3, 0.8)
    assert found.rmsd == pytest.approx(0.0, abs=1e-9)


def test_a_tm_score_is_normalised_by_the_reference_and_needs_three_residues():
    reference, model = made("r", ("A", "ACDEFGHIKLx", 1)), made("m", ("A", "ACDEFGHI", 1))
    x, y = (10.0 * s.positions[s.alpha_carbons] for s in (reference, model))
    theirs = tmtools.tm_align(y, x, "ACDEFGHI", "ACDEFGHIKLX")
    assert tm_score(reference, model) == theirs.tm_norm_chain2 != theirs.tm_norm_chain1
    three, two = made("r", ("A", "ACD", 1)), made("m", ("A", "AC", 1))
    assert tm_score(three, three) == pytest.approx(1.0)
    assert module._trace(reference, reference.alpha_carbons)[1] == "ACDEFGHIKLX"
    assert np.isnan(tm_score(three, two)) and np.isnan(tm_score(two, three))
    # The time of TM-align grows with the extent, which no assembly has.
    x = reference.positions.copy()
    x[reference.alpha_carbons[-1], 0] += 150.0
    assert np.isnan(tm_score(reference.with_positions(x), model))
    x[reference.alpha_carbons[-1], 0] -= 100.0
    assert tm_score(reference.with_positions(x), model) > 0.0


def test_a_record_names_its_units():
    reference = made("r", ("A", "ACw", 1))
    moved = reference.with_positions(reference.positions + np.array([0.3, 0.0, 0.0]))
    row = deviation(reference, moved, "all", "name C").record()
    assert list(row) == [
        "rmsd_angstrom", "rmsd_unsuperposed_angstrom", "tm_score", "matched_residues", "coverage", "identity",
        "matched_by", "chain_mapping", "aligned_atoms", "measured_atoms",
    ]  # fmt: skip
    assert row["rmsd_angstrom"] == pytest.approx(0.0, abs=1e-9)
    assert row["rmsd_unsuperposed_angstrom"] == pytest.approx(3.0)
    assert list(row.values())[2:] == [None, 2, 1.0, 1.0, "numbers", "A:A", 6, 2]
    three = made("r", ("A", "ACD", 1))
    assert deviation(three, three).record()["tm_score"] == pytest.approx(1.0)
