"""Diffusion in a round dish under a point source on its axis: what its wall takes from a slab's light, as in `finite`.

A sum over the slab's modes in depth, which falls as fast with the distance of the wall. Shapes q (b, 1), share (b, n).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from bssrdf.transport.arrays import Engine
from bssrdf.transport.light import SMALLEST_Q, Look
from bssrdf.transport.slab import Top

_MODES = np.arange(1, 41)
_NEWTON = 8
_DISH_NODES = 14
_U = np.arange(31) * 0.2
"""To where e^(−u²) is gone."""
_U_WEIGHTS = 0.2 * np.where(_U > 0, 2.0, 1.0) * np.exp(-_U * _U)


class Dish(NamedTuple):
    """Depth and radius in mean free paths, and 1/z of back and wall, (b, 1) each."""

    tau: Any
    back: Any
    omega: Any
    wall: Any


class Modes(NamedTuple):
    """Modes of a slab in depth, (b, modes): sin(p z + arctan p z), with slopes by ln σt′."""

    p: Any
    p_s: Any
    share: Any
    """Of K0(κ r)/2π in F."""
    share_s: Any


def slab_modes(e: Engine, top: Top, loss: Any, tau: Any, numbers: Any = _MODES) -> Modes:
    """p τ + arctan p z + arctan p/h = m π: a concave left side, so Newton's steps come from below."""
    xp = e.xp
    m, z0 = xp.asarray(numbers) * np.pi, top.z
    p = xp.maximum((m - np.pi) / tau, m / (tau + z0 + 1 / xp.maximum(loss, 1e-9)))  # both lie below
    for _ in range(_NEWTON):
        slope = tau + z0 / (1 + xp.square(p * z0)) + loss / (loss * loss + p * p)
        phase = xp.arctan2(p * (loss * z0 + 1), loss - p * p * z0)  # of both arcs
        p = p - (p * tau + phase - m) / slope
    at_top = z0 / (1 + xp.square(p * z0))
    length = tau + at_top + loss / (loss * loss + p * p)
    phase = xp.arctan(p * z0)
    source, out = xp.sin(p * top.source + phase), p * xp.cos(phase)
    share = 2 * source * out / length
    length_p = -2 * p * (z0 * at_top * at_top + loss / xp.square(loss * loss + p * p))
    share_p = 2 * (
        xp.cos(p * top.source + phase) * (top.source + at_top) * out + source * (xp.cos(phase) - out * p * z0 * at_top)
    )
    p_s = -p * tau / length
    return Modes(p, p_s, share, (share_p * p_s - share * (length_p * p_s + tau)) / length)


class _AtWall(NamedTuple):
    """Modes at a dish's wall: y = κω, η = 1/(z κ), and D = η I0 + I1 over e^y, with what slopes need."""

    modes: Modes
    kappa: Any
    y: Any
    eta: Any
    y_by: tuple[Any, Any]
    """By ln σt′ and q; so the others."""
    eta_by: tuple[Any, Any]
    i: tuple[Any, Any]
    d: Any
    d_y: Any


def _at_wall(e: Engine, dish: Dish, top: Top, aq: Any) -> _AtWall:
    xp = e.xp
    modes = slab_modes(e, top, dish.back, dish.tau)
    kappa = xp.sqrt(modes.p * modes.p + aq * aq)
    y, eta = kappa * dish.omega, dish.wall / kappa
    log_by = (modes.p * modes.p_s / (kappa * kappa), aq / (kappa * kappa))
    i0, i1 = _bessel_i(e, y)
    return _AtWall(
        modes,
        kappa,
        y,
        eta,
        (y * (1 + log_by[0]), y * log_by[1]),
        (-eta * log_by[0], -eta * log_by[1]),
        (i0, i1),
        eta * i0 + i1,
        eta * i1 + i0 - i1 / y,
    )


def of_wall(e: Engine, dish: Dish, top: Top, q: Any, share: Any) -> Look:
    """What the wall changes at this share of its radius: −Σ c (η K0 − K1)/(η I0 + I1) I0(κ x)/2π."""
    xp = e.xp
    aq = xp.maximum(xp.abs(q), SMALLEST_Q)
    at = _at_wall(e, dish, top, aq)
    b, b_y = _answer(xp, at)
    b_eta = 1 / (at.y * at.d * at.d)
    c, c_s = at.modes.share, at.modes.share_s
    by_s, by_q = (c * (b_y * at.y_by[k] + b_eta * at.eta_by[k]) for k in (0, 1))
    of_i0 = xp.stack([c * b, c_s * b + by_s, by_q], axis=1)
    of_i1 = (c * b)[:, None] * xp.stack([0 * b, *at.y_by], axis=1)
    inner, faded = _inside(xp, at.y)
    i0, i1 = _bessel_i(e, inner)
    sums = xp.matmul(of_i0, i0 * faded) + xp.matmul(of_i1, i1 * faded) * xp.asarray(_ROOTS)
    value, by_s, by_q = _along(xp, sums, share)
    return value, by_s, xp.sign(q) * by_q


