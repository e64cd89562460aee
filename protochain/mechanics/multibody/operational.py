"""Operational-space inverse inertias of bodies and constraints, and the gradient of ln det M. O(n).

The operational-space inverse inertia of body b, Y_b = J_b M^-1 J_b^T, follows from its parent's by one
outward sweep: Y_b = psi^T Y_p psi + h h^T / D. Rodriguez, Jain, Kreutz-Delgado, J. Guidance 15:1321 (1992).
Jain, *Robot and Multibody Dynamics* (2011).
"""

from dataclasses import dataclass

import numpy as np

from protochain.core import arrays
from protochain.core.arrays import Floats, Integers, read_only
from protochain.core.errors import MechanicsError
from protochain.core.settings import document_fields
from protochain.mechanics.multibody.algebra import Vector, cross, hinge_axis, kernel, lever
from protochain.mechanics.multibody.articulated import Articulated, articulate
from protochain.mechanics.multibody.kinematics import Frames, pull_back
from protochain.mechanics.multibody.small import dense_inertia, solve_lower, solve_upper
from protochain.mechanics.multibody.tree import PARENT, SLIDE, TURN, Q, Tree, V


@document_fields
@dataclass(frozen=True, eq=False)
class Rows:
    """Constraint rows on the twists of pairs of bodies: g V is the sum of wrench . twist over both."""

    body: Integers  # (m, 2) int: Bodies of each row, -1 for the world.
    # (m, 2, 6) float: Weights of (omega, u) of the origin of each body, world axes. Ignored for the world.
    wrench: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "body", read_only(self.body, np.int64))
        object.__setattr__(self, "wrench", read_only(self.wrench))
        m = len(self.body)
        if self.body.shape != (m, 2) or self.wrench.shape != (m, 2, 6):
            raise MechanicsError(
                f"rows have shapes {self.body.shape} and {self.wrench.shape}, not (m, 2) and (m, 2, 6)"
            )


def point_rows(frames: Frames, bodies: tuple[int, int], points: Floats) -> Rows:
    """Constraint rows for the velocity of a point of the second body relative to one of the first.

    Parameters
    ----------
    frames : Frames
        World frames of the bodies.
    bodies : tuple of 2 int
        Bodies, -1 for the world.
    points : (2, 3) float, nm
        World positions of the two points.

    Returns
    -------
    Rows
        Three rows, along the world axes.
    """
    wrench = np.zeros((3, 2, 6))
    for side, sign in ((0, -1.0), (1, 1.0)):
        if bodies[side] >= 0:
            arm = np.asarray(points)[side] - frames.origin[bodies[side]]
            wrench[:, side, :3] = sign * np.cross(arm, np.eye(3))
            wrench[:, side, 3:] = sign * np.eye(3)
    return Rows(np.tile(bodies, (3, 1)), wrench)


def row_matrix(tree: Tree, frames: Frames, rows: Rows) -> Floats:
    """Matrix G of the rows as functions of qd.

    Parameters
    ----------
    tree, frames : Tree, Frames
        Rigid bodies and their world frames.
    rows : Rows
        Constraint rows.

    Returns
    -------
    (m, n_v) float
        Row matrix. O(m n).
    """
    torques = [pull_back(tree, frames, load) for load in row_loads(tree, rows)]
    return np.array(torques).reshape(len(torques), tree.n_v)


def row_loads(tree: Tree, rows: Rows) -> Floats:
    """Each row as loads on all bodies: -> (m, nb, 6)."""
    out = np.zeros((len(rows.body), tree.n_bodies, 6))
    for side in (0, 1):
        (on,) = np.nonzero(rows.body[:, side] >= 0)
        np.add.at(out, (on, rows.body[on, side]), rows.wrench[on, side])
    return out


def log_det_gradient(tree: Tree, frames: Frames) -> Floats:
    """Gradient of ln det M along q: minus 2/kT times Fixman's torque.

    Parameters
    ----------
    tree, frames : Tree, Frames
        Rigid bodies and their world frames.

    Returns
    -------
    (n_v,) float
        Gradient. It is zero for free roots, whose motion leaves ln det M unchanged.

    Raises
    ------
    MechanicsError
        If M is singular.

    Notes
    -----
    Jain, Kandel, Wagner, Larsen, Vaidehi, J. Chem. Phys. 139:244103 (2013), for hinges of any kind: moving
    all bodies beyond hinge k along its twist h changes their articulated inertia P+ by -(P+ crm(h) + its
    transpose), and ln det M by the trace of that change with the parent's Y about the hinge. O(n).
    """
    return gradient_of_log_det(articulate(tree, frames))


def gradient_of_log_det(factors: Articulated) -> Floats:
    """Gradient of ln det M, as :func:`log_det_gradient`, from known factors."""
    tree, frames = factors.tree, factors.frames
    gradient, pivot = np.zeros(tree.n_v), factors.pivot
    if tree.driven is not None:
        # Nothing turns a hinge of this inertia.
        pivot = np.where(tree.driven, 1e300, pivot)
    _outward_gradient(
        tree.links, tree.bodies, frames.rotation, frames.origin, _gain_at_hinge(factors), pivot,
        factors.root, factors.inertia, gradient,
    )  # fmt: skip
    return gradient


