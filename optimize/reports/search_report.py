"""Report of a search: a self-contained HTML page, and its figures as PNG files."""

from __future__ import annotations

import html
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from controllers.policies.registry import POLICIES
from moflock_mj.files import new_file
from moflock_mj.metrics.catalogue import METRICS
from moflock_mj.visualization.figure_style import BLACK, GREEN, ORANGE, PINK, RED
from optimize.analysis.pca import agreement
from optimize.analysis.published_results import FIRST_COMPONENT, PAPER_RESULTS
from optimize.evaluation.objectives import PAPER
from optimize.reports.figures import (
    Landmark,
    components_figure,
    data_url,
    drawn_png,
    front_figure,
    generations_figure,
    hypervolume_figure,
    paper_landmarks,
    parameters_figure,
)
from optimize.reports.flight_figures import order_parameters_figure
from optimize.search.findings import Findings
from optimize.search.front import ReevaluatedFront

_FITNESS_LABELS = tuple(metric.fitness_symbol for metric in METRICS)

_STYLE = """
:root{color-scheme:light}
body{margin:0 auto;padding:1.5rem 1.25rem 4rem;max-width:78rem;background:#fff;color:#1d2127;
 font:16px/1.55 system-ui,sans-serif}
h1{font-size:1.6rem;margin:0 0 .25rem}h2{font-size:1.15rem;margin:2.4rem 0 .5rem}
p{margin:.4rem 0;max-width:46rem}figure{margin:.6rem 0}img{max-width:100%;height:auto}
.wide{overflow-x:auto}table{border-collapse:collapse;font-size:.8rem;font-variant-numeric:tabular-nums}
th,td{padding:.2rem .5rem;text-align:right;white-space:nowrap}th:first-child,td:first-child{text-align:left}
thead th{border-bottom:2px solid #1d2127;vertical-align:bottom}tbody tr:nth-child(even){background:#f4f5f7}
tr.rule td{border-top:1px solid #1d2127}.facts{color:#555d68}
"""


def write_report(found: Findings, out: str | Path) -> Path:
    """Write `index.html`, which includes all figures, and the figures as PNG files.

    Args:
        found: findings of the search.
        out: output folder; created if needed.

    Returns:
        Path of the page.

    Raises:
        RenderError: a file cannot be written.
    """
    out = Path(out)
    sections = []
    for name, title, text, draw in _figures(found):
        image = drawn_png(draw)
        with new_file(out / f"{name}.png") as place:
            place.write_bytes(image)
        sections.append(_figure_section(title, text, image))
    # The table belongs to the first figure, the front.
    body = "\n".join([_head(found), sections[0], _results_section(found), *sections[1:], _front_section(found.front)])
    page = out / "index.html"
    with new_file(page) as place:
        place.write_text(
            f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
            f'<meta name="viewport" content="width=device-width,initial-scale=1">'
            f"<title>{html.escape(found.name)} - moflock</title><style>{_STYLE}</style></head>\n"
            f"<body>\n{body}\n</body></html>\n",
            encoding="utf-8",
        )
    return page


