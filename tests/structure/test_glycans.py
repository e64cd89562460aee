"""Glycans that move, by GLYCAM-06j."""

import functools
import re
from itertools import product
from pathlib import Path

import gemmi
import numpy as np
import openmm
import pytest
from fixtures.components import read_columns
from fixtures.oracles import assert_equals_reference
from fixtures.samples import ROOT, STRUCTURES
from fixtures.tolerances import GEOMETRY_NM, SAME_KERNEL
from openmm import app, unit
from scipy.spatial.transform import Rotation

import protochain as pc
from protochain.ligands import dictionary
from protochain.structure.molecule.chirality import changed_stereocentres, chiral_atoms, volume
from protochain.structure.molecule.repairs import Kind
from protochain.structure.molecule.sugars import SUGARS, anomeric_carbon, glycam_names, sugar_centres

COMPLEXES = ROOT.parent / "shared" / "complexes"
pytest.importorskip("biotite.structure.info")


def shared(name):
    if not (COMPLEXES / name).exists():
        pytest.skip(f"{name} is not here")
    return COMPLEXES / name


@pytest.fixture(scope="module")
def fc():
    """A chain of an antibody, with a glycan of eight sugars and two branches."""
    return pc.load(shared("models/3ave.pdb"), chains="A,C", keep="NAG,BMA,MAN,FUC")


def borne(tmp_path, atom, sugar, change=lambda model: None, stated=True):
    """Ubiquitin with a sugar of the dictionary on an atom, as ``20 OG``, where it is farthest from others."""
    number, name = atom.split()
    whole = gemmi.read_structure(str(STRUCTURES / "1ubq.pdb"))
    whole.remove_waters()
    residue = next(each for each in whole[0]["A"] if each.seqid.num == int(number))
    own = dictionary.component(sugar)
    at = dict(zip(own.atom_name.tolist(), np.array(own.coord, dtype=float), strict=True))
    at = {each: x for each, x in at.items() if each[0] != "H"}
    carbon = anomeric_carbon(sugar)
    leaving = at.pop(f"O{carbon[1]}") - at[carbon]
    o, beta, alpha = (np.array(residue[each][0].pos.tolist()) for each in (name, "CB", "CA"))
    axis = (beta - o) / np.linalg.norm(beta - o)
    across = np.cross(axis, alpha - beta)
    out = Rotation.from_rotvec(np.deg2rad(113.0) * across / np.linalg.norm(across)).apply(axis)
    others = np.array(
        [a.pos.tolist() for r in whole[0]["A"] for a in r if r is not residue or a.name != name]
    )
    best = (-1.0, dict[str, np.ndarray]())
    for psi, phi in product(np.deg2rad(np.arange(0.0, 360.0, 30.0)), repeat=2):
        way = Rotation.from_rotvec(psi * axis).apply(out)
        turned = Rotation.from_rotvec(phi * way) * Rotation.align_vectors([-way], [leaving])[0]
        x = {each: o + 1.43 * way + turned.apply(y - at[carbon]) for each, y in at.items()}
        room = min(float(np.linalg.norm(others - y, axis=1).min()) for y in x.values())
        best = max(best, (room, x), key=lambda each: each[0])
    made = gemmi.Residue()
    made.name, made.seqid, made.het_flag = sugar, gemmi.SeqId(1, " "), "H"
    for each, x in best[1].items():
        new = gemmi.Atom()
        new.name, new.element, new.pos, new.occ = each, gemmi.Element(each[0]), gemmi.Position(*x), 1.0
        made.add_atom(new)
    chain = gemmi.Chain("S")
    chain.add_residue(made)
    whole[0].add_chain(chain)
    change(whole[0])
    if stated:
        link = gemmi.Connection()
        link.type, link.name = gemmi.ConnectionType.Covale, "covale1"
        link.partner1 = gemmi.AtomAddress("A", residue.seqid, residue.name, name)
        link.partner2 = gemmi.AtomAddress("S", made.seqid, whole[0]["S"][0].name, carbon)
        whole.connections.append(link)
    path = Path(tmp_path) / "borne.pdb"
    whole.write_pdb(str(path))
    return path


