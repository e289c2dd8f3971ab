"""The light that leaves a sample under the camera's angle: photon transport with absorption in the walk.

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
from scipy.interpolate import make_lsq_spline

from bssrdf.session.atomic import atomic_write

Array = NDArray[np.float64]

_BINS_PER_E_FOLD = 10
_REACH_MFP = (0.005, 2000.0)
"""Innermost and outermost edge of the radial bins above 0, in reduced mean free paths."""
_FAINT = 1e-6
"""Share of the light below which an annulus is too faint to smooth."""
_BINS_A_KNOT = 4
"""Bins between the knots of the smooth light; between those of its angular factor, twice that."""
_HALF_WINDOW = 0.1
"""Light that leaves within this of the camera's cos² counts as seen by it: ±6° at 45°, a bias below 0.1 %."""
SHIPPED = "light.npz"
"""File beside this one."""


@dataclass(frozen=True)
class SampleMedium:
    """One channel of a sample."""

    sigma_a: float
    sigma_sp: float
    eta: float
    g: float = 0.0


@dataclass(frozen=True)
class Sample:
    """What can lie under the beam: a half space, by its coefficients in each channel."""

    name: str
    media: dict[str, SampleMedium]


@dataclass(frozen=True)
class RadialLight:
    """Exiting light by distance from a thin beam, as π L/Φ: L the radiance at one exit angle, Φ the incident flux."""

    r_edges_mm: Array
    """(n,), ascending from 0."""
    beyond: Array
    """(n,): ∫ π L/Φ dA over everything farther out than each edge."""

    @property
    def total(self) -> float:
        """The radiance factor of the sample under even light."""
        return float(self.beyond[0])


def radial_light(medium: SampleMedium, view_angle_deg: float, *, photons: int, seed: int) -> RadialLight:
    """The light of a half space lit at normal incidence, seen under `view_angle_deg`.

    Taken from the light that ships with the package where it has this medium and angle (`make_light`), else walked
    with that many photons and kept in the user's cache. Only the reduced albedo shapes the light: walks are made in
    mean free paths 1/σt′, which media of one albedo share.
    """
    unit = unit_medium(medium)
    beyond = _shipped().get(light_key(unit, view_angle_deg))
    if beyond is None:
        beyond = _cached(unit, view_angle_deg, photons, seed)
    return RadialLight(r_edges_mfp() / (medium.sigma_a + medium.sigma_sp), beyond)


def unit_medium(medium: SampleMedium) -> SampleMedium:
    """The medium of the same albedo whose σt′ is 1."""
    loss = float(f"{medium.sigma_a / (medium.sigma_a + medium.sigma_sp):.9g}")
    return SampleMedium(loss, 1 - loss, medium.eta, medium.g)


def light_key(unit: SampleMedium, view_angle_deg: float) -> str:
    """Name of a walk in the shipped file."""
    return f"{unit.sigma_a:.9g},{unit.eta:g},{unit.g:g},{view_angle_deg:g}"


def r_edges_mfp() -> Array:
    """Edges of the radial bins in mean free paths 1/σt′, from 0."""
    lo, hi = np.log(_REACH_MFP)
    return np.concatenate([[0.0], np.exp(np.linspace(lo, hi, round(_BINS_PER_E_FOLD * (hi - lo))))])


def walked(unit: SampleMedium, view_angle_deg: float, photons: int, seed: int) -> Array:
    """`RadialLight.beyond` for a medium whose σt′ is 1, from the walk itself."""
    from bssrdf.transport.engine import MonteCarloMedium, simulate
    from bssrdf.transport.exit_radiance import transmittance

    medium = MonteCarloMedium.reduced(unit.sigma_a, unit.sigma_sp, unit.g, unit.eta)
    tally = simulate(medium, r_edges_mm=r_edges_mfp(), n_photons=photons, seed=seed)
    entering = float(transmittance(unit.eta, np.array(1.0)))
    by_direction = tally.scores[:, 0].sum(1).mean(0)[:-1]
    light = by_direction.sum(1)
    counted = light > _FAINT * light.sum()
    seen = by_direction @ _window(view_angle_deg, by_direction.shape[1])
    log_light = _smooth(np.log(light[counted]), light[counted], counted, _BINS_A_KNOT)
    factor = _smooth(seen[counted] / light[counted], light[counted], counted, 2 * _BINS_A_KNOT)
    light[counted] = np.exp(log_light) * factor
    total = entering * tally.total_radiance(view_angle_deg)[0]
    return beyond_of(light * total / light.sum())


def _window(view_angle_deg: float, n_bins: int) -> Array:
    """Weights of the bins of exit direction, even in cos², whose sum is the radiance factor within ±0.1 of cos²."""
    edges = np.linspace(0.0, 1.0, n_bins + 1)
    centre = np.cos(np.radians(view_angle_deg)) ** 2
    low, high = max(centre - _HALF_WINDOW, 0.0), min(centre + _HALF_WINDOW, 1.0)
    inside = np.clip(np.minimum(edges[1:], high) - np.maximum(edges[:-1], low), 0.0, None)
    return inside * n_bins / (high - low)


def _smooth(values: Array, light: Array, counted: NDArray[np.bool_], bins_a_knot: int) -> Array:
    """A value of the annuli `counted` with less of the photons' noise: a cubic spline in ln r, as light weighs it."""
    edges = r_edges_mfp()
    log_r = np.log(np.sqrt(np.maximum(edges[1:] * edges[:-1], edges[1:] ** 2 / 4)))[counted]
    knots = np.concatenate([[log_r[0]] * 4, log_r[bins_a_knot:-bins_a_knot:bins_a_knot], [log_r[-1]] * 4])
    return np.asarray(make_lsq_spline(log_r, values, knots, w=np.sqrt(light))(log_r))


def beyond_of(annulus: Array) -> Array:
    """Light farther out than each edge, from that of each annulus."""
    return np.concatenate([np.cumsum(annulus[::-1])[::-1], [0.0]])


@functools.cache
def _shipped() -> dict[str, Array]:
    with importlib.resources.files(__package__).joinpath(SHIPPED).open("rb") as file:
        content = np.load(file, allow_pickle=False)
        return dict(zip(content["keys"].tolist(), content["beyond"].astype(float), strict=True))


def _cached(unit: SampleMedium, view_angle_deg: float, photons: int, seed: int) -> Array:
    from bssrdf.transport import engine, exit_radiance, photon, walk

    code = "".join(inspect.getsource(module) for module in (engine, exit_radiance, photon, walk))
    key = json.dumps([asdict(unit), view_angle_deg, photons, seed, _BINS_PER_E_FOLD, _REACH_MFP, code])
    file = platformdirs.user_cache_path("bssrdf") / "light" / f"{hashlib.sha256(key.encode()).hexdigest()[:32]}.npy"
    if not file.is_file():
        file.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(file) as part, part.open("wb") as stream:
            np.save(stream, walked(unit, view_angle_deg, photons, seed), allow_pickle=False)
    return np.asarray(np.load(file, allow_pickle=False))
