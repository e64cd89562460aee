"""Energies and forces where atoms meet, are far from the origin, lie on a line, or are no numbers."""

from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bench.cases import Found, Refusal
from bench.studies.stability.cells import EPS, Case, Part
from protochain.chains.articulate import build_chain
from protochain.chains.chain import Pose, pose, pull_back
from protochain.core.arrays import Floats
from protochain.core.errors import Argument, Fault, OnlyAlphaError
from protochain.dynamics import simulate
from protochain.energies import Energy, energy
from protochain.minimisers import Status, minimise
from protochain.structure import Structure, from_sequence, load
from protochain.structure.write import as_text

REFERENCE = "OpenMM's Reference platform, double precision"
SOLVENTS = ("vacuum", "obc2", "gbn2")
CLOSEST = 1e-6
"""nm. Atoms nearer than this act as at this distance (``energies.native.pairs.CLOSEST``)."""


@cache
def peptide(sequence: str) -> Structure:
    """Extended peptide."""
    return from_sequence(sequence)


@cache
def energy_of(sequence: str, solvent: str, threads: int, cutoff: float | None = None) -> Energy:
    """Native energy of a peptide."""
    return energy(peptide(sequence), solvent=solvent, engine="native", cutoff=cutoff, threads=threads)


def atom(structure: Structure, residue: int, name: str) -> int:
    """Index of an atom by the number of its residue, from 1, and its name."""
    there = (structure.atom_residue == residue - 1) & (structure.atom_name == name)
    return int(np.flatnonzero(there)[0])


def differs(ours: Energy, x: Floats, at: Floats | None = None) -> Found:
    """Difference of energy and forces from the Reference platform, relative to the size of their parts."""
    value, forces = ours(x)
    expected, theirs = ours.reference(x if at is None else at)
    return Found(_apart(value - expected, forces, theirs, _parts(ours, x)), _rounded(x), REFERENCE)


def _parts(ours: Energy, x: Floats) -> float:
    """Sum of the sizes of an energy's parts."""
    return sum(abs(part) for part in ours.parts(x)[0].values())


def _apart(value: float, forces: Floats, expected: Floats, parts: float) -> float:
    """Difference of energies relative to their parts, or of forces relative to the largest."""
    return max(abs(value) / parts, float(np.abs(forces - expected).max() / np.abs(expected).max()))


def _rounded(x: Floats) -> float:
    """Relative error of an energy: 1e-12 of the polynomials in it, and the rounding of a distance.

    Coordinates are rounded by eps of their size, and a distance r by that over r; the steepest term is its
    thirteenth power. The least distance that counts is ``CLOSEST``, the least that is there is measured.
    """
    gaps = np.linalg.norm(x[:, None] - x[None], axis=2) + np.eye(len(x))
    nearest = max(float(gaps.min()), CLOSEST)
    # The Reference platform's angles by arc cosines lose half of their digits when they are 0 or pi.
    return 1e-10 + 13 * EPS * (1.0 + float(np.abs(x - x.mean(axis=0)).max())) / nearest


PAIRS = {
    "like charges": ("KAK", (1, "NZ"), (3, "NZ")),
    "unlike charges": ("KAE", (1, "NZ"), (3, "OE1")),
    "no charges": ("AAA", (1, "CB"), (3, "CB")),
    "hydrogens without radius": ("SAS", (1, "HG"), (3, "HG")),
}
"""Two atoms that are not bonded; hydroxyl hydrogens have no Lennard-Jones term that keeps them apart."""


def met(pair: str, distance: float, solvent: str, threads: int) -> Found:
    """Put one atom at a distance from another."""
    sequence, (_, first), (_, second) = PAIRS[pair][0], PAIRS[pair][1], PAIRS[pair][2]
    s, ours = peptide(sequence), energy_of(sequence, solvent, threads)
    i, j = atom(s, 1, first), atom(s, 3, second)
    along = np.array([0.6, 0.0, 0.8])
    # The one atom at the origin, so that the smallest distances are not rounded away.
    x = s.positions - s.positions[j]
    x[i] = distance * along
    if distance >= CLOSEST:
        return differs(ours, x)
    # The energy is that of the least distance; its direction is not known, so forces are only finite.
    value, forces = ours(x)
    x[i] = CLOSEST * along
    expected = ours.reference(x)[0]
    error = abs(value / expected - 1.0) if np.isfinite(forces).all() else np.nan
    # The distance itself is rounded at coordinates of a nm.
    return Found(error, 13 * 10 * EPS / CLOSEST, f"{REFERENCE}, at {CLOSEST:g} nm")


