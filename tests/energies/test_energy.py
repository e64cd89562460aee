import ast
import csv
import inspect
import os
import subprocess
import sys
from functools import partial
from xml.etree import ElementTree

import numpy as np
import openmm
import pytest
from fixtures.refusals import expect_refusal
from fixtures.samples import ROOT, STRUCTURES, chain, energy, load
from fixtures.tolerances import SAME_KERNEL
from openmm import app

import protochain as pc
from protochain.energies import as_energy, factory, untrusted
from protochain.energies.custom import CustomEnergy, check_forces
from protochain.structure.molecule.templates import _amber


def by_the_force_field(name, *files):
    """What OpenMM alone makes of the same topology."""
    system = app.ForceField(*files).createSystem(load(name).topology, nonbondedMethod=app.NoCutoff)
    return pc.energy(load(name), system=system).reference


@pytest.mark.parametrize("name", ["1l2y.pdb", "3i40.pdb"])
def test_gbsa_obc_equals_the_custom_force_it_replaces(name):
    e = energy(name).reference
    assert any(isinstance(force, openmm.GBSAOBCForce) for force in e.system.getForces())
    assert "GBSAOBCForce" in e.reason
    custom = by_the_force_field(name, "amber14/protein.ff14SB.xml", "implicit/obc2.xml")
    x = load(name).positions
    (ours, f), (theirs, g) = e(x), custom(x)
    assert ours == pytest.approx(theirs, rel=SAME_KERNEL)
    assert np.linalg.norm(f - g) < SAME_KERNEL * np.linalg.norm(g)


@pytest.mark.parametrize(("solvent", "files"), [("vacuum", ()), ("gbn2", ("implicit/gbn2.xml",))])
def test_other_solvents_are_openmms_own(solvent, files):
    x = load("1l2y.pdb").positions
    ours, _ = energy("1l2y.pdb", solvent=solvent).reference(x)
    theirs, _ = by_the_force_field("1l2y.pdb", "amber14/protein.ff14SB.xml", *files)(x)
    # The same forces through the same library: only round-off may differ.
    assert ours == pytest.approx(theirs, rel=1e-12)


@pytest.mark.slow
def test_a_system_is_the_same_in_every_process():
    """OpenMM numbers the types of a table of pairs in the order of a set of text."""
    code = (
        "import sys, protochain as pc\n"
        "e = pc.energy(pc.load(sys.argv[1]), 'charmm36', 'vacuum', engine='openmm')\n"
        "print(e.fingerprint, e.reference(pc.load(sys.argv[1]).positions)[0])"
    )
    found = {
        subprocess.run(
            [sys.executable, "-c", code, str(STRUCTURES / "ala10.pdb")], capture_output=True, text=True,
            check=True, env={**os.environ, "PYTHONPATH": str(ROOT), "PYTHONHASHSEED": seed},
        ).stdout
        for seed in ("1", "2")
    }  # fmt: skip
    assert len(found) == 1


def test_types_of_a_table_are_numbered_by_the_atoms():
    """However they were numbered, the System is the same, with the same coefficient of each pair."""
    table = np.array([[1.0, 2.0, 3.0], [2.0, 5.0, 6.0], [3.0, 6.0, 9.0]])
    texts = set()
    for order in ([0, 1, 2], [2, 0, 1], [1, 0, 2]):
        force = openmm.CustomNonbondedForce("acoef(type1, type2)/r^12")
        force.setName("LennardJones")
        force.addPerParticleParameter("type")
        renumbered = np.empty((3, 3))
        renumbered[np.ix_(order, order)] = table
        force.addTabulatedFunction("acoef", openmm.Discrete2DFunction(3, 3, renumbered.ravel()))
        system = openmm.System()
        for kind in (1, 0, 1, 2):
            system.addParticle(1.0)
            force.addParticle([order[kind]])
        system.addForce(force)
        factory._number_types(system)
        texts.add(openmm.XmlSerializer.serialize(system))
    assert len(texts) == 1
    own = force.getTabulatedFunction(0).getFunctionParameters()
    assert np.reshape(own[2], (3, 3)).tolist() == table[np.ix_([1, 0, 2], [1, 0, 2])].tolist()
    assert [force.getParticleParameters(i) for i in range(4)] == [(0.0,), (1.0,), (0.0,), (2.0,)]


