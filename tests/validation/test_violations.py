"""Violations as AlphaFold counts them: its published arrays, a slow oracle, planted faults."""

import csv
from itertools import combinations

import numpy as np
import pytest
from fixtures.command_line import run
from fixtures.molecules import atom
from fixtures.samples import ROOT, load, shared
from openmm import HarmonicBondForce, app

import protochain as pc
from protochain.validation.violations import violations

ATOM14 = {
    "ALA": "CB", "ARG": "CB CG CD NE CZ NH1 NH2", "ASN": "CB CG OD1 ND2", "ASP": "CB CG OD1 OD2",
    "CYS": "CB SG", "GLN": "CB CG CD OE1 NE2", "GLU": "CB CG CD OE1 OE2", "GLY": "",
    "HIS": "CB CG ND1 CD2 CE1 NE2", "ILE": "CB CG1 CG2 CD1", "LEU": "CB CG CD1 CD2", "LYS": "CB CG CD CE NZ",
    "MET": "CB CG SD CE", "PHE": "CB CG CD1 CD2 CE1 CE2 CZ", "PRO": "CB CG CD", "SER": "CB OG",
    "THR": "CB OG1 CG2", "TRP": "CB CG CD1 CD2 NE1 CE2 CE3 CZ2 CZ3 CH2", "TYR": "CB CG CD1 CD2 CE1 CE2 CZ OH",
    "VAL": "CB CG1 CG2",
}  # fmt: skip
ATOM14 = {name: ["N", "CA", "C", "O", *rest.split()] for name, rest in ATOM14.items()}
KINDS = ("bonds", "angles_ca_c_n", "angles_c_n_ca", "clashes", "within", "covalent")
RADIUS = {"C": 1.7, "N": 1.55, "O": 1.52, "S": 1.8}

# alphafold/relax/amber_minimize_test.py of AlphaFold 2.3, test_find_violations.
PUBLISHED_CONNECTIONS = [42, 43, 59, 60, 135, 136]
PUBLISHED_CLASHES = [
    (8, 4), (8, 5), (13, 3), (14, 1), (14, 4), (26, 4), (26, 5), (31, 8), (31, 10), (39, 0), (39, 1),
    (39, 2), (39, 3), (39, 4), (42, 5), (42, 6), (42, 7), (42, 8), (47, 7), (47, 8), (47, 9), (47, 10),
    (64, 4), (85, 5), (102, 4), (102, 5), (109, 13), (111, 5), (118, 6), (118, 7), (118, 8), (124, 4),
    (124, 5), (131, 5), (139, 7), (147, 4), (152, 7),
]  # fmt: skip


def connected(structure, found):
    """Residues of wrong bonds and angles."""
    atoms = np.concatenate([found.bonds.ravel(), found.angles_ca_c_n.ravel(), found.angles_c_n_ca.ravel()])
    return np.unique(structure.atom_residue[atoms]).tolist()


def slow(structure, x):
    """All violations by loops over all pairs: names of kinds to sets of atoms."""
    x = 10.0 * x
    atoms = {}
    for i, name in enumerate(structure.atom_name):
        residue = int(structure.atom_residue[i])
        if name in ATOM14.get(str(structure.residue_name[residue]), ()):
            atoms[residue, str(name)] = i
    bonded = {frozenset(bond) for bond in structure.bonds.tolist()}
    found = {kind: set() for kind in KINDS}
    for i, j, usual in lengths(structure):
        length, is_h = np.linalg.norm(x[i] - x[j]), "H" in structure.atom_element[[i, j]]
        if length > usual + 0.3 or length < (0.65 * usual if is_h else usual - 0.3):
            found["covalent"].add(tuple(sorted((i, j))))

    def cosine(i, j, k):
        u, v = x[i] - x[j], x[k] - x[j]
        return u @ v / np.linalg.norm(u) / np.linalg.norm(v)

    for r in range(structure.n_residues - 1):
        ca, c = atoms[r, "CA"], atoms[r, "C"]
        n, next_ca = atoms[r + 1, "N"], atoms[r + 1, "CA"]
        if frozenset((c, n)) not in bonded:
            continue
        mean, sigma = (1.341, 0.016) if structure.residue_name[r + 1] == "PRO" else (1.329, 0.014)
        if abs(np.linalg.norm(x[c] - x[n]) - mean) > 12 * sigma:
            found["bonds"].add((c, n))
        if abs(cosine(ca, c, n) + 0.4473) > 12 * 0.014:
            found["angles_ca_c_n"].add((ca, c, n))
        if abs(cosine(c, n, next_ca) + 0.5203) > 12 * 0.0353:
            found["angles_c_n_ca"].add((c, n, next_ca))
    allowed = bounds()
    for ((r, a), i), ((q, b), j) in combinations(sorted(atoms.items()), 2):
        distance = np.linalg.norm(x[i] - x[j])
        least = RADIUS[a[0]] + RADIUS[b[0]] - 1.5
        if r == q:
            low, high = allowed.get((str(structure.residue_name[r]), frozenset((a, b))), (least, np.inf))
            if not low <= distance <= high:
                found["within"].add(tuple(sorted((i, j))))
        elif a == b == "SG" or (frozenset((i, j)) in bonded and {a, b} == {"C", "N"}):
            continue
        elif distance < least:
            found["clashes"].add(tuple(sorted((i, j))))
    return found


