"""``metafab expose``: figures, sampled pillars, the corrected mask, and refusals by name."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab import layout, mask
from metafab.core.conventions import FloatArray
from metafab.library import Library, build, save
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import UnitCell, load_design
from tests.layout.conftest import OffAxisLens, sizes_at_sites
from tests.main_job import ROOT, SMALL, metafab

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
    """A lens 40 um wide: ``layout.oas``, ``design.toml``, and ``read.toml`` for the corrected mask."""
    folder = tmp_path_factory.mktemp("lens")
    for name, further in (("design.toml", PROCESS), ("read.toml", PROCESS + READ_BACK)):
        design_file(folder / name, SMALL, further, aperture_um="40.0", formats='["oas"]')
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
    assert corrected.json["error"] < 2e-4
    terms = corrected.json["psf"]["terms"]
    assert sum(term["weight"] for term in terms) == pytest.approx(1.0)
    assert {"kind", "weight", "range_nm"} <= terms[0].keys()

    before = mask.read(folder / "layout.oas", load_design(folder / "design.toml")).pillars
    after = mask.read(tmp_path / "layout.oas", load_design(folder / "read.toml")).pillars
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
    checked = metafab("drc", tmp_path / "layout.oas", "--design", folder / "read.toml", "--json")
    assert (checked.code, checked.json["pillars"]) == (0, corrected.json["pillars"]), checked.stderr


def _direct(weight: FloatArray, beta: FloatArray, lens: mask.ReadBack, dose: FloatArray, at_nm: FloatArray) -> float:
    """Energy at a place over that of a large pad at the base dose, summed over all pillars and Gaussians."""
    from scipy.special import erf

    pillars = lens.pillars
    size = pillars.size_nm()[pillars.to_array()]
    x = at_nm[0] - 1e3 * pillars.lattice.x_um()[None, :]
    y = at_nm[1] - 1e3 * pillars.lattice.y_um()[:, None]
    total = 0.0
    for share, reach in zip(weight, beta, strict=True):
        along_x = erf((x + 0.5 * size[..., 0]) / reach) - erf((x - 0.5 * size[..., 0]) / reach)
        along_y = erf((y + 0.5 * size[..., 1]) / reach) - erf((y - 0.5 * size[..., 1]) / reach)
        total += float(0.25 * share * (dose * along_x * along_y).sum())
    return total


def test_sampled_energies_agree_with_a_direct_sum_of_the_stated_function(folder: Path, tmp_path: Path) -> None:
    """From the CSV, the mask and ``psf`` in the JSON alone; 2e-4 is the error that the command may state."""
    table = tmp_path / "samples.csv"
    answer = metafab(
        "expose", folder / "layout.oas", "--design", folder / "design.toml", "--sample", "5", "--sample-csv", table,
        "--json",
    )  # fmt: skip
    assert answer.code == 0, answer.stderr
    rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(table.open(encoding="utf-8"))]
    assert len(rows) == 5
    weight = np.array([term["weight"] for term in answer.json["psf"]["terms"]])
    beta = np.array([term["range_nm"] for term in answer.json["psf"]["terms"]])
    back = mask.read(folder / "layout.oas", load_design(folder / "design.toml"))
    ratio = answer.json["base_over_clearing_dose"]
    for row in rows:
        place = 1e3 * np.array([row["x_um"], row["y_um"]])
        half = 0.5 * np.array([row["width_nm"], row["length_nm"]])
        dose = np.ones(back.pillars.lattice.shape)
        right, left = (_direct(weight, beta, back, dose, place + s * half * [1, 0]) for s in (1, -1))
        upper, lower = (_direct(weight, beta, back, dose, place + s * half * [0, 1]) for s in (1, -1))
        assert row["energy_centre"] == pytest.approx(ratio * _direct(weight, beta, back, dose, place), abs=2e-4)
        assert row["energy_edge_x"] == pytest.approx(ratio * 0.5 * (right + left), abs=2e-4)
        assert row["energy_edge_y"] == pytest.approx(ratio * 0.5 * (upper + lower), abs=2e-4)


@pytest.mark.parametrize(
    ("library", "further", "named"),
    [
        ("sos_800nm", "", "process.exposure"),
        ("tio2_hexagonal_660nm", PROCESS, "cell.lattice"),
        ("sin_circles_633nm", PROCESS, "cell.shape"),
        ("sos_800nm", '\n[process.exposure]\npreset = "unknown"\n', "hsq_sos_100kv"),
    ],
)
def test_refusals_name_the_key(library: str, further: str, named: str, folder: Path, tmp_path: Path) -> None:
    path = design_file(
        tmp_path / "design.toml", SMALL, further, library=f'"{ROOT}/unitcell_lib/{library}.toml"', optimise='"none"'
    )
    answer = metafab("expose", folder / "layout.oas", "--design", path, "--json")
    assert (answer.code, answer.stdout) == (2, "")
    assert named in answer.stderr


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
    assert transmitted[1] == pytest.approx(transmitted[0], rel=0.01)
    assert abs(transmitted[2] - transmitted[0]) > 0.02 * transmitted[0]
    refused = metafab("psf", "--ideal", "--design", path, "--printed", "plain")
    assert refused.code == 2
    assert "--printed" in refused.stderr
