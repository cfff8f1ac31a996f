"""Design, unit-cell and scene files (TOML) -> frozen, validated specs.

- ``fields``   checked number types and the ``spec`` decorator
- ``cell``     UnitCell: geometry, materials and illumination of one cell, and the sweep of a library
- ``design``   Design: device, rules, sensor, verification
- ``terms``    phase terms of a design
- ``light``    Light: one of several wavelengths that a mask serves
- ``mask/``    Mask: formats, layers, bias, tone, chip, copies, test structures, exposure; Process
- ``scene``    Scene: objects at depths, photons, noise
- ``substrate``  Substrate: birefringent plate before the pillars
- ``turned``   keys that turned pillars and full-Stokes imaging do not support
- ``construct``  unit cells and designs made in Python, without files
- ``new``      sample design file of each kind of device (``kinds/``, ``unit_cells/``)
- ``keys/``    all keys of the files with type, unit, default, range and meaning; faults in our words
- ``toml``     TOML -> spec, reporting all faults of a file; spec -> canonical TOML
- ``load``     unit-cell, scene, process and design files, with the files that they reference

In: paths. Out: frozen dataclasses whose public names carry their units.
"""

from metafab.spec.cell import Axes, Illumination, Material, Solver, Sweep, UnitCell
from metafab.spec.construct import make_design, make_unit_cell
from metafab.spec.design import Design, Device, Numerics, Optics, Rules, Sensor, Verify
from metafab.spec.light import Light
from metafab.spec.load import load_design, load_process, load_scene, load_unit_cell
from metafab.spec.mask import Chip, Copy, Dose, Exposure, Mask
from metafab.spec.new import kinds, write_new
from metafab.spec.scene import Scene, SceneObject
from metafab.spec.substrate import Substrate
from metafab.spec.terms import PhaseTerm
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
    "Light",
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
    "Substrate",
    "Sweep",
    "UnitCell",
    "Verify",
    "canonical_toml",
    "kinds",
    "load_design",
    "load_process",
    "load_scene",
    "load_unit_cell",
    "make_design",
    "make_unit_cell",
    "write_new",
]