def lengths(structure):
    """Bonds of a protein and their lengths in angstrom, by OpenMM's System."""
    system = app.ForceField("amber14/protein.ff14SB.xml").createSystem(structure.topology)
    (force,) = (force for force in system.getForces() if isinstance(force, HarmonicBondForce))
    terms = (force.getBondParameters(k) for k in range(force.getNumBonds()))
    return [(i, j, 10.0 * usual._value) for i, j, usual, _ in terms]


def bounds():
    """Least and greatest distances one and two bonds apart, by residue and names, errors by differences."""
    with (ROOT / "protochain/validation/data/geometry.csv").open() as file:
        rows = [
            (r["residue"], r["atoms"].split("-"), float(r["mean"]), float(r["sigma"]))
            for r in csv.DictReader(file)
        ]
    lengths = {(name, frozenset(ends)): (m, s) for name, ends, m, s in rows if len(ends) == 2}
    found = dict(lengths)
    for name, ends, mean, sigma in rows:
        if len(ends) == 3:
            values = [lengths[name, frozenset(ends[:2])], lengths[name, frozenset(ends[1:])]]
            values.append((np.radians(mean), np.radians(sigma)))

            def side(a, b, angle):
                return np.sqrt(a * a + b * b - 2 * a * b * np.cos(angle))

            means, h = np.array([value for value, _ in values]), 1e-6
            slopes = [(side(*(means + step)) - side(*(means - step))) / (2 * h) for step in h * np.eye(3)]
            error = np.sqrt(sum((slope * s) ** 2 for slope, (_, s) in zip(slopes, values, strict=True)))
            found[name, frozenset((ends[0], ends[2]))] = side(*means), error
    return {key: (mean - 12 * sigma, mean + 12 * sigma) for key, (mean, sigma) in found.items()}


def as_sets(found):
    return {kind: set(map(tuple, getattr(found, kind).tolist())) for kind in KINDS}


def moved(structure, atoms, by):
    x = structure.positions.copy()
    x[atoms] += by
    return x


def test_alphafold_finds_the_same_on_its_own_test_structure():
    s = pc.load(shared("af_multiple_disulfides.pdb"))
    found = violations(s)
    expected = sorted(
        atom(s, residue, ATOM14[str(s.residue_name[residue])][place]) for residue, place in PUBLISHED_CLASHES
    )
    assert found.clashing_atoms.tolist() == expected and len(expected) == 37
    assert connected(s, found) == PUBLISHED_CONNECTIONS
    assert found.counts["within"] == 0
    kinds = [line.split(":")[0] for line in found.lines(s)]
    disulfides = found.counts["covalent"]
    assert kinds == ["bond"] + 2 * ["angle"] + found.counts["clashes"] * ["clash"] + disulfides * [
        "covalent bond"
    ]
    # AlphaFold spares its disulfides, 10 of which are 1.1 to 1.7 or 2.4 to 2.9 angstrom long.
    assert disulfides == 10 and {*s.atom_name[found.covalent.ravel()]} == {"SG"}
    published = {r for r, _ in PUBLISHED_CLASHES} | set(PUBLISHED_CONNECTIONS)
    assert len(published) == 24 and published <= set(found.residues.tolist())
    assert set(found.residues.tolist()) == published | set(s.atom_residue[found.covalent.ravel()].tolist())


