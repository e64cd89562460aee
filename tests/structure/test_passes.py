"""Each pass of a preparation, on a draft made in memory."""

from dataclasses import replace

import gemmi
import numpy as np
import pytest
from fixtures.samples import ROOT

import protochain as pc
from protochain.core.arrays import read_only
from protochain.structure.molecule.links import Link
from protochain.structure.molecule.member import Member, atom
from protochain.structure.molecule.repairs import Kind, Repair
from protochain.structure.preparation.prepare import PASSES
from protochain.structure.preparation.structure_draft import (
    Draft,
    Evidence,
    HeteroResidue,
    Omission,
    Part,
    Reading,
    Role,
)
from protochain.structure.write import as_gemmi

STEPS = {step.__name__: step for step in PASSES}


def peptides(*sequences, apart=30.0):
    """A gemmi structure with a chain for each sequence."""
    made = gemmi.Structure()
    made.add_model(gemmi.Model(1))
    for k, sequence in enumerate(sequences):
        chain = as_gemmi([pc.from_sequence(sequence)])[0][0].clone()
        chain.name = "ABCD"[k]
        for each in (a for residue in chain for a in residue):
            each.pos.y += apart * k
        made[0].add_chain(chain)
    return made


def of_file(made, **options):
    draft = Draft("x", "x", reading=Reading(**options), file=made)
    draft.model, draft.chains = made[0], [*made[0]]
    return draft


def member(name, number, *atoms, chain="A"):
    made = [atom(label, element, [x, 0.0, 0.0]) for label, element, x in atoms]
    return Member(name, str(number), "", chain, made, raw_name=name)


def of_members(*members, beside=()):
    """A draft of one chain, and molecules beside it."""
    return Draft(
        "x", "x", [Part("A", [*members]), *(Part("B", [each], Evidence.ELEMENTS) for each in beside)]
    )


def placed_runs(*sequences, apart):
    draft = of_file(peptides(*sequences, apart=apart))
    for name in ("choose_altlocs", "split_chains"):
        [*STEPS[name](draft)]
    return draft


ZINC = ("ZN", "Zn", 2.3)


def build_assembly():
    made = peptides("AA")
    made.add_model(made[0].clone())
    made[1].num = 2
    draft = of_file(made, assembly="models")
    yield draft, [Kind.ASSEMBLY]
    assert [chain.name for chain in made[0]] == ["A", "B"] and len(made) == 1


def choose_model():
    made = peptides("AA")
    made.add_model(made[0].clone())
    made[1].num = 2
    draft = of_file(made)
    yield draft, [Kind.MODELS_LEFT_OUT, Omission("models", 1)]
    assert draft.model_number == 1 and len(draft.file_atoms) == draft.model.count_atom_sites()


def remove_pseudo_atoms():
    made = peptides("AA")
    made[0][0][0].add_atom(atom("CEN", "C", [0.0, 0.0, 0.0]))
    yield of_file(made), [Kind.VIRTUAL]
    assert not made[0][0][0].find_atom("CEN", "*")


def make_whole():
    made = peptides("AAAA")
    before = [a.atom.pos.tolist() for a in made[0].all()]
    made.cell = gemmi.UnitCell(60.0, 60.0, 60.0, 90.0, 90.0, 90.0)
    for each in made[0][0][3]:
        each.pos.x += 60.0
    yield of_file(made), [Kind.MADE_WHOLE]
    after = np.array([a.atom.pos.tolist() for a in made[0].all()])
    shift = after - before
    assert np.allclose(shift, shift[0], atol=1e-6)


def correct_atoms():
    made = peptides("AA")
    first = made[0][0][0]
    first[0].occ, first["CA"][0].element = float("nan"), gemmi.Element("N")
    first[-1].element, first[-1].name = gemmi.Element("D"), "D9"
    yield of_file(made), [Kind.NOT_A_NUMBER, Kind.DEUTERIUM, Kind.ELEMENTS]
    assert first[0].occ == 0.0 and first[-1].element.name == "H" and first["CA"][0].element.name == "C"


def read_bonds():
    made = peptides("CAC")
    for asu in (gemmi.Asu.Any, gemmi.Asu.Different):
        bond = gemmi.Connection()
        bond.type, bond.asu = gemmi.ConnectionType.Disulf, asu
        bond.partner1, bond.partner2 = (
            gemmi.AtomAddress("A", gemmi.SeqId(number, " "), "CYS", "SG") for number in (1, 3)
        )
        made.connections.append(bond)
    draft = of_file(made)
    yield draft, [Kind.IMAGES]
    assert draft.stated_bonds == [(("A", "1", "SG"), ("A", "3", "SG"))]


def choose_chains():
    draft = of_file(peptides("AA", "GG"), chains=("B",))
    yield draft, [Omission("chains", 1)]
    assert [chain.name for chain in draft.chains] == ["B"]


