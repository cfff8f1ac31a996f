"""``metafab expose``: figures, sampled pillars, the corrected mask, and refusals by name."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import gdstk
import numpy as np
import pytest
from scipy.special import erf

from metafab import exposure, layout, mask
from metafab.core.conventions import FloatArray
from metafab.core.storage.files import file_sha256
from metafab.exposure import BeamPsf, BeamTerm
from metafab.library import Library, build, save
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Dose, UnitCell, load_design, load_unit_cell
from tests.layout.conftest import OffAxisLens, sizes_at_sites
from tests.main_job import ROOT, SMALL, metafab
from tests.physics.exposure.conftest import polygon_energy

PROCESS = '\n[process.exposure]\npreset = "hsq_sos_100kv"\nclasses = 16\n'
READ_BACK = '\n[mask.dose]\nby = "proximity"\nclasses = 16\n'


def design_file(path: Path, source: Path, further: str, **replaced: str) -> Path:
    """Write a design of the repository with further tables and other values."""
    text = source.read_text(encoding="utf-8").replace("../unitcell_lib", str(ROOT / "unitcell_lib"))
    for old, new in replaced.items():
        lines = [f"{old} = {new}" if line.startswith(f"{old} =") else line for line in text.splitlines()]
        text = "\n".join(lines)
    path.write_text(text + further, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def folder(smooth_library: Library, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lens 40 um wide: ``layout.oas`` and its ``design.toml``."""
    folder = tmp_path_factory.mktemp("lens")
    design_file(folder / "design.toml", SMALL, PROCESS, aperture_um="40.0", formats='["oas"]')
    design = load_design(folder / "design.toml")
    profile = PhaseProfile((OffAxisLens(1000.0, 0.8, 140.0),))
    mask.write(layout.assign(profile, smooth_library, design).pillars, folder, design)
    return folder


def test_figures_and_the_corrected_mask(folder: Path, tmp_path: Path) -> None:
    common = (folder / "layout.oas", "--design", folder / "design.toml", "--json")
    plain = metafab("expose", *common)
    assert plain.code == 0, plain.stderr
    corrected = metafab("expose", *common, "--correct", "-o", tmp_path)
    assert corrected.code == 0, corrected.stderr
    keys = {"pillars", "cd_error_rms_nm", "cd_error_max_nm", "dose_min", "dose_max", "classes", "error", "psf"}
    assert keys | {"seconds", "peak_rss_mb"} <= plain.json.keys()
    assert (plain.json["dose_min"], plain.json["dose_max"], plain.json["classes"]) == (1.0, 1.0, 1)
    assert corrected.json["classes"] == 16
    # One class is 0.4 % of dose wide, and 1 % of dose is 0.11 nm.
    assert corrected.json["cd_error_rms_nm"] < min(0.05, plain.json["cd_error_rms_nm"])
    assert corrected.json["dose_min"] < 1.0 < corrected.json["dose_max"]
    assert corrected.json["error"] < 8e-4
    terms = corrected.json["psf"]["terms"]
    assert sum(term["weight"] for term in terms) == pytest.approx(1.0)
    assert {"kind", "weight", "range_nm"} <= terms[0].keys()

    design = load_design(folder / "design.toml")
    before, after = (mask.read(path / "layout.oas", design).pillars for path in (folder, tmp_path))
    assert np.array_equal(sizes_at_sites(after), sizes_at_sites(before))
    rows = list(csv.DictReader((tmp_path / "doses.csv").read_text(encoding="utf-8").splitlines()))
    assert [int(row["datatype"]) for row in rows] == list(range(16))
    doses = [float(row["dose_over_base_dose"]) for row in rows]
    assert doses == sorted(doses)
    assert doses[0] == pytest.approx(corrected.json["dose_min"], abs=1e-6)
    ranks = (tmp_path / "doses.jdi").read_text(encoding="utf-8")
    percent = [float(word) for word in re.findall(r"\( *\d+, +([-0-9.]+) \)", ranks)]
    assert ranks.startswith("helix_small: MODULAT (")
    np.testing.assert_allclose(1.0 + 0.01 * np.array(percent), doses, atol=1e-5)
    record = tmp_path / "exposure.json"
    recorded = metafab("expose", *common, "--correct", "-o", record)
    assert recorded.code == 0, recorded.stderr
    assert list(recorded.json["files"]) == ["exposure.json"]
    kept = exposure.load_record(record)
    assert kept is not None and kept.corrected is not None
    assert kept.mask_sha256 == file_sha256(folder / "layout.oas")
    assert kept.plain.figures.cd_error_rms_nm == plain.json["cd_error_rms_nm"]
    assert kept.corrected.figures.cd_error_rms_nm == corrected.json["cd_error_rms_nm"]
    # The design of the plain mask reads its classes too, however many the file has.
    for engine in ("lattice", "rectangles", "polygons"):
        by = ("--design", folder / "design.toml", "--engine", engine, "--json")
        checked = metafab("drc", tmp_path / "layout.oas", *by)
        assert (checked.code, checked.json["pillars"]) == (0, corrected.json["pillars"]), checked.stderr
        assert checked.json["other_layers"] == {}


