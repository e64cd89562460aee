"""The gun a second time: equations in absolute angles of the plane, and small motions in closed form.

Points are complex, x + i z. The coordinates are heave and roll of the deck, angle of the cradle, slide of the
barrel, angles of the tube's rods, all from the horizontal; nothing of the mechanics of trees is used.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import eigh
from scipy.optimize import root

from bench.scenes.gun import parts
from bench.scenes.gun.parts import Gun
from protochain.core.arrays import Floats

HEAVE, ROLL, CRADLE, SLIDE = range(4)


@dataclass(frozen=True)
class Planar:
    """Equations of motion of a gun.

    gun: Whose deck moves.
    """

    gun: Gun

    @cached_property
    def rods(self) -> Floats:
        """(k,) float: lengths of the tube's rods; one is the whole tube."""
        return parts.TUBE.lengths(self.gun.cells) if self.gun.cells else np.array([parts.TUBE.length])

    @cached_property
    def n(self) -> int:
        """Number of coordinates."""
        return SLIDE + len(self.rods)

    @cached_property
    def masses(self) -> Floats:
        """(b,) float: deck, mount, cradle, breech, rods."""
        return np.array([
            parts.DECK, parts.MOUNT, parts.CRADLE, parts.BREECH, *parts.TUBE.mass * self.rods
        ])  # fmt: skip

    @cached_property
    def arms(self) -> tuple[np.ndarray, np.ndarray]:
        """(b, n) complex: what each turning coordinate carries to each body; (n,) to the muzzle.

        Without the slide, which adds to the arm of the cradle.
        """
        arms, n_rods = np.zeros((4 + len(self.rods), self.n), dtype=complex), len(self.rods)
        arms[1, ROLL] = 1j * parts.MOUNT_HEIGHT
        arms[2:, ROLL] = 1j * parts.TRUNNION
        arms[2, CRADLE] = parts.CRADLE_AT
        arms[3, CRADLE] = parts.BREECH_AT - 1j * self.gun.offset
        # Rod 0 turns with the cradle, rod k with coordinate SLIDE + k.
        turns = [CRADLE, *range(SLIDE + 1, SLIDE + n_rods)]
        arms[4:, CRADLE] = parts.TUBE_AT
        for k, own in enumerate(turns):
            arms[4 + k, own] += 0.5 * self.rods[k]
            arms[5 + k :, own] += self.rods[k]
        muzzle = arms[-1].copy()
        muzzle[turns[-1]] += 0.5 * self.rods[-1]
        return arms, muzzle

    @cached_property
    def inertias(self) -> Floats:
        """(n,) float: of the coordinates, which are absolute angles; and the mass that only heaves."""
        out = np.zeros(self.n)
        out[ROLL] = parts.DECK_INERTIA + parts.MOUNT_INERTIA
        across = parts.TUBE.mass * self.rods**3 / 12.0
        out[CRADLE] = parts.CRADLE_INERTIA + parts.BREECH_INERTIA + across[0]
        out[SLIDE + 1 :] = across[1:]
        return out

    @cached_property
    def springs(self) -> tuple[Floats, Floats, Floats]:
        """Stiffness (n, n), damping (n, n) and coordinates at rest (n,) of what is linear."""
        gun = self.gun
        heave, roll, axle = gun.dampers
        rows = np.zeros((self.n, self.n))
        rows[range(4), range(4)] = 1.0
        rows[CRADLE, ROLL] = -1.0
        for k in range(SLIDE + 1, self.n):
            rows[k, k], rows[k, CRADLE if k == SLIDE + 1 else k - 1] = 1.0, -1.0
        bend = gun.bending * parts.TUBE.stiffness("y") * max(gun.cells, 1) / parts.TUBE.length
        k_of = np.full(self.n, bend)
        k_of[:4] = gun.deck, gun.deck * parts.SPAN**2, gun.axle, parts.RECUPERATOR
        c_of = k_of * gun.damped * parts.TUBE_TIME / gun.bending
        c_of[:4] = heave, roll, axle, 0.0
        rest = np.full(self.n, parts.ELEVATION)
        rest[[HEAVE, ROLL, SLIDE]] = 0.0
        return rows.T @ (k_of[:, None] * rows), rows.T @ (c_of[:, None] * rows), rest

    def places(self, y: Floats) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(n,) directions; (b, n) complex: positions by coordinate, and their derivatives."""
        arms = self.arms[0].copy()
        arms[3:, CRADLE] += y[SLIDE]
        turn = np.exp(1j * y)
        along = arms * turn
        slopes = 1j * along
        slopes[:, HEAVE] = 1j
        slopes[:, SLIDE] = 0.0
        slopes[3:, SLIDE] = turn[CRADLE]
        return turn, along, slopes

    def mass(self, y: Floats) -> Floats:
        """(n, n) float: mass matrix."""
        _, _, slopes = self.places(y)
        return np.asarray((slopes.conj().T @ (self.masses[:, None] * slopes)).real + np.diag(self.inertias))

    def pull(self, y: Floats) -> Floats:
        """(n,) float: minus the gradient of the energy of springs and weights."""
        _, _, slopes = self.places(y)
        stiffness, _, rest = self.springs
        out = -stiffness @ (y - rest) - parts.GRAVITY * self.masses @ slopes.imag
        above, before = parts.LEVER
        lift = self.gun.equilibrator * above * before * np.cos(y[CRADLE] - y[ROLL])
        out[CRADLE] += lift
        out[ROLL] -= lift
        return np.asarray(out)

    def powder(self, y: Floats) -> Floats:
        """(n,) float: what a firing force of one does."""
        turn, _, slopes = self.places(y)
        force = -turn[CRADLE]
        # It acts at the bore, above the breech's centre of mass.
        point = slopes[3].copy()
        point[CRADLE] += 1j * (1j * self.gun.offset) * turn[CRADLE]
        return np.asarray((np.conj(point) * force).real)

    def muzzle(self, y: Floats) -> Floats:
        """(3,) float: x and z of the muzzle, and its elevation."""
        arms = self.arms[1].copy()
        arms[CRADLE] += y[SLIDE]
        # Heave and slide have no arm.
        place = 1j * y[HEAVE] + np.sum(np.exp(1j * y) * arms)
        return np.array([place.real, place.imag, y[-1] if len(self.rods) > 1 else y[CRADLE]])

    def rates(self, time: float, state: Floats) -> Floats:
        """Rates of coordinates and their rates, (2 n,)."""
        n = self.n
        y, v = state[:n], state[n:]
        turn, along, slopes = self.places(y)
        turning = v.copy()
        turning[[HEAVE, SLIDE]] = 0.0
        curl = -along @ turning**2
        curl[3:] += 2j * v[CRADLE] * v[SLIDE] * turn[CRADLE]
        force = self.pull(y) - self.springs[1] @ v + self.gun.thrust(time) * self.powder(y)
        force -= (np.conj(slopes) * (self.masses * curl)[:, None]).real.sum(axis=0)
        force[SLIDE] -= self.gun.damped * parts.BRAKE * v[SLIDE] * abs(v[SLIDE])
        force[ROLL] += self.gun.heel(time)
        mass = (slopes.conj().T @ (self.masses[:, None] * slopes)).real + np.diag(self.inertias)
        return np.concatenate([v, np.linalg.solve(mass, force)])

    @cached_property
    def standing(self) -> Floats:
        """(n,) float: where nothing pulls."""
        return np.asarray(root(self.pull, self.springs[2], tol=1e-14).x)

    def moved(self, times: Floats, tolerance: float = 1e-12) -> Floats:
        """(k, 3) float: muzzle at ascending times, by DOP853 (scipy), anew after each shot."""
        state, now, out = np.concatenate([self.standing, np.zeros(self.n)]), 0.0, []
        fired = [parts.PERIOD * k for k in range(1, self.gun.shots)]
        for until in sorted({*map(float, times), *(t for t in fired if t < times[-1])}):
            state = solve_ivp(
                self.rates, (now, until), state, "DOP853", rtol=tolerance, atol=tolerance, first_step=1e-5
            ).y[:, -1]  # fmt: skip
            now = until
            if until in times:
                out.append(self.muzzle(state[: self.n]))
        return np.array(out)

    def modes(self, times: Floats) -> tuple[Floats, Floats]:
        """Frequencies (n,), and small changes of the muzzle's place (k, 3) after one shot, without dampers.

        Modal superposition: each mode answers to t exp(-t/t_m) in closed form.
        """
        y, n, nudge = self.standing, self.n, 1e-5
        steps = nudge * np.eye(n)
        stiffness = -np.column_stack([self.pull(y + d) - self.pull(y - d) for d in steps]) / (2.0 * nudge)
        squares, shapes = eigh(0.5 * (stiffness + stiffness.T), self.mass(y))
        w, a = np.sqrt(squares), 1.0 / parts.PULSE
        size = shapes.T @ self.powder(y) * self.gun.charge * parts.IMPULSE * a**2 / (a**2 + squares)
        other = 2.0 * a * size / (a**2 + squares)
        t = times[:, None]
        answer = (size * t + other) * np.exp(-a * t) - other * np.cos(w * t)
        answer -= (size - a * other) / w * np.sin(w * t)
        slope = np.column_stack([self.muzzle(y + d) - self.muzzle(y - d) for d in steps]) / (2.0 * nudge)
        return w, answer @ shapes.T @ slope.T
