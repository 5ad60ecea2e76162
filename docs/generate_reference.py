"""Fills the generated parts of the documentation when MkDocs builds the site (`make docs`).

A page asks for a part by a comment, `<!-- generated: NAME -->`. Everything here is read from the code, so that the
site cannot disagree with it.
"""

from __future__ import annotations

import ast
import dataclasses
import html
import importlib
import math
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import FunctionType
from typing import Any

import typer
from google.protobuf.descriptor_pb2 import FieldDescriptorProto

import moflock_mj
import optimize
from controllers.policies.registry import POLICIES, values_of
from moflock_mj import Scenario, load_point, point_names
from moflock_mj.cli.app import make_app
from moflock_mj.deployment.watchdogs import Watchdog, Watchdogs
from moflock_mj.fields import FieldSpec, Section
from moflock_mj.log import schemas
from moflock_mj.scenario.faults import KINDS, FaultConfig
from moflock_mj.world.arena import SHAPES, arena_fields

ROOT = Path(__file__).parent.parent

PACKAGES = ("controllers", "moflock_mj", "optimize")

CHANNELS = {
    "/swarm/points": "positions, attitudes, velocities, rates, commanded velocities and colours of all drones",
    "/tf": "the pose of each drone as a transform from `world` to `drone_NN`",
    "/metrics": "running order parameters and fitness, the number of the sample and a digest of the exact state",
    "/log": "events: contacts, near misses, exits from the arena, faults and their ends, the end of the flight",
    "/scene": "bodies of the drones and the boundary of the arena for 3D viewers",
    "/sim/state": "the complete state of the simulation, from which a flight can be resumed",
    "/arena": "outline of the arena as points",
    "/mavlink": "every MAVLink packet of a deployment",
}
"""Content of each channel of a log."""

WATCHDOGS = {
    "stale": ("age of the position", "s"),
    "lost": ("time without a packet", "s"),
    "fence": ("distance outside the arena at which the vehicle would come to rest", "m"),
    "separation": ("distance to the nearest vehicle", "m"),
    "battery": ("share of the charge that is left", "1"),
}
"""Quantity and unit of each watchdog."""

OPTIMIZE_NAMES = {
    "SearchConfig": "optimize.search.configuration",
    "Configuration": "optimize.search.configuration",
    "search": "optimize.search.search",
    "ReevaluatedFront": "optimize.search.front",
    "load_front": "optimize.search.front",
    "evaluate": "optimize.evaluation.evaluation",
}
"""Documented names of `optimize` where the package itself exports none."""


def on_page_markdown(markdown: str, **_: Any) -> str:
    """MkDocs calls this for every page: put the generated parts in the place of their comments."""
    return re.sub(r"<!-- generated: (\S+) -->", lambda match: PARTS[match[1]](), markdown)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [" | ".join(head), " | ".join("---" for _ in head), *(" | ".join(row) for row in rows)]
    return "\n".join(f"| {line} |" for line in lines) + "\n"


def cell(text: str) -> str:
    """A text that does not end its cell or become HTML."""
    return text.replace("|", "\\|").replace("<", "&lt;").replace("\n", " ")


def sentence(text: str) -> str:
    """A meaning with a capital letter, unless it begins with a name such as `spaced:`."""
    first = text.split(" ", maxsplit=1)[0]
    return cell(text if first.endswith(":") else text[:1].upper() + text[1:])


def number(value: Any) -> str:
    if value in (None, ""):
        return "-"
    return f"`{value:.6g}`" if isinstance(value, float) else f"`{value}`"


def bounds(spec: FieldSpec) -> str:
    if spec.choices:
        return ", ".join(f"`{name}`" for name in spec.choices)
    low = "" if spec.low is None else f"{'>' if spec.open_low else '≥'} {spec.low:.6g}"
    high = "" if spec.high is None else f"≤ {spec.high:.6g}"
    return ", ".join(part for part in (low, high) if part) or "-"


def unit(text: str) -> str:
    return "-" if text == "1" else re.sub(r"\^(\d)", lambda match: "²³"[int(match[1]) - 2], text)


def field_rows(kind: type) -> Iterator[tuple[str, ...]]:
    for field in dataclasses.fields(kind):
        if {"section", "sections", "arena"} & field.metadata.keys():
            continue
        spec: FieldSpec = field.metadata["bounds"]
        yield f"`{field.name}`", unit(spec.unit), number(field.default), bounds(spec), sentence(spec.help)


FIELD_HEAD = ("field", "unit", "default", "bounds", "meaning")


def scenario_fields() -> str:
    """Fields of a scenario that stand outside of its tables."""
    return table(FIELD_HEAD, field_rows(Scenario))