def changed_by_wall(e: Engine, dish: Dish, top: Top, q: Any, share: Any) -> Any:
    """The value alone."""
    xp = e.xp
    at = _at_wall(e, dish, top, xp.maximum(xp.abs(q), SMALLEST_Q))
    inner, faded = _inside(xp, at.y)
    of_i0 = (at.modes.share * _answer(xp, at)[0])[:, None]
    return _along(xp, xp.matmul(of_i0, e.special.i0e(inner) * faded), share)[0]


def _answer(xp: Any, at: _AtWall) -> tuple[Any, Any]:
    """(η K0 − K1)/D over e^(−2y), and its slope by y but for that."""
    k0, k1 = _bessel_k(xp, at.y)
    b = (at.eta * k0 - k1) / at.d
    return b, (k0 - at.eta * k1 + k1 / at.y - b * at.d_y) / at.d


def _inside(xp: Any, y: Any) -> tuple[Any, Any]:
    """κ x at the nodes along the radius, (b, modes, nodes), and what of the light there is left of the wall's."""
    inner = y[..., None] * xp.asarray(_ROOTS)
    return inner, xp.exp(inner - 2 * y[..., None])


def taken_by_wall(e: Engine, dish: Dish, top: Top, aq: Any) -> Look:
    """Σ c η/(κ² D): what a slab would send up and the wall does not, (b, 1)."""
    xp = e.xp
    at = _at_wall(e, dish, top, aq)
    gone = xp.exp(-at.y)
    each = at.eta * gone / (at.kappa * at.kappa * at.d)
    found = [(at.modes.share * each).sum(1, keepdims=True)]
    for k, own in ((0, at.modes.share_s), (1, 0.0)):
        log_kappa = -at.eta_by[k] / at.eta
        d_by = at.eta_by[k] * at.i[0] + at.d_y * at.y_by[k]
        moved = at.modes.share * each * (-3 * log_kappa - d_by / at.d)
        found.append((own * each + moved).sum(1, keepdims=True))
    return found[0], found[1], found[2]


def _bessel_i(e: Engine, y: Any) -> tuple[Any, Any]:
    """e^(−y) I0 and I1."""
    return e.special.i0e(y), e.special.i1e(y)


def _bessel_k(xp: Any, y: Any) -> tuple[Any, Any]:
    """e^y K0 and K1 = ∫ e^(y − y cosh t) cosh nt dt, over u² = y (cosh t − 1): good to 1e-11 from y = 0.4 on."""
    u2 = xp.asarray(_U * _U)
    each = xp.asarray(_U_WEIGHTS) / xp.sqrt(2 * y[..., None] + u2)
    k0 = each.sum(-1)
    return k0, k0 + (each * u2).sum(-1) / y


_SQUARES = (1 + np.cos((np.arange(_DISH_NODES) + 0.5) * np.pi / _DISH_NODES)) / 2
_ROOTS = np.sqrt(_SQUARES)
_TO_SERIES = np.linalg.inv(np.polynomial.chebyshev.chebvander(2 * _SQUARES - 1, _DISH_NODES - 1)).T
"""From values at the squares of radii to Chebyshev's series."""


def _along(xp: Any, sums: Any, share: Any) -> list[Any]:
    """Sums over modes (b, k, nodes) at shares of the radius: polynomials in its square to the digits that count."""
    series = xp.matmul(sums / (-2 * np.pi), xp.asarray(_TO_SERIES))
    basis = _chebyshev(xp, 2 * xp.square(xp.minimum(share, 1.0)) - 1)
    return [sum(series[:, k, j, None] * t for j, t in enumerate(basis)) for k in range(sums.shape[1])]


def _chebyshev(xp: Any, v: Any) -> list[Any]:
    basis = [xp.ones_like(v), v]
    while len(basis) < _DISH_NODES:
        basis.append(2 * v * basis[-1] - basis[-2])
    return basis
