"""Molecules kept with the protein: what is kept and said, how it is held, and metal sites."""

import importlib.util
from pathlib import Path

import gemmi
import numpy as np
import openmm
import pytest
from fixtures.repairs import sentences
from fixtures.samples import STRUCTURES, shared
from fixtures.tolerances import NATIVE_ENERGY, NATIVE_FORCE
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

import protochain as pc
from protochain.chains.contacts import overlaps
from protochain.energies.elements import lennard_jones
from protochain.mechanics.multibody import HingeKind
from protochain.structure.molecule.repairs import Kind
from protochain.structure.superpose import superpose

SITE_NM = 0.02
"""Zinc and heme sites stay within 0.2 angstrom of the input."""


def written(tmp_path: Path, text: str, name: str = "x.pdb") -> Path:
    path = tmp_path / name
    path.write_text(text)
    return path


def records(path: Path, *conditions) -> list[str]:
    lines = [line for line in path.read_text().splitlines(True) if line[:6] in ("ATOM  ", "HETATM")]
    return [line for line in lines if all(condition(line) for condition in conditions)]


def zinc_finger(tmp_path: Path) -> Path:
    """3znf with zinc where its four ligands point, whose distances are then 2.28 and 2.03 angstrom."""
    path = shared("3znf_zinc_finger.pdb")
    zinc = "HETATM  999 ZN    ZN G 101       5.278   2.167   4.202  1.00  0.00          ZN\n"
    return written(tmp_path, "".join(records(path)) + zinc + "END\n")


def globin(tmp_path: Path) -> Path:
    """Chain A of the erythrocruorin 2gtl, with carbon monoxide on its heme; from the data of tmtools."""
    spec = importlib.util.find_spec("tmtools")
    path = Path(spec.origin).parent / "data" / "2gtl.pdb" if spec else Path("absent")
    if not path.exists():
        pytest.skip("2gtl.pdb is not here")
    return written(tmp_path, "".join(records(path, lambda line: line[21] == "A")) + "END\n")


CUBE = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
CLUSTERS = {
    "SF4": (0.962 * CUBE, -1.308 * CUBE, 2.290 * CUBE),
    "FES": (
        np.array([[0.0, 0.0, 1.35], [0.0, 0.0, -1.35]]),
        np.array([[1.75, 0.0, 0.0], [-1.75, 0.0, 0.0]]),
        np.array([[0.0, y, z] for z in (2.65, -2.65) for y in (1.897, -1.897)]),
    ),
}
"""Angstrom: irons 2.7 apart, sulphides 2.2 to 2.3 from them, and cysteines' sulphurs 2.3 from their iron."""


def iron_sulphur(tmp_path: Path, name: str) -> Path:
    """A cluster that four peptides GCG, each a chain, hold by their cysteines."""
    peptide = pc.from_sequence("GCG")
    x, sulphur = 10 * peptide.positions, peptide.atom_name.tolist().index("SG")
    irons, sulphides, holders = CLUSTERS[name]
    lines = []

    def add(record, atom, residue, chain, number, at, element):
        lines.append(
            f"{record:<6}{len(lines) + 1:5d} {atom:<4} {residue:>3} {chain}{number:4d}    "
            f"{at[0]:8.3f}{at[1]:8.3f}{at[2]:8.3f}  1.00  0.00          {element:>2}\n"
        )

    for chain, target in zip("ABCD", holders, strict=True):
        iron = irons[np.argmin(np.linalg.norm(irons - target, axis=1))]
        # The peptide beyond its sulphur, which bends as one does: C-S-Fe of some 110 degrees.
        out, inward = target - iron, x[sulphur] - x.mean(axis=0)
        turn, _ = Rotation.align_vectors([out / np.linalg.norm(out)], [-inward / np.linalg.norm(inward)])
        placed = turn.apply(x - x[sulphur]) + target
        for k in np.flatnonzero(peptide.atom_element != "H"):
            r = peptide.atom_residue[k]
            add("ATOM", f" {peptide.atom_name[k]}", peptide.residue_name[r], chain, r + 1, placed[k],
                peptide.atom_element[k])  # fmt: skip
        lines.append("TER\n")
    for kind, places in (("FE", irons), ("S", sulphides)):
        for k, at in enumerate(places, 1):
            add("HETATM", f"{kind}{k}" if kind == "FE" else f" {kind}{k}", name, "E", 1, at, kind)
    return written(tmp_path, "".join(lines) + "END\n", f"{name}.pdb")


