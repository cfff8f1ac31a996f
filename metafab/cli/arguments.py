"""What the shell hands over, made into what the options take."""

from __future__ import annotations

from collections import deque

from metafab.core.errors import InputError

_DEPTHS = "--depths-m"


def spread_depths(arguments: list[str]) -> list[str]:
    """``--depths-m 0.25 0.3`` and ``--depths-m 0.25,0.3`` as one option a depth.

    Raises:
        InputError: no number follows ``--depths-m``.
    """
    spread: list[str] = []
    rest = deque(arguments)
    while rest:
        argument = rest.popleft()
        name, equals, value = argument.partition("=")
        if name != _DEPTHS:
            spread.append(argument)
            continue
        if equals:
            rest.appendleft(value)
        if not (rest and _are_numbers(rest[0])):
            raise InputError.single(_DEPTHS, "depths.m", "one or more depths", repr(rest[0]) if rest else "nothing")
        while rest and _are_numbers(rest[0]):
            # With "=", so that a minus sign starts no option.
            spread += [f"{_DEPTHS}={number}" for number in rest.popleft().split(",")]
    return spread


def _are_numbers(text: str) -> bool:
    try:
        list(map(float, text.split(",")))
    except ValueError:
        return False
    return True
