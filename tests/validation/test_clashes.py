"""Clashes: the pairs that Probe finds, a slow oracle with dots, and pairs whose answer follows on paper."""

import tracemalloc
from itertools import pairwise

import numpy as np
import pytest
from fixtures.samples import load, shared, still
from openmm import app

import protochain as pc
from protochain.chains.contacts import bonded_pairs
from protochain.validation.clashes import _at_clouds, _kinds, clash_discs, clashes

# Pairs with the radii, hydrogen bonds and excluded neighbours of this library, by the DotScorer of Probe 2
# (mmtbx_probe_ext of cctbx-base 2025.11), all dots, as residue number and atom.
PROBE_1HEL = [
    "15:HB3 92:HG11", "45:HB2 45:HE", "45:HG3 46:N", "51:HB 53:CE1", "59:OD1 61:HB3", "61:HG2 62:CE2",
    "62:HB2 63:CD1", "75:HA 75:HD22", "111:CD1 115:HB2",
]  # fmt: skip
PROBE_1UBQ = [
    "23:HB 52:HA", "37:HA 38:HD3", "42:HE 49:NE2", "42:HE 49:HE21", "71:HA 71:HD13", "72:O 72:CG",
    "72:O 72:HG2",
]  # fmt: skip


def labels(structure, pairs):
    number, name = structure.residue_number[structure.atom_residue], structure.atom_name
    return {" ".join(f"{number[i]}:{name[i]}" for i in pair) for pair in pairs}


@pytest.mark.parametrize(
    ("name", "expected", "more", "fewer"), [("1hel.pdb", PROBE_1HEL, 1, 0), ("1ubq.pdb", PROBE_1UBQ, 3, 2)]
)
def test_the_pairs_are_those_of_probe_but_for_contacts_nearly_covered(name, expected, more, fewer):
    """A few that bonded atoms cover but for a rim, where Probe has a dot or not, may differ."""
    found = clashes(load(name))
    mine = labels(load(name), found.pairs)
    # Probe has the amide of GLN49 as in the file: turned, it clashes with nothing.
    ends = {"49:NE2", "49:HE21", "49:HE22", "49:OE1"} if name == "1ubq.pdb" else set()
    assert not any(ends & set(pair.split()) for pair in mine)
    expected = {pair for pair in expected if not ends & set(pair.split())}
    assert len(mine - expected) <= more and len(expected - mine) <= fewer
    assert found.per_1000_atoms == pytest.approx(1000 * len(mine) / load(name).n_atoms)
    assert (np.diff(found.overlap_angstrom) <= 0).all()


def slow(structure):
    """Clashes by dots all over the atoms, sixteen per square angstrom."""
    kinds, n = _kinds(structure), structure.n_atoms
    x = _at_clouds(structure, 10 * structure.positions)
    is_h = structure.atom_element == "H"
    near = {frozenset(pair) for pair in bonded_pairs(structure, 3).tolist()}
    near |= {frozenset(pair) for pair in bonded_pairs(structure, 4).tolist() if is_h[pair].any()}
    own = np.array([[frozenset((i, j)) in near for j in range(n)] for i in range(n)])
    found = set()
    for i in range(n):
        m = int(16 * 4 * np.pi * kinds.radius[i] ** 2)
        z = 1 - (2 * np.arange(m) + 1) / m
        turn = np.pi * (3 - np.sqrt(5)) * np.arange(m)
        ring = np.sqrt(1 - z**2)
        dots = x[i] + kinds.radius[i] * np.column_stack([ring * np.cos(turn), ring * np.sin(turn), z])
        around = np.flatnonzero(np.linalg.norm(x - x[i], axis=1) < 4)  # the largest radii make 3.6
        gap = np.full((m, n), np.inf)
        gap[:, around] = np.linalg.norm(dots[:, None] - x[around], axis=-1) - kinds.radius[around]
        free = ~(gap[:, own[i]] < 0).any(axis=1)
        gap[:, own[i]] = gap[:, i] = np.inf
        cause = gap.argmin(axis=1)
        for dot in np.flatnonzero(free & (gap.min(axis=1) <= -0.4)):
            j = int(cause[dot])
            allowed = 0.0
            for a, b in ((i, j), (j, i)):
                if kinds.donor[a] and kinds.acceptor[b] and kinds.charge[a] * kinds.charge[b] <= 0:
                    allowed = 0.8 if kinds.charge[a] * kinds.charge[b] else 0.6
            if gap[dot, j] + allowed <= -0.4:
                found.add((min(i, j), max(i, j)))
    return found