def site_of(s: pc.Structure) -> list[int]:
    """Metals and the atoms that hold them."""
    return sorted({atom for tie in s.ties if len(tie.atoms) == 2 for atom in tie.atoms})


def moved(s: pc.Structure, x: np.ndarray, atoms: list[int]) -> float:
    """Largest displacement in nm of some atoms, superposed."""
    there = superpose(s.positions[atoms], x[atoms])
    return float(np.linalg.norm(there - x[atoms], axis=1).max())


@pytest.mark.parametrize(("distance", "stays"), [(2.1, True), (2.9, False)])
def test_an_ion_stays_with_a_kept_molecule_that_holds_it(tmp_path, distance, stays):
    """Magnesium and oxygen: 2.07 angstrom (Harding, Acta Cryst. D62:678, 2006)."""
    lines = records(STRUCTURES / "1l2y.pdb")
    x = np.array([place(line) for line in lines if line[22:26] == "  20"]).max(axis=0)
    atoms = ((" P   PO3", " P", 3.5), (" O1  PO3", " O", 5.0), ("MG    MG", "MG", 5.0 + distance))
    for k, (name, element, way) in enumerate(atoms):
        line = f"HETATM{900 + k:5d} {name} A {101 + (k == 2)}    {'':24}  1.00  0.00          {element}\n"
        lines.append(placed(line, x + np.array([way, 0.0, 0.0]), "A"))
    s = pc.load(written(tmp_path, "".join(lines) + "END\n"))
    assert s.residue_name[20:].tolist() == ["PO3", "MG"][: 1 + stays]


@pytest.mark.parametrize(
    ("occupancies", "kinds"),
    [
        ((1.0,), set()),
        ((0.0,), {Kind.UNRESOLVED}),
        ((1.0, 1.0), {Kind.COINCIDENT}),
        ((0.0, 0.0), {Kind.UNRESOLVED, Kind.COINCIDENT}),
    ],
)
def test_ligands_without_occupancy_or_in_one_place_are_kept_and_reported(tmp_path, occupancies, kinds):
    lines = records(STRUCTURES / "1l2y.pdb")
    x = np.array([place(line) for line in lines if line[22:26] == "  20"]).max(axis=0)
    for k, occupancy in enumerate(occupancies):
        for atom, way in (("P", 3.5), ("O", 5.0)):
            line = (
                f"HETATM  900  {atom:<3} PO3 A {101 + k}    {'':24}{occupancy:6.2f}  0.00           {atom}\n"
            )
            lines.append(placed(line, x + np.array([way, 0.0, 0.0]), "A"))
    s = pc.load(written(tmp_path, "".join(lines) + "END\n"))
    assert s.residue_name[20:].tolist() == ["PO3"] * len(occupancies)
    assert {each.kind for each in s.repairs} & {Kind.UNRESOLVED, Kind.COINCIDENT} == kinds


def test_atoms_of_one_name_get_names_that_no_other_has(tmp_path):
    """Of twelve C and two C1, the last of each would be C12."""
    lines = records(STRUCTURES / "1l2y.pdb")
    for k, name in enumerate(["C"] * 12 + ["C1"] * 2):
        line = f"HETATM  900  {name:<3} XXC B 101    {'':24}  1.00  0.00           C\n"
        lines.append(placed(line, np.array([30.0 + 1.3 * k, 0.7 * (k % 2), 0.0]), "B"))
    s = pc.load(written(tmp_path, "".join(lines) + "END\n"), keep="all")
    assert len({*s.atom_name[s.kept]}) == s.kept.sum() == 14


