"""A result that is handed on brings its energy, its chain and its coordinates, to every call, of every kind.

What a call computed with is known by its number, which OpenMM's own files give without protochain.
"""

import functools
import inspect
from dataclasses import fields, is_dataclass

import numpy as np
import openmm
import pytest
from fixtures.samples import STRUCTURES
from fixtures.tolerances import RIGID_MOTION
from openmm import app, unit

import protochain as pc
from protochain.core.processors import processors
from protochain.energies import CustomEnergy
from protochain.minimisers.judging import NAMES

OWN = {"forcefield": "amber99sb", "solvent": "vacuum", "threads": 1}
FILES = {
    "own": ("amber99sb.xml",),
    "other": ("amber14-all.xml", "implicit/gbn2.xml"),
    "solvent": ("amber99sb.xml", "implicit/gbn2.xml"),
}
HINGES, PARTS, MUTATION = "phi psi", ("resid 1:2", "resid 3:4"), "Y2G"


@functools.cache
def peptide():
    return pc.from_sequence("AYGA")


@functools.cache
def context(files):
    """OpenMM's Reference platform, of a System that OpenMM builds from its files."""
    system = app.ForceField(*FILES[files]).createSystem(peptide().topology)
    return openmm.Context(
        system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference")
    ), system


def by_openmm(files, x):
    at = context(files)[0]
    at.setPositions(x)
    return at.getState(energy=True).getPotentialEnergy().value_in_unit(unit.kilojoule_per_mole)


def springs(x):
    """A callable: springs that pull all atoms to the origin."""
    return float(np.sum(x**2)), -2.0 * x


@functools.cache
def own():
    return pc.energy(peptide(), **OWN)


@functools.cache
def other():
    return pc.energy(peptide(), solvent="gbn2", threads=1)


@functools.cache
def chain():
    return pc.build_chain(peptide(), HINGES)


@functools.cache
def solution():
    return pc.minimise(chain(), own(), "lbfgs", max_evaluations=60)


@functools.cache
def relaxed():
    return pc.relax(solution(), max_iterations=5, max_outer_iterations=1)


def a_search():
    return pc.search(chain(), own(), "hopping", evaluations=40)


def frames(top, **options):
    return next(pc.relax_frames(top, peptide().positions[None], max_iterations=3, **options))


def frame_energy(r, e):
    return pc.frame_energies(r, pc.as_structure(r).positions[None], **none_or(e))["energy_kj_mol"][0]


KINDS = {
    "solution": solution,
    "all atoms": lambda: pc.minimise(chain(), own(), "cartesian", max_evaluations=40),
    "held": lambda: pc.minimise(chain(), own(), "lbfgs", restraints=1e4, max_evaluations=20),
    "simulation": lambda: pc.simulate(chain(), own(), n_steps=20, every=20, pull="A:1:CA-A:4:CA"),
    "relaxation": relaxed,
    "starts": lambda: pc.explore(chain(), own(), "lbfgs", 2, max_evaluations=30),
    "search": a_search,
    "modes": lambda: pc.normal_modes(solution(), own(), k=2),
    "frame": lambda: frames(peptide(), **OWN),
    "frame of a result": lambda: frames(solution()),
    "interface": lambda: pc.score_interface(solution(), *PARTS, energy=own()),
    "compared": lambda: pc.compare(chain(), "lbfgs", own(), max_evaluations=20).solutions[0],
    "comparison": lambda: pc.compare(chain(), ("lbfgs", "kcm"), own(), max_evaluations=20, curvature=False),
    "mutation": lambda: pc.mutate(solution(), "Y2Y", max_iterations=5),
    "prepared": lambda: pc.Setup(**OWN, hinges=HINGES).prepare(solution()),
    "twice": lambda: pc.minimise(pc.minimise(solution(), max_evaluations=2), max_evaluations=2),
}
"""Every kind of result; its energy is ``own``."""
WITHOUT_CHAIN = {"relaxation", "frame", "frame of a result", "interface", "mutation"}

result = functools.cache(lambda kind: KINDS[kind]())


def in_ase(atoms):
    from ase import units

    return atoms.get_potential_energy() / (units.kJ / units.mol)


def at(energy, r):
    return energy(pc.as_structure(r).positions)[0]


def by_hessian(r, e):
    """Number of the energy of which the Hessian is: those of the two differ."""
    found = pc.hessian(r, e)
    known = {which.forcefield + which.solvent: which for which in (own(), other())}
    (of,) = [name for name, each in known.items() if np.array_equal(pc.hessian(r, each), found)]
    return at(known[of], r)


