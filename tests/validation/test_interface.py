"""Scored interfaces: each column against another program or its definition, and what cannot be scored."""

import copy
import functools
import json
import shutil

import biotite.structure
import gemmi
import mdtraj
import numpy as np
import openmm
import pandas as pd
import pytest
from fixtures.command_line import refusal, run
from fixtures.samples import STRUCTURES, energy, load, shared
from fixtures.tolerances import NATIVE_ENERGY, PACKING_OF_SPHERES, TWIN_AREA
from mdtraj.geometry.sasa import _ATOMIC_RADII
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

import protochain as pc
from protochain.structure import as_structure
from protochain.structure.formats.confidences import Confidence, read_scores
from protochain.structure.select import select, sides, touching_chains
from protochain.validation import CONFIDENCES, MAKEUP, SCORES, interface
from protochain.validation.interface import _unsatisfied_atoms
from protochain.validation.packing import packing

MODEL, BESIDE = "6bj9_model_0.cif.gz", "confidence_6bj9_model_0.json"


@functools.cache
def scored(name, first, second):
    return pc.score_interface(load(name), first, second, energy=energy(name))


def masks(s, *given):
    return [side[s.atom_residue] for side in sides(s, *given)]


@pytest.mark.parametrize(
    ("name", "first", "second"),
    [pytest.param("1ysa.pdb", "C", "D", marks=pytest.mark.slow), ("1ysa.pdb", "C,D", "A,B")],
)
def test_the_energy_is_that_of_the_whole_without_either_side_alone(name, first, second):
    """By OpenMM's Reference platform, of files with the chains of both sides, and of either."""
    s, found = load(name), scored(name, first, second).scores

    def alone(chains):
        mine = pc.load(STRUCTURES / name, chains=chains)
        of = (
            np.isin(s.residue_chain[s.atom_residue], chains.split(","))
            & ~(s.residue_name == "HOH")[s.atom_residue]
        )
        assert np.array_equal(mine.atom_name, s.atom_name[of])
        judge = pc.energy(mine, engine="openmm").reference
        return judge(s.positions[of])[0]

    parts = [alone(f"{first},{second}"), alone(first), alone(second)]
    assert found["energy_kj_mol"] == pytest.approx(
        parts[0] - parts[1] - parts[2], abs=10 * NATIVE_ENERGY * sum(map(abs, parts)) + 1e-6
    )
    terms = ("lennard_jones", "coulomb", "generalised_born", "bonded")
    assert found["interaction_kj_mol"] == pytest.approx(sum(found[f"{name}_kj_mol"] for name in terms))
    assert found["energy_kj_mol"] == pytest.approx(found["interaction_kj_mol"] + found["desolvation_kj_mol"])


def test_terms_are_those_between_two_parts_and_shares_add_up():
    s, found = load("3i40.pdb"), scored("3i40.pdb", "A", "B")
    table = pc.energy_terms(s, between="A,B", energy=energy("3i40.pdb"))
    assert found.scores["interaction_kj_mol"] == pytest.approx(table.loc["interaction", "total"])
    assert found.scores["desolvation_kj_mol"] == pytest.approx(table.loc["desolvation", "total"])
    assert found.shares.sum() == pytest.approx(found.scores["energy_kj_mol"])
    by_residue = pc.energy_terms(s, "residue", between="A,B", energy=energy("3i40.pdb"))["total"]
    its = s.residue_number.tolist(), s.residue_chain.tolist()
    place = {key: k for k, key in enumerate(zip(*its, strict=True))}
    for row in found.residues.itertuples():
        k = place[row.residue, row.chain]
        assert row.interaction_kj_mol == pytest.approx(by_residue[k])
        assert row.energy_kj_mol == found.shares[k]
    for k, side in enumerate(sides(s, "A", "B"), 1):
        assert found.scores[f"energy_{k}_kj_mol"] == pytest.approx(found.shares[side].sum())
    n = found.scores["residues_1"] + found.scores["residues_2"]
    assert found.scores["energy_per_residue_kj_mol"] == pytest.approx(found.scores["energy_kj_mol"] / n)