def with_a_duplex(tmp_path: Path, apart: float, *beside: str) -> pc.Structure:
    """1bna with a peptide 3 angstrom from its strand A; strand B further from that by so many angstrom.

    Of ``beside``, a name of an atom with its residue and number in B, each gets a zinc ion at 2.1 angstrom.
    """
    strands = {
        c: records(STRUCTURES / "1bna.pdb", lambda line, c=c: line[:4] + line[21] == "ATOM" + c) for c in "AB"
    }
    places = {c: np.array([place(line) for line in lines]) for c, lines in strands.items()}
    centre = np.vstack([*places.values()]).mean(axis=0)
    peptide = records(STRUCTURES / "ala10.pdb")
    x = np.array([place(line) for line in peptide])
    start = places["A"][np.argmax(np.linalg.norm(places["A"] - centre, axis=1))]
    out = (start - centre) / np.linalg.norm(start - centre)
    x += start - x.mean(axis=0)
    while KDTree(places["A"]).query(x)[0].min() < 3.0:
        x += 0.5 * out
    assert KDTree(places["B"]).query(x)[0].min() > 7.0
    places["B"] = places["B"] - apart * out
    lines = [placed(line, at, "P") for line, at in zip(peptide, x, strict=True)]
    for chain, its in strands.items():
        lines += [placed(line, at, chain) for line, at in zip(its, places[chain], strict=True)]
    for number, name in enumerate(beside):
        where = next(k for k, line in enumerate(strands["B"]) if line[12:26].split() == name.split())
        ring = [k for k, line in enumerate(strands["B"]) if line[22:26] == strands["B"][where][22:26]]
        middle = places["B"][[k for k in ring if "'" not in strands["B"][k][12:16]]].mean(axis=0)
        way = places["B"][where] - middle
        at = places["B"][where] + 2.1 * way / np.linalg.norm(way)
        ion = (
            f"HETATM{9000:5d} ZN    ZN Z{number + 1:4d}    {0:8.3f}{0:8.3f}{0:8.3f}  1.00  0.00          ZN\n"
        )
        lines.append(placed(ion, at, "Z"))
    return pc.load(written(tmp_path, "".join(lines) + "END\n"))


def place(line: str) -> list[float]:
    return [float(line[k : k + 8]) for k in (30, 38, 46)]


def placed(line: str, x, chain: str) -> str:
    return line[:21] + chain + line[22:30] + "".join(f"{each:8.3f}" for each in x) + line[54:]


def test_a_strand_stays_with_the_one_that_its_bases_are_paired_with(tmp_path):
    s = with_a_duplex(tmp_path, 0.0)
    assert [(s.residue_chain == chain).sum() for chain in "PAB"] == [10, 12, 12]
    # biotite's pairs are those of DSSR's criteria.
    pairs = pc.validate(s).measures["base_pairs"]
    assert pairs is None or pairs == 12
    with_zinc = with_a_duplex(tmp_path, 0.0, "N7 DG B 16")
    assert [(with_zinc.residue_chain == chain).sum() for chain in "PABZ"] == [10, 12, 12, 1]
    apart = with_a_duplex(tmp_path, 60.0, "N7 DG B 16")
    assert [(apart.residue_chain == chain).sum() for chain in "PABZ"] == [10, 12, 0, 0]


@pytest.mark.parametrize(
    ("name", "solvent"),
    [("1ajj_ldlr.pdb", "obc2"), pytest.param("1grm_gramicidin.pdb", "gbn2", marks=pytest.mark.slow)],
)
def test_both_engines_agree_on_molecules_without_parameters(name, solvent):
    s = pc.load(shared(name))
    e = pc.energy(s, solvent=solvent, engine="native")
    (value, forces), (true, exact) = e(s.positions), e.reference(s.positions)
    assert value == pytest.approx(true, rel=NATIVE_ENERGY)
    assert np.linalg.norm(forces - exact) < NATIVE_FORCE * np.linalg.norm(exact)


@pytest.mark.slow
def test_force_fields_with_tables_of_pairs_take_molecules_by_element():
    s = pc.load(shared("1grm_gramicidin.pdb"))
    e = pc.energy(s, "charmm36", "vacuum", engine="native")
    assert e(s.positions)[0] == pytest.approx(e.reference(s.positions)[0], rel=NATIVE_ENERGY)


