"""Scenes of energies: which terms and pairs a run needs not sum."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from bench.studies.omissions.cells import Answer, Counted, Material, Omission, TwoWays, native
from protochain.chains.articulate import build_chain
from protochain.chains.chain import Chain, pose, pull_back
from protochain.core.arrays import Floats, Integers
from protochain.energies import NativeEnergy, energy
from protochain.energies.native.evaluate import Layout, lists_of
from protochain.energies.native.evaluation import Evaluation, Workspace
from protochain.energies.native.implicit import Necks
from protochain.energies.native.neighbours import Lists, partners
from protochain.energies.native.terms import Terms
from protochain.mechanics.multibody import integrate
from protochain.minimisers.problem import Space, evaluate
from protochain.minimisers.spaces import Cartesian, Torsions
from protochain.structure import Structure, load

TURN, SHIFT = 0.005, 0.001
"""rad and nm: how far the points lie from the start at which answers are compared."""
CUTOFF = 1.0
"""nm, where there is one."""
_NECK = 0.7
"""nm. Reach of a neck of GBn2: both radii and 0.36 nm."""


def turned(chain: Chain) -> list[Floats]:
    """Coordinates of the start, and of two points near it."""
    rng = np.random.default_rng(7)
    steps = [rng.normal(scale=TURN, size=chain.n_v) for _ in range(2)]
    return [chain.q0, *(integrate(chain.tree, chain.q0, step) for step in steps)]


def sizes_of(whole: NativeEnergy, x: Floats) -> tuple[float, float]:
    """What energies and forces of a whole system are sums of: sizes for their errors."""
    parts, forces = whole.parts(x)
    return float(sum(map(abs, parts.values()))), float(np.linalg.norm(forces))


def evaluated(space: Space, of: NativeEnergy, q: Floats) -> Answer:
    """Energy and torques, or forces, of an evaluation, as minimisers make it."""
    at = evaluate(space, of, q)
    return at.energy, space.outward(at.x, at.torque) if isinstance(space, Cartesian) else at.torque


def counted(of: NativeEnergy, chain: Chain | None = None) -> Counted:
    """Counts of an energy with the lists in use."""
    return lambda: {**of.operation_counts, "bodies": chain.n_bodies if chain else 0}


def constants(material: Material, solvent: str, hinges: str, move: str) -> TwoWays:
    """Terms that are constant in a chain's bodies: summed, and left out."""
    chain = build_chain(material.structure, hinges, move=move)
    space, whole = Torsions(chain), material.energy(solvent)
    less = native(whole.without_constants(chain.rigid_groups, material.structure.positions))
    return TwoWays(
        partial(evaluated, space, whole), partial(evaluated, space, less), turned(chain),
        lambda q: sizes_of(whole, pose(chain, q).x), (counted(whole, chain), counted(less, chain)),
        f"{chain.n_v} freedoms; constant: {_said(less.left_out)}",
    )  # fmt: skip


def region(material: Material, solvent: str, move: str) -> TwoWays:
    """A region that turns: all hinges free, each way without its constant terms, and the region's alone."""
    s, whole = material.structure, material.energy(solvent)
    every, own = build_chain(s), build_chain(s, move=move)
    of_every, of_own = (
        native(whole.without_constants(each.rigid_groups, s.positions)) for each in (every, own)
    )
    places = {hinge.atoms: i for i, hinge in enumerate(every.hinges)}
    which = [places[hinge.atoms] for hinge in own.hinges]
    coordinate, freedom = _hinges_of(every, which)
    own_coordinate, own_freedom = _hinges_of(own, range(own.n_hinges))

    space_of_every, space_of_own = Torsions(every), Torsions(own)

    def all_hinges(q: Floats) -> Answer:
        at = every.q0.copy()
        at[coordinate] = q[own_coordinate]
        found = evaluate(space_of_every, of_every, at)
        return found.energy, found.torque[freedom]

    def few_hinges(q: Floats) -> Answer:
        found = evaluate(space_of_own, of_own, q)
        return found.energy, found.torque[own_freedom]

    return TwoWays(
        all_hinges, few_hinges, turned(own), lambda q: sizes_of(whole, pose(own, q).x),
        (counted(of_every, every), counted(of_own, own)),
        f"{own.n_v} of {every.n_v} freedoms",
    )  # fmt: skip