def _rectangles(path: Path, doses: Path) -> FloatArray:
    """Centre, width and length (nm) and dose of each polygon of a mask, by gdstk: shape (n, 5)."""
    drawn = gdstk.read_oas(path)
    (top,) = drawn.top_level()
    rows = csv.DictReader(doses.open(encoding="utf-8"))
    dose = {int(row["datatype"]): float(row["dose_over_base_dose"]) for row in rows}
    table = []
    for polygon in top.get_polygons():
        (left, low), (right, high) = polygon.bounding_box()
        sides = (0.5 * (left + right), 0.5 * (low + high), right - left, high - low)
        table.append((*(side * drawn.unit * 1e9 for side in sides), dose[polygon.datatype]))
    return np.array(table)


def _direct(terms: list[dict[str, Any]], drawn: FloatArray, x_nm: float, y_nm: float) -> float:
    """Energy at a place over that of a large pad at the base dose, summed over all rectangles and terms."""
    x, y, (width, length) = x_nm - drawn[:, 0], y_nm - drawn[:, 1], 0.5 * drawn[:, 2:4].T
    total = 0.0
    for term in terms:
        beta = term["range_nm"]
        along_x = erf((x + width) / beta) - erf((x - width) / beta)
        along_y = erf((y + length) / beta) - erf((y - length) / beta)
        total += float(0.25 * term["weight"] * (drawn[:, 4] * along_x * along_y).sum())
    return total


def test_samples_agree_with_a_direct_sum_from_outside(folder: Path, tmp_path: Path) -> None:
    """From the CSV, the corrected mask by gdstk, and ``psf`` of the JSON; the worst error is 2e-4.

    Printed edges: the profile of the pillar itself moves, the energy of all others is that at the drawn edge.
    """
    table, before = tmp_path / "samples.csv", file_sha256(folder / "layout.oas")
    answer = metafab(
        "expose", folder / "layout.oas", "--design", folder / "design.toml", "--sample", "5", "--sample-csv", table,
        "--correct", "-o", folder, "--json",
    )  # fmt: skip
    assert answer.code == 0, answer.stderr
    # The folder of the plain mask keeps it.
    assert file_sha256(folder / "layout.oas") == before
    assert answer.json["folder"] == str(folder / "corrected")
    assert str(folder / "corrected") in answer.stderr
    rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(table.open(encoding="utf-8"))]
    assert len(rows) == 5
    assert list(rows[0]) == [
        "x_um", "y_um", "width_nm", "length_nm", "dose", "energy_centre", "energy_edge_x", "energy_edge_y",
        "printed_width_nm", "printed_length_nm", "printed_corner_radius_nm",
    ]  # fmt: skip
    psf, ratio = answer.json["psf"], answer.json["base_over_clearing_dose"]
    terms = psf["terms"]
    assert {term["kind"] for term in terms} == {"gauss"}
    assert psf["blur_nm"] == 5.0
    drawn = _rectangles(folder / "corrected" / "layout.oas", folder / "corrected" / "doses.csv")
    assert len(drawn) == answer.json["pillars"]
    for row in rows:
        x, y, w, length = 1e3 * row["x_um"], 1e3 * row["y_um"], row["width_nm"], row["length_nm"]
        (own,) = drawn[np.hypot(drawn[:, 0] - x, drawn[:, 1] - y) < 0.1]
        np.testing.assert_allclose(own, [x, y, w, length, row["dose"]], rtol=0.0, atol=1e-6)
        assert row["energy_centre"] == pytest.approx(ratio * _direct(terms, drawn, x, y), abs=2e-4)
        for side, (right, up) in (("width", (0.5 * w, 0.0)), ("length", (0.0, 0.5 * length))):
            edges = [_direct(terms, drawn, x + sign * right, y + sign * up) for sign in (1, -1)]
            stated = row[f"energy_edge_{'x' if side == 'width' else 'y'}"]
            assert stated == pytest.approx(ratio * 0.5 * sum(edges), abs=2e-4)
            moved = 0.5 * (row[f"printed_{side}_nm"] - row[f"{side}_nm"])
            at_drawn = _direct(terms, own[None], x + right, y + up)
            at_printed = _direct(terms, own[None], x + right + np.sign(right) * moved, y + up + np.sign(up) * moved)
            # The edge of a pillar falls by 0.03 a nanometre: 1e-3 is 0.03 nm.
            assert stated + ratio * (at_printed - at_drawn) == pytest.approx(1.0, abs=1e-3)