def test_a_ligand_pushes_as_its_elements_do(tmp_path):
    """Pulling a sulfate away changes the energy by its Lennard-Jones energy with the protein alone."""
    path = shared("1bx8_hirustasin.pdb")
    s = pc.load(path)
    e = pc.energy(s, solvent="vacuum")
    away = s.positions + np.where(s.obstacle, 1000.0, 0.0)[:, None]
    nonbonded = next(f for f in e.system.getForces() if isinstance(f, openmm.NonbondedForce))
    rows = [[v._value for v in nonbonded.getParticleParameters(i)] for i in range(s.n_atoms)]
    q, sigma, epsilon = np.array(rows).T
    assert not q[s.obstacle].any()
    for atom in np.flatnonzero(s.obstacle):
        assert (sigma[atom], epsilon[atom]) == pytest.approx(lennard_jones(str(s.atom_element[atom])))
    here, there = np.flatnonzero(s.obstacle), np.flatnonzero(~s.obstacle)
    r = np.linalg.norm(s.positions[here][:, None] - s.positions[there], axis=-1)
    mean = 0.5 * (sigma[here][:, None] + sigma[there])
    depth = np.sqrt(epsilon[here][:, None] * epsilon[there])
    own = (4 * depth * ((mean / r) ** 12 - (mean / r) ** 6)).sum()
    assert e(s.positions)[0] - e(away)[0] == pytest.approx(own, rel=1e-6)


def crowded(tmp_path: Path) -> Path:
    """Insulin, and beside it two molecules of two atoms far apart, which lie on one another."""
    lines = records(STRUCTURES / "3i40.pdb", lambda line: line[17:20] != "HOH")
    x = np.array([[float(line[k : k + 8]) for k in (30, 38, 46)] for line in lines])
    out = x[np.argmax(x[:, 0])] + [4.0, 0.0, 0.0]
    for number, shift in ((901, 0.0), (902, 0.3)):
        for k, name in enumerate(("P", "O1")):
            at = out + np.array([5.0 * k, shift, 0.0])
            lines.append(
                f"HETATM{number:5d}  {name:<3} PO1 C {number}    {at[0]:8.3f}{at[1]:8.3f}{at[2]:8.3f}"
                f"  1.00  0.00           {name[0]}\n"
            )
    return written(tmp_path, "".join(lines) + "END\n")


def test_obstacles_are_one_thing_that_stands_still(tmp_path):
    """They do not push one another, nor do their overlaps count; the largest chain stays with them."""
    s = pc.load(crowded(tmp_path))
    still = np.flatnonzero(s.obstacle)
    assert len(still) == 4 and s.n_chains == 2
    e = pc.energy(s, solvent="vacuum")
    nonbonded = next(f for f in e.system.getForces() if isinstance(f, openmm.NonbondedForce))
    silent = {
        tuple(sorted(nonbonded.getExceptionParameters(k)[:2]))
        for k in range(nonbonded.getNumExceptions())
        if nonbonded.getExceptionParameters(k)[4]._value == 0.0
    }
    # Of one molecule, and touching ones; P of one and O1 of the other are 5 angstrom apart.
    p1, o1, p2, o2 = still.tolist()
    assert {(p1, o1), (p2, o2), (p1, p2), (o1, o2)} <= silent and not {(p1, o2), (o1, p2)} & silent
    assert [e.system.getParticleMass(int(k))._value for k in still] == [0.0] * 4
    assert not {a for pair in overlaps(s, s.positions) for a in (pair.first, pair.second) if "PO1" in a}
    c = pc.build_chain(s)
    kinds = [
        str(HingeKind(kind).name)
        for kind, parent in zip(c.tree.kind, c.tree.parent, strict=True)
        if parent < 0
    ]
    assert sorted(kinds) == ["FIXED", "FIXED", "FREE"]
    size = np.bincount(s.residue_chain_index[s.atom_residue])
    (free,) = {int(s.residue_chain_index[r]) for r in s.atom_residue[_of_root(c, HingeKind.FREE)]}
    assert size[free] == sorted(size[:2])[0]


