"""AMBER's and CNS's restraint files against potentials written by hand from their manuals."""

import itertools
import re

import numpy as np
import pytest
from fixtures.samples import load

import protochain as pc
from protochain.chains.cns_selection import parse_selection
from protochain.chains.restraint_lines import read_restraints
from protochain.chains.restraint_list import Restraints
from protochain.energies.custom import check_forces

KCAL = 4.184

AMBER = [
    "iat", "atnam", "iresid", "rstwt", "restraint", "nstep1", "nstep2", "irstyp", "ialtd", "ifvari",
    "ninc", "imult", "r0", "r1", "r2", "r3", "r4", "k0", "rk2", "rk3", "r0a", "r1a", "r2a", "r3a",
    "r4a", "k0a", "rk2a", "rk3a", "rjcoef", "igr1", "igr2", "igr3", "igr4", "igr5", "igr6", "igr7",
    "igr8", "fxyz", "outxyz", "grnam1", "grnam2", "grnam3", "grnam4", "grnam5", "grnam6", "grnam7",
    "grnam8", "ir6", "ifntyp", "ixpk", "nxpk", "iconstr",
]  # fmt: skip
"""Variables of the namelist &rst in AMBER's manual, section "Distance, angle and torsional restraints"."""

BASE = "r1=1., r2=2., r3=5., r4=7., rk2=10., rk3=20."


def sander(r, r1, r2, r3, r4, k2, k3, levels=False):
    """Energy of AMBER's manual, kcal/mol, of a value in angstrom or rad."""
    if r < r2:
        if r < r1 and not levels:
            return k2 * (r1 - r2) ** 2 + 2.0 * k2 * (r1 - r2) * (r - r1)
        return k2 * (r - r2) ** 2
    if r <= r3:
        return 0.0
    if r < r4:
        return k3 * (r - r3) ** 2
    if levels:
        a, b = 3.0 * (r4 - r3) ** 2, -2.0 * (r4 - r3) ** 3
        return k3 * (b / (r - r3) + a)
    return k3 * (r4 - r3) ** 2 + 2.0 * k3 * (r4 - r3) * (r - r4)


def turned(angle, low, high):
    """Angle in degrees, by a multiple of 360 as near as possible to the middle of two."""
    return min((angle + 360.0 * n for n in range(-3, 4)), key=lambda a: abs(a - 0.5 * (low + high)))


def dihedral(a, b, c, d):
    """Dihedral of four points, degrees: the angle of the outer bonds across the inner one."""
    axis = (c - b) / np.linalg.norm(c - b)
    first, last = (v - (v @ axis) * axis for v in (a - b, d - c))
    return np.degrees(np.arctan2(np.cross(axis, first) @ last, first @ last))


@pytest.fixture(scope="module")
def peptide():
    return pc.from_sequence("YGGFMLDK")


@pytest.fixture(scope="module")
def read(peptide, tmp_path_factory):
    """Restraints of a text of a file."""
    path = tmp_path_factory.mktemp("restraints") / "r.rst"

    def of(text, structure=peptide):
        path.write_text(text)
        return Restraints.of(structure, path)

    return of


def numbered(structure):
    """Number of each atom in the file, by residue number and name."""
    return {(int(a.residue.id), a.name): a.index + 1 for a in structure.topology.atoms()}


def stretched(structure, i, j, r):
    """Positions with the second atom at a distance of the first, angstrom."""
    x = np.array(structure.positions)
    x[j - 1] = x[i - 1] + [0.1 * r, 0.0, 0.0]
    return x


