"""An extension of Griffe: docstrings say `Example:` for one example, Griffe's parser knows `Examples:` alone."""

from __future__ import annotations

from typing import Any

import griffe


class OneExample(griffe.Extension):
    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        if obj.docstring:
            obj.docstring.value = obj.docstring.value.replace("\nExample:\n", "\nExamples:\n")
