"""The walks behind the light of `light`: where light that leaves a medium is seen from, photon by photon."""

from __future__ import annotations

import functools
import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_lsq_spline
from scipy.ndimage import median_filter

from bssrdf.rig.sim.media import SampleMedium, r_edges_mfp
from bssrdf.rig.sim.peel_off import PeeledMedium, peel_off
from bssrdf.transport import MonteCarloMedium, run_all, simulate
from bssrdf.transport.exit_radiance import angle_weights, transmittance
from bssrdf.transport.photon import stream_states

Array = NDArray[np.float64]

_AZIMUTHS = 36
"""Bins of azimuth over half a turn."""
_HARMONICS = 12
_FAINT, _FEW = 1e-9, 1e-4
"""Share of the light below which an annulus is too faint to smooth, and to tell its harmonics, which are held there."""
_SURELY_LIT = 2.0
"""Radius [1/σt′] within which an annulus is faint because it is small."""
_KNOTS = np.exp([*np.arange(-5, 1, 0.4), *np.arange(1.2, 8, 0.8)])
"""Of the smooth light [1/σt′]."""
_HARMONIC_KNOTS = np.exp([*np.arange(-5, 3.2, 0.8), 4.5])
_VANISHES_BEYOND = (np.inf, np.inf, 10.0, 10.0, *(4.0,) * (_HARMONICS - 4))
"""Radii [1/σt′] from which on a harmonic is below 0.5 % of the light in any medium, and so only noise."""
_TOLD_TO = 14.0
"""Radius [1/σt′] up to which the walk tells the second harmonic, even that of bright media, to 0.3 % of the light."""
_BATCHES = 32
_OF_CAMERA = 1
"""Key of the random streams of the walk that is scored towards the camera."""
_FAR_DECAYS = 20.0


def walked(
    unit: SampleMedium,
    view_angle_deg: float,
    photons: int,
    seed: int,
    n_threads: int | None = None,
    incidence_deg: float = 0.0,
) -> Array:
    """`SeenLight` of a medium whose σt′ is 1: rows `beyond`, `line_beyond` and the harmonics.

    From two walks of `photons` each. The engine's follows light far out; the other scores every collision towards the
    camera, and is the better one near the beam and in dark media. What is seen at a radius is their mean, weighed by
    their errors; where it goes is from the second. Of a beam at an angle the second tells all: the engine's is a mean
    over the directions of exit.
    """
    around, line = _towards_camera(unit, view_angle_deg, photons, seed, n_threads, incidence_deg)
    walks = [np.pi * around.sum(2)]
    if incidence_deg == 0:
        walks.append(_by_engine(unit, view_angle_deg, photons, seed, n_threads))
    return _rows(unit, _combined(*walks), around.mean(0), line.mean(0), incidence_deg)


def walked_in_lanes(unit: SampleMedium, view_angle_deg: float, photons: int, seed: int) -> Array:
    """The same by the second walk alone, by JAX: for so many photons that it tells all there is, on a GPU."""
    from bssrdf.rig.sim.peel_off_lanes import peel_off_lanes

    medium, edges, bins_per_e_fold = _as_peeled(unit, view_angle_deg)
    around, line = peel_off_lanes(
        medium, edges[1], bins_per_e_fold, (edges.size - 1, _AZIMUTHS), photons=photons, seed=seed
    )
    return rows_of_lanes(unit, around.mean(0), np.pi * around.sum(2), line.mean(0))


def rows_of_lanes(unit: SampleMedium, around: Array, rings: Array, line: Array) -> Array:
    """`SeenLight` of a mean walk, π times whose light by ring and batch are `rings`."""
    return _rows(unit, _mean_and_error(rings), around, line)


