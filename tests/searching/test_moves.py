"""Moves in torsions: where they lead, and that nothing else moves."""

import numpy as np
import pytest

import protochain as pc
from protochain.searching.conformers import backbone
from protochain.searching.moves import NONE, Moves, apply_move, cross_over, random_torsions
from protochain.searching.moves import backbone as favoured
from protochain.structure.sidechains.rotamers import rotamers
from protochain.validation.layout import peptides
from protochain.validation.ramachandran import CLASSES, FAVOURED, ramachandran, score


def moves_of(sequence, hinges="phi psi chi"):
    chain = pc.build_chain(pc.from_sequence(sequence), hinges, "fixed")
    return chain, Moves.of(chain)


def changed(before, after):
    return set(np.flatnonzero(before != after).tolist())


def test_hinges_are_sorted_by_residue():
    chain, moves = moves_of("AFPGS", "phi psi chi polar")
    own = {(h.residue_number, h.kind): k for k, h in enumerate(chain.hinges)}
    place = chain.tree.q_start[chain.hinge_body]
    names = {each.name: each for each in moves.residues}
    phe, pro = names["PHE"], names["PRO"]
    assert (phe.phi, phe.psi) == (place[own["2", "phi"]], place[own["2", "psi"]])
    assert phe.chi == (place[own["2", "chi1"]], place[own["2", "chi2"]])
    assert pro.phi == NONE and names["ALA"].phi == NONE
    assert [each.is_last for each in moves.residues] == [False] * 4 + [True]
    assert len(moves.other_hinges) == sum(h.kind == "rotor" for h in chain.hinges) > 0
    longer, of_classes = moves_of("AFPGIVTGPA")
    plot = ramachandran(longer.structure)
    assert [each.kind for each in of_classes.residues[1:-1]] == plot.kind.tolist()
    assert {CLASSES[kind] for kind in plot.kind} == {*CLASSES} - {"cis_proline"}
    # Not into proline, whose phi does not turn.
    assert set(moves.flips) == {(place[own[str(k), "psi"]], place[own[str(k + 1), "phi"]]) for k in (1, 3, 4)}


def test_within_a_cell_of_the_table_the_backbone_is_drawn_evenly():
    """Cells of two degrees, whose middles are odd."""
    _, moves = moves_of("AAA")
    random = np.random.default_rng(0)
    drawn = np.rad2deg([favoured(moves.residues[1], random) for _ in range(4000)])
    within = (drawn % 2.0) - 1.0
    assert np.all(np.abs(within.mean(axis=0)) < 4.0 * 2.0 / np.sqrt(12.0 * 4000))
    assert np.all(np.abs(within.std(axis=0) - 2.0 / np.sqrt(12.0)) < 0.02)


def test_the_backbone_goes_to_favoured_regions_of_its_own_residue():
    chain, moves = moves_of("AFIGPA")
    random = np.random.default_rng(0)
    by_phi = {each.phi: each for each in moves.residues if each.phi != NONE}
    seen = set()
    for _ in range(300):
        after = apply_move(moves, "backbone", chain.q0, 1.0, random)
        where = changed(chain.q0, after)
        residue = next((by_phi[k] for k in where if k in by_phi), None)
        if residue is None:
            continue
        assert where <= {residue.phi, residue.psi}
        phi, psi = np.rad2deg(after[[residue.phi, residue.psi]])
        # A point of the table, and up to half a cell beside it.
        assert score(np.array([residue.kind]), np.array([phi]), np.array([psi]))[0] > 0.5 * FAVOURED
        seen.add((residue.name, phi > 0))
    assert {("GLY", True), ("GLY", False), ("PHE", False), ("ILE", False)} <= seen


def test_a_new_start_has_every_residue_in_its_favoured_regions():
    chain, moves = moves_of("AFIGPMA", "phi psi chi polar")
    random = np.random.default_rng(0)
    starts = np.array([random_torsions(moves, chain.n_q, random) for _ in range(100)])
    # About as far from each other as angles can be, on average over all hinges.
    assert np.all(np.abs(np.exp(1j * starts).mean(axis=0)) < 0.97)
    assert len(moves.other_hinges) and np.all(
        np.abs(np.exp(1j * starts[:, moves.other_hinges]).mean(axis=0)) < 0.35
    )
    for residue in moves.residues:
        if min(residue.phi, residue.psi) >= 0:
            phi, psi = np.rad2deg(starts[:, [residue.phi, residue.psi]]).T
            assert np.all(score(np.full(100, residue.kind), phi, psi) > 0.5 * FAVOURED)
    (met,) = [each for each in moves.residues if each.name == "MET"]
    for q in starts:
        usual, _ = rotamers("MET", *np.rad2deg(q[[met.phi, met.psi]]))
        away = np.abs((q[list(met.chi)] - usual + np.pi) % (2 * np.pi) - np.pi).max(axis=1)
        assert away.min() < np.deg2rad(50.0)


