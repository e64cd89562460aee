"""Metal complexes, clusters and bonds of metals: charges, what moves, distances that springs hold."""

import csv
import functools
from pathlib import Path

import gemmi
import numpy as np
import openmm
import pytest
from fixtures.samples import STRUCTURES, shared
from fixtures.tolerances import READ_AGAIN, SUM_OF_CHARGES, TIED_ANGSTROM
from scipy.spatial.transform import Rotation

import protochain as pc
from protochain.ligands.dictionary import component
from protochain.minimisers.verdict import _changed_metal_bonds
from protochain.structure.molecule.repairs import Kind

CASES = "../cases/metals5"
METALS = ("Fe", "Mg", "Co", "Ni", "Zn", "Mn")
"""Of complexes that move."""
CHARGES = {
    "sod_bridge": 2, "hem_his_CN": -3, "cispt_link": 2, "dna5_first_incomplete": -4, "sf4": -2, "hem_his": -2,
    "nco": 3, "mgatp2": -2, "bluecu": 1,
}  # fmt: skip
"""Charge of each case: a cyanide more than ``hem_his``; Mg2+ and ATP 4-; Cu2+ and a thiolate."""
HELD = {
    "hem_his_CN": ("C", "FE", 1.95), "cispt_link": ("N7", "PT1", 2.0), "mgatp2": ("O1B", "MG", 2.08),
    "bluecu": ("SD", "CU", 2.80), "sf4": ("SG", "FE1", 2.3), "sod_bridge": ("NE2", "CU", 2.1),
    "hem_his": ("NE2", "FE", 2.05),
}  # fmt: skip
"""A bond of each case that a spring is to hold, and its length in the file."""
MORE = {"hem_his", "NBN", "6MO", "MOM"}
"""Kinds like others, for the slow tests."""


@functools.cache
def case(name):
    """A structure of the collection, prepared once."""
    return pc.load(shared(f"{CASES}/{name}.pdb"), keep="all")


def charge_of(structure, residue_name=""):
    """Sum of the charges of a structure, or of its residues of one name."""
    energy = pc.energy(structure, engine="openmm")  # Its system owns the forces.
    (force,) = (each for each in energy.system.getForces() if isinstance(each, openmm.NonbondedForce))
    chosen = structure.residue_name[structure.atom_residue] == residue_name
    atoms = np.flatnonzero(chosen) if residue_name else range(structure.n_atoms)
    return sum(force.getParticleParameters(int(k))[0]._value for k in atoms)


def tied(structure, x):
    """Names of the atoms of each spring of a distance, its rest and the distance at x, angstrom."""
    pairs = [tie for tie in structure.ties if len(tie.atoms) == 2]
    return [
        (
            *structure.atom_name[[*tie.atoms]].tolist(),
            10.0 * tie.rest,
            10.0 * np.linalg.norm(np.diff(x[[*tie.atoms]], axis=0)),
        )
        for tie in pairs
    ]


def with_component(tmp_path, name):
    """Decaalanine and the heavy atoms of a component of the dictionary, 4 nm away."""
    made = component(name)
    lines = [line for line in (STRUCTURES / "ala10.pdb").read_text().splitlines() if line[:4] == "ATOM"]
    for k, (atom, symbol, place) in enumerate(zip(made.atom_name, made.element, made.coord, strict=True)):
        if symbol not in ("H", "D"):
            called = f"{atom:<4}" if len(symbol) == 2 or len(atom) == 4 else f" {atom:<3}"
            x = "".join(f"{each + 40.0:8.3f}" for each in place)
            start = f"HETATM {9000 + k} {called} {name:>3} Z   1    {x}"
            lines.append(f"{start}  1.00 20.00          {symbol.upper():>2}")
    path = tmp_path / f"{name}.pdb"
    path.write_text("\n".join([*lines, "END"]))
    return path


def test_every_case_of_the_manifest_is_tested():
    with shared(f"{CASES}/MANIFEST.tsv").open() as lines:
        files = {row["file"].removesuffix(".pdb") for row in csv.DictReader(lines, delimiter="\t")}
    assert files == CHARGES.keys()