def choose_altlocs():
    made = peptides("AA")
    for k, occupancy in enumerate((0.7, 0.3)):
        ion = gemmi.Residue()
        ion.name, ion.seqid = "ZN", gemmi.SeqId(90 + k, " ")
        ion.add_atom(atom("ZN", "Zn", [50.0, 0.1 * k, 0.0]))
        ion[0].occ = occupancy
        made[0][0].add_residue(ion)
    draft = of_file(made)
    yield draft, [Omission("alternate locations", 1), Kind.EXCLUDED]
    assert [group[0].name for group, _ in draft.places["A"]] == ["ALA", "ALA", "ZN"]


def split_chains():
    made = peptides("AAA")
    for each in made[0][0][2]:
        each.pos.y += 20.0
    made[0][0][1].remove_atom("CA", "\0", gemmi.Element("C"))
    made[0][0][1].remove_atom("N", "\0", gemmi.Element("N"))
    draft = of_file(made)
    [*STEPS["choose_altlocs"](draft)]
    yield draft, [Kind.NO_BACKBONE, Omission("incomplete residues", 1)]
    assert [[m.seqid for m in run] for run in draft.runs] == [["1"], ["3"]]


def join_chains():
    made = peptides("AAAA")
    for residue in [*made[0][0]][2:]:
        for each in residue:
            each.pos.y += 20.0
    draft = of_file(made)
    for step in (STEPS["choose_altlocs"], STEPS["split_chains"]):
        [*step(draft)]
    for each in draft.runs[0]:
        each.atoms = [a for a in each.atoms if a.name != "OXT"]
    yield draft, [Kind.GAP]
    assert [len(part.members) for part in draft.parts] == [2, 2]


def add_poses():
    draft = of_file(peptides("AA", "AA"))
    draft.hetero_residues = [HeteroResidue(member("ZN", 9, ZINC, chain=chain), "ZN") for chain in "BA"]
    yield draft, []
    assert [each.member.chain_id for each in draft.hetero_residues] == ["A", "B"]


def choose_hetero():
    draft = of_members(member("ALA", 1, ("CA", "C", 0.0)))
    draft.hetero_residues = [HeteroResidue(member("HOH", 9, ("O", "O", 3.0)), "HOH")]
    yield draft, [Omission("waters", 1), Kind.WATERS_LEFT_OUT]
    assert len(draft.parts) == 1 and len(draft.omitted) == 1


def find_links():
    cysteine, zinc = member("CYS", 1, ("SG", "S", 0.0)), member("ZN", 9, ZINC, chain="B")
    draft = of_members(cysteine, beside=[zinc])
    yield draft, []
    assert [link.owners for link in draft.links] == [(id(cysteine), id(zinc))]
    assert cysteine.metals == cysteine.atoms


def assign_chemistry():
    far = [member("ALA", n, ("CB", "C", 9.0 * n)) for n in (1, 2)]
    draft = of_members(*far)
    draft.stated_bonds = [(("A", "1", "CB"), ("A", "2", "CB"))]
    yield draft, [Kind.BOND_IGNORED]
    assert draft.fragments == []


def report_links():
    cysteine, zinc = member("CYS", 1, ("SG", "S", 0.0)), member("ZN", 9, ZINC, chain="B")
    draft = of_members(cysteine, beside=[zinc])
    draft.links = [Link(cysteine, cysteine.atoms[0], zinc, zinc.atoms[0])]
    yield draft, [Kind.ION_HELD]


def report_hetero():
    yield of_members(member("ALA", 1, ("CA", "C", 0.0)), beside=[member("ZN", 9, ZINC)]), [Kind.KEPT]


def order_parts():
    draft = of_members(member("ALA", 1, ("CA", "C", 0.0)), beside=[member("ZN", 9, ZINC)])
    draft.is_ended = False
    for k, part in enumerate(reversed(draft.parts), 1):
        part.members[0].atoms[0].fraction = k
    yield draft, [Kind.NO_END]
    assert [part.obstacle for part in draft.parts] == [True, False]


def cap_ends():
    made = peptides("GAA")
    draft = of_members(*(Member(r.name, str(k), "", "A", [*r]) for k, r in enumerate(made[0][0], 1)))
    draft.reading = Reading(cap="ends")
    yield draft, [Kind.CAP_AT_END] * 2
    assert [m.name + m.number for m in draft.members] == ["ACE0", "GLY1", "ALA2", "ALA3", "NME4"]
    assert not draft.members[3].atom("OXT")


def list_bonds():
    draft = of_members(member("ALA", 1, ("CB", "C", 0.0)))
    draft.stated_bonds = [(("A", "1", "CB"), ("A", "7", "O"))]
    yield draft, [Kind.BONDS_LEFT_OUT]


