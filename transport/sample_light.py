"""What back and wall make of curve and total near a point, how far that may be off, and what errors of both do.

The curve's ratio to a half space (`finite`) is worked out at the point, and goes on from there to first order in ln σt′
and q², in which it is smooth at q = 0; the total's is worked out wherever it is asked for.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from bssrdf.transport.arrays import Engine
from bssrdf.transport.finite import (
    Sample,
    change,
    changes,
    half_space,
    level_of_change,
    level_of_half_space,
    of_change,
    top_of,
    total_ratio,
)
from bssrdf.transport.light import SMALLEST_Q, Light, Look
from bssrdf.transport.q_root import root_of_total
from bssrdf.transport.slab import fine, rough

CURVE_OFF = 0.015
"""Of the square of ln ratio, at all radii together: how far it departs from the engine's walks, +7 % at ln −2
(docs/finite-samples.md). Twice that at each radius for itself, so that such radii do not decide on the depth."""
TOTAL_OFF = 0.01
"""Of the logarithm of the total's."""
WALL_MFP, WALL_OFF = 10.0, 0.12
"""A dish's wall as near as this takes that much more of ln ratio than diffusion says, and of the total's as much again
as TOTAL_OFF; one farther away less, by the square. The engine's walks of 3.5 million photons, at 10.5 mean free paths:
7 ± 1 % (black) and 14 ± 1 % (air) of the curve's, R 0.33 ± 0.04 % lower; at 17.5 and 28 none is seen, to 1.5 %."""
LEAST_STEP, MOST_STEP = 1e-3, 0.3
"""Of a depth, over which a difference is taken."""
MOST_AHEAD = 1.0
SMALLEST_TOTAL_Q = 1e-5
"""In place of 0, where R has no slope in q."""


class SampleRatio(NamedTuple):
    """ln of the ratio to a half space near where it was worked out, and what that answers to one sd of each error."""

    log_ratio: Any
    by_log_sigma: Any
    by_q2: Any
    log_sigma: Any
    q2: Any
    by_thickness: Any
    by_back: Any
    """(b, u)."""
    by_lengths: Any
    """(b, u): by ln of all the sample's own lengths."""
    log_total: Any
    total_by_thickness: Any
    total_by_back: Any
    nearness: Any
    """(b, 1): of a dish's wall, (WALL_MFP/distance)²; 0 for a slab."""


def curve_off(laid: SampleRatio) -> Any:
    """What the curve's ratio may be off by, relative."""
    return CURVE_OFF * laid.log_ratio * laid.log_ratio + WALL_OFF * laid.nearness * abs(laid.log_ratio)


def total_off(laid: SampleRatio) -> Any:
    """What the total's may be off by, relative, (b, 1)."""
    return TOTAL_OFF * (1 + laid.nearness) * abs(laid.log_total)


def sampled(
    e: Engine,
    model: Light,
    dish: bool,
    sample: Sample,
    log_sigma: Any,
    q: Any,
    r: Any,
    *,
    thickness_rel_sd: Any,
    back_sd: Any,
    plain: bool,
) -> SampleRatio:
    """At a point, at radii r (b, u), with the answers to these errors (b, 1); `plain` leaves those out."""
    xp = e.xp
    top = top_of(model)
    half = half_space(e, top, q, xp.exp(log_sigma) * r)

    def log_total(held: Sample) -> Any:
        return xp.log(total_ratio(e, dish, held, top, log_sigma, q)[0])

    here = of_change(e, half, change(e, dish, sample, top, log_sigma, q, r))
    aq = xp.maximum(xp.abs(q), SMALLEST_Q)
    zero = xp.zeros_like(here[0])
    near = xp.square(WALL_MFP / (xp.exp(log_sigma) * sample.radius_mm)) if dish else 0 * q
    laid = SampleRatio(
        *here[:2], here[2] * xp.sign(q) / (2 * aq), log_sigma, q * q,
        zero, zero, zero, log_total(sample), 0 * q, 0 * q, near,
    )  # fmt: skip
    if plain:
        return laid
    step = xp.clip(thickness_rel_sd, LEAST_STEP, MOST_STEP)
    others = _aside(e, dish, sample, step, back_sd)
    less = changes(e, dish, fine(), others, sample, top, log_sigma, q, r)
    moved = _halves([level_of_change(e, half[0], each) for each in less])
    total_moved = _halves([log_total(each) for each in others[:4]])
    share = thickness_rel_sd / step
    return laid._replace(
        by_thickness=moved[0] * share,
        by_back=moved[1],
        by_lengths=moved[-1 if dish else 0] / step,
        total_by_thickness=total_moved[0] * share,
        total_by_back=total_moved[1],
    )