@pytest.mark.parametrize(
    ("name", "first", "second"),
    [("3i40.pdb", "A", "B"), pytest.param("1ysa.pdb", "C,D", "A,B", marks=pytest.mark.slow)],
)
def test_areas_are_those_of_another_program(name, first, second):
    """Biotite's, with the radii of mdtraj, and five times its points: some per mille of an area."""
    s, found = load(name), scored(name, first, second).scores
    radius = np.array([10.0 * _ATOMIC_RADII[symbol] for symbol in s.atom_element.tolist()])
    one, other = masks(s, first, second)

    def area(mask):
        there = biotite.structure.AtomArray(int(mask.sum()))
        there.coord, there.element = 10.0 * s.positions[mask], s.atom_element[mask]
        its = np.zeros(s.n_atoms)
        its[mask] = biotite.structure.sasa(there, point_number=5000, vdw_radii=radius[mask])
        return its

    heavy = s.atom_element != "H"
    bare = area(one & heavy) + area(other & heavy) - area((one | other) & heavy)
    assert found["buried_heavy_area_angstrom2"] == pytest.approx(bare.sum(), rel=0.005)
    lost = area(one) + area(other) - area(one | other)
    assert found["buried_area_angstrom2"] == pytest.approx(lost.sum(), rel=0.005)
    bears = {i: j for pair in s.bonds.tolist() for i, j in (pair, pair[::-1])}
    of = [bears[k] if s.atom_element[k] == "H" else k for k in range(s.n_atoms)]
    apolar = np.isin(s.atom_element[of], ["C", "S"])
    for k, side in ((1, one), (2, other)):
        for kind, its in (("apolar", apolar), ("polar", ~apolar)):
            key = f"buried_{kind}_{k}_angstrom2"
            assert found[key] == pytest.approx(lost[side & its].sum(), rel=0.01), key


@pytest.mark.parametrize(("name", "first", "second"), [("3i40.pdb", "A", "B"), ("1ysa.pdb", "C,D", "A,B")])
def test_bonds_contacts_and_clashes_are_those_of_their_definitions(name, first, second):
    s, its = load(name), scored(name, first, second)
    found, (one, other) = its.scores, masks(s, first, second)
    x, element, of = 10.0 * s.positions, s.atom_element, s.atom_residue
    both = one | other
    bonds = {
        (d, h, a)
        for d, h, a in mdtraj.baker_hubbard(pc.to_mdtraj(s), periodic=False).tolist()
        if both[d] and both[a]
    }
    across = [(d, a) for d, _, a in bonds if one[d] != one[a]]
    assert found["hydrogen_bonds"] == len(across) > 3
    names = s.residue_name[of]
    plus = np.isin(names, ["ARG", "LYS"]) & (element == "N") & (s.atom_name != "N")
    minus = np.isin(names, ["ASP", "GLU"]) & np.isin(s.atom_name, ["OD1", "OD2", "OE1", "OE2"])
    minus |= np.isin(s.atom_name, ["OP1", "OP2"])
    i, j = np.nonzero(cdist(x[plus], x[minus]) < 4.0)
    p, m = np.flatnonzero(plus)[i], np.flatnonzero(minus)[j]
    crossing = (one[p] & other[m]) | (other[p] & one[m])
    assert found["salt_bridges"] == len({*zip(of[p[crossing]], of[m[crossing]], strict=True)})
    heavy = element != "H"
    a, b = np.flatnonzero(heavy & one), np.flatnonzero(heavy & other)
    i, j = np.nonzero(cdist(x[a], x[b]) < 5.0)
    pairs = {*zip(of[a[i]].tolist(), of[b[j]].tolist(), strict=True)}
    assert found["contacts"] == len(pairs)
    assert found["residues_1"] == len({i for i, _ in pairs})
    assert found["residues_2"] == len({j for _, j in pairs})
    per = 2 * len(pairs) / (found["residues_1"] + found["residues_2"])
    assert found["contacts_per_residue"] == pytest.approx(per)
    clashing = pc.validation.clashes(s).pairs
    assert found["clashes"] == sum(one[i] != one[j] and both[i] and both[j] for i, j in clashing)
    table = its.residues
    for column in ("hydrogen_bonds", "salt_bridges", "clashes", "contacts"):
        assert table[column].sum() == 2 * found[column], column
    assert table["unsatisfied_polar_atoms"].sum() == found["unsatisfied_polar_atoms"]
    assert table["buried_area_angstrom2"].sum() == pytest.approx(found["buried_area_angstrom2"])


