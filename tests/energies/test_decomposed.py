"""Energy by term, residue and pair, against OpenMM's Reference platform and sums over atoms one by one."""

import copy
import functools

import numpy as np
import openmm
import pytest
from fixtures.samples import STRUCTURES, chain, load
from openmm import unit

import protochain as pc
from protochain.core import defaults
from protochain.energies.custom import CustomEnergy
from protochain.energies.decomposed import TERMS, decomposed, terms_at

CASES = [
    ("1l2y.pdb", "amber19", "obc2", 0.0),
    ("3i40.pdb", "amber14", "gbn2", 0.0),
    ("3i40.pdb", "charmm36", "vacuum", 0.0),
    ("1ysa.pdb", "amber14", "obc2", 0.0),
    ("3i40.pdb", "amber14", "gbn2", 0.3),
]
built = functools.cache(lambda name, *of, salt: pc.energy(load(name), *of, "native", salt=salt))


def of_reference(system, x):
    """Energies by force of a System, kJ/mol, by OpenMM's Reference platform."""
    system = copy.deepcopy(system)
    for k, force in enumerate(system.getForces()):
        force.setForceGroup(k)
    context = openmm.Context(
        system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatformByName("Reference")
    )
    context.setPositions(x)
    found = {}
    for k, force in enumerate(system.getForces()):
        value = context.getState(getEnergy=True, groups={k}).getPotentialEnergy()
        name = type(force).__name__
        found[name] = found.get(name, 0.0) + value.value_in_unit(unit.kilojoule_per_mole)
    return found


@pytest.mark.parametrize(("name", "forcefield", "solvent", "salt"), CASES)
def test_terms_are_those_of_openmms_forces_and_add_up_to_the_total(name, forcefield, solvent, salt):
    s, energy = load(name), built(name, forcefield, solvent, salt=salt)
    found = decomposed(s, energy, s.positions).terms
    largest = max(map(abs, found.values()))
    assert sum(found.values()) == pytest.approx(energy(s.positions)[0], abs=1e-10 * largest)
    by_openmm = of_reference(energy.system, s.positions)
    for terms, forces in (
        (("bonds",), ("HarmonicBondForce",)), (("angles",), ("HarmonicAngleForce",)),
        (("torsions", "impropers"), ("PeriodicTorsionForce", "CustomTorsionForce")),
        (("cmap",), ("CMAPTorsionForce",)),
        (("lennard_jones", "coulomb"), ("NonbondedForce", "CustomNonbondedForce", "CustomBondForce")),
        (("generalised_born", "surface"), ("GBSAOBCForce", "CustomGBForce")),
    ):  # fmt: skip
        mine = sum(found[each] for each in terms)
        # Of Born radii, polynomials stand for roots and logarithms.
        assert mine == pytest.approx(sum(by_openmm.get(each, 0.0) for each in forces), rel=1e-10, abs=1e-9), (
            terms
        )


def test_coulomb_is_what_charges_do_and_lennard_jones_the_rest():
    s = load("1l2y.pdb")
    energy = pc.energy(s, "amber14", "vacuum", "native")
    system = copy.deepcopy(energy.system)
    (force,) = (each for each in system.getForces() if isinstance(each, openmm.NonbondedForce))
    for k in range(force.getNumParticles()):
        force.setParticleParameters(k, 0.0, *force.getParticleParameters(k)[1:])
    for k in range(force.getNumExceptions()):
        i, j, _, *rest = force.getExceptionParameters(k)
        force.setExceptionParameters(k, i, j, 0.0, *rest)
    uncharged = of_reference(system, s.positions)["NonbondedForce"]
    assert decomposed(s, energy, s.positions).terms["lennard_jones"] == pytest.approx(uncharged, rel=1e-10)