def _figures(found: Findings) -> Iterable[tuple[str, str, str, Callable[[], Figure]]]:
    """File name, title, text and drawing function of each figure."""
    front, names = found.front, found.front.objectives.names
    yield (
        "front",
        "Front",
        f"The {len(front.mean)} best points of the search were flown again on {len(front.seeds)} fresh seeds, which "
        f"the search had not used. {len(front.remaining)} of them are not dominated in the mean. "
        "Bars show one standard deviation over the flights.",
        lambda: front_figure(front, _landmarks(found)),
    )
    yield (
        "generations",
        "Estimated fronts",
        "Front after each of the last even generations, from estimated means less one standard error.",
        lambda: generations_figure(found.generations, names),
    )
    yield (
        "hypervolume",
        "Hypervolume over flights",
        "Hypervolume as estimated during the search, and hypervolume of the front on fresh seeds (dashed).",
        lambda: hypervolume_figure(found.volumes, front.hypervolume),
    )
    if found.components is not None:
        yield _components(found)
    yield (
        "parameters",
        "Parameters on the front",
        f"Each parameter over the mean {names[0]}; dashed lines are the bounds of the search.",
        lambda: parameters_figure(front, found.configuration.bounds),
    )
    if found.parameters is not None:
        parameters = found.parameters
        share = float(np.sum(parameters.explained[:3]))
        yield (
            "parameter_components",
            "Correlation of the parameters",
            f"Principal components of the {len(parameters.names)} parameters over the {parameters.samples} points of "
            f"the front. The first three components explain {100 * share:.0f} % of the variance.",
            lambda: components_figure(parameters, parameters.names, "Covariance of the parameters"),
        )
    yield (
        "order_parameters",
        "Order parameters of the extreme points",
        f"One flight of each point, seed {found.statistics[0].seed}. Order parameters with solid lines should be high, "
        "those with dashed lines low.",
        lambda: order_parameters_figure(found.statistics, [f"Best {names[0]}", f"Best {names[-1]}"]),
    )


def _components(found: Findings) -> tuple[str, str, str, Callable[[], Figure]]:
    components = found.components
    assert components is not None  # for the type checker: the caller has checked it
    near = agreement(components)
    signs = "the same signs as" if near.same_signs else "not all the signs of"
    return (
        "pca",
        "Principal components of the fitnesses",
        f"Principal components of the six fitnesses of {components.samples} random points. The first component has "
        f"{signs} the paper's. The cosine between the two is {near.cosine:.3f}, and the elements of the covariance "
        f"matrices differ by {near.covariance_error:.3f} on average.",
        lambda: components_figure(components, _FITNESS_LABELS, "Covariance of the fitnesses", FIRST_COMPONENT),
    )


def _landmarks(found: Findings) -> list[Landmark]:
    """Landmarks as flown here and, if the objectives are the paper's, as printed in the paper."""
    styles = {"A": (RED, "<"), "B": (RED, "v"), "model_optimum": (GREEN, "s")}
    others = iter(((ORANGE, "D"), (PINK, "P"), (BLACK, "X")))
    flown = []
    for name, mean, deviation in zip(
        found.landmark_names, found.landmarks.mean, found.landmarks.deviation, strict=True
    ):
        colour, marker = styles[name] if name in styles else next(others, (BLACK, "*"))
        flown.append(Landmark(f"{_title(name)}, flown here", mean[:2], deviation[:2], colour, marker))
    return flown + (paper_landmarks() if found.front.objectives.groups == PAPER.groups else [])


def _title(name: str) -> str:
    return {"A": "paper's A", "B": "paper's B", "model_optimum": "model's optimum"}.get(name, name)


def _head(found: Findings) -> str:
    settings, scenario, front = found.configuration.settings, found.configuration.scenario, found.front
    count, failed = found.evaluations
    groups = "; ".join(
        f"{name} = {' · '.join(f'F_{member}' for member in group)}"
        for name, group in zip(front.objectives.names, front.objectives.groups, strict=True)
    )
    facts = (
        f"{settings.algorithm}, seed {settings.seed}, noise: {settings.noise}; {count} evaluations, {failed} of them "
        f"failed; {scenario.drones} drones as {settings.dynamics.replace('_', ' ')}, {scenario.arena.title}, "
        f"{scenario.duration:g} s a flight."
    )
    knee = ", ".join(
        f"{name} {mean:.3f} ± {spread:.3f}"
        for name, mean, spread in zip(
            front.objectives.names, front.mean[front.knee], front.deviation[front.knee], strict=True
        )
    )
    return (
        f"<h1>Search {html.escape(found.name)}</h1>\n<p class='facts'>{html.escape(facts)}<br>"
        f"Maximised: {html.escape(groups)}.</p>\n"
        f"<p>Hypervolume of the front on {len(front.seeds)} fresh seeds: <b>{front.hypervolume:.3f}</b>. "
        f"Knee of the front: {html.escape(knee)}.</p>"
    )


