"""Checked field types of input files. Numbers are strict: a quoted "350" is a fault, not 350."""

from __future__ import annotations

from typing import Annotated

from pydantic import ConfigDict, Field

#: Unknown keys are refused, values cannot change, defaults are checked too.
CONFIG = ConfigDict(extra="forbid", validate_default=True)

#: Beyond any length, count or time of this field in any of its units, and far from where arithmetic overflows.
LARGEST = 1e15

Real = Annotated[float, Field(strict=True, ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, gt=0.0, le=LARGEST, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(strict=True, ge=0.0, le=LARGEST, allow_inf_nan=False)]
Fraction = Annotated[float, Field(strict=True, ge=0.0, le=1.0)]
TargetError = Annotated[float, Field(strict=True, ge=1e-12, lt=1.0)]
Count = Annotated[int, Field(strict=True, ge=1)]
Index = Annotated[int, Field(strict=True, ge=0, le=65535)]
Name = Annotated[str, Field(strict=True, min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
