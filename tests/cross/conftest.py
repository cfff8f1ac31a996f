"""One Meep for all cross checks."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from metafab.cell.meep import Pool, find


@pytest.fixture(scope="module")
def pool(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Pool]:
    """One worker of the real Meep for all tests of a file; equal runs are made once."""
    if not any(candidate.found for candidate in find()):
        pytest.skip("no interpreter with Meep")
    with Pool(1, limit_s=600.0, keep=tmp_path_factory.mktemp("runs")) as workers:
        yield workers
