"""What is kept on disk of compiled functions."""

from __future__ import annotations

import pickle

from numba.core import caching

import controllers.compiling  # noqa: F401 - makes Numba's cache what it is tested for


def test_a_kept_index_that_names_a_type_of_older_sources_counts_as_none(tmp_path):
    index = caching.IndexDataCacheFile(tmp_path, "kept", (1, 1))
    older = b"cmoflock_mj.wind\nATypeThatIsNoMore\n."
    (tmp_path / "kept.nbi").write_bytes(pickle.dumps(index._version) + older)
    assert index._load_index() == {}