def operational_inverse(tree: Tree, frames: Frames, rows: Rows, factors: Articulated | None = None) -> Floats:
    """Operational-space inverse inertia G M^-1 G^T of m constraint rows.

    Parameters
    ----------
    tree, frames : Tree, Frames
        Rigid bodies and their world frames.
    rows : Rows
        Constraint rows.
    factors : Articulated, optional
        Factors of M at these frames, if they are known.

    Returns
    -------
    (m, m) float, 1/(amu nm^2) for rows that are turns, 1/amu for displacements
        Inverse inertia.

    Raises
    ------
    MechanicsError
        If M is singular.

    Notes
    -----
    Nodes are the rows' bodies, the bodies at which their paths to the root meet, and the roots. One sweep
    finds, for each body, the operator that transmits a load to the next node inward. Loads are transmitted
    from node to node, and two of them combine by Y of the outermost body that both reach. O(n + m^2) for
    rows that share few bodies, after Wensing, Featherstone, Orin, ICRA (2012) and Jain (2011).
    """
    factors = articulate(tree, frames) if factors is None else factors
    out = np.zeros((len(rows.body), len(rows.body)))
    if out.size:
        _operational(
            tree.locked_links, tree.bodies, frames.rotation, frames.origin, _gain_at_hinge(factors),
            factors.pivot, factors.root, rows.body, rows.wrench, out,
        )  # fmt: skip
    return out


def _gain_at_hinge(factors: Articulated) -> Floats:
    """(nb, 6) float: P h / D about the body's own origin. The factors have it about the parent's."""
    gain, parent, origin = factors.gain.copy(), factors.tree.parent, factors.frames.origin
    arm = np.where(parent[:, None] >= 0, origin - origin[parent], 0.0)
    gain[:, :3] -= arrays.cross(arm, gain[:, 3:])
    return gain


@kernel
def _inverse_of_root(factor: Floats, out: Floats) -> None:
    out[:] = np.eye(6)
    for i in range(6):
        solve_lower(factor, 6, out[i])
        solve_upper(factor, 6, out[i])


@kernel
def _carried_out(arm: Vector, y: Floats, out: Floats) -> None:
    """X Y X^T: inverse inertia of the parent about its child's origin, X = [[1, 0], [-[arm]x, 1]]."""
    half = np.empty((6, 6))
    for j in range(6):
        first = (y[0, j], y[1, j], y[2, j])
        a, b, c = cross(first, arm)
        half[0, j], half[1, j], half[2, j] = first
        half[3, j], half[4, j], half[5, j] = y[3, j] + a, y[4, j] + b, y[5, j] + c
    for i in range(6):
        first = (half[i, 0], half[i, 1], half[i, 2])
        a, b, c = cross(first, arm)
        out[i, 0], out[i, 1], out[i, 2] = first
        out[i, 3], out[i, 4], out[i, 5] = half[i, 3] + a, half[i, 4] + b, half[i, 5] + c


@kernel
def _past_hinge(axis: Vector, turn: float, slide: float, gain: Floats, pivot: float, y: Floats) -> None:
    """Overwrite Y on the parent's side of a hinge by (1 - h G^T) Y (1 - G h^T) + h h^T / D, beyond it."""
    h = np.empty(6)
    for i in range(3):
        h[i], h[3 + i] = turn * axis[i], slide * axis[i]
    y_gain = np.zeros(6)
    for i in range(6):
        for j in range(6):
            y_gain[i] += y[i, j] * gain[j]
    spread = 1.0 / pivot
    for i in range(6):
        spread += gain[i] * y_gain[i]
    for i in range(6):
        for j in range(6):
            y[i, j] += spread * h[i] * h[j] - h[i] * y_gain[j] - y_gain[i] * h[j]


@kernel
def _outward_gradient(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats,
    gain: Floats, pivot: Floats, root: Floats, packed: Floats, gradient: Floats,
) -> None:  # fmt: skip
    n = len(bodies)
    inverse, plus = np.zeros((n, 6, 6)), np.empty((6, 6))
    for b in range(n):
        p, k = links[b, PARENT], links[b, V]
        n_v = links[b + 1, V] - k
        y = inverse[b]
        if p >= 0:
            _carried_out(lever(origin, b, p), inverse[p], y)
        if n_v == 6:
            _inverse_of_root(root[links[b, Q] - k], y)
        elif n_v == 1:
            axis, turn, slide = hinge_axis(rotation, b), bodies[b, TURN], bodies[b, SLIDE]
            if p >= 0:
                # P+ = P - G D G^T: articulated inertia beyond the free hinge.
                dense_inertia(packed[b], plus)
                for i in range(6):
                    for j in range(6):
                        plus[i, j] -= pivot[b] * gain[b, i] * gain[b, j]
                gradient[k] = -2.0 * _trace_with_twist(axis, turn, slide, y, plus)
            _past_hinge(axis, turn, slide, gain[b], pivot[b], y)


