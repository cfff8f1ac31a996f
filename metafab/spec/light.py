"""Lights that one mask serves together: the table ``[[light]]`` of a design."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from metafab.spec.fields import CONFIG, Positive
from metafab.spec.terms import PhaseTerm


@dataclass(frozen=True, config=CONFIG)
class Light:
    """One wavelength that the mask serves, its weight, and its target phases."""

    wavelength_nm: Positive  #: Vacuum wavelength; one light has the unit cell's.
    weight: Positive = 1.0  #: Weight of its field overlap in the choice of each size.
    #: Phase terms of this light; without the key those of the design, at this wavelength.
    phase: Annotated[tuple[PhaseTerm, ...] | None, Field(min_length=1)] = None
