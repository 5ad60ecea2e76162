"""Airframes: what a model file says of a vehicle, and the flock's model composed from many copies of it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from controllers.airframe import GRAVITY, ROTORS, Airframe
from moflock_mj.errors import AirframeError

_GROUND = "ground"
_GRID_SPACING = 10.0
"""Distance between neighbours in the composed model, in m: one drone per cell of the ground."""

_DISABLED = (
    # A flock that blows up must be seen by the flight's own guard, not set back to the start behind its back.
    mujoco.mjtDisableBit.mjDSBL_AUTORESET
    # Free bodies have neither springs nor dampers; not looking for them takes a tenth off each step.
    | mujoco.mjtDisableBit.mjDSBL_SPRING
    | mujoco.mjtDisableBit.mjDSBL_DAMPER
)


def airframe_names() -> tuple[str, ...]:
    """The airframes that can be flown: the files of models/ but the ground."""
    return tuple(sorted(path.stem for path in _models_folder().glob("*.xml") if path.stem != _GROUND))


def airframe_path(name: str) -> Path:
    """The model file of an airframe; it flies by itself, with MuJoCo's own actuators.

    Raises:
        AirframeError: there is none of that name.
    """
    names = airframe_names()
    if name not in names:
        raise AirframeError(f"airframe: {name!r} is unknown; there are {', '.join(names)}")
    return _models_folder() / f"{name}.xml"


def load_airframe(name: str) -> Airframe:
    """Read an airframe from its model file, by the shape of its elements.

    Args:
        name: one of `airframe_names`.

    Raises:
        AirframeError: no such airframe, or its file does not describe a quadrotor that the controllers can fly.
    """
    return read_airframe(airframe_path(name))


def read_airframe(path: Path) -> Airframe:
    """Read an airframe from any MJCF file; the file's stem becomes its name.

    Raises:
        AirframeError: the file cannot be compiled, or does not describe a quadrotor that the controllers can fly.
    """
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as problem:
        raise AirframeError(f"airframe {path.stem}: {str(problem).splitlines()[0]}") from None
    require = _Requirements(path.stem)
    body = _free_body(model, require)
    guard = _collision_geom(model, body, require)
    sites, gears = _rotors(model, body, require)
    return Airframe(
        name=path.stem,
        mass=float(model.body_mass[body]),
        inertia=_floats(model.body_inertia[body]),
        rotor_positions=tuple((float(x), float(y)) for x, y, _ in model.site_pos[sites]),
        yaw_ratio=_floats(gears[:, 5]),
        thrust_max=float(model.actuator_ctrlrange[0, 1]),
        rotor_lag=float(model.actuator_dynprm[0, 0]),
        drag_area=_numeric(model, require, "drag_area", "m^2"),
        rotor_drag=_numeric(model, require, "rotor_drag", "1/s"),
        rotor_radius=_numeric(model, require, "rotor_radius", "m", above=True),
        rotor_efficiency=_numeric(model, require, "rotor_efficiency", "", above=True),
        battery_cells=round(_numeric(model, require, "battery_cells", "", above=True)),
        battery_capacity=_numeric(model, require, "battery_capacity", "C", above=True),
        battery_resistance=_numeric(model, require, "battery_resistance", "ohm"),
        radius=float(model.geom_size[guard, 0]),
        half_height=float(model.geom_size[guard, 1]),
    )


def flock_spec(airframe_name: str, drones: int, timestep: float, *, visuals: bool = False) -> mujoco.MjSpec:
    """Compose the flock: `drones` copies of an airframe on the ground, without rotors.

    MuJoCo's site actuators cost time that grows with the square of the flock, so they stay behind in the airframe's
    file; whoever flies the flock applies the rotors' forces to the bodies. Body i is named by `body_prefix`, its free
    joint is joint i, so that qpos is (drones, 7) and qvel (drones, 6).

    Args:
        airframe_name: one of `airframe_names`.
        drones: number of copies, at least 1.
        timestep: s.
        visuals: keep the geoms that are only looked at; physics is the same, but each costs time in every step.

    Raises:
        AirframeError: no such airframe.
    """
    body = _bare_body(airframe_name, visuals)
    spec = mujoco.MjSpec.from_file(str(_models_folder() / f"{_GROUND}.xml"))
    spec.modelname = "flock"
    spec.copy_during_attach = True
    columns = math.ceil(math.sqrt(drones))
    for drone in range(drones):
        row, column = divmod(drone, columns)
        place = spec.worldbody.add_frame(pos=(_GRID_SPACING * column, _GRID_SPACING * row, 0.0))
        place.attach_body(body, body_prefix(drone, drones), "")
    spec.option.timestep = timestep
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.option.gravity = (0.0, 0.0, -GRAVITY)
    spec.option.disableflags |= _DISABLED
    return spec


def flock_model(airframe_name: str, drones: int, timestep: float, *, visuals: bool = False) -> mujoco.MjModel:
    """The compiled model of `flock_spec`.

    Raises:
        AirframeError: no such airframe.
    """
    return flock_spec(airframe_name, drones, timestep, visuals=visuals).compile()


def body_prefix(drone: int, drones: int) -> str:
    """What the names of a drone's elements start with: `drone_07_`, with as many digits as the flock needs.

    Args:
        drone: index, from 0.
        drones: size of the flock.
    """
    digits = max(2, len(str(drones - 1)))
    return f"drone_{drone:0{digits}d}_"


def _models_folder() -> Path:
    """`moflock_mj/models` in an installed wheel, `models` at the repository's root in a checkout."""
    package = Path(__file__).resolve().parents[1]
    installed = package / "models"
    return installed if installed.is_dir() else package.parent / "models"


