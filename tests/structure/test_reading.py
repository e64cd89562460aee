"""Reading of molecules made by hand: what is taken, split, converted or left out, and in which words."""

import gemmi
import numpy as np
import pytest
from fixtures.drafts import read_model
from fixtures.repairs import kinds, sentences
from fixtures.samples import STRUCTURES, load

import protochain as pc
from protochain.structure.molecule.header import update_entities
from protochain.structure.molecule.member import atom
from protochain.structure.molecule.repairs import Kind
from protochain.structure.molecule.templates import archive_parent
from protochain.structure.preparation import read as module
from protochain.structure.preparation.prepare import read
from protochain.structure.preparation.structure_draft import Reading

BACKBONE = ("N", "CA", "C", "O")
STEP = 3.7
"""Angstrom between residues whose C and N are 1.3 angstrom apart."""


def residue(name, number, at=None, atoms=BACKBONE, code=" "):
    """N, CA and C in a row from x = at, other atoms above them; an atom may be (name, element)."""
    made = gemmi.Residue()
    made.name, made.seqid = name, gemmi.SeqId(number, code)
    at = STEP * number if at is None else at
    for k, each in enumerate(atoms):
        label, element = (each, each[0]) if isinstance(each, str) else each
        place = {"N": [0, 0, 0], "CA": [1.2, 0, 0], "C": [2.4, 0, 0]}.get(label, [0.1 * k, 1.0, 0])
        one = atom(label, element, [at + place[0], *place[1:]])
        one.occ = 1.0
        made.add_atom(one)
    return made


def structure(*chains, models=(1,)):
    """Chains (id, residues), the same in every model."""
    made = gemmi.Structure()
    for number in models:
        model = gemmi.Model(number)
        for name, residues in chains:
            chain = gemmi.Chain(name)
            for each in residues:
                chain.add_residue(each)
            model.add_chain(chain)
        made.add_model(model)
    return made


def taken(*residues, chain="A", **options):
    """The draft of one chain."""
    return read_model(structure((chain, residues)), **options)


def names(draft):
    return [[f"{m.name}{m.seqid}" for m in part.members] for part in draft.parts]


def refused(*residues, chain="A", **options):
    with pytest.raises(pc.ProtochainError) as error:
        taken(*residues, chain=chain, **options)
    return str(error.value)


def alanines(n, name="ALA"):
    return [residue(name, number) for number in range(1, n + 1)]


def test_bonded_residues_are_one_part_and_nothing_is_said():
    draft = taken(residue("ALA", 1), residue("HIE", 2, code="B"), residue("LEU", 3), chain=" A ")
    assert names(draft) == [["ALA1", "HIS2B", "LEU3"]] and not draft.parts[0].obstacle
    assert [part.chain_id for part in draft.parts] == ["A"] and not draft.parts[0].cyclic
    assert [(m.chain_id, m.number, m.insertion_code, m.state) for m in draft.members] == [
        ("A", "1", "", ""), ("A", "2", "B", "HIE"), ("A", "3", "", ""),
    ]  # fmt: skip
    assert sentences(draft) == ["A:HIE2B: read as HIS in protonation state HIE"]
    assert dict(draft.left_out) == {}


@pytest.mark.parametrize(("numbers", "said"), [((3, 4, 5), "3 to 5"), ((3, 7), "3, 7"), ((7, 6), "7, 6")])
def test_models_go_by_their_numbers(numbers, said):
    many = structure(("A", alanines(2)), models=numbers)
    many[1].remove_chain("A")
    many[1].add_chain(structure(("B", alanines(2)))[0][0])
    draft = read_model(many)
    n = len(numbers) - 1
    assert sentences(draft) == [f"model {numbers[0]} used, {n} other model{'s' * (n > 1)} left out"]
    assert dict(draft.left_out) == {"models": n} and draft.parts[0].chain_id == "A"
    second = read_model(many, model=numbers[1])
    assert second.parts[0].chain_id == "B" and second.repairs == [] and dict(second.left_out) == {"models": n}
    with pytest.raises(pc.ProtochainError) as error:
        read_model(many, model=1)
    assert str(error.value) == f"x: has no model 1; its models are {said}"