def told(structure, kind):
    return [each for each in structure.repairs if each.kind is kind]


@functools.cache
def full_names():
    """Names of sugars."""
    keys, names = read_columns("chem_comp", "id", "name")
    return {key: name for key, name in zip(keys.tolist(), names.tolist(), strict=True) if key in SUGARS}


@pytest.mark.parametrize("name", SUGARS)
def test_configurations_are_those_of_the_chemical_component_dictionary(name):
    own = dictionary.component(name)
    at = dict(zip(own.atom_name.tolist(), np.array(own.coord, dtype=float), strict=True))
    for centre, ends in sugar_centres(SUGARS[name]).items():
        assert volume(np.array([at[each] for each in (centre, *ends)])) > 0.5, centre
    said = full_names()[name]
    anomer, side = ("alpha", "beta")[SUGARS[name][1] == "B"], ("D", "L")[SUGARS[name][0].islower()]
    assert anomer in said and (f"-{side}-" in said or "neuraminic" in said)


@pytest.mark.parametrize("name", SUGARS)
def test_heavy_atoms_and_hydrogens_are_named_as_in_the_dictionary(name):
    from protochain.structure.molecule.member import Member
    from protochain.structure.preparation.glycans import _template

    template = _template(Member(name, "1", "", "S", []), f"0{SUGARS[name]}")
    own = set(dictionary.component(name).atom_name.tolist())
    # A link takes the place of a hydroxyl; acids have lost their proton.
    leaving = f"O{anomeric_carbon(name)[1]}"
    assert {*template.element} == own - {leaving, f"H{leaving}", "HO6B", "HO1B"}
    assert not {*glycam_names(name).values()} & {*template.element}


@functools.cache
def glycam(solvent):
    files = ["amber14/protein.ff14SB.xml", "amber14/GLYCAM_06j-1.xml", "amber14/tip3p.xml"]
    return app.ForceField(*files, *([f"implicit/{solvent}.xml"] if solvent != "vacuum" else []))


def by_glycam(structure, solvent):
    """Potential energy, kJ/mol, as OpenMM's own matching by names has it, from a topology made here."""
    topology, atoms, order = app.Topology(), {}, []
    free = {k for tie in structure.ties for k in tie.atoms} | {*np.flatnonzero(structure.obstacle).tolist()}
    assert not free
    bearing = {int(structure.atom_residue[i]) for i, _ in structure.links if not structure.kept[i]}
    for chain in structure.topology.chains():
        new = topology.addChain(chain.id)
        for residue in chain.residues():
            name = structure.glycans.get(residue.index, residue.name)
            if residue.index in bearing:
                name = {"ASN": "NLN", "SER": "OLS", "THR": "OLT"}[name]
            name, _, hydroxyl = name.partition("-")
            # GLYCAM's reducing ends have their hydroxyl in a residue of its own.
            own = [a for a in residue.atoms() if not hydroxyl or a.name not in ("O1", "HO1")]
            pieces = [(name, own), (hydroxyl, [a for a in residue.atoms() if a not in own])]
            for its, members in pieces[: 2 if hydroxyl else 1]:
                made = topology.addResidue(its, new)
                for atom in members:
                    atoms[atom.index] = topology.addAtom(atom.name, atom.element, made)
                    order.append(atom.index)
    for i, j in structure.bonds.tolist():
        topology.addBond(atoms[i], atoms[j])
    system = glycam(solvent).createSystem(topology, nonbondedMethod=app.NoCutoff)
    context = openmm.Context(
        system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatformByName("Reference")
    )
    context.setPositions(structure.positions[order])
    return context.getState(getEnergy=True).getPotentialEnergy().value_in_unit(unit.kilojoule_per_mole)


