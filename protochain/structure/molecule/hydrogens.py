"""Placement of hydrogens by geometry.

OpenMM's Modeller places hydrogens at random and minimises. Here equal atoms lead to equal positions. Bond
lengths are from ff14SB. Angles follow the hybridisation of the parent. Methyl and amine hydrogens are
staggered. Hydroxyls and thiols are rotated, one after the other, to the lowest energy: a repulsion and a
Coulomb term with a dielectric of 4 r/angstrom (Gelin, Karplus, Biochemistry 18:1256, 1979).
"""

from collections.abc import Iterable

import gemmi
import numpy as np
from scipy.spatial import KDTree

from protochain.core.arrays import Floats, Integers, cross, dots, sphere
from protochain.core.graph import neighbours

_LENGTH = {"C": 0.109, "N": 0.101, "O": 0.096, "S": 0.1336}  # nm: bond lengths to hydrogen.
_TETRAHEDRAL, _TRIGONAL = np.deg2rad(109.5), np.deg2rad(120.0)
_BENT = {"O": float(np.deg2rad(108.5)), "S": float(np.deg2rad(96.0))}
_WATER = float(np.deg2rad(104.52))
_STAGGERED = np.deg2rad([180.0, 300.0, 60.0])
_TURNS = np.deg2rad(np.arange(0.0, 360.0, 10.0))
_REACH = 0.6  # nm. Cutoff of the energy that orients a hydroxyl.
_COULOMB = 138.935 / 40.0  # kJ/mol nm^2/e^2, with a dielectric of 4 r/angstrom.
_CORE = 0.2  # nm. Distance at which the repulsion of a hydrogen is 1 kJ/mol.
_AT_METAL = 0.3  # nm. Largest distance of a metal-bound oxygen of water: 0.24 at calcium, 0.28 at potassium.
_DECIMALS = 6  # Decimals (nm) of positions, because sine and cosine differ in the last bit between libraries.


def place_hydrogens(x: Floats, element: list[str], charge: Floats, bonds: Integers) -> Floats:
    """Place hydrogens that have no position: x (na, 3) nm, charge (na,) e, bonds (nbonds, 2) int."""
    return _Placement(x, element, charge, bonds).place()