def scenario_tables() -> str:
    """One section for each table that switches on an effect or sets limits."""
    parts = []
    for field in dataclasses.fields(Scenario):
        if "section" not in field.metadata:
            continue
        kind = field.metadata["section"]
        state = "Off where the table is absent." if field.default is None else "Always on."
        parts += [f"### `[{field.name}]`\n", f"{sentence(field.metadata['bounds'].help)}. {state}\n"]
        parts += [table(FIELD_HEAD, field_rows(kind))]
    return "\n".join(parts)


def arena_shapes() -> str:
    rows = [
        (
            f"`{shape}`",
            f"`{field.name}`",
            unit(field.unit),
            f"≥ {field.low:g}, ≤ {field.high:g}",
            sentence(field.meaning),
        )
        for shape in SHAPES
        for field in arena_fields(shape)
    ]
    return table(("shape", "field", "unit", "bounds", "meaning"), rows)


def fault_fields() -> str:
    return table(FIELD_HEAD, field_rows(FaultConfig))


def fault_kinds() -> str:
    rows = [
        (
            f"`{name}`",
            cell(kind.text),
            ", ".join(f"`{figure}`" for figure in kind.figures) or "-",
            "one or all" if kind.of_all else "one",
            "yes" if kind.ends else "no",
        )
        for name, kind in KINDS.items()
    ]
    return table(("kind", "event text", "required fields", "drones", "can end"), rows)


def policy_parameters() -> str:
    """Parameters of each policy, without those that a policy above it has too."""
    parts, known = [], set()
    for spec in POLICIES.values():
        rows = [
            (f"`{item.name}`", unit(item.unit), f"{item.low:g} to {item.high:g}", sentence(item.meaning))
            for item in spec.parameters
            if item not in known
        ]
        known |= set(spec.parameters)
        parts += [f"### `{spec.name}`\n", table(("parameter", "unit", "bounds of a search", "meaning"), rows)]
    return "\n".join(parts)


def named_points() -> str:
    names = point_names()
    values = {name: values_of(load_point(name)) for name in names}
    rows = [(f"`{key}`", *(f"{values[name][key]:.4g}" for name in names)) for key in values[names[0]]]
    return table(("parameter", *names), rows)


def commands() -> str:
    """Every command with its arguments, options and example."""
    group = typer.main.get_command(make_app())
    return "\n".join(part for name, command in group.commands.items() for part in one_command(name, command))  # type: ignore[attr-defined]


def one_command(name: str, command: Any) -> Iterator[str]:
    context = command.make_context(f"moflock {name}", [], resilient_parsing=True)
    yield f"## moflock {name}\n"
    yield cell(command.help).replace("  ", " ") + "\n"
    yield f"```text\n{command.get_usage(context)}\n```\n"
    yield table(("argument or option", "default", "meaning"), map(option_row, option_records(command, context)))
    example, _, notes = (command.epilog or "").partition("\n\n")
    if example:
        lines = example.removeprefix("Example: ").replace("\n", " ").split("; ")
        yield "Example:\n\n```text\n" + "\n".join(lines) + "\n```\n"
    for paragraph in notes.split("\n\n") if notes else ():
        if paragraph.startswith("  "):
            yield "```text\n" + " ".join(paragraph.split()) + "\n```\n"
        else:
            yield cell(paragraph) + "\n"


def option_records(command: Any, context: Any) -> Iterator[tuple[str, str]]:
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record and parameter.name != "help":
            yield record


def option_row(record: tuple[str, str]) -> tuple[str, str, str]:
    name, text = record
    match = re.search(r"\s*\[([^][]*)\]$", text)
    default = ""
    if match:
        text = text[: match.start()]
        default = match[1].removeprefix("default: ").replace("default: ", "")
    if name.startswith("--workers"):
        default = "number of processors"
    return f"<code>{html.escape(name).replace('|', '&#124;')}</code>", cell(default) or "-", cell(text)


def api() -> str:
    """The public names of `moflock_mj`, for mkdocstrings."""
    return documented(moflock_mj._MODULES)


def optimize_api() -> str:
    return documented(getattr(optimize, "_MODULES", OPTIMIZE_NAMES))


def documented(modules: Mapping[str, str]) -> str:
    """Requests to mkdocstrings for some names, each followed once by the project's base classes that it has."""
    parts: dict[str, str] = {}
    for name in sorted(modules, key=str.lower):
        kind = getattr(importlib.import_module(modules[name]), name)
        parts[name] = request(kind, f"{modules[name]}.{name}")
        for base in getattr(kind, "__mro__", ())[1:]:
            if (
                base.__module__.startswith(PACKAGES)
                and base not in (Section, Exception)
                and base.__name__ not in modules
            ):
                parts[base.__name__] = request(base, f"{base.__module__}.{base.__name__}")
    return "\n".join(parts.values())