CHIP = """
[mask.chip]
margin_um = 30.0
mark_um = 8.0
mark_line_um = 1.0
frame_um = 2.0
street_um = 10.0
label = "A"
text_um = 4.0
scale_bar_um = 0.0
[mask.kit]
cd_bars = [{ at_um = [0.0, 16.5], width_nm = [200.0], length_um = 2.0, spacing_um = 1.0, lines = 3 }]
[[mask.include]]
file = "arrow.gds"
[[mask.copies]]
at_um = [-9.0, 0.0]
dose = 0.9
[[mask.copies]]
at_um = [8.9, 0.0]
dose = 1.2
"""


def test_everything_beside_a_lens_is_counted(smooth_library: Library, tmp_path: Path) -> None:
    """Two lenses 3 um apart with frame, text, bars and an arrow: energies are sums over the polygons of the file.

    Marks are the first exposure's. A shape that the design does not draw is left out, and named.
    """
    arrow = gdstk.Library(unit=1e-6, precision=1e-9)
    arrow.new_cell("arrow").add(
        gdstk.Polygon([(-9, -9), (-7, -11), (-9, -10), (-11, -11)], layer=40), gdstk.Label("up", (-9, -9), layer=40)
    )
    arrow.write_gds(tmp_path / "arrow.gds")
    path = design_file(tmp_path / "design.toml", SMALL, PROCESS + CHIP, aperture_um="15.0", formats='["oas"]')
    design = load_design(path)
    mask.write(
        layout.assign(PhaseProfile((OffAxisLens(1000.0, 0.8, 140.0),)), smooth_library, design).pillars,
        tmp_path,
        design,
    )
    common = ("--design", path, "--json", "--sample", "1000000", "--sample-csv", tmp_path / "s.csv")
    answer = metafab("expose", tmp_path / "layout.oas", *common, "--copy", "2")
    assert answer.code == 0, answer.stderr
    assert "not counted" not in answer.stderr
    beside = {one["name"]: one["dose"] for one in answer.json["beside"]}
    assert beside["copy 1"] == beside["11/0 frame"] == beside["40/0 included from arrow.gds"] == "counted"
    assert beside["10/0 alignment marks"] == "first exposure"
    drawn = gdstk.read_oas(tmp_path / "layout.oas").top_level()[0].get_polygons()
    doses, boxes, rest = {(1, 0): 0.9, (1, 1): 1.2}, [], []
    for polygon in drawn:
        corners, dose = 1e3 * polygon.points - (8900.0, 0.0), doses.get((polygon.layer, polygon.datatype), 1.0)
        if polygon.layer == 40:
            (x, y), (next_x, next_y) = corners.T, np.roll(corners, -1, axis=0).T
            rest.append(corners if np.sum(x * next_y - next_x * y) > 0.0 else corners[::-1])
        elif polygon.layer not in (10, 14, 16):
            low, high = corners.min(axis=0), corners.max(axis=0)
            boxes.append((*(0.5 * (low + high)), *(high - low), dose))
    psf, ratio = answer.json["psf"]["terms"], answer.json["base_over_clearing_dose"]
    beam = exposure.BeamPsf.of([BeamTerm("gauss", term["weight"], term["range_nm"]) for term in psf], "assumption")
    rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader((tmp_path / "s.csv").open())]
    rows.sort(key=lambda row: row["x_um"])
    for row in (rows[0], rows[-1], max(rows, key=lambda row: row["y_um"])):
        x, y = 1e3 * row["x_um"], 1e3 * row["y_um"]
        whole = _direct(psf, np.array(boxes), x, y) + sum(polygon_energy(beam, part - (x, y)) for part in rest)
        assert row["energy_centre"] == pytest.approx(ratio * whole, abs=answer.json["error"] + 1e-6)
        assert row["energy_centre"] > ratio * _direct(psf, np.array([b for b in boxes if b[4] == 1.2]), x, y) + 0.005
    _check_both_corrected(path, tmp_path, [box for box in boxes if box[4] == 1.0], rest, beam)
    # Another design's frame: the file's is left out, and named.
    other = design_file(tmp_path / "other.toml", path, "", frame_um="0.0", street_um="0.0")
    answer = metafab("expose", tmp_path / "layout.oas", "--design", other, "--json", "--copy", "2")
    assert answer.code == 0
    assert "4 on 11/0" in answer.stderr
    fitted = tmp_path / "cd.csv"
    fitted.write_text("x_um,y_um,width_nm,length_nm,copy\n" + "0.175,0.175,120,120,2\n", encoding="utf-8")
    refused = metafab("process", "fit", fitted, tmp_path / "layout.oas", "--design", other)
    assert refused.code == 2
    assert "4 on 11/0" in refused.stderr
    marked = design_file(tmp_path / "marked.toml", path, "", preset='"hsq_sos_100kv"\nwith_layers = [10]')
    answer = metafab("expose", tmp_path / "layout.oas", "--design", marked, "--json", "--copy", "2")
    assert {one["name"]: one["dose"] for one in answer.json["beside"]}["10/0 alignment marks"] == "counted"
    unknown = design_file(tmp_path / "unknown.toml", path, "", preset='"hsq_sos_100kv"\nwith_layers = [77]')
    answer = metafab("expose", tmp_path / "layout.oas", "--design", unknown, "--json", "--copy", "2")
    assert (answer.code, answer.stdout) == (2, "")
    assert "process.exposure.with_layers" in answer.stderr