@pytest.mark.parametrize("name", CHARGES)
def test_a_case_has_its_charge(name):
    s = case(name)
    assert charge_of(s) == pytest.approx(CHARGES[name], abs=SUM_OF_CHARGES)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name in MORE else ()) for name in HELD]
)
def test_a_bond_of_a_metal_is_held_and_reported(name):
    s = case(name)
    end = pc.relax(s).structure.positions
    donor, metal, length = HELD[name]
    rows = tied(s, end)
    assert any(row[:2] == (donor, metal) and row[2] == pytest.approx(length, abs=0.01) for row in rows)
    assert max(abs(row[3] - row[2]) for row in rows) < TIED_ANGSTROM
    kinds = (Kind.COORDINATED, Kind.ION_HELD, Kind.ION_MOVES)
    assert any(
        each.kind in kinds and each.facts["atom"].name == metal
        and any(end.atoms[0].name == donor for end in each.facts["ends"])
        for each in s.repairs
    )  # fmt: skip


def test_a_histidine_between_two_metals_has_no_hydrogen_at_nitrogen():
    s = case("sod_bridge")
    (residue,) = (each.facts["residue"] for each in s.repairs if each.kind is Kind.IMIDAZOLATE)
    mine = (s.residue_chain[s.atom_residue] == residue.chain) & (s.residue_name[s.atom_residue] == "HIS")
    assert not {"HD1", "HE2"} & {*s.atom_name[mine]}
    metals = np.isin(s.atom_element, ["Cu", "Zn"])
    apart = np.linalg.norm(s.positions[s.atom_element == "H"][:, None] - s.positions[metals], axis=2)
    assert apart.min() > 0.22


@pytest.mark.parametrize(
    ("name", "charge", "metal"),
    [
        ("HEM", -2, ("FE", 2)), ("HEA", -2, ("FE", 2)), ("HEC", -2, ("FE", 2)), ("CLA", 0, ("MG", 2)),
        ("CHL", 0, ("MG", 2)), ("BCL", 0, ("MG", 2)), ("B12", 1, ("CO", 3)), ("SRM", -8, ("FE", 2)),
        ("F43", -5, ("NI", 1)), ("MNR", -1, ("MN", 3)), ("ZNH", -2, ("ZN", 2)),
    ],
)  # fmt: skip
def test_a_macrocycle_moves_with_the_charge_that_it_has_without_its_metal(tmp_path, name, charge, metal):
    s = pc.load(with_component(tmp_path, name), keep="all")
    mine = s.residue_name[s.atom_residue] == name
    assert s.mobile[mine].all()
    assert charge_of(s, name) == pytest.approx(charge, abs=SUM_OF_CHARGES)
    called, state = metal
    (k,) = np.flatnonzero(mine & (s.atom_name == called))
    assert s.formal_charge[k] == state
    assert len([tie for tie in s.ties if len(tie.atoms) == 2 and tie.atoms[1] == k]) == 4
    # No hydrogen at a nitrogen of the ring, whose donors the bonds of the dictionary give.
    donors = {i for tie in s.ties if len(tie.atoms) == 2 for i in tie.atoms[:1]}
    assert all(s.atom_element[j] != "H" for i in donors for j in s.neighbours[i])


@pytest.mark.parametrize(
    ("name", "charge"),
    [("SF4", 2), ("FES", 2), ("F3S", 1), ("CUA", 3), ("NCO", 3), ("CLF", 2), ("ICS", -1), ("OEX", 6),
     ("CPT", 0)],
)  # fmt: skip
def test_a_cluster_stays_with_its_charge(tmp_path, name, charge):
    s = pc.load(with_component(tmp_path, name), keep="all")
    assert s.obstacle[s.residue_name[s.atom_residue] == name].all()
    assert charge_of(s, name) == pytest.approx(charge, abs=SUM_OF_CHARGES)