def test_numbering_the_types_of_a_table_changes_no_energy():
    s = load("ala10.pdb")
    value, forces = pc.energy(s, "charmm36", "vacuum").reference(s.positions)
    true, exact = by_the_force_field("ala10.pdb", "charmm36.xml")(s.positions)
    assert value == pytest.approx(true, rel=1e-12) and np.allclose(forces, exact, rtol=0, atol=1e-8)


@pytest.mark.parametrize("forcefield", ["amber14", "amber19", "amber99sb", "amber99sbildn", "charmm36"])
def test_every_named_force_field_takes_every_standard_residue(forcefield):
    s = pc.from_sequence("ACDEFGHIKLMNPQRSTVWY")
    value, forces = pc.energy(s, forcefield=forcefield, solvent="vacuum").reference(s.positions)
    assert np.isfinite(value) and np.isfinite(forces).all()


def test_any_system_can_be_used_and_is_copied():
    s = load("ala10.pdb")
    system = app.ForceField("amber14/protein.ff14SB.xml").createSystem(s.topology)
    e = pc.energy(s, system=system)
    before, _ = e.reference(s.positions)
    while system.getNumForces():
        system.removeForce(0)
    assert e.reference(s.positions)[0] == before
    with pytest.raises(pc.ProtochainError, match="3 particles but"):
        small = openmm.System()
        for _ in range(3):
            small.addParticle(1.0)
        pc.energy(s, system=small)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"solvent": "water"}, "solvent 'water' is not known"),
        ({"engine": "warp"}, "engine 'warp' is not known"),
        ({"forcefield": "amber99999"}, "not found"),
        ({"forcefield": "../amber14-all.xml"}, "not found"),
        ({"threads": 0}, "at least 1"),
    ],
)
def test_unknown_names_are_refused(options, word):
    with pytest.raises(pc.ProtochainError, match=word):
        pc.energy(load("ala10.pdb"), **options)


def test_a_force_field_without_the_residue_says_which(tmp_path):
    path = tmp_path / "small.xml"
    path.write_text("<ForceField><AtomTypes/><Residues/></ForceField>")
    with pytest.raises(pc.ProtochainError, match=r"does not fit: No template found for residue 0 \(ALA\)"):
        pc.energy(load("ala10.pdb"), forcefield=str(path), solvent="vacuum")


def _force_field_with(tag, attribute, mark):
    """Text of ff14SB with a part that would make a file if it ran."""
    root = ElementTree.parse(factory.DATA / "amber14" / "protein.ff14SB.xml").getroot()
    node = next(root.iter(tag), None)
    node = ElementTree.SubElement(root, tag) if node is None else node
    run = f"open({str(mark)!r}, 'w')"
    if attribute:
        node.set(attribute, run)
    else:
        node.text = run
    return ElementTree.tostring(root, encoding="unicode")


@pytest.mark.parametrize(
    ("tag", "attribute"),
    [
        ("Script", ""), ("InitializationScript", ""), ("Include", "file"), ("Bond", "k"),
        ("Type", "mass"),
        ("NonbondedForce", "useDispersionCorrection"), ("LennardJonesForce", "useDispersionCorrection"),
    ],
)  # fmt: skip
def test_a_force_field_that_would_run_code_is_refused_unrun(tag, attribute, tmp_path):
    mark = tmp_path / "ran"
    path = tmp_path / "evil.xml"
    path.write_text(_force_field_with(tag, attribute, mark))
    with pytest.raises(pc.ProtochainError, match=f"<{tag}>.* with trust_forcefield=True$"):
        pc.energy(load("ala10.pdb"), forcefield=str(path), solvent="vacuum")
    assert not mark.exists()


@pytest.mark.parametrize("value", ["exit", "true", "1 if x else 0"])
def test_what_openmm_evaluates_is_a_boolean_and_not_just_a_name(value, tmp_path):
    root = ElementTree.fromstring(
        f'<ForceField><NonbondedForce useDispersionCorrection="{value}"/></ForceField>'
    )
    with expect_refusal("trust_forcefield", match="True or False"):
        untrusted.check_passive(tmp_path, root)