def _check_both_corrected(path: Path, folder: Path, others: list[Any], rest: list[FloatArray], beam: BeamPsf) -> None:
    """Both lenses have doses of their own; energies of the one that is read are sums over the corrected file.

    ``others`` and ``rest`` are the rectangles and polygons beside both lenses, from the axis of the second one.
    """
    out, table = folder / "corrected", folder / "c.csv"
    common = ("expose", folder / "layout.oas", "--design", path, "--json", "--correct", "-o", out, "--copy", "2")
    refused = metafab(*common, "--dose-datatypes")
    assert refused.code == 2
    assert "mask.formats" in refused.stderr
    common = (*common[:3], design_file(folder / "gds.toml", path, "", formats='["gds", "oas"]'), *common[4:])
    answer = metafab(*common, "--sample", "1000000", "--sample-csv", table, "--dose-datatypes")
    assert answer.code == 0, answer.stderr
    copies = answer.json["copies"]
    assert [(one["copy"], one["dose"], one["doses_of"]) for one in copies] == [(1, 0.9, 1), (2, 1.2, 2)]
    rows = list(csv.DictReader((out / "doses.csv").open(encoding="utf-8")))
    assert [row["copies"] for row in rows] == ["1"] * 16 + ["2"] * 16
    dose = {int(row["datatype"]): float(row["dose_over_base_dose"]) for row in rows}
    boxes = list(others)
    for polygon in gdstk.read_oas(out / "layout.oas").top_level()[0].get_polygons():
        if polygon.layer == 1:
            low, high = 1e3 * np.array(polygon.bounding_box()) - (8900.0, 0.0)
            boxes.append((*(0.5 * (low + high)), *(high - low), dose[polygon.datatype]))
    by_class, by_dose = (
        gdstk.read_gds(out / name).top_level()[0].get_polygons() for name in ("layout.gds", "doses.gds")
    )
    assert len(by_class) == len(by_dose)
    for one, other in zip(by_class, by_dose, strict=True):
        assert np.array_equal(one.points, other.points) and one.layer == other.layer
        assert other.datatype == round(1000 * dose[one.datatype] if one.layer == 1 else 1000)
    assert (out / "doses.txt").read_text().splitlines()[0].split() == ["1", "0", rows[0]["dose_over_base_dose"]]
    figures, psf, ratio = np.array(boxes), answer.json["psf"]["terms"], answer.json["base_over_clearing_dose"]
    samples = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(table.open())]
    samples.sort(key=lambda row: row["x_um"])
    for row in (samples[0], samples[-1]):
        x, y = 1e3 * row["x_um"], 1e3 * row["y_um"]
        whole = _direct(psf, figures, x, y) + sum(polygon_energy(beam, part - (x, y)) for part in rest)
        assert row["energy_centre"] == pytest.approx(ratio * whole, abs=answer.json["error"] + 1e-6)
    read = load_design(design_file(folder / "read.toml", path, READ_BACK))
    for number in (1, 2):
        back = mask.read(out / "layout.oas", read, copy=number)
        assert np.count_nonzero(back.pillars.to_array()) == answer.json["pillars"]


