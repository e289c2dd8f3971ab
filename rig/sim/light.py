"""The light that leaves a sample towards the camera: photon transport with absorption in the walk.

Not the dipole and not a white table, so that no fit is tested on its own model. Lengths in mm, coefficients in 1/mm.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.resources
import inspect
import json
from dataclasses import asdict, dataclass

import numpy as np
import platformdirs
from numpy.typing import NDArray

from bssrdf.rig.sim.media import SampleMedium, r_edges_mfp, unit_medium
from bssrdf.session import atomic_write

Array = NDArray[np.float64]

SHIPPED = "light.npz"
"""File beside this one."""


@dataclass(frozen=True)
class SeenLight:
    """Exiting light by place, as π L/Φ: L the radiance towards the camera, Φ the flux of a thin incident beam.

    Light scattered more than once fills the surface. It runs outwards, so that it is brighter where that is towards the
    camera: π L ∝ 1 + Σ harmonics[k] cos((k + 1) φ), φ the azimuth from there. Light scattered once leaves in its plane:
    seen from an angle it is a line from the beam towards the camera.
    """

    r_edges_mm: Array
    """(n,), ascending from 0."""
    beyond: Array
    """(n,): ∫ π L/Φ dA of what fills the surface, over everything farther out than each edge."""
    harmonics: Array | None = None
    """(orders, n − 1), by annulus; None where all azimuths are alike."""
    line_beyond: Array | None = None
    """(n,): the same as `beyond` of the line."""

    @property
    def total(self) -> float:
        """The radiance factor of the sample under even light."""
        return float(self.beyond[0] + (0.0 if self.line_beyond is None else self.line_beyond[0]))


def seen_light(
    medium: SampleMedium,
    view_angle_deg: float,
    *,
    photons: int,
    seed: int,
    anew: bool = False,
    incidence_deg: float = 0.0,
) -> SeenLight:
    """The light of a half space or a slab seen under `view_angle_deg`, of a beam that runs towards the camera's side.

    Taken from the light that ships with the package where it has this medium and angle (`make_light`), else walked
    with that many photons and kept in the user's cache. Walks are made in mean free paths 1/σt′: only the reduced
    albedo shapes the light, and a slab's depth in these and its back. `anew` walks where the light ships, too: by
    seed then.
    """
    unit = unit_medium(medium)
    rows = None if anew or incidence_deg else _shipped().get(light_key(unit, view_angle_deg))
    if rows is None:
        rows = _cached(unit, view_angle_deg, photons, seed, incidence_deg)
    return SeenLight(r_edges_mfp() / (medium.sigma_a + medium.sigma_sp), rows[0], rows[2:, :-1], rows[1])


def light_key(unit: SampleMedium, view_angle_deg: float) -> str:
    """Name of a walk in the shipped file."""
    slab = "" if unit.thickness_mm is None else f",{unit.thickness_mm:.9g},{unit.back:g}"
    return f"{unit.sigma_a:.9g},{unit.eta:g},{unit.g:g},{view_angle_deg:g}{slab}"


@functools.cache
def _shipped() -> dict[str, Array]:
    with importlib.resources.files(__package__).joinpath(SHIPPED).open("rb") as file:
        content = np.load(file, allow_pickle=False)
        return dict(zip(content["keys"].tolist(), content["rows"].astype(float), strict=True))


def _cached(unit: SampleMedium, view_angle_deg: float, photons: int, seed: int, incidence_deg: float) -> Array:
    from bssrdf.rig.sim import peel_off, walked_light

    walks = (importlib.resources.files("bssrdf.transport") / name for name in ("photon.py", "walk.py"))
    code = "".join([*map(inspect.getsource, (walked_light, peel_off)), *(walk.read_text("utf-8") for walk in walks)])
    key = json.dumps([asdict(unit), view_angle_deg, photons, seed, incidence_deg, code])
    file = platformdirs.user_cache_path("bssrdf") / "light" / f"{hashlib.sha256(key.encode()).hexdigest()[:32]}.npy"
    if not file.is_file():
        file.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(file) as part, part.open("wb") as stream:
            rows = walked_light.walked(unit, view_angle_deg, photons, seed, incidence_deg=incidence_deg)
            np.save(stream, rows, allow_pickle=False)
    return np.asarray(np.load(file, allow_pickle=False))
