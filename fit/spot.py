"""What a finite spot does to the curve. A Gaussian spot of 1/e² radius w spreads R_d(r) over the disc of the spot."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bssrdf.fit.curves import RADII_FROM_SPOT
from bssrdf.fit.predict import Scalar

_T, _T_WEIGHTS = np.polynomial.laguerre.laggauss(6)
_ANGLES = (np.arange(8) + 0.5) * np.pi / 8


MATTERS = 0.2
"""Of the data's relative sd: a smaller effect of the spot is left out."""


def matters(spot_radius_mm: float, r_mm: np.ndarray, relative_sd: float) -> bool:
    """Whether the spot changes the innermost radius used by a share of its error; R_d ~ 1/r² to 1/r³ there."""
    innermost = max(float(r_mm.min()), RADII_FROM_SPOT * spot_radius_mm)
    return bool(spot_radius_mm > 0 and 9 / 8 * (spot_radius_mm / innermost) ** 2 > MATTERS * relative_sd)


Radii = Float[Array, " n"]


def blur(light: Callable[[Radii, Radii], Radii], r: Radii, spot_radius: Scalar) -> Radii:
    """What a spot makes at r of the light around an infinitely narrow beam.

    Mean of light(d, sin δ), d = r − ρ and δ its angle to r, over the spot's irradiance 2/(πw²) e^(−2ρ²/w²):
    Gauss–Laguerre in 2ρ²/w², midpoints in angle.
    """

    def add(sum_so_far: Float[Array, " n"], node: tuple[Scalar, ...]) -> tuple[Float[Array, " n"], None]:
        rho_over_w, cos_angle, sin_angle, weight = node
        rho = rho_over_w * spot_radius
        distance = jnp.sqrt(jnp.maximum(r * r + rho * rho - 2 * r * rho * cos_angle, 1e-6 * spot_radius**2))
        return sum_so_far + weight * light(distance, rho * sin_angle / distance), None

    rho, angle = np.meshgrid(np.sqrt(_T / 2), _ANGLES, indexing="ij")
    weights = np.repeat(_T_WEIGHTS / len(_ANGLES), len(_ANGLES))
    nodes = tuple(
        jnp.asarray(each, r.dtype) for each in (rho.ravel(), np.cos(angle).ravel(), np.sin(angle).ravel(), weights)
    )
    return jax.lax.scan(add, jnp.zeros_like(r), nodes)[0]
