"""Commands ``propose`` and ``compare``: choice of a rotating lobe, and comparison with other cameras."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import typer

from metafab.cli.app import DesignFile, Json, app, open_job, require_finite, require_positive
from metafab.cli.console import announce, open_work, show
from metafab.cli.outputs import Output, OutputFolder
from metafab.core.errors import InputError


@dataclass(frozen=True)
class Alternative:
    """A further choice of zones and exponent."""

    zones: int  #: Number L of spiral zones.
    exponent: float  #: Exponent epsilon of the zones' radii.
    rotation_deg: float  #: Rotation of the main lobe over the range of depths.
    relative_error: float  #: Bound of the relative depth error, mean over the range.


@app.command("propose")
def propose_command(
    depths_m: Annotated[tuple[float, float], typer.Option("--range-m", metavar="NEAR FAR", help="Range of depths.")],
    aperture_um: Annotated[float, typer.Option(metavar="D", help="Diameter of the lens.")],
    wavelength_nm: Annotated[float, typer.Option(help="Vacuum wavelength.")] = 800.0,
    electrons: Annotated[float, typer.Option(help="Mean signal of a Nyquist pixel, lambda s'/(4 R).")] = 3000.0,
    read_noise_e: Annotated[float, typer.Option(min=0.0, help="Standard deviation of the read noise.")] = 2.0,
    background_e: Annotated[float, typer.Option(min=0.0, help="Mean background of a pixel.")] = 0.0,
    contrast: Annotated[float, typer.Option(help="Contrast of the texture, rms over mean.")] = 0.25,
    output: Output = None,
    json_: Json = False,
) -> None:
    """Propose zones and exponent of a rotating lobe for a range of depths and a noise level."""
    from metafab import phase
    from metafab.information import Texture

    require_positive("--range-m", *depths_m)
    require_positive("--aperture-um", aperture_um)
    require_positive("--wavelength-nm", wavelength_nm)
    require_positive("--electrons", electrons)
    require_positive("--contrast", contrast)
    require_finite("--read-noise-e", read_noise_e)
    require_finite("--background-e", background_e)
    if output is not None and output.suffix != ".png":
        raise InputError.single("propose", "output", "a name ending with .png", str(output))
    proposals = phase.propose(
        *depths_m,
        aperture_um=aperture_um,
        wavelength_um=1e-3 * wavelength_nm,
        texture=Texture(electrons=electrons, contrast=contrast, background_e=background_e, read_noise_e=read_noise_e),
    )
    if output is not None:
        from metafab import report

        report.proposal_figure(proposals, output)
    best, *others = proposals
    if best.relative_error > 1.0:
        least = f"the least error is {best.relative_error:.2g} times the depth"
        announce([f"{least}: such a lens cannot measure this range; is `--aperture-um` in micrometres?"])
    alternatives = [Alternative(p.zones, p.exponent, p.rotation_deg, p.relative_error) for p in others]
    show(best, json_, relative_error=best.relative_error, alternatives=alternatives, file=output)


@app.command("compare")
def compare_command(
    design: DesignFile,
    output: OutputFolder = None,
    planes: Annotated[int, typer.Option(min=1, max=1000, metavar="N", help="Photographs at each depth.")] = 6,
    contrast: Annotated[float, typer.Option(min=0.01, max=1.0, help="Contrast of the texture, rms over mean.")] = 0.25,
    json_: Json = False,
) -> None:
    """Compare depth and sharpness with a standard lens and a double helix of equal aperture and light.

    The result goes to the design's run folder unless ``-o`` names another; the next report shows it.
    """
    from metafab import comparison, report

    with open_work() as (work, cost):
        job = open_job(design, output, work)
        result = comparison.compare(job.design, planes=planes, contrast=contrast, progress=work.progress)
        job.folder.mkdir(parents=True, exist_ok=True)
        comparison.save_comparison(result, job.folder / "comparison.json")
        file = report.comparison_figure(result, job.folder / "comparison.png")
    show(comparison.comparison_figures(result), json_, seconds=cost.seconds, file=file)