def test_nearly_equals_dots_all_over_the_atoms():
    """In a protein pressed flat."""
    s = load("1l2y.pdb")
    s = s.with_positions(s.positions * [0.5, 1.0, 1.0])
    found, expected = set(map(tuple, clashes(s).pairs.tolist())), slow(s)
    assert len(expected) > 50
    assert len(found ^ expected) < 0.1 * len(expected)


def molecules(*parts):
    """Each part a list of (element, x) in angstrom, bonded in a row; nothing between parts."""
    topology, x = app.Topology(), []
    for part in parts:
        residue = topology.addResidue("LIG", topology.addChain())
        atoms = [
            topology.addAtom(f"{e}{k}", app.Element.getBySymbol(e), residue) for k, (e, _) in enumerate(part)
        ]
        for first, second in pairwise(atoms):
            topology.addBond(first, second)
        x += [at for _, at in part]
    return pc.Structure("m", topology, 0.1 * np.array(x, dtype=float))


@pytest.mark.parametrize(
    ("parent", "charges", "apart", "clash"),
    [
        # Radii: hydrogen at C 1.22, at N 1.05, oxygen 1.40; a hydrogen bond may overlap by 0.6 more, by 0.8
        # if the charges of hydrogen's parent and oxygen attract each other, and by none if they repel.
        ("C", (0, 0), 1.22 + 1.40 - 0.41, 1), ("C", (0, 0), 1.22 + 1.40 - 0.39, 0),
        ("N", (0, 0), 1.05 + 1.40 - 0.90, 0), ("N", (0, 0), 1.05 + 1.40 - 1.01, 1),
        ("N", (0, -1), 1.05 + 1.40 - 0.99, 0), ("N", (0, -1), 1.05 + 1.40 - 1.01, 1),
        ("N", (1, -1), 1.05 + 1.40 - 1.19, 0), ("N", (1, -1), 1.05 + 1.40 - 1.21, 1),
        ("N", (-1, -1), 1.05 + 1.40 - 0.39, 0), ("N", (-1, -1), 1.05 + 1.40 - 0.41, 1),
    ],
)  # fmt: skip
def test_hydrogen_bonds_may_overlap_more(parent, charges, apart, clash):
    """The hydrogen is measured at its electron cloud, wherever along its bond it is."""
    length = {"C": 0.97, "N": 0.86}[parent]
    for drawn in (length, 1.09, 0.5):
        donor = [(parent, (-length, 0, 0)), ("H", (drawn - length, 0, 0))]
        s = molecules(donor, [("O", (apart, 0, 0)), ("C", (apart + 1.2, 0, 0))])
        for which, charge in zip((0, 2), charges, strict=True):
            list(s.topology.atoms())[which].formalCharge = charge
        assert ([1, 2] in clashes(s).pairs.tolist()) == bool(clash)


@pytest.mark.parametrize(("bonds", "clash"), [(3, 0), (4, 1)])
def test_neighbours_up_to_three_bonds_apart_do_not_clash(bonds, clash):
    """The ends of a row of atoms are near one another, the others far away."""
    middle = [("C", (0.0, 9.0 * k, 0)) for k in range(1, bonds)]
    pairs = clashes(molecules([("C", (0, 0, 0)), *middle, ("C", (2.0, 0, 0))])).pairs.tolist()
    assert pairs == [[0, bonds]] * clash


def test_a_hydrogen_four_bonds_away_does_not_clash_with_a_heavy_atom():
    far = [("C", (9.0 * k, 20.0, 0)) for k in range(1, 3)]
    for more, clash in ((0, 0), (1, 1)):
        tail = [("C", (40.0, 40.0, 0))] * more + [("C", (2.9, 0, 0)), ("H", (1.93, 0, 0))]
        s = molecules([("C", (0, 0, 0)), *far, *tail])
        h = s.n_atoms - 1
        assert ([0, h] in clashes(s).pairs.tolist()) == bool(clash)


def test_one_atom_put_onto_another_is_named():
    s = load("4pti.pdb")
    before = clashes(s)
    i = int(np.flatnonzero((s.atom_residue == 14) & (s.atom_name == "NZ"))[0])
    j = int(np.flatnonzero((s.atom_residue == 30) & (s.atom_name == "CA"))[0])
    x = s.positions.copy()
    x[i] = x[j] + [0.08, 0, 0]
    found = clashes(s, x)
    assert sorted((i, j)) in found.pairs.tolist() and len(found.pairs) > len(before.pairs)
    row = found.pairs.tolist().index(sorted((i, j)))
    assert found.overlap_angstrom[row] == pytest.approx(1.55 + 1.70 - 0.8)
    assert s.describe(i) in found.lines(s)[row] and "overlap by 2.45 angstrom" in found.lines(s)[row]