def test_stated_bonds_are_disulfides_covalent_links_and_bonds_to_metals():
    made = structure(("A ", alanines(2)))
    for kind in ("Disulf", "Covale", "Hydrog", "MetalC"):
        link = gemmi.Connection()
        link.type = getattr(gemmi.ConnectionType, kind)
        link.partner1 = gemmi.AtomAddress("A ", gemmi.SeqId(1, "B"), "CYS", "SG")
        link.partner2 = gemmi.AtomAddress("B", gemmi.SeqId(2, " "), "CYS", f"{kind}")
        made.connections.append(link)
    stated = read_model(made).stated_bonds
    assert stated == [(("A", "1B", "SG"), ("B", "2", kind)) for kind in ("Disulf", "Covale", "MetalC")]


def test_bonds_to_symmetry_mates_are_named_and_are_none_of_the_model():
    made = structure(("A", alanines(2)))
    for number, asu in ((1, "Different"), (2, "Different"), (2, "Same")):
        link = gemmi.Connection()
        link.type, link.asu = gemmi.ConnectionType.Disulf, getattr(gemmi.Asu, asu)
        link.partner1 = gemmi.AtomAddress("A", gemmi.SeqId(2, " "), "ALA", "CA")
        link.partner2 = gemmi.AtomAddress("A", gemmi.SeqId(number, " "), "ALA", "CA")
        made.connections.append(link)
    draft = read_model(made)
    assert draft.stated_bonds == [] and kinds(draft) == [Kind.IMAGES]
    assert sentences(draft)[0].startswith("3 bonds of the file to symmetry mates")
    assert sentences(draft)[0].endswith("of CA of A:ALA2")


def test_a_file_without_a_protein_says_what_there_is():
    water, iron = residue("HOH", 1, atoms=["O"]), residue("XQQ", 2, atoms=[("FE", "Fe")])
    heavy, other = residue("DOD", 3, atoms=["O", ("D1", "D")]), residue("XQQ", 4, atoms=["S"])
    third = residue("SOL", 5, atoms=["O"])
    assert refused(water, iron, heavy, other) == (
        "x: no protein found, only 2 waters, 2 residues XQQ; give a file with protein, DNA or RNA"
    )
    assert refused(residue("ALA", 1), water) == (
        "x: no protein found, only 1 water, 1 residue ALA; a chain has two amino acids or more"
    )
    many = refused(*(residue(f"X{k}", k, atoms=["P"]) for k in range(99)))
    assert "1 residue X7 and 91 more; give" in many and len(many) < 300
    draft = taken(*alanines(2), water, iron, heavy, other, third)
    assert dict(draft.left_out) == {"waters": 3, "XQQ": 2}
    assert kinds(draft) == [Kind.LEFT_OUT, Kind.DEUTERIUM]


def test_a_trace_of_c_alphas_is_refused_though_it_has_a_cap():
    cap = residue("ACE", 0, atoms=["C", "O", "CH3"])
    trace = [residue("ALA", number, atoms=["CA"]) for number in (1, 2)]
    said = "holds only C-alpha atoms; rebuild the others first, by PULCHRA or cg2all"
    assert refused(cap, *trace) == f"x: chain A {said}"
    assert refused(*trace, chain=" ") == f"x: chain (blank) {said}"
    draft = taken(trace[0], residue("ALA", 2), residue("ALA", 3))
    assert names(draft) == [["ALA2", "ALA3"]] and dict(draft.left_out) == {"incomplete residues": 1}
    assert kinds(draft) == [Kind.NO_BACKBONE] and [each.name for each in draft.repairs[0].lost] == ["ALA"]


def test_a_cap_alone_in_its_chain_is_no_trace_of_c_alphas():
    with pytest.raises(pc.ProtochainError, match="no protein found"):
        taken(residue("ACE", 0, atoms=["C", "O", "CH3"]))


def test_heavy_atoms_of_zero_occupancy_are_counted():
    made = [residue("ALA", k, atoms=(*BACKBONE, "H", "CB")) for k in (1, 2, 3)]
    made[0][4].occ = 0.0
    for k in (0, 5):
        made[1][k].occ = 0.0
    assert sentences(taken(*made)) == ["2 atoms of zero occupancy kept, in A:ALA2"]
    made[2][0].occ = 0.0
    assert sentences(taken(*made)) == ["3 atoms of zero occupancy kept, in A:ALA2 and 1 more"]


