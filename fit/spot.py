"""What a finite spot does to the curve. A Gaussian spot of 1/e² radius w spreads R_d(r) over the disc of the spot."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bssrdf.fit.curves import RADII_FROM_SPOT
from bssrdf.fit.predict import Parameters, Scalar, curve
from bssrdf.transport.forward import ForwardModel

_T, _T_WEIGHTS = np.polynomial.laguerre.laggauss(6)
_ANGLES = (np.arange(8) + 0.5) * np.pi / 8


MATTERS = 0.2
"""Of the data's relative sd: a smaller effect of the spot is left out."""


def matters(spot_radius_mm: float, r_mm: np.ndarray, relative_sd: float) -> bool:
    """Whether the spot changes the innermost radius used by a share of its error; R_d ~ 1/r² to 1/r³ there."""
    innermost = max(float(r_mm.min()), RADII_FROM_SPOT * spot_radius_mm)
    return bool(spot_radius_mm > 0 and 9 / 8 * (spot_radius_mm / innermost) ** 2 > MATTERS * relative_sd)


Radii = Float[Array, " n"]


def blur(
    model: ForwardModel,
    point: Parameters,
    r: Radii,
    spot_radius: Scalar,
    exit_factor: Callable[[Radii, Radii], Radii],
) -> Radii:
    """What is seen through the spot at r, over R_d of an infinitely narrow beam.

    Mean of R_d(d) exit_factor(d, sin δ), d = r − ρ and δ its angle to r, over the spot's irradiance
    2/(πw²) e^(−2ρ²/w²): Gauss–Laguerre in 2ρ²/w², midpoints in angle.
    """
    bare = curve(model, point, r, r, False)

    def add(sum_so_far: Float[Array, " n"], node: tuple[Scalar, ...]) -> tuple[Float[Array, " n"], None]:
        rho_over_w, cos_angle, sin_angle, weight = node
        rho = rho_over_w * spot_radius
        distance = jnp.sqrt(jnp.maximum(r * r + rho * rho - 2 * r * rho * cos_angle, 1e-6 * spot_radius**2))
        light = curve(model, point, distance, distance, False) * exit_factor(distance, rho * sin_angle / distance)
        return sum_so_far + weight * light, None

    rho, angle = np.meshgrid(np.sqrt(_T / 2), _ANGLES, indexing="ij")
    weights = np.repeat(_T_WEIGHTS / len(_ANGLES), len(_ANGLES))
    nodes = tuple(
        jnp.asarray(each, r.dtype) for each in (rho.ravel(), np.cos(angle).ravel(), np.sin(angle).ravel(), weights)
    )
    blurred, _ = jax.lax.scan(add, jnp.zeros_like(r), nodes)
    return jnp.where(spot_radius > 0, blurred / bare, exit_factor(r, jnp.zeros_like(r)))