def _rows(
    unit: SampleMedium, rings: tuple[Array, Array], around: Array, line: Array, incidence_deg: float = 0.0
) -> Array:
    entering = float(transmittance(unit.eta, np.array(np.cos(np.radians(incidence_deg)))))
    even, apart = entering * _smooth(unit, *rings), np.pi * entering * line
    return np.stack([beyond_of(even), beyond_of(apart), *_harmonics_of(unit, around)])


def _by_engine(unit: SampleMedium, view_angle_deg: float, photons: int, seed: int, n_threads: int | None) -> Array:
    """∫ π L dA over each annulus per entering flux, of light scattered twice or more, by batch: (batches, annuli).

    Not followed to where it is fainter by e^−_FAR_DECAYS.
    """
    edges = r_edges_mfp()
    near = edges[edges < _FAR_DECAYS / _kappa(unit)]
    tally = simulate(
        _medium(unit), r_edges_mm=near, n_photons=photons, seed=seed, n_batches=_BATCHES, n_threads=n_threads
    )
    towards = angle_weights(unit.eta, float(np.cos(np.radians(view_angle_deg))))
    seen = np.zeros((_BATCHES, edges.size - 1))
    seen[:, : near.size - 1] = tally.scores[:, 0, 2, :-1] @ towards
    return seen


