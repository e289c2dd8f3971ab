"""`peel_off` for many photons at once, in JAX: the same light, so fast on a GPU that its noise does not count.

Each lane walks one photon after the other. What is started is followed to its end, so that nothing is cut off: lanes
that ran dry are taken out while the last photons go on. Lengths in 1/σt.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from bssrdf.rig.sim.peel_off import PeeledMedium

Array = NDArray[np.float64]

BATCHES = 32
"""Lanes whose light is counted apart, for its errors."""
_ROULETTE_BELOW, _SURVIVORS_WEIGHT, _FAINT = 0.1, 0.3, 25.0
_STEPS_A_CALL = 256
_LEAST_LANES = 4096


class _Lanes(NamedTuple):
    at: Any
    """(3, n): place."""
    along: Any
    """(3, n): direction."""
    weight: Any
    """(n,), 0 where the lane has run dry."""
    order: Any
    """(n,): collisions so far."""
    batch: Any


def peel_off_lanes(
    medium: PeeledMedium,
    r_first: float,
    bins_per_e_fold: float,
    shape: tuple[int, int],
    *,
    photons: int,
    seed: int,
    lanes: int = 1 << 19,
) -> tuple[Array, Array]:
    """`around` and `line` of `peel_off` per photon, by batch: (BATCHES, *shape) and (BATCHES, n_r).

    Photons are started until there are that many, as many more as the lanes start meanwhile.
    """
    with jax.enable_x64(True):
        key = jax.random.key(seed, impl="rbg")
        n_r, n_phi = shape
        scores, started = jnp.zeros(BATCHES * n_r * (n_phi + 1)), jnp.zeros(BATCHES, jnp.int64)
        flying = _fresh(jnp.arange(lanes) % BATCHES, jnp.ones(lanes), medium)
        started += lanes // BATCHES
        layout = (r_first, bins_per_e_fold, n_r, n_phi)
        call = 0
        while True:
            refill = int(started.sum()) < photons
            flying, scores, started = _walk_on(
                flying, scores, started, jax.random.fold_in(key, call), tuple(medium), layout, refill=refill
            )
            call += 1
            if not refill:
                alive = np.flatnonzero(np.asarray(flying.weight) > 0)
                if not alive.size:
                    break
                flying = _packed(flying, alive)
        each = np.asarray(started, float)
        light = np.asarray(scores).reshape(BATCHES, n_r, n_phi + 1) / each[:, None, None]
        return light[:, :, :-1], light[:, :, -1]


def _packed(flying: _Lanes, alive: NDArray[np.intp]) -> _Lanes:
    """The lanes that still walk; in eighths of the lanes, so that few sizes are compiled."""
    size = flying.weight.size
    while size // 8 >= max(alive.size, _LEAST_LANES):
        size //= 8
    if size == flying.weight.size:
        return flying
    chosen = np.resize(alive, size)
    on = jnp.arange(size) < alive.size
    taken = _Lanes(*(each[..., chosen] for each in flying))
    return taken._replace(weight=jnp.where(on, taken.weight, 0.0))


def _fresh(batch: Any, weight: Any, medium: PeeledMedium) -> _Lanes:
    zero = jnp.zeros_like(weight)
    sine = medium.sin_beam / medium.eta
    along = jnp.stack([zero, zero + sine, zero + jnp.sqrt(1 - sine**2)])
    return _Lanes(jnp.stack([zero, zero, zero]), along, weight, jnp.zeros(weight.shape, jnp.int32), batch)


@functools.partial(jax.jit, static_argnames=("layout", "refill"), donate_argnums=(0, 1, 2))
def _walk_on(
    flying: _Lanes, scores: Any, started: Any, key: Any, medium: tuple[float, ...], layout: Any, *, refill: bool
) -> tuple[_Lanes, Any, Any]:
    def step(number: Any, carry: tuple[_Lanes, Any, Any]) -> tuple[_Lanes, Any, Any]:
        drawn = jax.random.uniform(jax.random.fold_in(key, number), (4, carry[0].weight.size), jnp.float64)
        return _collide(*carry, drawn, PeeledMedium(*medium), layout, refill)

    return jax.lax.fori_loop(0, _STEPS_A_CALL, step, (flying, scores, started))


def _collide(
    flying: _Lanes, scores: Any, started: Any, drawn: Any, medium: PeeledMedium, layout: Any, refill: bool
) -> tuple[_Lanes, Any, Any]:
    (x, y, z), (ux, uy, uz), weight = flying.at, flying.along, flying.weight
    d = -jnp.log1p(-drawn[0])
    leaves = z + d * uz < 0
    to_surface = jnp.where(leaves, -z / jnp.where(leaves, uz, -1.0), 0.0)
    weight *= jnp.where(leaves, _reflectance_inside(medium.eta, -uz), 1.0)
    x, y, z, d = x + ux * to_surface, y + uy * to_surface, jnp.where(leaves, 0.0, z), d - to_surface
    uz = jnp.where(leaves, -uz, uz)
    at_back = z + d * uz > medium.thickness
    d = jnp.where(at_back, (medium.thickness - z) / jnp.where(at_back, uz, 1.0), d)
    x, y, z = x + ux * d, y + uy * d, z + uz * d
    weight *= jnp.where(at_back, medium.back, medium.albedo)
    order = flying.order + 1
    scores = _score(scores, medium, layout, (x, y, z), (ux, uy, uz), weight, at_back, order, flying.batch)
    weak = weight < _ROULETTE_BELOW
    lives = drawn[1] * _SURVIVORS_WEIGHT <= weight
    weight = jnp.where(weak, jnp.where(lives & (weight > 0), _SURVIVORS_WEIGHT, 0.0), weight)
    along = _scattered(medium.g, jnp.stack([ux, uy, uz]), at_back, drawn[2], drawn[3])
    moved = _Lanes(jnp.stack([x, y, z]), along, weight, order, flying.batch)
    if not refill:
        return moved, scores, started
    ended = weight == 0
    new = _fresh(flying.batch, jnp.ones_like(weight), medium)
    started += jnp.zeros_like(started).at[flying.batch].add(ended)
    chosen = (jnp.where(jnp.broadcast_to(ended, b.shape), a, b) for a, b in zip(new, moved, strict=True))
    return _Lanes(*chosen), scores, started


def _score(
    scores: Any,
    medium: PeeledMedium,
    layout: Any,
    at: Any,
    along: Any,
    weight: Any,
    at_back: Any,
    order: Any,
    batch: Any,
) -> Any:
    """Add each collision's light towards the camera; that of the first to the line, which is the last column."""
    r_first, per_e_fold, n_r, n_phi = layout
    sin_inside = jnp.sqrt(1 - medium.cos_outside**2) / medium.eta
    cos_inside = jnp.sqrt(1 - sin_inside**2)
    passing = (1 - _reflectance_inside(medium.eta, cos_inside)) / (medium.eta**2 * cos_inside)
    g, depth = medium.g, at[2] / cos_inside
    cos_theta = along[1] * sin_inside - along[2] * cos_inside
    phase = (1 - g * g) / (4 * jnp.pi) * (1 + g * g - 2 * g * cos_theta) ** -1.5
    light = weight * jnp.where(at_back, cos_inside / jnp.pi, phase) * jnp.exp(-depth) * passing
    out = at[1] + depth * sin_inside
    r = jnp.hypot(at[0], out)
    ring = jnp.where(r < r_first, 0, 1 + jnp.floor(jnp.log(jnp.maximum(r, r_first) / r_first) * per_e_fold))
    turn = jnp.arccos(jnp.clip(out / jnp.maximum(r, 1e-300), -1, 1)) / jnp.pi * n_phi
    column = jnp.where(order == 1, n_phi, jnp.minimum(turn.astype(jnp.int32), n_phi - 1))
    seen = (depth < _FAINT) & (ring < n_r) & (light > 0)
    index = (batch * n_r + jnp.minimum(ring, n_r - 1).astype(jnp.int32)) * (n_phi + 1) + column
    return scores.at[index].add(jnp.where(seen, light, 0.0))


