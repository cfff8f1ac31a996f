"""The built-in records: formulas with their coefficients here, tables in ``tables/*.csv``."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from importlib.resources import as_file, files

from metafab.materials.record import IndexRecord, biaxial, isotropic, read_table, sellmeier
from metafab.spec.substrate import OPTIC_AXIS_DEG

_R_PLANE_TILT_RAD = math.radians(OPTIC_AXIS_DEG["r-plane"])

_SILICA = "Malitson, J. Opt. Soc. Am. 55, 1205 (1965); fused silica, 20 C"
_SILICA_N = sellmeier([(0.6961663, 0.0684043), (0.4079426, 0.1162414), (0.8974794, 9.896161)])
_NITRIDE = "Luke et al., Opt. Lett. 40, 4823 (2015); silicon nitride film"
_NITRIDE_N = sellmeier([(3.0249, 0.1353406), (40314.0, 1239.842)])
_SAPPHIRE = "Malitson and Dodge, J. Opt. Soc. Am. 62, 1405 (1972), formula in Dodge (1986); synthetic sapphire, 20 C"
_SAPPHIRE_NM = (200.0, 5000.0)
_SAPPHIRE_O = sellmeier([(1.4313493, 0.0726631), (0.65054713, 0.1193242), (5.3414021, 18.028251)])
_SAPPHIRE_E = sellmeier([(1.5039759, 0.0740288), (0.55069141, 0.1216529), (6.5927379, 20.072248)])
_SILICON = "Salzberg and Villa, J. Opt. Soc. Am. 47, 244 (1957), formula by Tatian (1984); crystalline silicon, 26 C"
_SILICON_N = sellmeier([(10.6684293, 0.301516485), (0.0030434748, 1.13475115), (1.54133408, 1104.0)])
_RUTILE = "Devore, J. Opt. Soc. Am. 41, 416 (1951); rutile, room temperature"
_RUTILE_NM = (430.0, 1530.0)


def _rutile(constant: float, strength: float, pole_um2: float) -> Callable[[float], complex]:
    """n^2 = constant + strength / (lambda^2 - pole), lambda in um (Devore's form)."""
    return lambda wavelength_nm: complex(math.sqrt(constant + strength / ((wavelength_nm * 1e-3) ** 2 - pole_um2)))


def _r_plane(wavelength_nm: float) -> complex:
    """Index of light along the normal of the wafer, polarised along the projected optic axis.

    1/n^2 = cos^2(tilt)/n_o^2 + sin^2(tilt)/n_e^2 with the angle between ray and optic axis (Born and Wolf, 15.3).
    """
    cos, sin = math.cos(_R_PLANE_TILT_RAD), math.sin(_R_PLANE_TILT_RAD)
    return 1.0 / ((cos / _SAPPHIRE_O(wavelength_nm)) ** 2 + (sin / _SAPPHIRE_E(wavelength_nm)) ** 2) ** 0.5


def _sapphire(name: str, cut: str, x: Callable[[float], complex], y: Callable[[float], complex]) -> IndexRecord:
    return IndexRecord(f"Al2O3/{name}", f"{_SAPPHIRE}; {cut}", _SAPPHIRE_NM, biaxial(x, y))


def _formulas() -> list[IndexRecord]:
    o, e = _SAPPHIRE_O, _SAPPHIRE_E
    rutile_o, rutile_e = _rutile(5.913, 0.2441, 0.0803), _rutile(7.197, 0.3322, 0.0843)
    return [
        IndexRecord("SiO2/Malitson", _SILICA, (210.0, 3710.0), isotropic(_SILICA_N)),
        IndexRecord("Si3N4/Luke", _NITRIDE, (310.0, 5504.0), isotropic(_NITRIDE_N)),
        IndexRecord("Si/Salzberg", _SILICON, (1360.0, 11000.0), isotropic(_SILICON_N)),
        _sapphire("Malitson", "C-plane (both axes ordinary)", o, o),
        _sapphire("Malitson-e", "extraordinary index", e, e),
        _sapphire("Malitson-A-x", "A-plane, optic axis along x", e, o),
        _sapphire("Malitson-A-y", "A-plane, optic axis along y", o, e),
        _sapphire("Malitson-R-x", "R-plane, optic axis projected along x", _r_plane, o),
        _sapphire("Malitson-R-y", "R-plane, optic axis projected along y", o, _r_plane),
        IndexRecord("TiO2/Devore-o", f"{_RUTILE}; ordinary index", _RUTILE_NM, isotropic(rutile_o)),
        IndexRecord("TiO2/Devore-e", f"{_RUTILE}; extraordinary index", _RUTILE_NM, isotropic(rutile_e)),
    ]


@cache
def built_in() -> dict[str, IndexRecord]:
    """Return all built-in records, by name in alphabetical order."""
    built_in_records = _formulas()
    for entry in files("metafab.materials").joinpath("tables").iterdir():
        if entry.name.endswith(".csv"):
            with as_file(entry) as path:
                built_in_records.append(read_table(path, path.stem.replace("_", "/", 1)))
    return {record.name: record for record in sorted(built_in_records, key=lambda record: record.name)}
