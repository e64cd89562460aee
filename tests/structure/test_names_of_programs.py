"""Residues by their atoms, whatever programs call them; what columns of other programs mean."""

import gemmi
import numpy as np
import pytest
from fixtures.samples import STRUCTURES

import protochain as pc
from protochain.ligands import dictionary

PEPTIDE, DUPLEX = STRUCTURES / "1l2y.pdb", STRUCTURES / "1bna.pdb"
OLD = {"OP1": "O1P", "OP2": "O2P", "C7": "C5M"}
CHARMM = {"DA": "ADE", "DC": "CYT", "DG": "GUA", "DT": "THY"}


def lines(path, edit):
    """Lines of a file without hydrogens, each atom's name and residue as ``edit`` calls them."""
    out = []
    for line in path.read_text().splitlines():
        if line.startswith("ATOM") and line[76:78].strip() != "H":
            atom, residue = edit(line[12:16].strip(), line[17:20].strip())
            named = atom if len(atom) == 4 else f" {atom:<3}"
            out.append(f"{line[:12]}{named} {residue:>3}{line[17 + max(3, len(residue)) :]}")
        elif line.startswith(("TER", "END")):
            out.append(line[:3])
        if line.startswith("ENDMDL"):
            break
    return "\n".join(out) + "\nEND\n"


def loaded(tmp_path, text, **settings):
    path = tmp_path / "x.pdb"
    path.write_text(text)
    return pc.load(path, **settings)


@pytest.mark.parametrize(
    ("given", "meant", "states"),
    [
        ("ASPP", "ASP", ["ASH"]), ("LSN", "LYS", ["LYN"]), ("LYSN", "LYS", ["LYN"]), ("LYP", "LYS", []),
        ("ARN", "ARG", []), ("ARGN", "ARG", []), ("GLNX", "GLN", []), ("XTR", "TRP", []),
    ],
)  # fmt: skip
def test_an_amino_acid_is_known_by_its_atoms(given, meant, states, tmp_path):
    text = lines(PEPTIDE, lambda atom, residue: (atom, given if residue == meant else residue))
    text = "\n".join(f"{line[:21]} {line[22:]}" if line[:4] == "ATOM" else line for line in text.split("\n"))
    s, plain = loaded(tmp_path, text), pc.load(PEPTIDE)
    assert s.residue_name.tolist() == plain.residue_name.tolist()
    assert {*s.residue_chain} == {""}
    assert [r.facts["state"] for r in s.repairs if r.kind.name == "STATE_NAMED"] == states
    hydrogens = {"ASH": 1, "LYN": -1}.get((states or [""])[0], 0)
    assert s.n_atoms == plain.n_atoms + hydrogens


@pytest.mark.parametrize(
    "edit",
    [
        lambda a, r: (OLD.get(a, a).replace("'", "*"), r[1:]), lambda a, r: (OLD.get(a, a), CHARMM[r]),
        lambda a, r: (a, f"Q{r}"),
    ],
    ids=["version 2.3", "CHARMM", "unknown"],
)  # fmt: skip
def test_a_nucleotide_is_known_by_its_sugar_and_base(edit, tmp_path):
    s, plain = loaded(tmp_path, lines(DUPLEX, edit)), pc.load(DUPLEX)
    assert s.residue_name.tolist() == plain.residue_name.tolist() and s.mobile.all()
    assert s.n_atoms == plain.n_atoms and len(s.bonds) == len(plain.bonds)


def test_pseudouridine_has_the_atoms_of_uridine_and_is_none(tmp_path):
    component = dictionary.component("PSU")
    atoms = [
        f"ATOM  {k:5} {name:^4} PSU A   1    {x[0]:8.3f}{x[1]:8.3f}{x[2]:8.3f}  1.00  0.00{element:>12}"
        for k, (name, x, element) in enumerate(
            zip(component.atom_name, component.coord, component.element, strict=True), 1
        )
        if element != "H" and name not in ("OP3",)
    ]
    text = lines(PEPTIDE, lambda *given: given).replace("END\n", "\n".join(atoms) + "\nEND\n")
    s = loaded(tmp_path, text, keep="all")
    assert "PSU" in s.residue_name and "U" not in s.residue_name


def test_a_chain_id_of_two_letters_stays_one(tmp_path):
    text = lines(PEPTIDE, lambda *given: given)
    twice = "\n".join(
        f"{line[:20]}{name}{line[22:]}"
        for name in ("AA", "BA") for line in text.split("\n") if line[:4] == "ATOM"
    )  # fmt: skip
    moved = [
        f"{line[:30]}{float(line[30:38]) + 60 * (line[20:22] == 'BA'):8.3f}{line[38:]}"
        for line in twice.split("\n")
    ]
    s = loaded(tmp_path, "\n".join(moved) + "\nEND\n")
    assert [*dict.fromkeys(s.residue_chain.tolist())] == ["AA", "BA"] and s.n_residues == 40


def acetate(name, chain="A"):
    at = (("C1", 20.0, 0.0), ("C2", 21.5, 0.0), ("O1", 22.1, 1.08), ("O2", 22.1, -1.08))
    return "".join(
        f"HETATM{900 + k:5} {atom:^4} {name:<4}{chain}   1    {x:8.3f}{y:8.3f}   0.000  1.00  0.00"
        f"{atom[0]:>12}\n"
        for k, (atom, x, y) in enumerate(at)
    )


