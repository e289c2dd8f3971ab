"""The random walk that looks like a measured medium, in renderers whose closures reflect no light back inside.

Written as it is, a medium comes out too bright there, for the real surface sends half of the light back in. So each
channel gets the index-matched, isotropic walk that has the measured total R, and the mean free path with which the
edge of a shadow falls nearest to the measured one, both under the renderer's own limits. Where one walk cannot do it,
for white media walks end too early, a second, coarser one brings back what is missing.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize, minimize_scalar

from bssrdf.errors import InputError
from bssrdf.export.spread import Spread, WalkMedium, added, measured_spread, walk_spread
from bssrdf.transport import decay_constant, half_space

Floats = NDArray[np.float64]

LIT, SHADOW = 0.03, 0.12
"""Errors of the two sides of an edge that weigh the same: an eye sees the shadow's as less."""
DEPTHS = np.array([0.05, 0.1, 0.2, 0.4, 0.7, 1.0, 1.25, 1.5])
"""Where the edge is matched, in 1/σtr."""
WIDEST, WHITE = 120.0, 60.0
"""[1/σt′] Two walks of 256 bounces follow light over 1.5/σtr where 1/σtr is up to WIDEST, as in cream; where it is
more, or there is no absorption, the edge is matched over WHITE in its place."""
LEAST_REDUCED = 0.02
"""α′ below which the Monte Carlo tables have no light."""
LEAST_ALBEDO, MOST_ALBEDO = 1e-5, 1 - 1e-6
SECOND_WEIGHT = 0.13
"""Of the second walk, one for all channels, as renderers mix closures; the channel's share lies in its albedo."""
WORTH = 0.7
"""What is left of the mismatch where a second walk is worth its while."""
LEAST_SECOND = 1e-3
"""Of R: less is not a second walk."""
SHARES, NEAR, FAR = (-3.0, -1.0, 1.0, 3.0), (0.6, 0.8, 1.0, 1.3), (1.5, 3.0, 6.0, 12.0, 24.0)
"""Where the search for two walks looks first: logit of the second's part, mean free paths over those of one walk."""


class Limits(NamedTuple):
    """What a renderer's walk can do."""

    bounces: int | None = None
    """After which light is given up; None: no limit is known."""
    least_albedo: float = 0.0
    """Below it the renderer walks with this albedo, and dims the result in proportion."""
    second: bool = False
    """Whether two walks can be added."""


class MatchedWalk(NamedTuple):
    """An isotropic, index-matched random walk."""

    albedo: float
    mfp_mm: float
    weight: float = 1.0

    def spread(self, limits: Limits) -> Spread:
        """Its light under the limits."""
        dimmed = min(1.0, self.albedo / limits.least_albedo) if limits.least_albedo else 1.0
        light = walk_spread(max(self.albedo, limits.least_albedo), self.mfp_mm, limits.bounces)
        return Spread(light.r_mm, self.weight * dimmed * light.share)


class Closure(NamedTuple):
    """One or two walks that stand for a medium in one channel, and what their light is."""

    first: MatchedWalk
    second: MatchedWalk | None
    light: Spread
    measured: Spread
    length_mm: float
    """1/σtr, or what stands for it."""


@functools.lru_cache(maxsize=64)
def solve(medium: WalkMedium, limits: Limits) -> Closure:
    """The closure nearest to the medium; InputError where the table knows no such medium."""
    if medium.sigma_sp < LEAST_REDUCED * medium.sigma_tp:
        raise InputError(
            f"σa {medium.sigma_a:.3g} and σs′ {medium.sigma_sp:.3g}/mm are black to a renderer, R {medium.total:.1g}: "
            "no random walk stands for them; is the channel measured at all?"
        )
    measured = measured_spread(medium)
    wide = medium.sigma_tr * WIDEST < medium.sigma_tp
    length = WHITE / medium.sigma_tp if wide else 1 / medium.sigma_tr
    first, worst = _one(medium, measured, length, limits)
    if limits.second and worst > 1:
        (near, far), worst_of_two = _two(first, measured, length, limits)
        if worst_of_two < WORTH * worst:
            return Closure(near, far, added([near.spread(limits), far.spread(limits)]), measured, length)
    return Closure(first, None, first.spread(limits), measured, length)