def test_unsatisfied_polar_atoms_are_buried_by_the_other_side_and_without_a_bond():
    s, found = load("3i40.pdb"), scored("3i40.pdb", "A", "B")
    one, other = masks(s, "A", "B")
    whole = pc.to_mdtraj(s)
    bonded = mdtraj.baker_hubbard(whole.atom_slice(np.flatnonzero(one | other)), periodic=False)
    bonded = {*np.flatnonzero(one | other)[bonded[:, [0, 2]]].ravel().tolist()}

    def area(mask):
        its = np.zeros(s.n_atoms)
        its[mask] = 100.0 * mdtraj.shrake_rupley(whole.atom_slice(np.flatnonzero(mask)))[0]
        return its

    alone, together = area(one) + area(other), area(one | other)
    count = 0
    for k in np.flatnonzero(np.isin(s.atom_element, ["N", "O"]) & (one | other)).tolist():
        hydrogens = [j for j in s.neighbours[k] if s.atom_element[j] == "H"]
        if s.atom_element[k] == "N" and len(s.neighbours[k]) == 3 and not hydrogens:
            continue
        group = [k, *hydrogens]
        count += together[group].sum() < 1.0 <= alone[group].sum() and k not in bonded
    assert found.scores["unsatisfied_polar_atoms"] == count > 0


def test_equal_spheres_in_a_close_packing_fill_their_known_share():
    """Touching in rows, pi / sqrt(18); apart by a tenth, with holes that no probe enters, as much less."""
    radius = 1.7
    cell = np.array([[0.0, 0.0, 0.0], [0.5, 0.5, 0.0], [0.5, 0.0, 0.5], [0.0, 0.5, 0.5]])
    corners = np.stack(np.meshgrid(*[np.arange(-3, 3)] * 3), axis=-1).reshape(-1, 1, 3)
    for wider in (1.0, 1.1):
        x = wider * 2.0 * np.sqrt(2.0) * radius * (corners + cell).reshape(-1, 3)
        one = x[:, 2] < -1e-9
        size = np.full(len(x), radius)
        found = packing(x[one], size[one], x[~one], size[~one])
        assert found == pytest.approx(np.pi / np.sqrt(18.0) / wider**3, abs=PACKING_OF_SPHERES)


def test_what_the_sides_are_made_of_is_counted():
    """As BindCraft counts, but within 5 angstrom of heavy atoms; secondary structure by another DSSP call."""
    s, its = load("3i40.pdb"), scored("3i40.pdb", "A", "B")
    codes = mdtraj.compute_dssp(pc.to_mdtraj(s))[0]
    row = its.record()
    for k, side in enumerate(sides(s, "A", "B"), 1):
        names = row[f"contact_residues_{k}"].split(",")
        place = np.char.add(s.residue_chain, s.residue_number)
        near = np.isin(place, names) & side
        assert near.sum() == len(names) == its.scores[f"residues_{k}"] > 5
        letters = gemmi.one_letter_code(s.residue_name[near].tolist())
        apolar = sum(letter in "ACFILMPVWY" for letter in letters)
        assert row[f"hydrophobic_percent_{k}"] == pytest.approx(100.0 * apolar / len(names))
        assert row[f"hydrogen_bonds_percent_{k}"] == pytest.approx(100.0 * row["hydrogen_bonds"] / len(names))
        lost = row["unsatisfied_polar_atoms"] / len(names)
        assert row[f"unsatisfied_percent_{k}"] == pytest.approx(100.0 * lost)
        for kind, code in (("helix", "H"), ("sheet", "E"), ("loop", "C")):
            assert row[f"contact_{kind}_percent_{k}"] == pytest.approx(100.0 * (codes[near] == code).mean())
            own = codes[side & np.isin(codes, [*"HEC"])]
            assert row[f"{kind}_percent_{k}"] == pytest.approx(100.0 * (own == code).mean())


def test_nitrogens_of_proline_are_satisfied_without_a_bond():
    """Between residues; at the start of a chain the nitrogen has hydrogens to give."""
    s = pc.from_sequence("PAPA")
    buried = _unsatisfied_atoms(s, np.zeros(s.n_atoms), np.full(s.n_atoms, 50.0), np.empty((0, 3), int))
    found = {(int(s.atom_residue[k]), str(s.atom_name[k])) for k in buried}
    polar = {(r, name) for r in range(4) for name in ("N", "O")} | {(3, "OXT")}
    assert found == polar - {(2, "N")}


