"""The page of a run whose results are in closed form."""

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

from metafab.core.errors import InputError
from metafab.core.parallel.progress import silent
from metafab.library.library import Library
from metafab.optics.interpolation import without_depths
from metafab.report import sections
from metafab.report.assets import asset
from metafab.report.draw import draw
from metafab.report.run_folder import AperturePhases, DesignOutline, RunFolder
from metafab.report.style import CSS_VARIABLES
from metafab.report.viewers import psf_view
from metafab.report.write import compose, write
from metafab.steps import RunSummary
from tests.closed_form_run import SHAPE, closed_form_run, decoded_image, turning_psf


@pytest.fixture(scope="module")
def full_run(tmp_path_factory: pytest.TempPathFactory, smooth_library: Library) -> RunFolder:
    """A run folder in which nothing is missing."""
    return closed_form_run(tmp_path_factory.mktemp("run"), smooth_library)


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
    assert "&lt;inputs&gt;" in page
    assert "<inputs>" not in page


def test_every_figure_is_a_png_and_a_drawing(page: str, full_run: RunFolder) -> None:
    pictures = sorted((full_run.path / "figures").glob("*.png"))
    assert len(pictures) == 26
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
    "missing", ["library", "phases", "pillars", "psf", "ideal_psf", "raw", "decoded", "summary", "outline"]
)
def test_a_missing_result_leaves_a_note(full_run: RunFolder, tmp_path: Path, missing: str) -> None:
    empty = {"summary": RunSummary(), "outline": DesignOutline()}.get(missing)
    section = {"pillars": "mask"}.get(missing, missing)
    reason = f"{missing} went missing in a test"
    # Only what depends on the missing part is drawn again: the page must stand without it.
    run = replace(full_run, path=tmp_path, notes={**full_run.notes, section: reason}, **{missing: empty})
    text = compose(run, {})
    if missing not in {"summary", "outline"}:
        assert reason in text
    assert text.rstrip().endswith("</html>")


def test_a_folder_without_results_gives_a_page_of_notes(tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text("{}", encoding="utf-8")
    page = write(tmp_path)
    text = page.read_text(encoding="utf-8")
    assert page == tmp_path / "report.html"
    assert text.count('class="note"') >= 8
    assert sorted(path.name for path in tmp_path.iterdir()) == ["figures", "report.html", "summary.json"]


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
    with pytest.raises(InputError, match=r"without design\.toml"):
        write(tmp_path)


def test_any_number_of_workers_draws_the_same(full_run: RunFolder, page: str) -> None:
    pictures = sorted((full_run.path / "figures").glob("*.png"))
    before = [path.read_bytes() for path in pictures]
    assert compose(full_run, draw(full_run, silent, workers=1)) == page
    assert [path.read_bytes() for path in pictures] == before


def test_a_device_without_a_scene_has_no_section_of_an_image(full_run: RunFolder) -> None:
    assert '<section id="image">' in compose(full_run, {})
    notes = {**full_run.notes, "raw": "no raw.h5"}
    run = replace(full_run, raw=None, decoded=None, outline=DesignOutline("deflector", has_scene=False), notes=notes)
    text = compose(run, {})
    assert '<section id="image">' not in text
    assert "no raw.h5" not in text


def test_one_depth_alone_is_not_drawn_over_depth(full_run: RunFolder) -> None:
    assert full_run.psf is not None
    drawn = {name: f"<svg>{name}</svg>" for name in ("psf_pair", "psf_orientation", "psf_peak", "psf_mtf")}
    several = compose(full_run, drawn)
    nearest = without_depths(full_run.psf, full_run.psf.depth_m > full_run.psf.depth_m[0])
    one = compose(replace(full_run, psf=nearest), drawn)
    assert all(f"<svg>{name}</svg>" in several for name in drawn)
    assert [name for name in drawn if f"<svg>{name}</svg>" in one] == ["psf_pair", "psf_mtf"]
    assert "<label hidden>Object depth" in one
    assert "<label hidden>" not in several


@pytest.mark.parametrize(
    ("terms", "depths", "names"),
    [
        (("spiral_zones", "split_lens"), 3, ["psf_orientation", "psf_peak"]),
        (("spiral_zones", "split_lens"), 1, []),
        (("lens",), 3, ["psf_peak"]),
        (("lens",), 1, []),
    ],
)
def test_curves_over_depth_need_several_depths_and_an_orientation_needs_a_lobe(
    terms: tuple[str, ...], depths: int, names: list[str], full_run: RunFolder, tmp_path: Path
) -> None:
    assert full_run.psf is not None
    pair = without_depths(full_run.psf, full_run.psf.depth_m > full_run.psf.depth_m[depths - 1])
    assert pair.depth_m.size == depths
    run = replace(full_run, path=tmp_path, psf=pair, outline=replace(full_run.outline, terms=terms))
    assert list(draw(run, silent, workers=1, only={"psf_orientation", "psf_peak"})) == names
    assert sorted(path.stem for path in (tmp_path / "figures").iterdir()) == names


@pytest.mark.parametrize(("ripple_rad", "shown"), [(0.0, False), (2.0 * np.pi, False), (0.3, True)])
def test_a_flat_phase_is_said_rather_than_drawn(full_run: RunFolder, ripple_rad: float, shown: bool) -> None:
    """A plain lens has nothing beside its carrier; whole turns are nothing, too."""
    step = ripple_rad * np.tri(8)[None].repeat(2, axis=0)
    plain = replace(full_run, phases=AperturePhases(np.where(np.eye(8) > 0.0, np.nan, step), 17.5))
    drawn = draw(plain, silent)
    assert ("phase_x" in drawn) == shown
    assert ("the target is the phase of the split lens alone" in compose(plain, drawn)) != shown


def test_a_maximum_on_the_image_point_has_no_direction() -> None:
    turning = turning_psf()
    centred = np.zeros_like(turning.psf)
    centred[:, :, centred.shape[2] // 2, centred.shape[3] // 2] = 1.0
    assert psf_view(replace(turning, psf=centred), None)["views"][0]["phi_deg"] == [None] * turning.depth_m.size
    assert None not in psf_view(turning, None)["views"][0]["phi_deg"]


def test_each_link_of_the_page_names_a_section() -> None:
    """The page's script removes links without their section: a wrong name would never show."""
    linked = set(re.findall(r'<a href="#([a-z]+)"', asset("page.html")))
    source = "".join(path.read_text(encoding="utf-8") for path in Path(sections.__file__).parent.glob("*.py"))
    made = set(re.findall(r'html\.section\(\s*"([a-z]+)"', source))
    assert linked == made