def shifted(shift: float, solvent: str, threads: int) -> Found:
    """Energy and forces far from the origin, against a copy moved back; says how many digits are lost."""
    s, ours = peptide("KAED"), energy_of("KAED", solvent, threads)
    x = s.positions + np.array([shift, -shift, 0.5 * shift])
    back = x - np.array([shift, -shift, 0.5 * shift])
    (value, forces), (expected, theirs) = ours(x), ours(back)
    parts = _parts(ours, back)
    error = _apart(value - expected, forces, theirs, parts)
    at_home = ours(s.positions)[0]
    lost = abs(value - at_home) / parts / EPS
    note = f"{np.log10(max(lost, 1.0)):.1f} digits lost to the rounding of positions"
    # Moving back is exact, so that distances are the same numbers; sums may come in another order.
    return Found(error, 1e3 * EPS, "the copy moved back", note)


def turned(shift: float, solvent: str, threads: int) -> Found:
    """Energy of a peptide turned over, at a distance from the origin."""
    s, ours = peptide("KAED"), energy_of("KAED", solvent, threads)
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    x = s.positions @ turn.T + shift
    (value, forces), (expected, theirs) = ours(x), ours(s.positions)
    largest = np.abs(theirs).max()
    error = float(np.abs(forces - theirs @ turn.T).max() / largest)
    error = max(error, abs(value - expected) / _parts(ours, x))
    # A spring of a bond, of 5e5 kJ/mol/nm^2, feels the rounding of its atoms' positions.
    return Found(error, 1e-10 + 10 * 5e5 * EPS * (abs(shift) + 3.0) / largest, "the copy as it was")


def scaled(scale: float, solvent: str, threads: int) -> Found:
    """All positions scaled: Born radii near their limits where atoms are dense, and where they are alone."""
    s, ours = peptide("KAEDW"), energy_of("KAEDW", solvent, threads)
    middle = s.positions.mean(axis=0)
    return differs(ours, middle + scale * (s.positions - middle))


def on_a_line(s: Structure, off: float) -> tuple[Floats, Floats, Floats]:
    """Positions with N, CA and C of the second residue this far (relative) off a line; along it, across."""
    x = s.positions.copy()
    n, ca, c = (atom(s, 2, name) for name in ("N", "CA", "C"))
    along = (x[ca] - x[n]) / np.linalg.norm(x[ca] - x[n])
    across = np.cross(along, [0.3, 0.2, 0.9])
    across /= np.linalg.norm(across)
    x[c] = x[ca] + 0.15 * (along + off * across)
    return x, along, across


def off_line(off: float, solvent: str, threads: int) -> Found:
    """Force on C of a residue whose N, CA and C are almost on a line, against differences."""
    s, ours = peptide("GAG"), energy_of("GAG", solvent, threads)
    x, along, across = on_a_line(s, off)
    c = atom(s, 2, "C")
    value, forces = ours(x)
    if off < 1e-9:
        # The dihedral is rounding error; the force, which is its inverse, is bounded.
        return _finite(value, forces)
    h = 1e-3 * 0.15 * off
    # Across both: the direction in which the dihedral turns.
    way = np.cross(along, across)
    near = [ours(_moved(x, c, d * h * way))[0] for d in (-2, -1, 1, 2)]
    expected = -(near[0] - 8 * near[1] + 8 * near[2] - near[3]) / (12 * h)
    size = float(np.linalg.norm(forces[c]))
    error = abs(float(forces[c] @ way) - expected) / size
    # Of order four, of a step of 1e-3 of the distance; energies are rounded, and positions by eps.
    bound = 1e-10 + 100 * EPS * abs(value) / (h * size) + 10 * EPS * np.abs(x).max() / h
    return Found(error, bound, "differences of order four")


def _moved(x: Floats, i: int, by: Floats) -> Floats:
    x = x.copy()
    x[i] += by
    return x


def _finite(value: float, forces: Floats, note: str = "") -> Found:
    finite = np.isfinite(value) and np.isfinite(forces).all()
    return Found(0.0 if finite else np.nan, 0.0, "finite: energy and forces", note)


def coincident(what: str, solvent: str, threads: int) -> Found:
    """Bonded atoms on one point, or all atoms in a plane, on a line or a point: all is finite."""
    s, ours = peptide("GAG"), energy_of("GAG", solvent, threads)
    x = s.positions.copy()
    if what == "two bonded atoms":
        x[atom(s, 2, "C")] = x[atom(s, 2, "CA")]
    elif what == "all hydrogens":
        x[s.atom_element == "H"] = x[0]
    else:
        x[:, : {"a plane": 1, "a line": 2, "a point": 3}[what]] = 0.0
    value, forces = ours(x)
    return _finite(value, forces, f"{value:.3g} kJ/mol")