class _Placement:
    """Present positions and the bonded neighbours of each atom."""

    def __init__(self, x: Floats, element: list[str], charge: Floats, bonds: Integers) -> None:
        self.x, self.element, self.charge = np.array(x), element, charge
        self.missing = np.isnan(self.x[:, 0])
        self.rotated: list[int] = []
        self.neighbours = neighbours(bonds, len(element))

    def place(self) -> Floats:
        """Place hydrogens whose position is determined, then those that rotate."""
        parents = dict.fromkeys(self.neighbours[h][0] for h in np.flatnonzero(self.missing).tolist())
        turning = self._place_around_bonds(self._place_opposite(parents))
        fixed = np.flatnonzero(~self.missing)
        self.fixed, self.tree = fixed, KDTree(self.x[fixed])
        metals = {symbol for symbol in {*self.element} if gemmi.Element(symbol).is_metal}
        self.metals = np.array([k for k in fixed.tolist() if self.element[k] in metals], dtype=np.int64)
        for parent in turning:
            self._turn_from_metals(parent)
            for hydrogen in self._hydrogens(parent):
                self._turn(parent, hydrogen)
                self.rotated.append(hydrogen)
        return self.x

    def _place_opposite(self, parents: Iterable[int]) -> list[int]:
        """Place hydrogens opposite two or three bonds, all at once. Return the remaining parents."""
        kinds: dict[tuple[bool, int, int], list[list[int]]] = {}
        remaining = []
        for parent in parents:
            bonded, hydrogens = self._placed_neighbours(parent), self._hydrogens(parent)
            is_one = len(bonded) == 3 or self._is_planar(parent)
            if len(bonded) in (2, 3) and len(hydrogens) <= (1 if is_one else 2):
                kind = is_one, len(bonded), len(hydrogens)
                kinds.setdefault(kind, []).append([parent, *bonded, *hydrogens])
            else:
                remaining.append(parent)
        for (is_one, n_known, n), rows in kinds.items():
            at, near, placed = np.split(np.array(rows), [1, 1 + n_known], axis=1)
            to = _unit(self.x[near] - self.x[at])
            back = _unit(-to.sum(axis=1))
            up = _unit(cross(to[:, 1], to[:, 0]))
            along, across = (1.0, 0.0) if is_one else (np.cos(0.5 * _TETRAHEDRAL), np.sin(0.5 * _TETRAHEDRAL))
            pair = np.stack([along * back + across * up, along * back - across * up], axis=1)
            length = np.array([_LENGTH.get(self.element[k], _LENGTH["C"]) for k, *_ in rows])
            self.x[placed] = np.round(self.x[at] + length[:, None, None] * pair[:, :n], _DECIMALS)
            self.missing[placed] = False
        return remaining

    def _hydrogens(self, parent: int) -> list[int]:
        return [k for k in self.neighbours[parent] if self.missing[k]]

    def _set_positions(self, parent: int, hydrogens: list[int], directions: Floats) -> None:
        length = _LENGTH.get(self.element[parent], _LENGTH["C"])
        self.x[hydrogens] = np.round(self.x[parent] + length * directions, _DECIMALS)
        self.missing[hydrogens] = False

    def _placed_neighbours(self, parent: int) -> list[int]:
        return [k for k in self.neighbours[parent] if not self.missing[k]]

    def _is_planar(self, atom: int) -> bool:
        """Whether an atom has three neighbours in a plane: a carbon, or a nitrogen next to such a carbon."""
        if len(self.neighbours[atom]) != 3:
            return False
        if self.element[atom] == "C":
            return True
        return self.element[atom] == "N" and any(
            self.element[k] == "C" and len(self.neighbours[k]) == 3 for k in self.neighbours[atom]
        )

    def _place_around_bonds(self, parents: Iterable[int]) -> list[int]:
        """Place hydrogens by dihedrals about one bond, those of a kind at once. Return other parents."""
        kinds: dict[tuple[bool, int, int], list[list[int]]] = {}
        turning = []
        for parent in parents:
            bonded, hydrogens = self._placed_neighbours(parent), self._hydrogens(parent)
            planar, n = self._is_planar(parent), len(hydrogens)
            # Excess hydrogens, and those that rotate freely, are rotated to the lowest energy.
            if len(bonded) != 1 or len(self.neighbours[parent]) <= 2 or n > (2 if planar else 3):
                turning.append(parent)
                continue
            # Dihedrals start from a heavy atom behind the bond. Without one they start from a hydrogen, if an
            # earlier parent has got it: such a parent is a kind of one, to be placed in its turn.
            behind = self._behind(parent, bonded[0])
            lone_parent = parent if behind < 0 or self.element[behind] == "H" else -1
            kinds.setdefault((planar, n, lone_parent), []).append([parent, bonded[0], *hydrogens])
        for (planar, n, _), rows in kinds.items():
            index, turns = np.array(rows), np.array([0.0, np.pi])[-n:] if planar else _STAGGERED[:n]
            angle = _TRIGONAL if planar else _TETRAHEDRAL
            directions = self._directions_around(index[:, 0], index[:, 1], angle, turns)
            length = np.array([_LENGTH.get(self.element[k], _LENGTH["C"]) for k, *_ in rows])[:, None, None]
            self.x[index[:, 2:]] = np.round(self.x[index[:, :1]] + length * directions, _DECIMALS)
            self.missing[index[:, 2:]] = False
        return turning

    def _behind(self, parent: int, near: int) -> int:
        """Return the first placed atom behind the bond of a parent, heavy if there is one, or -1."""
        behind = [k for k in self.neighbours[near] if k != parent and not self.missing[k]]
        return next((k for k in behind if self.element[k] != "H"), behind[0] if behind else -1)

    def _directions_around(self, parents: Integers, near: Integers, angle: float, turns: Floats) -> Floats:
        """Directions (n, m, 3) from the angle to bonds of n parents, and m dihedrals about the bonds."""
        axis = _unit(self.x[near] - self.x[parents])
        other = _perpendicular_axis(axis)
        behind = np.array([*map(self._behind, parents.tolist(), near.tolist())])
        arm = np.where(behind[:, None] < 0, other, self.x[behind] - self.x[near])
        arm = arm - dots(arm, axis)[:, None] * axis
        is_bent = np.sqrt(dots(arm, arm))[:, None] > 1e-6
        m = np.where(is_bent, _unit(arm), _unit(cross(axis, other)))
        n = cross(axis, m)
        aside = np.cos(turns)[:, None] * m[:, None] + np.sin(turns)[:, None] * n[:, None]
        return np.asarray(np.cos(angle) * axis[:, None] + np.sin(angle) * aside)

    def _turn(self, parent: int, hydrogen: int) -> None:
        """Rotate a hydrogen to its lowest energy."""
        if bonded := self._placed_neighbours(parent):
            is_water = all(self.element[k] == "H" for k in self.neighbours[parent])
            angle = _WATER if is_water else _BENT.get(self.element[parent], float(_TETRAHEDRAL))
            (choices,) = self._directions_around(np.array([parent]), np.array(bonded[:1]), angle, _TURNS)
        else:
            choices = sphere(len(_TURNS))
        energy = self._energies(parent, hydrogen, choices)
        self._set_positions(parent, [hydrogen], choices[[int(np.argmin(np.round(energy, 6)))]])

    def _energies(self, parent: int, hydrogen: int, choices: Floats) -> Floats:
        """(n,) kJ/mol of a hydrogen in directions (n, 3)."""
        near = self._near(parent)
        at = self.x[parent] + _LENGTH.get(self.element[parent], _LENGTH["C"]) * choices
        r = np.linalg.norm(at[:, None] - self.x[near], axis=-1)
        r = np.maximum(r, 0.01)
        coulomb = _COULOMB * self.charge[hydrogen] * self.charge[near] / r**2
        return np.asarray((coulomb + (_CORE / r) ** 12).sum(axis=1))

    def _turn_from_metals(self, parent: int) -> None:
        """Rotate both hydrogens of a metal-bound water about the axis away from the metals."""
        hydrogens, to = self._hydrogens(parent), self.x[parent] - self.x[self.metals]
        to = to[np.linalg.norm(to, axis=1) < _AT_METAL]
        if len(hydrogens) != 2 or len(self.neighbours[parent]) != 2 or not len(to):
            return
        away = _unit(_unit(to).sum(axis=0))
        side = _unit(cross(away, _perpendicular_axis(away)))
        across = np.cos(_TURNS)[:, None] * side + np.sin(_TURNS)[:, None] * cross(away, side)
        pair = np.stack(
            [np.cos(0.5 * _WATER) * away + np.sin(0.5 * _WATER) * s * across for s in (1, -1)], axis=1
        )
        energy = sum(self._energies(parent, hydrogen, pair[:, k]) for k, hydrogen in enumerate(hydrogens))
        self._set_positions(parent, hydrogens, pair[int(np.argmin(np.round(energy, 6)))])
        self.rotated += hydrogens

    def _near(self, parent: int) -> Integers:
        """Placed atoms within reach, without the parent and its neighbours."""
        close = self.fixed[sorted(self.tree.query_ball_point(self.x[parent], _REACH))]
        away = np.linalg.norm(self.x[self.rotated] - self.x[parent], axis=1)
        close_atoms = np.concatenate([close, np.array(self.rotated, dtype=np.int64)[away < _REACH]])
        excluded = {parent, *self.neighbours[parent]}
        return np.array([k for k in close_atoms.tolist() if k not in excluded], dtype=np.int64)


def _unit(v: Floats) -> Floats:
    """Unit vectors along vectors (..., 3), or x for zero vectors."""
    length = np.sqrt(dots(v, v))[..., None]
    return np.where(length > 1e-9, v / np.maximum(length, 1e-9), [1.0, 0.0, 0.0])


def _perpendicular_axis(axis: Floats) -> Floats:
    """Return unit vectors (..., 3) of the coordinate axes most nearly perpendicular to axes (..., 3)."""
    return np.asarray(np.eye(3)[np.argmin(np.abs(axis), axis=-1)])
