"""The light that leaves a sample towards the camera: photon transport with absorption in the walk.

How much leaves where is from the engine, where it goes from a walk that is scored towards the camera (`peel_off`).

Not the dipole and not a white table, so that no fit is tested on its own model. Lengths in mm, coefficients in 1/mm.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.resources
import inspect
import json
import threading
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import platformdirs
from numpy.typing import NDArray
from scipy.interpolate import make_lsq_spline

from bssrdf.session.atomic import atomic_write

Array = NDArray[np.float64]

_BINS_PER_E_FOLD = 10
_REACH_MFP = (0.005, 2000.0)
"""Innermost and outermost edge of the radial bins above 0, in reduced mean free paths."""
_AZIMUTHS = 36
"""Bins of azimuth over half a turn."""
_HARMONICS = 12
_FAINT, _FEW = 1e-9, 1e-4
"""Share of the light below which an annulus is too faint to smooth, and to tell its harmonics, which are held there."""
_KNOTS = np.exp(np.arange(-5, 8, 0.4))
"""Of the smooth light [1/σt′]."""
_HARMONIC_KNOTS = np.exp([*np.arange(-5, 1.4, 0.8), 3.0, 5.0])
_VANISHES_BEYOND = (np.inf, np.inf, 10.0, 10.0, *(4.0,) * (_HARMONICS - 4))
"""Radii [1/σt′] from which on a harmonic is below 0.5 % of the light in any medium, and so only noise."""
_BATCHES = 32
_OF_CAMERA = 1
"""Key of the random streams of the walk that is scored towards the camera."""
_FAR_DECAYS = 20.0
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
    """(_HARMONICS, n − 1), by annulus; None where all azimuths are alike."""
    line_beyond: Array | None = None
    """(n,): the same as `beyond` of the line."""

    @property
    def total(self) -> float:
        """The radiance factor of the sample under even light."""
        return float(self.beyond[0] + (0.0 if self.line_beyond is None else self.line_beyond[0]))


def seen_light(medium: SampleMedium, view_angle_deg: float, *, photons: int, seed: int) -> SeenLight:
    """The light of a half space lit at normal incidence, seen under `view_angle_deg`.

    Taken from the light that ships with the package where it has this medium and angle (`make_light`), else walked
    with that many photons and kept in the user's cache. Only the reduced albedo shapes the light: walks are made in
    mean free paths 1/σt′, which media of one albedo share.
    """
    unit = unit_medium(medium)
    rows = _shipped().get(light_key(unit, view_angle_deg))
    if rows is None:
        rows = _cached(unit, view_angle_deg, photons, seed)
    return SeenLight(r_edges_mfp() / (medium.sigma_a + medium.sigma_sp), rows[0], rows[2:, :-1], rows[1])


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


def walked(unit: SampleMedium, view_angle_deg: float, photons: int, seed: int, n_threads: int | None = None) -> Array:
    """`SeenLight` of a medium whose σt′ is 1, from two walks: rows `beyond`, `line_beyond` and the harmonics.

    What is seen at each radius, over all azimuths, comes from `photons` of the engine; where it goes, from a quarter as
    many that are scored towards the camera.
    """
    from bssrdf.transport.exit_radiance import transmittance

    entering = float(transmittance(unit.eta, np.array(1.0)))
    even = _all_azimuths(unit, view_angle_deg, photons, seed, n_threads)
    around, line = _towards_camera(unit, view_angle_deg, -(-photons // 4), seed, n_threads)
    return _smooth_rows(entering * even, around, np.pi * entering * line)


def _all_azimuths(unit: SampleMedium, view_angle_deg: float, photons: int, seed: int, n_threads: int | None) -> Array:
    """∫ π L dA over each annulus per entering flux, of light scattered twice or more; none where it is fainter by
    e^−_FAR_DECAYS."""
    from bssrdf.transport.discrete_ordinates import decay_constant
    from bssrdf.transport.engine import MonteCarloMedium, simulate
    from bssrdf.transport.exit_radiance import angle_weights

    medium = MonteCarloMedium.reduced(unit.sigma_a, unit.sigma_sp, unit.g, unit.eta)
    far = _FAR_DECAYS / (decay_constant(medium.sigma_s / medium.sigma_t, unit.g) * medium.sigma_t)
    edges = r_edges_mfp()
    near = edges[edges < far]
    tally = simulate(medium, r_edges_mm=near, n_photons=photons, seed=seed, n_threads=n_threads)
    towards = angle_weights(unit.eta, float(np.cos(np.radians(view_angle_deg))))
    seen = np.zeros(edges.size - 1)
    seen[: near.size - 1] = tally.scores[:, 0, 2, :-1].mean(0) @ towards
    return seen


def _towards_camera(
    unit: SampleMedium, view_angle_deg: float, photons: int, seed: int, n_threads: int | None
) -> tuple[Array, Array]:
    """`around` and `line` of `peel_off`, per photon."""
    from bssrdf.rig.sim.peel_off import peel_off
    from bssrdf.transport.parallel import run_all
    from bssrdf.transport.photon import stream_states

    sigma_s = unit.sigma_sp / (1 - unit.g)
    sigma_t = sigma_s + unit.sigma_a
    cos_view = float(np.cos(np.radians(view_angle_deg)))
    edges = r_edges_mfp() * sigma_t
    n_r = edges.size - 1
    bins_per_e_fold = (n_r - 1) / np.log(edges[-1] / edges[1])

    def batch(state: Any) -> tuple[Array, Array]:
        around, line = np.zeros((n_r, _AZIMUTHS)), np.zeros(n_r)
        each = -(-photons // _BATCHES)
        peel_off(each, state, sigma_s / sigma_t, unit.g, unit.eta, cos_view, edges[1], bins_per_e_fold, around, line)
        return around / each, line / each

    states = stream_states(seed, _BATCHES, _OF_CAMERA)
    done, _ = run_all([functools.partial(batch, state) for state in states], threading.Event(), n_threads, None)
    around, line = (np.mean([part[kind] for part in done], axis=0) for kind in range(2))
    return around, line


def _smooth_rows(even: Array, around: Array, line: Array) -> Array:
    """The rows of `walked` with less of the photons' noise; the sum of `even` stays."""
    lit = even > _FAINT * even.sum()
    smooth = np.zeros_like(even)
    smooth[lit] = np.exp(_smooth(np.log(even[lit]), even[lit], lit, _KNOTS))
    smooth *= even.sum() / smooth.sum()
    return np.stack([beyond_of(smooth), beyond_of(line), *_harmonics_of(around)])


