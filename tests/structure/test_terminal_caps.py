"""Acetyl and methylamide caps in place of charged ends of chains."""

from itertools import pairwise

import gemmi
import mdtraj
import numpy as np
import openmm
import pytest
from fixtures.command_line import run
from fixtures.refusals import expect_refusal
from fixtures.samples import STRUCTURES, load, shared
from fixtures.tolerances import CAP_ANGLE_RAD, CAP_BOND_NM, CAP_PLACE_NM, PDB_NM, PDB_ROUNDING_NM, READ_AGAIN
from openmm import app, unit

import protochain as pc
from protochain.core.arrays import dihedral
from protochain.structure.ensemble import Ensemble
from protochain.structure.formats.frames import open_frames
from protochain.structure.molecule.chirality import with_mirror_images
from protochain.structure.molecule.repairs import Kind
from protochain.structure.select import select
from protochain.structure.substitute import substitute

FORCE_FIELD = app.ForceField("amber14/protein.ff14SB.xml")
UBIQUITIN = STRUCTURES / "1ubq.pdb"


def cut(path, *absent, source=UBIQUITIN, records=("SEQRES",)):
    """Ubiquitin without some residues, and by default without its sequence."""
    lines = source.read_text().splitlines(keepends=True)
    kept = [
        line
        for line in lines
        if not line.startswith(records) and not (line[:4] == "ATOM" and int(line[22:26]) in absent)
    ]
    path.write_text("".join(kept))
    return path


def labels(s):
    return [f"{r.name}{r.id}{r.insertionCode.strip()}" for r in s.topology.residues()]


def caps(s):
    return [name for name in labels(s) if name[:3] in ("ACE", "NME")]


def kinds(s, *wanted):
    return [r.kind for r in s.repairs if r.kind in wanted]


def place(s, label, name):
    r = labels(s).index(label)
    return s.positions[(s.atom_residue == r) & (s.atom_name == name)][0]


def system(s):
    return FORCE_FIELD.createSystem(s.topology, nonbondedMethod=app.NoCutoff)


def charges(s):
    made = system(s)
    (force,) = (f for f in made.getForces() if isinstance(f, openmm.NonbondedForce))
    return np.array([force.getParticleParameters(k)[0]._value for k in range(s.n_atoms)])


def energy_of_openmm(s):
    context = openmm.Context(
        system(s), openmm.VerletIntegrator(0.001), openmm.Platform.getPlatformByName("Reference")
    )
    context.setPositions(s.positions * unit.nanometer)
    return context.getState(getEnergy=True).getPotentialEnergy()._value


def assert_ideal(s):
    """Lengths, angles and planes at caps are those of the force field."""
    x, built = s.positions, np.isin(s.residue_name[s.atom_residue], ["ACE", "NME"])
    made = system(s)
    bonds, angles, torsions = (
        next(f for f in made.getForces() if isinstance(f, kind))
        for kind in (openmm.HarmonicBondForce, openmm.HarmonicAngleForce, openmm.PeriodicTorsionForce)
    )
    n = 0
    for k in range(bonds.getNumBonds()):
        i, j, length, _ = bonds.getBondParameters(k)
        if built[[i, j]].any():
            n += 1
            assert np.linalg.norm(x[i] - x[j]) == pytest.approx(length._value, abs=CAP_BOND_NM)
    assert n >= 6
    for k in range(angles.getNumAngles()):
        i, j, m, angle, _ = angles.getAngleParameters(k)
        u, v = x[i] - x[j], x[m] - x[j]
        if built[[i, j, m]].any():
            bend = np.arccos(u @ v / np.linalg.norm(u) / np.linalg.norm(v))
            assert bend == pytest.approx(angle._value, abs=CAP_ANGLE_RAD), s.describe(j)
    for k in range(torsions.getNumTorsions()):
        *atoms, _, _, _ = torsions.getTorsionParameters(k)
        if built[atoms].any() and s.atom_name[atoms[1]] == "C" and s.atom_name[atoms[2]] == "N":
            bend = abs(np.sin(float(dihedral(*x[atoms]))))
            assert bend < np.sin(CAP_ANGLE_RAD), [s.describe(a) for a in atoms]


