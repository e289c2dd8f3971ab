"""The light that left the frame, and the floor of veiling glare, from the outer part of the curve. Lengths in mm.

Some mean free paths from the beam, light leaves as diffusion has it with the boundary's fluence φ and flux J
(Kienle & Patterson 1997, J. Opt. Soc. Am. A 14, 246): L ∝ φ + 3μ′J towards a camera that sees the inside under the
cosine μ′, from a source one mean free path deep and its negative image above the extrapolated boundary. What lies
beyond a line around the beam is a single integral along that line. What holds a
sample comes in as a ratio (`holder`).
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from bssrdf.calib import least_squares
from bssrdf.holding import HALF_SPACE, NEAR_WALL, Held
from bssrdf.measure.holder import Holder
from bssrdf.measure.profile import RadialProfile
from bssrdf.session.records import Array
from bssrdf.transport import decay_constants, half_spaces
from bssrdf.transport.exit_radiance import boundary_a, transmittance

INNER_SHARE = 0.35
"""The fit begins at this share of the distance from the beam to the nearest edge of the frame."""
_MODEL_REL_SD = 0.003
_MODEL_FREEDOM = 4
"""The form is right to this, and departs from the truth as smoothly as a curve of this many free values."""
LEAST_BINS = 8
_OUTERMOST = 4
"""One in so many bins, the farthest, tells a floor below 0 to begin with: darks brighter than black make one."""
ATTENUATION_REL_SD = 0.03
_TOTAL_REL_SD = 0.01
"""As a tile's reflectance is known."""
_MOST_STEP = 0.01
"""A parameter that nothing tells has an error without bound; its slope is taken over no more than this."""
_LONGEST = 1.0
"""Step of ln σtr on the way: a leap may end at a σtr so small that the curve knows it no more."""
_ORDINATES = 16
_LOG_LOSS = (-14.0, -0.5)
"""Range of ln(1 − α′) in which a total is looked up."""
_DEGREE = 23
"""Of the polynomial that stands for the totals there: 15 leaves 1e-6, 23 1e-7."""
_ATTENUATION_DEGREE = 31
"""Of that for the attenuations: it leaves 1e-7 of them."""
_LOOKED_UP = 2000
"""Places between which totals are straight lines: 6e-6 of a loss."""
_TOTALS = 41
"""Of half spaces in that range, between which those of a finite sample are interpolated."""
_NOTHING_LEFT = 12.0
"""Thicknesses farther out, on the whitest back, light has fallen to e⁻⁸."""
_RINGS = 1000
_DEEP = Holder(HALF_SPACE, 1.0)


class Boundary(NamedTuple):
    """What the surface does: `a`, the paper's A, and `cosine`, that of the view inside the medium."""

    a: float
    cosine: float


class Surroundings(NamedTuple):
    """What is known of the medium beside its curve. Angles in degrees, outside."""

    eta: float
    g: float
    view_angle_deg: float
    incidence_deg: float
    held: Held = HALF_SPACE

    @property
    def holder(self) -> Holder:
        return Holder(self.held, self.eta)

    def boundary(self) -> Boundary:
        inside = np.sin(np.radians(self.view_angle_deg)) / self.eta
        return Boundary(boundary_a(self.eta), float(np.sqrt(1 - inside**2)))

    def attenuation(self, total: float) -> float:
        """σtr times the mean free path of the half space whose total, as this camera sees it, is `total`."""
        return float(np.exp(_log_attenuation(self.g)(np.log(self.loss(total)))))

    def attenuation_by_mfp(self, total: float) -> Callable[[float], float]:
        """The same of the sample as it is held, which hangs on its mean free path [mm], too."""
        if self.held.kind == "half":
            of_half_space = self.attenuation(total)
            return lambda mfp: of_half_space
        log_loss = np.linspace(*_LOG_LOSS, _TOTALS)
        seen = np.interp(log_loss, *self._totals())
        q = np.exp(_log_attenuation(self.g)(log_loss))

        def attenuation(mfp: float) -> float:
            totals = seen * self.holder.total_ratio(mfp, q)
            return float(np.exp(np.interp(-total, -totals, np.log(q))))

        return attenuation

    def attenuation_rel_sd(self, total: float) -> float:
        """Relative error of that attenuation; infinite where the total is that of a medium without absorption.

        By the error of the form, and that of the total: the nearer to white, the less it tells of what little is lost.
        """
        brighter = total * (1 + _TOTAL_REL_SD)
        if brighter >= self._totals()[1][0]:
            return np.inf
        return float(np.hypot(ATTENUATION_REL_SD, np.log(self.attenuation(total) / self.attenuation(brighter))))

    def loss(self, total: float) -> float:
        """1 − α′ of that half space; the least or most that is looked for where none has this total."""
        log_loss, seen = self._totals()
        if not seen[-1] < total < seen[0]:
            return float(np.exp(_LOG_LOSS[0] if total > 0.5 else _LOG_LOSS[1]))
        return float(np.exp(np.interp(-total, -seen, log_loss)))

    def _totals(self) -> tuple[Array, Array]:
        return _totals(self.eta, self.g, self.view_angle_deg, self.incidence_deg)


