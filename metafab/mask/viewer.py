"""KLayout's layer properties: names and colours for the layers of a mask."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from metafab.mask.drawing.surroundings import Surroundings
from metafab.spec import Design

_PROPERTIES = """ <properties>
  <frame-color>{frame}</frame-color>
  <fill-color>{fill}</fill-color>
  <frame-brightness>0</frame-brightness>
  <fill-brightness>0</fill-brightness>
  <dither-pattern>I1</dither-pattern>
  <visible>true</visible>
  <transparent>false</transparent>
  <width>1</width>
  <marked>false</marked>
  <animation>0</animation>
  <name>{name}</name>
  <source>{source}@1</source>
 </properties>
"""

_PILLARS = ("#1f4e79", "#5b9bd5")
_BESIDE = ("#6b4f1d", "#c9a75a")


def layer_properties(design: Design, beside: Sequence[Surroundings] = ()) -> str:
    """The text of ``layout.lyp``: the pillar layer, a datatype each dose class, and what is drawn beside them."""
    first, last = design.mask.datatypes
    layers = []
    for datatype in range(first, last + 1):
        name = f"pillars of {design.name}" + (f", dose class {datatype - first}" if last > first else "")
        layers.append((name, f"{design.mask.layer}/{datatype}", _PILLARS))
    if design.mask.tone == "inverted":
        layers.append(("field around the pillars", f"{design.mask.field_layer}/0", _BESIDE))
    layers += [(kind.name, f"{kind.layer}/0", _BESIDE) for kind in beside]
    entries = "".join(
        _PROPERTIES.format(name=escape(name), source=source, frame=frame, fill=fill)
        for name, source, (frame, fill) in layers
    )
    return f'<?xml version="1.0" encoding="utf-8"?>\n<layer-properties>\n{entries}</layer-properties>\n'
