"""Sphinx configuration: Markdown pages by MyST, API pages from the docstrings."""

from __future__ import annotations

import gc
import re
import sys
from pathlib import Path
from typing import Any

from sphinx.domains.python import PythonDomain

from metafab import __version__

sys.path.insert(0, str(Path(__file__).parent))  # where our extensions lie

# Trees of pages are millions of objects and no garbage: with the collector's 700, searches take a quarter of the time.
gc.set_threshold(50_000)

project = "metafab"
author = "The metafab founders"
copyright = "2026, the metafab founders"  # noqa: A001 (the name that Sphinx asks for)
release = version = __version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
extensions += ["device_gallery", "key_reference", "native_math"]
myst_enable_extensions = ["dollarmath", "deflist", "colon_fence"]
myst_heading_anchors = 3
exclude_patterns = ["_build", "_gallery"]

html_math_renderer = "mathml"
html_theme = "alabaster"
html_static_path = ["_static"]
html_css_files = ["metafab.css"]
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


class _OurNames(PythonDomain):
    """Python domain that searches for names of ours alone: most types of signatures are Python's or NumPy's."""

    def find_obj(self, env: Any, modname: str, classname: str, name: str, *how: Any) -> list[tuple[str, Any]]:
        """As the base class; a name whose last part no object has is not compared with every object."""
        if len(self.objects) != self._counted:
            self._counted, self._last = len(self.objects), {each.rpartition(".")[2] for each in self.objects}
        if name.removesuffix("()").rpartition(".")[2] not in self._last:
            return []
        return super().find_obj(env, modname, classname, name, *how)

    _counted, _last = 0, frozenset[str]()


def setup(app: Any) -> None:
    """Register the domain and the docstring filter, which runs before napoleon adds markup of its own."""
    app.add_domain(_OurNames, override=True)
    app.connect("autodoc-process-docstring", _plain_english, priority=100)