def assert_apart(s):
    """Heavy atoms of caps do not lie on others."""
    heavy = np.flatnonzero(s.atom_element != "H")
    of_cap = heavy[np.isin(s.residue_name[s.atom_residue[heavy]], ["ACE", "NME"])]
    for k in of_cap.tolist():
        near = {k, *s.neighbours[k], *(j for i in s.neighbours[k] for j in s.neighbours[i])}
        far = heavy[~np.isin(heavy, [*near])]
        assert np.linalg.norm(s.positions[far] - s.positions[k], axis=1).min() > 0.19, s.describe(k)


@pytest.mark.parametrize(
    ("absent", "expected"),
    [
        ((16, 17, 18), ["NME16", "ACE18"]),  # Before proline 19.
        ((36,), ["NME35A", "ACE36"]),  # Between glycine 35 and proline 37.
        ((20, 21, 51, 52), ["NME20", "ACE21", "NME51", "ACE52"]),
    ],
)
def test_caps_at_breaks_are_where_the_chain_was(absent, expected, tmp_path):
    whole, path = load("1ubq.pdb"), cut(tmp_path / "cut.pdb", *absent)
    s, charged = pc.load(path, cap="breaks"), pc.load(path)
    assert caps(s) == expected and not caps(charged)
    assert kinds(s, Kind.GAP) == [] and len(kinds(charged, Kind.GAP)) == len(expected) // 2
    r = labels(s).index(expected[0])
    assert s.b_factor[s.atom_residue == r][0] == s.b_factor[s.atom_residue == r - 1][0] > 0.0
    built = {str(r.facts["residue"]) for r in s.repairs if r.kind is Kind.CAP_AT_BREAK}
    assert built == {f"A:{cap}" for cap in expected}
    assert_ideal(s)
    assert_apart(s)
    # An acetyl follows the ring of proline. A methylamide without room next to it turns.
    if absent == (36,):
        assert kinds(s, Kind.OXYGEN_TURNED)
        assert np.linalg.norm(place(s, "ACE36", "CH3") - place(whole, "ILE36", "CA")) < CAP_PLACE_NM
        return
    # The methylamide is opposite to the oxygen.
    last = labels(whole)[labels(whole).index(labels(s)[labels(s).index(expected[0]) - 1]) + 1]
    for name, of in (("N", "N"), ("C", "CA")):
        assert np.linalg.norm(place(s, expected[0], name) - place(whole, last, of)) < CAP_PLACE_NM
    if absent[0] == 16:
        for name, of in (("C", "C"), ("O", "O"), ("CH3", "CA")):
            assert np.linalg.norm(place(s, "ACE18", name) - place(whole, "GLU18", of)) < CAP_PLACE_NM


def test_capped_ends_have_no_charge_and_their_energy_is_that_of_openmm(tmp_path):
    path = cut(tmp_path / "cut.pdb", 16, 17, 18, 36)
    s, charged = pc.load(path, cap="breaks"), pc.load(path)
    q = charges(s)
    assert q.sum() == pytest.approx(round(q.sum()), abs=1e-6) and q.sum() == pytest.approx(
        charges(charged).sum()
    )
    for r in range(s.n_residues):
        if labels(s)[r] in ("NME16", "ACE18", "NME35A", "ACE36", "LEU15", "PRO19", "GLY35", "PRO37"):
            assert q[s.atom_residue == r].sum() == pytest.approx(0.0, abs=1e-6)
    value = pc.energy(s, solvent="vacuum", engine="native")(s.positions)[0]
    assert value == pytest.approx(energy_of_openmm(s), rel=READ_AGAIN)


@pytest.mark.parametrize(
    "name", ["1bhl_gap_cas.pdb", pytest.param("6lfo_gap_model.pdb", marks=pytest.mark.slow)]
)
def test_breaks_of_crystals_and_models_get_caps_that_survive_a_file(name, tmp_path):
    s = pc.load(shared(name), cap="breaks")
    gaps = kinds(pc.load(shared(name)), Kind.GAP)
    assert len(caps(s)) == 2 * len(gaps) and not kinds(s, Kind.GAP, Kind.NOT_CAPPED)
    assert charges(s).sum() == pytest.approx(round(charges(s).sum()), abs=1e-5)
    assert_ideal(s)
    energy = pc.energy(s, solvent="vacuum")
    for suffix, error in ((".pdb", 1.1 * PDB_ROUNDING_NM), (".cif", 1e-7)):
        pc.save(s, tmp_path / f"s{suffix}")
        again = pc.load(tmp_path / f"s{suffix}")
        assert labels(again) == labels(s) and np.abs(again.positions - s.positions).max() < error
        value = pc.energy(again, solvent="vacuum")(again.positions)[0]
        assert value == pytest.approx(energy(again.positions)[0], rel=READ_AGAIN)
        # A file with caps has no ends that are charged at its breaks.
        second = pc.load(tmp_path / f"s{suffix}", cap="breaks")
        assert second.fingerprint == again.fingerprint and np.array_equal(second.positions, again.positions)