def test_molecules_held_fixed_count_against_the_protein_alone():
    s = still(pc.load(shared("4cup_missing.cif")))
    fixed = np.flatnonzero(s.obstacle)
    x = s.positions.copy()
    x[fixed] = x[fixed].mean(axis=0) + 0.3 * (x[fixed] - x[fixed].mean(axis=0))
    assert not s.obstacle[clashes(s, x).pairs].all(axis=1).any()
    x = s.positions.copy()
    x[fixed] += x[s.alpha_carbons[20]] - x[fixed[0]]
    assert s.obstacle[clashes(s, x).pairs].sum() > 5


def test_radii_charges_and_lengths_of_hydrogens_follow_from_bonds():
    """At pH 7; centres of electron clouds as Reduce has them: Word et al., J. Mol. Biol. 285:1735, 1999."""
    s = load("1ubq.pdb")
    kinds, length, of = _kinds(s), np.zeros(s.n_atoms), s.atom_residue
    length[kinds.hydrogens] = kinds.lengths
    sign = {"LYS": {"NZ": 1}, "ARG": dict.fromkeys(("NE", "NH1", "NH2"), 1)}
    sign |= {"ASP": dict.fromkeys(("OD1", "OD2"), -1), "GLU": dict.fromkeys(("OE1", "OE2"), -1)}
    ends = {(0, "N"): 1, (s.n_residues - 1, "O"): -1, (s.n_residues - 1, "OXT"): -1}
    places = [*zip(of.tolist(), s.residue_name[of].tolist(), s.atom_name.tolist(), strict=True)]
    charge = np.array(
        [ends.get((r, name), sign.get(residue, {}).get(name, 0)) for r, residue, name in places]
    )
    charge[kinds.hydrogens] = charge[kinds.parents]
    assert kinds.charge.tolist() == charge.tolist()
    by_name = {}
    for (_, *name), *found in zip(places, kinds.radius.tolist(), length.tolist(), strict=True):
        by_name.setdefault(tuple(name), set()).add(tuple(found))
    expected = {
        ("PHE", "CG"): (1.75, 0), ("HIS", "CE1"): (1.75, 0), ("TYR", "CZ"): (1.75, 0),
        ("ALA", "CB"): (1.70, 0), ("ASN", "CG"): (1.65, 0), ("GLU", "CD"): (1.65, 0), ("LEU", "C"): (1.65, 0),
        ("LEU", "CG"): (1.70, 0), ("ARG", "CZ"): (1.70, 0), ("PRO", "CG"): (1.70, 0),
        ("THR", "OG1"): (1.40, 0), ("LYS", "NZ"): (1.55, 0), ("MET", "SD"): (1.80, 0),
        ("PHE", "HZ"): (1.05, 0.93), ("HIS", "HE1"): (1.05, 0.93), ("LYS", "HZ1"): (1.05, 0.89),
        ("ARG", "HH11"): (1.05, 0.86), ("LEU", "H"): (1.05, 0.86), ("LEU", "HG"): (1.22, 0.97),
        ("TYR", "HH"): (1.05, 0.84),
    }  # fmt: skip
    assert {key: by_name[key] for key in expected} == {key: {value} for key, value in expected.items()}


def test_memory_is_bounded_where_atoms_crowd():
    """2000 pairs with 24 dots and 8 neighbours each are looked at together: 400,000 rows of 100 bytes."""
    s = load("1l2y.pdb")
    clashes(s)
    tracemalloc.start()
    clashes(s, 0.4 * s.positions)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 100e6


def test_the_rim_of_a_disc_is_on_both_spheres():
    s = load("1hel.pdb")
    pairs, discs = clash_discs(s)
    centre, normal, radius = discs[:, :3], discs[:, 3:6], discs[:, 6]
    assert np.array_equal(pairs, clashes(s).pairs) and (radius > 0.3).all()
    across = np.cross(normal, [0.3, 0.5, 0.8])
    rim = centre + radius[:, None] * across / np.linalg.norm(across, axis=1)[:, None]
    x = _at_clouds(s, 10.0 * s.positions)
    for atoms in pairs.T:
        assert np.linalg.norm(rim - x[atoms], axis=1) == pytest.approx(_kinds(s).radius[atoms])
