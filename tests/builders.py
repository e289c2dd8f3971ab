"""The builders that tests share: of slices from light, and of sessions from pictures. Lengths in mm."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from bssrdf.session.records import ChannelSlice, Slice
from bssrdf.transport.dipole import Medium
from bssrdf.transport.forward import ForwardModel

Floats = NDArray[np.float64]


def slice_of(
    r_mm: Floats,
    rd: Floats,
    *,
    edges: tuple[Floats, Floats] | None = None,
    noise: float = 0.0,
    sd: float | Floats = 0.01,
    total_r: float | None = None,
    total_noise: float = 0.0,
    total_sd: float = 0.002,
    seed: int = 0,
    **keys: Any,
) -> Slice:
    """A slice of one channel, G, of light R_d [1/mm²] and R.

    `noise` is drawn and `sd` is stated, both relative; so are those of R. `keys` are those of a Slice, by default per
    entering flux over the hemisphere.
    """
    rng = np.random.default_rng(seed)
    values = rd * (1 + noise * rng.standard_normal(rd.size))
    known = {} if total_r is None else {"G": total_r * (1 + total_noise * rng.standard_normal())}
    sds = {"G": total_sd * total_r} if total_r is not None and total_sd else {}
    channel = ChannelSlice(r_mm, values, sd * np.abs(rd), *(edges or ()))
    given = {"eta": 1.3, "flux": "entering", "exit": "hemisphere", "total_r": known, "total_r_sd": sds, **keys}
    return Slice({"G": channel}, **given)


def model_slice(
    model: ForwardModel, sigma_a: float, sigma_sp: float, r_mfp: Floats, *, factor: float = 1.0, **keys: Any
) -> Slice:
    """The light of a model at radii in mean free paths, curve and R times `factor`; `keys` as in `slice_of`."""
    r_mm = r_mfp / (sigma_a + sigma_sp)
    rd, total_r = model_light(model, sigma_a, sigma_sp, r_mm)
    return slice_of(r_mm, factor * rd, total_r=factor * total_r, **{"eta": float(model.eta), **keys})


def model_light(model: ForwardModel, sigma_a: float, sigma_sp: float, r_mm: Floats) -> tuple[Floats, float]:
    """R_d [1/mm²] and R of a medium, in double precision."""
    with jax.enable_x64(True):
        medium = Medium(sigma_a, sigma_sp, float(model.eta))
        return np.asarray(model.rd(medium, r_mm)), float(model.total(medium))