def _of_root(c: pc.Chain, kind: HingeKind) -> np.ndarray:
    """Atoms of the trees whose root is of a kind."""
    root = np.arange(c.n_bodies)
    for b in range(c.n_bodies):
        if c.tree.parent[b] >= 0:
            root[b] = root[c.tree.parent[b]]
    return np.flatnonzero(c.tree.kind[root[c.atom_body]] == kind)


def test_charges_of_the_file_are_used(tmp_path):
    lines = records(shared("1bx8_hirustasin.pdb"))
    charged = [
        line[:78].rstrip("\n").ljust(78) + "1-\n"
        if line[17:20] == "SO4" and line[12:16].strip() in ("O1", "O2") else line
        for line in lines
    ]  # fmt: skip
    s = pc.load(written(tmp_path, "".join(charged) + "END\n"))
    assert s.formal_charge.sum() == -2
    system = pc.energy(s).system
    nonbonded = next(f for f in system.getForces() if isinstance(f, openmm.NonbondedForce))
    q = np.array([nonbonded.getParticleParameters(i)[0]._value for i in range(s.n_atoms)])
    assert np.array_equal(q[s.obstacle], s.formal_charge[s.obstacle]) and q.sum() == pytest.approx(
        np.round(q.sum()), abs=1e-6
    )


def test_glycans_stay_bonded_and_do_not_push_their_residue_away(tmp_path):
    """Residues 347 to 357 of chain A of 3o21 with the sugar on ASN 352, by a force field without sugars."""
    path = shared("3o21_1489.pdb")

    def is_part(line):
        number = int(line[22:26])
        return line[21] == "A" and (347 <= number <= 357 or number == 390)

    s = pc.load(written(tmp_path, "".join(records(path, is_part)) + "END\n"), forcefield="amber19")
    names, residue = s.atom_name, s.atom_residue
    (bond,) = (b for b in s.bonds.tolist() if {"ND2", "C1"} == {*names[b]} and len({*residue[b]}) == 2)
    nitrogen, carbon = sorted(bond, key=lambda atom: names[atom] != "ND2")
    assert s.describe(nitrogen) == "atom ND2 of A:ASN352" and not s.obstacle[carbon]
    partners = {str(names[k]) for pair in s.bonds[(s.bonds == nitrogen).any(axis=1)] for k in pair}
    assert len(partners) == 4 and partners > {"ND2", "CG", "C1"} and not s.ties
    c, e = pc.build_chain(s), pc.energy(s, "amber19")
    charge = next(f for f in e.system.getForces() if isinstance(f, openmm.NonbondedForce))
    total = sum(charge.getParticleParameters(i)[0]._value for i in range(s.n_atoms))
    assert total == pytest.approx(round(total), abs=1e-6)
    r = pc.minimise(c, e, "cartesian", max_evaluations=100)
    # 0.133 nm in the file; of N-glycosidic bonds in small crystals 0.145.
    assert 0.13 < np.linalg.norm(r.x[nitrogen] - r.x[carbon]) < 0.15


def test_a_zinc_site_is_prepared_as_one(tmp_path):
    s = pc.load(zinc_finger(tmp_path))
    names = set(zip(s.residue_number[s.atom_residue].tolist(), s.atom_name.tolist(), strict=True))
    assert not {("5", "HG"), ("8", "HG"), ("21", "HE2"), ("27", "HE2")} & names
    assert {("21", "HD1"), ("27", "HD1")} < names
    bonds = [tie for tie in s.ties if len(tie.atoms) == 2]
    assert [f"{10 * tie.rest:.2f}" for tie in bonds] == ["2.28", "2.28", "2.03", "2.03"]
    assert s.kept.sum() == 1 and not s.obstacle.any() and s.n_chains == 1
    e = pc.energy(s)
    stretched = s.positions + np.where(s.kept, 0.01, 0.0)[:, None]
    parts = e.parts(stretched)[0]
    own = sum(
        0.5 * tie.stiffness * (np.linalg.norm(np.subtract(*stretched[list(tie.atoms)])) - tie.rest) ** 2
        for tie in bonds
    )
    assert parts["ties"] == pytest.approx(own) and e.parts(s.positions)[0]["ties"] == pytest.approx(
        0.0, abs=1e-9
    )
    assert e(stretched)[0] == pytest.approx(e.reference(stretched)[0], rel=NATIVE_ENERGY)
    # The springs are those of the input, wherever a result lies.
    assert pc.energy(s.with_positions(stretched)).fingerprint == e.fingerprint