DOUBLING = ";".join(["a0", *(f"a{i}=a{i + 1}*a{i + 1}" for i in range(19)), "a19=r"])


@pytest.mark.parametrize(
    "text",
    ["(" * 20000 + "r" + ")" * 20000, "r+" * 40000 + "r", DOUBLING, "r^" * 100 + "r", "foo(r)", "k*(r"],
    ids=["deep", "long", "doubling", "powers", "function", "brackets"],
)  # fmt: skip
def test_an_expression_that_openmm_would_not_end_with_or_refuse_is_one_line(text, tmp_path):
    path = tmp_path / "own.xml"
    bond = '<PerBondParameter name="k"/><Bond class1="CX" class2="C" k="1"/>'
    bond += '<Bond type1="protein-CX" type2="protein-C" k="1"/>'
    path.write_text(f'<ForceField><CustomBondForce energy="{text}">{bond}</CustomBondForce></ForceField>')
    structure = load("ala10.pdb")
    with pytest.raises(pc.ProtochainError, match=r"own\.xml") as refused:
        pc.energy(structure, forcefield=f"amber14,{path}", solvent="vacuum")(structure.positions)
    assert "\n" not in str(refused.value) and len(str(refused.value)) < 400


def test_the_longest_expressions_of_implicit_solvents_are_computed(tmp_path):
    radii = "select(step(r+sr2-or1), 0.5*(1/L-1/U+0.25*(r-sr2^2/r)*(1/(U^2)-1/(L^2))+0.5*log(L/U)/r), 0)"
    text = f"{radii};U=r+sr2;L=max(or1, D);D=abs(r-sr2)"
    untrusted.check_expressions(tmp_path, ElementTree.fromstring(
        f"<ForceField><CustomGBForce><ComputedValue>{text}</ComputedValue></CustomGBForce></ForceField>"
    ))  # fmt: skip


def test_openmm_evaluates_nothing_but_what_is_listed():
    """A new ``eval`` or ``exec`` in OpenMM's reader must be looked at before it is allowed."""
    tree = ast.parse(inspect.getsource(app.forcefield))
    calls = [
        ast.unparse(node.args[0])
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("eval", "exec", "compile")
    ]
    evaluated = [f"element.attrib.get({name!r})" for name in untrusted.EVALUATED]
    assert {*calls} == {*evaluated, "node.text", "script"}


@pytest.mark.parametrize("name", ["amber14/protein.ff14SB.xml", "charmm36.xml"])
def test_only_scripts_keep_openmms_own_files_from_being_passive(name, tmp_path):
    root = ElementTree.parse(factory.DATA / name).getroot()
    for node in [node for node in root if node.tag in untrusted.ACTIVE]:
        root.remove(node)
    untrusted.check_passive(tmp_path, root)


def test_a_trusted_script_runs(tmp_path):
    path = tmp_path / "ff.xml"
    original = (factory.Path(app.__file__).parent / "data" / "amber14" / "protein.ff14SB.xml").read_text()
    path.write_text(
        original.replace("</ForceField>", "<Script>sys.addForce(openmm_force)</Script></ForceField>")
    )
    with pytest.raises(pc.ProtochainError, match="openmm_force"):
        pc.energy(load("ala10.pdb"), forcefield=str(path), solvent="vacuum", trust_forcefield=True)