def test_the_structure_that_alphafold_names_after_its_violations_has_some():
    s = pc.load(shared("af_with_violations.pdb"))
    found = violations(s)
    assert as_sets(found) == slow(s, s.positions)
    assert found and len(found.clashing_atoms) == 17 and connected(s, found) == [59, 60]


@pytest.mark.parametrize(
    ("name", "residues", "clashing", "within"),
    [("3enl_enolase.pdb", 6, 0, 0), ("1ajj_ldlr.pdb", 0, 0, 2), ("5pti_bpti.cif", 0, 0, 2),
     ("boltz2_5ht2c.cif", 0, 2, 0), ("1bhl_gap_cas.pdb", 0, 0, 0)],
)  # fmt: skip
def test_counts_are_those_of_alphafolds_own_code(name, residues, clashing, within):
    """Residues of wrong connections, atoms in clashes and of wrong distances: alphafold-colabfold 2.3.27."""
    s = pc.load(shared(name))
    found = violations(s)
    counts = (len(connected(s, found)), len(found.clashing_atoms), len(np.unique(found.within)))
    assert counts == (residues, clashing, within)


@pytest.mark.parametrize(("name", "noise"), [("1l2y.pdb", 0.01), ("4pti.pdb", 0.04)])
def test_equals_the_slow_oracle_with_and_without_noise(name, noise):
    s = load(name)
    x = s.positions + np.random.default_rng(1).normal(0.0, max(noise, 1e-9), s.positions.shape)
    found, expected = violations(s, x), slow(s, x)
    assert as_sets(found) == expected
    assert found.counts == {kind: len(its) for kind, its in expected.items()}
    if noise == 0.04:
        assert all(expected.values())  # every kind is compared
    if not noise:
        assert not found and str(found) == "no violations" and not found.lines(s)


@pytest.mark.parametrize(("length", "wrong"), [(1.329 - 0.167, 0), (1.329 - 0.169, 1), (1.5, 1), (1.496, 0)])
def test_a_peptide_bond_is_wrong_beyond_twelve_deviations(length, wrong):
    s = load("ala10.pdb")
    c, n = atom(s, 3, "C"), atom(s, 4, "N")
    along = s.positions[n] - s.positions[c]
    back = np.flatnonzero(s.atom_residue >= 4)
    x = moved(s, back, along * (0.1 * length / np.linalg.norm(along) - 1.0))
    found = violations(s, x)
    assert len(found.bonds) == wrong and len(found.within) == 0
    if wrong:
        assert found.bonds.tolist() == [[c, n]] and {3, 4} <= set(found.residues.tolist())
        assert f"are {length:.2f} angstrom apart" in found.lines(s, x)[0]


def test_a_proline_has_bounds_of_its_own():
    """Its bond may be 1.341 + 0.192 long, any other 1.329 + 0.168."""
    s = load("1l2y.pdb")
    proline = s.residue_name.tolist().index("PRO")
    for residue, wrong in ((proline, 0), (proline - 2, 1)):
        c, n = atom(s, residue - 1, "C"), atom(s, residue, "N")
        along = s.positions[n] - s.positions[c]
        x = moved(s, s.atom_residue >= residue, along * (0.152 / np.linalg.norm(along) - 1.0))
        assert len(violations(s, x).bonds) == wrong


def test_one_atom_put_onto_another_is_a_clash_of_both_and_strains_its_residue():
    s = load("1ubq.pdb")
    i, j = atom(s, 1, "CD"), atom(s, 60, "CD1")
    found = violations(s, moved(s, i, s.positions[j] + [0.05, 0, 0] - s.positions[i]))
    assert sorted((i, j)) in found.clashes.tolist()
    assert len(found.within) > 0 and set(s.atom_residue[found.within.ravel()]) == {1}
    assert not len(found.bonds) and {1, 60} <= set(found.residues.tolist())
    line = next(line for line in found.lines(s) if s.describe(i) in line and s.describe(j) in line)
    assert line.startswith("clash: ")


