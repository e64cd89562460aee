"""Terms from the templates of a force field against terms of the System that OpenMM builds."""

from dataclasses import fields, is_dataclass

import numpy as np
import pytest
from fixtures.samples import load, shared

import protochain as pc
from protochain.energies import factory
from protochain.energies.native.terms import compile_system


def assert_equal(first, second):
    """Compare values with all arrays and mappings in them, to the bit."""
    assert type(first) is type(second)
    if is_dataclass(first):
        for field in fields(first):
            assert_equal(getattr(first, field.name), getattr(second, field.name))
    elif isinstance(first, dict):
        assert [*first] == [*second]
        for key in first:
            assert_equal(first[key], second[key])
    elif isinstance(first, np.ndarray):
        assert first.dtype == second.dtype
        assert first.shape == second.shape
        assert first.tobytes() == second.tobytes()
    else:
        assert first == second


@pytest.mark.parametrize(
    ("name", "forcefield", "solvent"),
    [
        ("3i40.pdb", "amber14", "obc2"),  # Disulfides between chains.
        ("5awl.pdb", "amber99sbildn", "obc2"),
        ("1ejg.pdb", "amber99sb", "vacuum"),
        ("aaqaa3_capped.pdb", "amber14", "obc2"),
        ("5vav_cyclic.pdb", "amber14", "vacuum"),
    ],
)
def test_terms_of_templates_equal_terms_of_the_system(name, forcefield, solvent):
    path = shared(name) if "_" in name else None
    structure = pc.load(path, keep="none") if path else load(name)
    energy = pc.energy(structure, forcefield, solvent, engine="native")
    built = factory.build_system(structure, forcefield, solvent)
    assert_equal(energy.terms, compile_system(built))
    assert energy.fingerprint == pc.energy(structure, system=built).fingerprint


def test_a_minimisation_builds_no_system(monkeypatch):
    structure = load("ala10.pdb")
    expected = pc.energy(structure, system=factory.build_system(structure))(structure.positions)

    def refuse(*arguments):
        raise AssertionError

    monkeypatch.setattr(factory, "build_system", refuse)
    energy = pc.energy(structure)
    value, forces = energy(structure.positions)
    assert value == expected[0]
    assert forces.tobytes() == expected[1].tobytes()
    assert pc.minimise(structure, energy).status == "converged"
    with pytest.raises(AssertionError):
        _ = energy.system


def test_errors_are_reported_as_of_the_system():
    structure = pc.load(shared("1as5_conotoxin.cif"), keep="none")
    with pytest.raises(pc.ProtochainError, match="does not fit"):
        pc.energy(structure, "amber99sb")
