"""NEF and NMR-STAR files against sums over atoms listed by hand."""

import itertools

import numpy as np
import pandas as pd
import pytest
from fixtures.command_line import run
from fixtures.refusals import expect_refusal
from fixtures.samples import STRUCTURES, load

import protochain as pc
from protochain.chains.restraint_lines import read_restraints
from protochain.chains.restraint_list import Restraints
from protochain.energies.custom import check_forces

NEF_ATOM = "chain_code_{0} sequence_code_{0} residue_name_{0} atom_name_{0}"
STAR_ATOM = "Auth_asym_ID_{0} Auth_seq_ID_{0} Comp_ID_{0} Atom_ID_{0}"
SETS = {
    (2, "LEU", "HDx%"): "HD11 HD12 HD13 HD21 HD22 HD23",
    (2, "LEU", "HD1%"): "HD11 HD12 HD13",
    (3, "TYR", "HBx"): "HB2 HB3",
    (3, "TYR", "HB%"): "HB2 HB3",
    (3, "TYR", "HDy"): "HD1 HD2",
    (4, "ILE", "HG1x"): "HG12 HG13",
    (4, "ILE", "HG2%"): "HG21 HG22 HG23",
    (4, "ILE", "HB*"): "HB",
    (5, "GLN", "HE2y"): "HE21 HE22",
    (5, "GLN", "HGx"): "HG2 HG3",
    (8, "LYS", "HZ%"): "HZ1 HZ2 HZ3",
    (1, "ASN", "H%"): "H1 H2 H3",
    (10, "GLY", "HAx"): "HA2 HA3",
    (18, "PRO", "HA"): "HA",
}
"""Atoms that names of NEF mean: specification/Residue_Variants.txt of the format."""


def frame(category, columns, rows, potential="square-well-parabolic"):
    """A saveframe of NEF with one table."""
    lines = [f"save_{category}_list_1", f"_{category}_list.sf_category {category}_list"]
    lines += [f"_{category}_list.potential_type {potential}", "loop_", *(f"_{category}.{c}" for c in columns)]
    return "\n".join([*lines, *(" ".join(map(str, row)) for row in rows), "stop_", "save_", ""])


def atoms_of(n, form=NEF_ATOM):
    return [name for k in range(1, n + 1) for name in form.format(k).split()]


def distances(rows, further="upper_limit", **settings):
    """A file of distances: id, then (number, residue, name) of two atoms, and values of further columns."""
    columns = ["restraint_id", *atoms_of(2), *further.split()]
    flat = [(i, "A", *one, "A", *other, *values) for i, one, other, *values in rows]
    return "data_nef_test\n" + frame("nef_distance_restraint", columns, flat, **settings)


@pytest.fixture(scope="module")
def cage():
    return load("1l2y.pdb")


@pytest.fixture
def read(cage, tmp_path):
    path = tmp_path / "noe.nef"

    def of(text, structure=cage):
        path.write_text(text)
        return Restraints.of(structure, path)

    return of


def effective(structure, *pairs):
    """(sum r^-6)^(-1/6) in angstrom, over pairs of sets of atoms given by (number, names)."""
    number, x = structure.residue_number.astype(int)[structure.atom_residue], 10.0 * structure.positions
    total = 0.0
    for pair in pairs:
        one, other = (
            [
                int(np.flatnonzero((number == n) & (structure.atom_name == name)).item())
                for name in names.split()
            ]
            for n, names in pair
        )
        total += sum(np.linalg.norm(x[a] - x[b]) ** -6.0 for a, b in itertools.product(one, other))
    return total ** (-1.0 / 6.0)


@pytest.mark.parametrize("atom", SETS, ids=lambda atom: f"{atom[1]}-{atom[2]}")
def test_names_of_nef_mean_sets_of_atoms_that_are_summed(cage, read, atom):
    to = (13, "SER", "HA") if atom[0] < 10 else (5, "GLN", "HA")
    held = read(distances([(1, atom, to, 2.0)]))
    r = effective(cage, ((atom[0], SETS[atom]), (to[0], "HA")))
    assert 10.0 * held.values(cage.positions)[0] == pytest.approx(r, rel=1e-12)
    assert held(cage.positions)[0] == pytest.approx(500.0 * (0.1 * (r - 2.0)) ** 2)