def by_product(r, e):
    direction = np.eye(pc.build_chain(r).n_v)[0]
    found = pc.hessian_product(r, e, None, direction)
    (value,) = [
        at(each, r)
        for each in (own(), other())
        if np.array_equal(pc.hessian_product(r, each, None, direction), found)
    ]
    return value


def phi(r):
    return pc.as_structure(r).dihedrals()["phi"][[1]]


def arrays(value, at, seen):
    """Arrays of a frozen value and of what it holds, each with its place."""
    if id(value) in seen:
        return
    seen[id(value)] = value
    of = type(value)
    if isinstance(value, np.ndarray):
        yield at, value
    elif isinstance(value, tuple | list | dict):
        for each in value.values() if isinstance(value, dict) else value:
            yield from arrays(each, at, seen)
    elif is_dataclass(value) and of.__module__.startswith("protochain") and of.__dataclass_params__.frozen:
        for field in fields(value):
            yield from arrays(getattr(value, field.name), f"{of.__name__}.{field.name}", seen)


@pytest.mark.parametrize("kind", [*KINDS, "structure", "ligand"])
def test_no_array_of_a_result_can_be_written_to(kind):
    """But those of states, from which a run goes on."""
    others = {"structure": peptide, "ligand": lambda: pc.ligand("C[C@H](O)C=O")}
    found = [*arrays(others[kind]() if kind in others else result(kind), kind, {})]
    assert len(found) > 5
    states = {"Phase", "Bath", "Simulation", "Hopping"}
    assert {at.split(".")[0] for at, array in found if array.flags.writeable} <= states


def none_or(e):
    return {} if e is None else {"energy": e}


def named(e):
    """The same energy by its names, to calls that take no other."""
    return {} if e is None else {name: getattr(e, name) for name in ("forcefield", "solvent", "threads")}


CALLS = {
    "energy": lambda r, e: at(pc.energy(r, **named(e)), r),
    "energy_terms": lambda r, e: pc.energy_terms(r, **none_or(e))["total"].iloc[0],
    "score_interface": lambda r, e: at(pc.score_interface(r, *PARTS, **none_or(e)).energy_function, r),
    "to_ase": lambda r, e: in_ase(pc.to_ase(r, e)),
    "minimise": lambda r, e: pc.minimise(r, e, "lbfgs", max_evaluations=1).start.energy,
    "explore": lambda r, e: pc.explore(r, e, "lbfgs", 1, max_evaluations=1).solutions[0].start.energy,
    "compare": lambda r, e: (
        pc.compare(r, "lbfgs", e, max_evaluations=1, curvature=False).solutions[0].start.energy
    ),
    "search": lambda r, e: at(pc.search(r, e, "hopping", evaluations=1).energy_function, r),
    "simulate": lambda r, e: pc.simulate(r, e, n_steps=1, every=1).rows[0]["potential_kj_mol"],
    "relax": lambda r, e: pc.relax(r, max_iterations=1, max_outer_iterations=1, **named(e)).energy_start,
    "mutate": lambda r, e: at(pc.mutate(r, MUTATION, **named(e)).wild.energy_function, r),
    "frame_energies": frame_energy,
    "relax_frames": lambda r, e: at(frames(r, **named(e)).energy_function, r),
    "normal_modes": lambda r, e: at(pc.normal_modes(r, e, k=1).energy_function, r),
    "scan": lambda r, e: pc.scan(r, e, {"phi A:2": phi(r)})["energy_kj_mol"][0],
    "unfold": lambda r, e: pc.unfold(r, e, max_steps=1).energies[0],
    "hessian": by_hessian,
    "hessian_product": by_product,
}
"""Energy that each call computed with, at the coordinates of a result, kJ/mol."""
CHAINS = {
    "build_chain": lambda r: pc.build_chain(r),
    "minimise": lambda r: pc.minimise(r, method="lbfgs", max_evaluations=1).chain,
    "explore": lambda r: pc.explore(r, None, "lbfgs", 1, max_evaluations=1).chain,
    "compare": lambda r: pc.compare(r, "lbfgs", max_evaluations=1, curvature=False).solutions[0].chain,
    "search": lambda r: pc.search(r, method="hopping", evaluations=1).chain,
    "simulate": lambda r: pc.simulate(r, n_steps=1, every=1).chain,
    "normal_modes": lambda r: pc.normal_modes(r, k=1).chain,
    "unfold": lambda r: pc.unfold(r, max_steps=1).chain,
}
COORDINATES = {
    "as_structure", "cluster_frames", "complex_quality", "deviation", "differences", "energy_from", "quality",
    "rmsd", "save", "save_ligands", "to_mdanalysis", "to_mdtraj", "to_simulation", "touching_chains",
    "validate", "view",
}  # fmt: skip
"""Calls that need neither energy nor chain."""
NO_RESULT = {
    "batch", "ca_rmsd", "from_sequence", "from_simulation", "kcm", "ligand", "load", "log_det_mass",
    "mass_matrix", "minimize", "pose", "progress", "pull_back", "scan_mutations",
    "solve_mass", "umbrella",
}  # fmt: skip
"""Calls that take files, or a chain and its coordinates, or are names of others, or call one of these."""


