"""What several sections use."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from metafab.report import html

#: Figures by name, as SVG.
Drawn = Mapping[str, str]


def facts_line(part: Mapping[str, Any], **labels: str) -> str:
    """Figures of a step's summary in a line, those that are there."""
    items = [
        f"<li><b>{html.number(part[key])}</b> {escape(label)}</li>"
        for key, label in labels.items()
        if isinstance(part.get(key), int | float | str)
    ]
    return f'<ul class="facts">{"".join(items)}</ul>' if items else ""
