"""The page of a run, from results in closed form: a PSF pair that turns by a known angle, a scene of known depths."""

from __future__ import annotations

import base64
import json
import re
import zlib
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from metafab.camera.frame import RawFrame, Truth
from metafab.core.errors import InputError
from metafab.core.progress import silent
from metafab.decode.image import Image4D
from metafab.layout.pillars import Lattice, PillarMap
from metafab.library.library import Library
from metafab.optics.point_spread import Psf
from metafab.report.draw import draw
from metafab.report.run_folder import AperturePhases, RunFolder
from metafab.report.style import CSS_VARIABLES
from metafab.report.write import compose, write

DEPTHS_M = np.linspace(0.25, 0.35, 9)
SHAPE = (48, 64)


def turning_psf(share: float = 1.0) -> Psf:
    """A Gaussian lobe 8 um from the image point that turns by 20 degrees a step; y's is the point mirror image."""
    pixel_um, n = 1.0, 33
    phi_deg = 40.0 + 20.0 * np.arange(DEPTHS_M.size)
    axis = (np.arange(n) - n // 2) * pixel_um
    x, y = axis[None, :], axis[:, None]
    lobes = []
    for sign in (1.0, -1.0):
        u, v = (sign * 8.0 * f(np.radians(phi_deg))[:, None, None] for f in (np.cos, np.sin))
        lobes.append(np.exp(-((x - u) ** 2 + (y - v) ** 2) / 8.0) / (8.0 * np.pi))
    centre = np.zeros((2, DEPTHS_M.size, 2))
    wrapped = np.mod(phi_deg + 180.0, 360.0) - 180.0
    efficiency = np.full((2, DEPTHS_M.size), share)
    return Psf(
        DEPTHS_M,
        pixel_um,
        share * np.stack(lobes),
        centre,
        wrapped,
        np.full(9, 1e-3),
        efficiency,
        np.full(9, 30.0),
        2e4,
    )


def decoded_image() -> Image4D:
    """Two segments at 0.26 m and 0.33 m on an empty ground."""
    segment = np.zeros(SHAPE, dtype=np.int32)
    segment[8:24, 10:30], segment[28:40, 34:58] = 1, 2
    depth = np.choose(segment, [np.nan, 0.2604, 0.3291])
    intensity_x = np.choose(segment, [0.0, 900.0, 1500.0])
    intensity_y = np.choose(segment, [0.0, 850.0, 600.0])
    with np.errstate(invalid="ignore", divide="ignore"):
        contrast = np.where(segment > 0, intensity_x / intensity_y, np.nan)
    rows = ({"number": 1.0, "depth_m": 0.2604, "error_m": 4e-4}, {"number": 2.0, "depth_m": 0.3291, "error_m": 8e-4})
    confidence = np.where(segment > 0, 0.9, 0.0)
    return Image4D(
        intensity_x, intensity_y, contrast, depth, confidence, segment, (-3000.0, -80.0), 3.45, rows, nmae=2.1e-3
    )


def raw_frame() -> RawFrame:
    """Both images side by side."""
    image = decoded_image()
    truth = Truth(np.choose(image.segment, [np.nan, 0.26, 0.33]), image.intensity_x, image.intensity_y, image.segment)
    frame = np.hstack([image.intensity_x, np.zeros((SHAPE[0], 20)), image.intensity_y])
    return RawFrame(frame, 3.45, (-3000.0, -80.0), 2.0, truth, (-3000.0, -80.0))


def pillar_map() -> PillarMap:
    """A disc of two sizes, in tiles that do not divide the lattice."""
    lattice = Lattice((700, 700), (101, 101), 0.5)
    y, x = np.mgrid[-50:51, -50:51]
    index = np.where(x**2 + y**2 <= 48**2, 1 + (x + y) % 2, 0).astype(np.uint16)
    sizes = np.array([[0, 0], [200, 400], [500, 300]], dtype=np.int32)
    return PillarMap.from_array(lattice, sizes, index, 40)


SUMMARY = {
    "name": "closed_form",
    "library": {"file": "lib.h5", "points_solved": 120, "points_total": 5776, "max_error": 1.7e-3, "coverage_rad": 6.2},
    "phase": {"peak_gain": 1.36, "rotation_deg": -160.0},
    "layout": {
        "pillars": 7213,
        "distinct_sizes": 2,
        "min_gap_nm": 100.0,
        "phase_rms_error_rad": 0.08,
        "files": [{"name": "layout.gds", "bytes": 461632}, {"name": "layout.oas", "bytes": 9001}],
    },
    "drc": {"pillars": 7213, "violations": {"min_gap": 0, "min_feature": 3}, "engine": "lattice"},
    "decode": {"nmae": 2.1e-3, "seconds": 0.12},
    "error_budget": [
        {"source": "solver and library", "value": 1.7e-3, "unit": "complex t", "how": "held-out sizes"},
        {"source": "local-period approximation", "value": None, "unit": "complex t", "how": "not by this run"},
        {"source": "decoder", "value": 2.1e-3, "unit": "mean |dz|/z", "how": "decoded against <true> depth"},
    ],
    "seconds": {"library": 3.1, "layout": 0.5, "psf": 0.8},
    "peak_rss_mb": {"library": 210.0, "layout": 180.0, "psf": 260.0},
    "skipped": [{"step": "library", "why": "its inputs and its files are unchanged"}],
    "versions": {"metafab": "0.1.0", "numpy": "2.3"},
}


@pytest.fixture(scope="module")
def full_run(tmp_path_factory: pytest.TempPathFactory, smooth_library: Library) -> RunFolder:
    """A run folder in which nothing is missing."""
    angle = np.linspace(-np.pi, np.pi, 64)
    phase = np.stack([angle[:, None] + angle[None, :], angle[:, None] - angle[None, :]])
    return RunFolder(
        path=tmp_path_factory.mktemp("run"),
        summary=SUMMARY,
        design_table={
            "name": "closed_form",
            "device": {"aperture_um": 35.0, "aperture_shape": "circle", "focal_length_mm": 20.0},
            "phase": [{"term": "spiral_zones"}, {"term": "split_lens"}],
        },
        library=smooth_library,
        phases=AperturePhases(phase, 17.5),
        pillars=pillar_map(),
        mask_file="layout.oas",
        psf=turning_psf(0.6),
        ideal_psf=turning_psf(0.9),
        raw=raw_frame(),
        decoded=decoded_image(),
        notes={"design_table": "made in memory"},
    )


@pytest.fixture(scope="module")
def page(full_run: RunFolder) -> str:
    """Its page."""
    return compose(full_run, draw(full_run, silent))


class _Page(HTMLParser):
    """Collects what a browser would fetch, and every identifier."""

    def __init__(self) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.identifiers: list[str] = []
        self.references: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name == "id":
                self.identifiers.append(value or "")
            if name in {"src", "data", "poster"} or (
                name in {"href", "xlink:href"} and tag in {"link", "use", "image"}
            ):
                (self.references if (value or "").startswith("#") else self.fetched).append(value or "")


def _parsed(page: str) -> _Page:
    parser = _Page()
    parser.feed(page)
    return parser


def test_page_fetches_nothing(page: str) -> None:
    parser = _parsed(page)
    assert all(address.startswith("data:") for address in parser.fetched), parser.fetched
    assert "url(http" not in page
    assert "@import" not in page


def test_identifiers_are_unique_and_references_resolve(page: str) -> None:
    """Twenty drawings stand in one document: their clip paths and glyphs must not mix."""
    parser = _parsed(page)
    assert len(parser.identifiers) == len(set(parser.identifiers))
    clips = re.findall(r"url\(#([^)]+)\)", page)
    known = set(parser.identifiers)
    assert clips
    assert {*clips, *(reference[1:] for reference in parser.references)} <= known


def test_text_of_a_run_cannot_become_markup(page: str) -> None:
    assert "&lt;true&gt;" in page
    assert "<true>" not in page


def test_every_figure_is_a_png_and_a_drawing(page: str, full_run: RunFolder) -> None:
    pictures = sorted((full_run.path / "figures").glob("*.png"))
    assert len(pictures) == 24
    for picture in pictures:
        assert picture.read_bytes().startswith(b"\x89PNG")
    assert page.count('class="plot"') == len(pictures)


def test_inks_follow_the_theme(page: str) -> None:
    """No named ink is left as a fixed colour in a drawing; each has a light and a dark value."""
    drawings = "".join(re.findall(r"<svg.*?</svg>", page, flags=re.DOTALL))
    for ink, variable in CSS_VARIABLES.items():
        assert ink not in drawings.lower()
        assert page.count(f"{variable}:") == 2, f"{variable} needs a light and a dark value"


def test_views_carry_the_values(page: str) -> None:
    """What the pointer reads is what the decoder found, to the 16-bit step that it is stored with."""
    match = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, flags=re.DOTALL)
    assert match is not None
    views = json.loads(match[1])
    image, truth = views["image"], decoded_image()
    for name in ("depth_m", "contrast", "confidence", "intensity_x", "intensity_y"):
        stored, expected = image["values"][name], getattr(truth, name)
        steps = np.frombuffer(zlib.decompress(base64.b64decode(stored["deflated"])), dtype="<u2").reshape(SHAPE)
        values = np.where(steps == 65535, np.nan, stored["low"] + steps * stored["step"])
        # Rounding to the nearest step moves a value by half a step at most.
        np.testing.assert_allclose(values, expected, atol=0.501 * stored["step"], rtol=1e-12)
    pair = views["psf"]["views"]
    assert [view["name"] for view in pair] == ["written file", "target phases"]
    for index, (x, y) in enumerate(pair[0]["peak"][0]):
        # The lobe is 8 pixels out: rounding to whole pixels turns it by atan(0.71 / 8) = 5.1 degrees at most.
        turned = np.degrees(np.arctan2(y, x)) - pair[0]["phi_deg"][index]
        assert abs((turned + 180.0) % 360.0 - 180.0) < 5.1
        assert pair[0]["peak"][1][index] == [-x, -y]