def _scattered(g: float, along: Any, at_back: Any, u: Any, v: Any) -> Any:
    """A new direction: Henyey–Greenstein's, or upwards from a diffuse back."""
    small = jnp.abs(g) < 1e-4  # the closed form divides by g; here it is its own first order
    k = jnp.where(small, 1.0, g)
    even = 2 * u - 1
    t = (1 - k * k) / (1 - k + 2 * k * u)
    cos = jnp.clip(jnp.where(small, even + 1.5 * g * (1 - even**2), (1 + k * k - t * t) / (2 * k)), -1, 1)
    cos = jnp.where(at_back, jnp.sqrt(1 - u), cos)
    ux, uy, uz = jnp.where(at_back[None], jnp.array([0.0, 0.0, -1.0])[:, None], along)
    sin = jnp.sqrt(1 - cos * cos)
    p, q = sin * jnp.cos(2 * jnp.pi * v), sin * jnp.sin(2 * jnp.pi * v)
    sign = jnp.where(uz < 0, -1.0, 1.0)  # an orthonormal basis about u: Duff et al. 2017
    a = -1 / (sign + uz)
    b = ux * uy * a
    new = jnp.stack(
        [
            cos * ux + p * (1 + sign * ux * ux * a) + q * b,
            cos * uy + p * sign * b + q * (sign + uy * uy * a),
            cos * uz - p * sign * ux - q * uy,
        ]
    )
    return new / jnp.sqrt(jnp.sum(new * new, axis=0, keepdims=True))


def _reflectance_inside(eta: Any, cos_inside: Any) -> Any:
    """Fr for unpolarised light that meets the surface from inside."""
    outside = jnp.sqrt(jnp.maximum(1 - eta * eta * (1 - cos_inside * cos_inside), 0.0))
    r_s = (eta * cos_inside - outside) / (eta * cos_inside + outside)
    r_p = (cos_inside - eta * outside) / (cos_inside + eta * outside)
    return jnp.where(outside > 0, (r_s * r_s + r_p * r_p) / 2, 1.0)
