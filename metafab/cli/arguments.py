"""What the shell hands over, made into what the options take."""

from __future__ import annotations


def spread_depths(arguments: list[str]) -> list[str]:
    """``--depths-m 0.25 0.3`` and ``--depths-m 0.25,0.3`` as one option a depth."""
    spread: list[str] = []
    taking = False
    for argument in arguments:
        name, equals, value = argument.partition("=")
        if name == "--depths-m":
            taking = not equals
            argument = value  # noqa: PLW2901
            if not equals:
                continue
        numbers = argument.split(",")
        if (taking or name == "--depths-m") and all(_is_number(number) for number in numbers):
            for number in numbers:
                spread += ["--depths-m", number]
            continue
        taking = False
        spread.append(argument)
    return spread


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
