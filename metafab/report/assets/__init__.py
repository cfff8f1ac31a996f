"""Template, style and script of the page."""

from __future__ import annotations

from importlib.resources import files


def asset(name: str) -> str:
    """Text of ``page.html``, ``style.css`` or ``page.js``."""
    return (files("metafab.report.assets") / name).read_text(encoding="utf-8")
