"""Side chains put into the best of their rotamers."""

import copy
import importlib
from itertools import product

import numpy as np
import pytest
from fixtures.models import planted_rings
from fixtures.repairs import sentences
from fixtures.samples import load, shared
from openmm import unit

import protochain as pc
from protochain.chains.contacts import OVERLAP, near_pairs
from protochain.core.arrays import dihedral
from protochain.core.errors import StructureError
from protochain.core.units import COULOMB
from protochain.energies.native.terms import compile_system
from protochain.relaxation.repack import conflicting_residues, repack_side_chains
from protochain.relaxation.rotamer_energies import Interactions
from protochain.relaxation.rotamers import _with_hydrogen, rotamers_of
from protochain.structure.molecule import residues
from protochain.structure.select import select
from protochain.structure.sidechains.arms import Arm, backbone_of, wrap_angle
from protochain.structure.sidechains.assignment import assign_states
from protochain.structure.sidechains.reduction import Part, eliminate_dead_ends
from protochain.structure.sidechains.rotamers import rotamers
from protochain.validation import threaded_rings

# --- The search


def cost(own, pairs, states):
    return sum(e[k] for e, k in zip(own, states, strict=True)) + sum(
        table[states[i], states[j]] for (i, j), table in pairs.items()
    )


def tables(seed):
    """Own and pair energies of up to six sites; every third time whole numbers, with many ties."""
    rng = np.random.default_rng(seed)
    sizes = rng.integers(1, 6, rng.integers(1, 7))
    own = [rng.choice([0.0, 1.0, 3.0]) * rng.normal(size=n) for n in sizes]
    pairs = {
        (i, j): rng.choice([1.0, 5.0]) * rng.normal(size=(sizes[i], sizes[j]))
        for i, j in product(range(len(sizes)), repeat=2)
        if i < j and rng.random() < 0.7
    }
    if seed % 3 == 0:
        return [np.round(e) for e in own], {ij: np.round(table) for ij, table in pairs.items()}
    return own, pairs


@pytest.mark.parametrize("largest", [1, 30, 10**6], ids=["branches", "both", "elimination"])
def test_the_global_minimum_is_that_of_all_combinations(largest):
    for seed in range(60):
        own, pairs = tables(seed)
        least = min(cost(own, pairs, states) for states in product(*(range(len(e)) for e in own)))
        found = assign_states(own, pairs, largest)
        assert found.is_proven
        assert found.energy == pytest.approx(least, abs=1e-8), seed
        assert cost(own, pairs, found.states) == pytest.approx(found.energy, abs=1e-8)


def test_goldsteins_criterion_rules_out_what_another_state_beats_whatever_the_others_do():
    """Again and again, until no state is: without ties, those left are the same in any order."""
    ruled_out = 0
    for own, pairs in (tables(seed) for seed in range(60) if seed % 3):
        alive, before = [np.ones(len(e), dtype=bool) for e in own], None
        both = pairs | {(j, i): table.T for (i, j), table in pairs.items()}
        while (now := sum(map(np.sum, alive))) != before:
            before = now
            for i, e in enumerate(own):
                with_i = [table[:, alive[j]] for (at, j), table in both.items() if at == i]
                more = e[:, None] - e + sum(np.min(each[:, None] - each, axis=2) for each in with_i)
                alive[i] &= ~(more[:, alive[i]] > 0.0).any(axis=1)
        states = tuple(np.arange(len(e)) for e in own)
        left = eliminate_dead_ends(Part(tuple(range(len(own))), tuple(own), states, pairs, 0.0))
        assert all(np.array_equal(*each) for each in zip(left, alive, strict=True))
        ruled_out += sum(np.sum(~each) for each in alive)
    assert ruled_out > 100


def frustrated(n=14, n_states=6):
    rng = np.random.default_rng(3)
    pairs = {(i, j): rng.normal(size=(n_states, n_states)) for i in range(n) for j in range(i + 1, n)}
    return [np.zeros(n_states) for _ in range(n)], pairs


