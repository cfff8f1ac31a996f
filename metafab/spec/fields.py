"""Validated field types of input files. Numbers are strict: a quoted "350" is a fault, not 350."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import AfterValidator, ConfigDict, Field

#: Unknown keys are refused, values cannot change, defaults are checked too.
CONFIG = ConfigDict(extra="forbid", validate_default=True)

#: Largest magnitude of any number: above every physical value in any unit, far below overflow.
LARGEST = 1e15


def _far_or_infinite(depth_m: float) -> float:
    if LARGEST < depth_m < math.inf:
        raise ValueError(f"must be at most {LARGEST:g} m, or inf")
    return depth_m


Real = Annotated[float, Field(strict=True, ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, gt=0.0, le=LARGEST, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(strict=True, ge=0.0, le=LARGEST, allow_inf_nan=False)]
Fraction = Annotated[float, Field(strict=True, ge=0.0, le=1.0)]
TargetError = Annotated[float, Field(strict=True, ge=1e-12, lt=1.0)]
#: Object distance, m; may be infinite.
DepthOrInfinity = Annotated[float, Field(strict=True, gt=0.0), AfterValidator(_far_or_infinite)]
Flag = Annotated[bool, Field(strict=True)]
Index = Annotated[int, Field(strict=True, ge=0, le=65535)]
Name = Annotated[str, Field(strict=True, min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
