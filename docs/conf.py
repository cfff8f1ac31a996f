"""Sphinx configuration: Markdown pages by MyST, API pages from the docstrings."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

from metafab import __version__

sys.path.insert(0, str(Path(__file__).parent))  # where `device_gallery` and `key_reference` lie

project = "metafab"
author = "The metafab founders"
copyright = "2026, the metafab founders"  # noqa: A001 (the name that Sphinx asks for)
release = version = __version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax"]
extensions += ["device_gallery", "key_reference"]
myst_enable_extensions = ["dollarmath", "deflist", "colon_fence"]
myst_heading_anchors = 3
exclude_patterns = ["_build", "_gallery"]

html_theme = "alabaster"
html_scaled_image_link = False
html_title = f"metafab {version}"
html_theme_options = {
    "description": "From unit cell to mask to decoded image",
    "page_width": "1080px",
    "sidebar_width": "230px",
    "fixed_sidebar": False,
    "show_powered_by": False,
    "font_family": "Charter, 'Bitstream Charter', Georgia, serif",
    "head_font_family": "Charter, 'Bitstream Charter', Georgia, serif",
}

autodoc_typehints = "description"
autodoc_member_order = "bysource"
napoleon_use_ivar = True
nitpicky = False
#: Names of fields are the targets of no reference; several classes share some of them.
suppress_warnings = ["ref.python"]

#: Notebooks are run when they have changed; `-D nb_execution_mode=off` leaves their outputs out.
nb_execution_mode = "cache"
nb_execution_timeout = 300
nb_execution_raise_on_error = True

_VERBATIM = re.compile(r"(``.*?``|`[^`]+`_?)", re.DOTALL)


def _plain_english(app: Any, what: str, name: str, item: Any, options: Any, lines: list[str]) -> None:
    """Our docstrings are plain text: bars, stars and trailing underscores mean themselves, not markup."""
    for index, line in enumerate(lines):
        pieces = _VERBATIM.split(line)
        pieces[::2] = [re.sub(r"([|*]|_(?=\W|$))", r"\\\1", piece) for piece in pieces[::2]]
        lines[index] = "".join(pieces)
    # Of a field, napoleon takes the first line up to a colon for its type; a line without one has none.
    if what in {"attribute", "property"} and lines and ":" in lines[0]:
        lines[:1] = lines[0].split(" ", 1)


def setup(app: Any) -> None:
    """Register the docstring filter; it runs before napoleon adds markup of its own."""
    app.connect("autodoc-process-docstring", _plain_english, priority=100)