def _hinges_of(chain: Chain, which: "list[int] | range") -> tuple[Integers, Integers]:
    """Places of hinges in q and in the torques."""
    bodies = chain.hinge_body[list(which)]
    return chain.tree.q_start[bodies], chain.tree.v_start[bodies]


def atoms_of_region(material: Material, solvent: str, move: str) -> TwoWays:
    """A region whose atoms move alone: everything summed, and what is constant among the others left out."""
    s, whole = material.structure, material.energy(solvent)
    moving = build_chain(s, move=move).moving
    space = Cartesian(s, moving)
    less = native(whole.without_constants(np.where(moving, -1, 0)[:, None], s.positions))
    return TwoWays(
        partial(evaluated, space, whole), partial(evaluated, space, less), shifted(s, moving),
        lambda x: sizes_of(whole, x.reshape(-1, 3)), (counted(whole), counted(less)),
        f"{moving.sum()} of {s.n_atoms} atoms; constant: {_said(less.left_out)}",
    )  # fmt: skip


def shifted(s: Structure, moving: np.ndarray) -> list[Floats]:
    """Flat positions of the start, and of two points near it."""
    rng, points = np.random.default_rng(8), [s.positions.flatten()]
    for _ in range(2):
        x = s.positions.copy()
        x[moving] += rng.normal(scale=SHIFT, size=(moving.sum(), 3))
        points.append(x.flatten())
    return points


def all_atoms(material: Material) -> TwoWays:
    """All atoms move: with the sweeps over the chain, whose torques nothing asks for, and without."""
    s, whole = material.structure, material.energy("obc2")
    chain, moving = build_chain(s), np.ones(s.n_atoms, dtype=bool)
    at = pose(chain, chain.q0)

    def with_sweeps(x: Floats) -> Answer:
        value, forces = whole(x.reshape(-1, 3))
        pull_back(chain, pose(chain, at.q), forces)
        return value, forces.ravel()

    return TwoWays(
        with_sweeps, partial(evaluated, Cartesian(s, moving), whole), shifted(s, moving),
        lambda x: sizes_of(whole, x.reshape(-1, 3)), (counted(whole, chain), counted(whole)),
        "bodies, and torques of hinges",
    )  # fmt: skip


def _said(left_out: Mapping[str, int]) -> str:
    return ", ".join(f"{n} {kind}" for kind, n in left_out.items())


def layout_of(terms: Terms) -> Layout:
    """Layout of all terms, without rigid groups."""
    n = terms.n_atoms
    return Layout(terms, np.full((n, 1), -1), partners(terms.nonbonded.exceptions.atoms, n))


def summed(terms: Terms, x: Floats, lists: Lists | None = None) -> Evaluation:
    """Evaluation of all terms, with given lists or those of x."""
    layout = layout_of(terms)
    lists = lists or lists_of(layout, x)
    return Evaluation(layout, lists, np.zeros(terms.n_atoms), Workspace(layout), 1)


def parts_of(evaluation: Evaluation, x: Floats) -> Answer:
    """Energies by kind, and forces."""
    parts, forces = evaluation(x)
    return np.array(list(parts.values())), forces


def two_sums(
    ways: tuple[Evaluation, Evaluation], layouts: tuple[Layout, Layout], x: Floats, what: str
) -> TwoWays:
    """Two evaluations of one energy at one point."""
    first, second = (
        {"pairs": layout.pairs_of(way.lists), "lists": len(way.lists.close)}
        for way, layout in zip(ways, layouts, strict=True)
    )
    parts, forces = parts_of(ways[1], x)
    sizes = float(np.abs(parts).sum()), float(np.linalg.norm(forces))
    return TwoWays(
        partial(parts_of, ways[0]), partial(parts_of, ways[1]), [x], lambda _: sizes,
        (lambda: first, lambda: second), what,
    )  # fmt: skip


def terms_alone(whole: Terms, less: Terms, x: Floats, what: str) -> TwoWays:
    """Two sets of terms on all atoms, the one with terms that are zero."""
    ways = summed(whole, x), summed(less, x)
    return two_sums(ways, (layout_of(whole), layout_of(less)), x, what)


def vacuum(material: Material) -> TwoWays:
    """In vacuum: with a solvent of no charge and no surface, and without one."""
    plain, solvated = (material.energy(solvent).terms for solvent in ("vacuum", "obc2"))
    assert solvated.solvent is not None
    zero = np.zeros(plain.n_atoms)
    idle = replace(solvated.solvent, charge=zero, surface=zero)
    what = "Born radii, polar and surface energy"
    return terms_alone(replace(plain, solvent=idle), plain, material.structure.positions, what)


