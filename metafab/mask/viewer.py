"""KLayout's layer properties: names and colours for the layers of a mask."""

from __future__ import annotations

from xml.sax.saxutils import escape

from metafab.spec import Design

_PROPERTIES = """<?xml version="1.0" encoding="utf-8"?>
<layer-properties>
 <properties>
  <frame-color>#1f4e79</frame-color>
  <fill-color>#5b9bd5</fill-color>
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
</layer-properties>
"""


def layer_properties(design: Design) -> str:
    """The text of ``layout.lyp``: the pillar layer."""
    return _PROPERTIES.format(
        name=escape(f"pillars of {design.name}"), source=f"{design.mask.layer}/{design.mask.datatype}"
    )
