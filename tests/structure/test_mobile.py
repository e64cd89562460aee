"""Molecules kept with the protein that move, because a force field of the user's has their parameters."""

import gemmi
import numpy as np
import openmm
import pytest
from fixtures.repairs import sentences
from fixtures.samples import STRUCTURES
from fixtures.tolerances import NATIVE_FORCE

import protochain as pc
from protochain.core.units import ANGSTROM_PER_NM
from protochain.mechanics.multibody import HingeKind
from protochain.structure.molecule.member import Member
from protochain.structure.molecule.templates import Template
from protochain.structure.preparation.recognise import find_template

TYPES = {"C1": ("lig-C1", "C"), "C2": ("lig-C2", "C"), "O1": ("lig-O", "O"), "HO1": ("lig-H", "H")}
CHARGE = {"C1": 0.05, "C2": 0.2, "O1": -0.65, "HO1": 0.4}
SIGMA = {"C1": 0.36, "C2": 0.36, "O1": 0.31, "HO1": 0.1}
BOND_NM = {("C1", "C2"): 0.1526, ("C2", "O1"): 0.141, ("O1", "HO1"): 0.096}
STIFFNESS = 3.0e5
"""kJ/mol/nm^2."""
BOND_SLACK_NM = 0.004
"""A force of 600 kJ/mol/nm on one atom stretches the springs so far; an atom that nothing holds flies nm."""
ENGINES_AGREE = 1e-8
"""Relative."""
HYDROGEN_BOND = 2.6
"""Angstrom: the shortest there are between heavy atoms; an overlap is shorter."""


def ligand_xml(name: str = "LIG", called=lambda atom: atom) -> str:
    """A force field of ethanol with united hydrogens at the carbons: bonds, angles, charges and spheres."""
    mass = {"C": 12.011, "O": 15.999, "H": 1.008}
    types = "".join(
        f'<Type name="{t}" class="{t}" element="{e}" mass="{mass[e]}"/>' for t, e in TYPES.values()
    )
    atoms = "".join(f'<Atom name="{called(a)}" type="{TYPES[a][0]}" charge="{CHARGE[a]}"/>' for a in TYPES)
    inside = "".join(f'<Bond atomName1="{called(a)}" atomName2="{called(b)}"/>' for a, b in BOND_NM)
    bonds = "".join(
        f'<Bond type1="{TYPES[a][0]}" type2="{TYPES[b][0]}" length="{r}" k="{STIFFNESS}"/>'
        for (a, b), r in BOND_NM.items()
    )
    angles = "".join(
        f'<Angle type1="{TYPES[a][0]}" type2="{TYPES[b][0]}" type3="{TYPES[c][0]}" angle="1.91" k="500"/>'
        for a, b, c in (("C1", "C2", "O1"), ("C2", "O1", "HO1"))
    )
    pairs = "".join(f'<Atom type="{TYPES[a][0]}" sigma="{SIGMA[a]}" epsilon="0.4"/>' for a in TYPES)
    return (
        f'<ForceField><AtomTypes>{types}</AtomTypes><Residues><Residue name="{name}">{atoms}{inside}'
        f"</Residue></Residues><HarmonicBondForce>{bonds}</HarmonicBondForce><HarmonicAngleForce>{angles}"
        '</HarmonicAngleForce><NonbondedForce coulomb14scale="0.8333333333333334" lj14scale="0.5">'
        f'<UseAttributeFromResidue name="charge"/>{pairs}</NonbondedForce></ForceField>'
    )