def test_measured_sizes_become_a_process_file_that_a_design_uses(folder: Path, tmp_path: Path) -> None:
    """Sizes of the command itself, all 3 nm narrower; height and sidewalls as a microscope would add them.

    A lens that states no focus is in the best one, in the prediction and in the fit.
    """
    known = PROCESS + "base_over_clearing_dose = 2.0\nbest_focus_um = 0.4\n"
    design = design_file(tmp_path / "design.toml", SMALL, known, aperture_um="40.0", formats='["oas"]')
    mask_file, table, process = folder / "layout.oas", tmp_path / "samples.csv", tmp_path / "process.toml"
    exposed = metafab("expose", mask_file, "--design", design, "--sample", "40", "--sample-csv", table, "--json")
    assert exposed.code == 0, exposed.stderr
    lines = ["x_um,y_um,width_nm,length_nm,height_nm,sidewall_angle_deg"]
    for number, row in enumerate(csv.DictReader(table.open(encoding="utf-8"))):
        sizes = [float(row[f"printed_{side}_nm"]) - 3.0 for side in ("width", "length")]
        lines.append(f"{row['x_um']},{row['y_um']},{sizes[0] + 60.0 * (number == 6)},{sizes[1]},590.0,88.0")
    (tmp_path / "cd.csv").write_text("\n".join(lines), encoding="utf-8")
    common = ("process", "fit", tmp_path / "cd.csv", mask_file, "--design", design, "-o", process, "--json")
    answer = metafab(*common, "--free", "bias")
    assert answer.code == 0, answer.stderr
    assert answer.json["bias_nm"]["value"] == pytest.approx(-3.0, abs=0.02)
    assert answer.json["base_over_clearing_dose"] == {"value": 2.0, "error": None}
    (far,) = answer.json["far"]
    assert (far["row"], far["side"]) == (7, "width")
    assert far["measured_nm"] - far["fitted_nm"] == pytest.approx(60.0, abs=0.1)
    assert "hardly counts: row 7" in answer.stderr and "# far from the fit: row 7" in process.read_text("utf-8")
    source = SMALL.read_text(encoding="utf-8").replace("../unitcell_lib", str(ROOT / "unitcell_lib"))
    (tmp_path / "next.toml").write_text(f'process = "process.toml"\n{source}', encoding="utf-8")
    made = load_design(tmp_path / "next.toml").process
    assert made is not None and made.etch is not None and made.exposure is not None
    assert made.etch.bias_nm == pytest.approx(answer.json["bias_nm"]["value"], abs=1e-4)
    assert (made.etch.height_nm, made.etch.sidewall_angle_deg) == (590.0, 88.0)
    assert made.exposure.preset == "hsq_sos_100kv"
    assert exposure.beam_psf(made.exposure).source.endswith("; fit of bias to 80 sizes of cd.csv at 1 doses")
    assert load_unit_cell(tmp_path / "process_cell.toml").cell.height_nm == 590.0
    refused = metafab(*common, "--free", "contrast")
    assert refused.code == 2
    assert "threshold" in refused.stderr
    own = design_file(tmp_path / "own.toml", design, "", library='"process_cell.toml"')
    cell = (tmp_path / "process_cell.toml").read_bytes()
    refused = metafab(*common[:5], own, *common[6:], "--free", "bias")
    assert refused.code == 2, refused.stderr
    assert "process_cell.toml, which is read" in refused.stderr
    assert (tmp_path / "process_cell.toml").read_bytes() == cell