@pytest.mark.parametrize("salt", [0.0, 0.3])
def test_pairs_of_residues_are_sums_over_their_atoms(salt):
    """Slow and clear: each pair of atoms that is no exception, and no shape of loops shared."""
    s = load("ala10.pdb")
    energy = pc.energy(s, "amber14", "obc2", "native", salt=salt)
    kappa = 7.3 * 50.33355 * np.sqrt(salt / 78.5 / 298.15)

    def screened(distance):
        """-1/distance of charges scaled by the root of 1 - 1/78.5."""
        return (1.0 - np.exp(-kappa * distance) / 78.5) / (1.0 - 1.0 / 78.5) / distance

    terms, x, of = energy.terms, s.positions, s.atom_residue
    nonbonded, solvent, born = terms.nonbonded, terms.solvent, energy.born_radii(s.positions)
    found = decomposed(s, energy, x, pairs=True)
    own = {frozenset(pair) for pair in nonbonded.exceptions.atoms.tolist()}
    lj, coulomb, polar = np.zeros((3, s.n_residues, s.n_residues))
    for i in range(s.n_atoms):
        polar[of[i], of[i]] -= 0.5 * solvent.charge[i] ** 2 * screened(born[i])
        for j in range(i + 1, s.n_atoms):
            r2, place = float(np.sum((x[i] - x[j]) ** 2)), (of[i], of[j])
            both = born[i] * born[j]
            f = np.sqrt(r2 + both * np.exp(-0.25 * r2 / both))
            polar[place] -= solvent.charge[i] * solvent.charge[j] * screened(f)
            if {i, j} not in own:
                kinds = nonbonded.lj_type[i], nonbonded.lj_type[j]
                lj[place] += nonbonded.a12[kinds] / r2**6 - nonbonded.b6[kinds] / r2**3
                coulomb[place] += nonbonded.charge[i] * nonbonded.charge[j] / np.sqrt(r2)
    for (i, j), (a, b, qq) in zip(nonbonded.exceptions.atoms, nonbonded.exceptions.parameters, strict=True):
        r = float(np.linalg.norm(x[i] - x[j]))
        place = min(of[i], of[j]), max(of[i], of[j])
        lj[place] += a / r**12 - b / r**6
        coulomb[place] += qq / r
    for name, expected in (("lennard_jones", lj), ("coulomb", coulomb), ("generalised_born", polar)):
        mine = found.pairs[TERMS.index(name)]
        assert np.abs(mine - expected).max() < 1e-10 * np.abs(expected).max(), name


@pytest.mark.parametrize(("name", "forcefield", "solvent", "salt"), CASES)
def test_shares_are_halves_of_pairs_and_add_up(name, forcefield, solvent, salt):
    s, energy = load(name), built(name, forcefield, solvent, salt=salt)
    found = decomposed(s, energy, s.positions, pairs=True)
    total = energy(s.positions)[0]
    assert found.pairs.sum() == pytest.approx(total, abs=1e-10 * np.abs(found.pairs).sum())
    halves = 0.5 * (found.pairs.sum(axis=1) + found.pairs.sum(axis=2))
    # Of two kernels: one goes by tiles of atoms, the other by residues.
    assert np.abs(halves - found.shares).max() < 1e-9
    # Nothing below the diagonal, and bonded terms join neighbours or disulfides.
    assert not np.tril(found.pairs.any(axis=0), -1).any()


@pytest.mark.parametrize("salt", [0.0, 0.3])
def test_the_interaction_of_chains_and_what_the_solvent_costs_are_the_change_of_the_whole(salt):
    """Insulin's chains without their disulfides: energy together minus energies of either alone."""
    s = pc.load(STRUCTURES / "3i40.pdb", disulfide="none")
    energy = pc.energy(s, "amber14", "obc2", "native", salt=salt)
    table = pc.energy_terms(s, between="A,B", energy=energy)
    alone = 0.0
    for letter in ("A", "B"):
        part = pc.load(STRUCTURES / "3i40.pdb", disulfide="none", chains=letter)
        mine = np.flatnonzero(s.residue_chain[s.atom_residue] == letter)
        assert (part.atom_name == s.atom_name[mine]).all()
        alone += pc.energy(part, "amber14", "obc2", "native", salt=salt)(s.positions[mine])[0]
    assert table.loc["sum", "total"] == pytest.approx(energy(s.positions)[0] - alone, abs=1e-6)
    pairs = pc.energy_terms(s, "pair", between=("chainID A", "chainID B"), energy=energy)
    assert pairs["total"].sum() == pytest.approx(table.loc["interaction", "total"], abs=1e-9)
    assert {*pairs["chain_1"], *pairs["chain_2"]} == {"A", "B"}
    residues = pc.energy_terms(s, "residue", between="A,B", energy=energy)
    assert residues["total"].sum() == pytest.approx(pairs["total"].sum(), abs=1e-9)


def test_atoms_bonded_in_the_middle_have_angles_and_impropers():
    s = load("1l2y.pdb")
    table = pc.energy_terms(s, "residue", solvent="vacuum")
    assert list(table.columns) == ["chain", "residue", "name", *TERMS, "total"]
    flat = table[table["impropers"] != 0.0]["name"]
    assert {"TRP", "TYR"} <= {*flat}
    assert (table[["generalised_born", "surface", "ties"]] == 0.0).all(axis=None)


