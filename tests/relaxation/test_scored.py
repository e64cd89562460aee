"""An interface scored at both ends of a relaxation, in its record, in tables, on its page."""

import pytest
from fixtures.command_line import refusal
from fixtures.samples import STRUCTURES, load

import protochain as pc
from protochain.relaxation.record import COLUMNS, INTERFACE_COLUMNS
from protochain.validation import SCORES

FILE = STRUCTURES / "3i40.pdb"
OPTIONS = {"solvent": "vacuum", "max_iterations": 5, "threads": 1}


def key_at(key, when):
    """As ``energy_kj_mol`` of an interface is ``interface_energy_start_kj_mol``."""
    stem, unit = key, ""
    for ending in ("_kj_mol_nm2", "_kj_mol", "_angstrom2"):
        if key.endswith(ending):
            stem, unit = key.removesuffix(ending), ending
            break
    return f"interface_{stem}_{when}{unit}"


def test_its_record_has_the_scores_of_both_ends_and_none_that_were_not_asked_for():
    plain, scored = (pc.relax(load(FILE.name), **OPTIONS, interface=given) for given in ("", "A:B"))
    assert plain.interface_start is None and plain.interface_end is None
    assert plain.x.tobytes() == scored.x.tobytes()
    record = scored.record()
    assert {*plain.record()} == {each.key for each in COLUMNS}
    assert {*record} - {*plain.record()} == {each.key for each in INTERFACE_COLUMNS}
    energy = scored.energy_function
    for when, structure in (("start", scored.start), ("end", scored.structure)):
        found = pc.score_interface(structure, "A", "B", energy=energy).scores
        for key in SCORES:
            assert record[key_at(key, when)] == found[key], key
    assert record["interface_energy_start_kj_mol"] != record["interface_energy_end_kj_mol"]
    counts = {key_at(key, when) for key in SCORES for when in ("start", "end") if isinstance(found[key], int)}
    assert counts == {each.key for each in INTERFACE_COLUMNS if each.kind == int | None}
    assert pc.relax(load("1l2y.pdb"), **OPTIONS).interface_end is None


def test_only_residues_in_contact_move():
    s = load(FILE.name)
    found = pc.relax(s, **OPTIONS, move="interface A:B")
    touching = pc.score_interface(s, "A", "B", energy=found.energy_function).residues
    moved = {*s.atom_residue[(found.x != s.positions).any(axis=1)].tolist()}
    assert len(moved) == (touching["contacts"] > 0).sum() < s.n_protein_residues


@pytest.mark.parametrize(
    ("given", "said"), [("A:Q", "side 'Q'"), ("A", "give its two sides"), ("A:A", "on both")]
)
def test_sides_that_make_no_sense_are_refused_before_any_work(given, said, tmp_path):
    with pytest.raises(pc.ProtochainError, match=said):
        pc.relax(load(FILE.name), interface=given, watch=lambda row, x: pytest.fail("it has begun"))
    assert said in refusal("relax", FILE, "-o", tmp_path / "o.pdb", "--interface", given)
    assert not (tmp_path / "o.pdb").exists()