@pytest.mark.parametrize(
    ("library", "further", "named"),
    [
        ("sos_800nm", "", "process.exposure"),
        ("cross", PROCESS, "cell.shape"),
        ("ring", PROCESS, "cell.shape"),
        ("sos_800nm", '\n[process.exposure]\npreset = "unknown"\n', "hsq_sos_100kv"),
        ("sos_800nm", "\n[[mask.copies]]\nat_um = [0.0, 0.0]\nfocus_um = 0.5\n" + PROCESS, "convergence_mrad"),
    ],
)
def test_refusals_name_the_key(library: str, further: str, named: str, folder: Path, tmp_path: Path) -> None:
    cell = ROOT / "unitcell_lib" / f"{library}.toml"
    if library == "cross":
        cell = design_file(tmp_path / "cross.toml", cell.with_name("sos_800nm.toml"), "", shape='"cross"')
    if library == "ring":
        ring, circles = '"ring"\ninner_diameter_nm = 50.0', cell.with_name("sin_circles_633nm.toml")
        cell = design_file(tmp_path / "ring.toml", circles, "", shape=ring)
    rules = {"min_gap_nm": "40.0", "min_feature_nm": "20.0"}
    path = design_file(tmp_path / "design.toml", SMALL, further, library=f'"{cell}"', optimise='"none"', **rules)
    answer = metafab("expose", folder / "layout.oas", "--design", path, "--json")
    assert (answer.code, answer.stdout) == (2, "")
    assert named in answer.stderr


@pytest.mark.parametrize(("copy", "named"), [(1, "none in copy 2"), (2, "at least one at a site of the lens")])
def test_a_mask_without_a_lens_of_the_design_is_refused(copy: int, named: str, folder: Path, tmp_path: Path) -> None:
    """The correction ended in a ValueError, and the prediction took the missing lens for counted."""
    copies = "[[mask.copies]]\nat_um = [0.0, 0.0]\n[[mask.copies]]\nat_um = [45.0, 0.0]\n"
    path = design_file(tmp_path / "design.toml", SMALL, PROCESS + copies, aperture_um="40.0")
    for command in ("expose",), ("expose", "--correct"):
        answer = metafab(*command, folder / "layout.oas", "--design", path, "--copy", str(copy))
        assert (answer.code, named in answer.stderr) == (2, True), answer.stderr


