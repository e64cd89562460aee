"""Parts by name -> elements over arrays, bound to the bodies of a tree."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from protochain import multibody
from protochain.arrays import Floats, read_only
from protochain.errors import MechanicsError
from protochain.mechanisms import given
from protochain.mechanisms.bodies import Bodies, State
from protochain.mechanisms.bushing import Bushings
from protochain.mechanisms.elements import Acting, Conservative, Damping, Gravity, Memory, damping
from protochain.mechanisms.model import Counted, Model
from protochain.mechanisms.parts import Bushing, Driven, Forced, Happening, Pushed, Spring, Torsion, Turned
from protochain.mechanisms.springs import Springs, Torsions
from protochain.motion import Applied, Drive, Load
from protochain.multibody import Frames, HingeKind

P = TypeVar("P")


def connect(
    bodies: Bodies, q: Floats, qd: Floats, gravity: Floats, parts: Mapping[str, Any],
    drives: Mapping[str, Driven], events: Mapping[str, Happening],
) -> Model:  # fmt: skip
    """Return a model of bodies and all that acts on them.

    Raises
    ------
    MechanicsError
        If a part names a body or hinge that is not there, or cannot act where it is.
    """
    start = State(bodies, 0.0, q, qd, multibody.pose(bodies.tree, q))
    conservative: list[Conservative] = []
    damped: list[Damping] = []
    memories: list[Memory] = []
    inside = not np.any(gravity) and not np.any(
        (bodies.tree.parent < 0) & (bodies.tree.kind != HingeKind.FREE)
    )
    if np.any(gravity):
        conservative.append(Gravity(bodies.tree, gravity))
    for kind, make in ((Spring, _springs), (Torsion, _torsions), (Bushing, _bushings)):
        chosen: dict[str, Any] = _of_kind(parts, kind)
        if not chosen:
            continue
        element, stiff, resists, between = make(start, chosen)
        conservative += [element] if stiff else []
        damped += [element] if resists else []
        inside = inside and between
    loads: list[Counted] = []
    if damped:
        loads.append(Counted("damping", damping(bodies.tree, damped), dissipates=True))
    for name, part in parts.items():
        if isinstance(part, Pushed | Turned):
            push = _pushed(bodies, part) if isinstance(part, Pushed) else _turned(bodies, part)
            loads.append(Counted(name, push))
            inside = inside and isinstance(part, Turned)
        elif isinstance(part, Forced):
            acting = _bound(bodies, name, part)
            conservative += [acting.conservative] if acting.conservative else []
            loads += [Counted(name, acting.load, acting.dissipates)] if acting.load else []
            memories += [acting.memory] if acting.memory else []
            inside = inside and acting.inside
    drive = _drive(bodies, list(drives.values())) if drives else None
    return Model(
        bodies, q, qd, tuple(conservative), tuple(loads), drive, tuple(events.values()), inside,
        tuple(memories),
    )  # fmt: skip


def _of_kind(parts: Mapping[str, Any], kind: type[P]) -> dict[str, P]:
    return {name: part for name, part in parts.items() if isinstance(part, kind)}


def _ends(bodies: Bodies, name: str, part: Spring | Bushing) -> tuple[list[int], Floats]:
    """Numbers of both bodies, and their points along the axes of the tree's frames."""
    ends = [bodies.number(end, f'"{name}"') for end in part.ends]
    points = [bodies.inside(b, p) for b, p in zip(ends, part.points.reshape(2, 3), strict=True)]
    return ends, np.concatenate(points)


def _springs(start: State, parts: Mapping[str, Spring]) -> tuple[Springs, bool, bool, bool]:
    ends, points, constants = [], [], []
    for name, part in parts.items():
        numbers, at = _ends(start.bodies, name, part)
        places = [start.point(b, p) for b, p in zip(part.ends, part.points.reshape(2, 3), strict=True)]
        built = float(np.linalg.norm(places[1] - places[0]))
        rest = built if part.rest is None else part.rest
        if part.stiffness > 0.0 and built == 0.0 < rest:
            raise MechanicsError(
                f'spring "{name}": its ends meet as built, where its force has no direction; '
                "give rest=0, or move one"
            )
        ends.append(numbers)
        points.append(at)
        constants.append((part.stiffness, rest, part.damping))
    made = Springs(tuple(parts), read_only(ends, np.int64), read_only(points), read_only(constants))
    stiff, resists = (any(c[k] > 0.0 for c in constants) for k in (0, 2))
    return made, stiff, resists, bool(np.all(made.ends >= 0))