def test_of_sides_that_do_not_touch_all_is_nothing():
    s = load("1ysa.pdb")
    away = s.with_positions(s.positions + np.outer((s.residue_chain == "D")[s.atom_residue], [0, 9.0, 0]))
    found = pc.score_interface(away, "C", "D", solvent="vacuum").scores
    for key in (
        "buried_area_angstrom2", "hydrogen_bonds", "salt_bridges", "unsatisfied_polar_atoms", "clashes",
        "contacts", "residues_1", "residues_2",
    ):  # fmt: skip
        assert found[key] == 0, key
    for key in ("shape_complementarity", "energy_per_area_kj_mol_nm2", "contacts_per_residue", "packing"):
        assert found[key] is None, key
    # r^-6 at some 8 nm, of some thousand atoms.
    assert abs(found["lennard_jones_kj_mol"]) < 1e-2
    assert json.loads(json.dumps(dict(found), allow_nan=False)) == found


def test_sides_change_places():
    there, back = scored("3i40.pdb", "A", "B").scores, scored("3i40.pdb", "B", "A").scores
    swapped = {key.replace("_1", "_x").replace("_2", "_1").replace("_x", "_2"): v for key, v in back.items()}
    assert there.keys() == swapped.keys() == {**SCORES, **MAKEUP, **CONFIDENCES}.keys()
    for key, value in there.items():
        assert swapped[key] == (None if value is None else pytest.approx(value)), key


def test_a_ligand_is_a_side_that_the_chains_around_it_do_not_have():
    s = pc.load(STRUCTURES / MODEL)
    ligand = s.residue_chain == "C"
    assert ligand.sum() == 1
    for order in (("A,B,C", "chainID C"), ("chainID C", "A,B,C")):
        found = sides(s, *order)
        one, other = found if order[1] == "chainID C" else found[::-1]
        assert np.array_equal(other, ligand)
        assert np.array_equal(one, np.isin(s.residue_chain, ["A", "B"]))


def test_an_inhibitor_is_scored_in_its_pocket():
    s = pc.load(shared("1hpv_oldformat.pdb"))
    found = pc.score_interface(s, "A,B", "resname 478", solvent="vacuum").scores
    assert found["residues_2"] == 1 and found["contacts"] == found["residues_1"] > 20
    assert found["lennard_jones_kj_mol"] < -200.0 and found["hydrogen_bonds"] > 1
    assert 0.6 < found["shape_complementarity"] < 0.8


@pytest.mark.parametrize(
    ("first", "second", "said"),
    [
        ("A", "Q", "side 'Q' of an interface is no chain.*its chains are A, B"),
        ("A", "A", "A:GLY1 is on both sides"),
        ("A,B", "B", "is on both sides"),
        ("A", "", "side '' of an interface is no chain"),
        ("A", "resname XYZ", "is no chain"),
        ("resid 3 and chainID A", "chainID A", "is on both sides"),
        ("A", "chainID A", "nothing is left of side 'A'"),
        (3, "B", "first 3"),
    ],
)
def test_sides_that_make_no_sense_are_refused(first, second, said):
    with pytest.raises(pc.ProtochainError, match=said):
        pc.score_interface(load("3i40.pdb"), first, second)


def test_what_the_native_engine_cannot_compute_is_refused():
    s = load("3i40.pdb")
    by_openmm = pc.energy(s, engine="openmm")
    assert pc.score_interface(s, "A", "B", energy=by_openmm).scores == pc.score_interface(s, "A", "B").scores
    held = copy.deepcopy(by_openmm.system)
    held.addForce(openmm.CustomExternalForce("x^2"))
    with pytest.raises(pc.ProtochainError, match="by the native engine alone"):
        pc.score_interface(s, "A", "B", energy=pc.energy(s, system=held))


def test_an_interface_of_two_sides_can_be_selected():
    s = load("1ysa.pdb")
    assert np.array_equal(select(s, "interface A,B:C,D"), select(s, "interface C,D:A,B"))
    every, mine = select(s, "interface"), select(s, "interface A:B")
    names = {*s.residue_chain[s.atom_residue[mine]].tolist()}
    assert names == {"A", "B"} and (every | mine == every).all() and mine.sum() < every.sum()
    assert np.array_equal(select(s, "interface A:B and name P"), mine & (s.atom_name == "P"))
    residues = scored("1ysa.pdb", "C", "D").residues
    touching = residues[residues["contacts"] > 0]
    assert len({*s.atom_residue[select(s, "interface C:D")].tolist()}) == len(touching)
    with pytest.raises(pc.ProtochainError, match="side 'Q' of an interface"):
        select(s, "interface A:Q")
    with pytest.raises(pc.ProtochainError, match="side 'Q' of an interface"):
        select(s, "interface A Q and name P")
    assert np.array_equal(select(s, "interface A B and name P"), mine & (s.atom_name == "P"))
    assert select(s, "interface and name P").sum() == (every & (s.atom_name == "P")).sum()