def test_elements_of_amino_acids_and_caps_follow_their_names():
    """As CHARMM writes them, HD1 in columns 13-15 reads as holmium or mercury."""
    odd = [("HG1", "Hg"), ("1HB", "Hf"), ("CD", "Cd"), ("QX", "C"), ("D1", "D"), ("NE", "Ne"), ("9", "C")]
    draft = taken(residue("LYS", 1, atoms=(*BACKBONE, *odd)), residue("ALA", 2))
    assert [a.element.name for a in draft.members[0].atoms][4:] == ["H", "H", "C", "H", "N", "C"]
    calcium = taken(*alanines(2), residue("CA", 9, atoms=[("CA", "Ca")]), keep=("ions",))
    assert calcium.members[-1].atoms[0].element.name == "Ca" and calcium.parts[-1].obstacle


def test_d_cysteine_is_no_nucleotide_and_d_glutamine_no_nucleoside():
    draft = taken(residue("DCY", 1), residue("DGN", 2), residue("HYP", 3), residue("ALA", 4))
    assert names(draft)[0] == ["CYS1", "GLN2", "HYP3", "ALA4"]
    assert kinds(draft)[:2] == [Kind.MIRRORED, Kind.MIRRORED]
    strand = taken(*alanines(2), residue("DC", 9, atoms=["P", "N1"]))
    assert dict(strand.left_out) == {"DC": 1}


def test_caps_have_the_force_fields_names_and_stand_at_the_ends():
    first = residue("ACE", 0, atoms=["C", "O", "CA"])
    last = residue("NME", 3, atoms=["N", "CH3", "HN"])
    draft = taken(first, *alanines(2), last)
    assert names(draft) == [["ACE0", "ALA1", "ALA2", "NME3"]] and draft.repairs == []
    assert [[a.name for a in draft.members[k].atoms] for k in (0, 3)] == [["C", "O", "CH3"], ["N", "C", "H"]]
    amide = taken(*alanines(2), residue("NH2", 3, atoms=["N", "1H"]))
    assert [a.name for a in amide.members[-1].atoms] == ["N", "HN1"]
    wrong = taken(residue("NME", 0, atoms=["N"]), *alanines(2), residue("ACE", 3, atoms=["C", "O"]))
    assert names(wrong) == [["ALA1", "ALA2"]] and dict(wrong.left_out) == {"NME": 1, "ACE": 1}
    assert kinds(wrong) == [Kind.CAP, Kind.CAP]
    within = [residue("ALA", 1), residue("ALA", 2), residue("ACE", 3, atoms=["C"]), *alanines(5)[3:]]
    assert names(taken(*within)) == [["ALA1", "ALA2"], ["ACE3", "ALA4", "ALA5"]]


def test_modified_residues_become_their_parents():
    selenium = residue("MSE", 1, atoms=(*BACKBONE, "CB", "CG", ("SE", "Se"), "CE"))
    sulphur = residue("CSO", 2, atoms=(*BACKBONE, "CB", ("S1", "S"), "OD", "HD", "HA"))
    two = residue("CSO", 3, atoms=(*BACKBONE, ("S1", "S"), ("S2", "S"), "OXT"))
    methyl = residue("HIC", 4, atoms=(*BACKBONE, "CZ", "HD1", "HE2"))
    plain = residue("HIC", 5, atoms=(*BACKBONE, "HD1", "HE2", "H", "H1", "H2", "H3", "HQ", "OXT"))
    draft = taken(selenium, sulphur, two, methyl, plain)
    assert names(draft) == [["MET1", "CYS2", "CYS3", "HIS4", "HIS5"]]
    kept = [[a.name for a in m.atoms[4:]] for m in draft.members]
    assert kept == [
        ["CB", "CG", "SD", "CE"],
        ["CB", "SG"],
        ["OXT"],
        [],
        ["HD1", "HE2", "H", "H1", "H2", "H3", "OXT"],
    ]
    assert [draft.members[k].atom(s).element.name for k, s in ((0, "SD"), (1, "SG"))] == ["S", "S"]
    cut = Kind.CUT_TO_PARENT
    assert kinds(draft) == [Kind.SELENOMETHIONINE, cut, cut, cut, Kind.CONVERTED]
    assert [each.facts["atoms"] for each in draft.repairs[1:4]] == [("OD",), ("S1", "S2"), ("CZ",)]