def _bare_body(airframe_name: str, visuals: bool) -> Any:
    """The airframe's body with nothing on it that a flock does not need (`mujoco.MjsBody`)."""
    spec = mujoco.MjSpec.from_file(str(airframe_path(airframe_name)))
    body = spec.worldbody.first_body()
    unwanted = [*spec.actuators, *spec.keys, *spec.sites]
    if not visuals:
        unwanted += [geom for geom in body.geoms if not geom.contype and not geom.conaffinity]
    # Assets and default classes would be copied once per drone. Elements need their classes no more: what these say was
    # written into them when the file was read.
    unwanted += [*(geom for geom in spec.geoms if geom.parent != body), *spec.materials, *spec.textures]
    kept = [body, *body.joints, *body.geoms]
    classes = {element.classname.name for element in (*kept, *unwanted) if hasattr(element, "classname")}
    for element in unwanted:
        spec.delete(element)
    for element in kept:
        element.classname = spec.default
    for name in classes - {spec.default.name}:
        unused = spec.find_default(name)
        if unused is not None:  # else it went with the class around it
            spec.delete(unused)
    return body


class _Requirements:
    """Refuses an airframe in one line that names the field, its value and the limit."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __call__(self, holds: bool, field: str, value: object, limit: str) -> None:
        if not holds:
            raise AirframeError(f"airframe {self.name}: {field} is {value}, must be {limit}")


def _free_body(model: mujoco.MjModel, require: _Requirements) -> int:
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    require(len(free) == 1 and model.njnt == 1, "number of free joints", len(free), "1, and no other joint")
    require(model.nbody == 2, "number of bodies", model.nbody - 1, "1")
    body = int(model.jnt_bodyid[free[0]])
    offset = model.body_ipos[body]
    require(not offset.any(), "position of the inertia", offset.tolist(), "the body's origin")
    turn = model.body_iquat[body]
    require(np.allclose(turn, (1, 0, 0, 0)), "quaternion of the inertia", turn.tolist(), "1 0 0 0 (diagonal)")
    return body


def _collision_geom(model: mujoco.MjModel, body: int, require: _Requirements) -> int:
    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    geoms = np.flatnonzero(collides & (model.geom_bodyid == body))
    require(len(geoms) == 1, "number of colliding geoms", len(geoms), "1")
    guard = int(geoms[0])
    cylinder = model.geom_type[guard] == mujoco.mjtGeom.mjGEOM_CYLINDER
    require(cylinder, "type of the colliding geom", int(model.geom_type[guard]), "cylinder")
    return guard


def _rotors(
    model: mujoco.MjModel, body: int, require: _Requirements
) -> tuple[np.ndarray[Any, np.dtype[np.int32]], np.ndarray[Any, np.dtype[np.float64]]]:
    """Sites (4,) and gears (4, 6) of the actuators, in their order."""
    require(model.nu == ROTORS, "number of actuators", model.nu, str(ROTORS))
    transmission = model.actuator_trntype
    on_sites = (transmission == mujoco.mjtTrn.mjTRN_SITE).all()
    require(on_sites, "transmission of the actuators", transmission.tolist(), "site")
    sites, gears = model.actuator_trnid[:, 0], model.actuator_gear
    require((model.site_bodyid[sites] == body).all(), "body of the rotors' sites", "another", "the flying one")
    upright = np.allclose(model.site_quat[sites], (1, 0, 0, 0))
    require(upright, "quaternion of the rotors' sites", model.site_quat[sites].tolist(), "1 0 0 0")
    require(np.allclose(gears[:, :5], (0, 0, 1, 0, 0)), "gear", gears.tolist(), "0 0 1 0 0 and the yaw-torque ratio")

    kinds = model.actuator_dyntype
    filtered = (kinds == mujoco.mjtDyn.mjDYN_FILTEREXACT).all()
    require(filtered, "dyntype", kinds.tolist(), f"filterexact ({int(mujoco.mjtDyn.mjDYN_FILTEREXACT)})")
    lags = model.actuator_dynprm[:, 0]
    require(lags[0] > 0 and (lags == lags[0]).all(), "rotor lag (dynprm)", lags.tolist(), "above 0 s, the same for all")
    unit_gain = (model.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED).all() and (
        model.actuator_gainprm[:, 0] == 1
    ).all()
    require(unit_gain, "gainprm", model.actuator_gainprm[:, 0].tolist(), "a fixed gain of 1")
    unbiased = (model.actuator_biastype == mujoco.mjtBias.mjBIAS_NONE).all()
    require(unbiased, "biastype", model.actuator_biastype.tolist(), "none")
    ranges = model.actuator_ctrlrange
    limited = model.actuator_ctrllimited.all() and (ranges == (0, ranges[0, 1])).all() and ranges[0, 1] > 0
    require(limited, "ctrlrange", ranges.tolist(), "0 to the largest thrust in N, the same for all")
    return sites, gears


def _numeric(model: mujoco.MjModel, require: _Requirements, name: str, unit: str, *, above: bool = False) -> float:
    """A number of the file's custom data, at least 0, or above it."""
    numeric = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, name)
    require(numeric >= 0, f"numeric {name}", "absent", f"there, in {unit or 'plain numbers'}")
    value = float(model.numeric_data[model.numeric_adr[numeric]])
    require(
        value > 0 or (value == 0 and not above),
        f"numeric {name}",
        value,
        f"{'above' if above else 'at least'} 0 {unit}".strip(),
    )
    return value


def _floats(values: Any) -> Any:
    return tuple(float(value) for value in values)
