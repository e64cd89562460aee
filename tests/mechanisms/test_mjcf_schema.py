"""Every element and attribute of MuJoCo's schema: applied as MuJoCo applies it, named, or without effect."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest
from fixtures.mujoco_states import same_motion
from fixtures.tolerances import BY_MUJOCO

from protochain.core.errors import MechanicsError
from protochain.mechanisms import Mechanism
from protochain.mechanisms.closing import Closing
from protochain.mechanisms.hinge_friction import HingeFriction
from protochain.mechanisms.hinge_springs import Stop

mujoco = pytest.importorskip("mujoco")

BASE = """<mujoco>
  <compiler angle="radian"/>
  <option gravity="0.5 0.3 -9.81"><flag/></option>
  <default>
    <joint/><geom/><site/><tendon/><general/><motor/><equality/>
    <default class="other"><joint stiffness="11" damping="0.4"/><geom density="300"/></default>
  </default>
  <asset><mesh name="wedge" vertex="0 0 0 .2 0 0 0 .3 0 0 0 .4 .1 .1 .3"/></asset>
  <worldbody>
    <body name="a" pos="0.1 0.2 0.5">
      <inertial pos="0.1 0.02 -0.2" mass="1.2" diaginertia="0.02 0.03 0.025"/>
      <joint name="turn" axis="0.3 1 0.2" stiffness="3" damping="0.2"/>
      <geom name="ga" size="0.1 0.2" type="capsule" pos="0 0.1 0"/>
      <body name="b" pos="0.3 0 -0.1">
        <joint name="swing"/>
        <geom name="gb" size="0.1 0.2 0.15" type="box"/><geom group="3" size="0.05" pos="0 0 0.3"/>
        <site name="s" pos="0.1 0 0"/>
      </body>
    </body>
    <body name="c" pos="1 0 1"><freejoint/>
      <geom name="gc" size="0.1 0.05 0.2" type="box" pos="0.1 0 0"/></body>
    <body name="d" pos="0 1 1"><joint name="ball" type="ball"/>
      <geom name="gd" size="0.1 0.2" type="capsule" pos="0.1 0.1 0"/></body>
    <body name="still" pos="3 0 0"/>
  </worldbody>
  <tendon/><equality/><actuator/><sensor/><keyframe/>