def test_a_ligand_of_four_letters_keeps_its_name_and_pdb_files_say_how_they_call_it(tmp_path):
    text = lines(PEPTIDE, lambda *given: given).replace("END\n", acetate("LIG1") + "END\n")
    s = loaded(tmp_path, text, keep="all", ligands="LIG1=CC(=O)[O-]")
    assert s.residue_name_in_file[-1] == "LIG1" and len(s.ligands) == 1
    for name, called in (("y.pdb", "LIG"), ("y.cif", "LIG1")):
        pc.save(s, tmp_path / name)
        again = pc.load(tmp_path / name, keep="all")
        assert again.residue_name_in_file[-1] == called and len(again.ligands) == 1
        assert again.ligands[0].ligand.molecule.formal_charges.sum() == -1
    assert "LIG1 is called LIG here" in (tmp_path / "y.pdb").read_text()


def test_a_molecule_whose_bonds_are_given_is_no_amino_acid_by_its_atoms(tmp_path):
    """Prolinal, which has the atoms of proline within a chain: as given, and in files written of it."""
    text = lines(PEPTIDE, lambda *given: given)
    of = [line for line in text.split("\n") if line[17:20] == "PRO" and line[22:26] == "  12"]
    its = [f"HETATM{line[6:17]}LIG1A  99    {float(line[30:38]) + 30:8.3f}{line[38:]}" for line in of]
    s = loaded(
        tmp_path, text.replace("END\n", "\n".join([*its, "END\n"])), keep="all", ligands="LIG1=O=CC1CCCN1"
    )
    for name in ("y.pdb", "y.cif"):
        pc.save(s, tmp_path / name)
        again = pc.load(tmp_path / name, keep="all")
        assert len(again.ligands) == len(s.ligands) == 1 and again.n_atoms == s.n_atoms


def test_occupancies_that_are_not_there_are_1_and_b_factors_unknown(tmp_path):
    text = lines(PEPTIDE, lambda *given: given)
    bare = "\n".join(
        f"{line[:54]}{'':12}{line[66:]}" if line[:4] == "ATOM" else line for line in text.split("\n")
    )
    s = loaded(tmp_path, bare)
    assert (s.occupancy == 1.0).all() and np.isnan(s.b_factor).all()
    for name in ("y.pdb", "y.cif"):
        pc.save(s, tmp_path / name)
        again = pc.load(tmp_path / name)
        assert (again.occupancy == 1.0).all() and np.isnan(again.b_factor).all()
    atom = next(line for line in (tmp_path / "y.pdb").read_text().splitlines() if line[:4] == "ATOM")
    assert atom[54:66] == "  1.00      "
    block = gemmi.cif.read(str(tmp_path / "y.cif")).sole_block()
    assert {*block.find_values("_atom_site.B_iso_or_equiv")} == {"?"}


def test_segments_that_share_a_blank_id_become_chains(tmp_path):
    text = [line for line in lines(PEPTIDE, lambda *given: given).split("\n") if line[:4] == "ATOM"]
    both = [f"{line[:21]} {line[22:72]}PROA{line[76:]}" for line in text]
    both += [
        f"{line[:21]} {line[22:30]}{float(line[30:38]) + 60:8.3f}{line[38:72]}PROB{line[76:]}"
        for line in text
    ]
    s = loaded(tmp_path, "\n".join(both) + "\nEND\n")
    assert [*dict.fromkeys(s.residue_chain.tolist())] == ["", "A"]
    assert [r.kind.name for r in s.repairs].count("CHAIN_RENAMED") == 1
    for name in ("y.pdb", "y.cif"):
        pc.save(s, tmp_path / name)
        again = pc.load(tmp_path / name)
        assert again.residue_chain.tolist() == s.residue_chain.tolist()
        assert np.abs(again.positions - s.positions).max() < 1e-4
    block = gemmi.cif.read(str(tmp_path / "y.cif")).sole_block()
    labels = zip(
        block.find_values("_atom_site.label_asym_id"),
        block.find_values("_atom_site.auth_asym_id"),
        strict=True,
    )
    assert len({*labels}) == len({*block.find_values("_atom_site.label_asym_id")}) == 2


def test_other_data_blocks_with_atoms_are_named(tmp_path):
    pc.save(pc.load(PEPTIDE), tmp_path / "one.cif")
    text = (tmp_path / "one.cif").read_text()
    first = text.split("\n", 1)[0]
    (tmp_path / "two.cif").write_text(text + text.replace(first, "data_second", 1))
    (said,) = [r for r in pc.load(tmp_path / "two.cif").repairs if r.kind.name == "BLOCKS_LEFT_OUT"]
    assert said.facts["others"] == ("second",) and "second" in str(said)
    assert not [r for r in pc.load(tmp_path / "one.cif").repairs if r.kind.name == "BLOCKS_LEFT_OUT"]


def test_strands_are_polymers_of_their_kind(tmp_path):
    pc.save(pc.load(DUPLEX), tmp_path / "y.cif")
    block = gemmi.cif.read(str(tmp_path / "y.cif")).sole_block()
    assert {*block.find_values("_entity_poly.type")} == {"polydeoxyribonucleotide"}
    assert {*block.find_values("_atom_site.group_PDB")} == {"ATOM"}