def test_rows_of_one_restraint_are_alternatives_with_the_forces_of_their_sum(cage, read):
    rows = [
        (7, (3, "TYR", "HBx"), (8, "LYS", "HZ%"), 1.8, 3.0),
        (8, (2, "LEU", "HA"), (5, "GLN", "HA"), 1.8, 3.0),
        (7, (6, "TRP", "HE1"), (16, "ARG", "HDx"), 1.8, 3.0),
        (7, (3, "TYR", "HBx"), (8, "LYS", "HZ%"), 1.8, 3.0),
    ]
    held = read(distances(rows, "lower_limit upper_limit"))
    assert [restraint.label for restraint in held.listed] == ["noe.nef: restraint 7", "noe.nef: restraint 8"]
    r = effective(cage, ((3, "HB2 HB3"), (8, "HZ1 HZ2 HZ3")), ((6, "HE1"), (16, "HD2 HD3")))
    # A repeated row is no further alternative.
    assert 10.0 * held.values(cage.positions)[0] == pytest.approx(r, rel=1e-12)
    check_forces(held, cage.positions, "alternatives")


def well(r, low, high, low_end, high_end, k):
    """NEF's formula of a square well with linear ends: specification/Overview.md, section 5."""
    for e, end in ((r - high, high_end - high), (low - r, low - low_end)):
        if e > 0.0:
            return k * e**2 if e <= end else k * end * (2.0 * e - end)
    return 0.0


@pytest.mark.parametrize(
    "potential, bounds",
    [
        ("square-well-parabolic-linear", (4.0, 5.0, 3.2, 5.6)),
        ("square-well-parabolic", (4.0, 5.0, -1e9, 1e9)),
        ("upper-bound-parabolic-linear", (0.0, 5.0, 0.0, 5.6)),
        ("lower-bound-parabolic", (4.0, 1e9, -1e9, 1e9)),
        ("parabolic", (4.6, 4.6, -1e9, 1e9)),
        (".", (4.0, 5.0, 3.2, 5.6)),
    ],
)
@pytest.mark.parametrize("order", [1, -1])
def test_potentials_are_those_of_the_specification(cage, read, potential, bounds, order):
    """Columns in any order, and ends of the two sides at different distances."""
    columns = "weight target_value target_value_uncertainty lower_limit upper_limit"
    columns = f"{columns} lower_linear_limit upper_linear_limit".split()[::order]
    values = (2.5, 4.6, 0.3, 4.0, 5.0, 3.2, 5.6)[::order]
    row = (1, (3, "TYR", "CA"), (12, "PRO", "CA"), *values)
    held = read(distances([row], " ".join(columns), potential=potential))
    number = cage.residue_number.astype(int)[cage.atom_residue]
    a, b = (int(np.flatnonzero((number == n) & (cage.atom_name == "CA")).item()) for n in (3, 12))
    for r in (2.0, 3.1, 3.3, 3.6, 4.5, 5.2, 5.5, 5.7, 7.0):
        x = np.array(cage.positions)
        x[b] = x[a] + [0.1 * r, 0.0, 0.0]
        # k is half of the stiffness, 1000 kJ/mol/nm^2 times the weight.
        assert held(x)[0] == pytest.approx(well(r, *bounds, 0.01 * 0.5 * 2500.0), abs=1e-9), r


def test_missing_limits_follow_from_the_target_or_are_open(cage, read):
    pair = (3, "TYR", "CA"), (12, "PRO", "CA")
    columns = "weight target_value target_value_uncertainty lower_limit upper_limit"
    rows = [
        (1, *pair, ".", 4.6, 0.3, ".", "."), (2, *pair, 1, 4.6, ".", ".", "."),
        (3, *pair, ".", 4.6, ".", ".", 6), (4, *pair, ".", ".", ".", 3, "."), (5, *pair, 0, 4.6, 0.1, 4, 5),
    ]  # fmt: skip
    held = read(distances(rows, columns)).listed
    limits = np.array([(r.lower, r.upper) for r in held])
    assert limits == pytest.approx(np.array([(4.3, 4.9), (4.6, 4.6), (0.0, 6.0), (3.0, 3.0)]))
    assert held[3].stiffness == (1000.0, 0.0), "a lower limit alone does not pull"
    for potential, bounds in (("upper-bound-parabolic", (0.0, 4.9)), ("lower-bound-parabolic", (4.3, 4.3))):
        (one,) = read(distances(rows[:1], columns, potential=potential)).listed
        assert (one.lower, one.upper) == pytest.approx(bounds)
        assert one.stiffness == (1000.0 if one.lower == 0.0 else (1000.0, 0.0))