@pytest.mark.parametrize(("atom", "sugar"), [("20 OG", "A2G"), ("12 OG1", "NGA")])
def test_the_energy_is_that_of_openmm_by_names(tmp_path, atom, sugar):
    s = pc.load(borne(tmp_path, atom, sugar))
    assert s.glycans == {76: f"0{SUGARS[sugar]}"} and not s.ties and s.mobile.sum() == 28
    for solvent in ("vacuum", "gbn2"):
        energy = pc.energy(s, solvent=solvent, engine="native", threads=1)
        assert energy(s.positions)[0] == pytest.approx(by_glycam(s, solvent), rel=SAME_KERNEL)


def test_branched_glycans_have_the_energy_of_the_reference_platform(fc):
    assert sorted(fc.glycans.values()) == ["0YB", "0YB", "0fA", "2MA", "2MA", "4YB", "UYB", "VMB"]
    energy = pc.energy(fc, solvent="obc2", engine="native", threads=1)
    assert energy(fc.positions)[0] == pytest.approx(by_glycam(fc, "obc2"), rel=SAME_KERNEL)


def cut(tmp_path, change):
    """Chains A and C of the antibody after a change."""
    whole = gemmi.read_structure(str(shared("models/3ave.pdb")))
    whole.remove_waters()
    for name in "BD":
        whole[0].remove_chain(name)
    change(whole[0])
    path = Path(tmp_path) / "cut.pdb"
    whole.write_pdb(str(path))
    return path


def _between(first, last):
    def change(model):
        for chain, low, high in (("A", first, last), ("C", 1, 2)):
            for k in range(len(model[chain]) - 1, -1, -1):
                if not low <= model[chain][k].seqid.num <= high:
                    del model[chain][k]

    return change


@pytest.mark.parametrize(("first", "last"), [(285, 297), (297, 310)])
def test_a_residue_at_the_end_of_a_chain_bears_a_glycan(tmp_path, first, last):
    s = pc.load(cut(tmp_path, _between(first, last)))
    assert [*s.glycans.values()] == ["4YB", "0YB"]
    energy = pc.energy(s, solvent="vacuum", engine="native", threads=1)
    assert energy(s.positions)[0] == pytest.approx(by_glycam(s, "vacuum"), rel=SAME_KERNEL)


def _freed(model):
    """Asparagine 297 and its neighbours gone; a hydroxyl in place of its amide."""
    at = model["A"]["297"][0]["ND2"][0].pos
    oxygen = gemmi.Atom()
    oxygen.name, oxygen.element, oxygen.pos, oxygen.occ = "O1", gemmi.Element("O"), at, 1.0
    model["C"][0].add_atom(oxygen)
    for k in range(len(model["A"]) - 1, -1, -1):
        if not 240 <= model["A"][k].seqid.num <= 285:
            del model["A"][k]


def test_sugars_without_a_protein_have_their_hydroxyl(tmp_path):
    s = pc.load(cut(tmp_path, _freed), keep="NAG,BMA,MAN,FUC")
    assert s.glycans[min(s.glycans)] == "UYB-ROH" and len(s.glycans) == 8 and not s.ties
    assert {"O1", "HO1"} <= {*s.atom_name[s.atom_residue == min(s.glycans)].tolist()}
    assert len(told(s, Kind.SACCHARIDE)) == 1 and not s.obstacle.any()
    energy = pc.energy(s, solvent="obc2", engine="native", threads=1)
    assert energy(s.positions)[0] == pytest.approx(by_glycam(s, "obc2"), rel=SAME_KERNEL)
    chain = pc.build_chain(s)
    assert len({*chain.atom_body[s.mobile].tolist()}) == 1
    assert sum(hinge.kind == "torsion" for hinge in pc.build_chain(s, "phi psi glycan").hinges) == 16


def test_a_glycan_and_its_residue_have_a_whole_charge(fc):
    system = pc.energy(fc).system  # held here: OpenMM frees its forces with it
    (force,) = (f for f in system.getForces() if isinstance(f, openmm.NonbondedForce))
    charge = np.array([force.getParticleParameters(i)[0]._value for i in range(fc.n_atoms)])
    its = fc.mobile | (fc.atom_residue == fc.atom_residue[fc.links[0, 0]])
    assert charge[its].sum() == pytest.approx(0.0, abs=1e-9)


