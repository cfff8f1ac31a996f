"""Arguments that are no fault of a number but of a kind: a result for its part, two of them exchanged."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab import camera, decode, exposure, layout, library, mask, materials, optics, phase
from metafab.core.arguments import is_several, require_types
from metafab.core.errors import InputError
from metafab.layout import Assignment
from metafab.library import Library
from metafab.spec import Design, Scene, SceneObject, make_design
from tests.closed_form_run import turning_psf


def test_all_wrong_arguments_are_reported_at_once() -> None:
    require_types("f", a=(1, int), b=("x", str))
    with pytest.raises(InputError) as refused:
        require_types("f", a=("x", int), b=("x", str), c=(1.0, str))
    assert str(refused.value) == "f:\n  `a`: expected int, got str\n  `c`: expected str, got float"


def test_a_class_in_place_of_its_result_is_refused_too() -> None:
    with pytest.raises(InputError, match="`imaging`: expected Imaging, got type"):
        require_types("f", imaging=(optics.Imaging, optics.Imaging))


def test_several_values_are_any_iterable_but_texts_tables_and_arrays_without_axes() -> None:
    several = ([1.0], (1.0,), {1.0}, range(2), np.array([1.0]), iter([1.0]), {1.0: 2.0}.keys())
    assert all(map(is_several, several))
    assert not any(map(is_several, (1.0, np.float64(1.0), np.array(1.0), "10", {"term": "lens"}, None)))


@pytest.fixture(scope="module")
def design(small_design: Design) -> Design:
    return replace(small_design, device=replace(small_design.device, aperture_um=5.0))


@pytest.fixture(scope="module")
def mapped(design: Design, smooth_library: Library) -> Assignment:
    return layout.assign(phase.PhaseProfile(()), smooth_library, design)


def test_a_result_in_place_of_its_part_names_the_part(
    mapped: Assignment, design: Design, smooth_library: Library, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match="`pillars`: expected PillarMap, got Assignment; give its `pillars`"):
        optics.written_field(mapped, smooth_library)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="`pillars`: expected PillarMap, got Assignment; give its `pillars`"):
        mask.write(mapped, tmp_path, design)  # type: ignore[arg-type]
    read_back = mask.read(mask.write(mapped.pillars, tmp_path, design)[0].path, design)
    with pytest.raises(InputError, match="`pillars`: expected PillarMap, got ReadBack; give its `pillars`"):
        optics.written_field(read_back, smooth_library)  # type: ignore[arg-type]
    light = optics.written_field(read_back.pillars, smooth_library)
    with pytest.raises(InputError, match=r"`imaging`: expected Imaging, got Design; `Imaging\.of` makes one"):
        optics.psf(light, design, [0.003])  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"`source`: expected light, .* got PillarMap; `written_field` gives that of"):
        optics.psf(mapped.pillars, optics.Imaging.of(design), [0.003])  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"`source`: expected light, .* got Assignment; `written_field` gives that of"):
        optics.psf(mapped, optics.Imaging.of(design), [0.003])  # type: ignore[arg-type]


def test_exchanged_arguments_are_named(design: Design, smooth_library: Library) -> None:
    with pytest.raises(InputError, match="`library`: expected Library, got PhaseProfile"):
        layout.assign(smooth_library, phase.PhaseProfile(()), design)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="`scene`: expected Scene, got Psf\n  `psf`: expected Psf, got Scene"):
        camera.capture(turning_psf(), Scene(objects=(SceneObject(depth_m=0.003),)))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="`frame`: expected a RawFrame"):
        decode.decode(turning_psf(), turning_psf())  # type: ignore[arg-type]


def test_names_in_place_of_what_they_name_are_refused(mapped: Assignment) -> None:
    with pytest.raises(InputError, match=r"got 'Si/Schinke'; `Material\(record='Si/Schinke'\)` is one"):
        materials.refractive_index("Si/Schinke", 800.0)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="`process`: expected ExposureProcess, got str"):
        exposure.beam_psf("hsq_sos_100kv")  # type: ignore[arg-type]
    with pytest.raises(InputError) as refused:
        exposure.expose(mapped, "hsq_sos_100kv")  # type: ignore[arg-type]
    assert "`pillars`: expected PillarMap, got Assignment; give its `pillars`" in str(refused.value)
    assert "`psf`: expected BeamPsf, got str" in str(refused.value)


def test_a_design_in_place_of_its_parts_and_the_reverse_are_refused(design: Design) -> None:
    with pytest.raises(InputError, match="`cell`: expected UnitCell, got Design; give its `unit_cell`"):
        make_design(
            design,  # type: ignore[arg-type]
            aperture_um=30.0,
            focal_length_mm=0.2,
            pixel_um=1.0,
            focus_depth_m=1.0,
            phase=[],
        )
    with pytest.raises(InputError, match="`design`: expected Design, got UnitCell"):
        phase.profile_of(design.unit_cell)  # type: ignore[arg-type]


def test_a_library_is_built_of_a_unit_cell_alone(design: Design, tmp_path: Path) -> None:
    for build in (library.build, lambda one: library.build_file(one, tmp_path / "lib.h5")):
        with pytest.raises(InputError, match="`unit_cell`: expected UnitCell, got Design"):
            build(design)
    with pytest.raises(InputError, match="`library`: expected Library, got Design"):
        library.save(design, tmp_path / "lib.h5")  # type: ignore[arg-type]
