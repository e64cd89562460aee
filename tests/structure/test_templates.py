"""Names of residues and atoms: Amber's files, a force field of one's own, and the synonyms of both."""

import pytest

import protochain as pc
from protochain.structure.molecule.member import Member, atom
from protochain.structure.molecule.templates import (
    Template,
    rename,
    standard_name,
    template_name,
    templates,
)
from protochain.structure.preparation.recognise import _match_atoms
from protochain.structure.preparation.structure_draft import Draft, Evidence, Part

OWN = """\
<ForceField><AtomTypes><Type name="n" element="N"/><Type name="c" element="C"/><Type name="h" element="H"/>
<Type name="o" element="O"/><Type name="m"/></AtomTypes><Residues>
<Residue name="ALA"/>
<Residue name="QQQ"><Atom name="N" type="n" charge="-0.5"/><Atom name="HN" type="h" charge="0.25"/>
<Atom name="CA" type="c"/><Atom name="OT1" type="o"/><Atom name="M" type="m"/>
<Bond from="0" to="1"/><Bond atomName1="CA" atomName2="N"/><Bond atomName1="CA" atomName2="M"/>
<Bond atomName1="M" atomName2="CA"/><Bond from="3" to="2"/></Residue>
<Residue name="NILE"><Atom name="H1" type="h"/><Atom name="HT2" type="h"/><Atom name="CD" type="c"/></Residue>
</Residues></ForceField>
"""


def test_a_force_field_of_ones_own_is_added_under_the_archives_names(tmp_path):
    (tmp_path / "own.xml").write_text(OWN.replace("NILE", "NQQQ"))
    known = templates([tmp_path / "own.xml"])
    made = known["QQQ"]
    assert made.name == "QQQ" and dict(made.element) == {"N": "N", "H": "H", "CA": "C", "O": "O"}
    assert dict(made.charge) == {"N": -0.5, "H": 0.25, "CA": 0.0, "O": 0.0}
    assert made.bonds == (("N", "H"), ("CA", "N"), ("O", "CA"))
    assert dict(made.synonyms) == {
        **dict.fromkeys(("HN", "H1", "1H", "HN1", "HT1"), "H"),
        **dict.fromkeys(("O1", "OT1", "OCT1", "OC1"), "O"),
    }
    assert made.heavy == ["N", "CA", "O"] and made.hydrogens == {"N": ["H"]}
    # The first hydrogen of a charged terminus is H1.
    start = known["NQQQ"]
    assert list(start.element) == ["H1", "H2", "CD"]
    assert start.synonyms["H"] == start.synonyms["HT1"] == "H1" and start.synonyms["HT2"] == "H2"
    # Bundled residues stay as they are.
    assert (
        known["ALA"] is templates()["ALA"] and "QQQ" not in templates() and len(known) == len(templates()) + 2
    )


def test_the_last_carbon_of_isoleucine_has_two_names(tmp_path):
    (tmp_path / "own.xml").write_text(OWN)
    known = templates()
    for name in ("ILE", "NILE", "CILE"):
        assert known[name].element["CD1"] == "C" and known[name].synonyms["CD"] == "CD1"
        assert known[name].synonyms["HD1"] == known[name].synonyms["1HD1"] == "HD11"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (None, "not a force-field XML file ("),
        ("<ForceField>", "not a force-field XML file ("),
        (OWN.replace('from="3"', 'from="9"'), "a residue in it cannot be read (IndexError("),
        (OWN.replace('from="3"', ""), "a residue in it cannot be read (ValueError("),
        (OWN.replace('"-0.5"', '"many"'), "a residue in it cannot be read (ValueError("),
    ],
)
def test_a_file_that_is_no_force_field_is_refused(text, why, tmp_path):
    path = tmp_path / "own.xml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(pc.ProtochainError) as refused:
        templates([path])
    assert str(refused.value).startswith(f"{path}: {why}")


def test_water_ions_caps_and_nucleotides_are_known():
    known = templates()
    water = known["HOH"]
    assert dict(water.charge) == {"O": -0.834, "H1": 0.417, "H2": 0.417}
    assert water.bonds == (("O", "H1"), ("O", "H2")) and water.hydrogens == {"O": ["H1", "H2"]}
    assert dict(water.synonyms) == {"OW": "O", "OH2": "O", "HW1": "H1", "HW2": "H2"}
    assert dict(known["ZN"].charge) == {"ZN": 2.0} and known["ZN"].heavy == ["ZN"]
    methylamide = known["NME"]
    assert list(methylamide.element) == ["N", "H", "C", "H1", "H2", "H3"]
    # H1 is a methyl hydrogen here, not the amide's.
    expected = {
        "NT": "N", "HNT": "H", "HN": "H", "CH3": "C", "CA": "C", "CT": "C", "HH31": "H1", "HH33": "H3",
    }  # fmt: skip
    assert expected.items() <= methylamide.synonyms.items()
    assert known["NHE"].synonyms["H1"] == known["NHE"].synonyms["1H"] == "HN1"
    assert {"DA5", "DA3", "DAN", "A", "A5", "CHIE", "NHID", "CYX"} <= known.keys()
    assert known["DA"].synonyms["O1P"] == "OP1" and known["A"].synonyms["O2*"] == "O2'"


def test_hydrogens_belong_to_heavy_atoms_only():
    made = Template("X", {"H1": "H", "O": "O", "H2": "H"}, {}, (("H1", "O"), ("H1", "H2"), ("O", "H2")), {})
    assert made.hydrogens == {"O": ["H1", "H2"]} and made.heavy == ["O"]


