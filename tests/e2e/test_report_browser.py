"""The page in a real browser: its live views answer, nothing is logged as an error, nothing sticks out at 390 px."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from html import unescape
from pathlib import Path
from typing import Any

import pytest

from metafab.core.parallel.progress import silent
from metafab.library.library import Library
from metafab.report.draw import draw
from metafab.report.write import compose
from tests.closed_form_run import closed_form_run

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine: the page is not tried live")

#: Runs inside the page after its own script: acts as a reader does and writes down what the page answers.
PROBE = """
<script>
window.faults = [];
window.addEventListener("error", (event) => window.faults.push(event.message));
window.addEventListener("unhandledrejection", (event) => window.faults.push(String(event.reason)));
console.error = (...words) => window.faults.push(words.join(" "));
// Virtual time does not wait for the frames of a busy machine, but it waits for timers.
window.requestAnimationFrame = (draw) => setTimeout(() => draw(performance.now()), 16);
window.addEventListener("load", () => setTimeout(async () => {
  const found = {};
  const psf = document.getElementById("psf-viewer");
  const image = document.getElementById("image-viewer");
  while (psf.hidden || image.hidden) await new Promise((done) => setTimeout(done, 10));
  const slider = psf.querySelector("input");
  const lit = () => [...psf.querySelectorAll("canvas")].map((canvas) => {
    const { data, width, height } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    let best = -1, place = 0;
    for (let i = 0; i < data.length; i += 4) {
      const warm = data[i] - 0.4 * data[i + 2];  // the arrow is green, the crosshair grey
      if (data[i] > 200 && warm > best) { best = warm; place = i / 4; }
    }
    return [(place % width) / width - 0.5, 0.5 - Math.floor(place / width) / height];
  });
  found.depths = Number(slider.max) + 1;
  found.first = { text: psf.querySelector(".readout").textContent, depth: psf.querySelector(".depth").textContent,
                  lit: lit() };
  slider.value = slider.max;
  slider.dispatchEvent(new Event("input"));
  found.last = { text: psf.querySelector(".readout").textContent, depth: psf.querySelector(".depth").textContent,
                 lit: lit() };
  psf.querySelectorAll(".choice button")[1].click();
  found.ideal = psf.querySelector(".readout").textContent;
  const canvases = image.querySelectorAll("canvas");
  const box = canvases[3].getBoundingClientRect();
  // Pixel (45, 34) of 64 x 48 lies in the farther segment; rows count upwards.
  const at = { clientX: box.left + 45.5 / 64 * box.width, clientY: box.top + (48 - 34.5) / 48 * box.height };
  canvases[3].dispatchEvent(new PointerEvent("pointermove", at));
  found.pointed = image.querySelector(".readout").textContent;
  canvases[0].dispatchEvent(new PointerEvent("pointerdown", { ...at, clientY: box.bottom - 1, pointerType: "touch" }));
  found.touched = image.querySelector(".readout").textContent;
  canvases[0].dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowUp" }));
  found.keyed = image.querySelector(".readout").textContent;
  const relief = image.querySelector(".relief canvas");
  const shape = () => {
    const { data, width } = relief.getContext("2d").getImageData(0, 0, relief.width, relief.height);
    let lit = 0, sum = 0;
    for (let i = 3; i < data.length; i += 4) if (data[i]) { lit += 1; sum += ((i - 3) / 4 % width) / width; }
    return [lit / (data.length / 4), sum / lit];
  };
  found.relief = [shape()];
  relief.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight" }));
  await new Promise((done) => setTimeout(done, 50));
  found.relief.push(shape());
  const light = (colour) => colour.match(/[\\d.]+/g).slice(0, 3).map((part) => part / 255)
    .map((part) => part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4)
    .reduce((sum, part, i) => sum + part * [0.2126, 0.7152, 0.0722][i], 0);
  const paper = light(getComputedStyle(document.body).backgroundColor);
  found.paper = paper;
  const texts = document.querySelectorAll("svg.plot text, p, td, th, h1, h2, h3, li, summary, figcaption");
  found.faint = [...texts].filter((text) => {
    const colour = getComputedStyle(text)[text.tagName === "text" ? "fill" : "color"];
    if (colour === "rgb(255, 255, 255)") return false;  // stands on a dark picture
    const [low, high] = [light(colour), paper].sort((a, b) => a - b);
    return (high + 0.05) / (low + 0.05) < 3;
  }).map((text) => text.textContent);
  found.sticks_out = document.documentElement.scrollWidth - document.documentElement.clientWidth;
  found.width = innerWidth;
  found.faults = window.faults;
  document.body.dataset.found = JSON.stringify(found);
  parent.postMessage(document.body.dataset.found, "*");
}, 1500));
</script>
"""

#: Browsers have a least window width; a frame does not.
FRAME = """<!doctype html>
<body style="margin:0">
<iframe src="page.html" style="border:0;width:WIDTHpx;height:900px"></iframe>
<script>addEventListener("message", (event) => { document.body.dataset.found = event.data; });</script>
</body>
"""


@pytest.fixture(scope="module")
def live_page(tmp_path_factory: pytest.TempPathFactory, smooth_library: Library) -> str:
    """The page of a run in which nothing is missing."""
    run = closed_form_run(tmp_path_factory.mktemp("run"), smooth_library)
    return compose(run, draw(run, silent))


def _browse(page: str, folder: Path, width: int, *, dark: bool) -> dict[str, Any]:
    (folder / "page.html").write_text(page.replace("<body>", "<body>" + PROBE, 1), encoding="utf-8")
    frame = folder / "frame.html"
    frame.write_text(FRAME.replace("WIDTH", str(width)), encoding="utf-8")
    assert CHROMIUM is not None
    command = [
        CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
        "--disable-background-networking", "--disable-component-update", "--disable-sync",
        "--allow-file-access-from-files", f"--user-data-dir={folder / 'profile'}", "--window-size=1400,1000",
        "--virtual-time-budget=20000", "--dump-dom", frame.as_uri(),
    ]  # fmt: skip
    if dark:
        command.insert(-2, "--blink-settings=preferredColorScheme=0")
    environment = {**os.environ, "HOME": str(folder)}
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, env=environment)
    match = re.search(r'data-found="([^"]*)"', done.stdout)
    assert match is not None, done.stderr[-2000:]
    found: dict[str, Any] = json.loads(unescape(match[1]))
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("width", "dark"), [(1280, False), (390, True)], ids=["wide and light", "narrow and dark"])
def test_live_views_answer(live_page: str, tmp_path: Path, width: int, dark: bool) -> None:
    found = _browse(live_page, tmp_path, width, dark=dark)
    assert (found["paper"] < 0.05) == dark
    assert found["faint"] == [], "large text and figures need a contrast of 3 (WCAG 1.4.11)"
    assert found["faults"] == []
    assert found["width"] == width
    assert found["sticks_out"] <= 0
    assert found["depths"] == 9
    # The closed-form pair: 40 degrees at 25 cm, 200 (= -160) at 35 cm; the file keeps 60 %, the phases 90 %.
    assert found["first"]["depth"] == "25 cm"
    assert "40°" in found["first"]["text"]
    assert found["last"]["depth"] == "35 cm"
    assert "−160°" in found["last"]["text"]
    assert "x 60 %" in found["first"]["text"]
    assert "x 90 %" in found["ideal"]
    (x, y), (mirror_x, mirror_y) = found["first"]["lit"]
    assert x > 0.1 and y > 0.1, "the x lobe stands up and to the right of its image point at 40 degrees"
    assert mirror_x < -0.1 and mirror_y < -0.1, "the y lobe stands opposite"
    assert found["last"]["lit"][0][0] < -0.1
    assert "depth 32.91 cm" in found["pointed"]
    assert "contrast 2.5" in found["pointed"]
    assert "confidence 0.9" in found["pointed"]
    assert "no depth claimed" in found["touched"]
    assert found["keyed"] != found["touched"]
    (lit, _), (turned, _) = found["relief"]
    assert 0.05 < lit < 0.9
    assert found["relief"][0] != found["relief"][1], "an arrow key turns the relief"
    assert turned > 0.05
