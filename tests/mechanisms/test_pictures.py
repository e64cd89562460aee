"""Pictures of motions: where bodies are drawn, what a page holds, and that it moves in a browser."""

import io
import json
import re

import matplotlib.image
import numpy as np
import pytest
from matplotlib.patches import Circle
from scipy.spatial.transform import Rotation

from protochain.core.errors import MechanicsError, ProtochainError
from protochain.mechanisms import Ball, Block, Law, Mechanism, Plane, Rod

EVIL = "<img src=x onerror=alert(1)></script><script>alert(2)</script> {{ motion }} {{ title }}"
Y = (0, 1, 0)


def four_bar():
    m = Mechanism(gravity=(0, 0, -9.81))
    for name, along in (("crank", (0, 0, 1.0)), ("coupler", (2.0, 0, 0.5)), ("rocker", (0, 0, 1.5))):
        length = float(np.linalg.norm(along))
        m.body(name, length, com=np.multiply(0.5, along), inertia=length**3 / 12.0)
    m.hinge("A", "world", "crank", axis=Y, qd=3.0)
    m.hinge("B", "crank", "coupler", axis=Y, at=(0, 0, 1.0))
    m.hinge("D", "world", "rocker", axis=Y, at=(2.0, 0, 0))
    m.close("C", ("coupler", (2.0, 0, 0.5)), ("rocker", (0, 0, 1.5)), "revolute", axis=Y)
    m.spring("pull", ("coupler", (1.0, 0, 0.25)), ("world", (1.0, 0, -1.0)), stiffness=5.0)
    return m.build().simulate(1.0, 0.01)


def thrown():
    m = Mechanism(gravity=(0, 0, -9.81))
    turn = Rotation.from_rotvec([0.5, 0.2, -0.4]).as_matrix()
    m.body("ball", 1.0, inertia=0.004, position=(0, 0, 0.5), velocity=(1, 0, 0))
    m.body(
        "box",
        2.0,
        com=(0.1, 0, 0),
        inertia=(0.5, 0.4, 0.3),
        position=(3, 0, 2),
        rotation=turn,
        spin=(1, 2, 0),
    )
    m.contact("floor", [Ball("ball", 0.1)], Plane(), Law(1e5))
    return m.build().simulate(0.4, 1e-3, every=20)


def told(movie):
    """What the page is told."""
    found = re.search(r'<script type="application/json" id="motion">(.*?)</script>', movie.page, re.DOTALL)
    return json.loads(found[1])


def placed(motion, k, body, point):
    """Where the page puts a point of a body."""
    if body < 0:
        return np.array(point)
    w, x, y, z, *at = motion["frames"][k][7 * body : 7 * body + 7]
    turn = Rotation.from_quat([x, y, z, w]).as_matrix()
    return turn @ point + np.array(motion["middle"]) + np.array(at) * motion["fine"]


@pytest.mark.parametrize("made", [four_bar, thrown])
def test_bodies_are_drawn_where_they_are(made):
    run = made()
    motion = told(run.view(frames=7))
    assert len(motion["frames"]) == len(motion["times"]) == 7
    assert (motion["times"][0], motion["times"][-1]) == (0.0, run.time[-1])
    bodies, point = run.model.bodies, (0.3, -0.2, 0.1)
    for k, t in enumerate(motion["times"]):
        row = int(np.argmin(np.abs(run.time - t)))
        state = run.model.state(run.model.system.at(run.q[row], run.qd[row], run.time[row]))
        for b, name in enumerate(bodies.names):
            assert placed(motion, k, b, point) == pytest.approx(
                state.point(name, point), abs=3e-4 * motion["size"]
            )


