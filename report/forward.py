"""A curve of given coefficients: as slice.csv, which `bssrdf fit` reads, and as a figure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bssrdf.errors import InputError
from bssrdf.session import MM, atomic_write
from bssrdf.transport import Forward, Making, forward_curve

CHANNEL = "curve"
_FROM_MFP, _TO_MFP, _RADII = 0.3, 30.0, 60
"""Radii where none are given: the tables end at some 35 mean free paths of white media."""
_OTHER = {"mc": "dipole", "dipole": "mc"}


def curve_csv(
    r: Sequence[float] | None, *, sigma_a: float, sigma_sp: float, eta: float, g: float, unit: str, model: str,
    making: Making,
) -> str:  # fmt: skip
    """The curve as slice.csv; radii and coefficients are in `unit` and 1/unit, as is what is written."""
    in_mm, found = _found(r, sigma_a, sigma_sp, eta, g, unit, model, making)
    lines = [
        f"## R_d(r) per unit flux that entered, over all directions, by {_called(model)}",
        f"## sigma_a = {sigma_a!r} and sigma_sp = {sigma_sp!r} per {unit}; lengths in {unit}, R_d in 1/{unit}2",
        "# format = 1",
        f"# eta = {eta!r}",
        f"# g = {g!r}",
        '# flux = "entering"',
        '# exit = "hemisphere"',
        *([f'# unit = "{unit}"'] if unit != "mm" else []),
        f"# total_r = {found.total_r!r}",
        f"channel,r_{unit},rd_per_{unit}2,sd_per_{unit}2",
    ]
    rows = zip((found.r_mm / in_mm).tolist(), (found.rd_per_mm2 * in_mm**2).tolist(), strict=True)
    return "\n".join([*lines, *(f"{CHANNEL},{radius!r},{value!r}," for radius, value in rows)])


def draw_curve(
    path: Path, r: Sequence[float] | None, *, sigma_a: float, sigma_sp: float, eta: float, g: float, unit: str,
    model: str, making: Making,
) -> None:  # fmt: skip
    """Draw the curve, the other model beside it where that holds, as PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.5, 4.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(xscale="log", yscale="log", xlabel=f"r, {unit}", ylabel=f"R_d, 1/{unit}²")
    for name in (model, _OTHER[model]):
        try:
            in_mm, found = _found(r, sigma_a, sigma_sp, eta, g, unit, name, making)
        except InputError:
            if name == model:
                raise
            continue  # the dipole does not hold there, or no table can be made
        label = f"{_called(name)}: R {found.total_r:.4f}"
        axes.plot(found.r_mm / in_mm, found.rd_per_mm2 * in_mm**2, "--" if name == "dipole" else "-", label=label)
    axes.set_title(f"σa {sigma_a:g}, σs′ {sigma_sp:g}/{unit}, η {eta:g}, g {g:g}", fontsize=10)
    axes.legend()
    with atomic_write(path) as part:
        figure.savefig(part, dpi=120, format="png")


def _called(model: str) -> str:
    return "the paper's dipole" if model == "dipole" else "Monte Carlo"


def _found(
    r: Sequence[float] | None, sigma_a: float, sigma_sp: float, eta: float, g: float, unit: str, model: str,
    making: Making,
) -> tuple[float, Forward]:  # fmt: skip
    """Millimetres to the unit, and the curve in mm."""
    in_mm = MM[unit]
    if not sigma_sp > 0:
        raise InputError(f"sigma_sp = {sigma_sp:g} must be a finite number > 0")
    mfp = 1 / (max(sigma_a, 0.0) + sigma_sp)
    radii = np.geomspace(_FROM_MFP * mfp, _TO_MFP * mfp, _RADII) if r is None else np.unique(np.asarray(r, float))
    found = forward_curve(
        radii * in_mm,
        sigma_a_per_mm=sigma_a / in_mm,
        sigma_sp_per_mm=sigma_sp / in_mm,
        eta=eta,
        g=g,
        model=model,
        making=making,
    )
    return in_mm, found
