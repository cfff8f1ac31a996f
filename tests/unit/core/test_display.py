"""Results show their key figures, in a console and in a notebook."""

from __future__ import annotations

from metafab.core.display import Displayed


class Lens(Displayed):
    def key_figures(self) -> dict[str, str]:
        return {"aperture": "2 mm", "pillars <": "25 634 224"}


def test_repr_holds_the_key_figures() -> None:
    assert repr(Lens()) == "Lens(aperture: 2 mm, pillars <: 25 634 224)"


def test_html_escapes_and_needs_no_picture() -> None:
    html = Lens()._repr_html_()
    assert "<b>Lens</b>" in html
    assert "pillars &lt;" in html
    assert "<img" not in html
