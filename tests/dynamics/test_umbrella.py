"""Umbrella windows whose samples are drawn exactly, from a known free energy along one dihedral."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from fixtures.refusals import expect_refusal

import protochain as pc

pytest.importorskip("pymbar")

KT = 8.314462618e-3 * 300.0
GRID = np.arange(-180.0, 180.0, 1.0) + 0.5
CENTRES = np.arange(-150.0, -20.0, 20.0)


def flat(phi):
    return 0.0 * phi


def hilly(phi):
    return 6.0 * np.cos(2.0 * phi) + 3.0 * np.sin(phi)


def steep(phi):
    return 15.0 * np.cos(2.0 * phi)


@pytest.fixture(scope="module")
def dipeptide():
    """Chain of one hinge, and its positions at each angle of the grid."""
    c = pc.build_chain(pc.from_sequence("AA"), "phi", "fixed")
    (at,) = c.tree.q_start[c.hinge_body]
    q = np.tile(c.q0, (len(GRID), 1))
    q[:, at] += np.deg2rad(GRID) - np.deg2rad(c.structure.dihedrals()["phi"][1])
    return c, [pc.pose(c, row).x for row in q]


@pytest.fixture
def free_energy(dipeptide, monkeypatch):
    """Function that gives pc.umbrella of exact draws, each of which is repeated with some probability."""
    c, x = dipeptide

    def drawn(potential, centres, edges=None, *, stiffness=60.0, n=400, repeats=0.0, seed=0):
        random = np.random.default_rng(seed)

        def simulate(chain, energy, q, temperature, *, restraints, watch):
            away = np.angle(np.exp(1j * np.deg2rad(GRID - restraints.lower)))
            share = np.exp(-(potential(np.deg2rad(GRID)) + 0.5 * restraints.stiffness * away**2) / KT)
            rows = random.choice(len(GRID), n, p=share / share.sum())
            for k in range(1, n):
                rows[k] = rows[k - 1] if random.random() < repeats else rows[k]
            for row in rows:
                watch({}, x[row])
            return SimpleNamespace(is_sound=True, chain=c, q=None)

        monkeypatch.setattr("protochain.dynamics.umbrella.simulate", simulate)
        spring = pc.Restraint("dihedral", ("phi A:2",), 0, 0, stiffness)
        return pc.umbrella(c, lambda at: (0.0, 0.0 * at), spring, centres, edges=edges, n_equilibrate=0)

    return drawn


def exact(potential, edges):
    """Free energy of each bin per degree, above the lowest."""
    turned = (GRID - edges[0]) % 360.0 + edges[0]
    bins = [turned[(turned >= low) & (turned < high)] for low, high in pairwise(edges)]
    values = [-KT * np.log(np.mean(np.exp(-potential(np.deg2rad(angles)) / KT))) for angles in bins]
    return np.array(values) - min(values)


@pytest.mark.parametrize(
    ("centres", "edges", "middles"),
    [
        (CENTRES, [-150, -140, -130, -120, -90, -60, -50, -40], [-145, -135, -125, -105, -75, -55, -45]),
        ([-160, -120, -100, -90, -80, -70, -60, -20], None, [-160, -125, -102.5, -90, -80, -70, -52.5, -20]),
        ([150, 170, 190, 210], [140, 160, 180, 190, 195, 220], [150, 170, 185, 192.5, 207.5]),
        (np.arange(-180, 180, 24), None, np.arange(-180, 180, 24)),
        # The circle closes halfway between 170 and 190 degrees, which are -170.
        ([-170, -130, -90, -50, -10, 30, 70, 110, 170], None, [-165, -130, -90, -50, -10, 30, 70, 115, 160]),
    ],
)  # fmt: skip
@pytest.mark.parametrize("potential", [flat, hilly])
def test_bins_of_any_width_have_the_free_energy_per_degree(potential, centres, edges, middles, free_energy):
    found = free_energy(potential, centres, edges, n=1500, stiffness=40.0)
    assert found["value"].tolist() == pytest.approx(middles)
    if edges is None:
        inner = 0.5 * (np.array(centres[1:]) + centres[:-1])
        edges = [2.0 * middles[0] - inner[0], *inner, 2.0 * middles[-1] - inner[-1]]
    off = found["free_energy_kj_mol"] - exact(potential, np.array(edges, dtype=float))
    error = found["error_kj_mol"]
    lowest = found["free_energy_kj_mol"].idxmin()
    # All errors are those of a difference to the lowest bin, which has none.
    assert found["free_energy_kj_mol"][lowest] == 0.0 and error[lowest] < 1e-6
    assert (error.drop(lowest) > 0.05).all() and error.max() < 0.8
    assert (np.abs(off - off[lowest]) < 4.0 * error + 0.01).drop(lowest).all(), off


@pytest.mark.parametrize("repeats", [0.0, 0.8])
def test_errors_are_the_scatter_of_independent_runs(repeats, free_energy):
    """Of rows each of which is repeated with probability p, N are as good as N (1 - p) / (1 + p)."""
    edges = np.array([-140.0, -120.0, -105.0, -75.0, -50.0])
    runs = [
        free_energy(steep, [-130, -110, -90, -70], edges, repeats=repeats, seed=seed) for seed in range(40)
    ]  # fmt: skip
    values, errors = (
        np.array([run[name] for run in runs]) for name in ("free_energy_kj_mol", "error_kj_mol")
    )
    assert {int(np.argmin(row)) for row in values} == {2}
    ratio = np.sqrt(np.sum((values - exact(steep, edges)) ** 2) / np.sum(errors**2))
    # The scatter of 40 runs is known to 11 %. Rows taken as independent would give 3 for repeated rows.
    assert 0.7 < ratio < 1.4, ratio


def test_bins_without_samples_are_skipped(free_energy):
    found = free_energy(flat, CENTRES, np.arange(-180.0, 181.0, 30.0), stiffness=200.0)
    assert found["value"].tolist() == [-165, -135, -105, -75, -45, -15]
    assert np.isfinite(found.to_numpy()).all()


@pytest.mark.parametrize(
    ("centres", "edges", "stated"),
    [
        ([-60, -60, -30], None, "centres -60 and -60: these are equal"),
        ([-60, -30, -60.0], None, "centres -60 and -60"),
        (np.arange(-180, 181, 24), None, "centres 180 and -180"),
        (np.arange(-180, 600, 60), None, "centres 540 and -180"),
        ([0, np.nan, 3], None, "centres has nan"), ([[1, 2], [3, 4]], None, "centres has shape"),
        ([-60], None, "two centres or more"), ("ab", None, "two centres or more"),
        (CENTRES, [-50, -100, -80], "edges .* rising order"), (CENTRES, [-50, -100], "edges .* rising order"),
        (CENTRES, [-150, -100, -100, -50], "edges .* rising"), (CENTRES, [-50], "edges .* two or more"),
        (CENTRES, [-180, 0, 200], "edges .* within 360 degrees"), (CENTRES, [0, np.nan], "edges has nan"),
        (CENTRES, [60, 80, 100], "edges .* no samples between them"),
        ([-150, -140, 30, 40], None, "centres .* do not overlap"),
    ],
)  # fmt: skip
def test_windows_and_bins_that_give_no_free_energy_are_refused_in_one_line(
    centres, edges, stated, free_energy
):
    with pytest.raises(pc.ProtochainError, match=stated) as refusal:
        free_energy(flat, centres, edges, stiffness=400.0)
    assert "\n" not in str(refusal.value)


def test_windows_need_rows_and_a_coordinate_that_changes(free_energy):
    with expect_refusal("n_steps", match="1 rows, of which 0"):
        free_energy(flat, CENTRES, n=1)
    with pytest.raises(pc.ProtochainError, match="no hinge changes it"):
        free_energy(flat, CENTRES, repeats=1.0)


def test_distances_are_not_negative():
    c = pc.build_chain(pc.from_sequence("AA"), "phi")
    spring = pc.Restraint("distance", ("A:1:CA", "A:2:CA"), 0, 0)
    with expect_refusal("centres", match="centres -1"):
        pc.umbrella(c, pc.energy(c), spring, [-1.0, 2.0])


@pytest.mark.parametrize("option", ["q", "restraints", "watch"])
def test_what_the_windows_set_is_refused(option):
    c = pc.build_chain(pc.from_sequence("AA"), "phi")
    spring = pc.Restraint("dihedral", ("phi A:2",), 0, 0)
    with pytest.raises(pc.ProtochainError, match=f"umbrella: {option} is set by the windows"):
        pc.umbrella(c, pc.energy(c), spring, [-60.0, -40.0], **{option: None})