def with_ligand(tmp_path, gap: float = 3.8, atoms: tuple[str, ...] = ("C1", "C2", "O1"), name: str = "LIG"):
    """Trp-cage and a ligand whose first atom is ``gap`` angstrom beyond the outermost one."""
    residue_atoms = [a for r in gemmi.read_structure(str(STRUCTURES / "1l2y.pdb"))[0][0] for a in r]
    x = np.array([a.pos.tolist() for a in residue_atoms if not a.is_hydrogen()])
    far = x[np.argmax(np.linalg.norm(x - x.mean(axis=0), axis=1))]
    out = (far - x.mean(axis=0)) / np.linalg.norm(far - x.mean(axis=0))
    side = np.cross(out, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(out, [0.0, 0.0, 1.0]))
    first = far + gap * out
    places = [first, first + 1.526 * side]
    places.append(places[1] + 1.41 * (np.sin(0.34) * side + np.cos(0.34) * out))
    lines = [
        line for line in (STRUCTURES / "1l2y.pdb").read_text().split("ENDMDL")[0].splitlines()
        if line.startswith("ATOM")
    ]  # fmt: skip
    for k, (atom, at) in enumerate(zip(atoms, places, strict=True)):
        lines.append(
            f"HETATM{900 + k:5d}  {atom:<3} {name:>3} B   1    {at[0]:8.3f}{at[1]:8.3f}{at[2]:8.3f}"
            f"  0.50 20.00          {atom.strip('0123456789'):>2}"
        )
    path = tmp_path / "with.pdb"
    path.write_text("\n".join([*lines, "END", ""]))
    return path


def prepared(tmp_path, solvent: str = "obc2", **options):
    """Structure, chain and energy, with the ligand's parameters beside those of the protein."""
    path = tmp_path / "lig.xml"
    path.write_text(ligand_xml())
    setup = pc.Setup(forcefield=f"amber14,{path}", solvent=solvent, hinges="phi psi chi")
    return setup.prepare(with_ligand(tmp_path, **options))


def bond_lengths(s: pc.Structure, x: np.ndarray) -> np.ndarray:
    at = {name: int(k) for k, name in enumerate(s.atom_name) if s.mobile[k]}
    return np.array([np.linalg.norm(x[at[a]] - x[at[b]]) for a, b in BOND_NM])


def nearest(s: pc.Structure, x: np.ndarray) -> float:
    """Distance in angstrom of the ligand's heavy atoms from those of the protein."""
    heavy = s.atom_element != "H"
    apart = x[heavy & s.mobile][:, None] - x[heavy & ~s.mobile]
    return float(ANGSTROM_PER_NM * np.linalg.norm(apart, axis=2).min())


def test_a_molecule_with_parameters_of_the_users_is_free(tmp_path):
    s, c, _ = prepared(tmp_path)
    assert s.atom_name[s.mobile].tolist() == ["C1", "C2", "O1", "HO1"] and not s.obstacle.any()
    assert np.array_equal(s.kept, s.mobile) and s.n_chains == 1
    assert [line for line in sentences(s) if "1 LIG with parameters" in line and "rigid body" in line]
    assert not any("by element" in line for line in sentences(s))
    assert c.moving.all() and (c.tree.kind == HingeKind.FREE).sum() == 2
    assert len({*c.atom_body[s.mobile].tolist()}) == 1 and c.n_v == c.n_hinges + 12
    assert not any(s.mobile[list(hinge.atoms)].any() for hinge in c.hinges)


def test_without_parameters_it_is_an_obstacle(tmp_path):
    s = pc.load(with_ligand(tmp_path))
    assert s.obstacle.sum() == 3 and not s.mobile.any() and any("by element" in line for line in sentences(s))


def test_engines_agree_on_its_energy(tmp_path):
    s, _, e = prepared(tmp_path, "gbn2")
    assert e.engine == "native"
    x = s.positions + 0.003 * np.random.default_rng(3).normal(size=s.positions.shape)
    (value, forces), (true, exact) = e(x), e.reference(x)
    assert value == pytest.approx(true, rel=ENGINES_AGREE, abs=ENGINES_AGREE)
    assert np.linalg.norm(forces - exact) < NATIVE_FORCE * np.linalg.norm(exact)
    assert all(e.system.getParticleMass(int(k))._value > 0.0 for k in np.flatnonzero(s.mobile))
    nonbonded = next(f for f in e.system.getForces() if isinstance(f, openmm.NonbondedForce))
    own = [nonbonded.getParticleParameters(int(k))[0]._value for k in np.flatnonzero(s.mobile)]
    assert own == list(CHARGE.values())