def test_a_glycan_is_relaxed_and_read_again_as_it_is(fc, tmp_path):
    result = pc.relax(fc, threads=1)
    assert result.status == "converged" and not changed_stereocentres(fc, result.x, fc.positions)
    assert {*fc.glycans} <= {*fc.atom_residue[chiral_atoms(fc)[:, 0]].tolist()}
    for i, j in fc.links.tolist():
        assert 0.139 < np.linalg.norm(result.x[i] - result.x[j]) < 0.150
    record = result.record()
    assert record["clashscore_per_1000_atoms_end"] == 0.0 and record["overlaps_end"] == 0
    for suffix in (".cif", ".pdb"):
        path = tmp_path / f"out{suffix}"
        pc.save(result, path)
        again = pc.load(path)
        assert again.glycans == fc.glycans and np.array_equal(again.atom_name, fc.atom_name)
        assert np.array_equal(again.bonds, fc.bonds) and np.array_equal(again.links, fc.links)
        assert not told(again, Kind.OTHER_ANOMER) and not told(again, Kind.SUGAR_INVERTED)


def test_an_overlap_is_no_bond_of_a_sugar_and_is_parted(tmp_path):
    s = pc.load(borne(tmp_path, "7 OG1", "SIA"))
    assert [*s.glycans.values()] == ["0SA"]
    record = pc.relax(s, threads=1).record()
    assert record["overlaps_start"] > 5 and record["overlaps_end"] == 0


def test_a_result_is_tied_where_the_force_field_has_no_sugars(tmp_path):
    s = pc.load(borne(tmp_path, "60 ND2", "NAG"))
    for suffix in (".cif", ".pdb"):
        pc.save(s, tmp_path / f"out{suffix}")
        again = pc.load(tmp_path / f"out{suffix}", forcefield="charmm36")
        assert np.array_equal(again.links, s.links) and again.obstacle.sum() == s.mobile.sum()
        assert [tie.atoms for tie in again.ties if len(tie.atoms) == 2] == [tuple(s.links[0].tolist())]


def test_links_that_the_file_does_not_state_are_found_by_their_geometry(fc):
    whole = gemmi.read_structure(str(shared("models/3ave.pdb")))
    del whole.connections[:]
    found = pc.as_structure(whole, chains="A,C", keep="NAG,BMA,MAN,FUC")
    assert found.glycans == fc.glycans and np.array_equal(found.bonds, fc.bonds)


def test_links_of_sugars_turn_with_hinges_of_glycans(fc):
    chain = pc.build_chain(fc, "glycan")
    # By hand: one to asparagine, two each to O2, O3 and O4 of five sugars, three each to O6 of two.
    bonds = [frozenset(fc.atom_name[[*hinge.on_axis]].tolist()) for hinge in chain.hinges]
    assert len(bonds) == 1 + 5 * 2 + 2 * 3 and bonds.count(frozenset(("C6", "C5"))) == 2
    result = pc.minimise(chain, method="lbfgs", max_evaluations=30)
    moved = np.linalg.norm(result.x - fc.positions, axis=1)
    assert moved[~fc.kept].max() < GEOMETRY_NM and moved[fc.mobile].max() > 1e-3
    for r in fc.glycans:
        ring = np.flatnonzero(
            (fc.atom_residue == r) & np.isin(fc.atom_name, ["C1", "C2", "C3", "C4", "C5", "O5"])
        )
        apart = [np.linalg.norm(x[ring][:, None] - x[ring], axis=2) for x in (fc.positions, result.x)]
        assert np.abs(apart[0] - apart[1]).max() < GEOMETRY_NM
    i, j = fc.bonds.T
    lengths = [np.linalg.norm(x[i] - x[j], axis=1) for x in (fc.positions, result.x)]
    assert np.abs(lengths[0] - lengths[1]).max() < GEOMETRY_NM