def born(material: Material) -> TwoWays:
    """In OBC2: with GBn2's necks of no height, and without necks."""
    terms = material.energy("obc2").terms
    assert terms.solvent is not None
    flat, kind = np.zeros((1, 1)), np.zeros(terms.n_atoms, dtype=np.int64)
    idle = replace(terms.solvent, necks=Necks(kind, flat, flat, np.full((1, 1), _NECK)))
    return terms_alone(replace(terms, solvent=idle), terms, material.structure.positions, "necks of GBn2")


def kept(material: Material) -> TwoWays | None:
    """Waters kept in place: their own terms and pairs summed, and left out."""
    if material.path is None:
        return None
    beside = load(material.path, keep=("water",))
    if not beside.obstacle.any():
        return None
    own = Material(beside, material.path)
    both = constants(own, "vacuum", "phi psi chi", "all")
    return replace(both, what=f"{beside.obstacle.sum()} atoms of waters; {both.what}")


def chains(s: Structure) -> TwoWays:
    """Several chains with a cutoff: all pairs visited, and those of the lists."""
    terms, x = native(energy(s, solvent="obc2", cutoff=CUTOFF, threads=1)).terms, s.positions
    layout = layout_of(terms)
    lists = lists_of(layout, x)
    tiles = np.stack(np.triu_indices(len(layout.blocks)), axis=1).astype(np.int64)
    yes = np.ones(len(tiles), dtype=bool)
    every = replace(lists, tiles=tiles, changing=tiles, is_near=yes, is_necked=yes)
    ways = summed(terms, x, every), summed(terms, x, lists)
    return two_sums(ways, (layout, layout), x, f"tiles of blocks beyond {CUTOFF:g} nm")


def residues(s: Structure, first: int, n: int) -> str:
    """Selection of n residues with a C-alpha from the first-th on, or from so far that there are as many."""
    of_alpha = s.atom_residue[s.alpha_carbons]
    chosen = of_alpha[max(0, min(first, len(of_alpha) - n)) :][:n]
    return "index " + " ".join(map(str, np.flatnonzero(np.isin(s.atom_residue, chosen))))


def near_end(m: Material) -> str:
    """The tenth residue: what lies before it turns against what lies behind."""
    return residues(m.structure, 9, 1)


def in_the_middle(m: Material) -> str:
    """The middle residue: half of the chain turns against the other."""
    return residues(m.structure, len(m.structure.alpha_carbons) // 2, 1)


def side_chains(m: Material) -> str:
    """Side chains of the fifth to fourteenth residue."""
    return f"({residues(m.structure, 4, 10)}) and not backbone"


OMISSIONS = (
    Omission("backbone only, vacuum", "all terms", lambda m: constants(m, "vacuum", "phi psi", "all")),
    Omission("backbone only, OBC2", "all terms", lambda m: constants(m, "obc2", "phi psi", "all"), False),
    Omission("all hinges, vacuum", "all terms", lambda m: constants(m, "vacuum", "phi psi chi", "all")),
    Omission("tenth residue, vacuum", "all hinges", lambda m: region(m, "vacuum", near_end(m))),
    Omission("tenth residue, OBC2", "all hinges", lambda m: region(m, "obc2", near_end(m))),
    Omission(
        "middle residue, vacuum", "all hinges", lambda m: region(m, "vacuum", in_the_middle(m)), False
    ),
    Omission(
        "side chains of 10 residues, vacuum", "all hinges", lambda m: region(m, "vacuum", side_chains(m))
    ),
    Omission(
        "side chains of 10 residues, OBC2", "all hinges", lambda m: region(m, "obc2", side_chains(m)), False
    ),
    Omission(
        "atoms of the middle residue, vacuum", "all terms",
        lambda m: atoms_of_region(m, "vacuum", in_the_middle(m)),
    ),
    Omission(
        "atoms of the middle residue, OBC2", "all terms",
        lambda m: atoms_of_region(m, "obc2", in_the_middle(m)), False,
    ),
    Omission("vacuum", "a solvent of no charge", vacuum),
    Omission("generalised Born, OBC2", "necks of no height", born),
    Omission("all atoms, OBC2", "sweeps over the chain too", all_atoms),
    Omission("kept waters, vacuum", "all terms", kept),
)  # fmt: skip
