"""The choices made while a file is read: alternates, residues of one number, disulfides, histidines."""

from string import Formatter

import gemmi
import numpy as np
import pytest
from fixtures.drafts import protonated
from fixtures.repairs import noted

from protochain.cli.options import as_option
from protochain.core.errors import Argument
from protochain.structure.molecule.member import Member, atom
from protochain.structure.molecule.repairs import KEEP_ALL, Kind, Repair, summarise
from protochain.structure.molecule.residues import Residue
from protochain.structure.preparation.structure_draft import Draft, Evidence, Part


def residue(name, number, occupancies):
    """A residue of a number with insertion code, and of atoms (name, altloc, occupancy)."""
    made = gemmi.Residue()
    made.name, made.seqid = name, gemmi.SeqId(*number)
    for atom_name, altloc, occupancy in occupancies:
        one = atom(atom_name, atom_name[0], [0.0, 0.0, 0.0])
        one.altloc, one.occ = altloc, occupancy
        made.add_atom(one)
    return made


def ring_and_acceptors(*places):
    """A regular imidazole with acceptors 3 angstrom from a nitrogen, at an angle from its bisector."""
    names = ("CG", "ND1", "CE1", "NE2", "CD2")
    turns = np.radians(72.0) * np.arange(5)
    radius = 0.5 * 1.36 / np.sin(np.radians(36.0))
    outward = dict(zip(names, np.stack([np.cos(turns), np.sin(turns), 0 * turns], axis=1), strict=True))
    ring = Member("HIS", "1", "", "A", [atom(n, n[0], (radius * outward[n]).tolist()) for n in names])
    ring.atoms.append(atom("CB", "C", ((radius + 1.5) * outward["CG"]).tolist()))
    parts = [Part("A", [ring])]
    for donor, degrees in places:
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        way = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ outward[donor]
        at = radius * outward[donor] + 3.0 * way
        water = Member("HOH", "2", "", "A", [atom("O", "O", at.tolist())])
        parts.append(Part("A", [water], evidence=Evidence.ELEMENTS))
    return Draft("made", "made", parts)


def state(draft):
    (_, template) = protonated(draft)[0]
    return template.name[-3:]


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize(("degrees", "bonded"), [(0, True), (30, True), (41, False), (60, False)])
def test_histidines_hydrogen_goes_where_an_acceptor_is_straight_ahead(degrees, bonded, side):
    """A hydrogen 1 angstrom ahead sees the acceptor within 50 degrees where NE2 sees it within 35.2."""
    assert np.degrees(np.arctan2(np.sin(r := np.radians(35.2)), np.cos(r) - 1 / 3)) == pytest.approx(
        50, abs=0.1
    )
    at = ("NE2", side * degrees)
    assert state(ring_and_acceptors(at)) == ("HIE" if bonded else "HID")
    other = ("ND1", side * degrees)
    assert state(ring_and_acceptors(("NE2", 0), other)) == ("HID" if bonded else "HIE")


# --- What was changed, in few lines


def repair(kind, place=("A", "1", "LYS"), **facts):
    return Repair(kind, {"residue": Residue(*place), **facts})


def test_every_repair_is_told_once_alone_or_in_a_group():
    hydrogens = Repair(Kind.HYDROGENS_ADDED, {"count": 12, "ph": 7, "present": 0})
    last, first = Residue("A", "3", "SER"), Residue("", "5A", "GLY")
    caps = Argument("cap", "breaks")
    gap = Repair(Kind.GAP, {"last": last, "first": first, "length": 5.0, "caps": caps})
    waters = Repair(Kind.WATERS_LEFT_OUT, {"count": 3, "remedy": KEEP_ALL})
    lost = [
        repair(Kind.ALTERNATES, ("A", "4", "SER"), used="A", occupancy=0.6, others=("SER B",)),
        repair(Kind.NO_BACKBONE, ("A", "7", "GLY"), atom="N"),
        Repair(Kind.MODELS_LEFT_OUT, {"used": 1, "count": 9}),
    ]
    changed = [
        noted("CB"),
        repair(Kind.OXT_ADDED, ("B", "3", "LYS")),
        Repair(Kind.BRIDGE, {"first": last, "second": first}),
    ]
    many = [repair(Kind.ATOMS_ADDED, ("A", f"{n}", "LYS"), atoms=("CE", f"N{n}")) for n in range(20)]
    places = ", ".join(f"A:LYS{n}" for n in range(8))
    given = [hydrogens, *changed, *lost, gap, waters, *many]
    assert summarise(given) == (
        *map(str, (waters, gap, *lost, *changed)),
        f"missing atoms added in 20 residues: {places} and 12 more",
        str(hydrogens),
    )
    assert summarise(()) == () and summarise([waters, waters]) == (str(waters),)
    (gaps,) = summarise([gap, gap], as_option)
    assert gaps.startswith("split at 2 gaps in the chains, with charged termini: A:3-5A (5.0")
    assert "--cap breaks adds caps" in gaps and 'cap="breaks" adds caps' in str(gap)


def test_whoever_reads_a_repair_hears_of_arguments_in_their_words():
    waters = Repair(Kind.WATERS_LEFT_OUT, {"count": 3, "remedy": KEEP_ALL})
    said = "3 waters left out: the solvent is implicit; {} keeps everything"
    assert str(waters) == said.format('keep="all"')
    for words in (waters.sentence(as_option), *summarise([waters], as_option)):
        assert words == said.format("--keep all")


@pytest.mark.parametrize("kind", Kind)
def test_every_kind_of_repair_is_told_by_its_facts(kind):
    """Each stands in the sentence; what is said of many is not about one residue."""
    names = {name.partition(".")[0] for _, name, _, _ in Formatter().parse(kind.words.one) if name}
    given = {name: FACTS.get(name, f"<{name}>") for name in names}
    told = str(Repair(kind, given))
    for name, value in given.items():
        if name != "last" and name != "first":
            assert all(str(each) in told for each in (value if isinstance(value, tuple) else (value,)))
    assert "{" not in told and "{residue}" not in kind.words.many
    assert not kind.words.many or kind.words.one.startswith("{residue}")


FACTS = {
    "residue": Residue("A", "1", "LYS"), "last": Residue("A", "1", "LYS"), "first": Residue("B", "2", "GLY"),
    "second": Residue("B", "3", "GLY"), "count": 3, "length": 2.5, "occupancy": 0.25, "ph": 4.5, "pka": 8.5,
    **dict.fromkeys(("atoms", "others", "counts", "bare", "ends", "pairs", "changes"), ("<one>", "<two>")),
    "residues": ("<one>",),
}  # fmt: skip
