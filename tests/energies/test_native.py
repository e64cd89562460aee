"""The native engine against OpenMM's Reference platform, quadrature, differences and itself."""

import copy
import os
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import openmm
import pytest
from fixtures.samples import STRUCTURES, chain, load, shared
from fixtures.tolerances import LEFT_OUT, NATIVE_ENERGY, NATIVE_FORCE
from numba import njit
from openmm import app, unit
from scipy.integrate import quad
from scipy.spatial.distance import pdist

import protochain as pc
from protochain.chains.chain import pose, pull_back
from protochain.energies import NativeEnergy, OpenMMEnergy, UnsupportedForceError
from protochain.energies.native import born, series
from protochain.energies.native.evaluate import Layout
from protochain.energies.native.layout import W

PARTS_OF = {
    "HarmonicBondForce": ("bonds",), "HarmonicAngleForce": ("angles",), "PeriodicTorsionForce": ("torsions",),
    "CustomTorsionForce": ("impropers",), "CMAPTorsionForce": ("maps",), "NonbondedForce": ("nonbonded",),
    "CustomNonbondedForce": ("nonbonded",), "CustomBondForce": ("nonbonded",),
    "GBSAOBCForce": ("polar", "surface"), "CustomGBForce": ("polar", "surface"), "CMMotionRemover": (),
}  # fmt: skip
"""Parts of the native energy that hold what an OpenMM force gives."""

TEN = (
    "ala10.pdb", "1l2y.pdb", "1vii.pdb", "1ejg.pdb", "3i40.pdb", "4pti.pdb", "1ubq.pdb", "1hel.pdb",
    "1bta_barstar.pdb", "1fas_fasciculin.cif",
)  # fmt: skip
SMALL = ("1l2y.pdb", "1ejg.pdb", "3i40.pdb")
SLOW = {True: pytest.mark.slow, False: ()}


def structure(name):
    return pc.load(shared(name)) if "_" in name else load(name)


def shaken(s, nm=0.002):
    return s.positions + np.random.default_rng(0).normal(scale=nm, size=s.positions.shape)


def by_force(system, x):
    """Energy of each kind, and all forces, on the Reference platform."""
    system = copy.deepcopy(system)
    for group, force in enumerate(system.getForces()):
        force.setForceGroup(group)
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference"))
    context.setPositions(x)
    energies = {}
    for group, force in enumerate(system.getForces()):
        value = context.getState(energy=True, groups={group}).getPotentialEnergy()._value
        parts = PARTS_OF[type(force).__name__]
        if parts:
            energies[parts] = energies.get(parts, 0.0) + value
    forces = context.getState(forces=True).getForces(asNumpy=True)
    return energies, np.array(forces.value_in_unit(unit.kilojoule_per_mole / unit.nanometer))


def assert_same(native, system, x):
    theirs, their_forces = by_force(system, x)
    ours, forces = native.parts(x)
    # OpenMM reports a force's whole energy: where large parts cancel, digits of these are what is compared.
    for parts, value in theirs.items():
        assert sum(ours[part] for part in parts) == pytest.approx(value, rel=NATIVE_ENERGY)
    size = sum(abs(value) for value in theirs.values())
    assert abs(native(x)[0] - sum(theirs.values())) < NATIVE_ENERGY * size
    assert np.linalg.norm(forces - their_forces) < NATIVE_FORCE * np.linalg.norm(their_forces)


@pytest.mark.parametrize(
    ("name", "forcefield", "solvent"),
    [pytest.param(name, "amber14", "obc2", marks=SLOW[name not in (*SMALL, "1ubq.pdb")]) for name in TEN]
    + [
        pytest.param(name, *its, marks=SLOW[name != "1ejg.pdb"])
        for its in (("amber14", "gbn2"), ("amber19", "vacuum"), ("charmm36", "vacuum"))
        for name in TEN
    ],
)
def test_every_term_equals_the_reference_platforms(name, forcefield, solvent):
    s = structure(name)
    native = pc.energy(s, forcefield, solvent, engine="native")
    assert native.engine == "native"
    assert_same(native, native.system, shaken(s))


KAPPA = 7.3 * 50.33355 * (0.15 / 78.5 / 298.15) ** 0.5
"""1/nm, at 0.15 mol/l, as AmberPrmtopFile.createSystem computes it from a concentration."""