def test_a_residue_of_the_other_hand_goes_to_the_mirror_image():
    from dataclasses import replace

    chain, moves = moves_of("AIA")
    (residue,) = [each for each in moves.residues if each.name == "ILE"]
    other = Moves((replace(residue, mirror=-1.0),), (), ())
    same, mirrored = (
        apply_move(its, "backbone", chain.q0, 1.0, np.random.default_rng(3))[[residue.phi, residue.psi]]
        for its in (Moves((residue,), (), ()), other)
    )
    assert mirrored == pytest.approx(-same, abs=1e-12)


def test_side_chains_go_to_rotamers():
    chain, moves = moves_of("AMA")
    (met,) = moves.with_chi
    phi, psi = np.rad2deg(chain.q0[[met.phi, met.psi]])
    usual, _ = rotamers("MET", phi, psi)
    random = np.random.default_rng(0)
    near, which = [], set()
    for _ in range(200):
        after = apply_move(moves, "rotamer", chain.q0, 1.0, random)
        assert changed(chain.q0, after) == set(met.chi)
        away = np.abs((after[list(met.chi)] - usual + np.pi) % (2 * np.pi) - np.pi).max(axis=1)
        near.append(away.min())
        which.add(int(away.argmin()))
    # The largest of three normal deviates of 10 degrees.
    assert 8.0 < np.rad2deg(np.median(near)) < 16.0 and len(which) > 8


def test_a_crankshaft_turns_the_ends_little_against_each_other():
    chain, moves = moves_of("AAAAAA", "phi psi")
    random = np.random.default_rng(1)
    ends = [np.flatnonzero(chain.structure.atom_residue == r) for r in (0, 5)]
    for _ in range(20):
        after = apply_move(moves, "crankshaft", chain.q0, 0.3, random)
        (psi, phi) = next(pair for pair in moves.flips if set(pair) == changed(chain.q0, after))
        turn = after[psi] - chain.q0[psi]
        assert after[phi] - chain.q0[phi] == pytest.approx(-turn, abs=1e-12)
        alone = chain.q0.copy()
        alone[psi] = after[psi]

        def between(q):
            """Angle by which the last residue has turned, seen from the first."""
            x, x0 = pc.pose(chain, q).x, pc.pose(chain, chain.q0).x
            turns = [rotation(x[end], x0[end]) for end in ends]
            return np.arccos(np.clip((np.trace(turns[0].T @ turns[1]) - 1.0) / 2.0, -1.0, 1.0))

        if psi in (moves.flips[0][0], moves.flips[-1][0]):
            continue  # The ends themselves turn.
        assert between(after) < 0.2 * between(alone)


def rotation(x, reference):
    from protochain.structure.superpose import motion

    return motion(x, reference)[0]


def test_a_crossing_has_every_torsion_from_one_of_two_and_keeps_together_what_belongs_together():
    chain, moves = moves_of("AFIGPMA", "phi psi chi polar")
    random = np.random.default_rng(0)
    q, other = np.zeros(chain.n_q), np.ones(chain.n_q)
    assert sorted(k for part in moves.parts for k in part) == list(range(chain.n_q))
    seen = set()
    for _ in range(300):
        after = cross_over(moves, q, other, random)
        assert set(after.tolist()) <= {0.0, 1.0} and after.any() and not q.any()
        where = changed(q, after)
        seen.add(
            "part" if where in [set(part) for part in moves.parts]
            else "few" if len(where) <= 5
            else "stretch"
        )  # fmt: skip
        if len(where) > 5:  # The residues of a stretch change whole, up to half of all.
            whole = [{*each.backbone, *each.chi} for each in moves.residues]
            its = [k for k, torsions in enumerate(whole) if torsions <= where]
            assert where == set().union(*(whole[k] for k in its))
            assert its == list(range(its[0], its[-1] + 1)) and len(its) <= len(whole) // 2
    assert seen == {"part", "few", "stretch"}


def test_conformers_name_the_residues_between_others():
    for sequence in ("AAAA", "PPPP", "PAPA", "AGPA"):
        chain, _ = moves_of(sequence)
        phi, psi = backbone(chain, chain.q0)
        expected, its_psi, _ = peptides(chain.structure, chain.structure.positions)
        assert psi == pytest.approx(its_psi[1:-1], abs=1e-6)
        assert phi == pytest.approx(expected[1:-1], abs=1e-6)
