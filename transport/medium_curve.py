"""The forward question: R_d(r) and R of given coefficients, by table and by dipole. Lengths in mm."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bssrdf.errors import InputError
from bssrdf.transport.arrays import NUMPY
from bssrdf.transport.incidence import NORMAL
from bssrdf.transport.light import NEAREST_MFP, Light, dipole, shape_of
from bssrdf.transport.light_tables import SILENT, Making, light_table
from bssrdf.transport.white.store import ETA_RANGE

Floats = NDArray[np.float64]


class Forward(NamedTuple):
    """What leaves a half space, per unit flux that entered, over all directions."""

    r_mm: Floats
    rd_per_mm2: Floats
    total_r: float


def forward_curve(
    r_mm: ArrayLike,
    *,
    sigma_a_per_mm: float,
    sigma_sp_per_mm: float,
    eta: float,
    g: float = 0.0,
    model: str = "mc",
    making: Making = SILENT,
) -> Forward:
    """R_d(r) [1/mm²] at radii of shape (n,), and R, of the Monte Carlo table (`mc`) or the paper's `dipole`.

    InputError where a value is out of its range. A table that does not ship is made, and `making` is told.
    """
    r = np.atleast_1d(np.asarray(r_mm, float))
    _check(r, sigma_a_per_mm, sigma_sp_per_mm, eta, g, model)
    light: Light = light_table(eta, g, NORMAL, "make", making) if model == "mc" else dipole(eta)
    log_sigma, q = shape_of(sigma_a_per_mm, sigma_sp_per_mm)
    if q > light.q_max:
        raise InputError(
            f"sigma_a = {sigma_a_per_mm:g} is too large beside sigma_sp = {sigma_sp_per_mm:g} for the model {model}; "
            f"it holds up to sigma_a/sigma_sp = {light.q_max**2 / max(3 - light.q_max**2, 1e-9):.3g}"
        )
    sigma, row = float(np.exp(log_sigma)), np.full((1, 1), q)
    look = light.look(NUMPY, row, np.maximum(sigma * r, NEAREST_MFP)[None])
    return Forward(r, sigma**2 * look[0][0], float(light.total(NUMPY, row)[0][0, 0]))


def _check(r: Floats, sigma_a: float, sigma_sp: float, eta: float, g: float, model: str) -> None:
    def refuse(name: str, value: object, remedy: str) -> None:
        raise InputError(f"{name} = {value} {remedy}")

    if r.ndim != 1 or not r.size:
        refuse("r_mm", f"array of shape {r.shape}", "must be a list of radii")
    if not (np.isfinite(r) & (r >= 0)).all():
        refuse("r_mm", r[~(np.isfinite(r) & (r >= 0))][0], "must be 0 or more; radii count from the beam outwards")
    if not 0 <= sigma_a < np.inf:
        refuse("sigma_a", sigma_a, "must be a finite number >= 0")
    if not 0 < sigma_sp < np.inf:
        refuse("sigma_sp", sigma_sp, "must be a finite number > 0")
    if not ETA_RANGE[0] <= eta <= ETA_RANGE[1]:
        refuse("eta", eta, f"must lie from {ETA_RANGE[0]:g} to {ETA_RANGE[1]:g}")
    if not -1 < g < 1:
        refuse("g", g, "must lie between -1 and 1")
    if model not in ("mc", "dipole"):
        refuse("model", repr(model), "must be one of mc, dipole")
