"""How near the vehicle is to tipping: load of its feet, centre of pressure, and the force-angle measure."""

from dataclasses import replace

import numpy as np
import pandas as pd

from bench.scenes.backhoe.cycle import Worked
from bench.scenes.backhoe.machine import ARM, GROUND, LOWER, LOWER_AT, PAD, Design, G
from protochain.core.arrays import Floats
from protochain.mechanics.multibody.tree import FIRST_MOMENT, MASS
from protochain.mechanisms import Law, State
from protochain.mechanisms.reactions import phases, transmitted_forces


def loads(state: State, design: Design, law: Law = GROUND) -> Floats:
    """(10,) float: forces of the ground on the feet, upward, on flat ground."""
    balls = design.feet + np.array([0.0, 0.0, PAD])
    depth = np.array([PAD - state.point("tracks", ball)[2] for ball in balls])
    rate = np.array([-state.velocity("tracks", ball)[2] for ball in balls])
    force = law.stiffness * np.maximum(depth, 0.0) ** law.exponent
    return np.asarray(force * np.maximum(1.0 + law.damping * rate, 0.0))


def centre(state: State) -> Floats:
    """(3,) float: centre of mass."""
    bodies, frames = state.bodies.tree.bodies, state.frames
    first = bodies[:, FIRST_MOMENT : FIRST_MOMENT + 3]
    return np.asarray(
        (bodies[:, MASS] @ frames.origin + np.einsum("bij,bj->i", frames.rotation, first))
        / np.sum(bodies[:, MASS])
    )


def inside_by(point: Floats, corners: Floats) -> Floats:
    """(k,) float: distances of a point (2,) inside the edges of a polygon (k, 2), counterclockwise."""
    along = np.roll(corners, -1, axis=0) - corners
    off = point - corners
    return np.asarray((along[:, 0] * off[:, 1] - along[:, 1] * off[:, 0]) / np.linalg.norm(along, axis=1))


def force_angle(corners: Floats, at: Floats, force: Floats, moment: Floats) -> tuple[Floats, Floats]:
    """Force-angle measure of stability: Papadopoulos, Rey, ICRA 1996, 3111; Veh. Syst. Dyn. 33:29 (2000).

    corners (k, 3), at (3,), force, moment (3,).
    -> (k,): Angles, rad, between the force and the way from the centre of mass to each edge; these times the
        force and its distance from the edge. Negative where it tips.
    """
    along = np.roll(corners, -1, axis=0) - corners
    along /= np.linalg.norm(along, axis=1)[:, None]
    to = np.roll(corners, -1, axis=0) - at
    to -= np.sum(to * along, axis=1)[:, None] * along
    length = np.linalg.norm(to, axis=1)
    to /= length[:, None]
    # Of the force only what is across an axis tips it; the moment along it is a couple of forces at its ends.
    across = force - (along @ force)[:, None] * along
    across = across + np.cross(to, (along @ moment)[:, None] * along) / length[:, None]
    size = np.linalg.norm(across, axis=1)
    unit = across / np.where(size > 0.0, size, 1.0)[:, None]
    sign = np.where(np.sum(np.cross(to, unit) * along, axis=1) > 0.0, 1.0, -1.0)
    angle = sign * np.arccos(np.clip(np.sum(to * unit, axis=1), -1.0, 1.0))
    nearest = length * np.linalg.norm(np.cross(to, unit), axis=1)
    return angle, angle * nearest * size


def traced(worked: Worked, every: int = 1) -> pd.DataFrame:
    """Forces of cylinders and of the slewing drive, and stability, by time.

    ``pressure``, m: how far the centre of pressure of the feet is inside the edges; ``angle``, degrees, and
    ``measure``, N m rad, of :func:`force_angle`, of what passes through the slewing ring and the weight
    of the tracks; ``lifted``, m, of the highest foot; ``tilt``, degrees.
    """
    run, design, model = worked.run, worked.design, worked.model
    run = replace(run, rows=run.rows[::every], kept=run.kept[::every])
    ring = model.bodies.hinge("slew")
    places = [model.bodies.freedom(name)[1] for name in ("slew", *(f"{each} cylinder" for each in ARM))]
    rows = []
    for at in phases(run):
        state = model.state(at)
        corners = np.array([state.point("tracks", corner) for corner in design.corners])
        feet = np.array([state.point("tracks", foot) for foot in design.feet])
        carried = loads(state, design)
        total = float(np.sum(carried))
        pressure = np.nan
        if total > 0.0:
            pressure = float(np.min(inside_by(carried @ feet[:, :2] / total, corners[:, :2])))
        passed, middle = transmitted_forces(model, at).hinges[ring], centre(state)
        weight, own = np.array([0.0, 0.0, -LOWER * G]), state.point("tracks", LOWER_AT)
        force = weight - passed[3:]
        moment = (
            np.cross(own - middle, weight)
            - passed[:3]
            - np.cross(state.frames.origin[ring] - middle, passed[3:])
        )
        angle, measure = force_angle(corners, middle, force, moment)
        tilt = float(np.degrees(np.arccos(np.clip(state.rotation("tracks")[2, 2], -1.0, 1.0))))
        assert at.loads is not None
        rows.append((
            at.time, *at.loads[-1][places], total, pressure, np.degrees(np.min(angle)), np.min(measure),
            np.max(feet[:, 2]), tilt, *state.point("tracks")[:2],
        ))  # fmt: skip
    names = [
        "time", "slew", *ARM, "ground", "pressure", "angle", "measure", "lifted", "tilt", "x", "y",
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=names)