def _epimer(model):
    """The oxygen and the hydrogen at C4 exchanged: galactose has the other."""
    residue = model["S"][0]
    x = {name: np.array(residue[name][0].pos.tolist()) for name in ("C3", "C4", "C5", "O4")}
    arms = [(x[name] - x["C4"]) / np.linalg.norm(x[name] - x["C4"]) for name in ("C3", "C5", "O4")]
    way = -sum(arms)
    residue["O4"][0].pos = gemmi.Position(*(x["C4"] + 1.43 * way / np.linalg.norm(way)))


def test_a_sugar_of_another_hand_is_named_and_turned_right(tmp_path):
    s = pc.load(borne(tmp_path, "60 ND2", "NAG", _epimer))
    (repair,) = told(s, Kind.SUGAR_INVERTED)
    assert repair.facts["atoms"] == ("C4",) and repair.facts["residue"].name == "NAG"
    result = pc.relax(s, threads=1)
    assert any(
        re.search(r"C4 of \w*:?NAG1\b", each) for each in changed_stereocentres(s, result.x, s.positions)
    )


def test_of_two_anomers_a_sugar_is_that_which_its_atoms_are(tmp_path):
    def called_alpha(model):
        model["S"][0].name = "NDG"

    s = pc.load(borne(tmp_path, "60 ND2", "NAG", called_alpha))
    assert [*s.glycans.values()] == ["0YB"] and s.residue_name[-1] == "NDG"
    assert [each.facts["residue"].name for each in told(s, Kind.OTHER_ANOMER)] == ["NDG"]
    assert not told(s, Kind.SUGAR_INVERTED)
    named = pc.load(borne(tmp_path, "60 ND2", "NAG"))
    assert pc.energy(s)(s.positions)[0] == pc.energy(named)(named.positions)[0]


def _without_o6(model):
    residue = model["S"][0]
    del residue[[a.name for a in residue].index("O6")]


def _unknown(model):
    model["S"][0].name = "QQQ"


@pytest.mark.parametrize(
    ("change", "forcefield", "word"),
    [(_without_o6, None, "O6"), (lambda model: None, "charmm36", "amber14"), (_unknown, None, "")],
)
def test_what_glycam_does_not_know_is_tied_and_said(tmp_path, change, forcefield, word):
    s = pc.load(borne(tmp_path, "60 ND2", "NAG", change), forcefield=forcefield)
    assert not s.mobile.any() and s.obstacle.any() and not s.glycans
    assert sum(len(tie.atoms) == 2 for tie in s.ties) == 1
    stays = told(s, Kind.NO_PARAMETERS)
    assert len(stays) == 1 and word in str(stays[0])
    assert_equals_reference(pc.energy(s, forcefield or "amber14", engine="native"), s.positions)


def test_a_link_that_glycam_does_not_know_has_the_parameters_of_small_molecules(tmp_path):
    s = pc.load(borne(tmp_path, "59 OH", "MAN"))
    assert not s.glycans and s.mobile.any() and not s.obstacle.any()
    (link,) = told(s, Kind.LINKED)
    assert "OH of A:TYR59" in str(link)
    assert_equals_reference(pc.energy(s, engine="native"), s.positions)


def test_another_force_field_is_refused_with_the_remedy(tmp_path):
    s = pc.load(borne(tmp_path, "60 ND2", "NAG"))
    with pytest.raises(pc.ProtochainError, match=r"S:NAG1 .* GLYCAM-06j.* load"):
        pc.energy(s, "charmm36")


def test_a_file_without_links_has_the_glycans_of_the_file_with_them(tmp_path):
    path = shared("models/3ave.pdb")
    (tmp_path / "bare.pdb").write_text(re.sub(r"(?m)^(LINK|CONECT|SSBOND).*\n", "", path.read_text()))
    whole, bare = pc.load(path), pc.load(tmp_path / "bare.pdb")
    assert np.array_equal(bare.bonds, whole.bonds) and np.array_equal(bare.mobile, whole.mobile)
    assert whole.mobile.sum() > 300 and np.array_equal(bare.atom_name, whole.atom_name)
