"""Hessian and normal modes in torsions, against dense algebra of all atoms."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from fixtures.samples import STRUCTURES, load, shared
from fixtures.tolerances import HESSIAN, MODES, ROUND_OFF
from scipy.linalg import eigh
from scipy.spatial import cKDTree

import protochain as pc
from protochain.comparison import normal_modes
from protochain.comparison.modes import share_moved
from protochain.mechanics import multibody
from protochain.minimisers.spring_model import Springs, torsion_stiffness

WATER = {"threads": 1}


@functools.cache
def at_minimum(name="ala10.pdb", root="free"):
    s = load(name) if name.endswith(".pdb") else pc.from_sequence(name)
    c, e = pc.build_chain(s, root=root), pc.energy(s, **WATER)
    # Once more, from where a saddle point was left.
    for _ in range(2):
        end = pc.minimise(c, e, "lbfgs", tolerance=1e-5, max_evaluations=5000)
        c = pc.build_chain(end.structure, root=root)
    return c, e


@functools.cache
def modes(name="ala10.pdb", k=1000, **options):
    return pc.normal_modes(*at_minimum(name), k=k, **options)


def moved(c, q, v, h):
    return multibody.integrate(c.tree, q, h * v)


def jacobian(c, q, h=1e-5):
    """(3 na, n_v): changes of all positions, by differences."""
    columns = [
        (pc.pose(c, moved(c, q, unit, h)).x - pc.pose(c, moved(c, q, unit, -h)).x).ravel() / (2 * h)
        for unit in np.eye(c.n_v)
    ]
    return np.array(columns).T


def by_all_atoms(c, e, q):
    """J^T H J of all atoms on OpenMM's Reference platform, and what the curvature of the motions adds."""
    at, j, h = pc.pose(c, q), jacobian(c, q), 1e-6
    forces = e.reference(at.x)[1]
    out = np.empty((c.n_v, c.n_v))
    for k, unit in enumerate(np.eye(c.n_v)):
        step = (j @ unit).reshape(-1, 3)
        hj = (e.reference(at.x - h * step)[1] - e.reference(at.x + h * step)[1]).ravel() / (2 * h)
        there, back = (pc.pose(c, moved(c, q, unit, side * 1e-5)) for side in (1.0, -1.0))
        bent = (pc.pull_back(c, back, forces) - pc.pull_back(c, there, forces)) / 2e-5
        out[k] = j.T @ hj + bent
    return 0.5 * (out + out.T)


@pytest.mark.parametrize(("name", "root"), [("ala10.pdb", "fixed"), ("GCWP", "free")])
def test_the_hessian_is_that_of_all_atoms_along_the_hinges(name, root):
    s = load(name) if name.endswith(".pdb") else pc.from_sequence(name)
    c, e = pc.build_chain(s, root=root), pc.energy(s, **WATER)
    q, found = c.q0, pc.hessian(c, e)
    rng = np.random.default_rng(0)
    if root == "free":  # There the torque of the whole must vanish, and does.
        q = multibody.integrate(c.tree, q, 0.1 * rng.normal(size=c.n_v))
        found = pc.hessian(c, e, q)
    assert found == pytest.approx(by_all_atoms(c, e, q), abs=HESSIAN * np.abs(found).max())
    assert np.array_equal(found, found.T)
    v = rng.normal(size=c.n_v)
    assert pc.hessian_product(c, e, q, v) == pytest.approx(found @ v, abs=HESSIAN * np.linalg.norm(found @ v))
    assert not pc.hessian_product(c, e, q, 0.0 * v).any()