def test_an_unknown_amino_acid_is_refused_in_a_chain_and_left_out_alone():
    said = refused(residue("ALA", 1), residue("XQQ", 2), residue("ALA", 3))
    assert "A:XQQ2 is an unknown amino acid" in said
    draft = taken(*alanines(2), residue("XQQ", 9), residue("ALA", 20), residue("ALA", 21))
    assert names(draft) == [["ALA1", "ALA2"], ["ALA20", "ALA21"]]
    assert dict(draft.left_out) == {"XQQ": 1}
    assert sentences(draft) == ['1 XQQ left out; keep="all" keeps everything']


def test_a_residue_that_lacks_its_backbone_is_left_out():
    made = [*alanines(2), residue("ALA", 3, atoms=["CA", "O"]), residue("ALA", 4), residue("ALA", 5)]
    draft = taken(*made)
    assert names(draft) == [["ALA1", "ALA2"], ["ALA4", "ALA5"]]
    assert sentences(draft)[0] == "A:ALA3: left out: its backbone atom N is missing"
    assert dict(draft.left_out) == {"incomplete residues": 1} and len(draft.repairs) == 2
    assert "A:ALA3: atom N missing" in refused(*made, strict=True)


def apart(gap, second):
    """Four alanines with C and N in the middle this far apart, angstrom; the number of the third."""
    at = 6.0 - 2.4
    return [
        residue("ALA", 1, at - STEP),
        residue("ALA", 2, at),
        *(residue("ALA", second + k, 6.0 + gap + k * STEP) for k in (0, 1)),
    ]


@pytest.mark.parametrize("strays", [(5,), (5, 9)])
def test_residues_that_stand_elsewhere_in_the_file_do_not_break_a_chain(strays):
    """Two that are bonded have no charged ends, whatever stands between them."""
    far = [residue("ALA", number, 50.0 * number) for number in strays]
    draft = taken(*alanines(2), *far, *(residue("ALA", number) for number in (3, 4)))
    assert names(draft) == [["ALA1", "ALA2", "ALA3", "ALA4"]]
    assert dict(draft.left_out) == {"ALA": len(strays)}
    assert not any("broken" in line for line in sentences(draft))


def records(name):
    """Atom records of a sample."""
    lines = (STRUCTURES / f"{name}.pdb").read_text().splitlines(keepends=True)
    return [line for line in lines if line.startswith("ATOM")]


@pytest.mark.parametrize("name", ["1l2y", "3i40"])
def test_atoms_in_any_order_are_the_same_molecule(name, tmp_path):
    """Also where records of one chain stand between those of another."""
    lines = records(name)

    def atoms(lines):
        path = tmp_path / "given.pdb"
        path.write_text("".join(lines))
        s = pc.load(path)
        where = s.residue_chain[s.atom_residue].tolist(), s.residue_number[s.atom_residue].tolist()
        return sorted(zip(*where, s.atom_name.tolist(), s.positions.round(5).tolist(), strict=True))

    assert atoms(lines) == atoms(np.random.default_rng(1).permutation(lines).tolist())


def test_records_that_come_again_where_a_residue_begins_elsewhere_are_one_residue(tmp_path):
    """The last atoms of a chain, then all of its end."""
    lines, path = records("ala10"), tmp_path / "given.pdb"
    path.write_text("".join([*lines[:-20], *lines[-6:], "TER\n", *lines[-20:]]))
    again = pc.load(path)
    assert again.n_residues == 10 and kinds(again) == [Kind.REPEATED, *kinds(load("ala10.pdb"))]
    assert sorted(again.positions.tolist()) == sorted(load("ala10.pdb").positions.tolist())


