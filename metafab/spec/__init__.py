"""Design, unit-cell and scene files (TOML) -> frozen, validated specs.

- ``fields``   checked number types and the ``spec`` decorator
- ``cell``     UnitCell: what one pillar's cell is made of, and the sweep of a library
- ``design``   Design: device, phase terms, rules, sensor, verification
- ``mask``     Mask: formats, layers, bias, tone, dose classes, chip, copies, exposure
- ``scene``    Scene: objects at depths, photons, noise
- ``new``      a first design file of each kind of device (``kinds/``)
- ``toml``     TOML -> any spec, with all faults at once; spec -> canonical TOML
- ``load``     the files that users write, with the files that they name

In: paths. Out: frozen dataclasses whose public names carry their units.
"""

from metafab.spec.cell import Axes, Illumination, Material, Solver, Sweep, UnitCell
from metafab.spec.design import Design, Device, Numerics, Optics, PhaseTerm, Rules, Sensor, Verify
from metafab.spec.load import load_design, load_scene, load_unit_cell
from metafab.spec.mask import Chip, Copy, Dose, Exposure, Mask
from metafab.spec.new import kinds, write_new
from metafab.spec.scene import Scene, SceneObject
from metafab.spec.toml import canonical_toml

__all__ = [
    "Axes",
    "Chip",
    "Copy",
    "Design",
    "Device",
    "Dose",
    "Exposure",
    "Illumination",
    "Mask",
    "Material",
    "Numerics",
    "Optics",
    "PhaseTerm",
    "Rules",
    "Scene",
    "SceneObject",
    "Sensor",
    "Solver",
    "Sweep",
    "UnitCell",
    "Verify",
    "canonical_toml",
    "kinds",
    "load_design",
    "load_scene",
    "load_unit_cell",
    "write_new",
]
