"""Loads and slopes at which the vehicle tips or slides, what is stiff or crushed, and what is left out."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from bench.cases import Found, check, judged, left_out, vanishes
from bench.scenes.backhoe import oracle
from bench.scenes.backhoe.checks import COARSE, OUT, Turning, advance, driven
from bench.scenes.backhoe.cycle import SMALL, settled, work, working
from bench.scenes.backhoe.machine import (
    DESIGNS,
    GRIP,
    GROUND,
    HOUSE,
    HOUSE_AT,
    Design,
    G,
    add_link,
    hold,
    mesh,
    vehicle,
)  # fmt: skip
from bench.scenes.backhoe.stability import loads
from bench.scenes.backhoe.track import ROLLING, crawler
from bench.scenes.bucket.backhoe import EDGE
from bench.scenes.bucket.dig import Site
from protochain.core.arrays import Floats
from protochain.core.errors import Fault
from protochain.mechanisms import Friction, Law, Mechanism, Plane, Surface

TIPPED = 2.0
"""Degrees. Standing, it tilts by less than a tenth."""
EASED = 0.6
"""s. In which a load is put on."""
HARD = Law(5.0 * GROUND.stiffness, 1.0, GROUND.damping)
"""Ground for tipping: on a soft one the load sinks, and goes forward."""
NEAR = 0.02
"""By which loads are above or below that at which it tips."""


def tipping_load(design: Design) -> float:
    """Load of the bucket's edge at which all weight is on the front edge."""
    state = vehicle(design, hold(OUT), None).build().state()
    return oracle.tipping_load(design, OUT, state.point("bucket", EDGE) - state.point("tracks"))


def tilted_by(design: Design, load: float, until: float = 1.4) -> float:
    """Tilt, degrees, after a load has hung at the bucket's edge for a while."""
    m = vehicle(design, hold(OUT), Plane(), HARD)

    def weight(t: float) -> tuple[float, float, float]:
        s = min(t / EASED, 1.0)
        return 0.0, 0.0, -load * s * s * (3.0 - 2.0 * s)

    m.load("payload", "bucket", EDGE, weight)
    return _tilt(m, until)


def _tilt(m: Mechanism, until: float) -> float:
    """Tilt of the tracks at a time, degrees, or when it has tipped."""
    model = m.build()
    at, t = model.start(), 0.0
    while t < until:
        t += 0.1
        at = model.simulate(t, COARSE, every=50, start=at).end
        tilt = float(np.degrees(np.arccos(np.clip(model.state(at).rotation("tracks")[2, 2], -1.0, 1.0))))
        if tilt > TIPPED:
            break
    return tilt


def tips_at(design: Design, halvings: int = 4) -> float:
    """Load at which it tips, by bisection, of that in closed form."""
    exact = tipping_load(design)
    low, high = 0.94, 1.06
    for _ in range(halvings):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if tilted_by(design, middle * exact) > TIPPED else (middle, high)
    return 0.5 * (low + high) * exact


def _overloaded(design: Design, share: float) -> Found:
    tilt = tilted_by(design, share * tipping_load(design))
    return _whether(tilt, share > 1.0, "moments about the front edge")


def _whether(tilt: float, tips: bool, source: str) -> Found:
    return check("whether it tips", float(tilt > TIPPED), float(tips), 0.5, source, "absolute")


def _on_slope(degrees: float, friction: float, downhill: bool) -> Mechanism:
    angle = np.deg2rad(degrees)
    gravity = (G * np.sin(angle) * (1.0 if downhill else -1.0), 0.0, -G * np.cos(angle))
    grip = Friction(friction, GRIP.stiffness, GRIP.damping) if friction else None
    return vehicle(DESIGNS[0], hold(OUT), Plane(), HARD, grip, gravity)


def _slides(degrees: float, friction: float = GRIP.coefficient) -> Found:
    """How it slides backward, uphill as it looks."""
    model, angle = _on_slope(degrees, friction, False).build(), np.deg2rad(degrees)
    early = model.simulate(0.4, COARSE, every=100).end
    late = model.simulate(0.6, COARSE, every=100, start=early).end
    speeds = [float(model.state(at).velocity("tracks")[0]) for at in (early, late)]
    wanted = max(G * (np.sin(angle) - friction * np.cos(angle)), 0.0)
    return check("acceleration", -(speeds[1] - speeds[0]) / (late.time - early.time), wanted, 0.02,
                 "g (sin - mu cos), or at rest", "absolute")  # fmt: skip


def _tips_on_slope(off: float) -> Found:
    """Whether it tips where it cannot slide, looking downhill, at degrees beyond the angle of its edge."""
    middle = oracle.middle(DESIGNS[0], OUT)
    edge = np.degrees(np.arctan2(0.5 * DESIGNS[0].length - middle[0], middle[2]))
    tilt = _tilt(_on_slope(edge + off, 5.0, True), 1.0)
    return _whether(tilt, off > 0.0, "way to the edge over height")