@pytest.mark.parametrize(
    ("options", "said"),
    [({"by": "atom"}, "by 'atom'"), ({"between": "A"}, "two parts"), ({"between": "A,A"}, "in both parts"),
     ({"between": "A,Q"}, "'Q' is no part of"), ({"between": "A:1-5,A:400"}, "no residue A:400"),
     ({"between": 3}, "two parts"), ({"energy": 3}, "energy")],
)  # fmt: skip
def test_what_makes_no_sense_is_refused_in_one_line(options, said):
    with pytest.raises(pc.ProtochainError, match=said) as error:
        pc.energy_terms(load("1l2y.pdb"), **options)
    assert "\n" not in str(error.value)


def test_terms_of_openmms_engine_are_those_of_its_system_and_a_callable_has_none():
    s = load("1l2y.pdb")
    native, other = (
        pc.energy_terms(s, "residue", energy=pc.energy(s, engine=e)) for e in ("native", "openmm")
    )
    assert native.equals(other)
    spring = CustomEnergy(lambda x: (float(0.5 * np.sum(x**2)), -x))
    with pytest.raises(pc.ProtochainError, match="native engine alone"):
        pc.energy_terms(s, energy=spring)
    assert terms_at(spring, s, s.positions, s.positions) == ({}, {})


@pytest.mark.parametrize(
    ("name", "forcefield", "solvent", "cutoff", "engine"),
    [("1l2y.pdb", "amber19", "gbn2", None, "native"), ("3i40.pdb", "charmm36", "vacuum", None, "native"),
     ("1l2y.pdb", "amber14", "obc2", 1.2, "openmm")],
)  # fmt: skip
def test_terms_at_start_and_end_add_up_to_the_energies_of_the_reference(
    name, forcefield, solvent, cutoff, engine
):
    s = load(name)
    energy = pc.energy(s, forcefield, solvent, engine, cutoff=cutoff)
    result = pc.minimise(s, energy, "cartesian", max_evaluations=10)
    record = result.record()
    for when, total in (("start", result.start.energy), ("end", result.end.energy)):
        found = {each: record[f"energy_{each}_{when}_kj_mol"] for each in TERMS}
        assert found == getattr(result, f"terms_{when}")
        # Of the largest term: what cancels in the sum has been rounded before.
        assert sum(found.values()) == pytest.approx(total, abs=1e-10 * max(map(abs, found.values())))
    assert record["energy_bonds_start_kj_mol"] != record["energy_bonds_end_kj_mol"]


def test_terms_of_overlapping_atoms_add_up():
    """Two atoms at one place: their repulsion is large and finite, and no other term knows of it."""
    s = load("1l2y.pdb")
    x = s.positions.copy()
    x[s.alpha_carbons[-1]] = x[s.alpha_carbons[0]]
    energy = pc.energy(s, engine="native")
    found = decomposed(s, energy, x).terms
    assert np.isfinite(list(found.values())).all()
    assert sum(found.values()) == pytest.approx(energy(x)[0], rel=1e-10)


def test_of_more_atoms_than_pairs_are_summed_for_records_tell_no_terms(monkeypatch):
    s = load("1l2y.pdb")
    monkeypatch.setattr(defaults, "FULL_UP_TO", s.n_atoms - 1)
    assert terms_at(pc.energy(s), s, s.positions) == ({},)
    monkeypatch.setattr(defaults, "FULL_UP_TO", s.n_atoms)
    assert set(*terms_at(pc.energy(s), s, s.positions)) == set(TERMS)


def test_asking_for_terms_leaves_the_neighbour_lists_and_any_number_of_threads_gives_the_same_bits():
    s = load("1ubq.pdb")
    one, two = (pc.energy(s, engine="native", threads=n) for n in (1, 2))
    far = s.positions * 1.1
    one(s.positions)
    lists = one.lists_at
    first, second = (decomposed(s, e, far).shares for e in (one, two))
    assert np.array_equal(first, second)
    assert one.lists_at is lists


def test_an_energy_without_its_constant_terms_tells_all_of_them():
    c = chain("1l2y.pdb")
    whole = pc.energy(c.structure, engine="native")
    less = whole.without_constants(c.rigid_groups, c.structure.positions)
    found, expected = (decomposed(c.structure, e, c.structure.positions).shares for e in (less, whole))
    assert np.abs(found - expected).max() < 1e-9


def test_restraints_are_told_at_start_and_end_where_a_run_has_them():
    s = load("ala10.pdb")
    held = pc.minimise(s, method="cartesian", restraints="500")
    heavy = s.atom_element != "H"
    away = np.sum((held.x - s.positions)[heavy] ** 2)
    record = held.record()
    assert record["energy_restraints_start_kj_mol"] < 1e-20  # The pose is rounded.
    assert record["energy_restraints_end_kj_mol"] == pytest.approx(250.0 * away, rel=1e-9) != 0.0
    released = pc.minimise(s, method="cartesian", restraints="500 0")
    assert released.restraints is None and released.record()["energy_restraints_end_kj_mol"] is None