def test_a_charge_of_the_file_is_the_oxidation_state(tmp_path):
    path = with_component(tmp_path, "HEM")
    lines = [f"{line}3+" if line[12:16] == "FE  " else line for line in path.read_text().splitlines()]
    path.write_text("\n".join(lines))
    assert charge_of(pc.load(path, keep="all"), "HEM") == pytest.approx(-1, abs=SUM_OF_CHARGES)


@pytest.mark.parametrize("suffix", ["cif", "pdb"])
def test_a_heme_read_again_has_the_same_springs_and_energy(tmp_path, suffix):
    s = case("hem_his_CN")
    rng = np.random.default_rng(1)
    s = s.with_positions(np.round(s.positions + rng.normal(scale=0.002, size=s.positions.shape), 4))
    pc.save(s, tmp_path / f"heme.{suffix}")
    again = pc.load(tmp_path / f"heme.{suffix}", keep="all")
    assert len(again.ties) == len(s.ties)
    first, second = (pc.energy(each)(each.positions)[0] for each in (s, again))
    assert second == pytest.approx(first, rel=READ_AGAIN)


def test_forces_of_a_heme_are_those_of_openmm():
    s = case("hem_his_CN")
    (e, f), (expected, forces) = (pc.energy(s, engine=name)(s.positions) for name in ("native", "openmm"))
    assert e == pytest.approx(expected, rel=1e-6)
    assert np.abs(f - forces).max() < 1e-4 * np.abs(forces).max()


def test_a_metal_takes_no_bond_from_the_source_of_its_ring():
    s = case("hem_his")
    (bound,) = s.ligands
    assert not any(gemmi.Element(int(z)).is_metal for z in bound.ligand.molecule.elements)
    assert bound.ligand.molecule.charge == -4  # Ring and propionates.


def test_a_message_names_bonds_of_metals_that_changed():
    s = case("nco")
    assert not s.coordination.any()
    s = case("hem_his")
    (row,) = np.flatnonzero(
        s.coordination & np.isin(s.bonds, np.flatnonzero(s.atom_name == "NE2")).any(axis=1)
    )
    x = s.positions.copy()
    nitrogen, iron = s.bonds[row]
    x[nitrogen] += 0.01 * (x[nitrogen] - x[iron]) / np.linalg.norm(x[nitrogen] - x[iron])
    assert _changed_metal_bonds(s, s.positions) == []
    assert _changed_metal_bonds(s, x) == ["A:HIS2 NE2 and B:HEM1 FE 2.05 to 2.15"]


@pytest.mark.slow
def test_the_table_of_metal_components_is_that_of_the_code(tmp_path):
    page = (Path(pc.__file__).parents[1] / "analysis" / "docs" / "files.md").read_text()
    table = page.partition("| component | becomes | charge | moves |")[2].partition("\n\n")[0]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines()[2:]]
    assert len(rows) == 40
    for name, _, charge, moves in rows:
        s = pc.load(with_component(tmp_path, name), keep="all")
        mine = s.atom_residue == s.n_residues - 1
        found = sum(each.ligand.molecule.charge for each in s.ligands)
        metal = np.isin(s.atom_element, [*METALS])
        found += s.formal_charge[mine & metal].sum() if s.ligands else s.formal_charge[mine].sum()
        assert (name, f"{abs(found)}{'-+'[found > 0]}" if found else "none") == (name, charge)
        assert (name, s.mobile[mine].all()) == (name, moves == "yes")
        assert (name, mine.sum() == 1) == (name, moves == "held")


@pytest.mark.parametrize("place", ["first", "inner", "last"])
def test_a_strand_with_an_incomplete_nucleotide_has_a_whole_charge(tmp_path, place):
    lines = (STRUCTURES / "1bna.pdb").read_text().splitlines()
    number = {"first": 1, "inner": 5, "last": 12}[place]
    gone = (f"A{number:4}", " C4 ")
    chosen = [line for line in lines if line[:4] == "ATOM" and line[21] == "A"]
    kept = [line for line in chosen if (line[21:26], line[12:16]) != gone]
    assert len(kept) == len(chosen) - 1
    path = tmp_path / "strand.pdb"
    path.write_text("\n".join([*kept, "END"]))
    s = pc.load(path, keep="all")
    assert s.obstacle.any()
    assert charge_of(s) == pytest.approx(-11, abs=SUM_OF_CHARGES)


