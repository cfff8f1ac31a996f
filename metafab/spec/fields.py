"""Validated field types of input files, and the base of the specs whose fields must fit each other.

Numbers are strict: a quoted "350" is a fault, not 350.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import wraps
from typing import Annotated, Any, Self, TypeVar, cast, dataclass_transform

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, ValidationError, model_validator
from pydantic.dataclasses import dataclass

from metafab.core.errors import SpecError
from metafab.spec.keys.faults import faults_of

Class = TypeVar("Class", bound=type)

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
#: Marks a pair (x, y) for which a file may give one number.
BOTH = BeforeValidator(lambda value: (value, value) if isinstance(value, int | float) else value)


@dataclass_transform(frozen_default=True, field_specifiers=(Field,))
def spec(*, kw_only: bool = False) -> Callable[[Class], Class]:
    """Make a class a frozen dataclass with validated values; SpecError with all faults if Python gives others.

    Files are validated as a whole (:func:`metafab.spec.toml.validate`), with the paths of their keys.
    """

    def decorate(cls: Class) -> Class:
        checked: Any = dataclass(frozen=True, kw_only=kw_only, config=CONFIG)(cls)
        construct = checked.__init__

        @wraps(construct)
        def refusing(self: Any, *args: Any, **values: Any) -> None:
            try:
                construct(self, *args, **values)
            except ValidationError as error:
                raise SpecError(cls.__name__, faults_of(error, cls)) from error

        checked.__init__ = refusing
        return cast(Class, checked)

    return decorate


@spec()
class Checked:
    """Base of the specs whose fields must fit each other."""

    @model_validator(mode="after")
    def _sound(self) -> Self:
        if fault := next(self._faults(), None):
            raise ValueError(fault)
        return self

    def _faults(self) -> Iterator[str]:
        """Sentences about fields that contradict each other; the first one is reported."""
        yield from ()