def _harmonics_of(around: Array) -> Array:
    """Smooth harmonics of each annulus, the last one repeated, (_HARMONICS, n_r + 1)."""
    light = around.sum(1)
    counted = light > _FEW * light.sum()
    order = np.arange(1, _HARMONICS + 1)
    width = np.pi / _AZIMUTHS
    middle = (np.arange(_AZIMUTHS) + 0.5) * width
    weights = 2 * np.cos(middle[:, None] * order) / np.sinc(order * width / 2 / np.pi)
    weights[:, -1] /= 2  # the series goes on: half its last term is nearer to the sum than all of it or none
    ratios = (around[counted] @ weights) / light[counted, None]
    r = _middles()
    last = int(np.flatnonzero(counted)[-1])
    harmonics = np.zeros((_HARMONICS, light.size + 1))
    for k, ratio in enumerate(ratios.T):
        harmonics[k, :-1][counted] = _smooth(ratio, light[counted], counted, _HARMONIC_KNOTS)
        harmonics[k, last + 1 :] = harmonics[k, last]
        harmonics[k, :-1][r > _VANISHES_BEYOND[k]] = 0
    return harmonics


def _smooth(values: Array, light: Array, counted: NDArray[np.bool_], knots_mfp: Array) -> Array:
    """A value of the annuli `counted`, as a cubic spline in ln r, each weighed by its light."""
    log_r = np.log(_middles())[counted]
    inner = np.log(knots_mfp)
    inner = inner[(inner > log_r[3]) & (inner < log_r[-4])]
    knots = np.concatenate([[log_r[0]] * 4, inner, [log_r[-1]] * 4])
    return np.asarray(make_lsq_spline(log_r, values, knots, w=np.sqrt(light))(log_r))


def _middles() -> Array:
    """Radii [1/σt′] that stand for the annuli."""
    edges = r_edges_mfp()
    return np.sqrt(np.maximum(edges[1:] * edges[:-1], edges[1:] ** 2 / 4))


def beyond_of(annulus: Array) -> Array:
    """Light farther out than each edge, from that of each annulus."""
    return np.concatenate([np.cumsum(annulus[::-1])[::-1], [0.0]])


@functools.cache
def _shipped() -> dict[str, Array]:
    with importlib.resources.files(__package__).joinpath(SHIPPED).open("rb") as file:
        content = np.load(file, allow_pickle=False)
        return dict(zip(content["keys"].tolist(), content["rows"].astype(float), strict=True))


def _cached(unit: SampleMedium, view_angle_deg: float, photons: int, seed: int) -> Array:
    from bssrdf.rig.sim import light, peel_off
    from bssrdf.transport import photon, walk

    code = "".join(inspect.getsource(module) for module in (light, peel_off, photon, walk))
    key = json.dumps([asdict(unit), view_angle_deg, photons, seed, code])
    file = platformdirs.user_cache_path("bssrdf") / "light" / f"{hashlib.sha256(key.encode()).hexdigest()[:32]}.npy"
    if not file.is_file():
        file.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(file) as part, part.open("wb") as stream:
            np.save(stream, walked(unit, view_angle_deg, photons, seed), allow_pickle=False)
    return np.asarray(np.load(file, allow_pickle=False))