def test_modes_of_rigid_bodies_are_those_of_all_atoms_between_them():
    """Frequencies by dense algebra of all freedoms, six of them of the whole; no mode has momentum."""
    c, e = at_minimum()
    r = modes()
    j = jacobian(c, c.q0)
    mass = j.T @ (np.repeat(c.structure.atom_mass, 3)[:, None] * j)
    every = eigh(by_all_atoms(c, e, c.q0), mass, eigvals_only=True)
    assert np.abs(every[:6]).max() < 1e-3 * r.eigenvalues[0]
    assert r.n_modes == c.n_v - 6 == c.n_hinges
    assert r.eigenvalues == pytest.approx(every[6:], rel=1e-4)
    wide = r.modes.T @ mass @ r.modes
    assert wide == pytest.approx(np.eye(r.n_modes), abs=1e-8)
    for mode in (0, 7):
        p, spin = multibody.momentum(c.tree, pc.pose(c, c.q0).frames, r.modes[:, mode])
        assert np.abs(np.r_[p, spin]).max() < 1e-9
        assert r.displacements(mode).ravel() == pytest.approx(j @ r.modes[:, mode], abs=1e-8)
    assert r.frequencies**2 * (2 * np.pi * 0.0299792458) ** 2 == pytest.approx(r.eigenvalues)
    assert r.is_minimum and r.residuals.max() < 1e-8 and r.held_by == ""


def test_lowest_modes_by_products_are_those_of_the_whole_hessian():
    c, e = at_minimum("1l2y.pdb")
    dense, few = (pc.normal_modes(c, e, k=5, method=each) for each in ("dense", "products"))
    assert few.spectrum is None and len(dense.spectrum) == c.n_hinges
    assert few.eigenvalues == pytest.approx(dense.eigenvalues, rel=MODES)
    assert few.eigenvalues == pytest.approx(modes("1l2y.pdb").eigenvalues[:5], rel=MODES)
    assert few.residuals.max() <= 1e-8
    assert few.largest_stable_step == pytest.approx(dense.largest_stable_step, rel=1e-3)
    frames = pc.pose(c, c.q0).frames
    # The same directions: those of a mode have M-products of 1.
    for a, b in zip(few.modes.T, dense.modes.T, strict=True):
        assert abs(a @ multibody.multiply_mass(c.tree, frames, b)) == pytest.approx(1.0, abs=1e-4)


def test_of_many_freedoms_the_lowest_are_those_of_all(monkeypatch):
    """By Lanczos with the factor of K + s M, at a minimum and with negative modes, for one s and another."""
    c, e = at_minimum("1l2y.pdb")
    turned = c.q0 + np.where(np.arange(c.n_q) > 8, 0.1, 0.0)
    for q, shift in ((c.q0, 0.01), (turned, 0.01), (turned, 1e4)):
        monkeypatch.setattr(normal_modes, "_SHIFT", shift)
        every = pc.normal_modes(c, e, q, k=5)
        with monkeypatch.context() as patch:
            patch.setattr(normal_modes, "ALL", 10)
            few = pc.normal_modes(c, e, q, k=5)
        assert few.spectrum is None and few.residuals.max() < 1e-8
        assert few.eigenvalues == pytest.approx(every.eigenvalues, rel=1e-8)
        assert few.largest_eigenvalue == pytest.approx(every.largest_eigenvalue, rel=1e-8)
        if few.is_minimum:
            assert few.entropy(quantum=False) == every.entropy(quantum=False)
    assert few.n_negative


class Net:
    """Springs at rest between atoms within 0.45 nm, as an energy that users write."""

    def __init__(self, s, within_chains=False):
        x, chain = s.positions, s.residue_chain_index[s.atom_residue]
        self.i, self.j = cKDTree(x).query_pairs(0.45, output_type="ndarray").T
        if within_chains:
            kept = chain[self.i] == chain[self.j]
            self.i, self.j = self.i[kept], self.j[kept]
        self.rest = np.linalg.norm(x[self.i] - x[self.j], axis=1)

    def __call__(self, x):
        d = x[self.i] - x[self.j]
        r = np.linalg.norm(d, axis=1)
        f = np.zeros_like(x)
        pull = (-100.0 * (r - self.rest) / r)[:, None] * d
        np.add.at(f, self.i, pull)
        np.add.at(f, self.j, -pull)
        return float(50.0 * np.sum((r - self.rest) ** 2)), f

    def springs(self, *_):
        return Springs(np.stack([self.i, self.j], axis=1), np.full(len(self.i), 100.0))


def test_springs_at_rest_have_the_stiffness_of_their_lengths():
    s = load("3i40.pdb")
    c, net = pc.build_chain(s, "phi psi"), Net(load("3i40.pdb"))
    found, exact = pc.hessian(c, net), torsion_stiffness(c, pc.pose(c, c.q0), net.springs)
    assert found == pytest.approx(exact, abs=HESSIAN * np.abs(exact).max())


