"""A result read again is the same system: its atoms, bonds, charges and springs, and so its energy."""

from dataclasses import replace

import numpy as np
import pytest
from fixtures.samples import MORE_STRUCTURES, load, shared
from fixtures.tolerances import READ_AGAIN

import protochain as pc

COMPLEXES = MORE_STRUCTURES.parent / "complexes"
FORMATS = (".cif", ".pdb")
WHOLE_ENERGY_UP_TO = 700
"""Atoms up to which energies are compared, too, beside the fingerprint of all that determines them."""


def complex_of(name):
    path = COMPLEXES / name
    if not path.exists():
        pytest.skip(f"{name} is not here")
    return path


def again(structure, path):
    """The structure as its file has it."""
    pc.save(structure, path)
    return pc.load(path, keep="all")


def addresses(s):
    return [
        (str(s.residue_chain[r]), f"{s.residue_number[r]}{s.residue_insertion_code[r]}",
         str(s.residue_name[r]), str(name))
        for r, name in zip(s.atom_residue.tolist(), s.atom_name, strict=True)
    ]  # fmt: skip


def assert_same_system(structure, path):
    """All that an energy depends on is the same, and so is the energy at the positions of the file."""
    found = again(structure, path)
    assert addresses(found) == addresses(structure)
    for name in ("atom_element", "residue_chain_index", "obstacle", "mobile", "kept", "formal_charge"):
        assert np.array_equal(getattr(found, name), getattr(structure, name)), name
    assert {*map(tuple, found.bonds.tolist())} == {*map(tuple, structure.bonds.tolist())}
    assert [(tie.atoms, tie.stiffness) for tie in found.ties] == [
        (tie.atoms, tie.stiffness) for tie in structure.ties
    ]
    assert np.allclose(
        [tie.rest for tie in found.ties], [tie.rest for tie in structure.ties], rtol=0, atol=1e-9
    )
    assert found.fingerprint == replace(structure, ties=found.ties).fingerprint
    if structure.n_atoms <= WHOLE_ENERGY_UP_TO:
        value = pc.energy(found)(found.positions)[0]
        # Columns of a PDB file hold an angstrom's third decimal: it is the energy at these positions.
        at = structure.with_positions(found.positions)
        assert value == pytest.approx(pc.energy(at)(at.positions)[0], rel=READ_AGAIN)


def shaken(structure, seed=0):
    """The structure as a run might leave it: what may move has moved, by 0.03 angstrom."""
    step = np.random.default_rng(seed).normal(scale=0.003, size=structure.positions.shape)
    return structure.with_positions(structure.positions + step * ~structure.obstacle[:, None])


@pytest.mark.parametrize("name", ["1ejg.pdb", "1ubq.cif", "3i40.pdb", "ala10.pdb"])
def test_every_sample_is_the_same_system_again(name, tmp_path):
    for suffix in FORMATS:
        assert_same_system(shaken(load(name)), tmp_path / f"again{suffix}")


CHOSEN = (
    "3znf_zinc_finger.pdb", "5vav_cyclic.pdb", "3u7t_crambin_neutron.cif", "3al1_caps_altloc.pdb",
    "1orc_icode.pdb",
)  # fmt: skip
"""Metals, ring, deuterium, alternates and caps, insertion codes."""


@pytest.mark.parametrize("name", CHOSEN)
def test_kinds_of_file_are_the_same_system_again(name, tmp_path):
    s = shaken(pc.load(shared(name), keep="all"))
    for suffix in FORMATS:
        assert_same_system(s, tmp_path / f"again{suffix}")


@pytest.mark.parametrize("name", ["models/2r5z.pdb", "models/charges.cif"])
def test_complexes_are_the_same_system_again(name, tmp_path):
    """Charges of ATP and ions, DNA between chains that have waters."""
    s = shaken(pc.load(complex_of(name), keep="all"))
    for suffix in FORMATS:
        assert_same_system(s, tmp_path / f"again{suffix}")