def test_sulphurs_hydrogens_and_terminal_oxygens_do_not_clash():
    s = load("4pti.pdb")
    free = [atom(s, r, "SG") for r in np.flatnonzero(s.residue_name == "CYS")[:2]]
    x = moved(s, free[0], s.positions[free[1]] + [0.06, 0, 0] - s.positions[free[0]])
    assert free not in violations(s, x).clashes.tolist()
    last = s.n_residues - 1
    for loose in (atom(s, last, "OXT"), atom(s, 10, "H")):
        x = moved(s, loose, s.positions[atom(s, 30, "CA")] + [0.05, 0, 0] - s.positions[loose])
        found = violations(s, x)
        assert len(found.covalent) == sum(found.counts.values()) == 1 and loose in found.covalent


def test_chains_are_compared_with_one_another():
    """Residues of one number too, which AlphaFold's own count passes over."""
    s = load("3i40.pdb")
    chains = s.residue_chain.tolist()
    a, b = chains.index("A") + 4, chains.index("B") + 4
    assert s.residue_number[a] == s.residue_number[b]
    i, j = atom(s, a, "CA"), atom(s, b, "CA")
    x = moved(s, s.residue_chain[s.atom_residue] == "A", s.positions[j] + [0.1, 0, 0] - s.positions[i])
    assert sorted((i, j)) in violations(s, x).clashes.tolist()
    assert not violations(s)


def test_a_bond_between_residues_whose_numbers_do_not_follow_is_no_clash():
    """AlphaFold, which goes by the numbers, calls it one."""
    s = pc.load(shared("6lfo_gap_model.pdb"))
    number = [int(each) for each in s.residue_number]
    jump = [r for r in range(s.n_residues - 1) if number[r + 1] > number[r] + 1]
    c, n = zip(*((atom(s, r, "C"), atom(s, r + 1, "N")) for r in jump), strict=True)
    apart = np.linalg.norm(s.positions[list(c)] - s.positions[list(n)], axis=1)
    assert (apart < 0.15).any() and not len(violations(s).clashes)


def test_a_chain_split_at_a_long_bond_violates_it(tmp_path):
    """It is two chains afterwards; AlphaFold goes by the numbers."""
    lines = (ROOT / "structures/ala10.pdb").read_text().splitlines(keepends=True)
    far = [
        f"{line[:30]}{float(line[30:38]) + 4.0:8.3f}{line[38:]}"
        if line.startswith("ATOM") and int(line[22:26]) > 5
        else line
        for line in lines
        if line.startswith(("ATOM", "END"))
    ]
    (tmp_path / "far.pdb").write_text("".join(far))
    s = pc.load(tmp_path / "far.pdb")
    assert s.n_chains == 2
    found = violations(s)
    assert s.atom_residue[found.bonds].tolist() == [[4, 5]]
    renumbered = [
        line if int(line[22:26]) < 6 else f"{line[:22]}{int(line[22:26]) + 3:4d}{line[26:]}"
        for line in far
        if line.startswith("ATOM")
    ]
    (tmp_path / "gap.pdb").write_text("".join(renumbered))
    assert not violations(pc.load(tmp_path / "gap.pdb"))


def shifted(s, i, length):
    """Positions with one end of its first bond put at a length, angstrom, and the bond."""
    (pair,) = s.bonds[(s.bonds == i).any(axis=1)][:1]
    j = int(pair[pair != i][0])
    along = s.positions[i] - s.positions[j]
    x = s.positions.copy()
    x[i] = s.positions[j] + 0.1 * length * along / np.linalg.norm(along)
    return x, sorted((i, j))


def named(s, residue, name):
    """An atom by the name of its residue in the file, or its number, and its own."""
    of = s.atom_residue
    here = (s.residue_name[of] == residue) | (s.residue_number[of] == residue)
    return int(np.flatnonzero(here & (s.atom_name == name))[0])