def implicit_system(name, model, cutoff=None, **more):
    force_field = app.ForceField("amber14/protein.ff14SB.xml", *([f"implicit/{model}.xml"] if model else []))
    method = {"nonbondedMethod": app.NoCutoff}
    if cutoff:
        method = {"nonbondedMethod": app.CutoffNonPeriodic, "nonbondedCutoff": cutoff * unit.nanometer}
    return force_field.createSystem(structure(name).topology, **method, **more)


@pytest.mark.parametrize("model", ["hct", "obc1", "obc2", "gbn", "gbn2"])
@pytest.mark.parametrize("cutoff", [None, 1.0])
def test_every_implicit_model_as_the_force_field_builds_it(model, cutoff):
    system = implicit_system("1l2y.pdb", model, cutoff)
    s = load("1l2y.pdb")
    assert_same(pc.energy(s, system=system, engine="native"), system, shaken(s))


@pytest.mark.parametrize("model", ["hct", "obc1", "obc2", "gbn", "gbn2"])
@pytest.mark.parametrize("cutoff", [None, 1.0])
@pytest.mark.parametrize("salt", [0.0, 0.15])
def test_named_solvents_and_salt_equal_the_files_of_openmm(model, cutoff, salt):
    s, more = load("1l2y.pdb"), {"implicitSolventKappa": KAPPA} if salt else {}
    native = pc.energy(s, solvent=model, salt=salt, cutoff=cutoff, engine="native")
    assert_same(native, implicit_system("1l2y.pdb", model, cutoff, **more), shaken(s))


@pytest.mark.parametrize("solvent", ["obc2", "gbn2"])
@pytest.mark.parametrize("name", [pytest.param(name, marks=SLOW[name != "3i40.pdb"]) for name in TEN])
def test_salt_equals_the_reference_platform(name, solvent):
    s = structure(name)
    native = pc.energy(s, solvent=solvent, salt=0.5, engine="native")
    assert_same(native, native.system, shaken(s))
    plain, salted = (e(s.positions)[0] for e in (pc.energy(s, solvent=solvent, engine="native"), native))
    assert salted < plain - 1.0


def test_little_salt_is_no_salt():
    s = load("1l2y.pdb")
    value, forces = pc.energy(s, engine="native")(s.positions)
    salted, pushes = pc.energy(s, salt=1e-16, engine="native")(s.positions)
    assert salted == pytest.approx(value, abs=1e-5)
    assert np.linalg.norm(pushes - forces) < 1e-6 * np.linalg.norm(forces)


def test_gbsa_obc_force_with_a_cutoff():
    s = load("1ubq.pdb")
    system = implicit_system("1ubq.pdb", None, 1.1)
    for force in system.getForces():
        if isinstance(force, openmm.NonbondedForce):
            force.setReactionFieldDielectric(1.0)
    plain = pc.energy(s, engine="openmm").system
    (gb,) = (copy.deepcopy(f) for f in plain.getForces() if isinstance(f, openmm.GBSAOBCForce))
    gb.setNonbondedMethod(gb.CutoffNonPeriodic)
    gb.setCutoffDistance(1.1)
    system.addForce(gb)
    assert_same(pc.energy(s, system=system, engine="native"), system, shaken(s))


@pytest.mark.parametrize(
    ("solvent", "salt"), [("vacuum", 0.0), ("obc2", 0.0), ("gbn2", 0.0), ("obc2", 0.3), ("gbn2", 0.3)]
)
def test_forces_are_minus_the_gradient(solvent, salt):
    s = load("1l2y.pdb")
    e, x = pc.energy(s, "amber19", solvent, salt=salt, engine="native"), shaken(s)
    _, f = e(x)
    rng = np.random.default_rng(1)
    for _ in range(5):
        direction, h = rng.normal(size=x.shape), 1e-6
        numeric = (e(x + h * direction)[0] - e(x - h * direction)[0]) / (2 * h)
        # Cancellation: eps of ten thousand kJ/mol over the step, and its square times third derivatives.
        assert -numeric == pytest.approx(np.sum(f * direction), rel=1e-6, abs=1e-3)


