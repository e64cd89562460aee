"""Pictures of a motion: a page in which it moves, and a strip of poses."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from protochain.core.arrays import Floats
from protochain.core.checks import brief
from protochain.core.errors import MechanicsError
from protochain.core.palette import COLOURS
from protochain.core.settings import document_fields
from protochain.core.storage import write_text
from protochain.mechanisms.assemble import quaternion
from protochain.mechanisms.assembly import Motion
from protochain.mechanisms.drawing import THICK, Block, Drawing, Shape, drawing, outline
from protochain.mechanisms.element_arguments import direction
from protochain.mechanisms.shapes import Ball

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from protochain.core.figure import Figure

_POSES = 30
"""Most poses in a strip."""


@document_fields
@dataclass(frozen=True, repr=False)
class Movie:
    """A motion that moves in a notebook, with plain text elsewhere."""

    page: str  # The page: HTML that needs nothing else.
    title: str  # Subject of the page.

    def _repr_html_(self) -> str:
        frame = 'sandbox="allow-scripts" style="width: 100%; height: 34rem; border: 0"'
        return f'<iframe title="{escape(self.title)}" {frame} srcdoc="{escape(self.page)}"></iframe>'

    def __repr__(self) -> str:
        return f"<Movie of {self.title}: shown in notebooks>"


def view(
    run: Motion,
    path: str | Path | None = None,
    shapes: Sequence[Shape] | None = None,
    title: str = "",
    frames: int = 200,
) -> Movie:
    """Show the motion in three dimensions: in a notebook, and as a page that works offline.

    Parameters
    ----------
    run : Run
        The motion.
    path : str or Path, optional
        Where to write the page, as ``"motion.html"``.
    shapes : sequence of Ball, Rod or Block, optional
        Shapes of bodies. By default rods to joined parts, the balls of contacts, and for
        bodies without either blocks or balls with their moments of inertia.
    title : str
        Its heading.
    frames : int
        Most poses.

    Returns
    -------
    Movie
        Drag to turn it, scroll to zoom.

    Raises
    ------
    MechanicsError
        If a shape is none or its body not there.
    """
    from jinja2 import Template

    if not isinstance(frames, int) or isinstance(frames, bool) or frames < 1:
        raise MechanicsError(f"frames {brief(frames)}: give a whole number from 1")
    if not isinstance(title, str):
        raise MechanicsError(f"title {brief(title)}: give a text")
    if path is not None and not (isinstance(path, str | Path) and str(path)):
        raise MechanicsError(f'path {brief(path)}: give the name of a file, as "motion.html"')
    # 40,000 poses of bodies are two megabytes.
    n_frames = min(frames, max(40_000 // run.model.tree.n_bodies, 2))
    picture = drawing(run, _rows(run, np.linspace(run.time[0], run.time[-1], n_frames)), shapes)
    title = title or "Motion"
    text = json.dumps(_data_of(picture), separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    source = (files("protochain.mechanisms") / "movie.html").read_text(encoding="utf-8")
    page = Template(source, autoescape=True).render(title=title, motion=text)
    if path is not None:
        write_text(Path(path), page)
    return Movie(page, title)


def strip(
    run: Motion,
    times: ArrayLike | None = None,
    shapes: Sequence[Shape] | None = None,
    along: ArrayLike | None = None,
) -> "Figure":
    """Draw poses side by side.

    Parameters
    ----------
    run : Run
        The motion.
    times : (n,) array_like, optional
        Times. The rows next to these are drawn. By default five, from start to end.
    shapes : sequence of Ball, Rod or Block, optional
        As of :meth:`Run.view`.
    along : (3,) array_like, optional
        Direction of view. By default the direction in which the motion is flat, or aslant.

    Returns
    -------
    matplotlib.figure.Figure
        Notebooks display it. ``savefig("strip.svg")`` writes it.

    Raises
    ------
    MechanicsError
        If a time is not of the run, a shape is none, or its body not there.
    """
    from protochain.core.figure import Figure

    first, last = run.time[0], run.time[-1]
    if times is None:
        times = np.linspace(first, last, 5)
    try:
        when = np.atleast_1d(np.asarray(times, dtype=float))
    except (TypeError, ValueError):
        when = np.array([np.nan])
    slack = 1e-9 * (last - first)
    if when.ndim != 1 or not len(when) or not np.all((when >= first - slack) & (when <= last + slack)):
        raise MechanicsError(f"times {brief(times)}: give those of the run, from {first:g} to {last:g}")
    if len(when) > _POSES:
        raise MechanicsError(f"{len(when)} poses do not fit side by side: give {_POSES} times at most")
    picture = drawing(run, _rows(run, when), shapes)
    across = _across(picture, along)
    flat = np.array(np.meshgrid(*np.stack([picture.low, picture.high], axis=1))).reshape(3, -1).T @ across.T
    low, high = flat.min(axis=0), flat.max(axis=0)
    margin = 0.05 * picture.size
    width, height = high - low + 2.0 * margin
    tall = float(np.clip(2.2 * height / width, 1.2, 4.0))
    figure = Figure(figsize=(min(2.2 * len(when), 13.0), tall + 0.3), layout="constrained")
    for k, ax in enumerate(figure.subplots(1, len(when), squeeze=False)[0]):
        _draw(ax, picture, k, across)
        ax.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
        ax.set_aspect("equal")
        ax.set_axis_off()
        ax.set_title(f"t = {picture.times[k]:.4g}", fontsize=9)
    return figure


def _rows(run: Motion, times: Floats) -> list[int]:
    """Numbers of the rows that are next to times."""
    middles = 0.5 * (run.time[1:] + run.time[:-1])
    return [int(k) for k in np.searchsorted(middles, times)]


def _across(picture: Drawing, along: ArrayLike | None) -> Floats:
    """(2, 3) float: directions to the right and up, of a view along a direction."""
    extent = picture.high - picture.low
    thin = int(np.argmin(extent))
    if along is not None:
        back = -direction(along, "along")
    elif extent[thin] <= 0.2 * np.sort(extent)[1]:
        # Along the thin axis: from the front, so that x or y points to the right, or from above, so that y
        # points up.
        back = np.eye(3)[thin] * (-1.0 if thin == 1 else 1.0)
    else:
        back = direction((2.0, -3.0, 1.5), "along")
    up = np.array([0.0, 1.0, 0.0]) if abs(back[2]) > 0.999 else np.array([0.0, 0.0, 1.0])
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(back, right)])


def _draw(ax: "Axes", of: Drawing, k: int, across: Floats) -> None:
    """Draw one pose, the distant shapes first."""
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.patches import Circle, Polygon

    away, thick = np.cross(across[0], across[1]), THICK * of.size
    for ground in of.grounds:
        at, n = of.place(k, ground.body, ground.at), of.place(k, ground.body, ground.at + ground.normal)
        n = n - at
        level = across @ n
        # Seen from its side, a plane is a line.
        if np.linalg.norm(level) > 0.5:
            side = np.array([-level[1], level[0]]) / np.linalg.norm(level)
            ends = [across @ at - 2.0 * of.size * side, across @ at + 2.0 * of.size * side]
            ax.add_collection(LineCollection([ends], colors="#999999", linewidths=1.0))
    for mesh in of.meshes:
        flat = of.place(k, mesh.body, mesh.corners) @ across.T
        triangles = PolyCollection(list(flat), facecolors="#eeeeee", edgecolors="#999999", linewidths=0.5)
        ax.add_collection(triangles)
    for ends, points in zip(of.lines.ends, of.lines.points, strict=True):
        line = [across @ of.place(k, int(b), at) for b, at in zip(ends, points, strict=True)]
        ax.add_collection(LineCollection([line], colors="#666666", linewidths=1.0, linestyles="dashed"))
    for shape in of.shapes:
        b = of.bodies.number(shape.body)
        colour = COLOURS[b % len(COLOURS)] if b >= 0 else "#999999"
        look: dict[str, Any] = {"facecolor": colour, "edgecolor": "white", "linewidth": 0.4}
        places = of.place(k, b, outline(shape))
        if isinstance(shape, Ball):
            patch: Any = Circle(tuple(across @ places[0]), max(float(shape.radius), 0.25 * thick), **look)
        else:
            wide = 0.01 * thick if isinstance(shape, Block) else shape.radius or 0.5 * thick
            patch = Polygon(_hull(places @ across.T, wide), **look)
        depth = float(np.mean(places @ away))
        patch.set_zorder(2.0 + (depth - away @ of.low) / (10.0 * of.size))
        ax.add_patch(patch)


def _hull(points: Floats, radius: float) -> Floats:
    """Outline (k, 2) of points in the plane with discs about them."""
    from scipy.spatial import ConvexHull

    angle = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    disc = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    everything = (points[:, None] + disc).reshape(-1, 2)
    return np.asarray(everything[ConvexHull(everything).vertices])


def _data_of(picture: Drawing) -> dict[str, Any]:
    """Data of the page: shapes, and whole numbers for poses."""
    middle, fine = 0.5 * (picture.low + picture.high), 1e-4 * picture.size
    frames = [
        np.rint(np.hstack([1e4 * quaternion(turn), (at - middle) / fine])).astype(int).ravel().tolist()
        for turn, at in zip(picture.rotation, picture.origin, strict=True)
    ]
    lasts = float(picture.times[-1] - picture.times[0])
    across = _across(picture, None)
    back = np.cross(across[0], across[1])
    shapes = [{"body": picture.bodies.number(shape.body), **_shape(shape)} for shape in picture.shapes]
    lines = [{"ends": ends.tolist(), "points": points.tolist()}
             for ends, points in zip(picture.lines.ends, picture.lines.points, strict=True)]  # fmt: skip
    grounds = []
    for ground in picture.grounds:
        n = ground.normal
        u = np.cross(np.eye(3)[int(np.argmin(np.abs(n)))], n)
        u *= 0.6 * picture.size / np.linalg.norm(u)
        # Where the motion is, not where the plane was given.
        near = picture.place(0, ground.body, np.zeros(3)) if ground.body >= 0 else middle
        at = near - n * (n @ (near - ground.at)) if ground.body < 0 else ground.at
        v = np.cross(n, u)
        grounds.append({"body": ground.body, "at": at.tolist(), "u": u.tolist(), "v": v.tolist()})
    meshes = [{"body": mesh.body, "corners": mesh.corners.tolist()} for mesh in picture.meshes]
    return {
        "names": list(picture.bodies.names), "colours": list(COLOURS),
        "times": np.round(picture.times, 12).tolist(), "meshes": meshes, "frames": frames, "shapes": shapes,
        "lines": lines, "grounds": grounds, "middle": middle.tolist(), "size": picture.size, "fine": fine,
        "thick": THICK * picture.size,
        "turn": float(np.arctan2(back[1], back[0])) if abs(back[2]) < 0.999 else -0.5 * np.pi,
        "tilt": float(np.arcsin(np.clip(back[2], -1.0, 1.0))),
        # Motions longer than a minute, or shorter than a tenth of a second, last five seconds.
        "pace": 1.0 if 0.1 <= lasts <= 60.0 else lasts / 5.0,
    }  # fmt: skip


def _shape(shape: Shape) -> dict[str, Any]:
    points = outline(shape).tolist()
    if isinstance(shape, Ball):
        x, y, z = points[0]
        # A spot by which one sees a ball turn.
        return {"at": points[0], "radius": float(shape.radius), "mark": [x + float(shape.radius), y, z]}
    return {"corners": points} if isinstance(shape, Block) else {"ends": points, "radius": shape.radius}