@pytest.mark.parametrize("levels", [False, True])
@pytest.mark.parametrize("well", [(1, 2, 5, 7, 10, 20), (0, 3, 3, 4, 5, 1), (2, 2, 4, 9, 3, 3)])
def test_a_distance_has_ambers_energy_on_both_sides(peptide, read, well, levels):
    at = numbered(peptide)
    i, j = at[1, "CA"], at[8, "CA"]
    names = ("r1", "r2", "r3", "r4", "rk2", "rk3")
    text = ", ".join(f"{name}={value}" for name, value in zip(names, well, strict=True))
    held = read(f"&rst iat={i},{j}, {text}, ialtd={int(levels)} /")
    for r in (0.4, 1.2, 1.9, 2.5, 3.3, 4.4, 5.5, 6.9, 7.1, 9.5, 40.0):
        x = stretched(peptide, i, j, r)
        assert held(x)[0] == pytest.approx(KCAL * sander(r, *well, levels), abs=1e-9)
        check_forces(held, x, f"{well} at {r}") if r < 9.0 else None


@pytest.mark.parametrize(
    "well",
    [(0, 10, 20, 140, 5, 5), (-200, -160, -150, -149, 5, 2), (100, 130, 130, 170, 1, 3),
     (10, 60, 80, 130, 8, 8), (170, 190, 200, 350, 2, 7)],
)  # fmt: skip
def test_a_dihedral_has_two_walls_of_their_own(peptide, read, well):
    at = numbered(peptide)
    four = [at[key] for key in ((3, "C"), (4, "N"), (4, "CA"), (4, "C"))]
    r1, r2, r3, r4, k2, k3 = well
    held = read(
        f"&rst iat={','.join(map(str, four))}, r1={r1}, r2={r2}, r3={r3}, r4={r4}, rk2={k2}, rk3={k3} /"
    )
    random = np.random.default_rng(3)
    for _ in range(40):
        x = random.normal(scale=0.3, size=peptide.positions.shape)
        phi = turned(dihedral(*x[np.array(four) - 1]), r2, r3)
        radians = np.deg2rad([phi, r1, r2, r3, r4])
        assert held(x)[0] == pytest.approx(KCAL * sander(*radians, k2, k3), rel=1e-8, abs=1e-9), phi


def test_forces_of_files_are_those_of_their_energies(peptide, read):
    at = numbered(peptide)
    i, j = at[1, "CA"], at[8, "CA"]
    four = ",".join(str(at[key]) for key in ((3, "C"), (4, "N"), (4, "CA"), (4, "C")))
    group = ", ".join(str(at[4, name]) for name in ("CB", "CG", "CZ", "HZ"))
    for line in (
        f"iat={i},{j}, ialtd=1, {BASE}", f"iat=-1,{j}, igr1={group}, ir6=1, {BASE}",
        f"iat=-1,-1, igr1={group}, igr2={i},{j}, ir6=0, {BASE}",
        f"iat={four}, r1=10, r2=30, r3=40, r4=50, rk2=3, rk3=7",
    ):  # fmt: skip
        check_forces(read(f"&rst {line} /"), peptide.positions, line)
    dihedrals = "(resid 3 and name C) (resid 4 and name N) (resid 4 and name CA) (resid 4 and name C)"
    for exponent in (1, 2, 3, 4):
        check_forces(read(f"assign {dihedrals} 5 -60 20 {exponent}"), peptide.positions, str(exponent))


def test_groups_are_centres_of_mass_or_means_by_r6(peptide, read):
    at, x = numbered(peptide), 10.0 * peptide.positions
    one = [at[4, name] - 1 for name in ("CB", "HB2", "CG", "HZ")]
    other = [at[8, name] - 1 for name in ("CA", "O")]
    igr = f"igr1={','.join(str(k + 1) for k in one)},0, igr2={','.join(str(k + 1) for k in other)}"
    well = (1.0, 2.0, 5.0, 7.0, 10.0, 20.0)
    mass = peptide.atom_mass
    centres = [np.average(x[group], axis=0, weights=mass[group]) for group in (one, other)]
    held = read(f"&rst iat=-1,-1, {igr}, {BASE} /")
    assert held(peptide.positions)[0] == pytest.approx(
        KCAL * sander(np.linalg.norm(centres[0] - centres[1]), *well)
    )
    r = np.linalg.norm(x[one][:, None] - x[other], axis=-1)
    held = read(f"&rst iat=-1,-1, {igr}, ir6=1, {BASE} /")
    assert held(peptide.positions)[0] == pytest.approx(KCAL * sander(np.mean(r**-6.0) ** (-1 / 6), *well))
    # One group, by names of atoms in residues, and an atom twice, which counts once.
    held = read(
        "&rst iat=-1,8, iresid=1, atnam(2)='CA', igr1=4,4,4,4,4, "
        f"grnam1='CB','HB2',\"CG\", 'HZ' 'CB', {BASE} /"
    )
    alone = np.linalg.norm(centres[0] - x[at[8, "CA"] - 1])
    assert held(peptide.positions)[0] == pytest.approx(KCAL * sander(alone, *well))