def test_a_file_in_the_working_directory_never_stands_in_for_openmms_own(tmp_path, monkeypatch):
    trap = "<ForceField><Script>raise SystemExit('the trap ran')</Script></ForceField>"
    for name in ("amber14/protein.ff14SB.xml", "implicit/obc2.xml"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text(trap)
    monkeypatch.chdir(tmp_path)
    factory._bundled_force_field.cache_clear()
    _amber.cache_clear()
    fresh = pc.energy(pc.load(STRUCTURES / "ala10.pdb"))
    assert fresh.fingerprint == energy("ala10.pdb").fingerprint
    with expect_refusal("trust_forcefield", match="<Script>"):
        pc.energy(load("ala10.pdb"), forcefield="amber14/protein.ff14SB.xml")


def test_a_changed_force_field_file_is_read_again(tmp_path):
    path = tmp_path / "ff.xml"
    original = (factory.DATA / "amber14" / "protein.ff14SB.xml").read_text()
    path.write_text(original)
    s = load("ala10.pdb")
    before = pc.energy(s, forcefield=str(path), solvent="vacuum")(s.positions)[0]
    path.write_text(original.replace('coulomb14scale="0.8333333333333334"', 'coulomb14scale="0.1"'))
    after = pc.energy(s, forcefield=str(path), solvent="vacuum")(s.positions)[0]
    assert abs(after - before) > 1


def test_positions_of_another_structure_are_refused():
    with pytest.raises(pc.ProtochainError, match="shape"):
        energy("ala10.pdb")(load("1l2y.pdb").positions)


def test_the_samples_are_the_files_the_manifest_describes():
    import hashlib

    with (STRUCTURES / "MANIFEST.tsv").open() as lines:
        rows = {row["file"]: row for row in csv.DictReader(lines, delimiter="\t")}
    files = {path.name for path in STRUCTURES.iterdir()} - {"MANIFEST.tsv"}
    assert set(rows) == files
    for name, row in rows.items():
        assert hashlib.sha256((STRUCTURES / name).read_bytes()).hexdigest() == row["sha256"]
        assert row["licence"] and row["source"]


def harmonic(x):
    """Every atom on a spring to the origin, 10 kJ/mol/nm^2, as an external code may return it."""
    return np.float32(5.0 * np.sum(x**2)), (-10.0 * x).tolist()


def test_a_callable_is_an_energy_that_judges_itself():
    s = load("ala10.pdb")
    e = as_energy(harmonic, s)
    value, forces = e(s.positions)
    assert type(value) is float and value == np.float32(5.0 * np.sum(s.positions**2))
    assert forces.dtype == np.float64 and forces.flags.c_contiguous
    assert np.array_equal(forces, -10.0 * s.positions)
    assert e.reference is e and e.is_exact and e.without_constants(np.zeros((1, 1), int), forces) is e
    assert e.fingerprint == as_energy(harmonic, s).fingerprint != as_energy(partial(harmonic), s).fingerprint
    assert (e.engine, e.threads, e.atoms, e.system, dict(e.left_out)) == ("custom", 1, "", None, {})
    e.list_at(s.positions)
    assert e.lists_at is None and "judged by itself" in e.reason


def test_a_callable_cannot_change_the_positions_or_forces_of_a_run():
    kept = np.zeros((2, 3))

    def careless(x):
        x += 1.0
        kept[:] = x
        return 0.0, kept

    e, x = CustomEnergy(careless), np.zeros((2, 3))
    _, forces = e(x)
    e(x + 5.0)
    assert not x.any() and np.array_equal(forces, np.ones((2, 3)))


@pytest.mark.parametrize(
    "returned",
    [(1.0, np.zeros(30)), (1.0, "forces"), 3.0, (1.0,), (np.zeros(2), np.zeros((1, 3))), (1, 2, 3)],
)
def test_a_callable_that_returns_something_else_is_refused(returned):
    for refused in (
        lambda: CustomEnergy(lambda x: returned)(np.zeros((1, 3))),
        lambda: as_energy(lambda x: returned, load("ala10.pdb")),
        # A float was a bare TypeError, and forces of shape (3,) were taken for those of every atom.
        lambda: pc.minimise(chain("ala10.pdb"), harmonic, "lbfgs", restraints=lambda x: returned),
    ):
        with pytest.raises(
            pc.ProtochainError, match=r"^(energy|restraint) .*<lambda>: return \(energy, forces\)"
        ) as said:
            refused()
        assert "\n" not in str(said.value)


def off(wrong):
    """Springs to the origin whose forces are wrong."""
    return lambda x: (5.0 * float(np.sum(x**2)), wrong(-10.0 * x))


@pytest.mark.parametrize(
    "wrong",
    [lambda f: 0.5 * f, lambda f: -f, lambda f: 1.1 * f, lambda f: 0.0 * f, lambda f: f * (f > 0.0)],
    ids=["halved", "reversed", "a tenth too large", "none", "of some coordinates"],
)
def test_forces_that_are_not_of_the_energy_are_refused(wrong):
    """With halved forces a run ended as converged."""
    s = load("ala10.pdb")
    said = r"energy .*<lambda>: its forces are not those of its energy, whose slope .* is -?[\d.e+]+ kJ"
    with pytest.raises(pc.ProtochainError, match=said):
        as_energy(off(wrong), s)
    with pytest.raises(pc.ProtochainError, match=said.replace("energy", "restraint", 1)):
        pc.minimise(chain("ala10.pdb"), energy("ala10.pdb"), "lbfgs", restraints=off(wrong))
    # Springs to the start pull at nothing there.
    home = s.positions
    with pytest.raises(pc.ProtochainError, match="its forces are not those"):
        as_energy(lambda x: off(wrong)(x - home), s)


def test_right_forces_pass_in_single_precision_with_large_constants_and_near_overlaps():
    s = load("ala10.pdb")
    exact = energy("ala10.pdb")
    near = s.with_positions(0.8 * s.positions)
    for given in (
        lambda x: (np.float32(exact(x)[0] - 1e6), exact(x)[1].astype(np.float32)),
        lambda x: (3.0, 0.0 * x),
        lambda x: (np.nan, 0.0 * x),
        lambda x: (1.0, np.inf * np.ones_like(x)),
        energy("ala10.pdb", engine="openmm"),
    ):
        for start in (s, near):
            check_forces(given, start.positions, "given")


def test_an_energy_is_built_kept_or_refused():
    s = load("ala10.pdb")
    assert as_energy(None, s).fingerprint == energy("ala10.pdb").fingerprint
    assert as_energy(energy("ala10.pdb"), s) is energy("ala10.pdb")
    with pytest.raises(pc.ProtochainError, match="built for other atoms"):
        as_energy(energy("1l2y.pdb"), s)
    with pytest.raises(pc.ProtochainError, match="energy 'amber14': give"):
        as_energy("amber14", s)


def test_nonbonded_terms_are_those_of_openmm_without_its_torsions():
    """What is left out is the energy of OpenMM's torsion forces, and nothing else."""
    structure = pc.load(STRUCTURES / "1l2y.pdb")
    for solvent in ("vacuum", "obc2"):
        whole = pc.energy(structure, solvent=solvent)
        less = pc.energy(structure, solvent=solvent, terms="nonbonded")
        names = {type(force).__name__ for force in whole.system.getForces()}
        left = {type(force).__name__ for force in less.system.getForces()}
        assert names - left == {"PeriodicTorsionForce"} and left < names
        by_kind, _ = whole.reference.parts(structure.positions)
        torsions = sum(value for name, value in by_kind.items() if "Torsion" in name)
        value = less(structure.positions)[0]
        assert value == pytest.approx(whole(structure.positions)[0] - torsions, abs=1e-6)
        assert value == pytest.approx(less.reference(structure.positions)[0], abs=1e-6)
    assert "nonbonded" in less.forcefield and less.fingerprint != whole.fingerprint


def test_nonbonded_terms_are_for_methods_that_only_turn_hinges():
    structure = pc.from_sequence("AAA")
    energy = pc.energy(structure, terms="nonbonded")
    assert pc.minimise(structure, energy, "lbfgs").status == "converged"
    for method in ("cartesian", "hybrid", "openmm"):
        with pytest.raises(pc.ProtochainError, match="twist peptide bonds"):
            pc.minimise(structure, energy, method)
    with pytest.raises(pc.ProtochainError, match="twist peptide bonds"):
        pc.relax(structure, terms="nonbonded")
    with expect_refusal("terms", match="'bonded'"):
        pc.energy(structure, terms="bonded")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("forcefield", "charmm36"), ("solvent", "vacuum"), ("salt", 0.1), ("terms", "nonbonded"),
        ("cutoff", 1.0),
    ],
)  # fmt: skip
def test_an_argument_that_defines_an_energy_replaces_a_callable(name, value):
    """All others leave it as it is."""
    c = chain("ala10.pdb")
    end = pc.minimise(c, lambda x: (0.0, np.zeros_like(x)), "lbfgs", max_evaluations=2)
    assert pc.energy(end, threads=1) is end.energy_function
    made, expected = (pc.energy(source, **{name: value}) for source in (end, c))
    x = c.structure.positions
    assert made(x)[0] == expected(x)[0] != 0.0
