"""HTML page of one flight, or two in one arena: an offline 3D replay with a time slider."""

from __future__ import annotations

import contextlib
import html
import io
import os
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moflock_mj.errors import RenderError
from moflock_mj.files import new_file
from moflock_mj.simulation.results import AnyFlight
from moflock_mj.visualization.captions import conditions, figures, flight_names
from moflock_mj.visualization.colours import LegendEntry
from moflock_mj.visualization.playback import Playback, Track, playback_of

_MAX_FRAMES = 3000
"""Maximum number of frames of a page; a longer flight has a lower frame rate."""

_MARKER_SHARE = 1 / 28
"""Length of a marker as a share of the arena's side; a drone to scale would be one pixel wide."""

_TRAIL_PIECES = 24
_TRAIL_SECONDS = 10.0
_BACKGROUND = (20, 24, 30)
_EDGE = (120, 170, 220)
_GRID = (70, 80, 92)


def write_page(
    flights: AnyFlight | Sequence[AnyFlight], out: str | os.PathLike[str], *, colour: str = "danger"
) -> None:
    """Write the page of one flight, or of two to compare.

    Args:
        flights: one or two flights with samples, in one arena; each of two has its own colour.
        out: file to write, .html.
        colour: quantity shown by the drones' colour, "danger" or "speed".

    Raises:
        RenderError: no samples, more than two flights, viser is not installed, or the file cannot be written.
    """
    flights = list(flights) if isinstance(flights, Sequence) else [flights]
    names = flight_names(flights)
    playback = playback_of(flights, colour=colour, names=names)
    page = _record(playback)
    with new_file(out) as place:
        place.write_text(_add_captions(page, playback, flights, names), encoding="utf-8")


def _record(playback: Playback) -> str:
    """Record the replay as a page of viser."""
    try:
        import viser  # noqa: PLC0415 - an extra
    except ImportError as problem:
        raise RenderError("html: viser is not installed; pip install 'moflock-mj[html]'") from problem
    # The recording needs a server, without any client, on a free port. The server prints to stdout.
    with contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        _draw_arena(server.scene, playback)
        _place_camera(server, playback)
        flocks = [_Flock(server.scene, number, track, playback) for number, track in enumerate(playback.tracks)]
        recording = server.get_scene_serializer()
        times = frame_times(playback)
        for frame, time in enumerate(times):
            for flock in flocks:
                flock.show(frame, float(time))
            recording.insert_sleep(float(times[1] - times[0]) if len(times) > 1 else 0.0)
        return str(recording.as_html(dark_mode=True))
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


def frame_times(playback: Playback) -> NDArray[np.float64]:
    """Times of the frames, s: one per sample, up to `_MAX_FRAMES`."""
    samples = max(track.t.size for track in playback.tracks)
    return np.linspace(playback.begin, playback.end, min(samples, _MAX_FRAMES))


