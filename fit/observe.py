"""What annuli, spot and camera make of a model's R_d(r), which is that of a narrow beam over all directions of exit.

Shapes as in `layout`: b problems, u radii. Lengths in mm.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from bssrdf.fit.layout import Curves, Sight
from bssrdf.transport.arrays import Engine
from bssrdf.transport.light import NEAREST_MFP, Light, Look, exit_norm, transmittance

_DARKEST = 1e-6
"""What the exit law falls to at least, where it is a fit that may run below 0 right at the beam."""
EXIT_NEAR_MFP = 0.5
EXIT_BENDS_MFP = 0.2, 4.0
"""From the first to the second radius the departure turns round."""
EXIT_NEAR, EXIT_NEAR_STEEP, EXIT_NEAR_BY_G = 0.015, 0.14, 1.5
"""Of the light towards a camera at EXIT_NEAR_MFP; the second times sin⁴ of the view inside, all times 1 + the third g².
It falls as the radius: a walk scored at a right angle to the view (bench/camera_walk.py) lies 2 to 8 % off at 0.3 mean
free paths, 1 to 2 % at 1."""
EXIT_NEAR_ASKEW = 0.08
"""The same across the plane of an oblique beam, times 1 − g²: its table has no harmonic beyond the sixth, and walks lie
5 to 12 % below it at 0.6 mean free paths, 2 to 6 % at 1 (bench/oblique_light.py)."""
EXIT_PIVOT_MFP = 5.0
SIDE_NEAR_MFP = 0.22
SIDE_NEAR, SIDE_MEAN, SIDE_TOTAL = (1.0, 3.0), (0.3, 2.2), (0.17, 1.5)
"""How far what a camera sees from one side of an oblique beam may lie from the mean of both, over `Sight.slant`: at x
mean free paths the first over x + SIDE_NEAR_MFP, for means over azimuths the second too, of R the third times √|g|. The
second number of each counts by 1 − α′. Walks at 20 to 60°, g 0 to 0.8, α′ 0.67 to 0.98 have 0.4 to 0.9 times as much:
a camera stands in the beam's plane more often than not, where all go one way."""
SIDE_TOGETHER = 0.9
"""Correlation of what the side does to R and to a mean over azimuths."""
_FINE = np.polynomial.legendre.leggauss(12)
_COARSE = np.polynomial.legendre.leggauss(3)


def _stencil(radial: int, angular: int) -> tuple[Any, Any, Any]:
    """ρ/w, angle and weight of points over a Gaussian spot: Gauss–Laguerre in 2ρ²/w², midpoints in angle."""
    t, weight = np.polynomial.laguerre.laggauss(radial)
    angle = (np.arange(angular) + 0.5) * np.pi / angular
    rho, turn = (each.ravel() for each in np.meshgrid(np.sqrt(t / 2), angle, indexing="ij"))
    return rho, turn, np.repeat(weight / angular, angular)


_NEAR_SPOT, _FAR_SPOT = _stencil(6, 8), _stencil(3, 4)


class QuadratureNodes(NamedTuple):
    """Radii at which the model is looked at [mm], and their weights in the mean over an annulus, by r dr."""

    r: Any
    weight: Any


class Seen(NamedTuple):
    """ln of what is seen over a narrow beam's curve, near the point where it was last worked out."""

    log_ratio: Any
    by_log_sigma: Any
    by_q: Any
    log_sigma: Any
    q: Any


def nodes(e: Engine, sight: Sight, c: Curves) -> QuadratureNodes:
    """Twelve a wide annulus, in ln r or from 0 in r, and three a narrow one."""
    xp = e.xp
    if not sight.binned:
        return QuadratureNodes(c.r_lo, xp.ones_like(c.r_lo))
    b, k = c.r_lo.shape[0], sight.inner
    lo, hi = c.r_lo[:, :k, None], c.r_hi[:, :k, None]
    t = (1 + xp.asarray(_FINE[0])) / 2
    even = lo + (hi - lo) * t
    grown = xp.maximum(lo, 1e-300) * xp.exp(xp.log(xp.maximum(hi, 1e-300) / xp.maximum(lo, 1e-300)) * t)
    from_zero = lo < hi / 50
    r = xp.where(from_zero, even, grown)
    weight = xp.asarray(_FINE[1]) * xp.where(from_zero, r, r * r)
    far_lo, far_hi = c.r_lo[:, k:, None], c.r_hi[:, k:, None]
    far = (far_lo + far_hi) / 2 + (far_hi - far_lo) / 2 * xp.asarray(_COARSE[0])
    far_weight = xp.asarray(_COARSE[1]) * far
    weight, far_weight = (each / xp.maximum(each.sum(2, keepdims=True), 1e-300) for each in (weight, far_weight))
    join = lambda near, rest: xp.concatenate([near.reshape(b, -1), rest.reshape(b, -1)], axis=1)  # noqa: E731
    return QuadratureNodes(join(r, far), join(weight, far_weight))