def test_a_search_that_is_ended_says_so_and_still_has_states():
    own, pairs = frustrated()
    ended = assign_states(own, pairs, largest=1, most_tables=100)
    assert not ended.is_proven
    assert cost(own, pairs, ended.states) == pytest.approx(ended.energy)
    # No change of one site improves them.
    for i, k in product(range(len(own)), range(len(own[0]))):
        states = ended.states.copy()
        states[i] = k
        assert cost(own, pairs, states) >= ended.energy - 1e-8


# --- Energies


def soft(r, sigma, epsilon, charges):
    """Of two atoms r apart, as the module says it, from sigma and epsilon."""
    cutoff = 0.6
    if r >= cutoff:
        return 0.0

    def lennard_jones(r):
        return 4 * epsilon * ((sigma / r) ** 12 - (sigma / r) ** 6)

    near = 0.6 * 2 ** (1 / 6) * sigma
    if r < near:
        slope = (lennard_jones(near + 1e-7) - lennard_jones(near - 1e-7)) / 2e-7
        value = lennard_jones(near) + slope * (r - near)
    else:
        value = lennard_jones(r)
    return value - lennard_jones(cutoff) + charges / 40.0 * (1 / max(r, 0.1) ** 2 - 1 / cutoff**2)


class Slow:
    """The same energies from the forces of the System, pair by pair."""

    def __init__(self, system):
        forces = {type(force).__name__: force for force in system.getForces()}
        self.nonbonded, self.torsions = forces["NonbondedForce"], forces["PeriodicTorsionForce"]
        self.exceptions = {}
        for k in range(self.nonbonded.getNumExceptions()):
            i, j, *values = self.nonbonded.getExceptionParameters(k)
            self.exceptions[frozenset((i, j))] = [each._value for each in values]

    def pair(self, x, i, j):
        if frozenset((i, j)) in self.exceptions:
            charges, sigma, epsilon = self.exceptions[frozenset((i, j))]
        else:
            first, second = (
                [each._value for each in self.nonbonded.getParticleParameters(k)] for k in (i, j)
            )
            charges = first[0] * second[0]
            sigma, epsilon = 0.9 * 0.5 * (first[1] + second[1]), np.sqrt(first[2] * second[2])
        return soft(np.linalg.norm(x[i] - x[j]), sigma, epsilon, COULOMB * charges)

    def twisted_bonds(self, x, atoms):
        total = 0.0
        for k in range(self.torsions.getNumTorsions()):
            *quartet, times, phase, height = self.torsions.getTorsionParameters(k)
            if set(quartet) & set(atoms):
                phi = float(dihedral(*x[quartet]))
                total += 0.5 * height._value * (1 + np.cos(times * phi - phase._value))
        return total