def denormal(solvent: str, threads: int) -> Found:
    """Coordinates of 1e-310 nm instead of 0: the same bits."""
    s, ours = peptide("KAED"), energy_of("KAED", solvent, threads)
    x = s.positions.copy()
    zero, tiny = x.copy(), x.copy()
    zero[:5, 0], tiny[:5, 0] = 0.0, 1e-310
    (value, forces), (expected, theirs) = ours(tiny), ours(zero)
    same = value == expected and np.array_equal(forces, theirs)
    return Found(0.0 if same else abs(value - expected), 0.0, "the same with 0, bit for bit")


def not_a_number(value: float, solvent: str, threads: int) -> Found:
    """One coordinate that is no number: an infinite energy, no forces, and the next call is right again."""
    s, ours = peptide("KAED"), energy_of("KAED", solvent, threads)
    x = s.positions.copy()
    x[3, 1] = value
    found, forces = ours(x)
    said = found == np.inf and np.isnan(forces).all()
    after = differs(ours, s.positions)
    return after if said else Found(np.nan, after.bound, "infinite energy, forces NaN")


def far_and_back(cutoff: float, solvent: str, threads: int) -> Found:
    """Lists of neighbours when atoms jump by nanometres, and back, against the Reference platform."""
    s, ours = peptide("KAEDWKAEDW"), energy_of("KAEDWKAEDW", solvent, threads, cutoff)
    worst = Found(0.0, 1.0, REFERENCE)
    for jump in (0.0, 5.0, 0.04, -3.0, 0.0):
        x = s.positions.copy()
        x[: s.n_atoms // 2, 2] += jump
        found = differs(ours, x)
        worst = max(worst, found, key=lambda each: each.error / each.bound)
    return worst


def left_out(distance: float, solvent: str, threads: int) -> Found:
    """Torques without the constant terms, with two atoms at a distance, against the Reference platform's."""
    s, ours = peptide("KAE"), energy_of("KAE", solvent, threads)
    made = build_chain(s)
    less = ours.without_constants(made.rigid_groups, s.positions)
    # A turn of the last chi that brings a hydrogen near an atom: hinges keep the groups rigid.
    at = pose(made, made.q0 + distance * np.random.default_rng(2).normal(size=made.n_q))
    torque = pull_back(made, Pose(at.q, at.frames, at.x), less(at.x)[1])
    expected = pull_back(made, at, ours.reference(at.x)[1])
    error = float(np.abs(torque - expected).max() / np.abs(expected).max())
    # Constant terms of 1e5 kJ/mol/nm cancel in the torques of the reference.
    return Found(error, 1e-10 + 1e5 * 1e2 * EPS / np.abs(expected).max(), REFERENCE)


def copies(s: Structure, n: int, apart: ArrayLike = (0.0, 2.0, 0.0)) -> Structure:
    """Copies of an extended peptide as chains of one structure, each this far (nm) from the last."""
    beside = np.array([0.0, 2.0, 0.0])
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"{n}_chains.pdb"
        atoms = [line for line in as_text(s, ".pdb").splitlines() if line.startswith("ATOM")]
        text = []
        for k, chain in enumerate("ABCDEFGHIJ"[:n]):
            for line in atoms:
                y = float(line[38:46]) + 10.0 * beside[1] * k
                text.append(f"{line[:21]}{chain}{line[22:38]}{y:8.3f}{line[46:]}")
            text.append("TER")
        path.write_text("\n".join([*text, "END", ""]))
        many = load(path)
    # Moved once they are read, for a file in which one chain lies upon another is refused.
    numbers = np.repeat(np.arange(n), many.n_atoms // n)[:, None]
    return many.with_positions(many.positions + numbers * (np.asarray(apart) - beside))


def large(how: str, solvent: str, threads: int) -> Found:
    """A hundred residues of all kinds, whose pairs several threads share, extended or crossing themselves."""
    sequence = "ACDEFGHIKLMNPQRSTVWY" * 5
    s, ours = peptide(sequence), energy_of(sequence, solvent, threads)
    if how == "extended":
        return differs(ours, s.positions)
    made = build_chain(s)
    turn = np.random.default_rng(5).uniform(-np.pi, np.pi, made.n_q)
    return differs(ours, pose(made, made.q0 + turn).x)


def ten_chains(apart: float, solvent: str, threads: int) -> Found:
    """Ten copies of a peptide on top of one another, or this far (nm) apart."""
    ten = copies(peptide("GA"), 10, (apart, 0.0, 0.0))
    ours = energy(ten, solvent=solvent, engine="native", cutoff=None, threads=threads)
    if apart:
        return differs(ours, ten.positions)
    value, forces = ours(ten.positions)
    return _finite(value, forces, f"{value:.3g} kJ/mol")


def refuses(attempt: Callable[[int], Any], threads: int) -> Found:
    """Input that has no answer: anything but a refusal, or a verdict that says so, is wrong."""
    given = attempt(threads)
    said = getattr(given, "status", None) is Status.NON_FINITE
    return Found(0.0 if said else np.nan, 0.0, "the status non-finite", str(given))


def _one_atom(threads: int) -> Any:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "one.pdb"
        path.write_text(
            "ATOM      1  CA  ALA A   1       0.000   0.000   0.000  1.00  0.00           C\nEND\n"
        )
        try:
            return load(path)
        except OnlyAlphaError:
            # Without the folder's name, which differs each time.
            raise OnlyAlphaError(f"{path.name}: holds only C-alpha atoms") from None


def _nan_q(threads: int) -> Any:
    made = build_chain(peptide("KAED"))
    return simulate(made, energy_of("KAED", "vacuum", threads), np.full(made.n_q, np.nan), n_steps=1)


def _at(value: float, threads: int) -> Any:
    return peptide("KAED").with_positions(np.full((peptide("KAED").n_atoms, 3), value))


def _given(result: tuple[float, Any], threads: int) -> Any:
    """Minimise a callable that returns this, its forces in the shape of positions if they are one number."""
    value, forces = result
    return minimise(
        peptide("GA"), lambda x: (value, np.full_like(x, forces) if forces is not None else 0.0), "lbfgs"
    )


NO_ANSWER: dict[str, tuple[Callable[[int], Any], Refusal]] = {
    "a file of one atom": (_one_atom, Fault.ONLY_ALPHA),
    "a structure at NaN": (partial(_at, np.nan), Fault.NOT_FINITE),
    "a structure at infinity": (partial(_at, np.inf), Fault.NOT_FINITE),
    "dynamics from angles NaN": (_nan_q, Fault.NOT_FINITE),
    "a callable whose energy is NaN": (partial(_given, (np.nan, 0.0)), None),
    "a callable whose forces are infinite": (partial(_given, (0.0, np.inf)), None),
    "a callable whose forces have no shape": (partial(_given, (0.0, None)), Fault.SHAPE),
    "a cutoff below the lists": (
        lambda threads: energy(peptide("GA"), engine="native", cutoff=0.01)(peptide("GA").positions),
        Argument("cutoff"),
    ),
}
"""Attempts, with the refusal expected; a run on a callable ends, with a status that says so."""


def _cases() -> Iterator[Case]:
    for solvent in SOLVENTS:
        part = Part.TESTED if solvent == "obc2" else Part.QUICK
        for pair in PAIRS:
            for distance in (0.0, 5e-324, 1e-310, 1e-100, 1e-6, 1e-5, 1e-4, 1e-3, 0.01, 0.05, 0.1, 0.2):
                yield Case(pair, f"{distance:g} nm, {solvent}", partial(met, pair, distance, solvent), part)
        for shift in (1.0, 1e3, 1e6, 1e9):
            yield Case(
                "far from the origin", f"{shift:g} nm, {solvent}", partial(shifted, shift, solvent), part
            )
        for shift in (0.0, 1e3, 1e6):
            yield Case("turned over", f"at {shift:g} nm, {solvent}", partial(turned, shift, solvent), part)
        for scale in (0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0, 1.2, 10.0, 1e3):
            yield Case("scaled", f"by {scale:g}, {solvent}", partial(scaled, scale, solvent), part)
        for off in (1e-1, 1e-3, 1e-5, 1e-7, 1e-9, 1e-12, 0.0):
            yield Case(
                "N, CA, C on a line", f"off it by {off:g}, {solvent}", partial(off_line, off, solvent), part
            )
        for what in ("two bonded atoms", "all hydrogens", "a plane", "a line", "a point"):
            yield Case("coincident", f"{what}, {solvent}", partial(coincident, what, solvent), part)
        yield Case("denormals", solvent, partial(denormal, solvent), part)
        for value in (np.nan, np.inf, -np.inf):
            yield Case("not a number", f"{value}, {solvent}", partial(not_a_number, value, solvent), part)
        for cutoff in (0.8, 1.0, 2.0, 3.0):
            yield Case(
                "jumps with a cutoff", f"{cutoff:g} nm, {solvent}", partial(far_and_back, cutoff, solvent)
            )
        for turn in (0.0, 0.3, 1.0, 3.0):
            yield Case(
                "constant terms left out", f"{turn:g} rad, {solvent}", partial(left_out, turn, solvent)
            )
        for how in ("extended", "crossing itself"):
            yield Case("hundred residues", f"{how}, {solvent}", partial(large, how, solvent), Part.FULL)
        for apart in (0.0, 1e-3, 0.01, 0.1):
            yield Case("ten chains", f"{apart:g} nm apart, {solvent}", partial(ten_chains, apart, solvent))
    for what, (attempt, refusal) in NO_ANSWER.items():
        yield Case("no answer", what, partial(refuses, attempt), Part.TESTED, refusal)


CASES = tuple(_cases())