def variants(i, j):
    """Namelists of one meaning in Fortran's different forms."""
    well = "r1=1, r2=2, r3=5, r4=7, rk2=10, rk3=20"
    yield f"&rst iat={i},{j}, {well} /"
    yield f" &RST IAT(1)={i}, Iat(2)={j}, {well} &END"
    yield f"&rst iat(2)={j}, iat(1)={i},\n r1=1.d0 r2=0.2D+1, r3 = 5e0, r4=+7., rk2=.1E2 rk3=1*20.0 /"
    yield (
        "# it's a comment & more\nfree text, which isn't read\n"
        f"&rst ! of atoms\n iat={i},{j},0,0, ! two\n {well},\n/\n"
    )
    yield f"&rst iat={i} {j} 6*0 {well} iresid=0 /"
    yield f"&rst iresid=1, iat=1,8, atnam='CA','CA', {well} /"
    yield f"&rst iresid=1, iat=1,8, atnam(1)=\"CA\" atnam(2)='CA  ', {well}, ixpk=3, nxpk=1, ifntyp=0 /"
    yield f"&rst iresid=1, iat=1,8, atnam=2*'CA', {well}, nstep1=0, nstep2=0, rstwt=4*0.0, fxyz=3*1 /"
    yield f"&rst iat={i},{j},,, {well},,restraint=' ' /"
    yield f"&rst iat(1:2)={i},{j}, {well} $end"


@pytest.mark.parametrize("k", range(10))
def test_fortran_writes_one_thing_in_many_ways(peptide, read, k):
    at = numbered(peptide)
    texts = list(variants(at[1, "CA"], at[8, "CA"]))
    assert len(texts) == 10
    (held,) = read(texts[k]).listed
    assert (held.kind, held.lower, held.upper, held.linear) == ("distance", 2.0, 5.0, (1.0, 2.0))
    assert held.stiffness == pytest.approx((2 * 418.4 * 10.0, 2 * 418.4 * 20.0))
    assert read(texts[k])(peptide.positions)[0] == pytest.approx(read(texts[0])(peptide.positions)[0])


def test_values_are_inherited_from_namelists_before(peptide, read):
    """As of makeDIST_RST: the first namelist has all bounds, later ones what differs."""
    at = numbered(peptide)
    i, j, k = at[1, "CA"], at[8, "CA"], at[5, "CA"]
    held = read(
        f"&rst iat={i},{j}, {BASE}, ialtd=1, ir6=1 /\n&rst iat={i},{k}, r3=6., r4=6.5 / "
        f"&rst iat={k},{j}, ialtd=0 /&rst iat={i},-1, igr2={j},{k}, /\n"
        f"&rst iat={k},{j}, k0=3., r0=4. /\n&rst iat={i},{j}/\n&rst iat=0 /\n"
    )
    wells = [
        (1, 2, 5, 7, 10, 20, True), (1, 2, 6, 6.5, 10, 20, True), (1, 2, 6, 6.5, 10, 20, False),
        (1, 2, 6, 6.5, 10, 20, False), (0, 4, 4, 504, 3, 3, False), (0, 4, 4, 504, 3, 3, False),
    ]  # fmt: skip
    x = 10.0 * peptide.positions

    def apart(a, b):
        return np.linalg.norm(x[a - 1] - x[b - 1])

    mean = np.mean([apart(i, a) ** -6.0 for a in (j, k)]) ** (-1 / 6)
    values = [apart(i, j), apart(i, k), apart(k, j), mean, apart(k, j), apart(i, j)]
    expected = [KCAL * sander(r, *well) for r, well in zip(values, wells, strict=True)]
    for restraint, energy in zip(held.listed, expected, strict=True):
        assert Restraints.of(peptide, restraint)(peptide.positions)[0] == pytest.approx(energy)
    assert held(peptide.positions)[0] == pytest.approx(sum(expected))


