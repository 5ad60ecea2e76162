"""Airframes: reading of model files, and composition of a flock's model from copies of an airframe."""

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
"""Distance between neighbours in the composed model, m, with one drone per ground cell."""

_DISABLED = (
    # An automatic reset would hide a diverged state from the check in `Simulation.run`.
    mujoco.mjtDisableBit.mjDSBL_AUTORESET
    # Free bodies have no springs and no dampers; skipping them saves a tenth of each step.
    | mujoco.mjtDisableBit.mjDSBL_SPRING
    | mujoco.mjtDisableBit.mjDSBL_DAMPER
)


def airframe_names() -> tuple[str, ...]:
    """Names of the available airframes: the files in models/ except the ground."""
    return tuple(sorted(path.stem for path in _models_folder().glob("*.xml") if path.stem != _GROUND))


def airframe_path(name: str) -> Path:
    """Path of the model file of an airframe, which is a complete MuJoCo model with actuators.

    Raises:
        AirframeError: the airframe is unknown.
    """
    names = airframe_names()
    if name not in names:
        raise AirframeError(f"airframe: {name!r} is unknown; there are {', '.join(names)}")
    return _models_folder() / f"{name}.xml"


def load_airframe(name: str) -> Airframe:
    """Read an airframe from its model file.

    Args:
        name: name in `airframe_names`.

    Raises:
        AirframeError: the airframe is unknown, or its file does not describe a supported quadrotor.
    """
    return read_airframe(airframe_path(name))


def read_airframe(path: Path) -> Airframe:
    """Read an airframe from an MJCF file; its name is the stem of the path.

    Raises:
        AirframeError: the file cannot be compiled, or does not describe a supported quadrotor.
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
    """Compose the model of a flock: copies of an airframe on the ground, without rotors.

    The cost of MuJoCo's site actuators grows with the square of the flock. The model therefore has none, and the caller
    applies the rotors' forces to the bodies. The name of body i starts with `body_prefix`, and its free joint is joint
    i, so that qpos is (drones, 7) and qvel (drones, 6).

    Args:
        airframe_name: name in `airframe_names`.
        drones: number of copies, at least 1.
        timestep: integration step, s.
        visuals: True to keep visual geoms; they do not change the physics but cost time in every step.

    Raises:
        AirframeError: the airframe is unknown.
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
    """Compile the model of `flock_spec`.

    Raises:
        AirframeError: the airframe is unknown.
    """
    return flock_spec(airframe_name, drones, timestep, visuals=visuals).compile()


def body_prefix(drone: int, drones: int) -> str:
    """Prefix of the names of a drone's elements, such as `drone_07_`, with a constant number of digits in a flock.

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
    """Body of an airframe without the elements that a flock does not need (`mujoco.MjsBody`)."""
    spec = mujoco.MjSpec.from_file(str(airframe_path(airframe_name)))
    body = spec.worldbody.first_body()
    removed = [*spec.actuators, *spec.keys, *spec.sites]
    if not visuals:
        removed += [geom for geom in body.geoms if not geom.contype and not geom.conaffinity]
    # Assets and default classes would be copied once per drone. The elements no longer need their classes: reading the
    # file has already applied them.
    removed += [*(geom for geom in spec.geoms if geom.parent != body), *spec.materials, *spec.textures]
    kept = [body, *body.joints, *body.geoms]
    classes = {element.classname.name for element in (*kept, *removed) if hasattr(element, "classname")}
    for element in removed:
        spec.delete(element)
    for element in kept:
        element.classname = spec.default
    for name in classes - {spec.default.name}:
        unused = spec.find_default(name)
        if unused is not None:  # otherwise it was deleted with its parent class
            spec.delete(unused)
    return body


class _Requirements:
    """Check of a model file: a failure raises one line that names the field, its value and the limit."""

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
    require((model.site_bodyid[sites] == body).all(), "body of the rotors' sites", "another", "that of the vehicle")
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
    """Number of the file's custom data, checked to be at least 0, or above 0."""
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
