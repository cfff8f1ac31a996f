"""``metafab psf``: figures that the command adds to those of the pair."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from metafab import steps
from metafab.cli.commands.light import neighbour_figures


@pytest.mark.parametrize(
    ("neighbours", "model_error", "figures"),
    [
        (None, 0.01, {"with_neighbours": False}),
        ("map", None, {"with_neighbours": False}),
        ("map", 0.01, {"with_neighbours": True, "neighbour_error": 0.01}),
    ],
)
def test_a_pair_among_neighbours_states_the_error_of_the_model(
    neighbours: str | None, model_error: float | None, figures: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    model = model_error and SimpleNamespace(overall=SimpleNamespace(error_alike=model_error))
    monkeypatch.setattr(steps, "open_library", lambda job: SimpleNamespace(neighbours=model))
    assert neighbour_figures(cast(Any, None), cast(Any, SimpleNamespace(neighbours=neighbours))) == figures