@kernel
def _trace_with_twist(axis: Vector, turn: float, slide: float, y: Floats, plus: Floats) -> float:
    """tr(crm(h) Z) of Z = Y P+ and h = (turn, slide) axis, with crm(h) of rows [w]x, 0 and [v]x, [w]x."""
    trace = 0.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        # The i-th component of the axial vector of the blocks of Z: entries (j, k) less (k, j).
        turning, sliding = 0.0, 0.0
        for m in range(6):
            turning += y[j, m] * plus[m, k] - y[k, m] * plus[m, j]
            turning += y[3 + j, m] * plus[m, 3 + k] - y[3 + k, m] * plus[m, 3 + j]
            sliding += y[j, m] * plus[m, 3 + k] - y[k, m] * plus[m, 3 + j]
        trace += axis[i] * (turn * turning + slide * sliding)
    return trace


@kernel
def _operational(
    links: Integers, bodies: Floats, rotation: Floats, origin: Floats,
    gain: Floats, pivot: Floats, root: Floats, row_body: Integers, row_wrench: Floats, out: Floats,
) -> None:  # fmt: skip
    n, m = len(bodies), len(row_body)
    node = _nodes(links, row_body)
    n_nodes = node.max() + 1
    # For each body between a row's body and its root: Y, and the operator to the next node inward.
    inverse, operator, following = np.zeros((n, 6, 6)), np.zeros((n, 6, 6)), np.full(n, -1)
    for b in range(n):
        if node[b] == -2:
            continue
        p, k = links[b, PARENT], links[b, V]
        n_v = links[b + 1, V] - k
        y = inverse[b]
        if p >= 0:
            arm = lever(origin, b, p)
            _carried_out(arm, inverse[p], y)
            following[b] = p if node[p] >= 0 else following[p]
            turn, slide = n_v * bodies[b, TURN], n_v * bodies[b, SLIDE]
            _pass_inward(arm, hinge_axis(rotation, b), turn, slide, gain[b], operator[b])
            if node[p] < 0:
                operator[b] = operator[p] @ operator[b]
        if n_v == 6:
            _inverse_of_root(root[links[b, Q] - k], y)
        elif n_v == 1:
            _past_hinge(hinge_axis(rotation, b), bodies[b, TURN], bodies[b, SLIDE], gain[b], pivot[b], y)

    body = np.empty(n_nodes, dtype=np.int64)
    for b in range(n):
        if node[b] >= 0:
            body[node[b]] = b
    # Nearest common node: of two nodes the later cannot lie inward of the earlier, so it steps inward.
    meeting = np.full((n_nodes, n_nodes), -1)
    for i in range(n_nodes):
        inward = following[body[i]]
        meeting[i, i] = i
        for j in range(i):
            meeting[i, j] = meeting[node[inward], j] if inward >= 0 else -1
            meeting[j, i] = meeting[i, j]
    load = np.zeros((2 * m, n_nodes, 6))
    for t in range(2 * m):
        b = row_body[t // 2, t % 2]
        if b >= 0:
            load[t, node[b]] = row_wrench[t // 2, t % 2]
            while following[b] >= 0:
                load[t, node[following[b]]] = operator[b] @ load[t, node[b]]
                b = following[b]
    for s in range(2 * m):
        for t in range(2 * m):
            a, b = row_body[s // 2, s % 2], row_body[t // 2, t % 2]
            if a >= 0 and b >= 0:
                c = meeting[node[a], node[b]]
                if c >= 0:
                    out[s // 2, t // 2] += np.dot(load[s, c], inverse[body[c]] @ load[t, c])


@kernel
def _nodes(links: Integers, row_body: Integers) -> Integers:
    """(nb,) int: number of each node, at which rows act or paths meet, -1 between nodes, -2 elsewhere."""
    n = len(links) - 1
    node, paths = np.full(n, -2), np.zeros(n, dtype=np.int64)
    for i in range(len(row_body)):
        for side in range(2):
            if row_body[i, side] >= 0:
                paths[row_body[i, side]] = 2
    for b in range(n - 1, -1, -1):
        if paths[b] > 0:
            node[b] = 0 if paths[b] > 1 or links[b, PARENT] < 0 else -1
            if links[b, PARENT] >= 0:
                paths[links[b, PARENT]] += 1
    count = 0
    for b in range(n):
        if node[b] == 0:
            node[b] = count
            count += 1
    return node


@kernel
def _pass_inward(
    arm: Vector, axis: Vector, turn: float, slide: float, gain: Floats, operator: Floats
) -> None:
    """X^T (1 - G h^T): load on a body -> load transmitted to its parent through the hinge."""
    for j in range(6):
        give = turn * axis[j] if j < 3 else slide * axis[j - 3]
        for i in range(6):
            operator[i, j] = 1.0 * (i == j)
            if give != 0.0:
                operator[i, j] -= gain[i] * give
        x, y, z = cross(arm, (operator[3, j], operator[4, j], operator[5, j]))
        operator[0, j] += x
        operator[1, j] += y
        operator[2, j] += z