def test_every_public_function_is_here():
    functions = {name for name in pc.__all__ if inspect.isfunction(getattr(pc, name))}
    assert functions == {*CALLS, *CHAINS} | COORDINATES | NO_RESULT
    assert pc.minimize is pc.minimise


@pytest.mark.parametrize(
    ("kind", "call"),
    [
        *((kind, "minimise") for kind in KINDS),
        *(("relaxation", call) for call in CALLS if call != "minimise"),
    ],
)
def test_a_result_brings_its_energy_unless_another_is_given(kind, call):
    if call == "to_ase":
        pytest.importorskip("ase")
    r = result(kind)
    x = pc.as_structure(r).positions
    for e, files in ((None, "own"), (other(), "other")):
        assert CALLS[call](r, e) == pytest.approx(by_openmm(files, x), rel=RIGID_MOTION)


def test_the_energies_can_be_told_apart():
    """Otherwise nothing above would be shown."""
    for kind in KINDS:
        x = pc.as_structure(result(kind)).positions
        values = [by_openmm(files, x) for files in FILES] + [pc.energy(peptide())(x)[0]]
        assert min(np.diff(np.sort(values))) > 1.0


@pytest.mark.parametrize(
    ("kind", "call"),
    [
        *((kind, "build_chain") for kind in KINDS),
        *(("solution", call) for call in CHAINS if call != "build_chain"),
    ],
)
def test_a_result_brings_its_hinges_and_its_coordinates(kind, call):
    r = result(kind)
    made = CHAINS[call](r)
    usual = pc.build_chain(peptide()) if kind in WITHOUT_CHAIN else chain()
    assert (made.opened, made.n_hinges) == (usual.opened, usual.n_hinges)
    assert pc.ca_rmsd(peptide(), pc.pose(made, made.q0).x, pc.as_structure(r).positions) < 1e-6


@pytest.mark.parametrize("kind", KINDS)
def test_calls_on_coordinates_take_those_of_the_result(kind, tmp_path):
    r = result(kind)
    s = pc.as_structure(r)
    assert s.fingerprint == peptide().fingerprint and not np.array_equal(s.positions, peptide().positions)
    assert pc.rmsd(s, r) < 1e-6 and pc.differences(s, r).totals["ca_rmsd_angstrom"] < 1e-6
    assert np.array_equal(pc.to_mdtraj(r).xyz[0], s.positions.astype(np.float32))
    assert pc.validate(r).measures == pc.validate(s).measures
    pc.save(r, tmp_path / "r.pdb")
    pc.save(s, tmp_path / "s.pdb")
    assert np.array_equal(*(pc.load(tmp_path / name).positions for name in ("r.pdb", "s.pdb")))


def test_the_lowest_of_several_minima_is_handed_on():
    many, search = result("starts"), result("search")
    assert np.array_equal(pc.as_structure(many).positions, many.best.x)
    assert at(own(), search) == pytest.approx(search.energy, rel=RIGID_MOTION)
    assert search.energy == min(search.energies)


def ends(r):
    """Positions of the frames of a result, computed another way."""
    if hasattr(r, "solutions"):
        return [solution.x for solution in r.solutions]
    if isinstance(r, pc.Search):
        return [r.structure(number + 1).positions for number in range(len(r.q))]
    if isinstance(r, pc.Simulation):
        return [*r.to_mdtraj().xyz]
    return [*r.frames] if isinstance(r, pc.Solution) else [pc.as_structure(r).positions]