def test_two_chains_that_do_not_act_on_each_other_have_twelve_zero_modes(monkeypatch):
    """Six are left out, as ever; the other six, of one chain against the other, are found as zeros."""
    c = pc.build_chain(load("3i40.pdb"), "phi psi")
    r = pc.normal_modes(c, Net(c.structure, True), k=12)
    soft = np.abs(r.eigenvalues) <= r.errors
    assert soft.tolist() == [True] * 6 + [False] * 6
    assert r.is_minimum and r.b_factor_correlation is None
    with pytest.raises(pc.ProtochainError, match="no equilibrium"):
        r.mean_squares()
    monkeypatch.setattr(normal_modes, "ALL", 10)
    few = pc.normal_modes(c, Net(c.structure, True), k=12)
    assert few.eigenvalues[6:] == pytest.approx(r.eigenvalues[6:], rel=MODES)
    assert (np.abs(few.eigenvalues[:6]) <= few.errors[:6]).all() and few.residuals.max() < 1e-8
    joined = pc.normal_modes(c, Net(c.structure), k=12)
    assert (joined.eigenvalues > joined.errors).all() and len(joined.fluctuations()) == 51


def test_a_saddle_point_is_no_minimum():
    """Tetraglycine with all hinges at 180 degrees has no torque, by symmetry, and two ways down."""
    c = pc.build_chain(pc.from_sequence("GGGG"))
    q = c.q0.copy()
    q[c.tree.q_start[c.hinge_body]] = np.pi
    c = pc.build_chain(c.structure.with_positions(pc.pose(c, q).x))
    e = pc.energy(c.structure, **WATER)
    r = pc.normal_modes(c, e, k=9)
    # Sylvester's law: as many negative modes as negative eigenvalues.
    assert r.n_negative == np.sum(np.linalg.eigvalsh(pc.hessian(c, e)) < 0.0) == 2
    assert not r.is_minimum and r.frequencies[0] < 0.0
    for refused in (r.entropy, r.mean_squares):
        with pytest.raises(pc.ProtochainError):
            refused()


def test_a_point_with_torques_is_no_minimum_whatever_its_curvature():
    c, e = at_minimum()
    q = c.q0.copy()
    q[-1] += 0.05
    r = pc.normal_modes(c, e, q)
    assert r.max_torque > 1.0 and not r.is_minimum


def test_only_b_factors_of_a_crystal_are_compared():
    """pLDDT, deviations between models and columns without a cell are named, and left empty."""
    crystal, nmr = load("3i40.pdb"), "data_\n_struct.title 'PEPTIDE, NMR, 10 STRUCTURES'\n"
    for quantity, s in (
        ("B factor", crystal),
        ("unknown", replace(crystal, header="")),
        ("unknown", replace(crystal, header="", left_out={"models": 9})),
        ("deviation between models", replace(crystal, header=nmr, left_out={"models": 9})),
        ("pLDDT", replace(crystal, header="data_\n_ma_qa_metric.name pLDDT\n")),
    ):
        r = pc.normal_modes(pc.build_chain(s, "phi psi"), Net(s), k=12)
        in_file, is_b = r.fluctuations()["ca_b_factor_in_file_angstrom2"], quantity == "B factor"
        assert s.b_factor_quantity == quantity and in_file.notna().all() == in_file.notna().any() == is_b
        assert (r.b_factor_correlation is not None) == is_b


def test_b_factors_are_of_the_residue_also_behind_a_cap():
    s = pc.load(STRUCTURES / "ala10.pdb", cap="all")
    r = pc.normal_modes(pc.build_chain(s, "phi psi"), Net(s), k=12)
    table, squares = r.fluctuations(), r.mean_squares()
    assert s.residue_name[0] == "ACE" and table["residue"].astype(int).tolist() == [*range(1, 11)]
    for k, value in enumerate(table["b_factor_angstrom2"], 1):
        heavy = (s.atom_residue == k) & (s.atom_element != "H")
        assert value == pytest.approx(8 * np.pi**2 / 3 * squares[heavy].mean())