USED = {
    "iat": "iat=1,20", "r1": "r1=1.9", "r2": "r2=3.", "r3": "r3=6.", "r4": "r4=8.", "rk2": "rk2=11.",
    "rk3": "rk3=21.", "r0": "k0=1., r0=3.", "k0": "k0=1., r0=3.", "ialtd": "ialtd=1",
    "iresid": "iresid=1, iat=1,5, atnam='CA','CB'", "atnam": "iresid=1, iat=1,5, atnam='CA','CB'",
    "igr1": "iat=-1,20, igr1=3,4", "igr2": "iat=1,-1, igr2=3,4", "ir6": "iat=-1,20, igr1=3,4, ir6=1",
    "grnam1": "iresid=1, iat=-1,5, atnam(2)='CA', igr1=1,2, grnam1='CA','CA'",
    "grnam2": "iresid=1, iat=5,-1, atnam='CA', igr2=1,2, grnam2='CA','CA'",
}  # fmt: skip
"""Variables that change the restraint which is read."""
REFUSED = {
    "rstwt": "iat=1,2,3,4, rstwt=1.,-1.", "restraint": "restraint='distance(1,20)'", "nstep1": "nstep1=5",
    "nstep2": "nstep2=100", "irstyp": "irstyp=1", "ifvari": "ifvari=1, r1a=0.", "iconstr": "iconstr=1",
    "rjcoef": "iat=1,2,3,4, rjcoef=6.5,-1.8,1.6", "fxyz": "iat=-1,20, igr1=3,4, fxyz=0,0,1",
    "outxyz": "outxyz=1",
    **{f"{name}{k}": "iat=1,2,3,4,5,6,-1,-1" for name in ("igr", "grnam") for k in range(3, 9)},
}  # fmt: skip
"""Variables that are refused."""
INERT = {
    "ixpk", "nxpk", "ifntyp", "ninc", "imult", "r0a", "r1a", "r2a", "r3a", "r4a", "k0a", "rk2a", "rk3a",
}  # fmt: skip
"""Labels of peaks, time averages, and changes of restraints with time, which do not change the energies."""


@pytest.mark.parametrize("name", AMBER)
def test_each_variable_of_ambers_manual_is_used_inert_or_refused(name, tmp_path):
    assert (name in USED) + (name in REFUSED) + (name in INERT) == 1, "of one kind"
    path = tmp_path / "r.rst"

    def listed(more):
        path.write_text(f"# first\n&rst iat=1,9, {BASE} /\n&rst iat=1,9, {more} /\n")
        return read_restraints(path)[1]

    if name in USED:
        assert listed(USED[name]) != listed("")
    elif name in INERT:
        value = "3" if name in ("ixpk", "nxpk", "ninc", "imult", "ifntyp") else "3.5"
        assert listed(f"{name}={value}") == listed("")
    else:
        said = name if name not in ("igr3", "grnam3") and not re.search(r"[3-8]$", name) else "iat"
        with pytest.raises(pc.ProtochainError, match=rf"r\.rst: line 3: &rst: {said}.*not implemented; \w+"):
            listed(REFUSED[name])