def averaged(e: Engine, sight: Sight, at: QuadratureNodes, look: Look) -> Look:
    """The means over the annuli of what was seen at the nodes."""
    if not sight.binned:
        return look
    xp = e.xp
    b, k = look[0].shape[0], 12 * sight.inner
    weighed = [at.weight * each for each in look]
    near, far = (
        [w[:, :k].reshape(b, -1, 12).sum(2) for w in weighed],
        [w[:, k:].reshape(b, -1, 3).sum(2) for w in weighed],
    )
    value, by_x, by_q = (xp.concatenate(pair, axis=1) for pair in zip(near, far, strict=True))
    return value, by_x, by_q


def plain(e: Engine, log_sigma: Any, q: Any) -> Seen:
    """A narrow beam, seen over all directions: the same at all radii."""
    zero = e.xp.zeros_like(q)
    return Seen(zero, zero, zero, log_sigma, q)


def seen_at(e: Engine, sight: Sight, model: Light, c: Curves, log_sigma: Any, q: Any) -> Seen:
    """The ratio at a point, by the spot where `blurred`, by the camera's angle where `camera`."""
    xp = e.xp
    sigma = xp.exp(log_sigma)
    centre = xp.maximum((c.r_lo + c.r_hi) / 2, NEAREST_MFP / sigma)
    if not (sight.blurred or (sight.camera and model.exit_varies)):
        return plain(e, log_sigma, q)
    if sight.blurred:
        k = sight.blur_inner
        parts = [
            _blurred(e, sight, model, q, sigma, centre[:, at], c.arc[:, at], c.spot_radius, stencil)
            for at, stencil in ((slice(0, k), _NEAR_SPOT), (slice(k, None), _FAR_SPOT))
        ]
        seen = [xp.concatenate(pair, axis=1) for pair in zip(*parts, strict=True)]
    else:
        seen = list(_towards_camera(e, sight, model, q, sigma * centre, xp.zeros_like(centre), c.arc))
    narrow = model.look(e, q, sigma * centre)
    ratio = seen[0] / narrow[0]
    lit = xp.isfinite(ratio) & (ratio > _DARKEST)
    by_x, by_q = (
        xp.where(lit, s / xp.where(lit, seen[0], 1.0) - n / narrow[0], 0.0)
        for s, n in zip(seen[1:], narrow[1:], strict=True)
    )
    return Seen(xp.log(xp.where(lit, ratio, _DARKEST)), by_x, by_q, log_sigma, q)


def _blurred(
    e: Engine, sight: Sight, model: Light, q: Any, sigma: Any, r: Any, arc: Any, spot: Any, stencil: Any
) -> list[Any]:
    """Mean of the light at d = r − ρ over the spot; δ, the angle of d to r, turns the radius against the camera."""
    xp = e.xp
    rho_w, angle, weight = (xp.asarray(each) for each in stencil)
    r, arc, rho = r[..., None], arc[..., None], spot[..., None] * rho_w
    d = xp.sqrt(xp.maximum(r * r + rho * rho - 2 * r * rho * xp.cos(angle), 1e-6 * (r * r + rho * rho)))
    sin_turn = rho * xp.sin(angle) / d
    b, u, n = d.shape
    flat = lambda each: (each + xp.zeros_like(d)).reshape(b, -1)  # noqa: E731
    x = xp.maximum(sigma * flat(d), NEAREST_MFP)
    values = _towards_camera(e, sight, model, q, x, flat(sin_turn), flat(arc))
    return [(each.reshape(b, u, n) * weight).sum(2) for each in values]


def _towards_camera(e: Engine, sight: Sight, model: Light, q: Any, x: Any, sin_turn: Any, arc: Any) -> Look:
    """What the camera sees of a narrow beam, over Fresnel's exit law, where a bin's pixels lie within ±`arc` [rad] of
    the line across its view and `sin_turn` is that of the angle between a pixel's radius and its light's."""
    if not (sight.camera and model.exit_varies):
        return model.look(e, q, x)
    law = float(transmittance(np, model.eta, sight.cos_view)) / exit_norm(model.eta)
    value, by_x, by_q = model.radiance(e, q, x, sight.cos_view, *azimuths(e, arc, sin_turn))
    return value / law, by_x / law, by_q / law


class AzimuthAverage(NamedTuple):
    """Averages over the azimuths between light and camera: of cos 2φ, and the share of φ = 0 over a circle's."""

    cos_2: Any
    along: Any