def test_too_many_doses_are_refused_before_any_is_found(folder: Path, tmp_path: Path) -> None:
    """Each of 129 would have a single class among 256 datatypes."""
    copies = (f"[[mask.copies]]\nat_um = [{1000 * k}.0, 0.0]\ndose = {1 + 0.01 * k:g}\n" for k in range(129))
    path = design_file(tmp_path / "design.toml", SMALL, PROCESS + "".join(copies), optimise='"none"')
    answer = metafab("expose", folder / "layout.oas", "--design", path, "--correct", "-o", tmp_path / "out")
    assert (answer.code, answer.stdout) == (2, "")
    assert "at most 128 different doses" in answer.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("library", "further", "columns", "named"),
    [
        ("sin_circles_633nm", PROCESS, "", "cell.shape"),
        ("sos_800nm", READ_BACK + PROCESS, "", "mask.dose"),
        ("sos_800nm", PROCESS, "sidewall_angle_deg=40", "sidewall_angle_deg"),
        ("sos_800nm", PROCESS, "height_nm=-10", "height_nm"),
        ("sos_800nm", PROCESS, "corner_radius_nm=-1", "corner_radius_nm"),
        ("sos_800nm", PROCESS + "[[mask.copies]]\nat_um = [0.0, 0.0]\n", "copy=2", "copy"),
    ],
)
def test_a_fit_names_what_it_refuses(
    library: str, further: str, columns: str, named: str, folder: Path, tmp_path: Path
) -> None:
    design = design_file(
        tmp_path / "design.toml", SMALL, further, library=f'"{ROOT}/unitcell_lib/{library}.toml"', optimise='"none"'
    )
    name, _, value = columns.partition("=")
    table = tmp_path / "cd.csv"
    table.write_text(f"x_um,y_um,width_nm,length_nm,{name or 'note'}\n0.2,0.2,120,120,{value}\n", encoding="utf-8")
    answer = metafab("process", "fit", table, folder / "layout.oas", "--design", design, "-o", tmp_path / "p.toml")
    assert (answer.code, answer.stdout) == (2, "")
    assert f"`{named}`" in answer.stderr
    assert named != "cell.shape" or "'circle'" in answer.stderr
    assert not columns or named == "copy" or str(table) in answer.stderr
    assert not (tmp_path / "p.toml").exists()


def test_discs_are_printed_and_corrected(tmp_path: Path) -> None:
    """Energies of the corrected mask against polygons read by gdstk; the file is read back with its classes."""
    source = ROOT / "layouts" / "tio2_metalens.toml"
    blurred = PROCESS + "blur_nm = 15.0\n"
    path = design_file(tmp_path / "design.toml", source, blurred, aperture_um="8.0", formats='["oas"]')
    plain = load_design(path)
    lattice = layout.lattice_of(plain)
    table = np.array([(0, 0), *((side, side) for side in range(140, 480, 20))], dtype=np.int32)
    index = np.random.default_rng(2).integers(1, len(table), lattice.shape).astype(np.uint16)
    mask.write(layout.PillarMap.from_array(lattice, table, index, 64), tmp_path, plain)
    common = ("expose", tmp_path / "layout.oas", "--design", path, "--json")
    before = metafab(*common)
    answer = metafab(*common, "--correct", "-o", tmp_path / "out", "--sample", "4", "--sample-csv", tmp_path / "s.csv")
    assert (before.code, answer.code) == (0, 0), before.stderr + answer.stderr
    assert answer.json["cd_error_rms_nm"] < 0.2 * before.json["cd_error_rms_nm"]
    assert answer.json["cd_error_rms_nm"] < 0.1
    drawn = gdstk.read_oas(tmp_path / "out" / "layout.oas")
    rows = csv.DictReader((tmp_path / "out" / "doses.csv").open(encoding="utf-8"))
    dose = {int(row["datatype"]): float(row["dose_over_base_dose"]) for row in rows}
    polygons = [(1e9 * drawn.unit * p.points, dose[p.datatype]) for p in drawn.top_level()[0].get_polygons()]
    terms = [BeamTerm("gauss", term["weight"], term["range_nm"]) for term in answer.json["psf"]["terms"]]
    beam, ratio = exposure.BeamPsf.of(terms, "assumption"), answer.json["base_over_clearing_dose"]
    for row in csv.DictReader((tmp_path / "s.csv").open(encoding="utf-8")):
        x, y, half = 1e3 * float(row["x_um"]), 1e3 * float(row["y_um"]), 0.5 * float(row["width_nm"])
        edges = [sum(d * polygon_energy(beam, p - (x + dx, y)) for p, d in polygons) for dx in (half, -half)]
        assert float(row["energy_edge_x"]) == pytest.approx(0.5 * ratio * sum(edges), abs=2e-4)
        assert float(row["printed_width_nm"]) == pytest.approx(2.0 * half, abs=0.5)
    # Doses of classes are not read: neither the plain design nor that of the classes predicts this mask by one dose.
    again = metafab("expose", tmp_path / "out" / "layout.oas", "--design", path, "--json")
    assert (again.code, again.stdout) == (2, "")
    assert "datatype 0 alone" in again.stderr
    by_class = design_file(tmp_path / "classed.toml", path, READ_BACK)
    again = metafab("expose", tmp_path / "out" / "layout.oas", "--design", by_class, "--json")
    assert again.code == 2
    assert "`mask.dose`: expected one dose" in again.stderr
    classed = replace(plain, mask=replace(plain.mask, dose=Dose(by="proximity", classes=16)))
    back = mask.read(tmp_path / "out" / "layout.oas", classed)
    assert np.array_equal(sizes_at_sites(back.pillars), table[index])