def test_fluctuations_and_entropy_are_those_of_the_gaussian():
    """Covariance kT J K^-1 J^T, and ln det of K and M by dense algebra."""
    c, e = at_minimum()
    r = modes()
    kt = 8.31446261815324e-3 * 300.0
    six = np.arange(6) + c.tree.v_start[0]
    rest = np.setdiff1d(np.arange(c.n_v), six)
    every, j = pc.hessian(c, e), jacobian(c, c.q0)
    m = pc.mass_matrix(c, pc.pose(c, c.q0))
    whole = np.linalg.solve(m[np.ix_(six, six)], m[np.ix_(six, rest)])
    still = j[:, rest] - j[:, six] @ whole
    k = every[np.ix_(rest, rest)]
    covariance = kt * still @ np.linalg.solve(k, still.T)
    squares = np.diagonal(covariance).reshape(-1, 3).sum(axis=1)
    assert r.mean_squares() == pytest.approx(100.0 * squares, rel=1e-5)
    table = r.fluctuations()
    alpha = c.structure.alpha_carbons
    b_factors = table["ca_b_factor_angstrom2"].to_numpy()
    assert b_factors == pytest.approx(800 * np.pi**2 / 3 * squares[alpha], rel=1e-5)
    # det M of the rest, by Schur's complement.
    log_det = np.linalg.slogdet(m)[1] - np.linalg.slogdet(m[np.ix_(six, six)])[1]
    assert r.log_det_mass == pytest.approx(log_det, rel=1e-10)
    assert r.log_det_hessian == pytest.approx(np.linalg.slogdet(k)[1], rel=1e-8)
    # S = -dF/dT of F = kT sum ln(2 sinh(x/2)), and of kT sum ln(hbar w/kT).
    hbar, gas, w = 0.3990312712893431 / (2 * np.pi), 8.31446261815324e-3, np.sqrt(r.spectrum)
    for quantum, free in (
        (True, lambda t: gas * t * np.sum(np.log(2 * np.sinh(hbar * w / (2 * gas * t))))),
        (False, lambda t: gas * t * np.sum(np.log(hbar * w / (gas * t)))),
    ):
        slope = (free(299.9) - free(300.1)) / 0.2
        assert r.entropy(300.0, quantum=quantum) == pytest.approx(slope, rel=1e-6)
    exact = 8.31446261815324e-3 * np.sum(1.0 - np.log(hbar * w / kt))
    assert r.entropy(quantum=False) == pytest.approx(exact, rel=1e-10)
    with pytest.raises(pc.ProtochainError, match="method"):
        pc.normal_modes(c, e, k=2, method="products").entropy()


def test_overlaps_with_a_mode_are_its_own():
    r = modes("1l2y.pdb")
    frames = [r.chain.structure.with_positions(x) for x in r.swing(3, 0.001, 5)]
    alpha = r.chain.structure.alpha_carbons
    away = np.sqrt(np.mean(np.sum((frames[1].positions - r.x)[alpha] ** 2, axis=1)))
    assert away == pytest.approx(1e-4, rel=1e-3)  # nm
    assert np.array_equal(frames[0].positions, r.x)
    seen, together = r.overlap(frames[1]), r.cumulative_overlap(frames[1])
    assert seen[3] == pytest.approx(1.0, abs=1e-5) and seen.max() == seen[3]
    assert (np.diff(together) >= -ROUND_OFF).all() and together[2] < 0.999 < together[3]
    assert together[0] == pytest.approx(seen[0])
    # All hinges together hold nearly all that torsions can do: any change of them.
    model = pc.build_chain(r.chain.structure)
    rng = np.random.default_rng(1)
    other = pc.pose(model, model.q0 + 1e-5 * rng.normal(size=model.n_q)).x
    assert r.cumulative_overlap(r.chain.structure.with_positions(other))[-1] == pytest.approx(1.0, abs=1e-6)
    with pytest.raises(pc.ProtochainError, match="has the positions of"):
        r.overlap(r.chain.structure.with_positions(r.x))


def test_collectivity_counts_what_moves():
    one = np.zeros((7, 3))
    one[2] = 1.0, 2.0, 3.0
    assert share_moved(one) == pytest.approx(1 / 7)
    one[5] = -one[2]
    assert share_moved(one) == pytest.approx(2 / 7)
    assert share_moved(np.ones((7, 3))) == pytest.approx(1.0)
    r = modes()
    assert ((r.collectivity >= 0.1) & (r.collectivity <= 1.0)).all()


