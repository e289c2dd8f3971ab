"""What annuli, spot and camera make of a model's R_d(r), which is that of a narrow beam over all directions of exit.

Shapes: b curves of u radii or annuli each. Lengths in mm.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np

from bssrdf.transport.arrays import Engine
from bssrdf.transport.finite import Kind
from bssrdf.transport.light import NEAREST_MFP, Light, Look, exit_norm, transmittance

_DARKEST = 1e-6
"""What the exit law falls to at least, where it is a fit that may run below 0 right at the beam."""
_FINE = np.polynomial.legendre.leggauss(12)
_COARSE = np.polynomial.legendre.leggauss(3)


def _stencil(radial: int, angular: int) -> tuple[Any, Any, Any]:
    """ρ/w, angle and weight of points over a Gaussian spot: Gauss–Laguerre in 2ρ²/w², midpoints in angle."""
    t, weight = np.polynomial.laguerre.laggauss(radial)
    angle = (np.arange(angular) + 0.5) * np.pi / angular
    rho, turn = (each.ravel() for each in np.meshgrid(np.sqrt(t / 2), angle, indexing="ij"))
    return rho, turn, np.repeat(weight / angular, angular)


_NEAR_SPOT, _FAR_SPOT = _stencil(6, 8), _stencil(3, 4)


class Sight(NamedTuple):
    """How a curve was seen, the same for all rows of a batch: what the model's has to go through."""

    camera: bool
    """Whether a camera at an angle saw the light, so that the model's own exit law counts."""
    cos_view: float
    slant: float
    """Product of the sines of beam and view inside: what hangs on the camera's side of the beam grows with it."""
    binned: bool
    inner: int
    """Annuli, in order of radius, with 12 nodes."""
    blurred: bool
    blur_inner: int
    """Radii, in order, whose blur takes 48 nodes."""
    held: Kind
    """What back and walls the sample has."""


class Rings(Protocol):
    """Where curves have values."""

    @property
    def r_lo(self) -> Any: ...

    @property
    def r_hi(self) -> Any:
        """(b, u); equal where a value belongs to a radius and not to an annulus."""
        ...

    @property
    def arc(self) -> Any:
        """(b, u): pixels lie within ± this of the line across the view [rad]; π/2 is the whole circle."""
        ...

    @property
    def spot_radius(self) -> Any:
        """(b, 1): 1/e²; 0 where it is not known."""
        ...


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


def nodes(e: Engine, sight: Sight, c: Rings) -> QuadratureNodes:
    """Twelve a wide annulus, in ln r or from 0 in r, and three a narrow one."""
    xp = e.xp
    if not sight.binned:
        return QuadratureNodes(c.r_lo, xp.ones_like(c.spot_radius))
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


def seen_at(e: Engine, sight: Sight, model: Light, c: Rings, log_sigma: Any, q: Any) -> Seen:
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


def middles(e: Engine, c: Rings, log_sigma: Any) -> Any:
    """The middle of each annulus in mean free paths."""
    return e.xp.maximum(e.xp.exp(log_sigma) * (c.r_lo + c.r_hi) / 2, NEAREST_MFP)