def test_lists_hold_while_atoms_move_and_are_made_anew_when_they_must():
    s = load("1ubq.pdb")
    e, rng = pc.energy(s, engine="native"), np.random.default_rng(2)
    x = s.positions.copy()
    made = set()
    for _ in range(12):
        x = x + rng.normal(scale=0.006, size=x.shape)
        value, forces = e(x)
        made.add(id(e._lists))
        fresh_value, fresh = pc.energy(s, engine="native")(x)
        assert value == pytest.approx(fresh_value, rel=1e-12)
        assert np.linalg.norm(forces - fresh) < 1e-11 * np.linalg.norm(fresh)
    assert 1 < len(made) < 12


def test_positions_may_have_a_unit():
    s, e = load("ala10.pdb"), pc.energy(load("ala10.pdb"), engine="native", device="cpu")
    value, forces = e(10.0 * s.positions * unit.angstrom)
    assert value == pytest.approx(e(s.positions)[0], rel=NATIVE_ENERGY)
    assert np.linalg.norm(forces - e(s.positions)[1]) < NATIVE_FORCE * np.linalg.norm(forces)


@pytest.mark.parametrize("solvent", ["vacuum", "obc2"])
def test_no_place_is_taken_by_the_padding_of_the_last_block(solvent):
    s = load("ala10.pdb")
    e = pc.energy(s, solvent=solvent, engine="native")
    assert s.n_atoms % W
    value, forces = e(s.positions)
    for atom in range(0, s.n_atoms, 9):
        moved, by_moved = e(s.positions - s.positions[atom])
        assert moved == pytest.approx(value, rel=NATIVE_ENERGY)
        assert np.linalg.norm(by_moved - forces) < NATIVE_FORCE * np.linalg.norm(forces)


@pytest.mark.parametrize("qq", [0.0, 0.2])
def test_an_exception_between_atoms_beyond_the_cutoff(qq):
    s, system = load("1l2y.pdb"), implicit_system("1l2y.pdb", None, 0.9)
    (force,) = (f for f in system.getForces() if isinstance(f, openmm.NonbondedForce))
    x = shaken(s)
    distance = np.linalg.norm(x[0] - x, axis=1)
    charged = np.array([abs(force.getParticleParameters(i)[0]._value) > 0.3 for i in range(s.n_atoms)])
    beyond = np.flatnonzero(charged & (distance > 1.1) & (distance < 1.5))[:10]
    for i in (np.flatnonzero(charged & (distance > 0.5) & (distance < 0.8))[0], *beyond):
        force.addException(0, int(i), qq, 0.3, 0.4 * qq)
    assert len(beyond) == 10
    assert_same(pc.energy(s, system=system, engine="native"), system, x)


def test_pairs_of_a_table_are_added_to_the_lennard_jones_of_nonbonded_force():
    s = load("ala10.pdb")
    system = copy.deepcopy(pc.energy(s, "charmm36", "vacuum", engine="openmm").system)
    (force,) = (f for f in system.getForces() if isinstance(f, openmm.NonbondedForce))
    for i in range(s.n_atoms):
        force.setParticleParameters(i, force.getParticleParameters(i)[0], 0.25 + 0.002 * (i % 7), 0.4)
    for i in range(force.getNumExceptions()):
        first, second, qq, *_ = force.getExceptionParameters(i)
        force.setExceptionParameters(i, first, second, qq, 0.25, 0.3 if qq._value else 0.0)
    assert_same(pc.energy(s, system=system, engine="native"), system, shaken(s))


@pytest.mark.parametrize(("solvent", "salt"), [("vacuum", 0.0), ("obc2", 0.0), ("gbn2", 0.0), ("gbn2", 0.15)])
def test_atoms_on_top_of_one_another_give_large_numbers(solvent, salt):
    s = load("1l2y.pdb")
    e, x = pc.energy(s, solvent=solvent, salt=salt, engine="native"), s.positions.copy()
    for apart in (0.0, 1e-9, 1e-5, 1e-2):
        x[200] = x[20] + [apart, 0, 0]
        value, forces = e(x)
        assert np.isfinite(value)
        assert np.isfinite(forces).all()
        assert apart > 1e-3 or value > 1e10
    x[:] = 0.0
    value, forces = e(x)
    assert np.isfinite(value)
    assert np.isfinite(forces).all()