def test_energies_are_those_of_the_force_fields_terms():
    structure = load("1l2y.pdb")
    system = copy.deepcopy(pc.energy(structure, solvent="vacuum").system)
    # Force fields of proteins have phases of 0 and pi only, by which a cosine is even.
    torsions = next(force for force in system.getForces() if force.getName() == "PeriodicTorsionForce")
    for k in range(torsions.getNumTorsions()):
        *of, phase, height = torsions.getTorsionParameters(k)
        torsions.setTorsionParameters(k, *of, phase + 0.1 * k * unit.radian, height)
    turning = rotamers_of(structure, structure.positions, [2, 5, 6])
    assert [arm.residue for arm in turning] == [2, 5, 6]
    felt = Interactions(compile_system(system), structure.positions, turning)
    slow, pairs = Slow(system), felt.pairs()
    moving = np.concatenate([arm.atoms for arm in turning]).tolist()
    still = sorted(set(range(structure.n_atoms)) - set(moving))
    for k, arm in enumerate(turning):
        own, its = felt.self_energies(k), arm.atoms.tolist()
        for state in (0, 1, len(own) // 2, len(own) - 1):
            x = np.array(structure.positions)
            x[its] = arm.x[state]
            expected = arm.cost[state] + slow.twisted_bonds(x, its)
            expected += sum(slow.pair(x, i, j) for i in its for j in still)
            expected += sum(slow.pair(x, i, j) for i in its for j in its if i < j)
            assert own[state] == pytest.approx(expected, rel=1e-6, abs=1e-6)
    assert (0, 1) in pairs
    one, other = turning[0], turning[1]
    worst = np.unravel_index(pairs[0, 1].argmax(), pairs[0, 1].shape)
    for r, s in ((0, 0), (0, 3), worst):
        x = np.array(structure.positions)
        x[one.atoms], x[other.atoms] = one.x[r], other.x[s]
        expected = sum(slow.pair(x, i, j) for i in one.atoms for j in other.atoms)
        assert pairs[0, 1][r, s] == pytest.approx(expected, rel=1e-6, abs=1e-6)
    assert pairs[0, 1][worst] > 10.0


# --- Side chains that turn


def names(structure, chosen):
    return {str(structure.residue_name[arm.residue]) for arm in chosen}


def test_what_has_no_chi_or_is_bonded_stays():
    structure = load("4pti.pdb")
    able = rotamers_of(structure, structure.positions, range(structure.n_residues))
    assert not names(structure, able) & {"ALA", "GLY", "PRO", "CYS"}
    rest = {"ALA", "GLY", "PRO", "CYS"}
    assert len(able) == sum(str(name) not in rest for name in structure.residue_name)
    free = load("1ubq.pdb")
    assert "CYS" not in free.residue_name and len(rotamers_of(free, free.positions, [0])) == 1


def test_those_that_hold_a_metal_stay():
    structure = pc.load(shared("1ajj_ldlr.pdb"))
    holding = {int(structure.atom_residue[tie.atoms[0]]) for tie in structure.ties if len(tie.atoms) == 2}
    holding = {r for r in holding if structure.residue_name[r] in ("ASP", "GLU")}
    assert holding
    able = {arm.residue for arm in rotamers_of(structure, structure.positions, range(structure.n_residues))}
    assert not able & holding and able


def test_a_turned_side_chain_says_its_dihedrals_in_the_input_and_now():
    structure = load("1l2y.pdb")
    chi = structure.dihedrals()
    (arm,) = rotamers_of(structure, structure.positions, [5])
    assert arm.repair(0, "x").facts == {"residue": "x"}
    for state in range(1, len(arm.chi)):
        facts, at = arm.repair(state, "x").facts, np.rint(np.rad2deg(wrap_angle(arm.chi[state]))).astype(int)
        before = [int(np.rint(chi[f"chi{k}"][5])) for k in (1, 2)]
        assert facts["before"] == f"chi1 {before[0]} chi2 {before[1]}"
        assert facts["after"] == f"chi1 {at[0]} chi2 {at[1]}" != facts["before"]


def test_rotamers_keep_bonds_and_angles_and_the_input_is_the_first():
    structure = load("1ubq.pdb")
    joined = structure.bonds
    for arm in rotamers_of(structure, structure.positions, range(0, structure.n_residues, 7)):
        its = arm
        assert np.array_equal(its.x[0], structure.positions[its.atoms])
        near = joined[np.isin(joined, its.atoms).any(axis=1)]
        ends = np.unique(near)
        # Atoms bonded to a common one: their distances are bond lengths and angles.
        pairs = [(i, j) for i in ends for j in ends if i < j and _steps(joined, i, j) <= 2]
        for x in its.x[:: max(1, len(its.x) // 5)]:
            now = np.array(structure.positions)
            now[its.atoms] = x
            for i, j in pairs:
                before = np.linalg.norm(structure.positions[i] - structure.positions[j])
                assert np.linalg.norm(now[i] - now[j]) == pytest.approx(before, abs=1e-9)


def _steps(bonds, i, j):
    beside = {int(k) for k in bonds[(bonds == i).any(axis=1)].ravel()} - {i}
    if j in beside:
        return 1
    return 2 if beside & {int(k) for k in bonds[(bonds == j).any(axis=1)].ravel()} - {j} else 3


def test_dihedrals_are_those_asked_for():
    structure = load("1ubq.pdb")
    at = {str(structure.atom_name[i]): i for i in np.flatnonzero(structure.atom_residue == 58)}
    assert structure.residue_name[58] == "TYR"
    (arm,) = rotamers_of(structure, structure.positions, [58])
    quartets = [*residues.CHI["TYR"], ("CE1", "CZ", "OH", "HH")]
    facing = backbone_of(structure.neighbours, at, structure.positions, 1)
    assert arm.chi.shape == (1 + 2 * (1 + 3 * len(rotamers("TYR", *facing)[0])), 3)
    for chi, x in zip(arm.chi, arm.x, strict=True):
        now = np.array(structure.positions)
        now[arm.atoms] = x
        found = [float(dihedral(*now[[at[name] for name in quartet]])) for quartet in quartets]
        assert wrap_angle(np.array(found) - chi) == pytest.approx(0.0, abs=1e-9)


# --- All of it


def chi1(structure, x, residue):
    at = {str(structure.atom_name[i]): i for i in np.flatnonzero(structure.atom_residue == residue)}
    return float(dihedral(*x[[at[name] for name in residues.CHI[str(structure.residue_name[residue])][0]]]))


def scrambled(structure, n, seed=0):
    """With random chi1 of n residues, and these residues."""
    rng = np.random.default_rng(seed)
    able = rotamers_of(structure, structure.positions, range(structure.n_residues))
    chosen = [able[k] for k in sorted(rng.choice(len(able), n, replace=False))]
    x = np.array(structure.positions)
    for arm in chosen:
        moved = arm.atoms
        at = {str(structure.atom_name[i]): i for i in np.flatnonzero(structure.atom_residue == arm.residue)}
        quartet = tuple(at[name] for name in residues.CHI[str(structure.residue_name[arm.residue])][0])
        x[moved] = Arm((quartet,), (moved,)).positions_at(x, rng.uniform(-np.pi, np.pi, (1, 1)))[0]
    return structure.with_positions(x), [arm.residue for arm in chosen]


def test_random_side_chains_come_back():
    native = load("1ubq.pdb")
    given, chosen = scrambled(native, 30)
    assert len(near_pairs(given, given.positions, OVERLAP)[0]) > 20
    found = repack_side_chains(given, chosen)
    x = found.positions
    off = [abs(wrap_angle(chi1(native, x, r) - chi1(native, native.positions, r))) for r in chosen]
    # A third of random ones would be; 0.8 are.
    assert np.mean(np.array(off) < np.deg2rad(40)) >= 0.7
    assert not len(near_pairs(found, x, OVERLAP)[0])
    moved = (x != given.positions).any(axis=1)
    turned_residues = set(native.atom_residue[moved].tolist())
    assert set(chosen) >= turned_residues
    assert not moved[np.isin(native.atom_name, ["N", "CA", "C", "O", "CB", "HA"])].any()
    lines = sentences(found)[len(given.repairs) :]
    assert len(lines) == len(turned_residues)
    assert all(any(native.describe_residue(r) in line for line in lines) for r in turned_residues)
    assert any("side chains turned in" in line for line in found.changes)


def test_the_mirror_image_is_repacked_into_the_mirror_image():
    """D-amino acids under the same names: their rotamers are the mirror's, and hands stay."""
    given, chosen = scrambled(load("1l2y.pdb"), 6, seed=1)
    flip = np.array([1.0, 1.0, -1.0])
    found = repack_side_chains(given, chosen)
    mirror = repack_side_chains(given.with_positions(flip * given.positions), chosen)
    assert (found.positions != given.positions).any()
    assert mirror.positions == pytest.approx(flip * found.positions, abs=1e-9)


def test_the_same_is_found_again_by_either_engine():
    given, chosen = scrambled(load("1l2y.pdb"), 6, seed=2)
    first = repack_side_chains(given, chosen, energy=pc.energy(given))
    again = repack_side_chains(given, reversed(chosen), energy=pc.energy(given, engine="openmm"))
    assert np.array_equal(first.positions, again.positions)
    assert first.repairs == again.repairs
    assert np.array_equal(first.positions, repack_side_chains(given, chosen).positions)
    # An energy that leaves out what is constant in a chain still has all terms.
    whole = pc.energy(given)
    groups = pc.build_chain(given).rigid_groups
    assert whole.without_constants(groups, given.positions).terms is whole.terms


def test_a_molecule_kept_beside_is_kept_clear_of(tmp_path):
    peptide = pc.from_sequence("ALA")
    free = repack_side_chains(peptide, [1])
    at = {name: i for i, name in enumerate(peptide.atom_name) if peptide.atom_residue[i] == 1}
    end, before = (10 * free.positions[at[name]] for name in ("CD1", "CG"))
    # Too far for a bond, too near for comfort.
    x, y, z = end + 2.6 * (end - before) / np.linalg.norm(end - before)
    line = f"HETATM  999 XE    XE A 900    {x:8.3f}{y:8.3f}{z:8.3f}  1.00  0.00          XE\n"
    pc.save(free, tmp_path / "free.pdb")
    lines = (tmp_path / "free.pdb").read_text().splitlines(keepends=True)
    (tmp_path / "beside.pdb").write_text("".join([*(ln for ln in lines if not ln.startswith("END")), line]))
    given = pc.load(tmp_path / "beside.pdb")
    (obstacle,) = np.flatnonzero(given.obstacle)
    found = repack_side_chains(given, [1])
    gaps = [
        np.linalg.norm(s.positions[~s.obstacle] - s.positions[obstacle], axis=1).min() for s in (given, found)
    ]
    assert gaps[0] < 0.27 < 0.3 < gaps[1]
    assert np.array_equal(found.positions[obstacle], given.positions[obstacle])


def test_a_clean_structure_stays_as_it_is():
    structure = pc.from_sequence("AAA")
    assert repack_side_chains(structure) is structure
    ala = load("ala10.pdb")
    assert not len(conflicting_residues(ala)) and repack_side_chains(ala) is ala


def test_by_default_those_turn_that_are_in_the_way():
    native = load("1ubq.pdb")
    given, chosen = scrambled(native, 6, seed=3)
    near = near_pairs(given, given.positions, OVERLAP)[0]
    crowded = {r for r in native.atom_residue[near].ravel().tolist() if r in chosen}
    assert crowded and crowded <= set(conflicting_residues(given).tolist())
    found = repack_side_chains(given)
    assert not len(near_pairs(found, found.positions, OVERLAP)[0])
    assert len(conflicting_residues(found)) < len(conflicting_residues(given))


@pytest.mark.parametrize(
    ("first", "glycine"),
    [("H1", "N"), ("H2", "H"), ("H3", "CA"), ("HA", "HA2"), ("H1", "HA3"), ("H2", "C"), ("HA", "O")],
)
def test_atoms_that_no_chi_turns_do_not_make_a_side_chain_turn(first, glycine):
    structure = pc.from_sequence("SAAAGAAA")
    assert not len(conflicting_residues(structure))
    for name, others in ((first, []), ("OG", [0])):
        (one,), (other,) = (
            np.flatnonzero((structure.atom_residue == residue) & (structure.atom_name == its))
            for residue, its in ((0, name), (4, glycine))
        )
        x = structure.positions.copy()
        x[one] = x[other] + [0.02, 0.0, 0.0]
        assert conflicting_residues(structure.with_positions(x)).tolist() == others


def test_the_next_round_looks_where_the_last_put_side_chains(monkeypatch):
    """One put onto another that was far from it: then that may turn, too."""
    s, seen = load("1l2y.pdb"), []
    module, x = importlib.import_module("protochain.relaxation.repack"), s.positions.copy()
    side = [(s.atom_residue == r) & ~np.isin(s.atom_name, module._STAYING) for r in (0, 15)]
    x[side[0]] += x[side[1]].mean(axis=0) - x[side[0]].mean(axis=0)

    def settled(structure, terms, turning):
        seen.append({arm.residue for arm in turning})
        return x, ()

    for name, made in (
        ("_assign_rotamers", settled),
        ("_terms", lambda *_: True),
        ("conflicting_residues", lambda _: np.array([0])),
    ):
        monkeypatch.setattr(module, name, made)
    repack_side_chains(s)
    assert seen[0] == {0} and seen[1] >= {0, 15}


def test_threaded_rings_are_freed():
    for planted in planted_rings([load("1ubq.pdb")], 2, seed=0):
        given = planted.structure
        assert threaded_rings(given)
        assert {planted.ring_residue, planted.threading_residue} & set(conflicting_residues(given).tolist())
        assert not threaded_rings(repack_side_chains(given))


def test_a_residue_that_is_not_there_is_refused():
    with pytest.raises(StructureError, match=r"no residue of index 99; give indices from 0 to 19"):
        repack_side_chains(load("1l2y.pdb"), [1, 99])


# --- Before relaxing


def test_relaxing_turns_them_first_and_tells():
    given, _ = scrambled(load("1l2y.pdb"), 6, seed=1)
    plain = pc.relax(given, solvent="vacuum", max_iterations=20)
    done = pc.relax(given, solvent="vacuum", max_iterations=20, repack=True)
    assert plain.turned == () and plain.record()["side_chains_turned"] == []
    expected = repack_side_chains(given, energy=done.energy_function)
    assert done.turned == expected.repairs[len(given.repairs) :] != ()
    assert done.record()["side_chains_turned"] == [str(each) for each in done.turned]
    assert done.structure.repairs == expected.repairs and done.start is given
    # The springs lead to the turned side chains.
    turned_atoms = (expected.positions != given.positions).any(axis=1) & (given.atom_element != "H")
    away = [np.linalg.norm((done.x - s.positions)[turned_atoms], axis=1).mean() for s in (expected, given)]
    assert away[0] < 0.03 < 0.1 < away[1]
    assert "turned" in done._repr_html_() and "turned" not in plain._repr_html_()


def test_a_polar_hydrogen_turns_in_every_rotamer_and_stays_in_that_of_the_input():
    """The input costs what its own rotamer does, whatever the others cost."""
    chi, rarity, turns = np.array([[0.1], [1.0]]), np.array([3.0, 0.5]), np.array([0.0, 2.0])
    tried, cost = _with_hydrogen(chi, rarity, 0.7, turns)
    assert tried.tolist() == [[0.1, 0.7], [0.1, 0.0], [0.1, 2.0], [1.0, 0.0], [1.0, 2.0]]
    assert cost.tolist() == [3.0, 3.0, 3.0, 0.5, 0.5]


def test_a_region_is_repacked_whether_or_not_it_is_in_the_way():
    """Side chains of the interface of insulin's chains, turned away, come back; those elsewhere stay."""
    native = load("3i40.pdb")
    there = np.unique(native.atom_residue[select(native, "interface A B")])
    given, chosen = scrambled(native, 14, seed=5)
    found = repack_side_chains(given, there.tolist())
    turned = {r for r in chosen if not np.array_equal(*_of(r, given, found))}
    assert turned and turned <= set(there.tolist()) and set(chosen) - set(there.tolist())
    done = pc.relax(given, solvent="vacuum", max_iterations=5, repack_region="interface A B")
    region = np.unique(given.atom_residue[select(given, "interface A B")])
    alone = repack_side_chains(given, region, energy=done.energy_function)
    assert done.turned == alone.repairs[len(given.repairs) :] and done.turned
    record = done.record()
    assert record["repack_region"] == "interface A B" and record["repacked"] is True
    # Natives are not left for rotamers that gain little.
    same = repack_side_chains(native, there.tolist())
    assert sum(not np.array_equal(*_of(r, native, same)) for r in there) <= 0.2 * len(there)
    with pytest.raises(StructureError, match="side 'X'"):
        pc.relax(native, repack_region="interface A X")


def _of(residue, *structures):
    return [s.positions[s.atom_residue == residue] for s in structures]
