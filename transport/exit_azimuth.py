"""How the light that leaves a surface depends on the azimuth of the camera, from a white table. No JAX.

Far from the beam light still runs outwards. Seen from an angle, the even part of it is brighter along the plane of view
than across: π L ∝ 1 + a cos 2φ, φ the azimuth from that plane. So the isophotes of a round spot are not quite circles.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bssrdf.transport.exit_radiance import DEGREE, across_basis, shape_basis
from bssrdf.transport.white.archive import TableSet, lagrange
from bssrdf.transport.white.grid import N_U_COARSE, N_V_COARSE, R_MAX, R_ZERO, U_MAX, V_MAX, basis, u_of

Floats = NDArray[np.float64]


def second_harmonic(tables: TableSet, eta: float, g: float, q: float, r_mfp: Floats, view_angle_deg: float) -> Floats:
    """`a` of light scattered twice or more, at radii in 1/σt′; q = √(1 − α′) names the medium.

    η and g are drawn into the grid of the tables: the harmonic varies slowly with them.
    """
    eta, g = (float(np.clip(x, nodes[0], nodes[-1])) for x, nodes in ((eta, tables.etas), (g, tables.gs)))
    weights = np.outer(lagrange(tables.gs, g), lagrange(tables.etas, eta))
    coefficients = np.tensordot(weights, tables.angles, 2)
    along_u = basis(np.array([u_of(q)]), U_MAX, N_U_COARSE)
    along_v = basis(np.log1p(np.minimum(r_mfp, R_MAX) / R_ZERO), V_MAX, N_V_COARSE)
    shapes = along_v @ np.tensordot(along_u[0], coefficients, 1)
    mu = np.cos(np.radians([view_angle_deg]))
    lobe, across = shapes[:, : DEGREE + 1] @ shape_basis(eta, mu)[0], shapes[:, DEGREE + 1 :] @ across_basis(eta, mu)[0]
    return np.asarray(-across / lobe)
