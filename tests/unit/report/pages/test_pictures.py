"""Pictures of single results are written."""

from __future__ import annotations

from pathlib import Path

from metafab.library.library import Library
from metafab.report import library_figure


def test_library_picture_is_written(smooth_library: Library, tmp_path: Path) -> None:
    path = library_figure(smooth_library, tmp_path / "library.png")
    assert path.read_bytes().startswith(b"\x89PNG")