def _figure_section(title: str, text: str, image: bytes) -> str:
    return (
        f"<h2>{html.escape(title)}</h2>\n<p>{html.escape(text)}</p>\n"
        f'<figure><img alt="{html.escape(title)}" src="{data_url(image)}"></figure>'
    )


class _Column(NamedTuple):
    """Column of the table of results: title, formatted objectives, and parameters of a point."""

    title: str
    objectives: Sequence[str]
    params: Sequence[float]


def _results_section(found: Findings) -> str:
    """Table of results in the form of the paper's: its points as printed and as flown here, and the new points."""
    front, names = found.front, found.front.objectives.names
    papers = {name: _paper_columns(found, name) for name in PAPER_RESULTS if name in found.landmark_names}
    others = [name for name in found.landmark_names if name not in papers]
    columns = [
        *papers.get("A", ()),
        _own_column(front, front.best(0), f"best {names[0]}"),
        *papers.get("B", ()),
        _own_column(front, front.best(-1), f"best {names[-1]}"),
        *(_own_column(found.landmarks, found.landmark_names.index(name), _title(name)) for name in others),
        _own_column(front, front.knee, "knee"),
    ]
    rows = [[name, *(column.objectives[row] for column in columns)] for row, name in enumerate(names)]
    for index, parameter in enumerate(POLICIES[front.policy].parameters):
        rows.append([parameter.label, *(f"{column.params[index]:.4g}" for column in columns)])
    text = (
        f'Mean ± standard deviation over {len(front.seeds)} flights, and the parameters. Columns with "printed" show '
        "the paper's results for its points."
    )
    table = _table(["", *(column.title for column in columns)], rows, rule_before=len(names))
    return f"<h2>Results</h2>\n<p>{html.escape(text)}</p>\n{table}"


def _paper_columns(found: Findings, name: str) -> list[_Column]:
    """Columns of a point of the paper: as printed, if the objectives are the paper's, and as flown here."""
    here = _own_column(found.landmarks, found.landmark_names.index(name), f"{name}, flown here")
    if found.front.objectives.groups != PAPER.groups:
        return [here]
    printed = PAPER_RESULTS[name]
    objectives = [f"{mean:.3f} ± {spread:.3f}" for mean, spread in (printed.F_1, printed.F_2)]
    return [_Column(f"{name}, printed", objectives, here.params), here]


def _own_column(front: ReevaluatedFront, number: int, title: str) -> _Column:
    pairs = zip(front.mean[number], front.deviation[number], strict=True)
    return _Column(title, [f"{mean:.3f} ± {spread:.3f}" for mean, spread in pairs], front.points[number].tolist())


def _front_section(front: ReevaluatedFront) -> str:
    """Table of all points on the front."""
    names = front.objectives.names
    rows = [
        [
            str(place),
            *(f"{m:.3f} ± {h:.3f}" for m, h in zip(front.mean[number], front.half_width[number], strict=True)),
            *(f"{value:.4g}" for value in front.points[number]),
        ]
        for place, number in enumerate(front.remaining, start=1)
    ]
    head = ["", *names, *POLICIES[front.policy].names]
    return (
        "<h2>All points of the front</h2>\n<p>Mean on fresh seeds ± half width of its 95 % confidence interval, "
        f"and the parameters.</p>\n{_table(head, rows)}"
    )


def _table(head: Sequence[str], rows: Sequence[Sequence[str]], rule_before: int = -1) -> str:
    def line(cells: Sequence[str], tag: str) -> str:
        return "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in cells)

    body = "\n".join(
        f"<tr{' class=rule' if number == rule_before else ''}>{line(row, 'td')}</tr>" for number, row in enumerate(rows)
    )
    return (
        f"<div class='wide'><table><thead><tr>{line(head, 'th')}</tr></thead>\n<tbody>\n{body}\n</tbody></table></div>"
    )