def test_zinc_sites_stay_together(tmp_path):
    s = pc.load(zinc_finger(tmp_path))
    r = pc.minimise(pc.build_chain(s), pc.energy(s), "lbfgs", max_evaluations=400)
    assert moved(s, r.x, site_of(s)) < SITE_NM


def test_without_springs_the_site_falls_apart(tmp_path):
    """The test above can fail: the same file without its zinc."""
    s = pc.load(zinc_finger(tmp_path), keep=("none",))
    r = pc.minimise(pc.build_chain(s), pc.energy(s), "lbfgs", max_evaluations=400)
    names = (("5", "SG"), ("8", "SG"), ("21", "NE2"), ("27", "NE2"))
    at = list(zip(s.residue_number[s.atom_residue].tolist(), s.atom_name.tolist(), strict=True))
    assert moved(s, r.x, [at.index(name) for name in names]) > SITE_NM


@pytest.mark.slow
@pytest.mark.parametrize("method", ["lbfgs", "hybrid"])
def test_heme_sites_stay_together(tmp_path, method):
    s = pc.load(globin(tmp_path))
    assert {"HEM", "CMO"} < set(s.residue_name) and len(site_of(s)) == 2
    r = pc.minimise(pc.build_chain(s), pc.energy(s), method, max_evaluations=1000)
    heme = np.flatnonzero(s.residue_name[s.atom_residue] == "HEM").tolist()
    assert moved(s, r.x, sorted({*site_of(s), *heme})) < SITE_NM


@pytest.mark.parametrize(("name", "n"), [("SF4", 8), ("FES", 4)])
def test_iron_sulphur_clusters_are_prepared_as_sites(tmp_path, name, n):
    s = pc.load(iron_sulphur(tmp_path, name))
    assert s.obstacle.sum() == n and np.array_equal(s.kept, s.obstacle)
    bonds = [tie for tie in s.ties if len(tie.atoms) == 2]
    ends = [(str(s.atom_name[i]), str(s.atom_name[j])[:2]) for i, j in (tie.atoms for tie in bonds)]
    assert ends == [("SG", "FE")] * 4 and len({tie.atoms[0] for tie in bonds}) == 4
    assert [tie.rest for tie in bonds] == pytest.approx([0.23] * 4, abs=5e-4)
    assert not any("disulfide" in line for line in sentences(s))
    hydrogens = {str(h) for h in s.atom_name[s.atom_element == "H"]}
    assert "HB2" in hydrogens and "HG" not in hydrogens
    # Their iron is no bond of the cluster's own sulphides, and sulphides hold no hydrogens.
    assert {str(e) for e in s.atom_element[s.kept]} == {"Fe", "S"}
    system = pc.energy(s).system
    nonbonded = next(f for f in system.getForces() if isinstance(f, openmm.NonbondedForce))
    q = np.array([nonbonded.getParticleParameters(i)[0]._value for i in range(s.n_atoms)])
    sulphurs = [tie.atoms[0] for tie in bonds]
    assert np.all(q[sulphurs] < -0.5) and q.sum() == pytest.approx(round(q.sum()), abs=1e-6)


def test_iron_sulphur_clusters_stay_together(tmp_path):
    s = pc.load(iron_sulphur(tmp_path, "FES"))
    r = pc.minimise(pc.build_chain(s), pc.energy(s), "hybrid", max_evaluations=300)
    cluster = np.flatnonzero(s.kept).tolist()
    assert moved(s, r.x, sorted({*site_of(s), *cluster})) < SITE_NM
    assert np.linalg.norm(r.x - s.positions, axis=1).max() > SITE_NM


