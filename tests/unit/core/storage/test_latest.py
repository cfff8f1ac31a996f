"""One result of a kind is held, until another is asked for."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from metafab.core.storage.latest import Latest, file_mark


def test_the_same_key_gives_the_same_object_and_another_takes_its_place() -> None:
    held: Latest[list[int]] = Latest()
    made: list[int] = []

    def make(number: int) -> list[int]:
        made.append(number)
        return [number]

    first = held.of(("a", 1), lambda: make(1))
    assert held.of(("a", 1), lambda: make(2)) is first
    assert held.of(("b", 1), lambda: make(3)) == [3]
    assert held.of(("a", 1), lambda: make(4)) == [4]
    assert made == [1, 3, 4]


def test_what_fails_is_not_held_and_leaves_nothing_of_the_one_before() -> None:
    held: Latest[float] = Latest()
    assert held.of(1, lambda: 10) == 10
    with pytest.raises(ZeroDivisionError):
        held.of(2, lambda: 1 / 0)
    assert held.of(2, lambda: 20) == 20
    assert held.of(1, lambda: 11) == 11


def test_a_mark_tells_another_content_size_or_place(tmp_path: Path) -> None:
    path, link = tmp_path / "mask.oas", tmp_path / "link.oas"
    path.write_bytes(b"abc")
    link.symlink_to(path)
    mark = file_mark(path)
    assert file_mark(link) == mark
    path.write_bytes(b"abcd")
    os.utime(path, ns=(mark[2], mark[2]))
    assert file_mark(path) != mark
    path.write_bytes(b"abd")
    os.utime(path, ns=(mark[2] + 1, mark[2] + 1))
    assert file_mark(path) != mark
    with pytest.raises(OSError, match="gone"):
        file_mark(tmp_path / "gone.oas")