def test_shapes_are_found_from_what_joins_bodies():
    motion = told(four_bar().view())
    found = {(shape["body"], *np.round(shape["ends"][1], 9)) for shape in motion["shapes"]}
    assert found == {(0, 0, 0, 1), (1, 2, 0, 0.5), (1, 1, 0, 0.25), (2, 0, 0, 1.5)}
    assert motion["names"] == ["crank", "coupler", "rocker"]
    # A spring from the coupler to the world.
    assert [line["ends"] for line in motion["lines"]] == [[1, -1]]
    (rod,) = told(moored().view())["shapes"]
    assert (rod["body"], rod["ends"][1]) == (0, [0.5, 0, 0])
    ball, box = told(thrown().view())["shapes"]
    assert (ball["radius"], ball["at"]) == (0.1, [0, 0, 0])
    edges = np.ptp(box["corners"], axis=0)
    assert np.mean(box["corners"], axis=0) == pytest.approx([0.1, 0, 0])
    moments = 2.0 / 12.0 * np.array([edges[1] ** 2 + edges[2] ** 2, edges[2] ** 2 + edges[0] ** 2,
                                     edges[0] ** 2 + edges[1] ** 2])  # fmt: skip
    assert moments == pytest.approx([0.5, 0.4, 0.3])
    assert told(thrown().view())["grounds"][0]["at"][2] == pytest.approx(0.0, abs=1e-12)


def moored():
    m = Mechanism()
    m.body("buoy", 1.0, inertia=0.1, position=(10, 0, 0), velocity=(0, 1, 0))
    m.spring("rope", ("world", (12, 3, 0)), ("buoy", (0.5, 0, 0)), stiffness=5.0)
    return m.build().simulate(0.4, 1e-2)


@pytest.mark.parametrize("made", [four_bar, thrown, moored])
def test_the_box_is_that_of_all_that_is_drawn(made):
    motion, reached = told(made().view(frames=3)), []
    for shape in motion["shapes"]:
        points, reach = shape.get("corners") or shape.get("ends") or [shape["at"]], shape.get("radius") or 0.0
        at = np.array([placed(motion, k, shape["body"], each) for k in range(3) for each in points])
        reached += [*(at - reach), *(at + reach)]
    fixed = (end for line in motion["lines"] for end in zip(line["ends"], line["points"], strict=True))
    reached += [point for body, point in fixed if body == -1]
    low, high = np.min(reached, axis=0), np.max(reached, axis=0)
    size = np.linalg.norm(high - low)
    assert motion["size"] == pytest.approx(size, rel=1e-3)
    assert motion["middle"] == pytest.approx(0.5 * (low + high), abs=1e-3 * size)


@pytest.mark.parametrize(("axis", "turn", "tilt"), [((0, 0, 1), -90, 90), (Y, -90, 0), ((1, 0, 0), 0, 0)])
def test_a_flat_motion_is_seen_from_its_front_or_from_above(axis, turn, tilt):
    m = Mechanism()
    m.body("rod", 1.0, com=np.roll((0.5, 0, 0), axis[0]), inertia=0.1)
    m.hinge("pin", "world", "rod", axis=axis, qd=3.0)
    motion = told(m.build().simulate(1.0, 0.01).view())
    assert np.degrees([motion["turn"], motion["tilt"]]) == pytest.approx([turn, tilt], abs=1e-9)


def test_shapes_may_be_given_and_lie_in_their_bodies_axes():
    shapes = [
        Block("crank", (0.1, 0.2, 1.0), (0, 0, 0.5)),
        Rod("world", (0, 0, 0), (2, 0, 0), 0.01),
        Ball("rocker", 0.2, (0, 0, 1.5)),
    ]
    block, rod, ball = told(four_bar().view(shapes=shapes))["shapes"]
    assert np.ptp(block["corners"], axis=0) == pytest.approx([0.1, 0.2, 1.0])
    assert (rod["body"], rod["ends"], rod["radius"]) == (-1, [[0, 0, 0], [2, 0, 0]], 0.01)
    assert (ball["body"], ball["at"], ball["radius"]) == (2, [0, 0, 1.5], 0.2)


def test_a_page_is_whole_and_says_what_it_is_given(tmp_path):
    movie = four_bar().view(tmp_path / "new" / "page.html", title=EVIL)
    assert (tmp_path / "new" / "page.html").read_text(encoding="utf-8") == movie.page
    assert "<img" not in movie.page and movie.page.count("<script") == 2 and "http" not in movie.page
    assert movie.page.count("{{ motion }} {{ title }}") == 2  # In title and heading, as text.
    assert 'sandbox="allow-scripts"' in movie._repr_html_() and "<script" not in movie._repr_html_()
    assert len(movie.page) < 60_000


