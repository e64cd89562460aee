"""Alternate locations: one state of all that touches, whatever the numbers and names."""

import gemmi
import numpy as np
import pytest
from fixtures.samples import STRUCTURES, shared

import protochain as pc
from protochain.structure.molecule.repairs import Kind


def written(tmp_path, change):
    structure = gemmi.read_structure(str(STRUCTURES / "1ubq.pdb"))
    structure.remove_waters()
    change(structure[0])
    path = tmp_path / "made.pdb"
    structure.write_pdb(str(path))
    return path


def in_two_states(residue, occupancies, apart):
    """Give every atom of a residue a second place, in the direction of x."""
    others = [atom.clone() for atom in residue]
    for atom, other in zip(residue, others, strict=True):
        (atom.altloc, atom.occ), (other.altloc, other.occ) = zip("AB", occupancies, strict=True)
        other.pos = gemmi.Position(other.pos.x + apart, other.pos.y, other.pos.z)
    for other in others:
        residue.add_atom(other)


def letters(structure):
    return {
        r.facts["residue"].number: r.facts["used"] for r in structure.repairs if r.kind is Kind.ALTERNATES
    }


def test_residues_in_a_row_take_one_letter_and_others_the_likelier_of_their_own(tmp_path):
    occupancies = {"30": (0.8, 0.2), "31": (0.4, 0.6), "32": (0.7, 0.3), "50": (0.2, 0.8)}

    def change(model):
        for residue in model[0]:
            if str(residue.seqid) in occupancies:
                in_two_states(residue, occupancies[str(residue.seqid)], 0.8)

    path = written(tmp_path, change)
    s = pc.load(path)
    assert letters(s) == {"30": "A", "31": "A", "32": "A", "50": "B"}
    assert letters(pc.load(path, altloc="B")) == dict.fromkeys(occupancies, "B")
    ends = s.positions[s.bonds]
    peptide = (s.atom_name[s.bonds] == ["C", "N"]).all(axis=1)
    within = peptide & np.isin(s.residue_number[s.atom_residue[s.bonds]], ["30", "31", "32"]).all(axis=1)
    assert within.sum() == 2
    assert np.linalg.norm(ends[within, 0] - ends[within, 1], axis=1) == pytest.approx(0.133, abs=0.003)


@pytest.mark.parametrize("kept", ["A", "B"])
def test_two_residues_of_other_names_are_two_states_though_the_first_ends_before_the_second(tmp_path, kept):
    """20A 21A 20B 21B, of which 20 is serine in one state, alanine in the other."""

    def change(model):
        chain = model[0]
        place = next(k for k, residue in enumerate(chain) if residue.seqid.num == 20)
        pair = [chain[place].clone(), chain[place + 1].clone()]
        for k, residue in enumerate(pair):
            for atom in residue:
                atom.altloc, atom.occ = "B", 0.6 if kept == "B" else 0.4
            for atom in chain[place + k]:
                atom.altloc, atom.occ = "A", 0.4 if kept == "B" else 0.6
        pair[0].name = "ALA"
        pair[0].remove_atom("OG", "B")
        for k, residue in enumerate(pair):
            chain.add_residue(residue, place + 2 + k)

    s = pc.load(written(tmp_path, change))
    assert s.n_chains == 1 and s.n_residues == 76
    assert s.residue_name[19] == ("SER" if kept == "A" else "ALA")
    assert letters(s) == {"20": kept, "21": kept}


@pytest.mark.parametrize(("occupancy", "kept", "gone"), [(0.15, "MG", "CA"), (0.85, "CA", "MG")])
@pytest.mark.parametrize("blank", [False, True])
def test_of_two_ions_on_one_site_the_likelier_stays(tmp_path, occupancy, kept, gone, blank):
    text = shared("../cases/alternates/ion_excl.pdb").read_text()
    text = text.replace("  0.15  0.00          CA", f"  {occupancy:.2f}  0.00          CA")
    text = text.replace("  0.85  0.00          MG", f"  {1 - occupancy:.2f}  0.00          MG")
    if blank:
        text = text.replace("CA  A CA", "CA    CA").replace("MG  B MG", "MG    MG")
    path = tmp_path / "ions.pdb"
    path.write_text(text)
    s = pc.load(path)
    assert s.residue_name[-1] == kept and gone not in s.residue_name
    (told,) = (r.facts for r in s.repairs if r.kind is Kind.EXCLUDED)
    assert (told["residue"].name, told["other"].name) == (gone, kept)
    # Ions that are there at once are two.
    path.write_text(
        text.replace(f"  {occupancy:.2f}  ", "  1.00  ").replace(f"  {1 - occupancy:.2f}  ", "  1.00  ")
    )
    both = {*pc.load(path).residue_name[-2:].tolist()} == {"MG", "CA"}
    assert both is blank


def test_a_ligand_in_one_state_is_kept_with_the_state_that_it_touches(tmp_path):
    path = shared("../cases/alternates/altloc_two_residues.pdb")
    s = pc.load(path)
    assert "FUC" in s.residue_name and "FUL" not in s.residue_name
    assert "FUL" in pc.load(path, altloc="B").residue_name