def request(kind: Any, path: str) -> str:
    """The request for one name; a class of `quantity` fields has a table of them instead of its signature."""
    entry = f"::: {path}\n"
    if not dataclasses.is_dataclass(kind) or not any("bounds" in field.metadata for field in dataclasses.fields(kind)):
        return entry
    methods = [key for key, value in vars(kind).items() if isinstance(value, (FunctionType, classmethod, property))]
    public = [] if issubclass(kind, Section) else [key for key in methods if not key.startswith("_")]  # type: ignore[arg-type]
    members = "[" + ", ".join(public) + "]" if public else "false"
    # The signature of a class has all of its declarations; those of its methods are short.
    entry += f"    options: {{merge_init_into_class: false, show_signature: {bool(public)}, members: {members}}}\n\n"
    fields = "The fields are on the page [Scenario](scenario.md).\n"
    return entry + (fields if kind is Scenario else table(FIELD_HEAD, field_rows(kind)))


def log_channels() -> str:
    if CHANNELS.keys() != schemas.CHANNELS.keys():
        raise ValueError("the documentation describes other channels than moflock_mj.log.schemas has")
    rows = [
        (str(place), f"`{topic}`", f"`{kind.DESCRIPTOR.full_name}`", sentence(CHANNELS[topic]))
        for place, (topic, kind) in enumerate(schemas.CHANNELS.items(), start=1)
    ]
    return table(("id", "topic", "schema", "content"), rows)


def log_messages() -> str:
    """The project's own protobuf messages."""
    type_name = FieldDescriptorProto.Type.Name
    parts = []
    for kind in (schemas.Metrics, schemas.SimState, schemas.Packet):
        descriptor = kind.DESCRIPTOR
        rows = [
            (str(field.number), f"`{field.name}`", type_name(field.type).removeprefix("TYPE_").lower())
            for field in descriptor.fields
        ]
        parts += [f"### `{descriptor.full_name}`\n", table(("number", "field", "type"), rows)]
    return "\n".join(parts)


def point_fields() -> str:
    names = (*schemas.POINT_FLOATS, *schemas.POINT_COLOURS)
    offsets = [4 * place for place in range(len(schemas.POINT_FLOATS))]
    offsets += [offsets[-1] + 4 + place for place in range(len(schemas.POINT_COLOURS))]
    kinds = ["float32"] * len(schemas.POINT_FLOATS) + ["uint8"] * len(schemas.POINT_COLOURS)
    return table(
        ("offset", "field", "type"), [(str(o), f"`{n}`", k) for o, n, k in zip(offsets, names, kinds, strict=True)]
    )


def packages() -> str:
    """Every package with its number of modules and the first sentence of its docstring."""
    rows = []
    for name in PACKAGES:
        for init in sorted((ROOT / name).rglob("__init__.py")):
            folder = init.parent
            words = (ast.get_docstring(ast.parse(init.read_text("utf-8"))) or "").partition("\n")[0]
            modules = sum(1 for path in folder.glob("*.py") if path != init)
            label = str(folder.relative_to(ROOT)).replace("/", ".")
            rows.append((f"`{label}`", str(modules), cell(words)))
    return table(("package", "modules", "purpose"), rows)


def contracts() -> str:
    """The contracts of import-linter as `pyproject.toml` has them."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]
    parts = []
    for contract in settings["contracts"]:
        parts.append(f"### {cell(contract['name'])}\n")
        if contract["type"] == "layers":
            parts.append("```text\n" + "\n".join(contract["layers"]) + "\n```\n")
        else:
            sources, forbidden = (
                ", ".join(f"`{name}`" for name in contract[key]) for key in ("source_modules", "forbidden_modules")
            )
            parts.append(f"{sources} must not import {forbidden}.\n")
    return "\n".join(parts)


def turbulence() -> str:
    module = importlib.import_module("moflock_mj.scenario.effect_configs")
    rows = [(f"`{name}`", f"{speed:.2f} m/s") for name, speed in module.TURBULENCE.items() if not math.isnan(speed)]
    return table(("turbulence", "wind at 6 m"), rows)


def watchdogs() -> str:
    """Default limits and actions."""
    rows = []
    for field in dataclasses.fields(Watchdogs):
        if isinstance(field.default, Watchdog):
            quantity, of = WATCHDOGS[field.name]
            limit = f"{field.default.limit:g} {of}".removesuffix(" 1")
            rows.append((f"`{field.name}`", quantity, limit, f"`{field.default.action.value}`"))
    return table(("watchdog", "quantity", "limit", "action"), rows)


PARTS: dict[str, Callable[[], str]] = {
    "scenario-fields": scenario_fields,
    "scenario-tables": scenario_tables,
    "turbulence": turbulence,
    "arena-shapes": arena_shapes,
    "fault-fields": fault_fields,
    "fault-kinds": fault_kinds,
    "policy-parameters": policy_parameters,
    "named-points": named_points,
    "commands": commands,
    "api": api,
    "optimize-api": optimize_api,
    "log-channels": log_channels,
    "log-messages": log_messages,
    "point-fields": point_fields,
    "watchdogs": watchdogs,
    "packages": packages,
    "contracts": contracts,
}