def test_the_sequence_of_the_file_stays_and_caps_have_numbers_in_mmcif(tmp_path):
    source = shared("1ubq_ubiquitin.pdb")
    s = pc.load(cut(tmp_path / "cut.pdb", 20, 21, 22, 36, source=source, records=("HELIX",)), cap="breaks")
    pc.save(s, tmp_path / "s.pdb")
    texts = [path.read_text().splitlines() for path in (source, tmp_path / "s.pdb")]
    before, after = ([line.rstrip() for line in text if line[:6] == "SEQRES"] for text in texts)
    assert before and before == after and len(caps(s)) == 4
    source = STRUCTURES / "1ubq.cif"
    model = gemmi.read_structure(str(source))
    for i in reversed(range(len(model[0][0]))):
        if model[0][0][i].seqid.num in (20, 21, 22):
            del model[0][0][i]
    model.make_mmcif_document().write_file(str(tmp_path / "cut.cif"))
    s = pc.load(tmp_path / "cut.cif", cap="breaks")
    pc.save(s, tmp_path / "s.cif")
    written = gemmi.read_structure(str(tmp_path / "s.cif"))
    (entity,) = (e for e in written.entities if e.entity_type == gemmi.EntityType.Polymer)
    assert len(entity.full_sequence) == 76
    numbers = [r.label_seq for r in written[0][0]]
    assert None not in numbers and all(a < b for a, b in pairwise(numbers))
    assert [str(r.seqid) for r in written[0][0] if r.name in ("ACE", "NME")] == ["20", "22"]


def test_caps_next_to_insertion_codes_have_numbers_in_the_order_of_the_chain(tmp_path):
    """As in loops of antibodies: residues 30 to 45 are 29A to 29P, and 46 and later have lower numbers."""

    def renumber(line):
        n = int(line[22:26]) if line[:4] == "ATOM" else 0
        label = f"  29{chr(ord('A') + n - 30)}" if 30 <= n <= 45 else f"{n - 16:4d} "
        return line[:22] + label + line[27:] if n >= 30 else line

    for absent, expected in (
        ((34, 35, 38, 39, 40, 46, 47), ["NME29E", "ACE29F", "NME29I", "ACE29K", "NME30", "ACE31"]),
        ((30, 31, 32), ["NME29A", "ACE29C"]),
        ((29, 30, 31), ["NME29", "ACE29B"]),
    ):
        path = cut(tmp_path / "cut.pdb", *absent)
        path.write_text("".join(map(renumber, path.read_text().splitlines(keepends=True))))
        s = pc.load(path, cap="breaks")
        assert caps(s) == expected
        order = [(int(r.id), r.insertionCode.strip()) for r in s.topology.residues()]
        assert all(a < b for a, b in pairwise(order))


def test_a_break_at_a_residue_alone_has_no_charged_termini(tmp_path):
    s = pc.load(cut(tmp_path / "cut.pdb", 15, 16, 18, 19), cap="breaks")
    assert caps(s) == ["NME15", "ACE19"] and not kinds(s, Kind.GAP)
    # The residue before aspartate 39 is missing, and an acetyl has no room there.
    charged = pc.load(cut(tmp_path / "cut.pdb", 38), cap="breaks")
    assert caps(charged) == ["NME38"] and len(kinds(charged, Kind.GAP, Kind.NOT_CAPPED)) == 2


def test_a_force_field_without_caps_is_refused_with_the_option(tmp_path):
    s = pc.load(cut(tmp_path / "cut.pdb", 16, 17, 18), cap="breaks")
    with expect_refusal("cap", match='charmm36.*cap="none"'):
        pc.energy(s, "charmm36")