def test_light_of_printed_rectangles_on_a_hexagonal_lattice_is_refused(folder: Path, tmp_path: Path) -> None:
    """Their printed corners are round, which unit cells of that lattice are not."""
    path = design_file(tmp_path / "design.toml", ROOT / "layouts" / "hexagonal_metalens.toml", PROCESS)
    answer = metafab("psf", folder / "layout.oas", "--design", path, "--printed", "plain", "--json")
    assert (answer.code, answer.stdout) == (2, "")
    assert "cell.lattice" in answer.stderr


def test_a_design_of_a_lens_alone_has_no_layers_to_expose_with_it(folder: Path, tmp_path: Path) -> None:
    further = PROCESS + "with_layers = [99]\n"
    path = design_file(tmp_path / "design.toml", SMALL, further, aperture_um="40.0", formats='["oas"]')
    answer = metafab("expose", folder / "layout.oas", "--design", path, "--json")
    assert (answer.code, answer.stdout) == (2, "")
    assert "it draws none, got 99" in answer.stderr


def test_options_that_need_each_other(folder: Path, tmp_path: Path) -> None:
    common = ("expose", folder / "layout.oas", "--design", folder / "design.toml")
    lonely = metafab(*common, "--sample", "5")
    assert lonely.code == 2
    assert "--sample-csv" in lonely.stderr
    uncorrected = metafab(*common, "-o", tmp_path)
    assert uncorrected.code == 2
    assert "--correct" in uncorrected.stderr


def test_light_of_printed_pillars(unit_cell: UnitCell, tmp_path: Path) -> None:
    """An etch that narrows all pillars changes the transmitted power; corrected pillars keep it within 1 %."""
    span = (100.0, 160.0)
    sweep = replace(unit_cell.sweep, width_nm=span, length_nm=span, size_grid_nm=10.0, target_error=1e-2)
    save(build(replace(unit_cell, sweep=sweep)), tmp_path / "library.h5")
    etch = "\n[process.etch]\nbias_nm = -12.0\nsidewall_angle_deg = 89.0\n"
    transmitted = []
    for further, printed in (("", ()), ("", ("--printed", "corrected")), (etch, ("--printed", "plain"))):
        path = design_file(
            tmp_path / "design.toml", SMALL, PROCESS + further, aperture_um="20.0", library='"library.h5"'
        )
        if not transmitted:
            design = load_design(path)
            lattice = layout.lattice_of(design)
            side = 2 * np.arange(110, 160, 10)
            table = np.array([(0, 0), *((w, length) for w in side for length in side)], dtype=np.int32)
            index = np.random.default_rng(1).integers(1, len(table), lattice.shape).astype(np.uint16)
            mask.write(layout.PillarMap.from_array(lattice, table, index, 64), tmp_path, design)
        answer = metafab("psf", tmp_path / "layout.oas", "--design", path, "--depths-m", "0.003", *printed, "--json")
        assert answer.code == 0, answer.stderr
        transmitted.append(answer.json["transmitted_x"])
        assert ("made_error" in answer.json) == bool(printed)
    assert transmitted[1] == pytest.approx(transmitted[0], rel=0.01)
    assert abs(transmitted[2] - transmitted[0]) > 0.02 * transmitted[0]
    refused = metafab("psf", "--ideal", "--design", path, "--printed", "plain")
    assert refused.code == 2
    assert "--printed" in refused.stderr
