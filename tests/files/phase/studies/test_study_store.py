"""``phase_study.h5``: a study comes back unchanged, and missing parts stay missing."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from metafab.core.errors import InputError
from metafab.phase import profile_of, study
from metafab.phase.studies.study import PhaseStudy
from metafab.phase.studies.study_store import load_study, save_study
from metafab.spec import Design
from metafab.spec.device import Optics


@pytest.fixture(scope="module")
def stored(small_design: Design) -> PhaseStudy:
    plain = (replace(small_design.phase[0], optimise="none"), *small_design.phase[1:])
    design = replace(small_design, phase=plain, optics=Optics(20.0))
    return study(design, profile_of(design))


def _same(one: Any, other: Any) -> None:
    assert type(one) is type(other)
    if is_dataclass(one):
        for field in fields(one):
            _same(getattr(one, field.name), getattr(other, field.name))
    elif isinstance(one, tuple):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            _same(a, b)
    else:
        np.testing.assert_array_equal(one, other)


def test_round_trip(stored: PhaseStudy, tmp_path: Path) -> None:
    save_study(stored, tmp_path / "phase_study.h5", inputs_sha256="")
    _same(load_study(tmp_path / "phase_study.h5"), stored)


def test_parts_may_be_missing(stored: PhaseStudy, tmp_path: Path) -> None:
    for part in (PhaseStudy(None, None, None), replace(stored, bandwidth=None), replace(stored, lobe=None)):
        save_study(part, tmp_path / "part.h5", inputs_sha256="")
        _same(load_study(tmp_path / "part.h5"), part)


def test_a_budget_without_remedies_is_kept(stored: PhaseStudy, tmp_path: Path) -> None:
    assert stored.bandwidth is not None
    hopeless = replace(stored, bandwidth=replace(stored.bandwidth, remedies=()))
    save_study(hopeless, tmp_path / "hopeless.h5", inputs_sha256="")
    _same(load_study(tmp_path / "hopeless.h5"), hopeless)


def test_same_study_same_bytes_and_every_dataset_has_its_unit(stored: PhaseStudy, tmp_path: Path) -> None:
    for name in ("a.h5", "b.h5"):
        save_study(stored, tmp_path / name, inputs_sha256="")
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()
    datasets = []
    with h5py.File(tmp_path / "a.h5") as file:

        def look(name: str, item: object) -> None:
            if isinstance(item, h5py.Dataset):
                datasets.append(name)
                assert item.attrs["units"] and item.attrs["description"], name

        file.visititems(look)
        assert file["bounds/point_m"].dims[1][0].name == "/bounds/depth_m"
    assert len(datasets) > 20


def test_foreign_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "x.h5").write_bytes(b"no")
    for name in ("x.h5", "missing.h5"):
        with pytest.raises(InputError):
            load_study(tmp_path / name)
