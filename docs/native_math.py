"""Formulas as MathML, which browsers draw themselves: pages need no network and no script."""

from __future__ import annotations

from html import escape
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.util.logging import getLogger

_LOG = getLogger(__name__)


def _inline(self: Any, node: nodes.math) -> None:
    self.body.append(_mathml(node, as_block=False))
    raise nodes.SkipNode


def _block(self: Any, node: nodes.math_block) -> None:
    self.body.append(f'<div class="formula">{_mathml(node, as_block=True)}</div>\n')
    raise nodes.SkipNode


def _mathml(node: nodes.Element, *, as_block: bool) -> str:
    """MathML of a formula; one that docutils cannot read is a warning, and stands as it was written."""
    text = node.astext().strip()
    try:
        return str(tex2mathml(text, as_block=as_block))
    except (MathError, IndexError) as error:
        _LOG.warning("formula %r: %s", text, error, location=node)
        return f"<code>{escape(text)}</code>"


def setup(app: Any) -> dict[str, bool]:
    """Register the renderer; ``html_math_renderer = "mathml"`` takes it."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