def test_iptm_of_sides_is_the_mean_of_their_chains_both_ways():
    files = [STRUCTURES / BESIDE]
    told = json.loads(files[0].read_text())
    table, given = told["pair_chains_iptm"], read_scores(files)
    chains = [chr(ord("A") + k) for k in range(len(table))]
    assert given.mean_iptm(chains, {"A"}, {"B"}) == pytest.approx(0.5 * (table["0"]["1"] + table["1"]["0"]))
    assert given.mean_iptm(["A", "B"], {"A"}, {"B"}) is None  # Of other chains than the model's.
    assert Confidence(0.7).mean_iptm(["A", "B"], {"A"}, {"B"}) == 0.7
    assert Confidence(0.7).mean_iptm(["A", "B", "C"], {"A"}, {"B"}) is None


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("x.json", '{"iptm": 0.5, "chain_pair_iptm": [[null, 0.4], [0.6, 0.8]]}'),
        ("x.json", '{"iptm": 0.5, "pair_chains_iptm": {"0": {"0": 1, "1": 0.4}, "1": {"0": 0.6, "1": 1}}}'),
        ("x.json", '{"iptm": 0.5, "chain_pair_iptm": {"(A, B)": 0.5}}'),
        ("x.json", '{"iptm": 0.9, "pairwise_iptm": {"A-B": 0.5}}'),
        ("x.npz", None),
    ],
)
def test_confidences_of_each_program_are_read(tmp_path, name, text):
    """Of AlphaFold 3 with a single atom, Boltz, OpenFold 3, ColabFold, Chai."""
    path = tmp_path / name
    if text is None:
        np.savez(path, iptm=np.array([0.5]), per_chain_pair_iptm=np.array([[[0.9, 0.4], [0.6, 0.8]]]))
    else:
        path.write_text(text)
    assert read_scores([path]).mean_iptm("AB", {"A"}, {"B"}) == pytest.approx(0.5)


def test_iptm_of_chains_is_by_the_order_of_the_tokens(tmp_path):
    """A job that lists its ligand first, whose model has it last."""
    summary, full = tmp_path / "x_summary_confidences.json", tmp_path / "x_confidences.json"
    summary.write_text('{"iptm": 0.5, "chain_pair_iptm": [[1, 0.1, 0.2], [0.1, 1, 0.7], [0.2, 0.7, 1]]}')
    assert read_scores([summary]).mean_iptm("ABL", {"A"}, {"B"}) == 0.1
    full.write_text('{"token_chain_ids": ["L", "L", "A", "B", "B"]}')
    assert read_scores([summary, full]).mean_iptm("ABL", {"A"}, {"B"}) == 0.7


def _slowly(path, pae, sides):
    """(ipSAE, pDockQ2, mean error) of two chains, by the definitions, with a loop for each sum."""
    tokens, n = [], 0
    for chain in gemmi.read_structure(str(path))[0]:
        for residue in chain:
            single = gemmi.find_tabulated_residue(residue.name).is_standard()
            frame = next((k for k, atom in enumerate(residue) if atom.name in ("CA", "C1'")), None)
            if frame is not None and len(residue) > 1:
                beta = residue.find_atom("CA" if residue.name == "GLY" else "CB", "*")
                tokens.append((chain.name, n + (0 if single else frame), beta, residue.name))
            n += 1 if single else len(residue)
    assert n == len(pae)
    sae, docking, everything = [], [], []
    for a, b in (sides, sides[::-1]):
        one, other = ([each for each in tokens if each[0] == name] for name in (a, b))
        least = 2.0 if any(len(each[3]) < 3 for each in one + other) else 1.0
        for _, i, *_ in one:
            errors = [pae[i, j] for _, j, *_ in other]
            everything += errors
            errors = [error for error in errors if error < 10.0]
            d0 = 1.24 * (len(errors) - 15) ** (1 / 3) - 1.8 if len(errors) > 26 else 1.0
            d0 = max(d0, least)
            sae.append(sum(1 / (1 + (error / d0) ** 2) for error in errors) / max(len(errors), 1))
        total, count, seen = 0.0, 0, {}
        for _, i, first, _ in one:
            for _, j, second, _ in other:
                if first and second and first.pos.dist(second.pos) <= 8.0:
                    total, count = total + 1 / (1 + (pae[i, j] / 10.0) ** 2), count + 1
                    seen |= {i: first.b_iso, j: second.b_iso}
        if count:
            x = sum(seen.values()) / len(seen) * total / count
            docking.append(1.31 / (1 + np.exp(-0.075 * (x - 84.733))) + 0.005)
    return max(sae), max(docking, default=0.0), sum(everything) / len(everything)