def walk_total(albedo: float, limits: Limits) -> float:
    """R of a walk."""
    if limits.bounces is None and albedo >= max(limits.least_albedo, 0.02):
        return half_space(albedo, 0.0, 1.0, np.array([1.0])).total
    return MatchedWalk(albedo, 1.0).spread(limits).total


def albedo_of_total(total: float, limits: Limits) -> float:
    """The albedo whose walk has this R, or the most there is where none reaches it."""
    if walk_total(MOST_ALBEDO, limits) <= total:
        return MOST_ALBEDO
    return float(brentq(lambda albedo: walk_total(albedo, limits) - total, LEAST_ALBEDO, MOST_ALBEDO, xtol=1e-9))


def mismatch(light: Spread, measured: Spread, length_mm: float) -> tuple[Floats, Floats]:
    """Relative error of the edge at DEPTHS into the shadow and into the light."""
    x = DEPTHS * length_mm
    lit = measured.edge(-x)
    return light.beyond(x) / measured.beyond(x) - 1, light.edge(-x) / lit - 1


def _worst(light: Spread, measured: Spread, length_mm: float) -> float:
    shadow, lit = mismatch(light, measured, length_mm)
    return max(float(np.abs(shadow).max()) / SHADOW, float(np.abs(lit).max()) / LIT)


def _one(medium: WalkMedium, measured: Spread, length: float, limits: Limits) -> tuple[MatchedWalk, float]:
    """One walk of the measured R, and how far it is off, in units of LIT and SHADOW."""
    albedo = albedo_of_total(measured.total, limits)
    like_far_out = _same_decay(medium, albedo)

    def off(log_mfp: float) -> float:
        return _worst(MatchedWalk(albedo, math.exp(log_mfp)).spread(limits), measured, length)

    # far from 1/σtr the two decays differ by less than a factor of two: scattered once, light of any medium is alike
    around = math.log(like_far_out)
    found = minimize_scalar(off, bounds=(around - 0.8, around + 0.8), method="bounded", options={"xatol": 1e-4})
    return MatchedWalk(albedo, math.exp(found.x)), float(found.fun)


def _same_decay(medium: WalkMedium, albedo: float) -> float:
    """The mean free path with which light far out falls alike: κ*/κ, both exact; for white media their limit."""
    a = medium.sigma_s / (medium.sigma_s + medium.sigma_a)
    sigma_t = medium.sigma_s + medium.sigma_a
    kappa = decay_constant(min(a, MOST_ALBEDO), medium.g) * sigma_t
    return decay_constant(min(albedo, MOST_ALBEDO), 0.0) / kappa


def _two(
    one: MatchedWalk, measured: Spread, length: float, limits: Limits
) -> tuple[tuple[MatchedWalk, MatchedWalk], float]:
    """Two walks that have the measured R together, the far one's share and both mean free paths by the edge."""
    most = walk_total(MOST_ALBEDO, limits)
    lo, hi = max(measured.total - most, LEAST_SECOND * measured.total), SECOND_WEIGHT * most

    def walks(p: Floats) -> tuple[MatchedWalk, MatchedWalk]:
        second = lo + (hi - lo) / (1 + math.exp(-p[0]))
        first = MatchedWalk(albedo_of_total(measured.total - second, limits), one.mfp_mm * math.exp(p[1]))
        albedo = albedo_of_total(second / SECOND_WEIGHT, limits)
        return first, MatchedWalk(albedo, one.mfp_mm * math.exp(p[2]), SECOND_WEIGHT)

    def off(p: Floats) -> float:
        return _worst(added([walk.spread(limits) for walk in walks(p)]), measured, length)

    coarse = [np.array([share, math.log(a), math.log(b)]) for share in SHARES for a in NEAR for b in FAR]
    best = sorted(coarse, key=off)[:3]
    found = [minimize(off, start, method="Nelder-Mead", options={"maxiter": 200}) for start in best]
    least = min(found, key=lambda each: each.fun)
    return walks(least.x), float(least.fun)