@pytest.mark.parametrize("kind", KINDS)
def test_frames_of_a_result_are_used(kind):
    """As the first argument with the energy of the result, and as frames of a structure."""
    r = result(kind)
    x = ends(r)
    table, plain = pc.frame_energies(r), pc.frame_energies(peptide(), r, energy=own())
    assert len(table) == len(x) and len(pc.to_mdtraj(peptide(), r)) == len(x)
    by_files = [by_openmm("own", positions) for positions in x]
    assert table["energy_kj_mol"].tolist() == pytest.approx(by_files, rel=RIGID_MOTION)
    assert plain["energy_kj_mol"].tolist() == table["energy_kj_mol"].tolist()


def test_structures_and_clusters_are_frames():
    several = [solution(), result("search"), peptide()]
    expected = [by_openmm("own", pc.as_structure(r).positions) for r in several]
    assert pc.frame_energies(peptide(), several, energy=own())["energy_kj_mol"].tolist() == pytest.approx(
        expected, rel=RIGID_MOTION
    )
    found = pc.cluster_frames(peptide(), several, within=0.0)
    assert len(found.frames) == len(found.medoids) == 3
    assert np.array_equal(pc.as_structure(found).positions, found.medoids[0].positions)
    assert [row.record["frame"] for row in pc.relax_frames(several[0], [peptide()], max_iterations=1)] == [0]
    with pytest.raises(pc.ProtochainError, match="the structures have different atoms; give"):
        pc.frame_energies(peptide(), [peptide(), pc.from_sequence("AG")])


def test_a_comparison_hands_on_its_lowest_end():
    k = result("comparison")
    lowest = min(k.solutions, key=lambda s: s.end.energy)
    assert pc.as_structure(k) is not k.structure
    assert np.array_equal(pc.as_structure(k).positions, lowest.x) and k.best is lowest
    again = pc.minimise(k, method="lbfgs", max_evaluations=1).start.energy
    assert again == pytest.approx(lowest.end.energy, rel=RIGID_MOTION)
    assert pc.ca_rmsd(peptide(), k, lowest) < 1e-6 < pc.ca_rmsd(peptide(), k, peptide())


def test_an_unfolded_chain_brings_its_energy():
    folded = pc.load(STRUCTURES / "5awl.pdb")
    vacuum = pc.energy(folded, solvent="vacuum", threads=1)
    path = pc.unfold(folded, vacuum, max_steps=2)
    assert pc.energy(path) is vacuum
    assert pc.frame_energies(path)["energy_kj_mol"].tolist() == pytest.approx([path.energies[-1]])


@pytest.mark.parametrize(
    "call",
    [
        pc.minimise, pc.simulate, pc.relax, pc.energy, pc.frame_energies, pc.relax_frames, pc.cluster_frames,
        pc.rmsd,
    ],
)  # fmt: skip
def test_what_has_no_structure_is_refused_with_what_to_give(call):
    changes = pc.differences(peptide(), solution())
    for wrong in (changes, changes.residues, pc.quality(solution()), [], None):
        with pytest.raises(pc.ProtochainError, match="give "):
            call(*[wrong] * (1 + (call is pc.rmsd)))


def test_the_energy_of_another_result_is_used():
    r = pc.minimise(peptide(), solution(), "lbfgs", max_evaluations=1)
    assert r.energy_function is own()


def test_what_is_named_replaces_its_part_of_the_energy_alone():
    r = solution()
    with_solvent = by_openmm("solvent", r.x)
    assert at(pc.energy(r, solvent="gbn2"), r) == pytest.approx(with_solvent, rel=RIGID_MOTION)
    assert pc.energy_terms(r, solvent="gbn2")["total"].iloc[0] == pytest.approx(
        with_solvent, rel=RIGID_MOTION
    )
    done = pc.relax(r, solvent="gbn2", max_iterations=1, max_outer_iterations=1)
    assert done.energy_start == pytest.approx(with_solvent, rel=RIGID_MOTION)
    scored = pc.score_interface(r, *PARTS, solvent="gbn2")
    assert at(scored.energy_function, r) == pytest.approx(with_solvent, rel=RIGID_MOTION)
    one = pc.relax(r, threads=1, max_iterations=1, max_outer_iterations=1).energy_function
    assert (one.forcefield, one.solvent, one.threads) == ("amber99sb", "vacuum", 1)
    assert pc.energy(r) is own()
    without = pc.minimise(chain(), pc.energy(r, terms="nonbonded"), "lbfgs", max_evaluations=1)
    again = pc.energy(without, threads=min(2, processors()))
    assert (again.threads, again.forcefield, again.solvent) == (
        min(2, processors()), "amber99sb (nonbonded)", "vacuum",
    )  # fmt: skip