def add_heavy_atoms():
    made = peptides("GA")
    members = [Member(r.name, str(k), "", "A", [*r]) for k, r in enumerate(made[0][0], 1)]
    members[1].atoms = [a for a in members[1].atoms if a.name not in ("OXT", "CB")]
    yield of_members(*members), [Kind.ATOMS_ADDED, Kind.OXT_ADDED]
    assert {"OXT", "CB"} <= {a.name for a in members[1].atoms}


def bond_disulfides():
    pair = [member("CYS", n, ("SG", "S", 2.05 * n)) for n in (1, 2)]
    draft = of_members(*pair)
    yield draft, [Kind.BRIDGE]
    assert draft.bridges == [tuple(pair)]


def protonate():
    draft = of_members(*(member("GLY", n, ("N", "N", 4.0 * n), ("CA", "C", 4.0 * n + 1.5)) for n in (1, 2)))
    yield draft, [Kind.HYDROGENS_ADDED]
    assert [template.name for _, template in draft.states] == ["NGLY", "CGLY"]


CASES = (
    build_assembly, choose_model, remove_pseudo_atoms, make_whole, correct_atoms, read_bonds, choose_chains,
    choose_altlocs, split_chains, join_chains, add_poses, choose_hetero, find_links, assign_chemistry,
    report_links, report_hetero, order_parts, cap_ends, list_bonds, add_heavy_atoms, bond_disulfides,
    protonate,
)  # fmt: skip


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_a_pass_yields_what_it_changes(case):
    checks = case()
    draft, expected = next(checks)
    before = [*draft.repairs]
    changes = [*STEPS[case.__name__](draft)]
    assert [each.kind if isinstance(each, Repair) else each for each in changes] == expected
    assert draft.repairs == before
    assert next(checks, None) is None


def test_a_draft_without_a_chain_is_refused():
    draft = Draft("x", "x")
    draft.hetero_residues = [HeteroResidue(member("HOH", 9, ("O", "O", 3.0)), "HOH")]
    with pytest.raises(pc.ProtochainError, match="no protein found, only 1 water; give a file"):
        STEPS["require_chain"](draft)


def test_a_small_molecule_without_chemistry_stays_in_place_and_one_with_it_moves():
    unknown = Part("B", [member("QQQ", 9, ("C1", "C", 3.0), ("C2", "C", 4.5))], evidence=Evidence.SMALL)
    draft = Draft("x", "x", [unknown])
    (told,) = STEPS["parametrise_ligands"](draft)
    assert told.kind is Kind.STAYS_UNKNOWN and not unknown.mobile


def test_ligands_that_move_get_templates_and_hydrogens_at_carbon_and_others_lose_their_chemistry():
    ligand = pc.ligand("CO")
    x = np.arange(18.0).reshape(6, 3)
    ligand = replace(ligand, molecule=replace(ligand.molecule, positions=read_only(x)))
    names, elements = ligand.molecule.names, ligand.molecule.elements.tolist()
    symbols = [gemmi.Element(z).name for z in elements]
    order = [names.index(name) for name in ("C1", "H1", "H2", "H3", "O1", "H4")]
    parts = [
        Part(
            "B", [member("MOH", 9, *((names[k], symbols[k], float("nan")) for k in order))],
            evidence=evidence, ligand=ligand,
        )
        for evidence in (Evidence.CHEMISTRY, Evidence.BONDED)
    ]  # fmt: skip
    draft = Draft("x", "x", parts)
    (told,) = STEPS["assign_ligand_templates"](draft)
    assert told.kind is Kind.BOUND and told.facts["charge"] == "+0"
    assert parts[1].ligand is None and parts[0].members[0].template.hydrogens.keys() == {"C1", "O1"}
    assert not [*STEPS["put_hydrogens"](draft)]
    at = {a.name: a.pos.tolist() for a in parts[0].members[0].atoms}
    assert at["H1"] == pytest.approx(10.0 * x[names.index("H1")]) and np.isnan(at["H4"][0])


def test_the_table_of_evidence_is_that_of_the_code_and_the_role_decides_what_moves():
    rows = [f"| `{each.name}` | {each.role.value} | {each.reason} |" for each in Evidence]
    assert "\n".join(rows) in (ROOT / "CONTRIBUTING.md").read_text()
    for each in Evidence:
        part = Part("A", [], each)
        assert part.obstacle == (each.role is not Role.PROTEIN)
        assert part.mobile == (each.role in (Role.NUCLEIC, Role.GLYCAN, Role.FLEXIBLE))


def test_every_pass_has_a_test():
    tested = {case.__name__ for case in CASES}
    elsewhere = {"require_chain", "parametrise_ligands", "assign_ligand_templates", "put_hydrogens"}
    assert {step.__name__ for step in PASSES} == tested | elsewhere
