"""The search over a policy's parameters: evaluation, search, validation and reports.

Names are imported when they are first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from moflock_mj.metrics.verdict import Verdict as Verdict
    from optimize.analysis.pca import principal_components as principal_components
    from optimize.analysis.sensitivity import sobol_indices as sobol_indices
    from optimize.evaluation.evaluation import evaluate as evaluate
    from optimize.evaluation.executors import make_executor as make_executor
    from optimize.evaluation.objectives import Objectives as Objectives
    from optimize.search.configuration import Configuration as Configuration
    from optimize.search.configuration import SearchConfig as SearchConfig
    from optimize.search.front import ReevaluatedFront as ReevaluatedFront
    from optimize.search.front import load_front as load_front
    from optimize.search.run_directory import RunDirectory as RunDirectory
    from optimize.validation.validation import Validation as Validation
    from optimize.validation.validation import ValidationConfig as ValidationConfig

_MODULES = {
    "Configuration": "optimize.search.configuration",
    "Objectives": "optimize.evaluation.objectives",
    "ReevaluatedFront": "optimize.search.front",
    "RunDirectory": "optimize.search.run_directory",
    "SearchConfig": "optimize.search.configuration",
    "Validation": "optimize.validation.validation",
    "ValidationConfig": "optimize.validation.validation",
    "Verdict": "moflock_mj.metrics.verdict",
    "evaluate": "optimize.evaluation.evaluation",
    "load_front": "optimize.search.front",
    "make_executor": "optimize.evaluation.executors",
    "principal_components": "optimize.analysis.pca",
    "sobol_indices": "optimize.analysis.sensitivity",
}
"""Where each public name is defined."""

__all__ = sorted(_MODULES)  # noqa: PLE0605 - type checkers read the imports above


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    return __all__