@pytest.mark.parametrize("name", ["3i40.pdb", "1ysa.pdb"])
def test_scores_from_errors_are_those_of_their_definitions(tmp_path, name):
    """Two chains of protein, and one at DNA, of a job that lists a ligand first."""
    structure, rng = gemmi.read_structure(str(STRUCTURES / name)), np.random.default_rng(7)
    structure.remove_alternative_conformations()
    structure.remove_waters()
    model, sides_named = structure[0], {"3i40.pdb": ("A", "B"), "1ysa.pdb": ("A", "C")}[name]
    for atom in [place.atom for place in model.all()]:
        atom.b_iso = rng.uniform(60.0, 99.0)
    if name == "3i40.pdb":
        model["A"][3].name = "XYZ"  # Modified: a token for each atom.
    ligand = gemmi.Chain("Z")
    ligand.add_residue(gemmi.read_structure(str(STRUCTURES / "1l2y.pdb"))[0]["A"][0])
    ligand[0].name, ligand[0].het_flag = "QQQ", "H"
    model.add_chain(ligand, 0)
    structure.remove_hydrogens()
    path = tmp_path / "x_model_0.cif"
    structure.setup_entities()
    structure.make_mmcif_document().write_file(str(path))
    n = sum(
        1 if gemmi.find_tabulated_residue(residue.name).is_standard() else len(residue)
        for chain in gemmi.read_structure(str(path))[0] for residue in chain
    )  # fmt: skip
    pae = rng.uniform(0.3, 14.0, (n, n))
    np.savez(tmp_path / "pae_x_model_0.npz", pae=pae)
    found = pc.score_interface(path, *sides_named, solvent="vacuum").scores
    sae, docking, mean = _slowly(path, pae, sides_named)
    assert found["ipsae"] == pytest.approx(sae, rel=1e-12)
    assert found["pdockq2"] == pytest.approx(docking, rel=1e-6)
    assert found["pae_angstrom"] == pytest.approx(mean, rel=1e-12)


@pytest.mark.parametrize(
    "text",
    [
        "", "[]", "{}", '{"iptm": "x"}', '{"iptm": 1, "chain_pair_iptm": [[1, 2]]}',
        '{"iptm": 1, "chain_pair_iptm": [["x"]]}', '{"chain_pair_iptm": {"(A, B)": "x"}}', "[" * 100_000,
    ],
    ids=range(8),
)  # fmt: skip
def test_confidences_that_cannot_be_read_are_none(tmp_path, text):
    (tmp_path / "x.json").write_text(text)
    assert read_scores([tmp_path / "x.json"]) == Confidence(None)
    assert read_scores([]) is None


def test_a_model_has_its_confidences():
    for name in (MODEL, BESIDE):
        assert (STRUCTURES / name).exists()
    s = load(MODEL)
    found = pc.score_interface(STRUCTURES / MODEL, "A", "B", solvent="vacuum")
    x, of = 10.0 * s.positions, s.atom_residue
    beta = np.where(s.residue_name[of] == "GLY", s.atom_name == "CA", s.atom_name == "CB") & ~s.kept
    one, other = (np.flatnonzero(beta & (s.residue_chain[of] == name)) for name in "AB")
    i, j = np.nonzero(cdist(x[one], x[other]) <= 8.0)
    heavy = s.atom_element != "H"
    plddt = np.array([s.b_factor[heavy & (of == r)].mean() for r in range(s.n_residues)])
    mean = plddt[of[np.concatenate([np.unique(one[i]), np.unique(other[j])])]].mean()
    expected = 0.724 / (1 + np.exp(-0.052 * (mean * np.log10(len(i)) - 152.611))) + 0.018
    assert found.scores["pdockq"] == pytest.approx(expected)
    touching = np.unique(of[select(s, "interface A:B")])
    assert found.scores["interface_plddt"] == pytest.approx(plddt[touching].mean())
    assert found.scores["iptm"] == pytest.approx(0.962, abs=1e-3)
    assert scored("3i40.pdb", "A", "B").scores["iptm"] is None


