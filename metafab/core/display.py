"""Display of results: key figures in a console, and with a small picture in a notebook."""

from __future__ import annotations

from html import escape
from importlib import import_module

#: Module whose function ``picture(result)`` returns an HTML picture of a result, or "". It is named here and imported
#: when a notebook asks for a picture, because the rooms of results stand below the one that draws.
PICTURES = "metafab.report.cards"


class Displayed:
    """Mixin of results with a short ``repr`` and an HTML representation for Jupyter.

    A frozen dataclass that inherits from it is declared with ``repr=False`` and defines :meth:`key_figures`.
    """

    def key_figures(self) -> dict[str, str]:
        """Names and formatted values of the result's key figures, most important first."""
        raise NotImplementedError

    def __repr__(self) -> str:
        figures = ", ".join(f"{name}: {value}" for name, value in self.key_figures().items())
        return f"{type(self).__name__}({figures})"

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><td>{escape(name)}</td><td>{escape(value)}</td></tr>" for name, value in self.key_figures().items()
        )
        picture: str = import_module(PICTURES).picture(self)
        title = f"<b>{type(self).__name__}</b>"
        figures = f"<div>{title}<table>{rows}</table></div>"
        return f'<div style="display:flex;gap:1.5em;align-items:center">{picture}{figures}</div>'
