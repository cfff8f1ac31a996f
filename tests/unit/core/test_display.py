"""Results show their key figures, in a console and in a notebook."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.camera.frames.frame import RawFrame
from metafab.core.display import Displayed, dataset

pytest.importorskip("xarray")


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


def test_variables_carry_their_units() -> None:
    made = dataset({"depth": (("y_um",), [1.0, 2.0], "m")}, {"y_um": [0.0, 3.0]}, error=1e-3)
    assert made["depth"].attrs["units"] == "m"
    assert float(made["depth"].sel(y_um=3.0)) == 2.0
    assert made.attrs["error"] == 1e-3


def test_a_frame_keeps_its_places() -> None:
    frame = RawFrame(np.arange(6.0).reshape(2, 3), 2.0, (10.0, -4.0), 1.0).to_xarray()["frame"]
    assert float(frame.sel(y_um=-2.0, x_um=14.0)) == 5.0
