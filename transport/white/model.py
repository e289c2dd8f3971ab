"""The forward model that a white Monte Carlo table is. JAX comes when light is asked for; `light` has the equations.

Lengths in mm, coefficients in 1/mm.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bssrdf.transport.white.coefficients import Coefficients
from bssrdf.transport.white.grid import Q_MAX, R_MAX

if TYPE_CHECKING:
    from jaxtyping import Array, Float

    from bssrdf.transport.dipole import Medium
    from bssrdf.transport.forward import Azimuths
    from bssrdf.transport.precision import Real


class TableModel(Coefficients):
    """A forward model by the table of one η and g."""

    @property
    def name(self) -> str:
        return "mc"

    @property
    def q_max(self) -> float:
        return float(np.sqrt(3) * Q_MAX)

    @property
    def window_mfp(self) -> tuple[float, float]:
        return (0.0, R_MAX)

    def rd(self, medium: Medium, r: Real) -> Float[Array, "..."]:
        """R_d(r) [1/mm²]; raises InputError outside the table where the values are known."""
        from bssrdf.transport.white import light

        return light.rd(self, medium, r)

    def bin_average(self, medium: Medium, r_lo: Real, r_hi: Real) -> Float[Array, "..."]:
        """Mean of R_d over the annulus [r_lo, r_hi], weighted by r dr."""
        from bssrdf.transport.white import light

        return light.bin_average(self, medium, r_lo, r_hi)

    def total(self, medium: Medium) -> Float[Array, "..."]:
        """Total diffuse reflectance."""
        from bssrdf.transport.white import light

        return light.total(self, medium)

    def radiance(self, medium: Medium, r: Real, mu: Real, azimuths: Azimuths) -> Float[Array, "..."]:
        """π L [1/mm²] at radius r > 0 towards the outside cosine `mu`, a mean over `azimuths`."""
        from bssrdf.transport.white import light

        return light.radiance(self, medium, r, mu, azimuths)

    def total_radiance_factor(self, medium: Medium, mu: Real) -> Float[Array, "..."]:
        """π L/R over the whole surface towards the outside cosine `mu`: 1 for a Lambertian surface."""
        from bssrdf.transport.white import light

        return light.total_radiance_factor(self, medium, mu)
