"""The JSON schema of scenario files, generated from the fields of `Scenario`, its tables and the arena's shapes.

Editors use it to complete and check a file while it is written. Rules that relate two fields are checked when the
scenario is loaded; the schema has only those of faults, which follow from the kind of a fault.
"""

from __future__ import annotations

import dataclasses
from typing import Any

from moflock_mj.fields import FieldSpec, Section
from moflock_mj.scenario.faults import KINDS, FaultConfig
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.world.arena import SHAPES, arena_fields

DIALECT = "https://json-schema.org/draft/2020-12/schema"

_TYPES = {"bool": "boolean", "str": "string", "int": "integer", "float": "number"}
"""JSON types by the first word of a field's annotation."""


def scenario_schema() -> dict[str, Any]:
    """The JSON schema of a scenario file as a JSON value."""
    return {
        "$schema": DIALECT,
        "title": "moflock-mj scenario",
        "description": "Scenario of a flight in SI units. A field that is left out keeps its default.",
        "type": "object",
        "properties": {field.name: _scenario_field(field) for field in dataclasses.fields(Scenario)},
        "additionalProperties": False,
    }


def _scenario_field(field: dataclasses.Field[Any]) -> dict[str, Any]:
    spec: FieldSpec = field.metadata["bounds"]
    if "arena" in field.metadata:
        return {"description": _sentence(spec.help), **_arena()}
    if "section" in field.metadata:
        return _table(field.metadata["section"], spec.help)
    if "sections" in field.metadata:
        kind = field.metadata["sections"]
        items = _fault() if kind is FaultConfig else _table(kind, spec.help)
        return {"description": _sentence(spec.help), "type": "array", "items": items}
    return _value(field)


def _table(kind: type[Section], meaning: str) -> dict[str, Any]:
    return {
        "description": _sentence(meaning),
        "type": "object",
        "properties": {field.name: _value(field) for field in dataclasses.fields(kind)},
        "additionalProperties": False,
    }


def _value(field: dataclasses.Field[Any]) -> dict[str, Any]:
    """The schema of a field that `quantity` declares."""
    spec: FieldSpec = field.metadata["bounds"]
    word = str(field.type).split("|", maxsplit=1)[0].strip()
    schema: dict[str, Any] = {"description": _sentence(spec.help, spec.unit)}
    if word.startswith("tuple"):
        count = word.count(",") + 1
        schema |= {"type": "array", "items": {"type": "number", **_bounds(spec)}, "minItems": count, "maxItems": count}
    else:
        schema |= {"type": _TYPES[word], **_bounds(spec)}
    if field.default is not None and spec.admits(field.default):
        schema["default"] = field.default
    return schema


def _bounds(spec: FieldSpec) -> dict[str, Any]:
    if spec.choices:
        return {"enum": list(spec.choices)}
    bounds = {} if spec.low is None else {"exclusiveMinimum" if spec.open_low else "minimum": spec.low}
    return bounds if spec.high is None else bounds | {"maximum": spec.high}


def _arena() -> dict[str, Any]:
    """One alternative for each shape in the registry."""
    shapes = []
    for shape in SHAPES:
        fields = arena_fields(shape)
        numbers = {
            field.name: {
                "description": _sentence(field.meaning, field.unit),
                "type": "number",
                "minimum": field.low,
                "maximum": field.high,
            }
            for field in fields
        }
        shapes.append(
            {
                "type": "object",
                "properties": {"shape": {"const": shape}, **numbers},
                "required": ["shape", *numbers],
                "additionalProperties": False,
            }
        )
    return {"oneOf": shapes}


def _fault() -> dict[str, Any]:
    """A table `[[faults]]`: its kind decides which other fields are required and which are refused."""
    fields = dataclasses.fields(FaultConfig)
    figures = {name for kind in KINDS.values() for name in kind.figures}
    # The time after which a fault ends: the one optional time that no kind requires.
    ending = next(
        field.name
        for field in fields
        if field.name not in figures and field.default is None and field.metadata["bounds"].unit == "s"
    )
    rules = []
    for name, kind in KINDS.items():
        refused = sorted(figures - set(kind.figures)) + ([] if kind.ends else [ending])
        then: dict[str, Any] = {"properties": dict.fromkeys(refused, False)}
        required = [*kind.figures, *([] if kind.of_all else ["drone"])]
        if required:
            then["required"] = required
        rules.append({"if": {"properties": {"kind": {"const": name}}, "required": ["kind"]}, "then": then})
    return _table(FaultConfig, "one fault") | {"required": ["kind"], "allOf": rules}


def _sentence(meaning: str, unit: str = "1") -> str:
    """The meaning with a capital letter, and the unit in brackets."""
    return meaning[:1].upper() + meaning[1:] + (f" [{unit}]" if unit != "1" else "")
