"""Steps that read the same mask share its pillars; another file, design or lens is read anew."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab.core.errors import InputError
from metafab.core.storage.latest import Latest
from metafab.layout.pillars import Lattice, PillarMap
from metafab.library.library import Library
from metafab.spec import Design
from metafab.steps import optics as step
from metafab.steps.job import Job
from metafab.steps.optics import mask_source


def test_a_mask_is_read_once_until_something_changes(
    small_design: Design, smooth_library: Library, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[tuple[str, int]] = []

    def reading(job: Job, path: Path, copy: int) -> PillarMap:
        read.append((job.design.name, copy))
        return PillarMap.from_array(
            Lattice((700, 700), (4, 4), 0.5), np.zeros((1, 2), np.int32), np.zeros((4, 4), np.uint16), 4
        )

    monkeypatch.setattr(step, "_READ", Latest())
    monkeypatch.setattr(step, "_standing_pillars", reading)
    monkeypatch.setattr(step, "open_library", lambda job: smooth_library)
    path = tmp_path / "layout.oas"
    path.write_bytes(b"one")
    job = Job(small_design, tmp_path)
    first = mask_source(job, path)
    # Another job of the same design, as the next command of a notebook makes one.
    assert mask_source(Job(small_design, tmp_path), path).pillars is first.pillars
    assert len(read) == 1
    mask_source(job, path, copy=2)
    mask_source(Job(replace(small_design, name="other"), tmp_path), path)
    path.write_bytes(b"two")
    os.utime(path, ns=(1, 1))
    mask_source(job, path)
    assert [name for name, _ in read[1:]] == [small_design.name, "other", small_design.name]
    assert [copy for _, copy in read] == [1, 2, 1, 1]


def test_a_missing_mask_says_so_before_any_library_is_built(
    small_design: Design, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(job: Job) -> Library:
        raise AssertionError("built a library for nothing")

    monkeypatch.setattr(step, "open_library", never)
    with pytest.raises(InputError, match=r"gone\.oas"):
        mask_source(Job(small_design, tmp_path), tmp_path / "gone.oas")