def test_positions_that_are_not_numbers_are_an_infinite_energy():
    s = load("ala10.pdb")
    e, x = pc.energy(s, engine="native"), s.positions.copy()
    x[3, 1] = np.nan
    value, forces = e(x)
    assert value == np.inf
    assert np.isnan(forces).all()


@pytest.mark.parametrize(
    ("name", "solvent", "hinges"),
    [("1l2y.pdb", "gbn2", "phi psi chi"), ("4pti.pdb", "obc2", "phi psi"),
     ("3i40.pdb", "vacuum", "phi psi chi omega rotors")],
)  # fmt: skip
def test_leaving_out_constants_changes_nothing(name, solvent, hinges):
    c = chain(name, hinges)
    whole = pc.energy(c.structure, "amber19", solvent, engine="native")
    less = whole.without_constants(c.rigid_groups, pose(c, c.q0).x)
    assert less.left_out["bonds"] == whole.system.getForce(0).getNumBonds() - len(c.loops)
    assert less.left_out["torsions"] > 0
    rng = np.random.default_rng(4)
    for turn in (1e-3, 0.3):
        q = c.q0.copy()
        q[c.tree.q_start[c.hinge_body]] += rng.normal(scale=turn, size=c.n_hinges)
        at = pose(c, q)
        (value, forces), (same, fewer) = whole(at.x), less(at.x)
        assert same == pytest.approx(value, rel=1e-12, abs=1e-8)
        tau, of_less = pull_back(c, at, forces), pull_back(c, at, fewer)
        assert np.linalg.norm(tau - of_less) < LEFT_OUT * np.linalg.norm(tau)


def test_rigid_groups_are_rigid():
    c = chain("1l2y.pdb", "phi psi chi omega rotors")
    groups = c.rigid_groups
    rng = np.random.default_rng(5)
    q = c.q0.copy()
    q[c.tree.q_start[c.hinge_body]] += rng.normal(size=c.n_hinges)
    before, after = pose(c, c.q0).x, pose(c, q).x
    assert np.array_equal(groups[:, 0], c.atom_body)
    on_axes = 0
    for body in range(c.n_bodies):
        members = np.flatnonzero((groups == body).any(axis=1))
        on_axes += len(members) - np.sum(c.atom_body == body)
        change = pdist(before[members]) - pdist(after[members])
        assert np.abs(change).max(initial=0.0) < 1e-11
    # Both ends of a turning bond lie on its axis, and one of them in the other body.
    assert on_axes >= 2 * c.n_hinges - len(c.loops)


def with_force(force):
    s = load("ala10.pdb")
    system = copy.deepcopy(pc.energy(s, solvent="vacuum", engine="openmm").system)
    system.addForce(force)
    return s, system


def done(force, change):
    change(force)
    return force


def changed_gb(change):
    """The standard GBn2 force, changed."""
    s, system = custom_gb("", "")
    (force,) = (f for f in system.getForces() if isinstance(f, openmm.CustomGBForce))
    change(force)
    return s, system


def changed_table(change):
    """CHARMM's table of pairs, changed."""
    s = load("ala10.pdb")
    system = app.ForceField("charmm36.xml").createSystem(s.topology)
    (force,) = (f for f in system.getForces() if isinstance(f, openmm.CustomNonbondedForce))
    change(force)
    return s, system


def with_other_dielectric(force):
    """Of one of the energy's terms."""
    expression, kind = force.getEnergyTermParameters(0)
    assert "solventDielectric=78.5" in expression
    force.setEnergyTermParameters(
        0, expression.replace("solventDielectric=78.5", "solventDielectric=4"), kind
    )


def custom_gb(old, new, change=lambda system: None, **more):
    """The standard GBn2 force with one expression changed."""
    system = implicit_system("ala10.pdb", "gbn2", **more)
    (force,) = (f for f in system.getForces() if isinstance(f, openmm.CustomGBForce))
    for i in range(force.getNumComputedValues()):
        name, expression, kind = force.getComputedValueParameters(i)
        force.setComputedValueParameters(i, name, expression.replace(old, new), kind)
    for i in range(force.getNumEnergyTerms()):
        expression, kind = force.getEnergyTermParameters(i)
        force.setEnergyTermParameters(i, expression.replace(old, new), kind)
    change(system)
    return load("ala10.pdb"), system


