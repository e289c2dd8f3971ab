"""Diffusion in a slab under a point source: closed forms over the transverse wavenumber, as in `finite`.

Shapes q (b, 1), ξ (b, n). The lengths z of Robin's condition are those of exact transport.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from bssrdf.transport.arrays import Engine
from bssrdf.transport.light import SMALLEST_Q, Look, transmittance

MILNE = 0.710446
"""z of a black face, in mean free paths."""
FARTHEST = 16.0
"""In thicknesses: farther out no ratio is known."""
H_STEPS = 200
_KNOTS = 112
"""Along arcsinh ξ."""


class Hankel(NamedTuple):
    """Gauss's for Hankel's integral, and its values at knots."""

    k: Any
    """In 1/τ."""
    transform: Any
    """(k, knots): weights of ∫ k J0(kξ) … dk/2π."""
    farthest: float
    """ξ of the last knot."""


@lru_cache(maxsize=2)
def rule(nodes: int, most_k: float, farthest: float) -> Hankel:
    """Enough nodes for J0 at the farthest knot, half as many as radians there and some."""
    from scipy.special import j0

    at, weights = np.polynomial.legendre.leggauss(nodes)
    k = most_k / 2 * (1 + at)
    xi = np.sinh(np.linspace(0, np.arcsinh(farthest), _KNOTS))
    return Hankel(k, (k * weights * most_k / (4 * np.pi))[:, None] * j0(k[:, None] * xi), farthest)


def fine() -> Hankel:
    """To where e^(−2kτ) is gone."""
    return rule(192, 18.0, FARTHEST)


def rough() -> Hankel:
    """Good to 1e-6 of the light on the axis."""
    return rule(64, 9.0, FARTHEST / 2)


class Spectrum(NamedTuple):
    """F at some μ, and its slopes."""

    value: Any
    by_mu: Any
    by_tau: Any


class Top(NamedTuple):
    """How deep the source lies under the surface, and z of that."""

    source: Any
    z: float


@lru_cache(maxsize=64)
def milne(eta: float) -> float:
    """z of a smooth face to air, by exact transport: light without absorption that diffuses out of a half space.

    Chandrasekhar's H gives what the bare medium sends out and back in; with Fresnel's R inside, the intensity upwards
    is I = H + ½ H ∫ μ′ H/(μ + μ′) R I dμ′, and z = ∫ μ² (1 + R) I dμ/∫ μ (1 − R) I dμ.
    """
    nodes, weights = np.polynomial.legendre.leggauss(48)
    half, weights = (1 + nodes) / 2, weights / 2
    if eta == 1:
        return MILNE
    grazing = np.sqrt(max(1 - 1 / eta**2, 0.0))
    mu = np.concatenate(
        [max(grazing, 1e-9) * half, grazing + (1 - grazing) * half**2]
    )  # R has the slope of a root there
    w = np.concatenate([grazing * weights, (1 - grazing) * 2 * half * weights])
    inward = mu / (mu[:, None] + mu)
    h = np.ones_like(mu)
    for _ in range(H_STEPS):
        h = (h + 1 / (inward @ (w * h / 2))) / 2
    back = 1 - transmittance(np, 1 / eta, mu)
    up = np.linalg.solve(np.eye(mu.size) - h[:, None] * inward * (w * h * back / 2), h)
    return float((w * mu**2 * (1 + back) * up).sum() / (w * mu * (1 - back) * up).sum())


def air_back(eta: float) -> float:
    """The diffuse reflectance that does what a smooth face to air does."""
    share = (milne(eta) - MILNE) * 3 / 4
    return share / (1 + share)


def loss_of(rho: Any) -> Any:
    """1/z of a face, z = MILNE + 4/3 ρ/(1 − ρ)."""
    return (1 - rho) / (MILNE * (1 - rho) + 4 / 3 * rho)


class _Passed(NamedTuple):
    """What `spectrum` is made of: (1 − e^(−2μx))/μ and e^(−2μx) below the source and of the whole, and the fraction."""

    down: Any
    down_e: Any
    whole: Any
    whole_e: Any
    above: Any
    bottom: Any


def _passed(xp: Any, top: Top, loss: Any, tau: Any, mu: Any) -> _Passed:
    down, down_e = _passes(xp, mu, xp.maximum(tau - top.source, 0.0))
    whole, whole_e = _passes(xp, mu, tau)
    above = down * loss + 1 + down_e
    bottom = whole * (loss + mu * mu * top.z) + (1 + whole_e) * (1 + top.z * loss)
    return _Passed(down, down_e, whole, whole_e, above, bottom)


def spectrum(e: Engine, top: Top, loss: Any, tau: Any, mu: Any) -> Spectrum:
    """F of a slab: e^(−μs) (E₁ h + 1 + e₁)/(E (h + μ² z) + (1 + e)(1 + z h)), h = 1/z of the back, `loss`.

    e = e^(−2μτ), E = (1 − e)/μ; e₁ and E₁ the same of τ − s, s the depth of the source.
    """
    xp = e.xp
    z0 = top.z
    below = xp.maximum(tau - top.source, 0.0)
    _, down_e, whole, whole_e, above, bottom = _passed(xp, top, loss, tau, mu)
    above_mu = _passes_slope(xp, mu, below, down_e) * loss - 2 * below * down_e
    whole_mu = _passes_slope(xp, mu, tau, whole_e)
    bottom_mu = whole_mu * (loss + mu * mu * z0) + 2 * mu * z0 * whole - 2 * tau * whole_e * (1 + z0 * loss)
    value = xp.exp(-mu * top.source) * above / bottom
    by_mu = value * (above_mu / above - bottom_mu / bottom - top.source)
    by_tau = value * (
        2 * down_e * (loss - mu) / above - 2 * whole_e * (loss + mu * mu * z0 - mu * (1 + z0 * loss)) / bottom
    )
    return Spectrum(value, by_mu, by_tau)


def _passes(xp: Any, mu: Any, depth: Any) -> tuple[Any, Any]:
    """(1 − e^(−2μx))/μ and e^(−2μx)."""
    gone = xp.expm1(-2 * mu * depth)
    return -gone / mu, 1 + gone


def _passes_slope(xp: Any, mu: Any, depth: Any, gone: Any) -> Any:
    """Of the former by μ, a series where both its terms are nearly as large."""
    y = 2 * mu * depth
    near = y < 0.1
    safe = xp.where(near, 1.0, y)
    few = xp.where(near, y, 0.0)
    slope = xp.where(near, _series(few), (gone * (1 + y) - 1) / (safe * safe))
    return 4 * depth * depth * slope


_SERIES = [(-1) ** (n + 1) * (n + 1) / math.factorial(n + 2) for n in range(8)]
"""Of d/dy (1 − e^(−y))/y, by powers of y."""


def _series(y: Any) -> Any:
    value = _SERIES[-1]
    for term in _SERIES[-2::-1]:
        value = value * y + term
    return value


def of_back(e: Engine, top: Top, loss: Any, tau: Any, q: Any, xi: Any) -> Look:
    """What a back at depth τ changes at the radii ξ τ: ∫ k J0(k x) (F − F_half) dk/2π."""
    xp = e.xp
    aq, k, mu = _wavenumbers(xp, fine(), tau, q)
    slab = spectrum(e, top, loss, tau, mu)
    half = xp.exp(-mu * top.source) / (1 + mu * top.z)
    by_mu = (slab.by_mu + half * (top.source + top.z / (1 + mu * top.z))) / mu
    value = slab.value - half
    by_s = tau * slab.by_tau - k * k * by_mu - 2 * value
    value, by_s, by_q = _transformed(e, fine(), [value, by_s, aq * by_mu], tau, xi)
    return value, by_s, xp.sign(q) * by_q


def changed_by_backs(
    e: Engine, by: Hankel, top: Top, backs: Sequence[tuple[Any, Any]], tau: Any, q: Any, xi: Any
) -> list[Any]:
    """The value alone, of several backs (`loss`, depth) no farther from τ than a third, at the radii ξ τ."""
    _, _, mu = _wavenumbers(e.xp, by, tau, q)
    every = [_passed(e.xp, top, loss, depth, mu) for loss, depth in backs]
    fallen, half = e.xp.exp(-mu * top.source), 1 / (1 + mu * top.z)
    return _transformed(e, by, [fallen * (one.above / one.bottom - half) for one in every], tau, xi)


def _wavenumbers(xp: Any, by: Hankel, tau: Any, q: Any) -> tuple[Any, Any, Any]:
    """|q|, k and μ."""
    aq = xp.maximum(xp.abs(q), SMALLEST_Q)
    k = xp.asarray(by.k) / tau
    return aq, k, xp.sqrt(aq * aq + k * k)


def _transformed(e: Engine, by: Hankel, rows: list[Any], tau: Any, xi: Any) -> list[Any]:
    """Hankel's transforms of rows (b, k) at ξ (b, n)."""
    stacked = e.xp.stack(rows, axis=1) / (tau * tau)[:, :, None]
    b, n, nodes = stacked.shape
    at_knots = e.xp.matmul(stacked.reshape(b * n, nodes), e.xp.asarray(by.transform))  # one product: much the fastest
    return _interpolated(e, by.farthest, at_knots.reshape(b, n, _KNOTS), xi)


def _interpolated(e: Engine, farthest: float, rows: Any, xi: Any) -> list[Any]:
    """Rows (b, k, knots), even in arcsinh ξ, at ξ (b, n): cubics through four knots."""
    xp = e.xp
    t = xp.arcsinh(xp.minimum(xi, farthest)) * ((_KNOTS - 1) / float(np.arcsinh(farthest)))
    first = xp.clip(t.astype(xp.int32) - 1, 0, _KNOTS - 4)
    f = t - first
    a, b, c = f - 1, f - 2, f - 3
    weights = (-a * b * c / 6, f * b * c / 2, -f * a * c / 2, f * a * b / 6)
    taken = [e.take(rows, first + i) for i in range(4)]
    return [sum(w * t[k] for w, t in zip(weights, taken, strict=True)) for k in range(rows.shape[1])]