def test_a_strip_shows_the_rows_next_to_its_times():
    run = thrown()
    figure = run.strip([0.0, 0.401 - 1e-3, 0.2], along=Y)
    for ax, t in zip(figure.axes, (0.0, 0.4, 0.2), strict=True):
        row = int(np.argmin(np.abs(run.time - t)))
        (ball,) = (patch for patch in ax.patches if isinstance(patch, Circle))
        at = run.model.state(run.model.system.at(run.q[row], run.qd[row], run.time[row])).point("ball")
        # Seen along y, x is to the right and z up.
        assert ball.center == pytest.approx(at[[0, 2]]) and ball.radius == 0.1
        assert float(ax.get_title().split()[-1]) == pytest.approx(run.time[row])
    # A four-bar is flat, and seen from its side.
    assert len(four_bar().strip().axes) == 5
    low, high = four_bar().strip([0.0]).axes[0].get_ylim()
    assert low < -1.0 and high > 1.5
    assert four_bar().strip([0.0])._repr_png_().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda run: run.view(shapes=["crank"]), "shapes: 'crank' is not a shape"),
        (lambda run: run.view(shapes=[Ball("cranks", 0.1)]), 'shapes: there is no body "cranks"; there are'),
        (lambda run: run.view(frames=0), "frames 0: give a whole number from 1"),
        (lambda run: run.view(title=3), "title 3: give a text"),
        (lambda run: run.view(3), "path 3: give the name of a file"),
        (lambda run: run.view("/dev/null/x.html"), "/dev/null"),
        (lambda run: run.strip(9.0), "times 9.0: give those of the run, from 0 to 1"),
        (lambda run: run.strip(np.linspace(0, 1, 31)), "31 poses .* give 30 times at most"),
        (lambda run: run.model.state().point("crank", (0, 0)), r"the point \(0, 0\) of .crank.: give three"),
        (lambda run: run.strip(along=(0, 0, 0)), "along has length zero"),
        (lambda run: Rod("crank", (0, 0, 0), (0, 0, 1), -1.0), "the radius -1 of a rod"),
        (lambda run: Rod("crank", (0, 0), (0, 0, 1)), 'end a of a rod of "crank"'),
        (lambda run: Block("crank", (1, 1)), 'edges of a block of "crank"'),
        (lambda run: Block("crank", (1, 1, -1)), "give none below 0"),
    ],
)
def test_misuse_is_refused_in_a_line(call, said):
    with pytest.raises((MechanicsError, ProtochainError), match=said) as refused:
        call(four_bar())
    assert len(str(refused.value).splitlines()) == 1


@pytest.mark.parametrize(("width", "scheme"), [(1200, "light"), (390, "dark")])
def test_a_page_moves_in_a_browser_and_asks_nobody(browser, tmp_path, width, scheme):
    four_bar().view(tmp_path / "page.html", title=EVIL)
    page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
    said, asked = [], []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("dialog", lambda dialog: said.append(dialog.message))
    page.on("request", lambda request: asked.append(request.url))
    page.goto((tmp_path / "page.html").as_uri())
    page.wait_for_function("Number(document.querySelector('canvas').dataset.frame) > 3")
    page.get_by_role("button").click()
    assert page.get_by_role("button").inner_text() == "Play"

    def picture():
        drawn = matplotlib.image.imread(io.BytesIO(page.locator("canvas").screenshot()))[..., :3]
        assert np.mean(np.abs(drawn - drawn[0, 0]).max(axis=-1) > 0.2) > 0.002
        return drawn

    page.evaluate(
        "(s) => { s.value = 50; s.dispatchEvent(new Event('input')); }",
        page.locator("input").element_handle(),
    )
    assert page.locator("canvas").get_attribute("data-frame") == "50"
    before = picture()
    box = page.locator("canvas").bounding_box()
    page.mouse.move(box["x"] + 100, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 160, box["y"] + 130, steps=4)
    page.mouse.up()
    assert not np.array_equal(before, picture())
    assert said == [] and asked == [(tmp_path / "page.html").as_uri()]
    assert page.evaluate("document.documentElement.scrollWidth") <= width