def gb_with_dielectrics(inside, outside):
    force = openmm.GBSAOBCForce()
    force.setSoluteDielectric(inside)
    force.setSolventDielectric(outside)
    for _ in range(load("ala10.pdb").n_atoms):
        force.addParticle(0.1, 0.15, 0.8)
    return force


def changed(model, kind, change, name="ala10.pdb"):
    """A System as the force field builds it with a 1 nm cutoff, and one of its forces changed."""
    system = implicit_system(name, model, 1.0)
    (force,) = (f for f in system.getForces() if isinstance(f, kind))
    change(force)
    return load(name), system


def charmm_with_another_cutoff():
    s = load("ala10.pdb")
    force_field = app.ForceField("charmm36.xml")
    system = force_field.createSystem(s.topology, nonbondedMethod=app.CutoffNonPeriodic)
    (force,) = (f for f in system.getForces() if isinstance(f, openmm.CustomNonbondedForce))
    force.setCutoffDistance(0.8)
    return s, system


def with_site():
    s, system = with_force(openmm.CMMotionRemover())
    system.setParticleMass(5, 0.0)
    system.setVirtualSite(5, openmm.TwoParticleAverageSite(0, 1, 0.5, 0.5))
    return s, system


def two_maps():
    force = openmm.CMAPTorsionForce()
    for size in (4, 6):
        force.addMap(size, size**2 * [0.0])
    return force


def well_of_no_exception():
    force = openmm.CustomBondForce("4*epsilon*((sigma/r)^12-(sigma/r)^6)")
    force.addPerBondParameter("sigma"), force.addPerBondParameter("epsilon")
    force.addBond(0, 60, [0.1, 0.1])
    return force


def with_offset(add, *values):
    def change(force):
        force.addGlobalParameter("by", 0.0)
        getattr(force, add)("by", 0, *values)

    return changed(None, openmm.NonbondedForce, change)


UNKNOWN = {
    "virtual sites": with_site,
    "CMAPTorsionForce with maps of different sizes": lambda: with_force(two_maps()),
    "CustomBondForce between atoms that are no exception": lambda: with_force(well_of_no_exception()),
    "NonbondedForce with parameter offsets": lambda: with_offset("addParticleParameterOffset", 0.1, 0, 0),
    "NonbondedForce with parameter": lambda: with_offset("addExceptionParameterOffset", 0.1, 0, 0),
    "NonbondedForce with a switching": lambda: changed(
        None, openmm.NonbondedForce, lambda force: force.setUseSwitchingFunction(True)
    ),
    "NonbondedForce with periodic boundaries": lambda: changed(
        None, openmm.NonbondedForce, lambda force: force.setNonbondedMethod(force.PME)
    ),
    "CustomExternalForce": lambda: with_force(openmm.CustomExternalForce("x^2")),
    "RBTorsionForce": lambda: with_force(openmm.RBTorsionForce()),
    "CustomTorsionForce": lambda: with_force(openmm.CustomTorsionForce("theta")),
    "CustomBondForce": lambda: with_force(openmm.CustomBondForce("r")),
    "more than one NonbondedForce": lambda: with_force(openmm.NonbondedForce()),
    "CustomGBForce with Born integral": lambda: custom_gb("neckCut=0.68", "neckCut=0.7"),
    "CustomGBForce with Born radius": lambda: custom_gb("tanh(", "sin("),
    "CustomGBForce with energy": lambda: custom_gb("kappa=0", "kappa=1"),
    "generalised Born with salt and one dielectric": lambda: custom_gb(
        "Dielectric=78.5", "Dielectric=1", implicitSolventKappa=1.0
    ),
    "GBSAOBCForce or CustomGBForce with a cutoff of 1 nm": lambda: changed(
        "obc2", openmm.NonbondedForce, lambda force: force.setCutoffDistance(1.2)
    ),
    "CustomNonbondedForce with a cutoff of 0.8 nm": charmm_with_another_cutoff,
    "NonbondedForce with a cutoff below": lambda: changed(
        None, openmm.NonbondedForce, lambda force: force.setCutoffDistance(0.3)
    ),
    "CustomGBForce with alpha = 0": lambda: changed(
        "gbn2",
        openmm.CustomGBForce,
        lambda force: [
            force.setParticleParameters(i, [*values[:3], 0.0, *values[4:]])
            for i in range(force.getNumParticles())
            for values in [force.getParticleParameters(i)]
        ],
    ),
    "generalised Born of dielectric 80 inside": lambda: with_force(gb_with_dielectrics(80.0, 2.0)),
    "GBSAOBCForce with periodic boundaries": lambda: with_force(
        done(gb_with_dielectrics(1.0, 78.5), lambda force: force.setNonbondedMethod(force.CutoffPeriodic))
    ),
    "GBSAOBCForce together with CustomGBForce": lambda: custom_gb(
        "", "", lambda system: system.addForce(gb_with_dielectrics(1.0, 78.5))
    ),
    "CustomGBForce with periodic boundaries": lambda: changed_gb(
        lambda force: force.setNonbondedMethod(force.CutoffPeriodic)
    ),
    "CustomGBForce with exclusions": lambda: changed_gb(lambda force: force.addExclusion(0, 60)),
    "CustomGBForce with exclusions or global": lambda: changed_gb(
        lambda force: force.addGlobalParameter("k", 1.0)
    ),
    "CustomGBForce that is none of": lambda: changed_gb(
        lambda force: force.addComputedValue("C", "B", force.SingleParticle)
    ),
    "CustomGBForce without the usual polar terms": lambda: changed_gb(with_other_dielectric),
    "CustomGBForce whose necks' types": lambda: changed_gb(
        lambda force: force.setParticleParameters(
            0,
            [
                v + 0.01 * (force.getPerParticleParameterName(k) == "or")
                for k, v in enumerate(force.getParticleParameters(0))
            ],
        )
    ),
    "CustomNonbondedForce 'r'": lambda: changed_table(lambda force: force.setEnergyFunction("r")),
    "CustomNonbondedForce with other exclusions": lambda: changed_table(
        lambda force: force.addExclusion(0, 60)
    ),
}