def test_metal_sites_and_bonds_to_ligands_can_be_closed_in_dynamics(tmp_path):
    # Beside force fields that Sage does not go with, springs hold ligands.
    tied = pc.load(shared("1grm_gramicidin.pdb"), forcefield="charmm36")
    for s in (pc.load(zinc_finger(tmp_path)), tied):
        m = pc.simulate(pc.build_chain(s), pc.energy(s, solvent="vacuum"), n_steps=5, loops="closed")
        for tie in s.ties:
            if len(tie.atoms) == 2:
                assert np.linalg.norm(np.subtract(*m.x[list(tie.atoms)])) == pytest.approx(tie.rest, abs=1e-6)


def complexes(name: str) -> Path:
    """A file of the shared complexes, or skip."""
    return shared(f"../complexes/{name}")


@pytest.mark.parametrize(
    ("name", "pairs", "count"),
    [
        ("clash_dna.pdb", {("OG1", "OP2"), ("NH1", "O6"), ("NH2", "N7")}, 3),
        ("clash_ligand.cif", {("SG", "C"), ("SG", "O"), ("SG", "CH3")}, 4),  # Two chains, too, begin as one.
    ],
)
def test_molecules_pushed_into_the_protein_overlap_and_are_not_bonded(name, pairs, count):
    s = pc.load(complexes(f"models/{name}"))
    assert not s.ties and not len(s.links)
    found = [each for each in overlaps(s, s.positions) if s.kept[[*each.atoms]].sum() == 1]
    named = {tuple(s.atom_name[list(each.atoms)].tolist()) for each in found}
    assert pairs <= named | {pair[::-1] for pair in named}
    (line,) = (line for line in sentences(s) if "not bonded" in line)
    assert line.startswith(f"{count} pairs of atoms as near as bonded ones")
    # No hydrogen gives way to a bond that is none; tautomers of histidine may depend on what is near.
    whole = pc.load(complexes(f"models/{name}"), keep="none")
    names = [each[~np.isin(each, ["HD1", "HE2"])] for each in (whole.atom_name, s.atom_name[~s.kept])]
    assert np.array_equal(*names)


def test_a_relaxation_parts_the_protein_from_what_overlaps_with_it():
    r = pc.relax(complexes("models/clash_dna.pdb"), threads=1)
    record = r.record()
    assert record["overlaps_beside_start"] >= 3 and record["overlaps_beside_end"] == 0
    assert r.status == "converged" and np.array_equal(
        r.x[r.start.obstacle], r.start.positions[r.start.obstacle]
    )
    # Where the protein may not give way, the status and the message say so.
    held = pc.relax(complexes("models/clash_dna.pdb"), threads=1, max_iterations=1, max_outer_iterations=1)
    assert held.status == "clash" and "apart" in held.message


def methylated(tmp_path: Path, far: float, connected: bool) -> Path:
    """Trp-cage with a molecule of one carbon beyond NH1 of its arginine, with a CONECT record or without."""
    model = gemmi.read_structure(str(STRUCTURES / "1l2y.pdb"))[0]
    arginine = next(each for each in model[0] if each.name == "ARG")
    nitrogen, centre = (np.array(arginine[name][0].pos.tolist()) for name in ("NH1", "NE"))
    at = nitrogen + far * (nitrogen - centre) / np.linalg.norm(nitrogen - centre)
    serial = arginine["NH1"][0].serial
    carbon = "HETATM 9001  C   XXC A 101    {:8.3f}{:8.3f}{:8.3f}  1.00  0.00           C\n".format(*at)
    link = f"CONECT{serial:5d} 9001\n" * connected
    atoms = records(STRUCTURES / "1l2y.pdb", lambda line: line[76:78].strip() != "H")
    return written(tmp_path, "".join(atoms) + carbon + link + "END\n")


@pytest.mark.parametrize(
    ("far", "connected", "bonded"), [(1.46, True, True), (1.46, False, False), (2.6, True, False)]
)
def test_bonds_of_conect_records_are_believed_at_lengths_of_bonds(tmp_path, far, connected, bonded):
    s = pc.load(methylated(tmp_path, far, connected))
    assert [tuple(s.atom_name[pair].tolist()) for pair in s.links] == [("NH1", "C")] * bonded
    assert any("not bonded" in line for line in sentences(s)) is (not connected)
    assert any("ignored: it is 2.60 angstrom long" in line for line in sentences(s)) is (far > 2.0)