def test_a_real_terminator_ends_the_file_and_others_are_refused(tmp_path):
    path = tmp_path / "r.rst"
    good = f"&rst iat=1,9, {BASE} /\n"
    for text, said in (
        (f"{good}&rst iat=0 /\n{good}", "line 3: AMBER reads no &rst after"),
        (f"{good}&rst iat=1,2,3 /", "line 2: &rst: iat: angles"),
        (f"{good}&rst iat=1,9, rk4=3 /", "no variable rk4"),
        (f"{good}&rst iat=1,9, r3=five /", "line 2: &rst: r3=five is not a number"),
        (f"{good}&rst iat=1.5,9 /", "iat=1.5 is not a whole number"),
        (f"{good}&rst iat=1,9, r3=1. /", "rising order"),
        (f"{good}&wt type='REST', value1=2. /", "line 2: namelist &wt is not implemented"),
        (f"{good}&rst iat=1,9", "line 2: namelist &rst has no end"),
        (f"{good}&rst 5, iat=1,9 /", "is not assigned to a variable"),
        (f"{good}&rst iat=1,9, iresid=1 /", "iresid=1 needs a name"), (f"{good}&rst iat=-1,9 /", "igr1"),
        ("&rst iat=1,9, r1=1., r2=2., r3=3., r4=4. /", "; give r1 to r4, rk2 and rk3"),
        (f"{good}&rst iat=-1,2,3,4, igr1=4,5 /", "groups in dihedrals"),
        (f"{good}&rst iat=9*1 /", "more than 8"),
    ):  # fmt: skip
        path.write_text(text)
        with pytest.raises(pc.ProtochainError, match=re.escape(said)) as refused:
            read_restraints(path)
        assert str(refused.value).startswith(f"{path}: line ") and "; " in str(refused.value)


def test_residues_and_atoms_are_those_of_the_file():
    """Numbers of AMBER count from 1 in the file, whatever residues are called there."""
    s = load("1ubq.pdb")
    place = [(a.split("/")[1], a.split("/")[-1]) for a in s.origin.atoms]
    residues = list(dict.fromkeys(number for number, _ in place))
    for number, name in (("5", "CA"), ("40", "NE2"), ("76", "C")):
        (atom,) = (
            k for k in range(s.n_atoms) if s.describe(k) and s.origin.place[k] == place.index((number, name))
        )
        by_residue = pc.Restraint("distance", ("A:1:N", f":{residues.index(number) + 1}@{name}"), 0, 1)
        by_atom = pc.Restraint("distance", ("A:1:N", f"@{place.index((number, name)) + 1}"), 0, 1)
        d = np.linalg.norm(s.positions[atom] - s.positions[0])
        for restraint in (by_residue, by_atom):
            assert Restraints.of(s, restraint).values(s.positions)[0] == pytest.approx(d)
    with pytest.raises(pc.ProtochainError, match="no atoms :3@XX"):
        Restraints.of(s, "distance A:1:N :3@XX 0 1")


SELECTIONS = {
    "resid 3 and name HB#": lambda n, a, r, c: n == 3 and re.fullmatch(r"HB\d*", a),
    "residue 3 and name H*": lambda n, a, r, c: n == 3 and a.startswith("H"),
    "resi 3 and (name CA or name C)": lambda n, a, r, c: n == 3 and a in ("CA", "C"),
    "name CA or name C and resid 3": lambda n, a, r, c: a == "CA" or (a == "C" and n == 3),
    "not (resid 3:8 or name H*)": lambda n, a, r, c: not (3 <= n <= 8 or a.startswith("H")),
    "(resn GLY or resname al%) and name ha+": lambda n, a, r, c: (
        (r == "GLY" or re.fullmatch("AL.", r)) and re.fullmatch(r"HA\d", a)
    ),
    'segid "A" and resid 5 and name "HN"': lambda n, a, r, c: n == 5 and a == "H",
    'segi "    " and atom A 7 CB': lambda n, a, r, c: n == 7 and a == "CB",
    "hydrogen and RESIDUE 2": lambda n, a, r, c: n == 2 and a.startswith("H"),
    "all and not none and known and resid 1%": lambda n, a, r, c: re.fullmatch("1.", str(n)),
    "resid 4 and not name H*": lambda n, a, r, c: n == 4 and not a.startswith("H"),
    "not resid 4 and name CA": lambda n, a, r, c: n != 4 and a == "CA",
}