def test_confidences_of_0_to_1_are_those_of_0_to_100(tmp_path):
    found = []
    for scale in (1.0, 0.01):
        s = gemmi.read_structure(str(STRUCTURES / "3i40.pdb"))
        for k, place in enumerate(s[0].all()):
            place.atom.b_iso = scale * (60 + k % 39)
        path = tmp_path / f"{scale}_model_0.cif"
        s.setup_entities()
        s.make_mmcif_document().write_file(str(path))
        (tmp_path / f"confidence_{scale}_model_0.json").write_text("{}")
        found.append(pc.score_interface(path, "A", "B", solvent="vacuum").scores)
    for name in ("interface_plddt", "pdockq"):
        assert found[0][name] == pytest.approx(found[1][name], rel=1e-6)
    assert 50.0 < found[0]["interface_plddt"] < 100.0


@pytest.fixture
def three(tmp_path):
    for name in ("3i40.pdb", "1ysa.pdb", "1l2y.pdb"):
        shutil.copy(STRUCTURES / name, tmp_path)
    return tmp_path


def test_a_table_of_many_is_ranked_and_one_chain_is_told(three, capsys):
    csv, residues, page = (three / name for name in ("a.csv", "r.csv", "p.html"))
    out = ["--csv", csv, "--residues", residues, "--report", page, "--solvent", "vacuum", "--json"]
    status = run("score", three / "1l2y.pdb", three / "3i40.pdb", three / "1ysa.pdb", "--rank",
                 "buried_area_angstrom2", *out)  # fmt: skip
    said, errors = capsys.readouterr()
    told = json.loads(said)["results"]
    assert status == 4 and "no two of its chains are in contact" in errors
    done = [row for row in told if not row["message"]]
    assert len(done) == 1 + len(touching_chains(load("1ysa.pdb"))) and told[-1]["message"]
    areas = [row["buried_area_angstrom2"] for row in done]
    assert areas == sorted(areas, reverse=True)
    table = pd.read_csv(csv)
    assert table["interface"].tolist()[:-1] == [row["interface"] for row in done]
    assert {*SCORES} <= {*table.columns}
    rows = pd.read_csv(residues, dtype={"residue": str})
    sums = rows.groupby(["file", "interface"])["buried_area_angstrom2"].sum()
    for row in done:
        assert sums[row["file"], row["interface"]] == pytest.approx(row["buried_area_angstrom2"])
    assert "3i40.pdb A:B" in page.read_text()


def test_frames_are_scored_and_their_sides_compared_with_a_reference(three, capsys):
    """As they are; a side moved by 2 angstrom; both turned and moved as one; a side five per cent larger."""
    s = load("3i40.pdb")
    other = masks(s, "A", "B")[1]
    turned = Rotation.from_rotvec([0.3, 0.1, 0.2]).apply(s.positions.copy())
    turned += [1.0, -2.0, 0.5]
    larger = np.where(other[:, None], 1.05 * s.positions, s.positions)
    x = np.array([s.positions, s.positions + np.outer(other, [0.0, 0.2, 0.0]), turned, larger])
    np.savez(three / "f.npz", positions=x, unit="nm")
    out = three / "scored.csv"
    given = ["--trajectory", three / "f.npz", "--reference", three / "3i40.pdb", "--solvent", "vacuum"]
    assert run("score", three / "3i40.pdb", *given, "--csv", out, "--workers", "1") == 0
    table = pd.read_csv(out)
    assert table["interface"].tolist() == ["A:B"] * 4
    alpha = np.isin(np.arange(s.n_atoms), s.alpha_carbons) & other
    moved = np.sqrt(np.mean(np.sum((0.5 * s.positions[alpha]) ** 2, axis=1)))
    own = pc.rmsd(s, s.with_positions(larger), measure="name CA and chainID B", align="name CA and chainID B")
    for key, its in (
        ("hotspot_rmsd", [0, 2, 0, moved]), ("ca_rmsd_1", [0, 0, 0, 0]), ("ca_rmsd_2", [0, 0, 0, own]),
    ):  # fmt: skip
        assert table[f"{key}_angstrom"].to_numpy() == pytest.approx(its, abs=2e-3)
    for k in range(2):
        its = pc.score_interface(s.with_positions(x[k]), "A", "B", solvent="vacuum").record()
        for key in ("energy_kj_mol", "packing", "hydrogen_bonds", "contact_residues_2"):
            assert table[key][k] == (its[key] if isinstance(its[key], str) else pytest.approx(its[key]))
    assert table["energy_kj_mol"][2] == pytest.approx(table["energy_kj_mol"][0], rel=1e-4)
    capsys.readouterr()
    several = ["--interface", "A:B", "--interface", "B:A"]
    assert "give one interface" in refusal("score", three / "3i40.pdb", *given[:2], *several)