def test_a_fixed_root_holds_the_whole():
    """M is then that of the hinges alone, whatever the chain weighs beside them."""
    c, e = at_minimum(root="fixed")
    r = pc.normal_modes(c, e, k=3)
    exact = eigh(pc.hessian(c, e), pc.mass_matrix(c, pc.pose(c, c.q0)), eigvals_only=True)[:3]
    assert r.eigenvalues == pytest.approx(exact, rel=1e-10) and r.modes.shape == (c.n_hinges, 3)


def test_what_has_no_modes_is_refused(monkeypatch):
    """Atoms on a line, whose bonds turn nothing; atoms in one place; and more freedoms than fit."""
    s = load("ala10.pdb")
    line = 0.12 * np.arange(s.n_atoms)[:, None] * [0.0, 0.6, 0.8]
    with pytest.raises(pc.ProtochainError, match="no bond turns"):
        pc.normal_modes(s.with_positions(line))
    x = s.positions.copy()
    x[5] = x[90]
    with pytest.raises(pc.ProtochainError, match="not finite"):
        pc.normal_modes(s.with_positions(x))
    monkeypatch.setattr(normal_modes, "ANALYTIC", 20)
    monkeypatch.setattr(normal_modes, "MOST", 10)
    assert pc.normal_modes(s, k=1).n_modes == 1  # 19 freedoms
    with pytest.raises(pc.ProtochainError, match="19 freedoms exceed the limit of 10"):
        pc.normal_modes(s, k=1, method="products")
    monkeypatch.setattr(normal_modes, "ANALYTIC", 18)
    with pytest.raises(pc.ProtochainError, match="19 freedoms exceed the limit of 18"):
        pc.normal_modes(s, k=1)


def test_energies_without_analytic_derivatives_have_the_modes_of_their_differences():
    """OpenMM's forces are those of its Reference platform, which is exact enough to be differenced."""
    c, _ = at_minimum()
    engine = pc.energy(c.structure, engine="openmm", **WATER)
    assert pc.normal_modes(c, engine).eigenvalues == pytest.approx(modes().eigenvalues, rel=MODES, abs=1e-4)
    for options in ({"solvent": "gbn2"}, {"cutoff": 1.0}):
        other = pc.energy(c.structure, **options, **WATER)
        end = pc.minimise(c, other, "lbfgs", tolerance=1e-3)
        dense, few = (pc.normal_modes(c, other, end.q, 4, method=m) for m in ("dense", "products"))
        assert dense.is_minimum and dense.n_products == 0 < few.n_products
        assert few.eigenvalues == pytest.approx(dense.eigenvalues, rel=MODES)


def test_obstacles_hold_the_whole():
    """Beside atoms that stay there are no zero modes: none is left out, and the softest are of the whole."""
    s = load("3i40.pdb")
    held = replace(s, obstacle=s.residue_chain[s.atom_residue] == "B")
    c, net = pc.build_chain(held, "phi psi", "free"), Net(held)
    r = pc.normal_modes(c, net, k=5)
    assert r.held_by and r.n_freedoms == c.n_v == c.n_hinges + 6
    exact = eigh(pc.hessian(c, net), pc.mass_matrix(c, pc.pose(c, c.q0)), eigvals_only=True)[:5]
    assert r.eigenvalues == pytest.approx(exact, rel=1e-8) and exact[0] > r.errors[0]
    assert not r.displacements(0)[held.obstacle].any()


def test_a_torque_that_is_no_number_is_refused():
    s = load("ala10.pdb")
    with pytest.raises(pc.ProtochainError, match="not finite"):
        pc.normal_modes(s, lambda x: (0.0, np.full_like(x, np.nan)))
    with pytest.raises(pc.ProtochainError, match="q has nan at 1"):
        pc.hessian(s, q=np.r_[0.0, np.nan, np.zeros(pc.build_chain(s).n_q - 2)])


def test_one_residue_between_caps_has_modes():
    r = pc.normal_modes(pc.minimise(shared("ala_dipeptide.pdb"), method="lbfgs"))
    assert r.n_modes == 2 and r.is_minimum and r.b_factor_correlation is None
    assert r.collectivity == pytest.approx(1.0) or np.isnan(r.collectivity).all()