def dihedral(*limits, number=5, further="lower_limit upper_limit"):
    atoms = [(number - 1, "C"), (number, "N"), (number, "CA"), (number, "C")]
    names = {4: "ILE", 5: "GLN", 6: "TRP"}
    flat = [value for n, name in atoms for value in ("A", n, names[n], name)]
    table = frame(
        "nef_dihedral_restraint", ["restraint_id", *atoms_of(4), *further.split()], [(3, *flat, *limits)]
    )
    return f"data_nef_test\n{table}"


@pytest.mark.parametrize("limits", [(-70, -50), (170, -160), (-50, -70), (100, 210), (300, -120)])
def test_dihedrals_are_between_their_limits_around_the_circle(cage, read, limits):
    low, high = limits
    held, phi = read(dihedral(*limits)), cage.dihedrals()["phi"][4]
    # The distance from the interval, counted from its lower end upwards.
    width, at = (high - low) % 360.0, (phi - low) % 360.0
    outside = 0.0 if at <= width else min(at - width, 360.0 - at)
    assert held(cage.positions)[0] == pytest.approx(500.0 * np.deg2rad(outside) ** 2, abs=1e-9)
    check_forces(held, cage.positions, str(limits))


def test_both_sides_of_a_dihedral_have_ends_of_their_own(cage, read):
    phi = cage.dihedrals()["phi"][4]
    further = "lower_limit upper_limit lower_linear_limit upper_linear_limit"
    for low, high in ((phi + 10.0, phi + 50.0), (phi - 50.0, phi - 10.0)):
        text = dihedral(low, high, low - 4.0, high + 6.0, further=further)
        held = read(text.replace("parabolic", "parabolic-linear"))
        e, end = np.deg2rad([10.0, 4.0 if phi < low else 6.0])
        assert held(cage.positions)[0] == pytest.approx(500.0 * end * (2.0 * e - end), rel=1e-6)


@pytest.mark.parametrize("form", ["own", "amber", "cns"])
def test_walls_differ_in_every_form(cage, tmp_path, form):
    """Steeper above than below, from 4 to 5 angstrom, and linear from 3.2 and 5.6 on."""
    number = cage.residue_number.astype(int)[cage.atom_residue]
    a, b = (int(np.flatnonzero((number == n) & (cage.atom_name == "CA")).item()) for n in (3, 12))
    k, path = (200.0, 400.0), tmp_path / "r.txt"
    in_kcal = [side / (2.0 * 4.184 * 100.0) for side in k]
    path.write_text({
        "own": f"distance A:3:CA A:12:CA 4 5 {k[0]},{k[1]} linear=0.8,0.6\n",
        "amber": "&rst iat=3,12, iresid=1, atnam(1)='CA', atnam(2)='CA', r1=3.2, r2=4, r3=5, r4=5.6, "
        f"rk2={in_kcal[0]}, rk3={in_kcal[1]} /",
        "cns": "assign (resid 3 and name CA) (resid 12 and name CA) 4.3 0.3 0.7\n",
    }[form])  # fmt: skip
    held = Restraints.of(cage, path)
    (one,) = held.listed
    assert (one.lower, one.upper) == pytest.approx((4.0, 5.0))
    if form == "cns":
        return
    for r, side in ((2.0, 0), (3.3, 0), (4.5, 0), (5.5, 1), (7.0, 1)):
        x = np.array(cage.positions)
        x[b] = x[a] + [0.1 * r, 0.0, 0.0]
        assert held(x)[0] == pytest.approx(well(r, 4.0, 5.0, 3.2, 5.6, 0.005 * k[side]), abs=1e-9), r


STAR = """data_test
save_assembly
_Assembly.Sf_framecode assembly
loop_
_Entity_assembly.ID
_Entity_assembly.Entity_label
_Entity_assembly.Asym_ID
1 $TC5b A
stop_
save_
save_noe
_Gen_dist_constraint_list.Sf_category general_distance_constraints
loop_
_Gen_dist_constraint.ID
_Gen_dist_constraint.Member_logic_code
{}
_Gen_dist_constraint.Distance_val
_Gen_dist_constraint.Distance_lower_bound_val
_Gen_dist_constraint.Distance_upper_bound_val
{}
stop_
save_
"""


