"""Contract of every airframe's model file, what is refused, and the composition of a flock."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from moflock_mj.dynamics.airframe_models import (
    airframe_names,
    airframe_path,
    body_prefix,
    flock_model,
    flock_spec,
    load_airframe,
    read_airframe,
)
from moflock_mj.errors import AirframeError

AIRFRAMES = airframe_names()
OBJECTS = ("BODY", "JOINT", "GEOM", "SITE", "ACTUATOR", "KEY", "NUMERIC", "LIGHT", "MATERIAL", "TEXTURE", "CAMERA")


def unnamed(model):
    counts = {
        "BODY": "nbody",
        "JOINT": "njnt",
        "ACTUATOR": "nu",
        "LIGHT": "nlight",
        "MATERIAL": "nmat",
        "TEXTURE": "ntex",
    }
    counts |= {"GEOM": "ngeom", "SITE": "nsite", "KEY": "nkey", "NUMERIC": "nnumeric", "CAMERA": "ncam"}
    return [
        (kind, index)
        for kind in OBJECTS
        for index in range(getattr(model, counts[kind]))
        if not mujoco.mj_id2name(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind}"), index)
    ]


def test_the_airframes():
    assert AIRFRAMES == ("crazyflie", "x500")


@pytest.mark.parametrize("name", AIRFRAMES)
def test_every_element_is_named(name):
    assert unnamed(mujoco.MjModel.from_xml_path(str(airframe_path(name)))) == []
    assert unnamed(flock_model(name, 3, 0.005, visuals=True)) == []


@pytest.mark.parametrize("name", AIRFRAMES)
def test_hovers_by_itself(name):
    model = mujoco.MjModel.from_xml_path(str(airframe_path(name)))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("hover").id)
    start = data.qpos.copy()
    mujoco.mj_step(model, data, 2000)
    assert data.qpos == pytest.approx(start, abs=1e-6)
    assert data.qvel == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("name", AIRFRAMES)
@pytest.mark.parametrize("rotor", range(4))
def test_one_rotor_more_moves_it_as_the_airframe_says(name, rotor):
    airframe = load_airframe(name)
    model = mujoco.MjModel.from_xml_path(str(airframe_path(name)))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    extra = 0.01 * airframe.thrust_max
    data.act[rotor] += extra
    mujoco.mj_forward(model, data)
    (x, y), ratio = airframe.rotor_positions[rotor], airframe.yaw_ratio[rotor]
    turning = np.array([y, -x, ratio]) * extra / airframe.inertia
    assert data.qacc == pytest.approx((0, 0, extra / airframe.mass, *turning), rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("name", AIRFRAMES)
def test_the_airframe_is_plausible(name):
    airframe = load_airframe(name)
    assert 1.5 < airframe.thrust_to_weight() < 2.5
    assert 0.02 <= airframe.rotor_lag <= 0.05
    assert airframe.radius > np.hypot(*airframe.rotor_positions[0])
    assert max(airframe.inertia) < airframe.mass * airframe.radius**2
    assert 0 < airframe.drag_area < 1


def test_figures_of_the_x500():
    airframe = load_airframe("x500")
    assert airframe.mass == 2.0
    assert airframe.thrust_to_weight() == pytest.approx(1.8)
    assert 2 * np.hypot(*airframe.rotor_positions[0]) == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("name", AIRFRAMES)
def test_a_flock_is_many_free_bodies_without_rotors(name):
    model = flock_model(name, 5, 0.004)
    airframe = load_airframe(name)
    assert (model.nq, model.nv, model.nu, model.nsite) == (35, 30, 0, 0)
    assert model.ngeom == 6
    assert model.opt.timestep == 0.004
    assert model.body_mass[1:] == pytest.approx(airframe.mass)
    assert model.body_inertia[1:] == pytest.approx(np.tile(airframe.inertia, (5, 1)))
    for drone in range(5):
        assert model.body(drone + 1).name.startswith(body_prefix(drone, 5))
        assert model.jnt_qposadr[drone] == 7 * drone
    # Apart from each other, on the ground.
    places = model.qpos0.reshape(5, 7)
    assert min(np.linalg.norm(a - b) for i, a in enumerate(places) for b in places[:i]) >= 10
    assert model.geom_contype.all()


def test_prefixes_have_as_many_digits_as_the_flock_needs():
    assert [body_prefix(7, n) for n in (8, 100, 101, 1001)] == ["drone_07_", "drone_07_", "drone_007_", "drone_0007_"]


def test_looks_change_no_physics():
    bare, dressed = (flock_model("x500", 2, 0.005, visuals=visuals) for visuals in (False, True))
    assert dressed.ngeom > bare.ngeom
    states = []
    for model in (bare, dressed):
        data = mujoco.MjData(model)
        data.qpos[:] = (0, 0, 1, 1, 0, 0, 0, 0.3, 0, 2, 0.9, 0.1, 0.2, 0.3)
        mujoco.mj_step(model, data, 400)
        states.append(data.qpos.copy())
    assert (states[0] == states[1]).all()


def test_a_flock_survives_its_xml():
    spec = flock_spec("crazyflie", 3, 0.005, visuals=True)
    model = spec.compile()
    again = mujoco.MjModel.from_xml_string(spec.to_xml())
    assert (again.nq, again.ngeom) == (model.nq, model.ngeom)
    assert again.body_mass == pytest.approx(model.body_mass)


def test_an_unknown_airframe_is_refused():
    with pytest.raises(AirframeError, match=r"airframe: 'x5000'.*crazyflie, x500"):
        load_airframe("x5000")
    with pytest.raises(AirframeError, match="is unknown"):
        load_airframe("../models/x500")
    with pytest.raises(AirframeError, match="'ground' is unknown"):
        flock_spec("ground", 1, 0.005)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('<freejoint name="x500_free"/>', "", "number of free joints is 0\\b"),
        ('<inertial pos="0 0 0"', '<inertial pos="0 0 0.1"', "position of the inertia is"),
        ('mass="2.0" diaginertia', 'mass="2.0" quat="0.9 0.1 0 0" diaginertia', "quaternion of the inertia"),
        (
            'name="x500_guard" type="cylinder" size="0.377 0.06"',
            'name="x500_guard" type="sphere" size="0.3"',
            "cylinder",
        ),
        ('dyntype="filterexact" dynprm="0.025"', "", "dyntype is"),
        ('dynprm="0.025"', 'dynprm="0"', "rotor lag"),
        ('ctrlrange="0 8.829"', "", "ctrlrange is"),
        ('ctrlrange="0 8.829"', 'ctrlrange="-1 8.829"', "ctrlrange is"),
        ('gainprm="1"', 'gainprm="2"', "gainprm is"),
        ('gear="0 0 1 0 0 0.016"', 'gear="0 1 0 0 0 0.016"', "gear is"),
        ('pos="0.1768 -0.1768 0"', 'pos="0.1768 -0.1768 0" euler="0.2 0 0"', "quaternion of the rotors' sites"),
        ("drag_area", "draft_area", "drag_area is absent"),
        ("</worldbody>", "", "XML"),
    ],
)
def test_what_is_no_quadrotor_is_refused(tmp_path, old, new, message):
    text = airframe_path("x500").read_text()
    assert old in text
    check_refused(tmp_path, text[: text.index("<keyframe>")].replace(old, new) + "</mujoco>", message)


def test_an_airframe_without_actuators_is_refused(tmp_path):
    text = airframe_path("x500").read_text()
    check_refused(tmp_path, text[: text.index("<actuator>")] + "</mujoco>", "number of actuators is 0\\b")


def check_refused(folder, text, message):
    (folder / "ground.xml").write_text(airframe_path("x500").with_name("ground.xml").read_text())
    odd = folder / "odd.xml"
    odd.write_text(text)
    with pytest.raises(AirframeError, match=message) as refusal:
        read_airframe(odd)
    assert str(refusal.value).startswith("airframe odd: ")
    assert "\n" not in str(refusal.value)
