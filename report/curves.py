"""R_d(r) of each channel beside the model, the dipole and a simulation, with standardised residuals: to be drawn."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from bssrdf.report.bare import Bare, bare_curve, model_of
from bssrdf.report.plot import Axis, bars, dots, line
from bssrdf.report.validation import Check
from bssrdf.session.records import ChannelFit, Fit, Slice

WIDTH, CURVE_HEIGHT, RESIDUAL_HEIGHT = 640, 330, 130
_LEFT, _RIGHT, _TOP, _GAP, _BOTTOM = 62, 12, 8, 16, 40
_DEEPEST = 1e-9
"""Of the largest value: fainter ones are not drawn."""
_MOST_Z = 8.0
"""Residuals beyond are drawn at the edge."""


class CurvePanel(NamedTuple):
    """One channel of one slice, as numbers for the script and as lines for print."""

    title: str
    data: dict[str, Any]
    """Columns by radius, None where a series has no value there."""
    svg: dict[str, Any]
    note: str


def panel(
    title: str, curve: Slice, channel: str, found: ChannelFit | None, fit: Fit | None, check: Check | None
) -> CurvePanel:
    """The panel; without trusted coefficients the curve alone, as it was measured."""
    stated = fit is not None and found is not None and found.sigma_sp_per_mm > 0 and found.sigma_a_per_mm >= 0
    if not stated or found is None:
        part = curve.channels[channel]
        nothing = np.full_like(part.r_mm, np.nan)
        seen = Bare(part.r_mm, part.r_mm, part.rd_per_mm2, part.sd_per_mm2, nothing, nothing)
        note = "as measured: no coefficients are stated, so that no model can be drawn"
        window = (math.nan, math.nan)
    else:
        model = model_of(curve, found.model)
        seen = bare_curve(curve, channel, found.sigma_a_per_mm, found.sigma_sp_per_mm, model)
        note, window = "as a model has it: spot, camera angle and specular share taken off", found.window_mm
    if check is not None:
        note += f"; Monte Carlo: R {check.total_r:.4f} ± {check.total_r_se:.4f}"
        if math.isfinite(check.median_departure):
            note += f", measured over simulated {100 * check.median_departure:+.2f} %"
    hidden = int(np.count_nonzero(~(seen.rd_per_mm2 > 0)))
    if hidden:
        note += f"; {hidden} values at or below 0 cannot be drawn on a log axis"
    columns = _columns(seen, check)
    return CurvePanel(title, {**columns, "window": list(window) if math.isfinite(window[0]) else None},
                 _svg(columns, window), note)  # fmt: skip


def _columns(seen: Bare, check: Check | None) -> dict[str, list[float | None]]:
    """All series over one ascending column of radii."""
    order = np.argsort(seen.r_mm, kind="stable")
    r, rd, sd, model, dipole = (
        each[order] for each in (seen.r_mm, seen.rd_per_mm2, seen.sd_per_mm2, seen.model_per_mm2, seen.dipole_per_mm2)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        z = (rd - model) / sd
    columns = {"r": r, "rd": rd, "lo": rd - sd, "hi": rd + sd, "model": model, "dipole": dipole, "z": z}
    if check is not None:
        columns = {name: np.append(each, np.full(len(check.r_mm), np.nan)) for name, each in columns.items()}
        columns["r"][len(r) :] = check.r_mm
        columns["mc"] = np.append(np.full(len(r), np.nan), check.simulated)
    else:
        columns["mc"] = np.full(len(r), np.nan)
    columns = {name: each[np.argsort(columns["r"], kind="stable")] for name, each in columns.items()}
    lit = columns["r"] > 0
    top = float(np.nanmax(np.where(columns["rd"] > 0, columns["rd"], 0), initial=0.0)) or 1.0
    for name in ("rd", "lo", "hi", "model", "dipole", "mc"):
        columns[name] = np.where(columns[name] > _DEEPEST * top, columns[name], np.nan)
    columns["lo"] = np.where(np.isfinite(columns["rd"]) & np.isnan(columns["lo"]), _DEEPEST * top, columns["lo"])
    return {name: [_short(value) for value in each[lit].tolist()] for name, each in columns.items()}


def _short(value: float) -> float | None:
    return float(f"{value:.4g}") if math.isfinite(value) else None


def _svg(columns: dict[str, list[float | None]], window: tuple[float, float]) -> dict[str, Any]:
    """Paths and ticks of the printed figure."""
    values = {name: np.array([math.nan if v is None else v for v in each], float) for name, each in columns.items()}
    right, middle = WIDTH - _RIGHT, _TOP + CURVE_HEIGHT
    x = Axis.log(values["r"], _LEFT, right)
    y = Axis.log(np.concatenate([values[name] for name in ("rd", "model", "mc")]), middle, _TOP)
    z_top = middle + _GAP
    reach = min(_MOST_Z, max(3.0, float(np.nanmax(np.abs(values["z"]), initial=0.0))))
    z = Axis(-reach, reach, z_top + RESIDUAL_HEIGHT, z_top, is_log=False)
    shown_z = np.clip(values["z"], -reach, reach)
    return {
        "width": WIDTH,
        "height": z_top + RESIDUAL_HEIGHT + _BOTTOM,
        "x": x,
        "y": y,
        "z": z,
        "window": [x(edge) for edge in window] if math.isfinite(window[0]) else None,
        "bars": bars(x, y, values["r"], values["lo"], values["hi"]),
        "dots": dots(x, y, values["r"], values["rd"]),
        "model": line(x, y, values["r"], values["model"]),
        "dipole": line(x, y, values["r"], values["dipole"]),
        "mc": line(x, y, values["r"], values["mc"]),
        "z_dots": dots(x, z, values["r"], shown_z),
    }