class _Flock:
    """Drones of one flight in viser's scene: darts that point along the velocity, and trails."""

    def __init__(self, scene: Any, number: int, track: Track, playback: Playback) -> None:
        self._track = track
        self._length = marker_length(playback)
        self._every = max(1, round(_TRAIL_SECONDS / _TRAIL_PIECES / _frame_period(playback)))
        first = track.at(playback.begin)
        vertices, faces = _dart(self._length)
        self._darts = scene.add_batched_meshes_simple(
            f"/flight {number + 1}/drones",
            vertices,
            faces,
            batched_wxyzs=_along(first.velocity),
            batched_positions=first.position,
            batched_colors=_linear(first.rgb),
            flat_shading=True,
            side="double",
            lod="off",
            cast_shadow=False,
        )
        still = np.repeat(first.position[:, None], 2, axis=1)
        self._trail = [
            scene.add_line_segments(
                f"/flight {number + 1}/trail/{piece}",
                points=still,
                colors=_pair(first.rgb),
                thickness=1.5,
                thickness_units="screen",
            )
            for piece in range(_TRAIL_PIECES)
        ]
        self._corner = first.position

    def show(self, frame: int, time: float) -> None:
        """Move the drones to their positions at a time, s, and extend the trails at intervals."""
        now = self._track.at(time)
        self._darts.batched_positions = now.position
        self._darts.batched_wxyzs = _along(now.velocity)
        self._darts.batched_colors = _linear(now.rgb)
        if frame % self._every == 0:
            piece = self._trail[frame // self._every % _TRAIL_PIECES]
            piece.points = np.stack([self._corner, now.position], axis=1)
            piece.colors = _pair((0.6 * now.rgb).astype(np.uint8))
            self._corner = now.position


def marker_length(playback: Playback) -> float:
    """Length of a drone's marker, m: visible with the whole arena in view, and not smaller than the drone."""
    return max(float(np.ptp(playback.outline, axis=0).max()) * _MARKER_SHARE, 1.5 * playback.drone_width)


def _frame_period(playback: Playback) -> float:
    times = frame_times(playback)
    return float(times[1] - times[0]) if len(times) > 1 else 1.0


def _dart(length: float) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """Mesh of a dart along x with a length in m, centred at the origin: corners, (5, 3), and faces, (6, 3)."""
    corners = np.array([[0.5, 0, 0], [-0.5, 0.32, 0], [-0.5, -0.32, 0], [-0.3, 0, 0.18], [-0.3, 0, -0.1]])
    faces = np.array([[0, 1, 3], [0, 3, 2], [1, 2, 3], [0, 4, 1], [0, 2, 4], [1, 4, 2]])
    return (length * corners).astype(np.float32), faces.astype(np.uint32)


def _along(velocity: NDArray[np.float32]) -> NDArray[np.float32]:
    """Quaternions about z that turn x towards the velocity, (N, 4), wxyz; velocity: (N, 3), m/s."""
    half = np.arctan2(velocity[:, 1], velocity[:, 0]) / 2
    zero = np.zeros_like(half)
    return np.stack([np.cos(half), zero, zero, np.sin(half)], axis=1).astype(np.float32)


def _pair(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Colours of both ends of each line, (N, 2, 3); rgb: (N, 3)."""
    return np.repeat(_linear(rgb)[:, None], 2, axis=1)


def _linear(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Convert sRGB colours to the linear colours that the renderer expects for batches."""
    return np.asarray((255 * (rgb / 255) ** 2.2).round(), np.uint8)


def _draw_arena(scene: Any, playback: Playback) -> None:
    """Draw the edges of the walls, and a grid of a tenth of the arena on the ground."""
    scene.set_up_direction("+z")
    # Directional lights would change the drones' colours, which carry information.
    scene.configure_default_lights(enabled=False)
    scene.add_light_ambient("/light", intensity=1.0)
    scene.set_background_image(np.full((2, 2, 3), _BACKGROUND, np.uint8), format="png")
    outline, top = playback.outline, 2 * playback.altitude
    for name, height, width in (("ground", 0.0, 2.5), ("altitude", playback.altitude, 1.0), ("top", top, 2.5)):
        corners = np.column_stack([outline, np.full(len(outline), height)])
        edges = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
        scene.add_line_segments(f"/arena/{name}", points=edges, colors=_EDGE, thickness=width, thickness_units="screen")
    posts = np.stack([np.column_stack([outline, np.full(len(outline), height)]) for height in (0.0, top)], axis=1)
    scene.add_line_segments("/arena/posts", points=posts, colors=_EDGE, thickness=1.5, thickness_units="screen")
    low, high = outline.min(axis=0), outline.max(axis=0)
    scene.add_grid(
        "/arena/ground grid",
        width=float(high[0] - low[0]),
        height=float(high[1] - low[1]),
        cell_size=float(high[0] - low[0]) / 10,
        section_size=float(high[0] - low[0]) / 2,
        cell_color=_GRID,
        section_color=_GRID,
        fade_strength=0.0,
        position=(*((low + high) / 2), 0.0),
    )


def _place_camera(server: Any, playback: Playback) -> None:
    """Place the camera in the south and above, with the whole arena in view."""
    low, high = playback.outline.min(axis=0), playback.outline.max(axis=0)
    side, middle = float(np.max(high - low)), (low + high) / 2
    server.initial_camera.position = (middle[0], middle[1] - 0.78 * side, 0.66 * side)
    server.initial_camera.look_at = (middle[0], middle[1] - 0.04 * side, 0.0)
    server.initial_camera.far = 20 * side


_STYLE = """<style>
#flight{position:fixed;right:12px;top:12px;z-index:5;max-width:min(25rem,calc(100vw - 24px));box-sizing:border-box;
 padding:10px 14px;border-radius:8px;background:rgba(15,18,23,.82);color:#e8ebef;font:12px/1.4 system-ui,sans-serif;}
#flight summary{cursor:pointer;font-weight:600;margin-bottom:4px}
#flight b{font-size:13px}#flight p{margin:0 0 6px}#flight i{display:inline-block;height:10px;margin-right:6px;
 border-radius:3px;width:10px}#flight i.scale{width:90px}#flight small{color:#aab2bd}
</style>"""


def _add_captions(page: str, playback: Playback, flights: Sequence[AnyFlight], names: list[str]) -> str:
    """Add a title, the flights' figures and the legend to the page."""
    title = html.escape(" and ".join(names))
    parts = [
        f"<p>{_name(name, number, playback)}{html.escape(conditions(flight))}<br>{html.escape(figures(flight))}</p>"
        for number, (name, flight) in enumerate(zip(names, flights, strict=True))
    ]
    key = "".join(f"<div>{_key(entry)}</div>" for entry in playback.legend)
    times = marker_length(playback) / playback.drone_width
    note = (
        f"Markers are {marker_length(playback):.3g} m long, {times:.0f} times the size of a drone, "
        "and point along its velocity."
    )
    parts.append(f"{key}<small>{note} Trails: {_TRAIL_SECONDS:g} s.</small>")
    panel = f'<details id="flight" open><summary>{title}</summary>{"".join(parts)}</details>'
    before, body, after = page.partition("<body>")
    if not body:
        raise RenderError("html: viser's page has no <body>; it must have one: install another release of viser")
    head = f"<title>{title} - moflock</title>{_STYLE}"
    before = re.sub("<title>.*?</title>", lambda _: head, before, count=1)
    return f"{before}{body}{panel}{after}"


def _name(name: str, number: int, playback: Playback) -> str:
    """Name of a compared flight in its colour; empty for a single flight, whose name is the title."""
    if len(playback.tracks) == 1:
        return ""
    scale = playback.legend[number]
    # A speed scale begins with a dark shade, a danger scale with the flight's own colour.
    tone = scale.rgb[1] if scale.bounds[0] == 0 else scale.rgb[0]
    return f'<b style="color:{_css(tone)}">{html.escape(name)}</b><br>'


def _css(rgb: Sequence[int]) -> str:
    return f"rgb({','.join(str(int(channel)) for channel in rgb)})"


def _key(entry: LegendEntry) -> str:
    """Line of the legend: a colour, or a scale with its bounds."""
    label = html.escape(entry.label)
    tones = [_css(rgb) for rgb in entry.rgb]
    if not entry.bounds:
        return f'<i style="background:{tones[0]}"></i>{label}'
    first, last = (f"{bound:g}" for bound in (entry.bounds[0], entry.bounds[-1]))
    scale = f'<i class="scale" style="background:linear-gradient(90deg,{",".join(tones)})"></i>'
    return f"{label}: {first} {scale}{last}"
