"""Connolly's molecular surface in dots, from a probe that rolls over atoms and rests between them.

Connolly, Science 221:709 (1983). Convex parts lie on atoms, saddles on the probe as it rolls along two of
them, concave parts on the probe at rest on three. The neighbours of two atoms limit the arcs of
the probe around them, which follow in closed form. The probe rests at the ends of the arcs.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from protochain.core.arrays import Floats, Integers, Value, cross, sphere

_SAME = 1e-6  # angstrom. Shorter distances between two places of the probe are rounding.


@dataclass(frozen=True, eq=False)
class Dots(Value):
    """Dots on a surface."""

    x: Floats  # (n, 3) angstrom.
    normal: Floats  # (n, 3): Unit vectors out of the molecule.
    area: Floats  # (n,) angstrom^2: Area of each dot.
    probe: Floats  # (n, 3) angstrom: Centre of the probe that touches the dot.

    def __len__(self) -> int:
        return len(self.x)

    def __getitem__(self, index: NDArray[np.bool_] | Integers) -> "Dots":
        return Dots(self.x[index], self.normal[index], self.area[index], self.probe[index])


def molecular_surface(
    x: Floats, radius: Floats, probe: float, density: float, mask: NDArray[np.bool_] | None = None
) -> Dots:
    """Cover the molecular surface of the atoms in a mask (n,) with dots: x (n, 3), angstrom, 1/angstrom^2."""
    atom = np.arange(len(x)) if mask is None else np.flatnonzero(mask)
    if not len(atom):
        empty = np.zeros((0, 3))
        return Dots(empty, empty, np.zeros(0), empty)
    reach, tree = radius + probe, cKDTree(x)
    candidates = tree.query_ball_point(x[atom], reach[atom] + reach.max(), return_sorted=True)
    neighbours = []
    for i, near in zip(atom.tolist(), map(np.array, candidates), strict=True):
        # Of these the spheres of the probe's centre cross that of the atom, or swallow it.
        meets = np.linalg.norm(x[near] - x[i], axis=1) < reach[i] + reach[near]
        neighbours.append(near[meets & (near != i)])
    convex = [
        _convex(x, radius, probe, density, i, near) for i, near in zip(atom.tolist(), neighbours, strict=True)
    ]
    saddles, rests, corners = _roll_probe(x, reach, probe, density, atom, neighbours)
    concave = _concave(x, rests, corners, probe, density)
    parts = [*convex, *_outside([saddles, concave], rests, probe)]
    return Dots(*map(np.concatenate, zip(*((p.x, p.normal, p.area, p.probe) for p in parts), strict=True)))


def _convex(x: Floats, radius: Floats, probe: float, density: float, i: int, near: Integers) -> Dots:
    """Dots on atom i at which the probe meets no neighbour."""
    area = 4.0 * np.pi * radius[i] ** 2
    way = sphere(max(int(np.ceil(area * density)), 1))
    share, reach = area / len(way), radius[i] + probe
    if len(near):
        arm = x[near] - x[i]
        square = (arm**2).sum(axis=1)
        limit = (square + reach**2 - (radius[near] + probe) ** 2) / (2.0 * reach)
        way = way[(way @ arm.T <= limit).all(axis=1)]
    return Dots(x[i] + radius[i] * way, way, np.full(len(way), share), x[i] + reach * way)


def _roll_probe(
    x: Floats, reach: Floats, probe: float, density: float, atom: Integers, neighbours: list[Integers]
) -> tuple[Dots, Floats, Integers]:
    """Saddles, the places (n, 3) of the probe at rest on three atoms, and these atoms (n, 3)."""
    # Pairs of neighbours, and the circle of centres of the probe that touches both atoms.
    counts = np.array([len(near) for near in neighbours], dtype=np.int64)
    start = np.concatenate([[0], np.cumsum(counts)])
    flat = np.concatenate([np.empty(0, dtype=np.int64), *neighbours])
    owner = np.repeat(np.arange(len(atom)), counts)
    keep = np.isin(flat, atom) & (flat > atom[owner])
    keep &= np.linalg.norm(x[flat] - x[atom[owner]], axis=1) > _SAME
    owner, j = owner[keep], flat[keep]
    i = atom[owner]
    arm = x[j] - x[i]
    distance = np.linalg.norm(arm, axis=1)
    axis = arm / distance[:, None]
    along = (distance**2 + reach[i] ** 2 - reach[j] ** 2) / (2.0 * distance)
    square = reach[i] ** 2 - along**2
    crosses = square > 0.0
    owner, i, j, distance, axis, along = (v[crosses] for v in (owner, i, j, distance, axis, along))
    h = np.sqrt(square[crosses])
    centre = x[i] + along[:, None] * axis
    e1 = cross(axis, np.eye(3)[np.argmin(np.abs(axis), axis=1)])
    e1 /= np.linalg.norm(e1, axis=1, keepdims=True)
    e2 = cross(axis, e1)
    # Each pair with each further neighbour of its first atom.
    pair, m = _number_items(counts[owner])
    k = flat[start[owner[pair]] + m]
    third = k != j[pair]
    pair, k = pair[third], k[third]
    arm = x[k] - centre[pair]
    height = (arm * axis[pair]).sum(axis=1)
    u, v = (arm * e1[pair]).sum(axis=1), (arm * e2[pair]).sum(axis=1)
    off = np.hypot(u, v)
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = (h[pair] ** 2 + off**2 + height**2 - reach[k] ** 2) / (2.0 * h[pair] * off)
    # On the axis a third atom hides the whole circle or nothing of it.
    cosine = np.where(off > _SAME, cosine, np.where(np.hypot(h[pair], height) < reach[k], -1.0, 1.0))
    hidden = np.zeros(len(i), dtype=bool)
    hidden[pair[cosine <= -1.0]] = True
    cuts = (cosine < 1.0) & (cosine > -1.0) & ~hidden[pair]
    pair, k, half = pair[cuts], k[cuts], np.arccos(cosine[cuts])
    arcs = _free_arcs(pair, np.arctan2(v, u)[cuts], half, k, hidden)
    on, begin, end = arcs.circle, arcs.begin, arcs.end
    # Saddles follow from the free arcs. The probe rests at their ends.
    saddles = _saddles(
        arcs, centre[on], axis[on], e1[on], e2[on], h[on], along[on], distance[on], probe, density
    )
    ends = np.concatenate([np.column_stack([on, k_of]) for k_of in (arcs.before, arcs.after)])
    angle = np.concatenate([begin, end])
    real = ends[:, 1] >= 0
    ends, angle = ends[real], angle[real]
    at, corners = ends[:, 0], np.column_stack([i[ends[:, 0]], j[ends[:, 0]], ends[:, 1]])
    places = centre[at] + h[at, None] * (np.cos(angle)[:, None] * e1[at] + np.sin(angle)[:, None] * e2[at])
    # Each place is the end of an arc of all three pairs.
    is_covered = np.isin(corners[:, 2], atom)
    places, corners = places[is_covered], np.sort(corners[is_covered], axis=1)
    key = np.column_stack([corners, np.round(places / 1e-3)])
    first = np.unique(key, axis=0, return_index=True)[1]
    return saddles, places[first], corners[first]


@dataclass(frozen=True)
class _Arcs:
    """Free arcs of circles: the circle of each, its ends in rad, the atoms that end it (-1: a whole one)."""

    circle: Integers
    begin: Floats
    end: Floats
    before: Integers
    after: Integers


def _free_arcs(
    circle: Integers, middle: Floats, half: Floats, atom: Integers, hidden: NDArray[np.bool_]
) -> _Arcs:
    """Arcs of circles that no interval (middle - half, middle + half) covers."""
    n, turn = len(hidden), 2.0 * np.pi
    begin, end = (middle - half) % turn, (middle + half) % turn
    over = np.bincount(circle, (begin > end), n).astype(np.int64)
    event_circle = np.concatenate([circle, circle])
    angle = np.concatenate([begin, end])
    step = np.repeat([1, -1], len(circle))
    event_atom = np.concatenate([atom, atom])
    order = np.lexsort((-step, angle, event_circle))
    event_circle, angle, step, event_atom = event_circle[order], angle[order], step[order], event_atom[order]
    total = np.cumsum(step)
    first = np.searchsorted(event_circle, np.arange(n))
    before = np.where(first > 0, total[np.maximum(first, 1) - 1], 0) if len(total) else np.zeros(n, int)
    covered = total - before[event_circle] + over[event_circle]
    # An arc is free from the event after which nothing covers to the next one of its circle, the first again.
    free = np.flatnonzero((covered == 0) & (step == -1))
    last = np.searchsorted(event_circle, np.arange(n), side="right") - 1
    wraps = free == last[event_circle[free]]
    following = np.where(wraps, first[event_circle[free]], free + 1)
    stop = angle[following] + np.where(wraps, turn, 0.0)
    full = np.setdiff1d(np.flatnonzero(~hidden), circle)
    none = np.full(len(full), -1)
    return _Arcs(
        np.concatenate([event_circle[free], full]),
        np.concatenate([angle[free], np.zeros(len(full))]),
        np.concatenate([stop, np.full(len(full), turn)]),
        np.concatenate([event_atom[free], none]), np.concatenate([event_atom[following], none]),
    )  # fmt: skip


def _saddles(
    arcs: _Arcs, centre: Floats, axis: Floats, e1: Floats, e2: Floats, h: Floats, along: Floats,
    distance: Floats, probe: float, density: float,
) -> Dots:  # fmt: skip
    """Dots of the probe as it rolls along two atoms, n arcs of centres about an axis at distance h (n,)."""
    low, high = -np.arctan2(along, h), np.arctan2(distance - along, h)
    across = np.maximum(np.ceil(probe * (high - low) * np.sqrt(density)).astype(np.int64), 1)
    arc, m = _number_items(across)
    tilt = low[arc] + (high - low)[arc] * (m + 0.5) / across[arc]
    off = h[arc] - probe * np.cos(tilt)
    arc, tilt, off = arc[off > 0.0], tilt[off > 0.0], off[off > 0.0]  # Within, the probe meets itself.
    width = (arcs.end - arcs.begin)[arc]
    around = np.maximum(np.ceil(off * width * np.sqrt(density)).astype(np.int64), 1)
    row, m = _number_items(around)
    arc, tilt, off, width, around = arc[row], tilt[row], off[row], width[row], around[row]
    angle = arcs.begin[arc] + width * (m + 0.5) / around
    away = np.cos(angle)[:, None] * e1[arc] + np.sin(angle)[:, None] * e2[arc]
    place = centre[arc] + h[arc, None] * away
    normal = np.cos(tilt)[:, None] * away - np.sin(tilt)[:, None] * axis[arc]
    area = probe * ((high - low) / across)[arc] * off * width / around
    return Dots(place - probe * normal, normal, area, place)


def _number_items(counts: Integers) -> tuple[Integers, Integers]:
    """Row of each of so many (n,) items, and its number in the row."""
    row = np.repeat(np.arange(len(counts)), counts)
    return row, np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)


def _concave(x: Floats, rests: Floats, corners: Integers, probe: float, density: float) -> Dots:
    """Dots on the probe at rest (n, 3), in the triangles of the three atoms (n, 3) that it touches."""
    way = sphere(int(np.ceil(4.0 * np.pi * probe**2 * density)))
    arms = x[corners] - rests[:, None]
    flat = np.abs(np.linalg.det(arms)) < _SAME
    rests, arms = rests[~flat], arms[~flat]
    # A way within the triangle is a sum of the three arms, with no negative part.
    parts = np.einsum("nij,mi->nmj", np.linalg.inv(arms), way)
    row, m = np.nonzero((parts >= 0.0).all(axis=2))
    area = np.full(len(row), 4.0 * np.pi * probe**2 / len(way))
    return Dots(rests[row] + probe * way[m], -way[m], area, rests[row])


def _outside(parts: list[Dots], rests: Floats, probe: float) -> list[Dots]:
    """Dots of the probe that it does not sweep away at rest elsewhere."""
    if not len(rests):
        return parts
    tree = cKDTree(rests)
    return [dots[np.asarray(tree.query(dots.x)[0] > probe - _SAME)] if len(dots) else dots for dots in parts]