def test_it_moves_away_from_an_overlap_and_holds_together(tmp_path):
    s, c, e = prepared(tmp_path, gap=2.1)
    assert nearest(s, s.positions) < 2.2
    r = pc.minimise(c, e, "cartesian", max_evaluations=300)
    assert nearest(s, r.x) > HYDROGEN_BOND
    assert np.abs(bond_lengths(s, r.x) - list(BOND_NM.values())).max() < BOND_SLACK_NM
    assert r.end.energy < r.start.energy
    pc.save(r, tmp_path / "out.pdb")
    written = [line for line in (tmp_path / "out.pdb").read_text().splitlines() if line[17:20] == "LIG"]
    assert [line[12:16].strip() for line in written] == ["C1", "C2", "O1", "HO1"]
    assert {line[:6] for line in written} == {"HETATM"} and {line[21:26] for line in written} == {"B   1"}


def test_in_torsions_it_moves_as_a_rigid_body(tmp_path):
    s, c, e = prepared(tmp_path, gap=2.1)
    r = pc.minimise(c, e, "lbfgs", max_evaluations=150)
    assert nearest(s, r.x) > HYDROGEN_BOND
    assert np.abs(bond_lengths(s, r.x) - bond_lengths(s, s.positions)).max() < 1e-9


def test_a_straight_one_stands_still_in_torsions_and_moves_in_all_atoms(tmp_path):
    """Two atoms on a line have no inertia about it."""
    text = ligand_xml()
    keep = (
        '<Residue name="DIA"><Atom name="C1" type="lig-C1" charge="0.1"/>'
        '<Atom name="C2" type="lig-C2" charge="-0.1"/><Bond atomName1="C1" atomName2="C2"/></Residue>'
    )
    path = tmp_path / "lig.xml"
    path.write_text(text.replace("<Residues>", f"<Residues>{keep}"))
    file = with_ligand(tmp_path, gap=2.4, name="DIA")
    file.write_text("\n".join(x for x in file.read_text().splitlines() if " O1  DIA" not in x) + "\n")
    s, c, e = pc.Setup(forcefield=f"amber14,{path}").prepare(file)
    assert s.mobile.sum() == 2 and not (c.tree.kind == HingeKind.FREE).any()
    still, moved = (pc.minimise(c, e, method, max_evaluations=100) for method in ("lbfgs", "cartesian"))
    across = [r.x[s.mobile][0] - r.x[s.mobile][1] for r in (still, moved)]
    assert (
        np.linalg.norm(across[0]) == pytest.approx(0.1526, abs=1e-5) and nearest(s, moved.x) > HYDROGEN_BOND
    )


def test_a_structure_with_a_free_molecule_needs_its_parameters(tmp_path):
    s = prepared(tmp_path).structure
    with pytest.raises(pc.ProtochainError, match=r"B:LIG1 moves and has no parameters"):
        pc.energy(s, "amber14")


def test_one_bonded_to_another_molecule_stays(tmp_path):
    path = tmp_path / "lig.xml"
    path.write_text(ligand_xml())
    file = with_ligand(tmp_path)
    last = next(line for line in file.read_text().splitlines()[::-1] if line[17:20] == "LIG")
    x = float(last[30:38]) + 1.3
    file.write_text(
        file.read_text().replace(
            "END\n", f"HETATM  950  C   XYZ B   2    {x:8.3f}{last[38:54]}  1.00 20.00           C\nEND\n"
        )
    )
    s = pc.load(file, forcefield=f"amber14,{path}")
    assert not s.mobile.any() and s.obstacle.sum() == 5
    assert any("LIG" in line and "stays in place" in line for line in sentences(s))


