"""A design beside other cameras."""

from __future__ import annotations

from typing import Annotated

import typer

from metafab.cli.app import DesignFile, Json, Output, app, open_job
from metafab.cli.console import progress_bars, show


@app.command("compare")
def compare_command(
    design: DesignFile,
    output: Output = None,
    planes: Annotated[int, typer.Option(min=1, max=1000, metavar="N", help="Photographs at each depth.")] = 6,
    contrast: Annotated[float, typer.Option(min=0.01, max=1.0, help="Of the texture, rms over mean.")] = 0.25,
    json_: Json = False,
) -> None:
    """Depth and sharpness over depth beside a standard lens and a double helix of equal aperture and light.

    In the design's run folder, where ``-o`` does not say otherwise, the next report shows it.
    """
    from metafab import comparison, report
    from metafab.core.parallel.measure import measured

    with progress_bars() as progress, measured() as cost:
        job = open_job(design, output, None, None, progress)
        found = comparison.compare(job.design, planes=planes, contrast=contrast, progress=progress)
        job.folder.mkdir(parents=True, exist_ok=True)
        comparison.save_comparison(found, job.folder / "comparison.json")
        file = report.comparison_figure(found, job.folder / "comparison.png")
    show({**vars(comparison.comparison_figures(found)), "seconds": cost.seconds, "file": file}, json_)
