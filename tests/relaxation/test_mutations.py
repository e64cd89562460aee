"""Mutants, and what they cost."""

import numpy as np
import pandas as pd
import pytest
from fixtures.command_line import refusal_as_said, run
from fixtures.samples import STRUCTURES, load, shared

import protochain as pc
from protochain.batches import mutation_scan
from protochain.batches.mutation_scan import heat_map, sites_of
from protochain.core.errors import ProtochainError
from protochain.relaxation.mutations import mutated, places_of, protocol

FAST = {"solvent": "vacuum", "threads": 1}


@pytest.fixture(scope="module")
def leucine():
    return pc.mutate(load("1l2y.pdb"), "A:L7A", **FAST)


def test_what_is_near_moves_in_both_and_the_rest_is_held(leucine):
    wild, mutant = leucine.wild, leucine.mutant
    moved = [np.unique(each.start.atom_residue[each.moving]) for each in (wild, mutant)]
    assert np.array_equal(*moved) and leucine.record()["n_residues_moved"] == len(moved[0]) < 20
    s = load("1l2y.pdb")
    heavy = s.atom_element != "H"
    seventh = s.positions[heavy & (s.atom_residue == 6)]
    apart = np.linalg.norm(s.positions[heavy][:, None] - seventh, axis=2).min(axis=1)
    assert {*s.atom_residue[heavy][apart <= 0.8].tolist()} <= {*moved[0].tolist()}
    for each in (wild, mutant):
        assert np.array_equal(each.x[~each.moving], each.start.positions[~each.moving])


def test_the_change_is_that_of_the_energies_of_both_ends(leucine):
    ends = [pc.energy(r.start, **FAST)(r.x)[0] for r in (leucine.wild, leucine.mutant)]
    assert leucine.change == pytest.approx(ends[1] - ends[0], abs=1e-6)
    assert leucine.ddg == pytest.approx(leucine.change - leucine.unfolded, abs=1e-9)


def test_a_mutation_to_itself_costs_nothing():
    """Of a side chain that its rotamers describe: both sides are the same."""
    s = load("1l2y.pdb")
    relaxing, setup = protocol({**FAST, "repack_region": ""})
    same = mutated(s, {6: "LEU"}, relaxing, setup, {})
    assert same.unfolded == 0.0 and abs(same.ddg) < 5.0


def test_both_sides_have_the_same_ties_to_a_metal():
    """Where atoms are now: of a structure that was relaxed, sulphurs may be near that were not."""
    s = pc.load(shared("1ajj_ldlr.pdb"))
    moved = s.with_positions(1.02 * s.positions)
    m = pc.mutate(moved, "A:F8A", max_iterations=1, max_outer_iterations=1, **FAST)
    wild, mutant = ([tie.rest for tie in each.start.ties] for each in (m.wild, m.mutant))
    assert len(s.ties) == len(wild) > 0 and wild[0] == pytest.approx(1.02 * s.ties[0].rest, rel=1e-3)
    assert mutant == pytest.approx(wild, rel=1e-4)


def test_there_and_back_cost_the_same_in_pentapeptides(leucine):
    back = pc.mutate(leucine.structure, "A:A7L", **FAST)
    assert back.unfolded == pytest.approx(-leucine.unfolded, abs=1e-9)


def test_protonation_states_are_compared_with_their_own():
    """HID and HIE differ by tens of kJ/mol in AMBER, wherever they are."""
    s = load("1hel.pdb")
    relaxing, setup = protocol(FAST)
    r = int(np.flatnonzero(s.residue_number == "15")[0])
    found = [mutated(s, {r: state}, relaxing, setup, {}).unfolded for state in ("HID", "HIE")]
    assert found[0] == 0.0 and abs(found[1]) > 10.0


def test_half_of_a_disulfide_has_no_reference():
    m = pc.mutate(load("1hel.pdb"), "A:C6A", **FAST)
    assert m.ddg is None and m.record()["ddg_kj_mol"] is None