@pytest.mark.parametrize("hydrogen", [False, True])
def test_a_ligand_is_recognised_by_its_bonds_under_any_names(tmp_path, hydrogen):
    """As openmmforcefields writes them: the residue is named by a SMILES, the atoms by their order."""
    path = tmp_path / "lig.xml"
    names = {"C1": "C1x", "C2": "C2x", "O1": "O3x", "HO1": "H4x"}
    path.write_text(ligand_xml("[H]OCC", names.__getitem__))
    file = with_ligand(tmp_path, atoms=("C9", "C7", "O5"), name="UNL")
    if hydrogen:
        (oxygen,) = [line for line in file.read_text().splitlines() if " O5  UNL" in line]
        x = float(oxygen[30:38]) - 0.96
        file.write_text(
            file.read_text().replace("END\n", f"HETATM  950  HQ  UNL B   1    {x:8.3f}{oxygen[38:54]}"
                                     "  1.00 20.00           H\nEND\n")
        )  # fmt: skip
    s = pc.load(file, forcefield=f"amber14,{path}")
    assert s.atom_name[s.mobile].tolist() == ["C9", "C7", "O5", "HQ" if hydrogen else "H4x"]
    assert not s.obstacle.any() and not any("by element" in line for line in sentences(s))
    e = pc.energy(s, f"amber14,{path}", "vacuum")
    nonbonded = next(f for f in e.system.getForces() if isinstance(f, openmm.NonbondedForce))
    own = [nonbonded.getParticleParameters(int(k))[0]._value for k in np.flatnonzero(s.mobile)]
    assert own == list(CHARGE.values())


def molecule(bonds: str, elements: dict[str, str]) -> Template:
    return Template(
        "X", elements, dict.fromkeys(elements, 0.0), tuple(map(tuple, map(str.split, bonds.split(",")))), {}
    )


@pytest.mark.parametrize(
    ("bonds", "same"),
    [
        ("C1 C2,C2 C3,C3 C4,C4 C5,C5 C6,C6 C1,C1 O", True),
        ("C1 C2,C2 C3,C3 C1,C4 C5,C5 C6,C6 C4,C1 O", False),  # two rings of three
        ("C1 C2,C2 C3,C3 C4,C4 C5,C5 C6,C6 C2,C1 O", False),
        ("C1 C2,C2 C3,C3 C4,C4 C5,C5 C6,C6 C1,C4 O", True),
        ("C1 C2,C2 C3,C3 C4,C4 C5,C5 C6,C6 C1", False),
    ],
)
def test_bonds_and_elements_decide_what_is_recognised(bonds, same):
    """A ring of six carbons with an oxygen, against others of as many atoms."""
    atoms = {f"A{k}": "C" for k in range(6)} | {"Z": "O"}
    ring = molecule("A0 A3,A3 A1,A1 A5,A5 A2,A2 A4,A4 A0,A5 Z", atoms)
    elements = {f"C{k}": "C" for k in range(1, 7)} | ({"O": "O"} if " O" in bonds else {"O": "N"})
    member = Member("LIG", "1", "", "A", [])
    found = find_template(member, ring, [molecule(bonds, elements)])
    assert (found is not None) == same
    if found is not None:
        assert {frozenset(pair) for pair in found.bonds} == {frozenset(pair) for pair in ring.bonds}
        assert found.name == "LIG" and found.element["Z"] == "O" and found.is_users


def test_hydrogens_of_the_file_choose_among_states(tmp_path):
    """Of an acid and its anion the one whose hydrogens are there; without any, the first."""
    heavy = {"C": "C", "O1": "O", "O2": "O"}
    anion = molecule("C O1,C O2", heavy)
    acid = molecule("C O1,C O2,O1 H", heavy | {"H": "H"})
    member = Member("FMT", "1", "", "A", [])
    seen = molecule("A OA,A OB,OB HB", {"A": "C", "OA": "O", "OB": "O", "HB": "H"})
    bare = molecule("A OA,A OB", {"A": "C", "OA": "O", "OB": "O"})
    assert find_template(member, seen, [anion, acid]).hydrogens == {"OB": ["HB"]}
    assert find_template(member, bare, [anion, acid]).hydrogens == {}
    assert list(find_template(member, bare, [acid, anion]).hydrogens.values()) == [["H"]]
