"""What viewer and video draw: places between samples, trails, colours, cameras, markers and the stage."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from moflock_mj import Scenario, fly, load_point
from moflock_mj.errors import RenderError
from moflock_mj.log.schemas import STATUS_RGBA
from moflock_mj.metrics.order_parameters import CLOSE, OUTSIDE, TOUCHED
from moflock_mj.rendering.cameras import CAMERAS, View, camera_path
from moflock_mj.rendering.scene import SceneDecorator, grid_cell, pose, room_for, stage_model
from moflock_mj.visualization.colours import clearances, danger_colours
from moflock_mj.visualization.playback import Playback, playback_of

SCENARIO = Scenario(drones=5, duration=20.0, arena_side=120.0)
QUARTER_TURN = np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])


@pytest.fixture(scope="module")
def flight():
    return fly(load_point("A"), scenario=SCENARIO, dynamics="point_mass")


@pytest.fixture(scope="module")
def playback(flight):
    return playback_of(flight)


def test_a_moment_between_samples_is_on_the_line_between_them(flight, playback):
    track, position = playback.tracks[0], flight.samples.position
    np.testing.assert_allclose(track.at(3.05).position, (position[30] + position[31]) / 2, atol=1e-4)
    np.testing.assert_allclose(track.at(-1.0).position, position[0], atol=1e-4)
    np.testing.assert_allclose(track.at(1e9).position, position[-1], atol=1e-4)


def test_a_turn_goes_the_short_way_even_if_a_quaternion_changes_its_sign(playback):
    track = playback.tracks[0]
    quaternion = track.quaternion.copy()
    quaternion[30], quaternion[31] = [1, 0, 0, 0], -QUARTER_TURN
    turned = dataclasses.replace(track, quaternion=quaternion).at(3.05).quaternion
    eighth = np.array([np.cos(np.pi / 8), 0, 0, np.sin(np.pi / 8)])
    np.testing.assert_allclose(turned, np.broadcast_to(eighth, (5, 4)), atol=1e-6)


@pytest.mark.parametrize("time", [0.0, 0.03, 4.0, 15.23, 20.0, 99.0])
def test_a_trail_ends_at_the_drone_and_is_ten_seconds_long(playback, time):
    track = playback.tracks[0]
    corners, rgb = track.trail(time)
    assert len(corners) == len(rgb) + 1
    assert len(corners) <= 22
    np.testing.assert_array_equal(corners[-1], track.at(time).position)
    oldest = np.searchsorted(track.t, max(min(time, 20.0) - 10.0, 0.0) - 1e-9)
    assert np.linalg.norm(corners[0] - track.position[oldest], axis=-1).max() < 6.0


def test_clearances_are_distances_to_the_nearest_other():
    places = np.array([[[0, 0, 0], [3, 0, 0], [3, 4, 0], [100, 0, 0]]], float)
    np.testing.assert_allclose(clearances(places), [[3, 3, 4, 97]])
    assert np.isinf(clearances(places[:, :1])).all()


def test_the_worst_decides_the_colour_of_danger():
    shades = np.array([[0, 0, 200], [100, 100, 100], [200, 0, 0]])
    status = np.array([[0, 0, 0, OUTSIDE, OUTSIDE | CLOSE, OUTSIDE | CLOSE | TOUCHED]], np.uint8)
    rgb = danger_colours(shades, np.array([[50.0, 12.0, 7.5, 50.0, 2.0, 50.0]]), status, 3.0)
    np.testing.assert_array_equal(rgb[0, :3], [[0, 0, 200], [0, 0, 200], [100, 100, 100]])
    np.testing.assert_array_equal(rgb[0, 3:], STATUS_RGBA[1:, :3])


def test_a_playback_is_the_same_after_it_was_saved(tmp_path, playback):
    playback.save(tmp_path)
    loaded = Playback.load(tmp_path)
    for name in ("t", "position", "quaternion", "velocity", "rgb", "objectives"):
        np.testing.assert_array_equal(getattr(loaded.tracks[0], name), getattr(playback.tracks[0], name))
    assert (loaded.followed, loaded.end, loaded.events) == (playback.followed, 20.0, _lists(playback.events))
    assert [entry.label for entry in loaded.legend] == [entry.label for entry in playback.legend]


def _lists(events):
    return [list(event) for event in events]


def test_flights_that_cannot_be_shown_together_are_refused(flight):
    smaller = dataclasses.replace(flight, scenario=SCENARIO.replace(arena_side=100.0))
    with pytest.raises(RenderError, match="one is in a 120 m arena, the other in a 100 m arena"):
        playback_of([flight, smaller])
    with pytest.raises(RenderError, match=r"3 given.*1 to 2"):
        playback_of([flight] * 3)
    with pytest.raises(RenderError, match="no samples"):
        playback_of([dataclasses.replace(flight, samples=None)])


def test_a_view_places_its_middle_in_the_middle_and_what_is_above_it_above():
    view = View(np.array([1.0, 2.0, 3.0]), 10.0, 30.0, -20.0)
    seen, depth = view.place([[1, 2, 3], [1, 2, 4], view.lookat - 20 * view.axes()[2]])
    np.testing.assert_allclose(seen[0], 0, atol=1e-12)
    assert seen[1, 1] > 0
    np.testing.assert_allclose(depth[[0, 2]], [10, -10])


@pytest.mark.parametrize("camera", ["overview", "top"])
def test_the_whole_arena_is_in_the_picture(playback, camera):
    view = camera_path(playback, camera, 16 / 9, 1.0)(0.0)
    seen, depth = view.place([(*corner, height) for corner in playback.outline for height in (0.0, 40.0)])
    assert (depth > 0).all()
    assert (np.abs(seen) < (16 / 9, 1.0)).all()
    assert np.abs(seen[:, 1]).max() > 0.8


def test_the_chase_camera_keeps_its_drone_in_the_middle(playback):
    path = camera_path(playback, "chase", 16 / 9, 1.0)
    for time in (0.0, 7.7, 20.0):
        seen, _ = path(time).place(playback.tracks[0].at(time).position[[playback.followed]])
        np.testing.assert_allclose(seen, 0, atol=1e-6)


def test_two_flocks_of_different_airframes_share_a_stage(flight):
    other = dataclasses.replace(flight, scenario=SCENARIO.replace(airframe="crazyflie"))
    playback = playback_of([flight, other], names=["one", "two"])
    model = stage_model(playback)
    assert model.nq == 7 * 10
    data = mujoco.MjData(model)
    moments = [track.at(5.0) for track in playback.tracks]
    pose(data, model, moments)
    np.testing.assert_allclose(data.xpos[1:], np.concatenate([moment.position for moment in moments]), atol=1e-5)
    assert model.body_mass[1] > 1 > model.body_mass[6]
    assert grid_cell(playback) == 10.0


@pytest.mark.parametrize("camera", CAMERAS)
def test_markers_trails_and_walls_fit_into_the_scene(playback, camera):
    model = stage_model(playback)
    scene = mujoco.MjvScene(model, room_for(playback))
    view = camera_path(playback, camera, 16 / 9, 1.0)(15.0)
    SceneDecorator(playback, scene).paint(15.0, [playback.tracks[0].at(15.0)], view)
    assert 5 * 20 < scene.ngeom < scene.maxgeom
    assert np.isfinite([geom.pos for geom in scene.geoms[: scene.ngeom]]).all()