@pytest.mark.parametrize("what", UNKNOWN)
def test_what_has_no_exact_counterpart_is_refused_by_name(what):
    s, system = UNKNOWN[what]()
    with pytest.raises(UnsupportedForceError, match=what.split()[0]) as refusal:
        pc.energy(s, system=system, engine="native")
    assert str(refusal.value).startswith(what)
    fallen_back = pc.energy(s, system=system, engine="auto")
    assert isinstance(fallen_back, OpenMMEnergy)
    assert str(refusal.value) in fallen_back.reason


def test_auto_is_native_for_the_named_force_fields():
    names = [(name, "vacuum") for name in ("amber14", "amber19", "amber99sb", "amber99sbildn", "charmm36")]
    for forcefield, solvent in [*names, ("amber14", "obc2"), ("amber14", "gbn2")]:
        e = pc.energy(load("ala10.pdb"), forcefield, solvent)
        assert isinstance(e, NativeEnergy)
        assert e.reference.platform == "Reference"


def callable_from_python(function):
    """A function that only kernels call, in a kernel."""
    return njit(lambda *values: function(*values))


def test_powers_of_two():
    power_of_two = callable_from_python(series.power_of_two)
    y = np.linspace(-60.0, 0.0, 20001)
    ours = np.array([power_of_two(value) for value in y])
    assert np.abs(ours / np.exp2(y) - 1).max() < 1e-13
    assert power_of_two(-1e6) == power_of_two(-60.0)


def test_inverse_roots_over_all_exponents():
    inverse_root = callable_from_python(series.inverse_root)
    mantissa = np.linspace(1.0, 2.0, 401)
    x = np.concatenate([mantissa * 2.0**exponent for exponent in range(-80, 81)])
    ours = np.array([inverse_root(value) for value in x])
    assert np.abs(ours * np.sqrt(x) - 1).max() < 1e-15
    assert np.isfinite(inverse_root(0.0))