def test_a_complex_that_overlaps_is_relaxed_and_deviates_from_its_reference(three, capsys):
    s = load("3i40.pdb")
    one, other = masks(s, "A", "B")
    way = s.positions[one].mean(0) - s.positions[other].mean(0)
    x = s.positions + np.outer(other, 0.2 * way / np.linalg.norm(way))
    pc.save(s.with_positions(x), three / "near.pdb")
    rows = []
    for more in ((), ("--relax", "--reference", three / "3i40.pdb")):
        run("score", three / "near.pdb", "--interface", "A:B", "--solvent", "vacuum", "--json", *more)
        rows.append(json.loads(capsys.readouterr().out)["results"][0])
    assert rows[0]["clashes"] > 20 > rows[1]["clashes"]
    assert rows[1]["energy_kj_mol"] < 0.0 < rows[0]["energy_kj_mol"]
    assert 0.5 < rows[1]["hotspot_rmsd_angstrom"] < 2.5 and rows[1]["ca_rmsd_2_angstrom"] < 1.0
    np.savez(three / "near.npz", positions=x[None], unit="nm")
    given = (
        "--trajectory", three / "near.npz", "--interface", "A:B", "--solvent", "vacuum", "--workers", "1",
    )  # fmt: skip
    run("score", three / "3i40.pdb", *given, "--relax", "--csv", three / "near.csv")
    assert pd.read_csv(three / "near.csv")["clashes"].item() < 20


@pytest.mark.parametrize("given", ["A", "A:Q", "", ":", "A:B:C"])
def test_interfaces_that_cannot_be_read_are_told(three, given, capsys):
    assert run("score", three / "3i40.pdb", "--interface", given) == 2
    said = capsys.readouterr().err
    assert "interface" in said and said.count("\n") == 1
    run("score", three / "3i40.pdb", three / "1ysa.pdb", "--interface", given, "--workers", "1")
    said = capsys.readouterr().err.splitlines()
    assert [line.split(": ")[0] for line in said] == [str(three / "3i40.pdb"), str(three / "1ysa.pdb")]


def test_an_atom_in_the_place_of_another_adds_no_area():
    """mdtraj would end the process."""
    s = load("3i40.pdb")
    at = int(np.flatnonzero(masks(s, "A", "B")[1] & (s.atom_element == "C"))[0])
    twin = next(k for k in s.neighbours[at] if s.atom_element[k] == "C")
    x = np.array([s.positions, s.positions])
    x[:, twin] = x[:, at] + [[0.0, 0.0, 0.0], [2e-4, 0.0, 0.0]]
    areas = [
        pc.score_interface(s.with_positions(each), "A", "B").scores["buried_area_angstrom2"] for each in x
    ]
    assert areas[0] == pytest.approx(areas[1], abs=TWIN_AREA)


def test_a_file_is_prepared_for_the_force_field_that_scores_it(monkeypatch):
    """A residue of the user's force field is known only to a preparation with it."""
    seen = []

    def prepare(source, **settings):
        seen.append(settings)
        return as_structure(source, **settings)

    monkeypatch.setattr(interface, "as_structure", prepare)
    for given in ({}, {"forcefield": "charmm36", "solvent": "vacuum"}):
        pc.score_interface(STRUCTURES / "3i40.pdb", "A", "B", **given, ph=6.0)
    assert seen == [{"ph": 6.0}, {"forcefield": "charmm36", "ph": 6.0}]