</mujoco>"""

TURN = {"axisangle": "1 2 0 0.5", "euler": "0.3 0.2 0.1", "quat": "0.9 0.1 0.3 -0.1",
        "xyaxes": "1 0.2 0 -0.2 1 0.3", "zaxis": "0.2 0.3 1"}  # fmt: skip
BODY, JOINT, GEOM = "worldbody/body", "worldbody/body/joint", "worldbody/body/body/geom"
APPLIED = {
    "compiler": {
        "alignfree": "true", "angle": ("degree", {f"{BODY} euler": "20 10 30"}),
        "balanceinertia": ("true", {f"{BODY}/inertial diaginertia": "0.1 0.1 0.5"}), "boundinertia": "0.2",
        "boundmass": "30", "eulerseq": ("zyx", {f"{BODY} euler": "0.3 0.2 0.1"}),
        "fitaabb": ("true", {f"{GEOM} mesh": "wedge", f"{GEOM} size": None}), "inertiafromgeom": "true",
        "inertiagrouprange": "0 2",
        "settotalmass": "5",
    },
    "option": {"gravity": "1 2 3"},
    "option/flag": {"gravity": "disable", "spring": "disable", "damper": "disable"},
    "default/joint": {"armature": "0.3", "damping": "0.5", "stiffness": "4", "axis": "1 1 0"},
    "default/geom": {"density": "500", "shellinertia": "true"},
    "worldbody/body": {**TURN, "pos": "1 2 3", "childclass": "other"},
    "worldbody/body/inertial": {
        **TURN, "diaginertia": "0.03 0.02 0.04", "mass": "2", "pos": "0 0.3 0",
        "fullinertia": ("0.03 0.02 0.025 0.003 0.001 0.002", {f"{BODY}/inertial diaginertia": None}),
    },
    "worldbody/body/joint": {
        "armature": "0.3", "axis": "0 1 1", "class": ("other", {f"{JOINT} stiffness": None}),
        "damping": "0.5", "pos": "0.1 0.2 0", "ref": "0.4",
        "springdamper": ("0.5 1", {f"{JOINT} damping": "0"}), "springref": "0.3",
        "stiffness": "8", "type": "slide",
    },
    "worldbody/body/freejoint": {"align": "true"},
    "worldbody/body/geom": {
        **{key: (value, {}) for key, value in TURN.items()}, "class": "other", "density": "400", "mass": "3",
        "fromto": ("0 0 0 0.3 0.2 0.1", {f"{GEOM} type": "capsule", f"{GEOM} size": "0.1"}),
        "fitscale": ("0.7", {f"{GEOM} mesh": "wedge", f"{GEOM} size": None}),
        "mesh": ("wedge", {f"{GEOM} type": "mesh", f"{GEOM} size": None}),
        "pos": "0.1 0.3 0", "shellinertia": "true", "size": "0.2 0.3 0.1", "type": "ellipsoid",
    },
    "asset/mesh": {
        "inertia": "shell", "refpos": "0.1 0.2 0", "refquat": "0.9 0.1 0.3 -0.1", "scale": "1 2 1",
        "vertex": "0 0 0 .2 0 0 0 .3 0 0 0 .5 .2 .1 .3",
    },
}  # fmt: skip
"""Element -> attribute -> value, and what else it needs; each changes the motion in MuJoCo and here alike."""
POLYNOMIALS = {"damping": "0.1 0.2", "stiffness": "1 2"}
NAMED = {
    "option": {"density": ("1.2", "fluid"), "viscosity": ("0.1", "fluid")},
    "option/flag": {"sleep": ("enable", "sleep")},
    "worldbody/body": {"gravcomp": ("0.5", "gravcomp")},
    "worldbody/body/joint": {
        **{key: (value, "polynomials") for key, value in POLYNOMIALS.items()},
        "range": ("-1 1", "limits"), "springyield": ("1", "springyield"),
    },
    "default/joint": {key: (value, "polynomials") for key, value in POLYNOMIALS.items()},
}  # fmt: skip
"""Element -> attribute -> value and the kind under which it is refused, or listed."""
WHOLE = {
    "contact": "contacts", "tendon": "tendons", "actuator": "actuators", "sensor": "sensors",
    "keyframe": "keyframes", "deformable/flex": "flex", "worldbody/body/flexcomp": "flex",
    "extension": "plugins", "worldbody/body/plugin": "plugins", "equality/joint": "equality",
    "equality/tendon": "equality", "equality/flex": "equality", "equality/flexstrain": "equality",
}  # fmt: skip
"""Element -> kind under which it is named with its attributes, but armature and damping of actuators."""
LOOPS = {"connect", "weld"}
NOTHING = {
    "pictures": {
        "visual", "asset/texture", "asset/material", "asset/skin", "deformable/skin", "default/texture",
        "default/material", "default/camera", "default/light", "worldbody/body/camera",
        "worldbody/body/light",
    },
    "sizes, statistics and data of users": {"size", "statistic", "custom"},
    "actuators": {
        "compiler/lengthrange", "default/general", "default/motor", "default/position", "default/velocity",
        "default/intvelocity", "default/orientation", "default/pid", "default/damper", "default/cylinder",
        "default/muscle", "default/adhesion", "default/dcmotor",
    },
    "contacts": {"default/pair", "asset/hfield"},
    "models that MuJoCo attaches before it compiles": {"worldbody/body/attach", "asset/model"},
    "meshes, whose inertia MuJoCo finds": {"default/mesh", "asset/mesh/plugin", "worldbody/body/geom/plugin"},
    "points, at which only loops and tendons are joined": {"worldbody/body/site", "default/site"},
    "tendons and loops, named by themselves": {"default/tendon", "default/equality"},
}  # fmt: skip
"""Reason -> elements that move no body by themselves."""
NO_ATTRIBUTE = {
    "names, groups, notes and pictures": {
        "name", "class", "user", "group", "material", "rgba", "cameraid",
    },
    "files, threads and what is saved": {
        "assetdir", "meshdir", "texturedir", "strippath", "usethread", "savecanonical", "savecompiled",
        "saveinertial", "passthrough", "conflict", "discardvisual", "file", "content_type", "builtin",
        "params", "face", "normal", "texcoord", "smoothnormal", "maxhullvert",
    },
    "bodies that MuJoCo may treat as one, or faster": {"fusestatic", "fuse", "simple", "sleep", "coordinate"},
    "settings of MuJoCo's steps, solver and state": {
        "timestep", "integrator", "iterations", "tolerance", "ls_iterations", "ls_tolerance",
        "noslip_iterations", "noslip_tolerance", "ccd_iterations", "ccd_tolerance", "cone", "impratio",
        "jacobian", "solver", "sdf_initpoints", "sdf_iterations", "sleep_tolerance", "actuatorgroupdisable",
        "autoreset", "clampctrl", "diagexact", "energy", "eulerdamp", "filterparent", "fwdinv",
        "invdiscrete", "ipc", "island", "midphase", "multiccd", "nativeccd", "refsafe", "sensor",
        "speculative", "warmstart", "actuation",
    },
    "softness of limits, friction and loops, which are exact or stops here": {
        "margin", "solimp", "solref", "solimpfriction", "solimplimit", "solreffriction", "solreflimit",
        "torquescale",
    },
    "contacts, which are left out": {
        "adhesion", "conaffinity", "condim", "contype", "friction", "gap", "priority", "solmix",
        "surfacevel", "hfield", "o_friction", "o_margin", "o_solimp", "o_solref", "override", "castshadow",
    },
    "actuators, which are left out": {"actuatorfrclimited", "actuatorfrcrange", "actuatorgravcomp"},
    "sensors": {"magnetic"},
    "air, which is refused by its density or viscosity": {"wind", "fluidcoef", "fluidshape"},
}  # fmt: skip
"""Reason -> attributes that move no body by themselves."""
TESTED_BELOW = {
    "option/flag": {"constraint", "contact", "equality", "frictionloss", "limit"},
    "compiler": {"autolimits"},
    "worldbody/body": {"mocap"},
    "worldbody/body/joint": {"frictionloss", "limited"},
}
DEFAULTS = {"default/joint": "worldbody/body/joint", "default/geom": "worldbody/body/geom"}


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """MuJoCo writes its warnings to a file where it runs."""
    monkeypatch.chdir(tmp_path)


def schema():
    """Yield elements, as paths from the root, with their attributes."""
    path, attributes = [], {}
    for line in mujoco.mj_printSchema(False, False).splitlines():
        head = re.match(r"^( *)(\(world\))?(\w+) \((.)\) *(.*)$", line)
        if head:
            depth = len(head.group(1)) // 3
            name = "worldbody/body" if head.group(2) else head.group(3)
            path[depth:] = [name]
            attributes["/".join(path[1:])] = head.group(5).split()
        elif line.strip():
            attributes["/".join(path[1:])] += line.split()
    return {path.removesuffix("/"): names for path, names in attributes.items() if path}


def edited(edits):
    """Text of the base with attributes, "path name" -> value; None removes one."""
    root = ElementTree.fromstring(BASE)
    for where, value in edits.items():
        path, name = where.split()
        *above, tag = path.split("/")
        parent = root.find("/".join(above)) if above else root
        element = parent.find(tag)
        element = ElementTree.SubElement(parent, tag) if element is None else element
        if value is None:
            del element.attrib[name]
        else:
            element.set(name, value)
    return ElementTree.tostring(root, encoding="unicode")


def element_of(path):
    """Of a geom the one of body b, which has no inertia beside."""
    return GEOM if path == "worldbody/body/geom" else path


def variants():
    for path, attributes in APPLIED.items():
        for name, value in attributes.items():
            value, more = value if isinstance(value, tuple) else (value, {})
            where = "worldbody/body[@name='c']/freejoint" if path.endswith("freejoint") else element_of(path)
            mesh = {f"{GEOM} type": "mesh", f"{GEOM} mesh": "wedge", f"{GEOM} size": None}
            more = {**more, **mesh} if path == "asset/mesh" else more
            yield pytest.param({f"{where} {name}": value, **more}, id=f"{path} {name}")


def test_every_attribute_of_the_schema_is_applied_named_or_without_effect():
    unknown = []
    for path, names in schema().items():
        of = DEFAULTS.get(path, path)
        whole = [key for key in WHOLE if path == key or path.startswith(f"{key}/")]
        nothing = any(path == key or path.startswith(f"{key}/") for keys in NOTHING.values() for key in keys)
        if path.split("/")[0] == "equality" and path.split("/")[-1] in LOOPS:
            continue
        for name in names:
            known = any(
                name in table.get(at, {}) for table in (APPLIED, NAMED, TESTED_BELOW) for at in (path, of)
            )
            if not (known or whole or nothing or any(name in keys for keys in NO_ATTRIBUTE.values())):
                unknown.append(f"{path} {name}")
    assert not unknown


@pytest.mark.parametrize("edits", list(variants()))
def test_an_attribute_moves_bodies_as_in_mujoco(edits):
    text = edited(edits)
    ours, theirs = same_motion(text, 1)
    assert ours == pytest.approx(theirs, rel=BY_MUJOCO, abs=BY_MUJOCO * np.max(np.abs(theirs)))
    # It does something, in another state of the same coordinates at least.
    other = edited({key: value for key, value in edits.items() if key != next(iter(edits))})
    try:
        _, without = same_motion(other, 1)
    except ValueError:
        return  # MuJoCo needs it.
    assert len(without) != len(theirs) or not np.allclose(without, theirs, rtol=1e-6)


@pytest.mark.parametrize(
    ("where", "value", "kind"),
    [(f"{path} {name}", *each) for path, found in NAMED.items() for name, each in found.items()],
)
def test_an_attribute_that_is_not_had_is_named(where, value, kind):
    text = edited({where: value, **({f"{JOINT} stiffness": "3"} if kind == "springyield" else {})})
    try:
        found = Mechanism.from_mjcf(text).left_out
    except MechanicsError as error:
        assert f"{kind} (" in str(error)
        found = Mechanism.from_mjcf(text, leave_out={kind}).left_out
    assert kind in found


@pytest.mark.parametrize("flag", ["frictionloss", "constraint"])
def test_friction_is_had_unless_a_flag_has_it_off(flag):
    rubbing = {f"{JOINT} frictionloss": "0.4"}
    (friction,) = Mechanism.from_mjcf(edited(rubbing)).parts(HingeFriction)
    assert (friction.hinge, friction.torque) == ("turn", 0.4)
    off = edited({**rubbing, f"option/flag {flag}": "disable"})
    assert not [*Mechanism.from_mjcf(off).parts(HingeFriction)]


@pytest.mark.parametrize(
    ("edits", "limited"),
    [
        ({f"{JOINT} range": "-1 1"}, True), ({f"{JOINT} range": "-1 1", f"{JOINT} limited": "false"}, False),
        ({f"{JOINT} range": "-1 1", "compiler autolimits": "false", f"{JOINT} limited": "true"}, True),
        ({f"{JOINT} range": "-1 1", "option/flag limit": "disable"}, False),
        ({f"{JOINT} range": "-1 1", "option/flag constraint": "disable"}, False),
    ],
)  # fmt: skip
def test_limits_are_stops_or_named(edits, limited):
    text = edited(edits)
    stops = [*Mechanism.from_mjcf(text, stops=100.0).parts(Stop)]
    assert [(each.low, each.high) for each in stops] == [(-1.0, 1.0)] * limited
    assert ("limits" in Mechanism.from_mjcf(text).left_out) == limited


@pytest.mark.parametrize("flag", ["equality", "constraint", None])
def test_loops_are_closed_unless_a_flag_has_them_off(flag):
    text = edited({"equality/weld body1": "b", "equality/weld body2": "c"})
    text = text if flag is None else text.replace("<flag", f'<flag {flag}="disable"')
    m = Mechanism.from_mjcf(text)
    assert len(m._parts[Closing]) == (flag is None)
    assert ("inactive equality" in m.left_out) == (flag is not None)


def test_what_does_nothing_by_itself_is_listed():
    text = edited(
        {
            "actuator/motor joint": "swing", "sensor/jointpos joint": "swing", "keyframe/key time": "1",
            "worldbody/body[@name='still'] mocap": "true",
        }
    )  # fmt: skip
    assert {"contacts", "actuators", "sensors", "keyframes", "mocap"} <= Mechanism.from_mjcf(
        text
    ).left_out.keys()
    off = edited({"option/flag contact": "disable"})
    assert "contacts" not in Mechanism.from_mjcf(off).left_out


ACTUATORS = {
    "motor": {}, "general": {}, "position": {"kp": "0"}, "velocity": {"kv": "0"},
    "damper": {"ctrlrange": "0 1"},
    "cylinder": {"timeconst": "1"}, "intvelocity": {"kp": "0", "actrange": "-1 1"}, "pid": {"kp": "0"},
}  # fmt: skip


@pytest.mark.parametrize("kind", ACTUATORS)
@pytest.mark.parametrize(("name", "value"), [("armature", "0.7"), ("damping", "0.6"), ("damping", "0.1 0.2")])
def test_armature_and_damping_of_actuators_are_those_of_their_joints(kind, name, value):
    if name not in schema().get(f"actuator/{kind}", ()):
        pytest.skip("this version of MuJoCo does not have it")
    tag = f"actuator/{kind}"
    edits = {f"{tag} {key}": x for key, x in ACTUATORS[kind].items()}
    edits |= {f"{tag} joint": "swing", f"{tag} gear": "2", f"{tag} {name}": value}
    text = edited(edits)
    if " " in value:
        with pytest.raises(MechanicsError, match="polynomials"):
            Mechanism.from_mjcf(text)
        return
    ours, theirs = same_motion(text, 1)
    assert ours == pytest.approx(theirs, rel=BY_MUJOCO, abs=BY_MUJOCO * np.max(np.abs(theirs)))
    assert not np.allclose(same_motion(edited({}), 1)[1], theirs, rtol=1e-6)


TENDON = '<fixed name="t" {0}><joint joint="swing" coef="2"/><joint joint="turn" coef="1"/></fixed>'
SPATIAL = '<spatial name="t" {0}><site site="s"/><site site="w"/></spatial>'
FLEX = (
    '<flexcomp name="f" type="grid" count="2 2 2" spacing="0.1 0.1 0.1" pos="5 0 0" dim="3" mass="1" '
    'radius="0.01"><elasticity young="1e3" poisson="0.2"/></flexcomp>'
)


@pytest.mark.parametrize("of", [TENDON, SPATIAL])
@pytest.mark.parametrize(
    "pulls",
    [
        "stiffness='3'", "damping='2'", "frictionloss='0.3'", "armature='0.2'", "damping='0 1'",
        "stiffness='0 2'",
    ],
)  # fmt: skip
def test_a_tendon_that_acts_is_refused_and_one_for_actuators_is_listed(of, pulls):
    base = edited({}).replace("<worldbody>", '<worldbody><site name="w" pos="2 0 0"/>')
    plain = base.replace("<tendon />", "<X/>", 1).replace("<tendon />", f"<tendon>{of.format('')}</tendon>")
    plain = plain.replace("<X/>", "<tendon/>")
    assert Mechanism.from_mjcf(plain).left_out["tendons"] == "t"
    acting = plain.replace('name="t"', f'name="t" {pulls}')
    with pytest.raises(MechanicsError, match=r'tendons \("t"\)'):
        Mechanism.from_mjcf(acting)
    assert Mechanism.from_mjcf(acting, leave_out={"tendons"}).left_out["tendons"] == "t"
    off = {"stiffness": "spring", "damping": "damper", "frictionloss": "frictionloss"}.get(
        pulls.split("=")[0]
    )
    if off:
        Mechanism.from_mjcf(acting.replace("<flag", f'<flag {off}="disable"'))


@pytest.mark.parametrize(
    ("of", "kind"),
    [
        (
            '<equality><joint name="e" joint1="swing" joint2="turn" polycoef="0 2 0 0 0"/></equality>',
            "equality",
        ),
        (f"<worldbody>{FLEX}</worldbody>", "flex"),
    ],
)
def test_loops_and_bodies_of_other_kinds_are_refused(of, kind):
    text = edited({}).replace("</mujoco>", f"{of}</mujoco>")
    with pytest.raises(MechanicsError, match=rf"{kind} \("):
        Mechanism.from_mjcf(text)
    assert kind in Mechanism.from_mjcf(text, leave_out={kind, "equality"}).left_out


def test_friction_and_limits_of_balls_and_free_bodies_are_named():
    ball = "worldbody/body[@name='d']/joint"
    for edits, kind in (
        ({f"{ball} frictionloss": "1"}, "resistance of balls"),
        ({"default/joint frictionloss": "1"}, "resistance of balls"),
    ):
        with pytest.raises(MechanicsError, match=kind):
            Mechanism.from_mjcf(edited(edits))
    free = edited({}).replace("<freejoint />", '<joint type="free" frictionloss="2"/>')
    with pytest.raises(MechanicsError, match="friction of free bodies"):
        Mechanism.from_mjcf(free)
    limited = edited({f"{ball} range": "0 1"})
    assert "limits" in Mechanism.from_mjcf(limited).left_out
    with pytest.raises(MechanicsError, match="resistance of balls"):
        Mechanism.from_mjcf(limited, stops=10.0)


def test_what_is_left_out_is_gone():
    """Also what a mechanism could have: so files are read as without."""
    text = edited({f"{JOINT} armature": "0.5"})
    ours, _ = same_motion(text, 1, leave_out={"armature"})
    assert np.array_equal(ours, same_motion(edited({}), 1)[0])
