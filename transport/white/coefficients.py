"""The numbers of a white Monte Carlo table of one η and g. Lengths in mm, coefficients in 1/mm."""

from __future__ import annotations

from typing import Any, NamedTuple


class Coefficients(NamedTuple):
    """Monte Carlo light of a half space of one η and g, as spline coefficients: `assembly` makes them.

    Its arrays are NumPy's; as a pytree it goes into compiled functions as it is.
    """

    eta: Any
    g: Any
    log_curve: Any
    """(u, 4, v): S of `smooth`; along u splines' coefficients, along v cubics by cell."""
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
    """(u, k, 4, v): shape of the exit radiance of the light scattered twice or more, see `smooth`."""
    total_angles: Any
    """(k, 4, u): the same of the total, over all azimuths."""