def test_logarithms_over_all_exponents():
    logarithm = callable_from_python(series.logarithm)
    mantissa = np.linspace(1.0, 2.0, 401)[:-1]
    x = np.concatenate([mantissa * 2.0**exponent for exponent in range(-60, 61)])
    ours = np.array([logarithm(value) for value in x])
    assert np.abs(ours - np.log(x)).max() < 1e-13
    assert logarithm(1.0) == 0.0
    beside_1 = 1.0 + np.linspace(-1e-3, 1e-3, 101)
    assert [logarithm(value) for value in beside_1] == pytest.approx(np.log(beside_1), rel=1e-12, abs=0)


@pytest.mark.parametrize("near", [True, False])
def test_the_series_are_the_closed_form(near):
    largest = series.NEAR_RATIO if near else series.FAR_RATIO

    @njit
    def values_at(y):
        return series.integral_series(y, near), series.slope_series(y, near)

    descreening = callable_from_python(born.descreening)
    s = 0.12
    for ratio in np.linspace(0.05, 0.999 * largest, 40):
        r = s / ratio
        value, over_r = descreening(r, 0.01, s, False)
        # The closed form loses what cancels in it: some eps / ratio^3.
        lost = 20 * np.finfo(float).eps / ratio**3
        integral, slope = values_at(ratio**2)
        assert 0.5 * s**3 / r**4 * integral == pytest.approx(value, rel=lost + 6e-13)
        assert -0.5 * s**3 / r**6 * slope == pytest.approx(over_r, rel=lost + 3e-12)


@pytest.mark.parametrize("r", [0.05, 0.11, 0.2, 0.3, 0.7])
def test_the_descreening_integral_is_that_of_a_sphere(r):
    """1/(4 pi) times the integral of 1/t^4 over the part of the sphere outside the atom."""
    radius, s = 0.14, 0.12
    descreening = callable_from_python(born.descreening)

    def inside(t):
        """Share of the shell of radius t about the atom that lies in the sphere."""
        if t <= s - r:
            return 1.0
        return np.clip((s**2 - (r - t) ** 2) / (4 * r * t), 0.0, 1.0)

    ends = sorted({max(radius, abs(r - s)), max(radius, r + s)})
    by_quadrature = quad(lambda t: inside(t) / t**2, ends[0], ends[-1], epsabs=1e-13)[0]
    assert descreening(r, radius, s, True)[0] == pytest.approx(by_quadrature, rel=1e-9, abs=1e-12)
    h = 1e-6
    numeric = (descreening(r + h, radius, s, True)[0] - descreening(r - h, radius, s, True)[0]) / (2 * h)
    assert r * descreening(r, radius, s, True)[1] == pytest.approx(numeric, rel=1e-6, abs=1e-9)


@pytest.mark.slow
def test_no_bit_depends_on_what_was_compiled_first(tmp_path):
    chain_first = "pc.build_chain(s); print(repr(float(pc.energy(s)(s.positions)[0])))"
    energy_first = "e = pc.energy(s); print(repr(float(e(s.positions)[0]))); pc.build_chain(s)"
    found = []
    for name, then in (("chain", chain_first), ("energy", energy_first)):
        program = f"import protochain as pc; s = pc.load({str(STRUCTURES / '1l2y.pdb')!r}); {then}"
        alone = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / name)}
        run = subprocess.run(
            [sys.executable, "-c", program], env=alone, capture_output=True, text=True, check=True
        )
        found.append(run.stdout)
    assert found[0] == found[1] != ""


def test_a_block_is_near_up_to_where_the_far_series_of_its_largest_radius_hold():
    s = np.full(40, 0.1)
    s[3], s[39] = -0.3, 0.15
    solvent = SimpleNamespace(scaled_radius=s, offset_radius=np.full(40, 0.2))
    made = Layout(SimpleNamespace(solvent=solvent, n_atoms=40), np.full((40, 1), -1), (s, s))
    assert made.near == pytest.approx(0.3 / 0.5)
    assert made.block_near == pytest.approx([0.3 / 0.24, 0.15 / 0.24])
    s[39] = 0.01
    small = Layout(made.terms, made.groups, made.exceptions)
    assert small.block_near == pytest.approx([0.3 / 0.24, max(0.1 / 0.24, small.near)])
    none = Layout(SimpleNamespace(solvent=None, n_atoms=40), made.groups, made.exceptions)
    assert none.block_near.tolist() == [none.near] * 2