def heavy_atoms(name):
    """Names, elements and positions (angstrom) of the heavy atoms of a component of the dictionary."""
    made = component(name)
    chosen = ~np.isin(made.element, ["H", "D"])
    symbols = [str(symbol).title() for symbol in made.element[chosen]]
    return made.atom_name[chosen].tolist(), symbols, np.array(made.coord[chosen], dtype=float)


def directed(x, start, end, at, way):
    """Positions moved and turned so that one atom is at a place, and another in a direction from it."""
    own = x[end] - x[start]
    turn = Rotation.align_vectors([way], [own / np.linalg.norm(own)])[0]
    return turn.apply(x - x[start]) + at


def beside_peptide(folder, sequence, molecules, bonds):
    """A peptide and molecules (name, names, elements, positions) in chains of their own, as a PDB file."""
    pc.save(pc.from_sequence(sequence), folder / "peptide.pdb", hydrogens=False)
    structure = gemmi.read_structure(str(folder / "peptide.pdb"))
    for letter, (name, names, symbols, x) in zip("BCDE", molecules, strict=False):
        residue = gemmi.Residue()
        residue.name, residue.seqid, residue.het_flag = name, gemmi.SeqId("1"), "H"
        for called, symbol, place in zip(names, symbols, x, strict=True):
            atom = gemmi.Atom()
            atom.name, atom.element, atom.occ = called, gemmi.Element(symbol), 1.0
            atom.pos = gemmi.Position(*place)
            residue.add_atom(atom)
        chain = gemmi.Chain(letter)
        chain.add_residue(residue)
        structure[0].add_chain(chain)
    for k, ends in enumerate(bonds):
        bond = gemmi.Connection()
        bond.type, bond.name = gemmi.ConnectionType.MetalC, f"metalc{k}"
        bond.partner1, bond.partner2 = (
            gemmi.AtomAddress(letter, gemmi.SeqId("1"), name, atom) for letter, name, atom in ends
        )
        structure.connections.append(bond)
    structure.write_pdb(str(folder / "made.pdb"))
    return folder / "made.pdb"


AXIAL = {"AZI": ("N1", "N2", 2.05, 120.0), "ENC": ("C", "N", 1.95, 178.0), "NBN": ("C", "N", 1.95, 165.0)}
"""Azide, and isocyanides of ethyl and butyl: donor, the next atom, Fe-donor (angstrom) and its angle."""
QUICK_AXIAL = ("AZI", True), ("ENC", False)
"""Ligands of the fast tests, and whether their files state the bond."""


def heme_with(folder, name, is_stated):
    """A heme between a histidine and another ligand."""
    s = pc.from_sequence("AHA")
    its = {str(s.atom_name[k]): 10.0 * s.positions[k] for k in np.flatnonzero(s.atom_residue == 1)}
    out = its["NE2"] - (its["CG"] + its["ND1"]) / 2.0
    out /= np.linalg.norm(out)
    names, symbols, x = heavy_atoms("HEM")
    iron = names.index("FE")
    normal = np.linalg.svd(x[[names.index(n) for n in ("NA", "NB", "NC", "ND")]] - x[iron])[2][2]
    place = its["NE2"] + 2.05 * out
    heme = Rotation.align_vectors([out], [normal])[0].apply(x - x[iron]) + place
    donor, following, length, angle = AXIAL[name]
    ligand, elements, y = heavy_atoms(name)
    aside = np.cross(out, [0.2, 0.5, 0.8])
    bend = np.deg2rad(180.0 - angle)
    way = np.cos(bend) * out + np.sin(bend) * aside / np.linalg.norm(aside)
    y = directed(y, ligand.index(donor), ligand.index(following), place + length * out, way)
    molecules = [("HEM", names, symbols, heme), (name, ligand, elements, y)]
    bonds = [(("B", "HEM", "FE"), ("C", name, donor))] if is_stated else []
    return beside_peptide(folder, "AHA", molecules, bonds), donor, length


