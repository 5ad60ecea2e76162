"""The picture of a flight: what stands on it, that it is whole or not there, and what is refused."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Text
from PIL import Image

from moflock_mj import Flight, Scenario, fly, load_point
from moflock_mj.errors import RenderError
from moflock_mj.visualization.flight_figure import feasible_maxima, flight_figure, save_flight_figure


def flown(point: str = "A", drones: int = 6, duration: float = 8.0, **given: object) -> Flight:
    scenario = Scenario(drones=drones, duration=duration, arena_side=120.0, start_spacing=5.0)
    return fly(load_point(point), scenario=scenario, dynamics="point_mass", **given)


@pytest.fixture(scope="module")
def flight() -> Flight:
    return flown()


def test_png_has_the_promised_size_and_something_on_it(flight: Flight, tmp_path: Path) -> None:
    save_flight_figure(flight, tmp_path / "new" / "a.png")
    with Image.open(tmp_path / "new" / "a.png") as picture:
        assert picture.size == (1875, 1500)
        assert round(picture.info["dpi"][0]) == 150
        assert len(set(picture.convert("RGB").resize((200, 160)).get_flattened_data())) > 50
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["a.png"]


@pytest.mark.parametrize(("ending", "head"), [(".svg", b"<?xml"), (".pdf", b"%PDF")])
def test_vector_formats_by_ending(flight: Flight, tmp_path: Path, ending: str, head: bytes) -> None:
    save_flight_figure(flight, tmp_path / f"a{ending}")
    assert (tmp_path / f"a{ending}").read_bytes().startswith(head)


def test_every_axis_is_labelled_with_a_unit(flight: Flight) -> None:
    figure = flight_figure([flight])
    labels = {label for axes in figure.axes for label in (axes.get_xlabel(), axes.get_ylabel()) if label}
    assert {"x, m", "y, m", "time, s", "distance, m", "speed, m/s"} <= labels
    assert all(axes.lines or axes.collections for axes in figure.axes)


def test_title_names_point_seed_and_objectives(flight: Flight) -> None:
    title = flight_figure([flight]).get_suptitle()
    for part in ("point A", "6 point masses", "8 s", "seed 1", f"F_1 = {flight.fitness.F_1:.3f}", "F_2 = "):
        assert part in title


def test_curves_are_the_running_order_parameters_over_their_maxima(flight: Flight) -> None:
    axes = next(axes for axes in flight_figure([flight]).axes if "Order parameters" in axes.get_title(loc="left"))
    maxima = feasible_maxima(flight.scenario)._asdict()
    curves = {line.get_label().partition(":")[0]: line.get_ydata() for line in axes.lines}
    np.testing.assert_allclose(curves["speed"], np.minimum(flight.samples.order_parameters.vel / maxima["vel"], 1))
    assert all(np.max(curve) <= 1 for curve in curves.values())
    assert axes.get_ylim()[1] == pytest.approx(1.03)


def test_two_flights_have_a_map_each_and_their_own_colours(flight: Flight, tmp_path: Path) -> None:
    figure = flight_figure([flight, flown("B")])
    shown = {axes.get_title(loc="left") for axes in figure.axes}
    titles = {text.get_text(): text.get_color() for text in figure.findobj(Text) if text.get_text() in shown}
    maps = {title: colour for title, colour in titles.items() if title.endswith("Trajectories from above")}
    assert len(maps) == len(set(maps.values())) == 2
    save_flight_figure([flight, flown("B")], tmp_path / "ab.png")
    with Image.open(tmp_path / "ab.png") as picture:
        assert picture.width == 1875


def test_flights_of_one_point_are_distinguished_by_their_seeds(flight: Flight) -> None:
    title = flight_figure([flight, flown(seed=2)]).get_suptitle()
    assert "point A, seed 1:" in title
    assert "point A, seed 2:" in title


def test_a_single_drone_and_a_short_flight_are_drawn(tmp_path: Path) -> None:
    save_flight_figure(flown(drones=1, duration=0.1), tmp_path / "a.png")
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.size == (1875, 1500)
        assert len(set(picture.convert("RGB").resize((200, 160)).get_flattened_data())) > 50


def test_what_cannot_be_drawn_is_refused_in_one_line(flight: Flight, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.png").mkdir()
    for flights, out, reason in (
        (flight, "a.gif", r"a\.gif: its name ends in '\.gif'.*one of \.png, \.svg, \.pdf"),
        ([flight] * 3, "a.png", "flights: 3 given.*1 to 2"),
        (dataclasses.replace(flight, samples=None), "a.png", "samples: the flight has none"),
        (flight, "file/a.png", "file/a.png: "),
        (flight, "folder.png", "it is a folder"),
    ):
        with pytest.raises(RenderError, match=reason) as problem:
            save_flight_figure(flights, tmp_path / out)
        assert "\n" not in str(problem.value)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder.png"]