@pytest.mark.parametrize("text", SELECTIONS)
def test_selections_are_those_of_x_plor(text):
    s = load("1l2y.pdb")
    number, chains = s.residue_number.astype(int)[s.atom_residue], s.residue_chain[s.atom_residue]
    columns = zip(
        number.tolist(), s.atom_name.tolist(), s.residue_name[s.atom_residue].tolist(), chains, strict=True
    )
    expected = np.array([bool(SELECTIONS[text](*row)) for row in columns])
    assert expected.any()
    np.testing.assert_array_equal(parse_selection(text)(s), expected)


@pytest.mark.parametrize(
    "word",
    ["around 5", "saround 5", "attribute q > 1", "bondedto", "bygroup", "byres", "chemical C", "fbox 1",
     "id 12", "point (1 1 1) cut 3", "previous", "recall1", "sfbox 1", "store1", "tag", "res 3", "nam CA",
     "resid",
     "name A:C", "atom A 3", "(resid 3", "resid 3 name CA", "resid 3 and"],
)  # fmt: skip
def test_other_selections_are_refused_by_name(word, tmp_path):
    (tmp_path / "noe.tbl").write_text(f"! one\nassign ({word}) (resid 4) 3 1 1\n")
    with pytest.raises(pc.ProtochainError, match=r"noe\.tbl: line \d: (selection|assign).*; "):
        read_restraints(tmp_path / "noe.tbl")


def test_ambiguous_distances_are_sums_over_all_pairs(read):
    s = load("1l2y.pdb")
    x = 10.0 * s.positions

    def atoms(residue, *names):
        return [
            k
            for k in range(s.n_atoms)
            if int(s.residue_number[s.atom_residue[k]]) == residue and s.atom_name[k] in names
        ]

    hb3, ha14, h5 = atoms(3, "HB2", "HB3"), atoms(14, "HA"), atoms(5, "H")
    pairs = [*itertools.product(hb3, ha14), *itertools.product(hb3, h5), *itertools.product(ha14, h5)]
    r = sum(np.linalg.norm(x[a] - x[b]) ** -6.0 for a, b in pairs) ** (-1 / 6)
    tail = "peak 12 spectrum 1 weight 0.11000E+01 volume 0.2E+02 ppm1 8.1 ppm2 4.4 cv 1"
    first, second, third = (
        "(resid 3 and name HB#) (resid 14 and name HA)", "(resid 3 and name HB#) (residue 5 and name HN)",
        "((resid 14 and name HA)) (resid 5 and name H)",
    )  # fmt: skip
    for text in (
        "noe\n nres=3000\n class all\n set echo=off message=off end\n{ table\n of NOEs }\n"
        f"assign {first} 4.0 2.2 1.0 {tail}\n or {{ 2 }} {second}\n or {third}\nend\n",
        f"ASSI {first} or {second} or {third} 4.0 2.2 1.0 WEIGHT=1.1 ! strong",
        f"assign {first} 4.0 2.2 1.0 or {second} or {third} weight 1.1d0\naveraging all sum monomers * 1",
    ):
        held = read(text, s)
        assert len(held.listed) == 1 and held.listed[0].places[0] == "resid 3 and name HB#"
        assert 10.0 * held.values(s.positions)[0] == pytest.approx(r)
        assert held.listed[0].stiffness == pytest.approx(1100.0) and held.listed[0].upper == 5.0
        outside = max(r - 5.0, 0.0) + max(1.8 - r, 0.0)
        assert held(s.positions)[0] == pytest.approx(0.5 * 1100.0 * (0.1 * outside) ** 2)
    (either,) = read(
        "assign (resid 3 and (name HB2 or name HB3)) ((resid 14 and name HA) or (resid 5 and name HN)) 4 2 1",
        s,
    ).listed
    shorter = [*itertools.product(hb3, ha14), *itertools.product(hb3, h5)]
    d = sum(np.linalg.norm(x[a] - x[b]) ** -6.0 for a, b in shorter) ** (-1 / 6)
    assert 10.0 * Restraints.of(s, either).values(s.positions)[0] == pytest.approx(d)