def test_same_results_same_bytes(full_run: RunFolder, page: str) -> None:
    pictures = {path.name: path.read_bytes() for path in (full_run.path / "figures").glob("*.png")}
    assert compose(full_run, draw(full_run, silent)) == page
    assert pictures == {path.name: path.read_bytes() for path in (full_run.path / "figures").glob("*.png")}


@pytest.mark.parametrize(
    "missing", ["library", "phases", "pillars", "psf", "ideal_psf", "raw", "decoded", "summary", "design_table"]
)
def test_a_missing_result_leaves_a_note(full_run: RunFolder, tmp_path: Path, missing: str) -> None:
    empty: dict[str, object] | None = {} if missing in {"summary", "design_table"} else None
    section = {"pillars": "mask"}.get(missing, missing)
    reason = f"{missing} went missing in a test"
    # Only what depends on the missing part is drawn again: the page must stand without it.
    run = replace(full_run, path=tmp_path, notes={**full_run.notes, section: reason}, **{missing: empty})
    text = compose(run, {})
    if missing not in {"summary", "design_table"}:
        assert reason in text
    assert text.rstrip().endswith("</html>")


def test_an_empty_folder_gives_a_page(tmp_path: Path) -> None:
    page = write(tmp_path)
    text = page.read_text(encoding="utf-8")
    assert page == tmp_path / "report.html"
    assert text.count('class="note"') >= 8
    assert sorted(path.name for path in tmp_path.iterdir()) == ["figures", "report.html"]


def test_damaged_files_are_named(tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text("[1, 2]", encoding="utf-8")
    (tmp_path / "design.toml").write_text("name = ", encoding="utf-8")
    for name in ("psf.h5", "raw.h5", "decoded.h5"):
        (tmp_path / name).write_bytes(b"\x89HDF\r\n\x1a\ncut short")
    text = write(tmp_path).read_text(encoding="utf-8")
    for name in ("psf.h5", "raw.h5", "decoded.h5"):
        assert f"{name} could not be used" in text


def test_a_folder_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="run folder"):
        write(tmp_path / "nowhere")
