"""A session of known light, made with plain numpy noise: a curve in closed form, filmed at 45° by a camera of RGGB."""

from pathlib import Path

import numpy as np
from builders import film, of_kinds

from bssrdf.session.records import Beam, Camera, Geometry, Material, Reference, Session

EXPOSURES_S = [0.001 * 4**k for k in range(7)]
BLACK, WHITE, GAIN, READ_NOISE_E = 500, 16383, 4.0, 3.0
MM_PER_PX, VIEW_DEG, RHO = 0.05, 45.0, 0.98
SHAPE = (120, 160)


def falloff(r_mm):
    """A curve [1/mm²] that is known in closed form: two Gaussians and an exponential tail."""
    return 0.8 * np.exp(-((r_mm / 0.5) ** 2)) + 0.05 * np.exp(-r_mm)


TOTAL = np.pi * 0.8 * 0.5**2 + 2 * np.pi * 0.05


def picture(curve, centre=(82.3, 57.6), shape=SHAPE):
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    total = np.zeros(shape)
    for dx in (-1 / 3, 0, 1 / 3):
        for dy in (-1 / 3, 0, 1 / 3):
            u = (x + dx - centre[0]) * MM_PER_PX
            v = (y + dy - centre[1]) * MM_PER_PX / np.cos(np.radians(VIEW_DEG))
            total += curve(np.hypot(u, v)) / 9
    return total


def tile(r_mm):
    return RHO * 3.0 * np.exp(-6 * r_mm**2) * 2 / np.pi


def write_session(
    path: Path,
    *,
    seed=0,
    sample=falloff,
    reference=tile,
    layout="RGGB",
    shape=SHAPE,
    e_per_s=None,
    sd=0.0049,
    aside=(0.0, 0.0),
):
    """`aside`: where the spots fall, in pixels from where they would."""
    dx, dy = aside
    pictures = {
        "sample": picture(sample, (82.3 + dx, 57.6 + dy), shape),
        "reference": picture(reference, (80 + dx, 60 + dy), shape),
    }
    e_per_s = e_per_s or 0.8 * (WHITE - BLACK) * GAIN / EXPOSURES_S[0] / max(p.max() for p in pictures.values())
    session = Session(
        path,
        Camera(layout, BLACK, WHITE, GAIN, READ_NOISE_E),
        Material("wax", 1.4),
        Geometry(MM_PER_PX, view_angle_deg=VIEW_DEG, view_angle_sd_deg=0.2, mm_per_px_rel_sd=0.001),
        Beam(channels=("633nm",) if layout == "mono" else None),
        Reference("tile", (RHO,), (sd,)),
    )
    light, rng = of_kinds(pictures, e_per_s), np.random.default_rng(seed)
    return film(session, light, EXPOSURES_S, rng, gain_e_per_dn=GAIN, read_noise_e=READ_NOISE_E)