def star(rows, form=STAR_ATOM):
    columns = "\n".join(f"_Gen_dist_constraint.{name}" for name in atoms_of(2, form))
    return STAR.format(columns, "\n".join(" ".join(map(str, row)) for row in rows))


def test_nmr_star_is_read_as_nef(cage, read):
    """Rows of all pairs that names of NEF mean, as the archive writes them, and both ways to name a chain."""
    ends = [(3, "TYR", "HB2"), (3, "TYR", "HB3")], [(8, "LYS", f"HZ{k}") for k in (1, 2, 3)]
    same = read(distances([(7, (3, "TYR", "HB%"), (8, "LYS", "HZ%"), 1.8, 3.0)], "lower_limit upper_limit"))
    for form, chain in ((STAR_ATOM, "A"), (STAR_ATOM.replace("Auth_asym", "Entity_assembly"), "1")):
        rows = [(7, "OR", chain, *a, chain, *b, ".", 1.8, 3.0) for a, b in itertools.product(*ends)]
        held = read(star(rows, form))
        assert len(held.listed) == 1
        assert held(cage.positions)[0] == pytest.approx(same(cage.positions)[0], rel=1e-12)
    # The author's name of an unassigned atom means both, not the one that the archive chose.
    form = f"{STAR_ATOM} Auth_atom_ID_{{0}}"
    rows = [(7, ".", "A", 3, "TYR", "HB2", "HBx", "A", *ends[1][0], "HZ1", ".", 1.8, 3.0)]
    r = effective(cage, ((3, "HB2 HB3"), (8, "HZ1")))
    assert 10.0 * read(star(rows, form)).values(cage.positions)[0] == pytest.approx(r, rel=1e-12)
    # Chains and numbers of the archive's structure precede the author's.
    form = f"PDB_strand_ID_{{0}} PDB_residue_no_{{0}} {STAR_ATOM}"
    rows = [(7, ".", "A", 3, "X", 103, "TYR", "HA", "A", 8, "X", 108, "LYS", "HA", ".", 1.8, 3.0)]
    r = effective(cage, ((3, "HA"), (8, "HA")))
    assert 10.0 * read(star(rows, form)).values(cage.positions)[0] == pytest.approx(r, rel=1e-12)


@pytest.mark.parametrize(
    "name, pattern", [("H5x", "H5'*"), ("H5'y", "H5'*"), ("H2'x", "H2'*"), ("H6x", "H6+#")]
)
def test_primes_of_sugars_distinguish_their_hydrogens(tmp_path, name, pattern):
    path = tmp_path / "dna.nef"
    path.write_text(distances([(1, (2, "DG", f'"{name}"'), (3, "DC", "H6"), 4.0)]))
    (restraint,) = read_restraints(path)
    assert restraint.places == (f"atom A 2 {pattern} and resname DG", "atom A 3 H6 and resname DC")


def test_torsions_of_nmr_star_are_dihedrals(cage, read):
    text = dihedral(-70, -50).replace("_nef_dihedral_restraint.", "_Torsion_angle_constraint.")
    nef = read(dihedral(-70, -50))
    for before, after in (
        ("restraint_id", "ID"),
        ("chain_code", "Auth_asym_ID"),
        ("sequence_code", "Comp_index_ID"),
        ("residue_name", "Comp_ID"),
        ("atom_name", "Atom_ID"),
        ("lower_limit", "Angle_lower_bound_val"),
        ("upper_limit", "Angle_upper_bound_val"),
    ):
        text = text.replace(before, after)
    assert "Angle_lower" in text and read(text).listed == nef.listed


def test_joined_rows_are_separate_restraints(cage, read):
    pairs = ((3, "TYR", "HA"), (8, "LYS", "HA")), ((2, "LEU", "HA"), (5, "GLN", "HA"))
    rows = [(4, *pairs[0], 1, 3.0), (4, *pairs[1], 1, 2.0)]
    held = read(distances(rows, "restraint_combination_id upper_limit")).listed
    assert [(len(r.places), r.upper) for r in held] == [(2, 3.0), (2, 2.0)]