def test_ions_whose_waters_are_left_out_stay_in_place():
    s = pc.load(complexes("astex/1V48_HA1_protein.pdb"))
    ions = [tie.atoms[1] for tie in s.ties if len(tie.atoms) == 2]
    assert len(ions) < 4 and s.obstacle[ions].all()
    assert any(line.endswith("; the ion stays in place") for line in sentences(s))
    r = pc.minimise(s, pc.energy(s, solvent="vacuum"), "cartesian", max_evaluations=10)
    assert np.array_equal(r.x[ions], s.positions[ions])


def test_a_carbonyl_missing_at_a_kept_cap_is_added_and_the_bond_is_an_amides(tmp_path):
    text = shared("1grm_gramicidin.pdb").read_text()
    lines = [line for line in text.splitlines(keepends=True) if line[12:26] != " O   TRP A  15"]
    (tmp_path / "cut.pdb").write_text("".join(lines))
    whole, cut = pc.load(shared("1grm_gramicidin.pdb")), pc.load(tmp_path / "cut.pdb")
    assert cut.n_atoms == whole.n_atoms
    pc.save(cut, tmp_path / "again.cif")
    assert pc.load(tmp_path / "again.cif").n_atoms == whole.n_atoms


def moved_sdf(name, by):
    """Text of a sample's SDF with its atoms moved, angstrom."""
    lines = (STRUCTURES / name).read_text().splitlines(keepends=True)
    for k in range(4, 4 + int(lines[3][:3])):
        x = [float(lines[k][i : i + 10]) + shift for i, shift in zip((0, 10, 20), by, strict=True)]
        lines[k] = "".join(f"{each:10.4f}" for each in x) + lines[k][30:]
    return "".join(lines)


def sdf_atoms(text):
    lines = text.splitlines()
    return np.array(
        [[float(lines[k][i : i + 10]) for i in (0, 10, 20)] for k in range(4, 4 + int(lines[3][:3]))]
    )


@pytest.mark.parametrize(("far", "stays"), [(3.5, True), (7.0, False)])
def test_what_is_near_a_pose_belongs_to_the_site(far, stays, tmp_path):
    """A sulphate that is 5.5 angstrom or more from the protein, beside a nicotine that is put there."""
    protein = pc.load(STRUCTURES / "1l2y.pdb")
    x = 10.0 * protein.positions[protein.atom_element != "H"]
    top = x[np.argmax(x[:, 2])]
    ligand = sdf_atoms((STRUCTURES / "1P2Y_NCT.sdf").read_text())
    low = ligand[np.argmin(ligand[:, 2])]
    by = top - low + np.array([0.0, 0.0, 4.0])
    pose = tmp_path / "pose.sdf"
    pose.write_text(moved_sdf("1P2Y_NCT.sdf", by))
    high = (ligand + by)[np.argmax(ligand[:, 2])]
    sulphur = high + np.array([0.0, 0.0, far])
    oxygens = 1.49 / np.sqrt(3.0) * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) * [1, 1, 0.0]
    oxygens[:, 2] = [0.86, 0.86, 0.86, 0.86]
    names = ("S", "O1", "O2", "O3", "O4")
    pc.save(protein, tmp_path / "one.pdb")
    atoms = [
        line for line in (tmp_path / "one.pdb").read_text().splitlines(keepends=True) if line[:4] == "ATOM"
    ]
    x = sulphur + np.vstack([np.zeros(3), oxygens])
    beside = [
        f"HETATM{9000 + k:5d}  {name:3} SO4 B   1    "
        f"{x[k][0]:8.3f}{x[k][1]:8.3f}{x[k][2]:8.3f}  1.00 10.00          {name[0]:>2}\n"
        for k, name in enumerate(names)
    ]
    (tmp_path / "site.pdb").write_text("".join([*atoms, "TER\n", *beside, "END\n"]))
    assert "SO4" not in pc.load(tmp_path / "site.pdb").residue_name
    s = pc.load(tmp_path / "site.pdb", ligands=str(pose))
    assert ("SO4" in s.residue_name) == stays