def test_a_protocol_names_its_energy():
    in_solvent = pc.minimise(chain(), other(), "lbfgs", max_evaluations=2)
    done = pc.relax(in_solvent, protocol="alphafold", max_iterations=1, max_outer_iterations=1)
    assert done.energy_start == pytest.approx(by_openmm("own", in_solvent.x), rel=RIGID_MOTION)


def test_an_energy_without_names_is_brought_too():
    """A System, a callable, and the energy of frames that another process relaxed."""
    system = context("other")[1]
    r = pc.minimise(chain(), pc.energy(peptide(), system=system, threads=1), "lbfgs", max_evaluations=2)
    expected = pytest.approx(by_openmm("other", r.x), rel=RIGID_MOTION)
    assert pc.energy_terms(r)["total"].iloc[0] == expected
    assert at(pc.energy(r, threads=2), r) == expected
    assert pc.relax(r, threads=2, max_iterations=1, max_outer_iterations=1).energy_start == expected
    assert at(pc.energy(r, "amber99sb", "vacuum"), r) == pytest.approx(
        by_openmm("own", r.x), rel=RIGID_MOTION
    )
    pulled = pc.minimise(chain(), springs, "lbfgs", max_evaluations=2)
    more = pc.minimise(pulled, method="lbfgs", max_evaluations=2)
    assert isinstance(more.energy_function, CustomEnergy)
    assert more.start.energy == pytest.approx(springs(pulled.x)[0], rel=RIGID_MOTION)
    done = pc.relax(pulled, threads=2, max_iterations=1, max_outer_iterations=1)
    assert done.judge == NAMES["custom"] and done.energy_start == pytest.approx(springs(pulled.x)[0])
    with pytest.raises(pc.ProtochainError, match="told by the native engine alone"):
        pc.energy_terms(pulled)


@pytest.mark.usefixtures("worker_processes")
def test_frames_of_other_processes_bring_their_energy():
    frame = frames(solution(), workers=1)
    expected = by_openmm("own", frame.structure.positions)
    assert pc.energy_terms(frame)["total"].iloc[0] == pytest.approx(expected, rel=RIGID_MOTION)


def test_restraints_belong_to_a_run_and_not_to_its_result():
    held = result("held")
    assert held.restraints[1] > 0.0
    free = pc.minimise(held, method="lbfgs", max_evaluations=60)
    assert free.restraints is None and free.hold != held.hold
    assert free.end.energy < held.end.energy - 1.0


def test_what_may_move_and_the_masses_are_brought():
    part = pc.build_chain(peptide(), HINGES, move="resid 2:3", hydrogen_mass=3.0)
    r = pc.minimise(part, own(), "lbfgs", max_evaluations=2)
    made = pc.build_chain(r)
    assert (made.opened, made.move, made.hydrogen_mass) == (HINGES, "resid 2:3", 3.0)
    assert pc.build_chain(r, "phi", move="all").n_hinges == pc.build_chain(peptide(), "phi").n_hinges
    done = pc.relax(r, max_iterations=3, max_outer_iterations=1)
    still = ~part.moving
    assert done.move == "resid 2:3" and still.any()
    assert np.array_equal(done.x[still], r.x[still]) and not np.array_equal(done.x, r.x)
    assert pc.minimise(done, method="lbfgs", max_evaluations=1).chain.move == "resid 2:3"
    everything = pc.relax(r, move="all", max_iterations=3, max_outer_iterations=1)
    assert everything.n_atoms_moving == peptide().n_atoms


def test_the_root_of_a_search_is_no_property_of_its_result():
    """A search needs none that moves; what follows frees it as for any chain."""
    assert pc.simulate(result("search"), n_steps=1, every=1).chain.root == "free"
    fixed = pc.search(pc.build_chain(peptide(), HINGES, "fixed"), own(), "hopping", evaluations=1)
    assert pc.simulate(fixed, n_steps=1, every=1).chain.root == "fixed"


def test_an_energy_of_other_atoms_is_refused():
    with pytest.raises(pc.ProtochainError, match="built for other atoms"):
        pc.minimise(solution(), pc.energy(pc.from_sequence("AAAA")))


def test_trust_in_one_file_is_none_in_another():
    trusted = pc.minimise(chain(), pc.energy(peptide(), trust_forcefield=True), "lbfgs", max_evaluations=1)
    assert pc.energy(trusted, solvent="vacuum").settings["trust_forcefield"] is True
    assert pc.energy(trusted, forcefield="amber99sb").settings["trust_forcefield"] is False