def test_a_part_of_a_histidine_beside_a_protein_is_of_its_own_chemistry(tmp_path):
    """No tautomer is sought for a ring that is not there."""
    part = [
        line for line in records("3i40") if line[21:26] == "B   5" and line[12:16].strip() not in ("O", "CD2")
    ]
    path = tmp_path / "given.pdb"
    path.write_text("".join([*(line for line in records("3i40") if line[21] == "A"), "TER\n", *part]))
    s = pc.load(path, keep="all")
    assert s.residue_name[-1] == "HIS" and {"CG", "ND1", "CE1", "NE2"} <= {
        *s.atom_name[s.atom_residue == s.n_residues - 1]
    }


@pytest.mark.parametrize(("gap", "broken"), [(1.999, False), (2.0, True)])
def test_a_chain_breaks_where_c_and_n_are_two_angstrom_apart(gap, broken):
    far = apart(gap, 4)
    draft = taken(*far, chain="")
    where = "chain (blank) is broken between 2 and 4 (2.0 angstrom)"
    assert names(draft) == (
        [["ALA1", "ALA2"], ["ALA4", "ALA5"]] if broken else [["ALA1", "ALA2", "ALA4", "ALA5"]]
    )
    assert kinds(draft) == [Kind.GAP] * broken
    if broken:
        said = refused(*far, chain="", strict=True)
        assert where in sentences(draft)[0] and where in said and said.endswith("strict=True")


@pytest.mark.parametrize(("gap", "torn"), [(1.999, False), (2.0, True), (2.999, True), (3.0, None)])
def test_a_bond_of_consecutive_numbers_is_torn_before_it_is_a_break(gap, torn):
    draft = taken(*apart(gap, 3), strict=torn is not None)
    if torn is None:
        assert len(names(draft)) == 2 and "broken between 2 and 3 (3.0 angstrom)" in sentences(draft)[0]
    else:
        assert names(draft) == [["ALA1", "ALA2", "ALA3", "ALA4"]]
        assert kinds(draft) == [Kind.TORN] * torn


def test_a_break_at_a_terminus_or_a_cap_is_no_surprise():
    ends = residue("ALA", 2, atoms=(*BACKBONE, "OXT"))
    amide = residue("NH2", 3, atoms=["N"])
    again = [residue("ALA", 8), residue("ALA", 9)]
    start = residue("ACE", 7, atoms=["C", "O", "CH3"])
    for first in (
        [residue("ALA", 1), ends],
        [*alanines(2), amide],
        [*alanines(2), amide, start],
        [*alanines(2), start],
    ):
        draft = taken(*first, *again, strict=True)
        assert draft.repairs == [] and len(draft.parts) == 2


@pytest.mark.parametrize("n", [3, 4])
@pytest.mark.parametrize(("gap", "bonded"), [(1.9, True), (2.0, False)])
def test_residues_whose_ends_meet_are_a_ring(n, gap, bonded):
    ring = alanines(n)
    ring[0][0].pos = gemmi.Position(STEP * n + 2.4, gap, 0.0)
    made = structure(("A", ring))
    draft = read_model(made)
    assert draft.parts[0].cyclic is bonded
    assert kinds(draft) == [Kind.CYCLIC] * bonded
    link = gemmi.Connection()
    link.type = gemmi.ConnectionType.Covale
    link.partner1 = gemmi.AtomAddress("A", gemmi.SeqId(1, " "), "ALA", "N")
    link.partner2 = gemmi.AtomAddress("A", gemmi.SeqId(n, " "), "ALA", "C")
    made.connections.append(link)
    assert read_model(made).repairs == []


def test_caps_do_not_bond_on_their_far_sides():
    draft = taken(*alanines(2), residue("NME", 3, atoms=["N", "C"]), residue("ALA", 4))
    assert np.isinf(module._gap(draft.members[-1], draft.members[0])) and draft.members[-1].name == "NME"
    assert module._gap(draft.members[0], draft.members[1]) == pytest.approx(1.3)
    capped = module.Member("ACE", "2", "", "A", draft.members[1].atoms)
    assert np.isinf(module._gap(draft.members[0], capped))
    assert [archive_parent(name) for name in ("SEP", "ABA", "UNK", "HOH", "XQQ")] == [
        "SER",
        "ALA",
        "",
        "",
        "",
    ]


