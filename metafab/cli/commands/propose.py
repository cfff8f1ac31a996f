"""The choice of a helix, before there is a design file."""

from __future__ import annotations

from typing import Annotated

import typer

from metafab.cli.app import Json, Output, app, require_finite, require_positive
from metafab.cli.console import show
from metafab.core.errors import InputError


@app.command("propose")
def propose_command(
    depths_m: Annotated[tuple[float, float], typer.Option("--range-m", metavar="NEAR FAR", help="Range of depths.")],
    aperture_um: Annotated[float, typer.Option(metavar="D", help="Diameter of the lens.")],
    wavelength_nm: Annotated[float, typer.Option(help="Vacuum wavelength.")] = 800.0,
    electrons: Annotated[float, typer.Option(help="Mean of a pixel of lambda s'/(4 R).")] = 3000.0,
    read_noise_e: Annotated[float, typer.Option(min=0.0, help="Standard deviation of the read noise.")] = 2.0,
    background_e: Annotated[float, typer.Option(min=0.0, help="Mean of a pixel without the picture.")] = 0.0,
    contrast: Annotated[float, typer.Option(help="Of the texture, rms over mean.")] = 0.25,
    output: Output = None,
    json_: Json = False,
) -> None:
    """Zones and exponent of a rotating lobe for a range of depths and its noise."""
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
    found = phase.propose(
        *depths_m,
        aperture_um=aperture_um,
        wavelength_um=1e-3 * wavelength_nm,
        texture=Texture(electrons, contrast, background_e=background_e, read_noise_e=read_noise_e),
    )
    if output is not None:
        from metafab import report

        report.proposal_figure(found, output)
    best = found[0]
    others = [
        {
            "zones": p.zones,
            "exponent": p.exponent,
            "rotation_deg": p.rotation_deg,
            "relative_error": p.relative_error,
        }
        for p in found[1:]
    ]
    show({**vars(best), "relative_error": best.relative_error, "alternatives": others, "file": output}, json_)
