"""Planar atoms whose neighbours lie on one side: found, pushed, and opened by relaxation."""

import numpy as np
import pytest
from fixtures.samples import SAMPLES, load

import protochain as pc
from protochain.relaxation.restraints import Planes
from protochain.validation import violations

ANGLE = np.radians(75.0)


def folded(structure, residue):
    """Positions of which, seen from a carbonyl's carbon, C-alpha is between oxygen and the next nitrogen."""
    x, of = structure.positions.copy(), structure.atom_residue == residue
    ca, c, o = (int(np.flatnonzero(of & (structure.atom_name == name))[0]) for name in ("CA", "C", "O"))
    (n,) = (
        int(i) for i in np.flatnonzero((structure.atom_residue == residue + 1) & (structure.atom_name == "N"))
    )
    along, across = x[ca] - x[c], x[n] - x[c]
    across -= (across @ along) / (along @ along) * along
    along, across = along / np.linalg.norm(along), across / np.linalg.norm(across)
    for atom, side in ((n, across), (o, -across)):
        way = np.cos(ANGLE) * along + np.sin(ANGLE) * side
        x[atom] = x[c] + way * np.linalg.norm(x[atom] - x[c])
    return x, c


def test_the_force_is_the_derivative_of_the_energy():
    s = load("1l2y.pdb")
    planes = Planes.of(s)
    x = s.positions + np.random.default_rng(4).normal(scale=0.04, size=s.positions.shape)
    value, forces = planes(x)
    assert value > 0.0 and np.abs(forces.sum(axis=0)).max() < 1e-9 * np.abs(forces).max()
    way, h = np.random.default_rng(5).normal(size=x.shape), 1e-6
    slope = (planes(x + h * way)[0] - planes(x - h * way)[0]) / (2 * h)
    assert slope == pytest.approx(-np.vdot(forces, way), rel=1e-5)


@pytest.mark.parametrize("name", SAMPLES)
def test_atoms_of_usual_shape_feel_nothing(name):
    s = load(name)
    planes = Planes.of(s)
    value, forces = planes(s.positions)
    assert value == 0.0 and not forces.any()
    names = set(s.atom_name[planes.atoms[:, 0]].tolist())
    assert {"C", "N"} <= names and not names & {"CA", "CB", "NZ"}
    # Every peptide bond's carbon, and its nitrogen.
    assert (s.atom_name[planes.atoms[:, 0]] == "C").sum() == s.n_residues


def test_a_folded_carbonyl_is_opened():
    s = load("1l2y.pdb")
    x, centre = folded(s, 9)
    planes = Planes.of(s)
    (at,) = np.flatnonzero(planes.atoms[:, 0] == centre)
    alone = Planes(planes.atoms[at : at + 1])
    assert alone(x)[0] > 100.0
    start = s.with_positions(x)
    done = pc.relax(start)
    assert done.status == "converged" and alone(done.structure.positions)[0] == 0.0
    assert not violations(done.structure)