@pytest.mark.slow
@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize(
    "path",
    [
        path
        for folder in (MORE_STRUCTURES, COMPLEXES / "models", COMPLEXES / "astex")
        for path in sorted(folder.glob("*.*"))
        if path.suffix in FORMATS
    ],
    ids=lambda path: path.name,
)
def test_every_file_is_the_same_system_again(path, suffix, tmp_path):
    try:
        s = shaken(pc.load(path, keep="all"))
    except pc.ProtochainError as refused:
        pytest.skip(str(refused))
    try:
        pc.save(s, tmp_path / f"again{suffix}")
    except pc.ProtochainError as refused:
        assert suffix == ".pdb" and "does not fit a PDB file" in str(refused)
    else:
        if suffix == ".pdb" and max(map(len, s.residue_name.tolist())) > 3:
            assert " here: PDB files have names of three" in (tmp_path / "again.pdb").read_text()
            assert pc.load(tmp_path / "again.pdb", keep="all").n_atoms == s.n_atoms
        else:
            assert_same_system(s, tmp_path / f"again{suffix}")


def test_a_hydrogen_stays_with_the_atom_it_is_named_for(tmp_path):
    """In an overlap another atom of its residue may be nearer."""
    s = load("1ubq.pdb")
    at = {str(n): k for k, n in enumerate(s.atom_name) if s.atom_residue[k] == 3}
    x = s.positions.copy()
    # Of a phenylalanine: its carbonyl oxygen pushed onto a hydrogen of its ring.
    x[at["O"]] = x[at["HD1"]] + 0.8 * (x[at["HD1"]] - x[at["CD1"]])
    found = again(shaken(s.with_positions(x)), tmp_path / "a.cif")
    assert addresses(found) == addresses(s)
    assert np.abs(found.positions - shaken(s.with_positions(x)).positions).max() < 1e-7


@pytest.mark.parametrize("ph", [3.0, 12.0])
def test_states_of_another_ph_are_read_again_without_it(ph, tmp_path):
    """Neutral acids, charged histidine; neutral lysine, thiolate."""
    pc.save(pc.from_sequence("GKCDEHKCA"), tmp_path / "a.pdb", hydrogens=False)
    s = pc.load(tmp_path / "a.pdb", ph=ph)
    usual = pc.load(tmp_path / "a.pdb")
    assert s.n_atoms == usual.n_atoms + (3 if ph < 7.0 else -4)
    for suffix in FORMATS:
        assert_same_system(shaken(s), tmp_path / f"again{suffix}")


def test_what_a_result_kept_is_kept_again_though_it_came_further_away(tmp_path):
    s = pc.load(complex_of("astex/1HQ2_PH2_protein.pdb"))
    away = s.with_positions(s.positions + 2.0 * s.kept[:, None])
    for suffix in FORMATS:
        pc.save(away, tmp_path / f"a{suffix}")
        assert addresses(pc.load(tmp_path / f"a{suffix}")) == addresses(s)


def test_a_result_has_the_energy_that_was_said_of_it(tmp_path):
    """Springs to its calcium are stretched at the end: they are not made anew with other lengths."""
    s = pc.load(shared("1ajj_ldlr.pdb"))
    r = pc.minimise(pc.build_chain(s), pc.energy(s), "cartesian", tolerance=100.0)
    r.save(tmp_path / "a.cif")
    found = pc.load(tmp_path / "a.cif")
    assert pc.energy(found)(found.positions)[0] == pytest.approx(r.end.energy, rel=READ_AGAIN)
    r.save(tmp_path / "a.pdb")
    found = pc.load(tmp_path / "a.pdb")
    at_its_places = pc.energy(s)(found.positions)[0]
    assert pc.energy(found)(found.positions)[0] == pytest.approx(at_its_places, rel=READ_AGAIN)
