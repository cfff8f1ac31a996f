"""Design, unit-cell and scene files (TOML) -> frozen, validated specs.

- ``fields``   checked number types and the base of specs whose fields must fit each other
- ``cell``     UnitCell: geometry, materials and illumination of one cell, and the sweep of a library
- ``device``   what is made and stands around it: lens, design rules, sensor, other optics
- ``design``   Design: all tables of a design file, and how they must fit each other
- ``terms``    phase terms of a design
- ``light``    Light: one of several wavelengths that a mask serves
- ``mask/``    Mask: formats, layers, bias, tone, chip, copies, test structures, exposure; Process
- ``scene/``   Scene: objects at depths or a picture with its depth, photons, noise
- ``substrate``  Substrate: birefringent plate before the pillars
- ``turned``   keys that turned pillars and full-Stokes imaging do not support
- ``construct``  unit cells and designs made in Python, without files
- ``new``      sample design file of each kind of device (``kinds/``, ``unit_cells/``)
- ``keys/``    all keys of the files with type, unit, default, range and meaning; faults in our words
- ``toml``     TOML -> spec, reporting all faults of a file; spec -> canonical TOML
- ``load``     unit-cell, scene, process and design files, with the files that they reference

In: paths. Out: frozen dataclasses whose public names carry their units. All report their faults at once by an
InputError: that of a spec that Python makes by itself, such as a Scene, is a SpecError, which is a ValueError, too.
"""

from metafab.spec.cell import Axes as Axes
from metafab.spec.cell import Illumination as Illumination
from metafab.spec.cell import Material as Material
from metafab.spec.cell import Solver as Solver
from metafab.spec.cell import Sweep as Sweep
from metafab.spec.cell import UnitCell
from metafab.spec.construct import make_design, make_unit_cell
from metafab.spec.design import Design
from metafab.spec.design import Numerics as Numerics
from metafab.spec.design import Verify as Verify
from metafab.spec.device import Device as Device
from metafab.spec.device import Optics as Optics
from metafab.spec.device import Rules as Rules
from metafab.spec.device import Sensor as Sensor
from metafab.spec.light import Light as Light
from metafab.spec.load import load_design, load_process, load_scene, load_unit_cell
from metafab.spec.mask import Chip as Chip
from metafab.spec.mask import Copy as Copy
from metafab.spec.mask import Dose as Dose
from metafab.spec.mask import Exposure as Exposure
from metafab.spec.mask import Mask as Mask
from metafab.spec.new import kinds, write_new
from metafab.spec.scene import Scene, SceneObject
from metafab.spec.substrate import Substrate as Substrate
from metafab.spec.terms import PhaseTerm as PhaseTerm
from metafab.spec.toml import canonical_toml as canonical_toml

__all__ = [
    "load_design",
    "make_design",
    "make_unit_cell",
    "write_new",
    "kinds",
    "Design",
    "UnitCell",
    "Scene",
    "SceneObject",
    "load_unit_cell",
    "load_scene",
    "load_process",
]
