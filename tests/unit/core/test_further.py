"""Further names of the faces: each can be imported from its room, and none is listed."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest

import metafab
from metafab.core.further import further_names

PACKAGE = Path(metafab.__file__).parent


def _tables() -> Iterator[tuple[str, str, str]]:
    """Face, module and names of each line of each face's table."""
    for path in sorted(PACKAGE.rglob("__init__.py")):
        face = ".".join(["metafab", *path.parent.relative_to(PACKAGE).parts])
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "further_names":
                for module, names in ast.literal_eval(node.args[1]).items():
                    yield face, module, names


@pytest.mark.parametrize(("face", "module", "names"), list(_tables()))
def test_a_face_offers_its_further_names(face: str, module: str, names: str) -> None:
    room, home = import_module(face), import_module(module)
    for name in names.split():
        assert getattr(room, name) is getattr(home, name)
        assert name not in getattr(room, "__all__", [])


def test_names_of_the_first_version_are_importable() -> None:
    from metafab.cell.rcwa import ZeroOrder
    from metafab.library import Surface, coverage_rad
    from metafab.optics import PsfField, depth_crlb_m, modulation_transfer, orientation_deg
    from metafab.phase import PhaseStudy, Proposal, Texture, rim_defocus_rad, zone_radii
    from metafab.report.figures import pair_over_depth, phase_map
    from metafab.steps import full_stokes, save_psf

    found = [ZeroOrder, Surface, coverage_rad, PsfField, depth_crlb_m, modulation_transfer, orientation_deg]
    found += [PhaseStudy, Proposal, Texture, rim_defocus_rad, zone_radii, pair_over_depth, phase_map]
    assert all(callable(each) for each in [*found, full_stokes, save_psf])


def test_other_names_are_refused() -> None:
    attribute = further_names("metafab.room", {"math": "pi tau"})
    assert attribute("pi") == pytest.approx(3.14159265)
    with pytest.raises(AttributeError, match=r"module 'metafab.room' has no attribute 'e'"):
        attribute("e")
