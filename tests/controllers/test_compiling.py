"""What is kept on disk of compiled functions."""

from __future__ import annotations

import ast
import os
import pickle
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
from numba.core import caching

from controllers import compiling

ALONE = ("optimize/evaluation/coverage.py",)
"""Files whose kernels call no kernel of another file: Numba's own stamp, of the file itself, is enough."""

DECORATORS = {"kernel", "hot_kernel", "entry_kernel", "stage", "hot_stage", "implements", "njit", "jit", "overload"}


def test_a_kept_index_that_names_a_type_of_older_sources_counts_as_none(tmp_path):
    index = caching.IndexDataCacheFile(tmp_path, "kept", (1, 1))
    older = b"cmoflock_mj.wind\nATypeThatIsNoMore\n."
    (tmp_path / "kept.nbi").write_bytes(pickle.dumps(index._version) + older)
    assert index._load_index() == {}


@pytest.mark.parametrize("package", ["", "effects", "effects/deeper"])
def test_an_edit_in_any_sub_package_changes_the_stamp(tmp_path, package):
    folder = tmp_path / package
    folder.mkdir(parents=True, exist_ok=True)
    (tmp_path / "entry.py").write_text("")
    source = folder / "kernels.py"
    source.write_text("gain = 1\n")
    before = compiling.stamp_of((tmp_path,))
    source.write_text("gain = 2.5\n")
    assert compiling.stamp_of((tmp_path,)) != before


def decorators_in(source):
    """Names of the decorators of a module's functions, without what they are called with."""
    functions = [node for node in ast.walk(ast.parse(source.read_text())) if isinstance(node, ast.FunctionDef)]
    decorators = [decorator for function in functions for decorator in function.decorator_list]
    called = [decorator.func if isinstance(decorator, ast.Call) else decorator for decorator in decorators]
    return {ast.unparse(decorator).rpartition(".")[2] for decorator in called}


def test_every_file_with_kernels_counts_for_the_stamp():
    root = Path(compiling.__file__).parent.parent
    sources = [path for name in ("controllers", "moflock_mj", "optimize") for path in (root / name).rglob("*.py")]
    compiled = [path for path in sources if decorators_in(path) & DECORATORS]
    assert len(compiled) > 20
    outside = {path for path in compiled if not any(folder in path.parents for folder in compiling.SOURCE_ROOTS)}
    assert outside <= {root / name for name in ALONE}


@pytest.mark.slow
def test_an_edited_kernel_of_a_sub_package_is_compiled_anew(tmp_path):
    """The caller is kept on disk and is not edited; it must not go on with what it inlined."""
    inner = tmp_path / "package" / "inner.py"
    inner.parent.mkdir()
    inner.with_name("__init__.py").write_text("")
    caller = """
        from pathlib import Path
        from controllers import compiling
        compiling.SOURCE_ROOTS = (Path(__file__).resolve().parent,)
        from package.inner import factor
        @compiling.entry_kernel
        def times(x):
            return factor() * x
        print(times(1.0), sum(times.stats.cache_hits.values()))
    """
    (tmp_path / "caller.py").write_text(textwrap.dedent(caller))
    program = "from controllers.compiling import kernel\n@kernel\ndef factor():\n    return {}\n"
    runner = "import importlib; importlib.import_module('caller')"
    roots = os.pathsep.join([str(tmp_path), str(Path(compiling.__file__).parent.parent)])

    def printed() -> str:
        return subprocess.run(
            [sys.executable, "-c", runner],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "PYTHONPATH": roots, "PYTHONDONTWRITEBYTECODE": "1"},
        ).stdout.strip()

    inner.write_text(program.format("2.0"))
    assert printed() == "2.0 0"
    assert printed() == "2.0 1"
    inner.write_text(program.format("2.125"))
    assert printed() == "2.125 0"