def test_a_name_comes_from_the_file_and_an_end_is_missed(tmp_path, monkeypatch):
    protein = structure(("A", alanines(3)))
    text = protein.make_pdb_string(gemmi.PdbWriteOptions(minimal=True, end_record=True))
    unended = text.replace("TER   ", "REMARK").replace("END   ", "REMARK")
    for name, stem in (("a.b.pdb", "a.b"), ("c.pdb.GZ", "c")):
        (tmp_path / name).write_text(text)
        draft = read(tmp_path / name)
        assert (draft.name, draft.source, sentences(draft)) == (stem, str(tmp_path / name), [])
    water = "HETATM   99  O   HOH A   9       1.000   9.000   3.000  1.00  0.00           O  \n"
    oxygen = water.replace("HETATM   99  O   HOH A   9", "ATOM     98  OXT ALA A   3")
    place = tmp_path / "x.pdb"
    place.write_text(unended + water)
    assert kinds(read(place, Reading(keep=("water",)))) == [Kind.KEPT, Kind.NO_END]
    place.write_text(unended + oxygen)
    assert read(place).repairs == []
    with place.open() as stream:
        monkeypatch.setattr("sys.stdin", stream)
        draft = read("-")
    assert (draft.name, draft.source) == ("stdin", "standard input")


@pytest.mark.parametrize("given", ["   nan", "  1e30", " -1e30"])
def test_an_occupancy_that_is_no_number_is_no_choice(given, tmp_path):
    """Of two locations the one with an occupancy is taken."""
    lines = [line for line in (STRUCTURES / "1ejg.pdb").read_text().splitlines() if line.startswith("ATOM")]
    own = [k for k, line in enumerate(lines) if line[16] == "A" and line[22:26] == "  22"]
    assert own
    for k in own:
        lines[k] = f"{lines[k][:54]}{given}{lines[k][60:]}"
    (tmp_path / "x.pdb").write_text("\n".join([*lines, "END", ""]))
    s = pc.load(tmp_path / "x.pdb")
    assert s.residue_name[21] == "SER" and np.isfinite(s.occupancy).all()
    assert f"occupancy of {len(own)} atoms is no number below 1000: read as 0" in sentences(s)


def test_atoms_upon_one_another_beyond_measure_are_refused(tmp_path):
    """A thousand times what is usual; the file itself is small."""
    text = (STRUCTURES / "1l2y.pdb").read_text().split("ENDMDL")[0].splitlines()
    at = "HETATM 1000 ZN    ZN B{:4}      11.000  11.000  11.000  1.00  0.00          ZN"
    text = [line for line in text if line.startswith("ATOM")] + [at.format(k) for k in range(1, 1001)]
    (tmp_path / "x.pdb").write_text("\n".join([*text, "END", ""]))
    with pytest.raises(pc.ProtochainError, match=r"lie upon one another: [0-9]+ pairs"):
        pc.load(tmp_path / "x.pdb")


@pytest.mark.parametrize(("letters", "kept"), [(100, ""), (101, "..."), (50_000, "...")])
def test_a_long_name_is_cut_after_100_letters_where_it_is_refused(letters, kept, tmp_path):
    document = gemmi.cif.read(str(STRUCTURES / "1ubq.cif"))
    column = document.sole_block().find_loop("_atom_site.auth_asym_id")
    for k in range(len(column)):
        column[k] = letters * "Q"
    document.write_file(str(tmp_path / "x.cif"))
    with pytest.raises(pc.ProtochainError, match=f"has {letters} letters") as caught:
        pc.load(tmp_path / "x.cif")
    assert f" {100 * 'Q'}{kept} has" in str(caught.value)


def test_an_entity_that_names_a_chain_twice_is_one():
    st = gemmi.read_structure(str(STRUCTURES / "1l2y.pdb"))
    st.setup_entities()
    st.entities[0].entity_type = gemmi.EntityType.NonPolymer
    for residue in st[0][0]:
        residue.entity_type = gemmi.EntityType.NonPolymer
    st.entities[0].subchains = [*st.entities[0].subchains] * 2
    update_entities(st, complete=True)
    assert st.entities[0].subchains == ["Axp"]