def molybdenum(folder, name, sulphurs, metal, is_double=False):
    """Molybdopterin whose two sulphurs hold molybdenum, at 2.4 angstrom; or two of it, as tetrahedra are."""
    names, symbols, x = heavy_atoms(name)
    first, second = (x[names.index(each)] for each in sulphurs)
    middle = (first + second) / 2.0
    carbons = [
        k
        for k, y in enumerate(x)
        if symbols[k] == "C" and np.linalg.norm(y - [[first], [second]], axis=2).min() < 1.9
    ]
    out = middle - x[carbons].mean(axis=0)
    out /= np.linalg.norm(out)
    place = middle + np.sqrt(2.4**2 - np.linalg.norm(second - first) ** 2 / 4.0) * out
    called, elements, y = heavy_atoms(metal)
    k = elements.index("Mo")
    y = directed(y, k, (k + 1) % len(called), place, out) if len(called) > 1 else np.array([place])
    away = np.array([0.0, 0.0, 40.0])
    side = (second - first) / np.linalg.norm(second - first)
    turn = Rotation.from_rotvec(np.pi / 2.0 * out) * Rotation.from_rotvec(np.pi * side)
    molecules = [(name, names, symbols, x + away), (metal, called, elements, y + away)]
    molecules += [(name, names, symbols, turn.apply(x - place) + place + away)] if is_double else []
    bonds = [(("B", name, each), ("C", metal, called[k])) for each in sulphurs]
    return beside_peptide(folder, "AAA", molecules, bonds)


def assert_held(path, donors, metal, length):
    """Each bond of a metal is reported, and ends as long as it was."""
    s = pc.load(path, keep="all")
    (ion,) = np.flatnonzero(s.atom_element == metal)
    ends = np.flatnonzero(s.kept & np.isin(s.atom_name, donors))
    before, after = (
        10.0 * np.linalg.norm(x[ends] - x[ion], axis=1)
        for x in (s.positions, pc.relax(s).structure.positions)
    )
    assert before == pytest.approx(length, abs=0.01)
    assert np.abs(after - before).max() < TIED_ANGSTROM
    (told,) = (
        each
        for each in s.repairs
        if each.kind in (Kind.COORDINATED, Kind.ION_HELD)
        and {*donors} & {end.atoms[0].name for end in each.facts["ends"]}
    )
    assert sum(end.atoms[0].name in donors for end in told.facts["ends"]) == len(ends)
    return len(ends)


@pytest.mark.parametrize(
    ("name", "is_stated"),
    [
        pytest.param(name, each, marks=() if (name, each) in QUICK_AXIAL else pytest.mark.slow)
        for name in AXIAL
        for each in (True, False)
    ],
)
def test_azide_and_isocyanides_stay_at_the_iron_of_heme(tmp_path, name, is_stated):
    path, donor, length = heme_with(tmp_path, name, is_stated)
    assert_held(path, [donor], "Fe", length)


@pytest.mark.parametrize(
    "metal",
    [
        pytest.param(name, marks=pytest.mark.slow if name in MORE else ())
        for name in ("4MO", "6MO", "MOS", "MOM")
    ],
)
def test_molybdopterin_holds_molybdenum_by_both_sulphurs(tmp_path, metal):
    """Ions of charge 4 and 6, and oxides."""
    sulphurs = ["S1'", "S2'"]
    assert assert_held(molybdenum(tmp_path, "MTE", sulphurs, metal), sulphurs, "Mo", 2.4) == 2


def test_two_molybdopterins_hold_molybdenum(tmp_path):
    sulphurs = ["S12", "S13"]
    path = molybdenum(tmp_path, "MGD", sulphurs, "6MO", is_double=True)
    assert assert_held(path, sulphurs, "Mo", 2.4) == 4