def test_ends_are_capped_unless_the_sequence_of_the_file_ends_there(tmp_path):
    assert caps(pc.load(STRUCTURES / "ala10.pdb", cap="ends")) == ["ACE0", "NME11"]
    stated = pc.load(STRUCTURES / "4pti.pdb", cap="ends")
    assert not caps(stated) and len(kinds(stated, Kind.NOT_CAPPED)) == 2
    assert caps(pc.load(STRUCTURES / "4pti.pdb", cap="all")) == ["ACE0", "NME59"]
    # Of a shorter model the sequence goes on. Its break is not an end.
    source = shared("1ubq_ubiquitin.pdb")
    short = cut(tmp_path / "cut.pdb", 1, 2, 30, 31, *range(72, 77), source=source, records=("HELIX",))
    assert caps(pc.load(short, cap="ends")) == ["ACE2", "NME72"]
    assert caps(pc.load(short, cap="breaks")) == ["NME30", "ACE31"]
    assert caps(pc.load(short, cap="all")) == ["ACE2", "NME30", "ACE31", "NME72"]


def test_ends_with_hydrogens_get_caps_without_the_charged_atoms():
    s = pc.load(STRUCTURES / "1l2y.pdb", cap="all")  # NMR: H1, H2, H3 and OXT.
    names = [set(s.atom_name[s.atom_residue == r].tolist()) for r in (1, 20)]
    assert not {"H1", "H2", "H3", "OXT"} & (names[0] | names[1]) and "H" in names[0]
    assert not s.losses and caps(s) == ["ACE0", "NME21"]
    assert_ideal(s)


@pytest.mark.parametrize(
    "name",
    ["5vav_cyclic.pdb", "1grm_gramicidin.pdb", "ala_dipeptide.pdb", "aaqaa3_capped.pdb"],
)
def test_rings_and_ends_with_caps_or_modified_residues_get_none(name):
    s, before = pc.load(shared(name), cap="all"), pc.load(shared(name))
    assert s.fingerprint == before.fingerprint and np.array_equal(s.positions, before.positions)


def test_other_bonds_of_an_end_and_nucleotides_are_not_capped(tmp_path):
    assert caps(pc.load(shared("2n0n_lactam.pdb"), cap="all")) == ["ACE0"]
    # Lysine 5 has the lactam.
    lines = cut(path := tmp_path / "cut.pdb", 1, 3, 4, source=shared("2n0n_lactam.pdb")).read_text()
    path.write_text("".join(line for line in lines.splitlines(True) if line[17:26] != "AIB A   2"))
    s = pc.load(path, cap="all")
    assert not caps(s) and kinds(s, Kind.NOT_CAPPED)
    s = pc.load(STRUCTURES / "1ysa.pdb", cap="all")
    assert caps(s) == ["ACE224", "NME282", "ACE223", "NME281"]
    assert set(s.residue_chain[np.isin(s.residue_name, ["ACE", "NME"])].tolist()) == {"C", "D"}


@pytest.mark.parametrize(
    ("number", "name", "absent", "expected"),
    [(76, "OXT", 20, ["ACE0"]), (35, "O", 36, ["ACE0", "ACE36", "NME77"])],
)
def test_the_oxygen_of_a_metal_stays(number, name, absent, expected, tmp_path):
    """Without zinc glycine 35 gets a methylamide, for which its oxygen turns."""
    path = cut(tmp_path / "cut.pdb", absent)
    last = next(r for r in gemmi.read_structure(str(path))[0][0] if r.seqid.num == number)
    oxygen, carbon = last[name][0].pos, last["C"][0].pos
    zinc = oxygen + (oxygen - carbon) * (2.1 / oxygen.dist(carbon))
    ion = "HETATM 9000 ZN    ZN A 200    " + "".join(f"{value:8.3f}" for value in zinc.tolist())
    path.write_text(path.read_text().replace("MASTER", f"{ion}  1.00 10.00          ZN\nMASTER"))
    s = pc.load(path, cap="all")
    assert [cap for cap in caps(s) if cap[3:] not in ("20", "21")] == expected
    assert place(s, f"GLY{number}", name) == pytest.approx(np.array(oxygen.tolist()) / 10.0, abs=1e-6)


