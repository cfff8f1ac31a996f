"""Pieces of HTML: numbers, text, figures, tables."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

#: Drawn figures as SVG, by name.
Drawn = Mapping[str, str]


def number(value: Any, digits: int = 3) -> str:
    """Format a value: thin spaces in long integers, few digits in others, a dash for None and NaN, ∞."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}".replace(",", "\u202f").replace("-", "−")
    if isinstance(value, float):
        if math.isinf(value):
            return "∞" if value > 0.0 else "−∞"
        if value.is_integer() and abs(value) >= 1000:
            return number(int(value))
        mantissa, _, exponent = f"{value:.{digits}g}".replace("-", "−").partition("e")
        power = exponent.lstrip("+").replace("−0", "−").lstrip("0")
        return f"{mantissa}\u202f×\u202f10<sup>{power}</sup>" if power else mantissa
    return escape(str(value))


def section(identifier: str, title: str, *content: str) -> str:
    """A section with a title; empty pieces are left out."""
    body = "\n".join(piece for piece in content if piece)
    return f'<section id="{identifier}">\n<h2>{escape(title)}</h2>\n{body}\n</section>'


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of HTML."""
    return f'<p class="{kind}">{text}</p>' if kind else f"<p>{text}</p>"


def prose(text: Any) -> str:
    """A sentence as HTML; text in backticks becomes code."""
    return re.sub(r"`(.+?)`", r"<code>\1</code>", escape(str(text)))


def note(text: str) -> str:
    """A remark in place of something missing; it ends with a full stop unless it asks."""
    return paragraph(prose(text if text.endswith("?") else f"{text}."), "note")


def figure(svg: str, caption: str = "") -> str:
    """A picture with a caption of HTML."""
    below = f"<figcaption>{caption}</figcaption>" if caption else ""
    return f"<figure>{svg}{below}</figure>"


def figures(drawn: Drawn, *names: str) -> str:
    """A grid of the drawn figures among ``names``."""
    return grid(figure(drawn[name]) for name in names if name in drawn)


def facts(values: Mapping[str, float | str | None]) -> str:
    """Figures in a line, by their labels; None is left out."""
    items = [f"<li><b>{number(v)}</b> {escape(label)}</li>" for label, v in values.items() if v is not None]
    return f'<ul class="facts">{"".join(items)}</ul>' if items else ""


def wide(content: str) -> str:
    """Wide content, which scrolls sideways on a narrow screen."""
    return f'<div class="scroll wide">{content}</div>'


def fitting(content: str) -> str:
    """A wide picture, which shrinks on a narrow screen."""
    return f'<div class="fit">{content}</div>'


def grid(figures: Iterable[str]) -> str:
    """Pictures side by side, as many as fit."""
    return f'<div class="grid">{"".join(figures)}</div>'


#: Units at the end of a key, and their symbols.
_UNITS = {"m": "m", "mm": "mm", "um": "µm", "nm": "nm", "rad": "rad", "deg": "°", "db": "dB", "px": "px", "mb": "MB"}


def column(key: str) -> str:
    """Head of a column from its key: ``depth_error_m`` gives depth error / m, ``slope_x_per_m`` gives slope x / m⁻¹."""
    *words, last = key.split("_")
    if words[-1:] == ["per"] and last in _UNITS:
        return escape(f"{' '.join(words[:-1])} / {_UNITS[last]}⁻¹")
    return escape(f"{' '.join(words)} / {_UNITS[last]}" if words and last in _UNITS else key.replace("_", " "))


def table(head: Sequence[str], rows: Iterable[Sequence[str]], kinds: Sequence[str] = (), kind: str = "") -> str:
    """A table of HTML cells; class "n" of a column is for numbers.

    The class "stack" of the table puts the last cell below the others on narrow screens.
    """
    classes = [*kinds, *[""] * (len(head) - len(kinds))]

    body = "".join(f"<tr>{_cells(row, classes, 'td')}</tr>" for row in rows)
    top = f"<thead><tr>{_cells(head, classes, 'th')}</tr></thead>"
    return f'<div class="scroll"><table class="{kind}">{top}<tbody>{body}</tbody></table></div>'


def _cells(row: Sequence[str], classes: Sequence[str], tag: str) -> str:
    return "".join(f'<{tag} class="{kind}">{cell}</{tag}>' for cell, kind in zip(row, classes, strict=True))


def headline(value: str, label: str, tone: str = "") -> str:
    """A figure in large type with its label; ``tone`` is "good", "bad" or empty."""
    return f'<li class="{tone}"><b>{value}</b><span>{label}</span></li>'