def _albedo(loss: Array, g: float) -> Array:
    scattering = (1 - loss) / (1 - g)
    return scattering / (scattering + loss)


@functools.lru_cache(maxsize=8)
def _log_attenuation(g: float) -> np.polynomial.Chebyshev:
    """ln of σtr times the mean free path of half spaces, over ln(1 − α′)."""

    def log_attenuation(log_loss: Array) -> Array:
        loss = np.exp(log_loss)
        return np.asarray(np.log(decay_constants(_albedo(loss, g), g) * (1 + g / (1 - g) * (1 - loss))))

    return np.polynomial.Chebyshev.interpolate(log_attenuation, _ATTENUATION_DEGREE, domain=_LOG_LOSS)


@functools.lru_cache(maxsize=8)
def _totals(eta: float, g: float, view_angle_deg: float, incidence_deg: float) -> tuple[Array, Array]:
    """ln(1 − α′) rising, and the totals of such half spaces as a camera sees them: all solved at once."""
    cosines = np.array([np.cos(np.radians(view_angle_deg))])
    entering = float(transmittance(eta, np.cos(np.radians([incidence_deg])))[0])

    def seen(log_loss: Array) -> Array:
        return entering * half_spaces(_albedo(np.exp(log_loss), g), g, eta, cosines, _ORDINATES).radiance[:, 0]

    log_loss = np.linspace(*_LOG_LOSS, _LOOKED_UP)
    return log_loss, np.polynomial.Chebyshev.interpolate(seen, _DEGREE, domain=_LOG_LOSS)(log_loss)


@dataclass(frozen=True)
class Tail:
    """Outer part of a curve: σtr [1/mm], mean free path [mm], a scale, and the floor of glare."""

    scale: float
    sigma_tr: float
    mfp: float
    floor: float
    boundary: Boundary

    def _sources(self) -> tuple[float, float, float]:
        """Depth of the source, height of its image, and the diffusion constant."""
        diffusion = self.mfp / 3
        return self.mfp, self.mfp + 4 * self.boundary.a * diffusion, diffusion

    def __call__(self, r: Array) -> Array:
        return self.scale * self.shape(r) + self.floor

    def shape(self, r: Array) -> Array:
        """The curve at a scale of 1, over no floor."""
        z_r, z_v, diffusion = self._sources()
        (fluence_r, flux_r), (fluence_v, flux_v) = (self._of_source(r, z) for z in (z_r, z_v))
        return np.asarray((fluence_r - fluence_v) / diffusion + 3 * self.boundary.cosine * (flux_r + flux_v))

    def _of_source(self, r: Array, z: float) -> tuple[Array, Array]:
        """Fluence, times the diffusion constant, and flux at the surface above a source z deep."""
        d = np.hypot(r, z)
        fluence = np.exp(-self.sigma_tr * d) / d
        return fluence, z * (1 + self.sigma_tr * d) * fluence / d**2

    def beyond(self, outline: tuple[Array, Array]) -> float:
        """∫ of the curve, floor left out, over everything outside of a closed line (across, along) round the beam."""
        across, along = outline
        z_r, z_v, diffusion = self._sources()
        d_r, d_v = (np.sqrt(across**2 + along**2 + z**2) for z in (z_r, z_v))
        near, far = np.exp(-self.sigma_tr * d_r), np.exp(-self.sigma_tr * d_v)
        fluence = -near * np.expm1(-self.sigma_tr * (d_v - d_r)) / self.sigma_tr / diffusion
        flux = z_r * near / d_r + z_v * far / d_v
        angle = np.unwrap(np.arctan2(along, across))
        return self.scale * abs(float(np.trapezoid(fluence + 3 * self.boundary.cosine * flux, angle)))


@dataclass(frozen=True)
class TailOfSample(Tail):
    """The same of a slab or a dish."""

    holder: Holder
    n_modes: int

    def shape(self, r: Array) -> Array:
        return super().shape(r) * self.holder.ratio(r, self.mfp, self.sigma_tr * self.mfp, self.n_modes)

    def beyond(self, outline: tuple[Array, Array]) -> float:
        r = np.minimum(np.hypot(*outline), self.holder.held.radius)
        farthest = min(float(r.max()) + _NOTHING_LEFT * self.holder.thickness, self.holder.held.radius)
        rings = np.geomspace(float(r.min()), farthest, _RINGS)
        light = self.scale * self.shape(rings) * rings**2
        inner = np.append(0.0, np.cumsum((light[1:] + light[:-1]) / 2 * np.diff(np.log(rings))))
        angle = np.unwrap(np.arctan2(outline[1], outline[0]))
        return abs(float(np.trapezoid(inner[-1] - np.interp(r, rings, inner), angle)))


class Estimate(NamedTuple):
    """A number with its standard error."""

    value: float
    sd: float