@pytest.mark.parametrize(
    ("given", "name", "state"),
    [
        ("ALA", "ALA", ""), ("ACE", "ACE", ""), ("DA", "DA", ""), ("HIE", "HIS", "HIE"),
        ("HSP", "HIS", "HIP"), ("NHIE", "HIS", "HIE"), ("CALA", "ALA", ""), ("NCYX", "CYS", ""),
        ("CASH", "ASP", "ASH"), ("WAT", "HOH", ""), ("TIP3", "HOH", ""), ("DA5", "DA", ""),
        ("HIH", "HIS", ""), ("NMA", "NME", ""), ("XALA", "XALA", ""), ("NHOH", "NHOH", ""),
        ("NALAA", "NALAA", ""), ("NAL", "NAL", ""), ("ALAN", "ALAN", ""), ("HOH", "HOH", ""),
    ],
)  # fmt: skip
def test_names_of_residues_are_the_archives(given, name, state):
    assert standard_name(given) == (name, state)


class Asked(dict):
    """Knows every template, by its name."""

    def get(self, name, default=None):
        return f"template {name}"


def members(*names):
    return [Member(name, str(k), "", "A", []) for k, name in enumerate(names, 1)]


@pytest.mark.parametrize(
    ("names", "kinds", "expected"),
    [
        (("ALA", "HIS", "GLY"), {}, ["NALA", "HIE", "CGLY"]),
        (("HIS", "LYS", "HIS"), {}, ["NHIE", "LYS", "CHIE"]),
        (("ACE", "ALA", "NME"), {}, ["ACE", "ALA", "NME"]),
        (("ALA", "NH2"), {}, ["NALA", "NHE"]),
        (("ALA",), {}, ["NALA"]),
        (("ALA", "HIS", "GLY"), {"cyclic": True}, ["ALA", "HIE", "GLY"]),
        (("HOH",), {"evidence": Evidence.ELEMENTS}, ["HOH"]),
        (("DA", "DC", "G"), {"evidence": Evidence.ELEMENTS}, ["DA5", "DC", "G3"]),
        (("U",), {"evidence": Evidence.ELEMENTS}, ["UN"]),
    ],
)
def test_ends_of_chains_and_strands_have_templates_of_their_own(names, kinds, expected):
    part = Part("A", members(*names), **kinds)
    assert [part.template(Asked(), i) for i in range(len(names))] == [f"template {e}" for e in expected]


def test_a_state_takes_the_place_of_the_usual_one():
    part = Part("A", members("HIS", "HIS", "ASP"))
    found = [part.template(Asked(), i, state) for i, state in enumerate(("HIP", "HID", "ASH"))]
    assert found == ["template NHIP", "template HID", "template CASH"]
    assert part.template({}, 0) is None and template_name("ALA") == "ALA" and template_name("NH2") == "NHE"


def test_atoms_are_renamed_once_and_never_to_a_name_that_is_there():
    known = templates()["ILE"]

    def renamed(*names):
        atoms = [atom(name, name[0], [0.0, 0.0, 0.0]) for name in names]
        return rename(atoms, known), [each.name for each in atoms]

    assert renamed("CD", "HN", "1H", "CA", "QX") == (
        [("CD", "CD1"), ("HN", "H")],
        ["CD1", "H", "1H", "CA", "QX"],
    )
    assert renamed("CD", "CD1") == ([], ["CD", "CD1"])


def test_a_draft_knows_its_residues_and_stated_bonds():
    first, second = members("ALA", "GLY")
    second.atoms.append(atom("CA", "C", [1.0, 2.0, 3.0], 4.0))
    draft = Draft("x", "x", [Part("A", [first]), Part("B", [second], evidence=Evidence.ELEMENTS)])
    assert draft.members == [first, second] and [part.cyclic for part in draft.parts] == [False, False]
    a, b, c = ("A", "1", "C"), ("A", "2", "N"), ("B", "1", "C")
    draft.stated_bonds.append((a, b))
    assert (
        draft.has_bond(a, b)
        and draft.has_bond(b, a)
        and not draft.has_bond(a, c)
        and not draft.has_bond(c, b)
    )
    carbon = second.atom("CA")
    assert carbon.pos.tolist() == [1.0, 2.0, 3.0] and carbon.b_iso == 4.0 and carbon.element.name == "C"
    assert second.atom("CB") is None and atom("H", "H", [0.0] * 3).b_iso == 0.0
    inserted = Member("ALA", "7", "B", "", [])
    assert (inserted.seqid, str(inserted)) == ("7B", "ALA7B")
    assert [m.is_cap for m in members("ALA", "ACE", "NH2")] == [False, True, True]


def test_a_molecule_of_many_like_pieces_is_compared_in_bounded_time():
    """Of sixteen pairs of atoms the last two differ; there are 1e19 ways to see it."""

    def graph(pairs):
        kind = {f"{i}{end}": (pair[end], 0) for i, pair in enumerate(pairs) for end in (0, 1)}
        return kind, {f"{i}{end}": {f"{i}{1 - end}"} for i, _ in enumerate(pairs) for end in (0, 1)}

    like = ["CC"] * 14
    assert _match_atoms(graph([*like, "NN", "OO"]), graph([*like, "NO", "NO"])) is None
    found = _match_atoms(graph([*like, "NO", "NO"]), graph(["NO", *like, "ON"]))
    assert found is not None and found["00"] == "140" and found["151"] in ("140", "150")
