"""The analytic Hessian, against differences of torques, and its parts against differences of their own."""

import numpy as np
import pytest
from fixtures.samples import load
from fixtures.tolerances import ANALYTIC, DIFFERENCED

import protochain as pc
from protochain.comparison import pair_hessian
from protochain.comparison.hessian import torques_at
from protochain.comparison.pair_hessian import applies, born_radii, colours
from protochain.comparison.pair_kernels import screening


@pytest.mark.parametrize(
    ("name", "hinges", "options"),
    [
        ("ala10.pdb", "phi psi chi", {"solvent": "vacuum"}),
        ("1l2y.pdb", "phi psi omega chi rotors angles", {"solvent": "vacuum"}),
        ("3i40.pdb", "phi psi", {"forcefield": "amber19"}),
        ("ala10.pdb", "phi psi", {"forcefield": "charmm36", "solvent": "vacuum"}),
        ("3i40.pdb", "phi psi", {"salt": 0.3}),
        ("ala10.pdb", "phi psi chi", {"solvent": "hct", "salt": 3.0}),
    ],
)
def test_it_is_that_of_differences(name, hinges, options):
    """One chain, two that disulfides join, angles that open, CMAP; any number of threads."""
    s = load(name)
    c = pc.build_chain(s, hinges, "free")
    e = pc.energy(s, threads=1, **options)
    end = pc.minimise(c, e, "lbfgs", max_evaluations=60, curvature=False)
    found = []
    for threads in (1, 2):
        e.threads = threads
        assert applies(e)
        torques = torques_at(c, e, end.q)
        found.append(torques.matrix(np.arange(c.n_v)))
    rows = torques._by_rows(np.arange(c.n_v))
    scale = np.abs(rows).max()
    assert found[0] == pytest.approx(rows, abs=ANALYTIC * scale)
    assert found[1] == pytest.approx(found[0], abs=1e-12 * scale)
    assert np.array_equal(found[0], found[0].T)


def test_of_many_atoms_radii_are_made_again_for_the_same_result(monkeypatch):
    """A tenth of their derivatives are kept at a time; parts of rows, of bodies and of atoms are ragged."""
    s = load("1l2y.pdb")
    c, e = pc.build_chain(s, root="free"), pc.energy(s, threads=2)
    whole = pc.hessian(c, e)
    for name, value in (("_KEPT", 0.0), ("_ROWS", 29), ("_BODIES", 5), ("_COLUMNS", 3), ("_PART", 7)):
        monkeypatch.setattr(pair_hessian, name, value)
    assert len(s.positions) > 8 * max(29, c.n_v // 2)
    assert pc.hessian(c, e) == pytest.approx(whole, abs=1e-12 * np.abs(whole).max())


def test_it_is_the_same_to_the_last_bit_for_any_number_of_threads():
    s = load("3i40.pdb")
    c = pc.build_chain(s)
    one, two = (pc.hessian(c, pc.energy(s, threads=threads)) for threads in (1, 2))
    assert np.array_equal(one, two)


def test_other_energies_have_differences():
    s = load("ala10.pdb")
    for options in ({"solvent": "gbn2"}, {"cutoff": 1.0}, {"engine": "openmm"}):
        assert not applies(pc.energy(s, **options))
    e = pc.energy(s, solvent="gbn2", threads=1)
    c = pc.build_chain(s)
    torques = torques_at(c, e, None)
    assert np.array_equal(pc.hessian(c, e), torques._by_rows(np.arange(c.n_v)))


@pytest.mark.parametrize("engulfs", [False, True])
def test_integrals_have_their_derivatives(engulfs):
    """Near and far, inside, across and outside the sphere, on both sides of where the series begins."""
    for r in (0.03, 0.09, 0.15, 0.24, 0.31, 0.4, 1.0, 5.0):
        for radius, s in ((0.15, 0.1), (0.11, 0.15), (0.11, 0.05)):
            value, slope, second = screening(r, 1 / r**2, radius, s, engulfs)
            h = 1e-5 * r
            (before, below, _), (after, above, _) = (
                screening(at, 1 / at**2, radius, s, engulfs) for at in (r - h, r + h)
            )
            size = abs(value) / r + 1e-9
            assert slope * r == pytest.approx((after - before) / (2 * h), abs=DIFFERENCED * size)
            rise = (above * (r + h) - below * (r - h)) / (2 * h)
            assert second == pytest.approx(rise, abs=DIFFERENCED * size / r)
            assert value == pytest.approx(descreening(r, radius, s, engulfs), rel=1e-9, abs=1e-12)


def descreening(r, radius, s, engulfs):
    """Hawkins, Cramer, Truhlar (1996), equation 9, as OpenMM has it."""
    low, high = max(radius, abs(r - s)), r + s
    if high <= radius:
        return 0.0
    squares = 1 / high**2 - 1 / low**2
    value = 1 / low - 1 / high + 0.25 * (r - s * s / r) * squares + 0.5 * np.log(low / high) / r
    return 0.5 * value + (1 / radius - 1 / low if engulfs and radius < s - r else 0.0)


def test_born_radii_have_their_derivatives():
    rng = np.random.default_rng(0)
    offset, radius = 0.1 + 0.1 * rng.random(20), 0.12 + 0.1 * rng.random(20)
    bend = np.where(np.arange(20)[:, None] < 10, [1.0, 0.8, 4.85], 0.0)
    integral, h = 4.0 * rng.random(20), 1e-5
    _, slope, second = born_radii(integral, offset, radius, bend)
    (before, below, _), (after, above, _) = (
        born_radii(integral + side * h, offset, radius, bend) for side in (-1.0, 1.0)
    )
    assert slope == pytest.approx((after - before) / (2 * h), rel=DIFFERENCED)
    assert second == pytest.approx((above - below) / (2 * h), rel=DIFFERENCED, abs=1e-7)


def test_hinges_of_one_colour_share_no_bonded_term():
    s = load("3i40.pdb")
    c = pc.build_chain(s)
    e = pc.energy(s, threads=1)
    coupled, colour = colours(c, e)
    bonded = torques_at(c, e.bonded_terms, None)
    rows = bonded._by_rows(np.arange(c.n_v))
    there = np.abs(rows) > 1e-6 * np.abs(rows).max()
    assert not (there & (coupled.toarray() == 0.0)).any()
    for each in range(colour.max() + 1):
        assert (there[:, colour == each].sum(axis=1) <= 1).all()
    assert colour.max() < c.n_v // 2