@dataclass(frozen=True)
class TailFit:
    """A tail with the covariance of (ln scale, ln σtr, ln mfp, floor)."""

    tail: Tail
    parameters: Array
    covariance: Array
    make: Callable[[Array], Tail]
    chi2: float
    """Per degree of freedom."""

    def estimate(self, quantity: Callable[[Tail], float]) -> Estimate:
        """A quantity of the tail with the error that follows from that of the fit."""
        value = quantity(self.tail)
        steps = np.minimum(1e-3 * np.sqrt(np.diag(self.covariance)) + 1e-12, _MOST_STEP)
        slope = np.array(
            [(quantity(self.make(self.parameters + step)) - value) / step.sum() for step in np.diag(steps)]
        )
        return Estimate(value, float(np.sqrt(slope @ self.covariance @ slope)))


def most_beyond(profile: RadialProfile, reach: float) -> float:
    """Light that may lie farther than `reach` from the beam, by two errors: no medium's falls more slowly than r⁻³.

    It bounds the error of a tail that noise hides, whose logarithms a fit leaves open by orders of magnitude.
    """
    outer = (profile.r > INNER_SHARE * reach) & (profile.r < reach) & (profile.sd > 0) & np.isfinite(profile.sd)
    cube = profile.r[outer] ** 3
    weight = (cube * profile.sd[outer]) ** -2.0
    if not weight.size:
        return np.inf
    mean, sd = float(np.average(cube * profile.value[outer], weights=weight)), float(weight.sum() ** -0.5)
    return 2 * np.pi * (max(mean, 0.0) + 2 * sd) / reach


def fit_tail(
    profile: RadialProfile,
    reach: float,
    boundary: Boundary,
    *,
    with_floor: bool,
    attenuation: Callable[[float], float] | None = None,
    attenuation_rel_sd: float = ATTENUATION_REL_SD,
    holder: Holder = _DEEP,
) -> TailFit | None:
    """The tail of a curve seen round a beam that is `reach` from the nearest edge; None where there is too little.

    A floor is hard to tell from a slower decay. `attenuation`, σtr times the mean free path by the total reflectance
    where that path is so many mm, helps to.
    """
    reach = min(reach, NEAR_WALL * holder.held.radius)
    outer = (profile.r > INNER_SHARE * reach) & np.isfinite(profile.sd)
    outer &= profile.r < NEAR_WALL * holder.held.radius
    n_modes = holder.modes(INNER_SHARE * reach)
    r, value = profile.r[outer], profile.value[outer]
    model_sd = _MODEL_REL_SD * np.sqrt(max(1.0, len(r) / _MODEL_FREEDOM))
    sd = np.hypot(profile.sd[outer], model_sd * value)
    r, value, sd = r[sd > 0], value[sd > 0], sd[sd > 0]
    if len(r) < LEAST_BINS:
        return None
    below = min(0.0, float(np.mean(value[-len(r) // _OUTERMOST :]))) if with_floor else 0.0
    first = float(value[0]) - below
    if max(float(np.mean(value / sd)), float(np.mean(-below / sd))) < 1 or not first > 0:
        return None

    def unit(p: Array) -> Tail:
        own = 1.0, float(np.exp(p[1])), float(np.exp(p[2])), below + float(p[3]) * first if with_floor else 0.0
        return Tail(*own, boundary) if n_modes is None else TailOfSample(*own, boundary, holder, n_modes)

    def make(p: Array) -> Tail:
        tail = unit(p)
        return replace(tail, scale=float(np.exp(p[0])) * first / float(tail.shape(r[:1])[0]))

    n = 4 if with_floor else 3
    low = np.array([-20.0, np.log(1e-4 / reach), np.log(1e-3 * reach), -1.0])[:n]
    high = np.array([20.0, np.log(30 / reach), np.log(reach), 1.0])[:n]
    start = np.array([0.0, np.log(1 / reach), np.log(0.05 * reach), 0.0])[:n]

    @functools.lru_cache(maxsize=4)
    def shape_of(log_sigma_tr: float, log_mfp: float) -> Array:
        """Over its first value."""
        shape = unit(np.array([0.0, log_sigma_tr, log_mfp, 0.0])).shape(r)
        return np.asarray(shape / shape[0])

    def residual(p: Array) -> Array:
        floor = below + float(p[3]) * first if with_floor else 0.0
        by_curve = (np.exp(p[0]) * first * shape_of(*p[1:3].tolist()) + floor - value) / sd
        if attenuation is None:
            return by_curve
        return np.append(by_curve, (p[1] + p[2] - np.log(attenuation(float(np.exp(p[2]))))) / attenuation_rel_sd)

    solved = least_squares(residual, start, low, high, longest=_LONGEST)
    covariance = np.asarray(np.linalg.pinv(solved.slopes.T @ solved.slopes), float)
    chi2 = 2 * solved.cost / max(len(solved.residuals) - n, 1)
    return TailFit(make(solved.x), solved.x, covariance, make, chi2)