def test_hydrogens_of_a_modified_residue_have_elements_where_the_file_has_no_columns_for_them(tmp_path):
    """1HB of norleucine, as older programs write it, becomes a hydrogen of the leucine."""
    text = (STRUCTURES / "1l2y.pdb").read_text().split("ENDMDL")[0].splitlines()
    lines = [line[:66] for line in text if line.startswith("ATOM")]
    own = [k for k, line in enumerate(lines) if line[22:26] == "   2"]
    for k in own:
        name = {" HB2": " 1HB", " HB3": " 2HB"}.get(lines[k][12:16], lines[k][12:16])
        lines[k] = f"{lines[k][:12]}{name} NLE{lines[k][20:]}"
    (tmp_path / "x.pdb").write_text("\n".join([*lines, "END", ""]))
    s = pc.load(tmp_path / "x.pdb")
    assert s.residue_name[1] == "LEU" and s.n_atoms == load("1l2y.pdb").n_atoms
    assert {*s.atom_element[s.atom_residue == 1].tolist()} == {"C", "N", "O", "H"}


def test_a_molecule_of_thousands_of_atoms_is_refused(tmp_path):
    text = (STRUCTURES / "1l2y.pdb").read_text().split("ENDMDL")[0].splitlines()
    at = "HETATM 1000 {:4} LIG B   1    {:8.3f}{:8.3f}  11.000  1.00  0.00           C"
    more = [at.format(f"C{k:03}" if k < 1000 else f"D{k - 1000:03}" if k < 2000 else f"E{k - 2000:03}",
            9.0 + 3.0 * (k % 50), 3.0 * (k // 50)) for k in range(2001)]  # fmt: skip
    (tmp_path / "x.pdb").write_text("\n".join([*(x for x in text if x[:4] == "ATOM"), *more, "END", ""]))
    with pytest.raises(pc.ProtochainError, match="B:LIG1 has 2001 atoms"):
        pc.load(tmp_path / "x.pdb", keep="all")


def test_atoms_without_names_and_molecules_without_numbers_get_them_and_amino_acids_are_refused(tmp_path):
    document = gemmi.cif.read(str(STRUCTURES / "1ubq.cif"))
    table = document.sole_block().find(
        "_atom_site.", ["group_PDB", "label_atom_id", "auth_atom_id", "auth_seq_id", "label_seq_id"]
    )
    for row in table:
        if row[0] == "HETATM":
            row[3] = "?"
    document.write_file(str(tmp_path / "x.cif"))
    numbers = pc.load(tmp_path / "x.cif", keep="all").residue_number
    assert "None" not in numbers and (np.unique(numbers, return_counts=True)[1][:3] == 1).all()
    table[4][1] = table[4][2] = "''"
    document.write_file(str(tmp_path / "x.cif"))
    with pytest.raises(pc.ProtochainError, match="atom X does not belong"):
        pc.load(tmp_path / "x.cif")
    table[1][3] = table[1][4] = "?"
    document.write_file(str(tmp_path / "x.cif"))
    with pytest.raises(pc.ProtochainError, match="auth_seq_id"):
        pc.load(tmp_path / "x.cif")


def test_elements_of_standard_residues_are_those_of_their_names(tmp_path):
    """Also of names that other programs give; without it the hydrogen would be there twice, once as zinc."""
    lines = (STRUCTURES / "1l2y.pdb").read_text().splitlines(keepends=True)
    wrong = {" CB  TRP": "Fe", " H   TRP": "Na", " HB2 TRP": "Zn"}
    changed = [
        f"{line[:76]}{wrong[line[12:20]]:>2}{line[78:]}" if line[12:20] in wrong else line for line in lines
    ]
    changed = [line.replace(" HB3 TRP", " HB1 TRP") for line in changed]
    (tmp_path / "odd.pdb").write_text("".join(changed))
    whole, odd = pc.load(STRUCTURES / "1l2y.pdb"), pc.load(tmp_path / "odd.pdb")
    assert odd.atom_element.tolist() == whole.atom_element.tolist()
    (note,) = (each for each in odd.repairs if each.kind is Kind.ELEMENTS)
    assert note.facts["count"] == 3