@pytest.mark.parametrize(
    ("file", "residue", "name", "lengths"),
    [("1l2y_trpcage.pdb", "4", "HD11", (0.6, 1.5, 7.0)), ("1l2y_trpcage.pdb", "1", "H2", (0.5, 1.4)),
     ("1l2y_trpcage.pdb", "20", "OXT", (0.8, 1.7)), ("1l2y_trpcage.pdb", "3", "HH", (0.5, 1.4)),
     ("3al1_caps_altloc.pdb", "ACE", "H1", (0.6, 1.5)), ("3al1_caps_altloc.pdb", "MPD", "1HM", (0.6, 1.5)),
     ("../complexes/models/1bna.pdb", "3", "H5''", (0.6, 1.6)), ("4pti_bpti.pdb", "5", "SG", (1.4, 2.6)),
     ("1as5_conotoxin.cif", "HYP", "HD1", (0.6, 1.5)), ("2n0n_lactam.pdb", "AIB", "HB11", (0.6, 1.5))],
)  # fmt: skip
def test_a_covalent_bond_of_a_wrong_length_is_found_in_every_kind_of_molecule(file, residue, name, lengths):
    """Nothing measured bonds to hydrogen, disulfides and terminal oxygens, and those of moving molecules."""
    s = pc.load(shared(file))
    i, sound = named(s, residue, name), violations(s)
    for length in lengths:
        x, bond = shifted(s, i, length)
        found = pc.validate(s.with_positions(x))
        new = {*map(tuple, found.violations.covalent.tolist())} - {*map(tuple, sound.covalent.tolist())}
        # A heavy atom has more bonds than the one that was drawn out.
        assert tuple(bond) in new and (len(new) == 1 or name == "SG")
        at = s.residue(int(s.atom_residue[i]))
        assert int(s.atom_residue[i]) in found.violations.residues
        assert found.measures["violations"] > len(sound.residues)
        said = [line for line in found.listing() if name in line and f"{length:.2f} angstrom" in line]
        assert said and (s.kept[i] or at.label in said[0])


@pytest.mark.parametrize(
    ("file", "shortest"),
    [("3u7t_crambin_neutron.cif", 0.85), ("5pti_bpti.cif", 0.90), ("3al1_caps_altloc.pdb", 0.82),
     ("1bta_barstar.pdb", 0.95), ("1ubi_ubiquitin_addH.pdb", 1.17), ("dhfr_jac_amber.pdb", 0.95),
     ("1ejg_crambin.pdb", 0.96), ("2sdf_sdf1_nmr30.pdb", 0.95)],
)  # fmt: skip
def test_hydrogens_where_methods_put_them_are_no_violations(file, shortest):
    """Neutrons, X-rays (0.82 to 0.98 angstrom), NMR, Amber, OpenMM: conventions, and no faults."""
    s = pc.load(shared(file))
    to_hydrogen = s.bonds[(s.atom_element[s.bonds] == "H").any(axis=1)]
    length = 10.0 * np.linalg.norm(np.subtract(*s.positions[to_hydrogen.T]), axis=1)
    assert length.min() == pytest.approx(shortest, abs=0.05) and length.max() < 1.4
    assert len(violations(s).covalent) == 0


@pytest.mark.parametrize("method", ["lbfgs", "newton", "kcm"])
def test_a_run_in_torsions_reports_a_hydrogen_far_from_its_atom(method):
    """It mends no bond, and ended converged."""
    s = load("ala10.pdb")
    x, _ = shifted(s, named(s, "3", "HB1"), 4.0)
    # So high a tolerance is met at the start: what remains is the bond.
    found = pc.minimise(s.with_positions(x), method=method, tolerance=1e6, max_evaluations=20)
    assert found.status == "violations" and "CB of A:ALA3 to HB1, 4.00 angstrom" in found.message
    assert found.measures_end["violations"] == 1
    sound = pc.minimise(s, method=method, tolerance=1e6, max_evaluations=20)
    assert sound.status == "converged"


def test_relax_puts_such_a_hydrogen_back():
    s = load("ala10.pdb")
    x = s.positions.copy()
    x[named(s, "3", "HB1")] = s.positions[named(s, "6", "CB")] + [0.005, 0.0, 0.0]
    found = pc.relax(s.with_positions(x))
    assert (found.measures_start["violations"], found.measures_end["violations"]) == (1, 0)
    assert found.status == "converged"


def test_commands_report_such_a_bond_of_a_file(tmp_path, capsys):
    """Nearer than 1.5 angstrom the reader keeps a hydrogen."""
    s = load("ala10.pdb")
    x, _ = shifted(s, named(s, "3", "HB1"), 1.45)
    path = tmp_path / "drawn.pdb"
    pc.save(s.with_positions(x), path)
    assert run("info", path) is None
    line = "CB of A:ALA3 to HB1, 1.45 angstrom long, not 1.09"
    assert f"violations: 1\n  covalent bond: {line}\n" in capsys.readouterr().out
    run("validate", path)
    assert f"A:ALA3: violation: {line}" in capsys.readouterr().out