def azimuths(e: Engine, arc: Any, sin_turn: Any) -> AzimuthAverage:
    """Of a bin's pixels within ±`arc` [rad] of the line across the view, light turned against their radius by δ."""
    xp = e.xp
    along = (arc > 0) & (xp.abs(sin_turn) > xp.cos(arc) - 1e-6)
    return AzimuthAverage(
        cos_2=(2 * sin_turn**2 - 1) * xp.abs(xp.sinc(2 * arc / np.pi)),
        along=xp.where(along, np.pi / 2 / xp.maximum(arc, 0.1), 0.0),
    )


def total_seen(e: Engine, sight: Sight, model: Light, q: Any) -> Any:
    """What the camera's angle makes of R, over Fresnel's exit law; the spot leaves it alone."""
    if not sight.camera:
        return e.xp.ones_like(q)
    law = float(transmittance(np, model.eta, sight.cos_view)) / exit_norm(model.eta)
    return model.total_radiance_factor(e, q, sight.cos_view) / law


def exit_rel_sd(e: Engine, model: Light, c: Curves, sigma: Any) -> Any:
    """What the exit law may be off by at each radius; all azimuths together it is known better."""
    xp = e.xp
    x = xp.maximum(sigma * (c.r_lo + c.r_hi) / 2, NEAREST_MFP)
    return model.exit_error_mfp / x * xp.abs(xp.sinc(2 * c.arc / np.pi))


def exit_modes(e: Engine, sight: Sight, model: Light, c: Curves, sigma: Any) -> tuple[Any, ...]:
    """What the exit law may be off by at all radii together: by the same, by what grows as ln r, and near the beam by
    what falls as the radius, to one side and from one side to the other."""
    xp = e.xp
    x = xp.maximum(sigma * (c.r_lo + c.r_hi) / 2, NEAREST_MFP)
    across = xp.abs(xp.sinc(2 * c.arc / np.pi))
    amplitude = model.exit_error * xp.ones_like(x)
    near = EXIT_NEAR + EXIT_NEAR_STEEP * ((1 - sight.cos_view**2) / model.eta**2) ** 2
    near = near * (1 + EXIT_NEAR_BY_G * getattr(model, "g", 0.0) ** 2)
    near = near + (
        EXIT_NEAR_ASKEW * (1 - getattr(model, "g", 0.0) ** 2) if getattr(model, "sin_beam", 0.0) > 0 else 0.0
    )
    near = near * across * EXIT_NEAR_MFP / xp.maximum(x, EXIT_NEAR_MFP / 2)
    first, last = EXIT_BENDS_MFP
    turn = xp.cos(np.pi * xp.clip(xp.log(x / first) / np.log(last / first), 0, 1))
    grows = xp.log(x / EXIT_PIVOT_MFP) / np.log(EXIT_PIVOT_MFP)
    return amplitude, amplitude * grows, near, near * np.sqrt(2) * turn


def side_modes(e: Engine, sight: Sight, model: Light, c: Curves, sigma: Any, q: Any) -> tuple[Any, ...]:
    """What the camera's side of an oblique beam, which no slice says, may do to the curve: near the beam; to a mean
    over all azimuths at all radii, by the same and by what grows as ln r, and by light scattered once, whose side is
    known but for the camera's. What it does to R is apart."""
    xp = e.xp
    x = xp.maximum(sigma * (c.r_lo + c.r_hi) / 2, NEAREST_MFP)
    near = _of_side(sight, SIDE_NEAR, q) / (x + SIDE_NEAR_MFP)
    circle = 1 - xp.abs(xp.sinc(2 * c.arc / np.pi))
    mean = _of_side(sight, SIDE_MEAN, q) * circle
    grows = xp.log(x / EXIT_PIVOT_MFP) / np.log(EXIT_PIVOT_MFP)
    once = model.first_by_side(e, q, x, sight.cos_view)
    return near, mean, mean * grows, *(each * circle for each in once), 0.0 * x


def side_of_total(sight: Sight, model: Light, q: Any) -> tuple[Any, ...]:
    """The same of R, which goes mostly with a mean over all azimuths: it is the light under it. Nothing where
    scattering forgets where light came from."""
    off = _of_side(sight, SIDE_TOTAL, q) * np.sqrt(abs(getattr(model, "g", 0.0)))
    return 0 * off, SIDE_TOGETHER * off, 0 * off, 0 * off, 0 * off, float(np.sqrt(1 - SIDE_TOGETHER**2)) * off


def _of_side(sight: Sight, level: tuple[float, float], q: Any) -> Any:
    return sight.slant * (level[0] + level[1] * q * q / 3)