@pytest.mark.parametrize("exponent", [1, 2, 3, 4])
def test_dihedrals_of_cns_have_their_exponent(read, exponent):
    s = load("1l2y.pdb")
    four = "(resid 4 and name C) (resid 5 and name N) (resid 5 and name CA) (resid 5 and name C)"
    phi = s.dihedrals()["phi"][4]
    for centre, width in ((-170.0, 20.0), (60.0, 10.0), (phi + 330.0, 5.0), (phi, 10.0)):
        held = read(
            f"restraints dihedral\n nassign=400\n assign {four} 5.0 {centre} {width} {exponent}\nend", s
        )
        well = max(abs(turned(phi, centre, centre) - centre) - width, 0.0)
        assert held(s.positions)[0] == pytest.approx(KCAL * 5.0 * np.deg2rad(well) ** exponent, abs=1e-9)


@pytest.mark.parametrize(
    "statement",
    ["averaging all center", "averaging * r-6", "monomers all 2", "potential all soft", "scale all 50",
     "ceiling 100", "sqconstant all 1", "sqexponent all 2", "sqoffset all 0", "rswitch all 1",
     "asymptote all 1", "ncount all 2", "distribute a b 5", "predict", "temperature 300", "cool",
     "print threshold 0.5",
     "evaluate ($x=1)",
     "bhig all 1", "soexponent all 1", "countviol all", "scale=200"],
)  # fmt: skip
def test_other_statements_of_cns_are_refused_by_name(statement, tmp_path):
    (tmp_path / "noe.tbl").write_text(f"assign (resid 3) (resid 4) 3 1 1\n\n{statement}\n")
    name = re.match("[a-z]+", statement)[0]
    with pytest.raises(pc.ProtochainError, match=rf"noe\.tbl: line 3: .*{name}.*not implemented; "):
        read_restraints(tmp_path / "noe.tbl")


def test_damaged_statements_are_refused_with_their_lines(tmp_path):
    pair, four = "(resid 3) (resid 4)", "(resid 3) (resid 4) (resid 5) (resid 6)"
    for text, said in (
        (f"assign {pair} 3 1", "not a distance"), (f"assign {four} 1 60 20", "not a distance"),
        (f"assign {four} (resid 7) 1 2 3", "not a distance"),
        (f"assign {pair} 3 1 1 or (resid 5)", "after or"),
        (f"assign {pair} 3 1 1 weight", "a number after weight"),
        (f"assign {pair} 3 1 1 peak 2 5", "a number after peak"),
        (f"assign {pair} 3 1 1 weight -2", "stiffness"), (f"assign {pair} 3 1 1 colour 2", "'colour' is not"),
        ("assign (resid 3) (resid 4 3 1 1", "not closed"), (f"assign {four} 1 60 20 2.5", "not a distance"),
    ):  # fmt: skip
        (tmp_path / "noe.tbl").write_text(f"assign {pair} 3 1 1\n{text}\n")
        with pytest.raises(pc.ProtochainError, match=rf"noe\.tbl: line 2: .*{said}"):
            read_restraints(tmp_path / "noe.tbl")


def test_lines_have_all_that_files_say(tmp_path):
    """What is read from a file is written as a line, which is read as the same."""
    path = tmp_path / "r.rst"
    for text in (
        f"&rst iat=1,9, {BASE}, ialtd=1 /",
        f"&rst iat=-1,-1, igr1=1,2, igr2=5,6, {BASE}, ir6=1 /",
        "&rst iresid=1, iat=1,9, atnam='CA','N', r1=1, r2=1, r3=5, r4=5, rk2=1, rk3=2 /",
        'assign (segid "A" and resid 3) (resid 4) or (resid 5) (resid 6) 3 1 1 weight 2',
        "assign (resid 3) (resid 4) (resid 5) (resid 6) 1.5 60 20 4",
    ):
        path.write_text(text)
        for restraint in read_restraints(path):
            assert pc.Restraint.read(str(restraint)) == restraint