def _halves(pairs: list[Any]) -> list[Any]:
    """Half the difference of each pair."""
    return [(pairs[k] - pairs[k + 1]) / 2 for k in range(0, len(pairs), 2)]


def _aside(e: Engine, dish: bool, sample: Sample, step: Any, back_sd: Any) -> tuple[Sample, ...]:
    """Pairs of samples: deeper and shallower; on a brighter back and a darker, which stays one; and all larger."""
    xp = e.xp
    deeper, shallower = (sample._replace(thickness_mm=sample.thickness_mm * (1 + sign * step)) for sign in (1, -1))
    brighter, darker = (sample._replace(back=xp.clip(sample.back + sign * back_sd, 0.0, 1.0)) for sign in (1, -1))
    found = (deeper, shallower, brighter, darker)
    if not dish:
        return found
    return (
        *found,
        *(
            each._replace(radius_mm=sample.radius_mm * (1 + sign * step))
            for each, sign in ((deeper, 1), (shallower, -1))
        ),
    )


def further(e: Engine, laid: SampleRatio, log_sigma: Any, q: Any) -> Look:
    """ln of the ratio at a point near by, and its slopes."""
    xp = e.xp
    move = laid.by_log_sigma * (log_sigma - laid.log_sigma) + laid.by_q2 * (q * q - laid.q2)
    return laid.log_ratio + xp.clip(move, -MOST_AHEAD, MOST_AHEAD), laid.by_log_sigma, 2 * q * laid.by_q2


def total_look(e: Engine, model: Light, dish: bool, sample: Sample, log_sigma: Any, q: Any) -> Look:
    """R of the sample, and its slopes by ln σt′ and q; even in q."""
    value, by_q = model.total(e, e.xp.abs(q))
    ratio, ratio_s, ratio_q = total_ratio(e, dish, sample, top_of(model), log_sigma, e.xp.abs(q))
    return value * ratio, value * ratio_s, e.xp.where(q < 0, -1.0, 1.0) * (by_q * ratio + value * ratio_q)


def q_of_sample(e: Engine, model: Light, dish: bool, sample: Sample, log_sigma: Any, total_r: Any) -> Any:
    """The q at which the sample's R is nearest to the one measured."""

    def total(q: Any, fixed: Any) -> tuple[Any, Any]:
        value, _, slope = total_look(e, model, dish, fixed[0], fixed[1], e.xp.maximum(q, SMALLEST_TOTAL_Q))
        return value, slope

    return root_of_total(e, total, model.q_max, total_r, (sample, log_sigma))


def scanned(e: Engine, model: Light, sample: Sample, log_sigma: Any, q: Any, r: Any) -> Any:
    """ln of the ratio of a slab at many scales (b, s) with q (b, s), at r (b, n): (b, s, n)."""
    b, s = log_sigma.shape
    flat = lambda each: each.reshape(-1, 1)  # noqa: E731
    tiled = Sample(*(flat(each + 0 * log_sigma) for each in sample))
    radii = (r[:, None, :] + 0 * log_sigma[:, :, None]).reshape(b * s, -1)
    top = top_of(model)
    half = level_of_half_space(e, top, flat(q), e.xp.exp(flat(log_sigma)) * radii)
    (less,) = changes(e, False, rough(), (tiled,), tiled, top, flat(log_sigma), flat(q), radii)
    return level_of_change(e, half, less).reshape(b, s, -1)
