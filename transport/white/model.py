"""The white Monte Carlo table of one η and g: numbers, and a forward model of them. JAX comes when light is asked for.

Lengths in mm, coefficients in 1/mm. The equations are in `table_light`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bssrdf.transport.white.grid import Q_MAX, R_MAX

if TYPE_CHECKING:
    from jaxtyping import Array, Float

    from bssrdf.transport.dipole import Medium
    from bssrdf.transport.forward import Azimuths
    from bssrdf.transport.precision import Real


class TableModel(NamedTuple):
    """Monte Carlo light of a half space of one η and g, as spline coefficients; `table_assembly` makes it.

    Its arrays are NumPy's; as a pytree it goes into compiled functions as it is.
    """

    eta: Any
    g: Any
    log_curve: Any
    """(u, 4, v): S of `table_fit`; along u splines' coefficients, along v cubics by cell."""
    log_curve_sd: Any
    """(q, v): its standard error at the knots: relative error of the light scattered twice or more."""
    diffusion_ratio: Any
    """(4, u): κ²/(3 σa σt′), 1 at albedo 1."""
    log_total: Any
    """(4, u): −ln(R/α′)."""
    first: Any
    """(4, w): ln(ρ R⁽¹⁾/(σs σt)) + first_decay ρ along ln(1 + ρ/RHO_ZERO), ρ = σt r."""
    first_decay: Any
    angles: Any
    """(u, k, 4, v): shape of the exit radiance of the light scattered twice or more, see `table_fit`."""
    total_angles: Any
    """(k, 4, u): the same of the total, over all azimuths."""

    @property
    def name(self) -> str:
        return "mc"

    @property
    def q_max(self) -> float:
        return float(np.sqrt(3) * Q_MAX)

    @property
    def window_mfp(self) -> tuple[float, float]:
        return (0.0, R_MAX)

    @property
    def relative_error(self) -> float:
        return 0.003

    @property
    def exit_error_mfp(self) -> float:
        return 0.008  # docs/white-tables.md

    def rd(self, medium: Medium, r: Real) -> Float[Array, "..."]:
        """R_d(r) [1/mm²]; raises InputError outside the table where the values are known."""
        from bssrdf.transport.white import light as table_light

        return table_light.rd(self, medium, r)

    def bin_average(self, medium: Medium, r_lo: Real, r_hi: Real) -> Float[Array, "..."]:
        """Mean of R_d over the annulus [r_lo, r_hi], weighted by r dr."""
        from bssrdf.transport.white import light as table_light

        return table_light.bin_average(self, medium, r_lo, r_hi)

    def total(self, medium: Medium) -> Float[Array, "..."]:
        """Total diffuse reflectance."""
        from bssrdf.transport.white import light as table_light

        return table_light.total(self, medium)

    def radiance(self, medium: Medium, r: Real, mu: Real, azimuths: Azimuths) -> Float[Array, "..."]:
        """π L [1/mm²] at radius r > 0 towards the outside cosine `mu`, a mean over `azimuths`."""
        from bssrdf.transport.white import light as table_light

        return table_light.radiance(self, medium, r, mu, azimuths)

    def total_radiance_factor(self, medium: Medium, mu: Real) -> Float[Array, "..."]:
        """π L/R over the whole surface towards the outside cosine `mu`: 1 for a Lambertian surface."""
        from bssrdf.transport.white import light as table_light

        return table_light.total_radiance_factor(self, medium, mu)
