"""Energy by term, residue and pair, against OpenMM's Reference platform and sums over atoms one by one."""

import copy

import numpy as np
import openmm
import pytest
from fixtures.samples import STRUCTURES, load
from openmm import unit

import protochain as pc
from protochain.energies.decomposed import TERMS, decomposed

CASES = [("1l2y.pdb", "amber19", "obc2"), ("3i40.pdb", "amber14", "gbn2"), ("3i40.pdb", "charmm36", "vacuum"),
         ("1ysa.pdb", "amber14", "obc2")]  # fmt: skip


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


@pytest.mark.parametrize(("name", "forcefield", "solvent"), CASES)
def test_terms_are_those_of_openmms_forces_and_add_up_to_the_total(name, forcefield, solvent):
    s = pc.load(STRUCTURES / name)
    energy = pc.energy(s, forcefield, solvent, "native")
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


def test_pairs_of_residues_are_sums_over_their_atoms():
    """Slow and clear: each pair of atoms that is no exception, and no shape of loops shared."""
    s = load("ala10.pdb")
    energy = pc.energy(s, "amber14", "obc2", "native")
    terms, x, of = energy.terms, s.positions, s.atom_residue
    nonbonded, solvent, born = terms.nonbonded, terms.solvent, energy.born_radii(s.positions)
    found = decomposed(s, energy, x, pairs=True)
    own = {frozenset(pair) for pair in nonbonded.exceptions.atoms.tolist()}
    lj, coulomb, polar = np.zeros((3, s.n_residues, s.n_residues))
    for i in range(s.n_atoms):
        polar[of[i], of[i]] -= 0.5 * solvent.charge[i] ** 2 / born[i]
        for j in range(i + 1, s.n_atoms):
            r2, place = float(np.sum((x[i] - x[j]) ** 2)), (of[i], of[j])
            both = born[i] * born[j]
            f = np.sqrt(r2 + both * np.exp(-0.25 * r2 / both))
            polar[place] -= solvent.charge[i] * solvent.charge[j] / f
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


@pytest.mark.parametrize(("name", "forcefield", "solvent"), CASES)
def test_shares_are_halves_of_pairs_and_add_up(name, forcefield, solvent):
    s = pc.load(STRUCTURES / name)
    energy = pc.energy(s, forcefield, solvent, "native")
    found = decomposed(s, energy, s.positions, pairs=True)
    total = energy(s.positions)[0]
    assert found.pairs.sum() == pytest.approx(total, abs=1e-10 * np.abs(found.pairs).sum())
    halves = 0.5 * (found.pairs.sum(axis=1) + found.pairs.sum(axis=2))
    assert np.abs(halves - found.shares).max() < 1e-9
    # Nothing below the diagonal, and bonded terms join neighbours or disulfides.
    assert not np.tril(found.pairs.any(axis=0), -1).any()


def test_the_interaction_of_chains_and_what_the_solvent_costs_are_the_change_of_the_whole():
    """Insulin's chains without their disulfides: energy together minus energies of either alone."""
    s = pc.load(STRUCTURES / "3i40.pdb", disulfide="none")
    energy = pc.energy(s, "amber14", "obc2", "native")
    table = pc.energy_terms(s, between="A,B", energy=energy)
    alone = 0.0
    for chain in ("A", "B"):
        part = pc.load(STRUCTURES / "3i40.pdb", disulfide="none", chains=chain)
        mine = np.flatnonzero(s.residue_chain[s.atom_residue] == chain)
        assert (part.atom_name == s.atom_name[mine]).all()
        alone += pc.energy(part, "amber14", "obc2", "native")(s.positions[mine])[0]
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


def test_another_engine_tells_no_terms():
    s = load("1l2y.pdb")
    with pytest.raises(pc.ProtochainError, match="native engine alone"):
        pc.energy_terms(s, energy=pc.energy(s, engine="openmm"))