def _stiff(factor: float, step: float, until: float) -> Found:
    law = Law(factor * GROUND.stiffness, 1.0, GROUND.damping)
    design = DESIGNS[0]
    model = vehicle(design, hold(OUT), Plane(), law).build()
    at = model.simulate(until, step, every=1000).end
    return check("load of the feet", float(loads(model.state(at), design, law).sum()), design.mass * G, 0.02,
                 "weight")  # fmt: skip


def _without_soil() -> Found:
    """No cubes: the same motion, to the last bit, as without soil."""
    empty = settled(Site(SMALL.low, SMALL.high, 0))
    machine = vehicle(DESIGNS[0], working(empty.level), Plane()).build()
    found = [work(DESIGNS[0], empty, 0.1).run.q[-1], machine.simulate(0.1, 1e-3).q[-1]]
    return vanishes("motion", float(np.max(np.abs(found[0] - found[1]))), 0.0, "without soil")


def _crushed() -> Found:
    """The bucket is driven into the floor of the bin."""
    ground = settled(SMALL)
    work(DESIGNS[0], ground, 0.4, path=working(ground.level, 1.6))
    return vanishes("nothing", np.nan, 0.0, "")


def _stretched() -> Found:
    """A cylinder is longer than boom and foot allow."""
    m = Mechanism()
    m.body("house", HOUSE, HOUSE_AT, 0.3)
    add_link(m, "boom", 0.0, lambda t: (2.0, 0.0, 0.0))
    m.build()
    return vanishes("nothing", np.nan, 0.0, "")


def _spins(until: float) -> Found:
    """Without friction nothing from outside moves it along, however the track turns."""
    run = driven(2.0, until, grip=0.0)
    size = float(np.max(np.abs(run.motion["sprocket rate"]))) * ROLLING * 20.0
    return vanishes("momentum", float(np.max(np.abs(run.momenta[:, 0, 0]))) / size, 1e-3, "no force")


def _climbs(degrees: float, until: float) -> Found:
    way, angle = advance(driven(2.0, until, np.deg2rad(degrees)))
    return check("way", way / angle / ROLLING, 1.0, 0.05, "a pitch to a tooth")


def limits(quick: bool) -> Iterator[Found]:
    """Vehicles that are loaded, on slopes, on stiff ground, without grip, or make no sense."""
    for design in DESIGNS[:1] if quick else DESIGNS[1:]:
        for share in (1.0 - NEAR, 1.0 + NEAR):
            label = f"{design.name}: {share:g} of the load that tips it"
            yield judged(label, partial(_overloaded, design, share))
    for degrees in (30.0, 32.0) if quick else (10.0, 30.0, 32.0, 45.0):
        label = f"slope of {degrees:g} degrees, friction {GRIP.coefficient:g}"
        yield judged(label, partial(_slides, degrees))
    if not quick:
        yield judged("slope of 10 degrees without friction", partial(_slides, 10.0, 0.0))
        for off in (-2.0, 2.0):
            label = f"rough slope, {off:+g} degrees from the one that tips it"
            yield judged(label, partial(_tips_on_slope, off))
        yield judged("a track climbs 10 degrees", partial(_climbs, 10.0, 0.8))
    yield judged("ground 100 times as stiff", partial(_stiff, 100.0, 5e-4, 0.05))
    yield judged("ground 1000 times as stiff", partial(_stiff, 1e3, 1e-3, 0.05), Fault.STEP)
    yield judged("no soil", _without_soil)
    yield judged("the bucket is driven into the floor", _crushed, Fault.OVERLAP)
    yield judged("a cylinder longer than it can be", _stretched, Fault.OPEN)
    yield judged("a track without grip", partial(_spins, 0.1 if quick else 0.4))
    yield judged("teeth without stiffness", _toothless, Fault.NO_STIFFNESS)


def _toothless() -> Found:
    crawler(Turning(2.0), stiffness=0.0)
    return vanishes("nothing", np.nan, 0.0, "")


def without(quick: bool) -> Iterator[Found]:
    """Triangles of flat ground; the shoes of a track that does not slip."""
    until = 0.05 if quick else 0.2

    def stands(ground: Surface | Plane) -> Floats:
        model = vehicle(DESIGNS[0], hold(OUT), ground).build()
        return loads(model.state(model.simulate(until, COARSE, every=50).end), DESIGNS[0])

    triangles = mesh((-0.6, -0.5), (0.4, 0.5), 0.02)
    yield left_out(
        "triangles of flat ground, 5000 of them: loads of the feet", partial(stands, triangles),
        partial(stands, Plane()), 1e-9, 1,
    )  # fmt: skip
    rolled = 0.25 if quick else 0.6

    def shoes() -> float:
        return float(driven(2.0, rolled).motion["frame x"].iloc[-1])

    # Before it rolls evenly the ground has given way a little.
    yield left_out(
        "shoes and wheels of a track: its way", shoes, lambda: ROLLING * Turning(2.0)(rolled)[0],
        0.1 if quick else 0.05, 1,
    )  # fmt: skip
