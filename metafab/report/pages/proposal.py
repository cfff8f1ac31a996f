"""Proposed helices as one picture, for ``metafab propose``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from metafab.phase.studies.propose import Proposal
from metafab.report import figures
from metafab.report.render import save_png


def proposal_figure(found: Sequence[Proposal], path: Path) -> Path:
    """Draw the smallest error and the turn over depth of up to five choices of [L, epsilon] as a PNG.

    Args:
        found: choices over one range of depths, the best first; at least one.
        path: PNG to write.

    Returns:
        ``path``.
    """
    figure = Figure(figsize=(9.6, 3.8))
    left, right = figure.subplots(1, 2, gridspec_kw={"left": 0.08, "right": 0.97, "bottom": 0.15, "wspace": 0.25})
    figures.proposals(found, left)
    figures.proposed_orientation(found, right)
    return save_png(figure, path)