def test_binding_changes_where_the_interface_does():
    m = pc.mutate(load("3i40.pdb"), "B:F24A", interface="A:B", **FAST)
    scores = [each.interface_end.scores["energy_kj_mol"] for each in (m.wild, m.mutant)]
    assert m.interface_change == pytest.approx(scores[1] - scores[0]) != 0.0


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("A:F7A", "there is residue 7 LEU of chain A"), ("A:L7", "as A:L45F"), ("A:L7B", "as A:L45F"),
        ("A:L77A", "there are no residues A:77"), ("Z:L7A", "no residues Z:7"), ("", "give some"),
        ("A:L7A,A:L7V", "mutated twice"), ("B:", "as A:L45F"),
    ],
)  # fmt: skip
def test_mutations_that_cannot_be_are_refused(given, said):
    with pytest.raises(ProtochainError, match=said):
        places_of(load("1l2y.pdb"), given)


def test_of_one_chain_the_name_may_be_left_out():
    assert places_of(load("1l2y.pdb"), "l7a") == places_of(load("1l2y.pdb"), "A:L7A") == {6: "ALA"}
    with pytest.raises(ProtochainError, match="name its chain, of A, B"):
        places_of(load("3i40.pdb"), "G1A")


def test_sites():
    s = load("3i40.pdb")
    assert sites_of(s, "A:1-3,B:2", "A") == [(0, "A"), (1, "A"), (2, "A"), (22, "A")]
    ((_, letters),) = sites_of(s, "A:1", "all")
    assert len(letters) == 19 and "G" not in letters
    for sites, into, said in (
        ("C", "A", "no part"),
        ("A:1", "Z", "letters"),
        ("A:1", "G", "nothing to mutate"),
    ):
        with pytest.raises(ProtochainError, match=said):
            sites_of(s, sites, into)


def test_a_scan_has_the_rows_of_mutants_alone(leucine):
    table = pc.scan_mutations(load("1l2y.pdb"), "A:7-8", "A", **FAST)
    assert table["mutations"].tolist() == ["A:L7A", "A:K8A"]
    row = table.iloc[0].to_dict()
    assert row["ddg_kj_mol"] == leucine.ddg and row["energy_mutant_kj_mol"] == leucine.mutant.energy_end
    drawn = heat_map(table).axes[0].images[0].get_array()
    assert drawn.shape == (1, 2) and drawn[0, 0] == leucine.ddg


def test_a_scan_goes_on_after_a_stop(tmp_path, monkeypatch, leucine):
    """A row that is there stays, and is not made again."""
    monkeypatch.chdir(tmp_path)
    source = STRUCTURES / "1l2y.pdb"
    given = ["mutate", source, "--scan", "A:7-8", "--workers", 1, "-o", "scan.csv", "--solvent", "vacuum"]
    first = mutation_scan.rows_of

    def at_once(*arguments):
        raise KeyboardInterrupt
        yield

    def stopped(*arguments):
        yield next(first(*arguments))
        raise KeyboardInterrupt

    # Of another scan that is complete: none of its rows are of this one.
    (tmp_path / "scan.csv").write_text("chain,residue,wild,mutant\nA,7,L,A\n")
    monkeypatch.setattr(mutation_scan, "rows_of", at_once)
    assert run(*given, "--report", "scan.html") == 130
    assert len(pd.read_csv("scan.csv")) == 0 and not (tmp_path / "scan.html").exists()
    given += ["--resume"]
    monkeypatch.setattr(mutation_scan, "rows_of", stopped)
    assert run(*given) == 130
    assert pd.read_csv("scan.csv")["mutations"].tolist() == ["A:L7A"]
    given.pop()
    monkeypatch.setattr(mutation_scan, "rows_of", first)
    assert "holds an interrupted scan" in refusal_as_said(*given)
    assert "--into" in refusal_as_said(*given, "--into", "V", "--resume")
    marked = pd.read_csv("scan.csv").assign(message="kept")
    marked.to_csv("scan.csv", index=False)
    assert run(*given, "--resume", "--report", "scan.html") == 0
    table = pd.read_csv("scan.csv")
    assert table["mutations"].tolist() == ["A:L7A", "A:K8A"] and table["message"][0] == "kept"
    assert table["ddg_kj_mol"][0] == pytest.approx(leucine.ddg, rel=1e-9)
    assert "data:image/png" in (tmp_path / "scan.html").read_text()
    assert not list(tmp_path.glob("*.npz"))