def _torsions(start: State, parts: Mapping[str, Torsion]) -> tuple[Torsions, bool, bool, bool]:
    places, constants = [], []
    for name, part in parts.items():
        start.bodies.hinge(part.hinge, f'torsion "{name}"')
        try:
            places.append(start.bodies.freedom(part.hinge))
        except MechanicsError as error:
            raise MechanicsError(f'torsion "{name}": {error}') from None
        rest = start.angle(part.hinge) if part.rest is None else part.rest
        constants.append((part.stiffness, rest, part.damping))
    where = read_only(places, np.int64)
    made = Torsions(read_only(where[:, 0], np.int64), read_only(where[:, 1], np.int64), read_only(constants))
    stiff, resists = (any(c[k] > 0.0 for c in constants) for k in (0, 2))
    return made, stiff, resists, True


def _bushings(start: State, parts: Mapping[str, Bushing]) -> tuple[Bushings, bool, bool, bool]:
    ends, points, firsts, seconds = [], [], [], []
    for name, part in parts.items():
        numbers, at = _ends(start.bodies, name, part)
        ends.append(numbers)
        points.append(at)
        second = start.bodies.axes(numbers[1])
        seconds.append(second)
        # The axes of b as they lie in a at rest.
        world = start.rotation(part.ends[1])
        turn = np.eye(3) if numbers[0] < 0 else start.frames.rotation[numbers[0]]
        firsts.append(turn.T @ world)
    made = Bushings(
        tuple(parts), read_only(ends, np.int64), read_only(points), read_only([firsts, seconds]),
        read_only([part.stiffness for part in parts.values()]),
        read_only([part.damping for part in parts.values()]),
    )  # fmt: skip
    return made, bool(np.any(made.stiffness)), bool(np.any(made.damping)), bool(np.all(made.ends >= 0))


def _law(value: Any, said: str) -> tuple[Callable[..., Any], bool]:
    """A function of time and a maker of states, and whether it may depend on velocities."""
    if not callable(value):
        return (lambda time, state: value), False
    if given.n_parameters(value, 2, said) == 1:
        return (lambda time, state: value(time)), False
    return (lambda time, state: value(time, state())), True


def _pushed(bodies: Bodies, part: Pushed) -> Load:
    b = bodies.number(part.body, f'load "{part.name}"')
    if b < 0:
        raise MechanicsError(f'load "{part.name}": the world does not move; name a body')
    point, said = bodies.inside(b, part.at), f'load "{part.name}": its'
    force, by_force = _law(part.force, f"{said} force")
    moment, by_moment = _law(part.moment, f"{said} moment")

    def applied(time: float, q: Floats, qd: Floats, frames: Frames) -> Applied:
        def state() -> State:
            return State(bodies, time, q, qd, frames)

        wrenches = np.zeros((bodies.tree.n_bodies, 6))
        if part.force is not None:
            fx, fy, fz = given.numbers(force(time, state), (3,), f"{said} force").tolist()
            x, y, z = (frames.rotation[b] @ point).tolist()
            wrenches[b] = y * fz - z * fy, z * fx - x * fz, x * fy - y * fx, fx, fy, fz
        if part.moment is not None:
            wrenches[b, :3] += given.numbers(moment(time, state), (3,), f"{said} moment")
        return Applied(wrenches)

    return Load(applied, by_force or by_moment)


def _turned(bodies: Bodies, part: Turned) -> Load:
    bodies.hinge(part.hinge, f'torque "{part.name}"')
    freedom = bodies.freedom(part.hinge)[1]
    value, by_state = _law(part.value, f'torque "{part.name}": its value')

    def applied(time: float, q: Floats, qd: Floats, frames: Frames) -> Applied:
        torques = np.zeros(bodies.tree.n_v)
        found = value(time, lambda: State(bodies, time, q, qd, frames))
        torques[freedom] = given.number(found, f'torque "{part.name}": its value')
        return Applied(torques=torques)

    return Load(applied, by_state)


def _bound(bodies: Bodies, name: str, part: Forced) -> Acting:
    if isinstance(part.element, Load):
        return Acting(load=part.element)
    acting = part.element.bind(bodies)
    if not isinstance(acting, Acting) or (acting.conservative is None and acting.load is None):
        raise MechanicsError(f'force "{name}": its bind() gives nothing that acts; return Acting(...)')
    return acting


def _drive(bodies: Bodies, drives: Sequence[Driven]) -> Drive:
    """All drives as one, in the order of the tree."""
    ordered = sorted(drives, key=lambda each: bodies.hinge(each.hinge))

    def drive(time: float) -> tuple[Floats, Floats, Floats]:
        q, qd, qdd = np.array([each.at(time) for each in ordered]).T
        return q, qd, qdd

    return drive