def test_a_mirror_image_gets_mirror_images_of_the_caps(tmp_path):
    """Also of an end whose oxygen turns."""
    path = cut(tmp_path / "cut.pdb", 10, 11, 12, 16, 17, 18, 36)
    s = with_mirror_images(pc.load(path))
    mirrored = with_mirror_images(s.with_positions(s.positions * [1, 1, -1]))
    pc.save(mirrored, tmp_path / "d.cif", hydrogens=False)
    text = (tmp_path / "d.cif").read_text().splitlines(keepends=True)
    (tmp_path / "d.cif").write_text("".join(line for line in text if " OXT " not in line))
    d, original = pc.load(tmp_path / "d.cif", cap="all"), pc.load(path, cap="all")
    assert d.mirrored.any() and labels(d) == labels(original)
    for label in caps(original):
        for name in ("C", "O", "CH3") if label[:3] == "ACE" else ("N", "C"):
            assert place(d, label, name) * [1, 1, -1] == pytest.approx(place(original, label, name), abs=2e-5)


@pytest.mark.slow
def test_an_oxygen_turns_if_its_cap_has_no_room_and_acetyls_avoid_the_rest(tmp_path):
    """The neighbour stands in the way of the methylamide, one residue further."""
    s = pc.load(shared("1r19_poor_1176.pdb"), chains="A", cap="breaks")
    turned = [str(r.facts["residue"]) for r in s.repairs if r.kind is Kind.OXYGEN_TURNED]
    assert turned and not kinds(s, Kind.NOT_CAPPED, Kind.GAP)
    assert_ideal(s)
    assert_apart(s)


def test_mutations_and_rebuilt_side_chains_keep_the_caps(tmp_path):
    path = cut(tmp_path / "cut.pdb", 16, 17, 18)
    s = pc.load(path, cap="all")
    mutant = substitute(s, {labels(s).index("LEU15"): "VAL"})
    assert caps(mutant) == caps(s) and "VAL15" in labels(mutant)
    rebuilt = pc.Setup(cap="all", rebuild_side_chains="all").load(path)
    assert labels(rebuilt) == labels(s)
    assert [str(r) for r in rebuilt.repairs][: len(s.repairs)] == [str(r) for r in s.repairs]
    backbone = np.isin(s.atom_name, ["N", "CA", "C", "O", "CH3"])
    again = np.isin(rebuilt.atom_name, ["N", "CA", "C", "O", "CH3"])
    assert np.array_equal(rebuilt.positions[again], s.positions[backbone])


def test_frames_without_caps_get_them(tmp_path):
    path = cut(tmp_path / "cut.pdb", 16, 17, 18, records=("HELIX",))
    mdtraj.load(path).save_dcd(tmp_path / "cut.dcd")
    s = pc.load(path, cap="breaks")
    frames = open_frames(tmp_path / "cut.dcd", None)
    frame = Ensemble.of(s, frames, {"cap": "breaks"}).at(next(iter(frames)))
    assert frame.fingerprint == s.fingerprint
    # Glutamine 49 is flipped in the structure, and not in frames of the file.
    is_other = (s.residue_number == "49")[s.atom_residue]
    assert frame.positions[~is_other] == pytest.approx(s.positions[~is_other], abs=PDB_NM)
    lengths = np.linalg.norm(np.diff(frame.positions[frame.bonds], axis=1), axis=-1)
    assert lengths.max() < 0.2
    row = pc.frame_energies(path, tmp_path / "cut.dcd", cap="breaks", solvent="vacuum").iloc[0]
    expected = pc.energy(s, solvent="vacuum")(frame.positions)[0]
    assert row["energy_kj_mol"] == pytest.approx(expected, rel=READ_AGAIN)


def test_numbers_select_residues_and_commands_report_breaks(tmp_path, capsys):
    path = cut(tmp_path / "cut.pdb", 16, 17, 18)
    assert run("info", path) in (0, None)
    shown = capsys.readouterr().out
    assert "--cap breaks caps: 1" in shown and "A:15-19" in shown
    out = tmp_path / "out.pdb"
    assert run(
        "minimise", path, "-o", out, "--cap", "breaks", "--max-evaluations", "5", "--solvent", "vacuum"
    ) in (0, 3)
    assert caps(pc.load(out)) == ["NME16", "ACE18"]
    capsys.readouterr()
    assert run("rmsd", path, out, "--json") in (0, None)
    assert select(pc.load(out), "resid 19:20").sum() == select(pc.load(path), "resid 19:20").sum() - 2


def test_an_unknown_place_of_caps_is_refused():
    with pytest.raises(pc.ProtochainError, match="'end' is not known; choose from"):
        pc.load(UBIQUITIN, cap="end")