def _towards_camera(
    unit: SampleMedium, view_angle_deg: float, photons: int, seed: int, n_threads: int | None, incidence_deg: float
) -> tuple[Array, Array]:
    """`around` and `line` of `peel_off` per photon, by batch."""
    medium, edges, bins_per_e_fold = _as_peeled(unit, view_angle_deg, incidence_deg)
    n_r = edges.size - 1

    def batch(state: Any) -> tuple[Array, Array]:
        around, line = np.zeros((n_r, _AZIMUTHS)), np.zeros(n_r)
        each = -(-photons // _BATCHES)
        peel_off(each, state, *medium, edges[1], bins_per_e_fold, around, line)
        return around / each, line / each

    states = stream_states(seed, _BATCHES, _OF_CAMERA)
    done, _ = run_all([functools.partial(batch, state) for state in states], threading.Event(), n_threads, None)
    around, line = (np.stack([part[kind] for part in done]) for kind in range(2))
    return around, line


def _as_peeled(
    unit: SampleMedium, view_angle_deg: float, incidence_deg: float = 0.0
) -> tuple[PeeledMedium, Array, float]:
    """Medium, edges of the rings and rings per e-fold as `peel_off` takes them, in 1/σt."""
    sigma_s = unit.sigma_sp / (1 - unit.g)
    sigma_t = sigma_s + unit.sigma_a
    edges = r_edges_mfp() * sigma_t
    depth = np.inf if unit.thickness_mm is None else unit.thickness_mm * sigma_t
    cos_view, sin_beam = float(np.cos(np.radians(view_angle_deg))), float(np.sin(np.radians(incidence_deg)))
    medium = PeeledMedium(sigma_s / sigma_t, unit.g, unit.eta, cos_view, sin_beam, depth, unit.back)
    return medium, edges, float((edges.size - 2) / np.log(edges[-1] / edges[1]))


def _combined(*walks: Array) -> tuple[Array, Array]:
    """Mean of the walks in each annulus by inverse variance, and its error; as a whole, scaled to their mean total."""
    means, errors = zip(*(_mean_and_error(walk) for walk in walks), strict=True)
    totals, total_errors = zip(*(_mean_and_error(walk.sum(1, keepdims=True)) for walk in walks), strict=True)
    mean, error = _weighed(np.stack(means), np.stack([_typical(each) for each in errors]))
    total, _ = _weighed(np.stack(totals), np.stack(total_errors))
    scale = total / mean.sum()
    return mean * scale, error * scale


def _mean_and_error(batches: Array) -> tuple[Array, Array]:
    return batches.mean(0), batches.std(0, ddof=1) / np.sqrt(len(batches))


def _typical(error: Array) -> Array:
    """Errors smoothed over neighbouring annuli: one that is small by chance should not decide; infinite where unlit."""
    around = np.exp(median_filter(np.log(np.maximum(error, 1e-300)), 9))
    return np.where(error > 0, np.maximum(error, around), np.inf)


def _weighed(values: Array, errors: Array) -> tuple[Array, Array]:
    weight = 1 / errors**2
    total = weight.sum(0)
    lit = total > 0
    mean = np.divide((weight * values).sum(0), total, out=np.zeros_like(total), where=lit)
    return mean, np.divide(1, np.sqrt(total), out=np.zeros_like(total), where=lit)


def _smooth(unit: SampleMedium, light: Array, error: Array) -> Array:
    """The light of the annuli with less of the photons' noise, its sum kept; smooth is its ratio to diffusing light."""
    r = _middles()
    lit = light > np.maximum(_FAINT * light.sum(), 2 * error)
    faint = np.flatnonzero(~lit & (r > _SURELY_LIT))
    lit[faint[0] if faint.size else lit.size :] = False
    decay = np.log1p(_kappa(unit) * r) - _kappa(unit) * r
    smooth = np.zeros_like(light)
    ratio = _spline(r[lit], np.log(light[lit]) - decay[lit], light[lit] / error[lit], _KNOTS)
    smooth[lit] = np.exp(ratio + decay[lit])
    return smooth * light.sum() / smooth.sum()


def _kappa(unit: SampleMedium) -> float:
    """Decay constant of light far out, in 1/mfp′."""
    return _medium(unit).decay_constant(np.inf)


def _medium(unit: SampleMedium) -> MonteCarloMedium:
    sigma_s = unit.sigma_sp / (1 - unit.g)
    return MonteCarloMedium(unit.sigma_a, sigma_s, unit.g, unit.eta, unit.thickness_mm, unit.back)


def _harmonics_of(unit: SampleMedium, around: Array) -> Array:
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
        harmonics[k, :-1][counted] = _spline(r[counted], ratio, np.sqrt(light[counted]), _HARMONIC_KNOTS)
        harmonics[k, last + 1 :] = harmonics[k, last]
        harmonics[k, :-1][r > _VANISHES_BEYOND[k]] = 0
    harmonics[1] = continued(unit, harmonics[1])
    return harmonics


def continued(unit: SampleMedium, second: Array) -> Array:
    """The second harmonic, beyond _TOLD_TO as diffusing light has it: (f'' − f'/r)/f of f = (1 + κr) e^(−κr)/r³.

    Its own noise there, 1 to 4 % of the light, is more than itself.
    """
    r = np.append(_middles(), _middles()[-1])
    kappa = np.sqrt(3 * unit.sigma_a) if unit.thickness_mm is None else _kappa(unit)
    fall = -3 / r - kappa**2 * r / (1 + kappa * r)
    bend = fall**2 + 3 / r**2 - kappa**2 / (1 + kappa * r) ** 2 - fall / r
    near = int(np.searchsorted(r, _TOLD_TO))
    return np.where(r > r[near], second[near] * bend / bend[near], second)


def _spline(r: Array, values: Array, weight: Array, knots_mfp: Array) -> Array:
    """Values at ascending radii as a cubic spline in ln r."""
    log_r = np.log(r)
    inner = np.log(knots_mfp)
    inner = inner[(inner > log_r[3]) & (inner < log_r[-4])]
    knots = np.concatenate([[log_r[0]] * 4, inner, [log_r[-1]] * 4])
    return np.asarray(make_lsq_spline(log_r, values, knots, w=weight)(log_r))


def beyond_of(annulus: Array) -> Array:
    """Light farther out than each edge, from that of each annulus."""
    return np.concatenate([np.cumsum(annulus[::-1])[::-1], [0.0]])


def _middles() -> Array:
    """Radii [1/σt′] that stand for the annuli."""
    edges = r_edges_mfp()
    return np.sqrt(np.maximum(edges[1:] * edges[:-1], edges[1:] ** 2 / 4))
