"""What a model's light may be off by at all radii together, as modes of one sd each, and at each radius for itself.

Shapes as in `light`: q is (b, 1), x and arc are (b, n); pixels lie within ± `arc` [rad] of the line across the view.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bssrdf.transport.arrays import Engine
from bssrdf.transport.light import KNOT_STEP, Light
from bssrdf.transport.white.grid import R_ZERO

TABLE_MODES = 4
"""Cosines along ln r by which a table's own noise is shared: more are too fine to look like a change of σa or σs′."""
TABLE_SHARED = 0.65
"""Size of each over the table's standard error at a radius: one photon of its walk lights many radii. 26 walks of 2e7
to 1e9 photons (rig.sim.peel_off_lanes) lie so far off; were the knots independent it would be 0.2."""
EXIT_MODES = 4
"""Amplitude, slope in ln r, and two that fall as the radius."""
SIDE_MODES = 6
"""The camera's side of an oblique beam: of the curve near the beam, of a mean over azimuths four, and last of R."""
EXIT_NEAR_MFP = 0.5
EXIT_BENDS_MFP = 0.2, 4.0
"""From the first to the second radius the departure turns round."""
EXIT_NEAR, EXIT_NEAR_STEEP, EXIT_NEAR_BY_G = 0.015, 0.14, 1.5
"""Of the light towards a camera at EXIT_NEAR_MFP; the second times sin⁴ of the view inside, all times 1 + the third g².
It falls as the radius: a walk scored at a right angle to the view (bench/camera_walk.py) lies 2 to 8 % off at 0.3 mean
free paths, 1 to 2 % at 1."""
EXIT_NEAR_ASKEW = 0.08
"""The same across the plane of an oblique beam, times 1 − g²: its table has no harmonic beyond the sixth, and walks lie
5 to 12 % below it at 0.6 mean free paths, 2 to 6 % at 1 (bench/oblique_light.py)."""
EXIT_PIVOT_MFP = 5.0
SIDE_NEAR_MFP = 0.22
SIDE_NEAR, SIDE_MEAN, SIDE_TOTAL = (1.0, 3.0), (0.3, 2.2), (0.17, 1.5)
"""How far what a camera sees from one side of an oblique beam may lie from the mean of both, over `slant`: at x mean
free paths the first over x + SIDE_NEAR_MFP, for means over azimuths the second too, of R the third times √|g|. The
second number of each counts by 1 − α′. Walks at 20 to 60°, g 0 to 0.8, α′ 0.67 to 0.98 have 0.4 to 0.9 times as much:
a camera stands in the beam's plane more often than not, where all go one way."""
SIDE_TOGETHER = 0.9
"""Correlation of what the side does to R and to a mean over azimuths."""


def table_modes(e: Engine, model: Light, q: Any, x: Any, first: Any, last: Any) -> tuple[Any, ...]:
    """The table's noise: cosines, as the table counts radii, from the `first` to the `last` that are seen (b, 1)."""
    xp = e.xp
    lo, hi = (xp.log1p(each / R_ZERO) for each in (first, last))
    cosine = xp.cos(np.pi * xp.clip((xp.log1p(x / R_ZERO) - lo) / xp.maximum(hi - lo, KNOT_STEP), 0, 1))
    level = TABLE_SHARED * model.shape_sd(e, q, x)
    cosines = [1 + 0 * cosine, cosine]
    while len(cosines) < TABLE_MODES:
        cosines.append(2 * cosine * cosines[-1] - cosines[-2])
    return level * cosines[0], *(level * (np.sqrt(2) * each) for each in cosines[1:])


def exit_rel_sd(e: Engine, model: Light, x: Any, arc: Any) -> Any:
    """What the exit law may be off by at each radius; all azimuths together it is known better."""
    return model.exit_error_mfp / x * _across(e, arc)


def exit_modes(e: Engine, model: Light, cos_view: float, x: Any, arc: Any) -> tuple[Any, ...]:
    """What the exit law may be off by at all radii together: by the same, by what grows as ln r, and near the beam by
    what falls as the radius, to one side and from one side to the other."""
    xp = e.xp
    g, sin_beam = getattr(model, "g", 0.0), getattr(model, "sin_beam", 0.0)
    amplitude = model.exit_error * xp.ones_like(x)
    near = EXIT_NEAR + EXIT_NEAR_STEEP * ((1 - cos_view**2) / model.eta**2) ** 2
    near = near * (1 + EXIT_NEAR_BY_G * g**2) + (EXIT_NEAR_ASKEW * (1 - g**2) if sin_beam > 0 else 0.0)
    near = near * _across(e, arc) * EXIT_NEAR_MFP / xp.maximum(x, EXIT_NEAR_MFP / 2)
    first, last = EXIT_BENDS_MFP
    turn = xp.cos(np.pi * xp.clip(xp.log(x / first) / np.log(last / first), 0, 1))
    return amplitude, amplitude * _growing(e, x), near, near * np.sqrt(2) * turn


def side_modes(e: Engine, model: Light, cos_view: float, slant: float, q: Any, x: Any, arc: Any) -> tuple[Any, ...]:
    """What the camera's side of an oblique beam, which no slice says, may do to the curve: near the beam; to a mean
    over all azimuths at all radii, by the same and by what grows as ln r, and by light scattered once, whose side is
    known but for the camera's. What it does to R is apart. `slant` is the product of the sines of beam and view inside.
    """
    near = slant * _by_albedo(SIDE_NEAR, q) / (x + SIDE_NEAR_MFP)
    circle = 1 - _across(e, arc)
    mean = slant * _by_albedo(SIDE_MEAN, q) * circle
    once = model.first_by_side(e, q, x, cos_view)
    return near, mean, mean * _growing(e, x), *(each * circle for each in once), 0.0 * x


def side_of_total(model: Light, slant: float, q: Any) -> tuple[Any, ...]:
    """The same of R, which goes mostly with a mean over all azimuths: it is the light under it. Nothing where
    scattering forgets where light came from."""
    off = slant * _by_albedo(SIDE_TOTAL, q) * np.sqrt(abs(getattr(model, "g", 0.0)))
    return 0 * off, SIDE_TOGETHER * off, 0 * off, 0 * off, 0 * off, float(np.sqrt(1 - SIDE_TOGETHER**2)) * off


def _by_albedo(level: tuple[float, float], q: Any) -> Any:
    return level[0] + level[1] * q * q / 3


def _across(e: Engine, arc: Any) -> Any:
    """1 across the view, 0 over all azimuths."""
    return e.xp.abs(e.xp.sinc(2 * arc / np.pi))


def _growing(e: Engine, x: Any) -> Any:
    return e.xp.log(x / EXIT_PIVOT_MFP) / np.log(EXIT_PIVOT_MFP)