PAIR = (3, "TYR", "HA"), (8, "LYS", "HA")
FAULTS = {
    "missing-atom": (
        distances([(5, (3, "TYR", "HX"), PAIR[1], 3)]),
        "noe.nef: restraint 5: .*no atoms atom A 3 HX",
    ),
    "other-residue": (distances([(5, (3, "ALA", "HA"), PAIR[1], 3)]), "noe.nef: restraint 5: .*resname ALA"),
    "pseudo-atom": (distances([(5, (3, "TYR", "QB"), PAIR[1], 3)]), "noe.nef: restraint 5: .*QB.*; correct"),
    "no-bounds": (distances([(5, *PAIR, ".")]), "restraint 5 of .*no bounds; give"),
    "not-a-number": (distances([(5, *PAIR, "far")]), "restraint 5 of .*not numbers; correct"),
    "crossed": (
        distances([(5, *PAIR, 6, 3)], "lower_limit upper_limit"),
        "restraint 5.*lower bound.*; give 3 6",
    ),
    "log-harmonic": (
        distances([(5, *PAIR, 3)], potential="log-harmonic"),
        "restraint 5 of .*log-harmonic.*; give",
    ),
    "unlike-rows": (distances([(5, *PAIR, 3), (5, *PAIR, 4)]), "restraint 5 of .*different bounds.*; give"),
    "no-name": (distances([(5, (3, "TYR", "."), PAIR[1], 3)]), "restraint 5 of .*atom 1 has no .*; add"),
    "and-or": (
        distances([(5, *PAIR, 1, 3), (5, *PAIR, 2, 3)], "restraint_combination_id upper_limit"),
        "restraint 5 of .*alternatives.*; remove",
    ),
    "half-dihedral": (dihedral(-70, "."), "restraint 3 of .*no bounds; give"),
    "truncated": (distances([(5, *PAIR, 3)])[:-20] + " 'x", "not a NEF or NMR-STAR file.*; correct"),
    "shifts-only": (
        "data_nef_x\nsave_a\n_nef_chemical_shift_list.sf_category a\nsave_\n",
        "no restraints; give",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_faults_are_one_line_with_file_restraint_and_remedy(read, name):
    text, said = FAULTS[name]
    with pytest.raises(pc.ProtochainError, match=said) as refused:
        read(text)
    line = str(refused.value)
    assert "noe.nef" in line and "; " in line and "\n" not in line


def test_a_labelled_restraint_is_read_from_its_line(tmp_path):
    path = tmp_path / "the noe.nef"
    path.write_text(distances([(5, (3, "TYR", "HBx"), PAIR[1], 3)]) + dihedral(170, -160).partition("\n")[2])
    for restraint in read_restraints(path):
        assert pc.Restraint.read(str(restraint)) == restraint and "the noe.nef" in restraint.label


@pytest.mark.parametrize("command", ["minimise", "relax"])
def test_every_restraint_is_in_the_table_worst_first(tmp_path, capsys, command):
    s = load("1l2y.pdb")
    rows = [
        (1, *PAIR, 3.0),
        (2, (2, "LEU", "HA"), (5, "GLN", "HA"), 9.0),
        (3, (1, "ASN", "CA"), (20, "SER", "CA"), 4.0),
    ]
    (tmp_path / "noe.nef").write_text(distances(rows))
    table, out = tmp_path / "r.csv", tmp_path / "out.pdb"
    how = ("--method", "lbfgs", "--max-evaluations", 5) if command == "minimise" else ("--max-iterations", 5)
    given = (
        command, STRUCTURES / "1l2y.pdb", "--restraints", tmp_path / "noe.nef", "-o", out, "--solvent",
        "vacuum",
    )  # fmt: skip
    assert run(*given, *how, "--restraint-csv", table) == 3
    assert str(table) in capsys.readouterr().out
    found, end = pd.read_csv(table), pc.load(out)
    assert found["restraint"].str.extract(r"restraint (\d)'")[0].tolist() == ["3", "1", "2"]
    expected = Restraints.of(end, tmp_path / "noe.nef").measure(end.positions)
    # The file has three decimals.
    assert sorted(found["value"]) == pytest.approx(sorted(value.value for value in expected), abs=2e-3)
    assert found["violation"].tolist() == pytest.approx(
        sorted((v.violation for v in expected), reverse=True), abs=2e-3
    )
    assert s.n_atoms == end.n_atoms
    with expect_refusal("restraint_csv", "restraints"):
        run(*given[:2], "-o", out, "--restraint-csv", table, "--force")
