"""Mutants, and what they cost."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from fixtures.command_line import refusal_as_said, run
from fixtures.samples import STRUCTURES, load, shared
from fixtures.tolerances import THERE_AND_BACK, THERE_AND_BACK_READ

import protochain as pc
from protochain.batches import mutation_scan
from protochain.batches.mutation_scan import heat_map, sites_of
from protochain.core.errors import ProtochainError
from protochain.relaxation.mutations import NEAR, _state, mutate_at, places_of, protocol
from protochain.structure.molecule.residues import STANDARD
from protochain.structure.substitute import substitute

FAST = {"solvent": "vacuum", "threads": 1}


@pytest.fixture(scope="module")
def leucine():
    return pc.mutate(load("1l2y.pdb"), "A:L7A", **FAST)


BACKBONE = ("N", "CA", "C", "O", "OXT")


def test_side_chains_near_move_in_both_and_the_rest_is_fixed(leucine):
    s = load("1l2y.pdb")
    of_backbone = s.positions[np.isin(s.atom_name, BACKBONE)]
    residues = [np.unique(each.start.atom_residue[each.moving]) for each in (leucine.wild, leucine.mutant)]
    assert np.array_equal(*residues) and leucine.record()["n_residues_moved"] == len(residues[0]) < 20
    # The C-betas of the wild type are within 0.2 angstrom of their ideal places.
    (betas,) = np.nonzero(s.atom_name == "CB")
    apart = 10.0 * np.linalg.norm(s.positions[betas] - s.positions[betas[s.atom_residue[betas] == 6]], axis=1)
    assert {*s.atom_residue[betas][apart < NEAR - 0.4].tolist()} <= {*residues[0].tolist()}
    assert not {*s.atom_residue[betas][apart > NEAR + 0.4].tolist()} & {*residues[0].tolist()}
    for each in (leucine.wild, leucine.mutant):
        names = each.start.atom_name
        assert not np.isin(names[each.moving], BACKBONE).any()
        assert np.array_equal(each.x[np.isin(names, BACKBONE)], of_backbone)
        still = ~np.isin(s.atom_residue, residues[0])
        assert np.array_equal(each.x[~np.isin(each.start.atom_residue, residues[0])], s.positions[still])


def test_the_change_is_that_of_the_energies_of_both_ends(leucine):
    ends = [pc.energy(r.start, **FAST)(r.x)[0] for r in (leucine.wild, leucine.mutant)]
    assert leucine.change == pytest.approx(ends[1] - ends[0], abs=1e-6)
    assert leucine.ddg == pytest.approx(leucine.change - leucine.unfolded, abs=1e-9)


def letter(structure, r):
    return STANDARD[str(structure.residue_name[r])]


def there_and_back(structure, r, new, **options):
    """Sum of the changes of a mutation and its reverse, kJ/mol."""
    its = structure.residue(r)
    old, place = letter(structure, r), f"{its.chain}:{{}}{its.number}{{}}"
    there = pc.mutate(structure, place.format(old, new), **options)
    back = pc.mutate(there.structure, place.format(new, old), **options)
    return there.ddg + back.ddg


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("1l2y.pdb", "A:L2L"), ("1l2y.pdb", "A:P12P"), ("1l2y.pdb", "A:G11G"), ("1ejg.pdb", "A:C3C"),
        ("1l2y.pdb", "A:S20S"), ("4pti.pdb", "A:A16A,A:R17R"),
    ],
)  # fmt: skip
def test_a_mutation_to_itself_costs_exactly_nothing(name, place):
    """A bonded cysteine, glycine and proline among them; both sides are one calculation."""
    s = load(name)
    same = pc.mutate(s, place, **FAST)
    assert same.ddg == same.change == same.unfolded == 0.0
    # An energy of the one is an energy of the other.
    assert same.structure.fingerprint == s.fingerprint


def test_each_side_is_a_function_of_the_fixed_atoms_alone(leucine):
    """Side chains near the site may be anywhere at the start: they are built anew."""
    s = load("1l2y.pdb")
    near = np.isin(s.atom_residue, np.unique(leucine.wild.start.atom_residue[leucine.wild.moving]))
    away = 0.03 * np.random.default_rng(3).normal(size=(s.n_atoms, 3))
    away[~near | np.isin(s.atom_name, BACKBONE)] = 0.0
    again = pc.mutate(s.with_positions(s.positions + away), "A:L7A", **FAST)
    for one, other in ((again.wild, leucine.wild), (again.mutant, leucine.mutant)):
        assert np.array_equal(one.x, other.x) and one.energy_end == other.energy_end


@pytest.mark.parametrize(
    ("r", "new"), [(5, "A"), (3, "P"), (11, "W"), (10, "K"), (15, "G"), (0, "D"), (19, "Y")]
)
def test_there_and_back_the_change_is_nothing(r, new):
    """Of Trp-cage: tryptophan, to and from proline, from glycine, arginine to glycine, and both ends."""
    assert abs(there_and_back(load("1l2y.pdb"), r, new, **FAST)) < THERE_AND_BACK


@pytest.mark.parametrize("state", ["HID", "HIE"])
def test_a_histidine_goes_and_comes_back_whatever_its_tautomer(state):
    s = load("1hel.pdb")
    s = substitute(s, {int(np.flatnonzero(s.residue_number == "15")[0]): state})
    assert pc.mutate(s, "A:H15H", **FAST).ddg == 0.0
    assert abs(there_and_back(s, 14, "A", **FAST)) < THERE_AND_BACK


def test_changes_round_a_cycle_cancel(leucine):
    f = pc.mutate(leucine.structure, "A:A7F", **FAST)
    last = pc.mutate(f.structure, "A:F7L", **FAST)
    assert abs(leucine.ddg + f.ddg + last.ddg) < THERE_AND_BACK


def test_a_mutant_read_again_goes_back_for_the_same(leucine, tmp_path):
    """Of a PDB file, whose three digits move the backbone, too."""
    leucine.save(tmp_path / "mutant.pdb")
    back = pc.mutate(tmp_path / "mutant.pdb", "A:A7L", **FAST)
    assert abs(leucine.ddg + back.ddg) < THERE_AND_BACK_READ


def test_bonded_side_chains_near_the_site_stay():
    """Of crambin, whose disulfide bonds no rotamer closes."""
    s = load("1ejg.pdb")
    m = pc.mutate(s, "A:T2A", **FAST)
    for each in (m.wild, m.mutant):
        sulphurs = each.start.atom_name == "SG"
        assert not each.moving[sulphurs].any()
        assert np.array_equal(each.x[sulphurs], s.positions[s.atom_name == "SG"])
    assert len(m.wild.start.bonds) == len(s.bonds)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "step"), [("1l2y.pdb", 1), ("1ubq.pdb", 6), ("4pti.pdb", 6), ("1ejg_crambin.pdb", 4)]
)
def test_null_mutations_and_round_trips_of_relaxed_proteins(name, step):
    """In the solvent, as results are used: nothing for the same residue, and there and back to alanine."""
    s, sums = pc.relax(shared(name) if "_" in name else load(name), threads=1).structure, []
    for r in range(0, s.n_residues, step):
        its = s.residue(r)
        if (own := STANDARD.get(str(s.residue_name[r]))) is None:
            continue
        place = f"{its.chain}:{own}{its.number}"
        assert pc.mutate(s, f"{place}{own}", threads=1).ddg == 0.0
        is_bonded = own == "C" and "HG" not in s.atom_name[s.atom_residue == r]
        if own not in "GA" and not is_bonded:
            sums.append(there_and_back(s, r, "A", threads=1))
    assert len(sums) > 5 and np.abs(sums).max() < THERE_AND_BACK


def test_both_sides_have_the_same_ties_to_a_metal():
    """Where atoms are now: of a structure that was relaxed, sulphurs may be near that were not."""
    s = pc.load(shared("1ajj_ldlr.pdb"))
    moved = s.with_positions(1.02 * s.positions)
    m = pc.mutate(moved, "A:F8A", max_iterations=1, max_outer_iterations=1, **FAST)
    wild, mutant = ([tie.rest for tie in each.start.ties] for each in (m.wild, m.mutant))
    assert len(s.ties) == len(wild) > 0 and wild[0] == pytest.approx(1.02 * s.ties[0].rest, rel=1e-3)
    assert mutant == pytest.approx(wild, rel=1e-4)


def test_protonation_states_are_compared_with_their_own():
    """HID and HIE differ by tens of kJ/mol in AMBER, wherever they are."""
    s = load("1hel.pdb")
    relaxing, setup = protocol(FAST)
    r = int(np.flatnonzero(s.residue_number == "15")[0])
    found = [mutate_at(s, {r: state}, relaxing, setup, {}).unfolded for state in ("HID", "HIE")]
    own, other = sorted(found, key=abs)
    assert own == 0.0 and abs(other) > 10.0


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
        ("A:F7A", "there is A:LEU7"), ("A:L7", "as A:L45F"), ("A:L7B", "as A:L45F"),
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
    axes = heat_map(table).axes[0]
    drawn = axes.images[0].get_array()
    assert drawn.shape == (1, 2) and drawn[0, 0] == leucine.ddg
    assert axes.get_title(loc="left") == f"{(table['ddg_kj_mol'] > 0.0).sum()} of 2 mutants are less stable"


def test_the_model_of_the_unfolded_chain_has_no_change_of_stability():
    """GGXGG itself, whose energy changes as much in the structure as in the peptide."""
    m = pc.mutate(pc.from_sequence("GGAGG"), "A:A3V", solvent="vacuum", threads=1)
    assert m.change < -50.0 and abs(m.ddg) < 1.0


def test_rows_of_a_scan_are_the_mutations_alone_in_the_order_of_the_sites():
    """Sites and letters in another order than in the file, whose moving residues are as many."""
    few = {"solvent": "vacuum", "threads": 1, "max_iterations": 2, "max_outer_iterations": 1}
    table = pc.scan_mutations(STRUCTURES / "ala10.pdb", "A:6,A:5", "VGS", **few).set_index("mutations")
    assert [*table.index] == [f"A:A{site}{letter}" for site in (5, 6) for letter in "GSV"]
    assert table["n_residues_moved"].nunique() < len(table)
    for name in ("A:A5S", "A:A6G", "A:A6V"):
        alone = pc.mutate(STRUCTURES / "ala10.pdb", name, **few).record()
        for key in ("ddg_kj_mol", "energy_mutant_kj_mol", "energy_wild_kj_mol", "unfolded_change_kj_mol"):
            assert table.loc[name, key] == pytest.approx(alone[key], abs=1e-6), (name, key)


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
    assert "contains an interrupted scan" in refusal_as_said(*given)
    assert "--into" in refusal_as_said(*given, "--into", "V", "--resume")
    marked = pd.read_csv("scan.csv").assign(message="kept")
    marked.to_csv("scan.csv", index=False)
    assert run(*given, "--resume", "--report", "scan.html") == 0
    table = pd.read_csv("scan.csv")
    assert table["mutations"].tolist() == ["A:L7A", "A:K8A"] and table["message"][0] == "kept"
    assert table["ddg_kj_mol"][0] == pytest.approx(leucine.ddg, rel=1e-9)
    page, ranked = (tmp_path / "scan.html").read_text(), table.sort_values("ddg_kj_mol")
    assert 'src="data:image/' in page and ">kept<" not in page  # Only reasons of failures are shown.
    for label, row in (("most", ranked.iloc[0]), ("least", ranked.iloc[1])):
        shown = f"{row['mutations']} {row['ddg_kj_mol']:+.1f}"
        assert f"<dt>{label} stable, kJ/mol</dt><dd>{shown}</dd>" in page
    assert "2 of 2 converged" in page
    assert not list(tmp_path.glob("*.npz"))


def test_terminal_and_page_call_it_an_energy(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    given = ["mutate", STRUCTURES / "ala10.pdb", "--solvent", "vacuum"]
    assert run(*given, "A:A5G", "-o", "m.pdb") == 0
    one = capsys.readouterr().out
    assert run(*given, "--scan", "A:5", "--into", "G", "-o", "s.csv", "--report", "s.html") == 0
    texts = (one, capsys.readouterr().out, (tmp_path / "s.html").read_text())
    for text in texts:
        assert "not a free energy" in text


@pytest.mark.parametrize(
    ("name", "atoms", "state"),
    [
        ("HIS", "HD1 HE2", "HIP"), ("HIS", "HD1", "HID"), ("HIS", "HE2", "HIE"), ("HIS", "", "HIS"),
        ("ASP", "HD2", "ASH"), ("ASP", "", "ASP"), ("GLU", "HE2", "GLH"), ("GLU", "", "GLU"),
        ("LYS", "HZ1 HZ2 HZ3", "LYS"), ("LYS", "HZ2 HZ3", "LYN"), ("CYS", "HG", "CYS"), ("CYS", "", ""),
        ("ALA", "HB1", "ALA"),
    ],
)  # fmt: skip
def test_a_state_is_that_of_the_protons_of_the_residue(name, atoms, state):
    names = np.array(["HD1", "HE2", "CA", *atoms.split()])
    residues = (np.arange(len(names)) > 1).astype(int)  # The first has both protons of a histidine.
    s = SimpleNamespace(residue_name=["HIS", name], atom_name=names, atom_residue=residues)
    assert _state(s, 1) == state
