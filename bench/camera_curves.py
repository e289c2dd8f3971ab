"""Curves as `measure` has them, of all published materials, in the table's own light: two sides of rings, a spot, a
camera at 45°, R, and stated errors of scale, length and view. Lengths in mm, coefficients in 1/mm."""

from __future__ import annotations

import math
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.bench.demo import MM_PER_PX
from bssrdf.bench.fit_peers import PeerFit, timed
from bssrdf.bench.measure import cost_of
from bssrdf.bench.trials import ModelName
from bssrdf.fit import FitOptions, curves_of, fit_slices, sight_of
from bssrdf.rig import published_sample
from bssrdf.session import write_slice
from bssrdf.session.records import ChannelFit, ChannelSlice, Slice
from bssrdf.transport import CHANNELS, load_materials, usual_light
from bssrdf.transport.arrays import NUMPY
from bssrdf.transport.light import NEAREST_MFP, shape_of, transmittance
from bssrdf.transport.observed import averaged, nodes, seen_at

Floats = NDArray[np.float64]
RINGS = 70
PX_A_RING = 2.0
SPOT_PX = 2.5
VIEW_DEG = 45.0
NOISE, TOTAL_NOISE = 0.01, 0.002
FAINTEST = 1e-5
"""Of the brightest ring: the noise of a dark frame."""


class CameraFit(NamedTuple):
    """Coefficients (n,) found, with what they took, and those that made the light."""

    found: PeerFit
    sigma_a: Floats
    sigma_sp: Floats


def fit_camera(model: ModelName, copies: int) -> CameraFit:
    """All that `bssrdf fit` reports, of `copies` of every material with noise of their own."""
    pieces = [piece for seed in range(copies) for piece in camera_slices(seed)]
    options = FitOptions(model=model, tables="shipped")
    fits: list[ChannelFit] = []

    def run() -> Floats:
        fits[:] = [fit for each in fit_slices(pieces, options) for fit in each.values()]
        return np.array([fit.sigma_a_per_mm for fit in fits])

    sigma_a, seconds = timed(run, repeats=1)
    sigma_sp = np.array([fit.sigma_sp_per_mm for fit in fits])
    media = [published_sample(name).media[channel] for name in load_materials() for channel in CHANNELS] * copies
    found = PeerFit(sigma_a, sigma_sp, seconds / len(fits), int(np.isnan(sigma_sp).sum()))
    return CameraFit(found, np.array([m.sigma_a for m in media]), np.array([m.sigma_sp for m in media]))


def camera_slices(seed: int) -> list[Slice]:
    """A slice of each published material, three channels."""
    rng = np.random.default_rng(seed)
    return [_slice(name, rng) for name in load_materials()]


def command_seconds() -> tuple[float, float]:
    """Processor seconds of `bssrdf fit` on marble's slice, from a cold process: with an empty cache, and again."""
    (marble,) = (piece for piece in camera_slices(0) if piece.material == "Marble")
    with tempfile.TemporaryDirectory(prefix="bssrdf-fit-") as folder:
        file = Path(folder) / "marble.csv"
        write_slice(file, marble)
        cost_of("fit", file, "--quiet")  # byte code
        cold, warm = (cost_of("fit", file, "--quiet", XDG_CACHE_HOME=folder).cpu_s for _ in range(2))
    return cold, warm


def _slice(name: str, rng: np.random.Generator) -> Slice:
    media, width = published_sample(name).media, MM_PER_PX[name] * PX_A_RING
    lo: Floats = width * np.tile(np.arange(float(RINGS)), 2)
    hi: Floats = lo + width
    middle: Floats = lo + width / 2
    sides = np.repeat(np.array([-1, 1], np.int8), RINGS)
    blank = ChannelSlice(middle, np.ones_like(lo), np.ones_like(lo), lo, hi, sides)
    bare = Slice(
        channels=dict.fromkeys(CHANNELS, blank),
        eta=media[CHANNELS[0]].eta,
        g=0.0,
        flux="incident",
        exit="fresnel",
        view_angle_deg=VIEW_DEG,
        view_angle_sd_deg=0.2,
        band_mm=5 * width,
        spot_radius_mm=SPOT_PX * MM_PER_PX[name],
        scale_rel_sd=0.0025,
        mm_rel_sd=0.002,
        material=name,
    )
    seen = {channel: _seen(bare, *shape_of(one.sigma_a, one.sigma_sp)) for channel, one in media.items()}
    channels, totals = {}, {}
    for channel, (rd, total_r) in seen.items():
        sd = np.hypot(NOISE * rd, FAINTEST * rd.max())
        noisy = rd + sd * rng.standard_normal(rd.size)
        channels[channel] = ChannelSlice(middle, noisy, sd, lo, hi, sides)
        totals[channel] = total_r * (1 + TOTAL_NOISE * rng.standard_normal())
    sds = {channel: TOTAL_NOISE * total_r for channel, (_, total_r) in seen.items()}
    return replace(bare, channels=channels, total_r=totals, total_r_sd=sds)


def _seen(piece: Slice, log_sigma: float, q: float) -> tuple[Floats, float]:
    """What the camera sees of the table's medium in each ring of both sides [1/mm²], and its R, per incident flux."""
    model, cos_view = usual_light(piece.eta, 0.0), math.cos(math.radians(VIEW_DEG))
    entering = float(transmittance(np, piece.eta, 1.0))
    c = curves_of([piece], ["R"], None)
    sight = sight_of(piece, c, blurred=True)
    s, at = np.full((1, 1), log_sigma), np.full((1, 1), q)
    quadrature = nodes(NUMPY, sight, c)
    look = averaged(NUMPY, sight, quadrature, model.look(NUMPY, at, np.maximum(np.exp(s) * quadrature.r, NEAREST_MFP)))
    towards = 1 / c.rd[0, 0, 0]  # of a slice of ones: the convention of incident flux and of Fresnel's exit law
    rings = towards * np.exp(2 * s + seen_at(NUMPY, sight, model, c, s, at).log_ratio) * look[0]
    total_r = entering * model.total(NUMPY, at)[0] * model.total_radiance_factor(NUMPY, at, cos_view)
    return np.tile(rings[0], 2), float(total_r[0, 0])
