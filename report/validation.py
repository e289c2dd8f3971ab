"""The paper's Fig. 6: measured points, the dipole, and a Monte Carlo simulation, all with the fitted coefficients.

Spot and camera angle are taken off the measured points as the fit allows for them (`report/bare.py`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from bssrdf.holding import held, sample_ratio
from bssrdf.report.bare import bare_curve
from bssrdf.session.records import ChannelFit, Fit, Slice
from bssrdf.transport import (
    DipoleModel,
    ForwardModel,
    MonteCarloMedium,
    dipole,
    scoped_x64,
    simulate,
    table_model,
    tabulated,
    usual_light,
)
from bssrdf.transport.dipole import Medium

PHOTONS = 300_000
BINS = 40
SEED = 6
_CLEAR_SD = 5.0
_DEGREES = {"mc": 3, "dipole": 10}
"""Of the polynomial in ln r that the simulation over the model is taken for."""
COLOURS = {"R": "tab:red", "G": "tab:green", "B": "tab:blue"}


class RingData(NamedTuple):
    """The slice as R_d [1/mm²] of a narrow beam over all directions of exit, per entering flux."""

    r_lo_mm: np.ndarray
    """Edges of the ring that a value is the mean of; equal for a point."""
    r_hi_mm: np.ndarray
    rd: np.ndarray
    clear: np.ndarray
    """Whether a value stands out of its noise; all do where errors are unknown."""

    @property
    def r_mm(self) -> np.ndarray:
        return (self.r_lo_mm + self.r_hi_mm) / 2


@dataclass(frozen=True)
class Check:
    """One channel: the simulation of its fitted coefficients, beside the data over the fit's window."""

    channel: str
    measured: RingData
    r_mm: np.ndarray
    """Centres of the annuli that are simulated."""
    simulated: np.ndarray
    simulated_se: np.ndarray
    total_r: float
    total_r_se: float
    median_departure: float
    """Median of measured/simulated − 1 over the clear values of the window, each over its own ring."""


def validate(
    fit: Fit, piece: Slice, *, photons: int = PHOTONS, progress: Callable[[str, int, int], None] | None = None
) -> list[Check]:
    """Simulate every channel that converged, where σa is known, with the absorbing walk and no table; g is the fit's,
    0 if unknown. `photons` are those of a white medium; dark ones get more."""
    sound = {
        name: channel
        for name, channel in fit.channels.items()
        if channel.status in ("converged", "upper_bound") and math.isfinite(channel.sigma_a_per_mm)
    }
    checks = []
    for number, (name, channel) in enumerate(sound.items()):
        if progress is not None:
            progress(f"simulate {name}", number, len(sound))
        medium = _medium(fit, channel, piece)
        far = min(float(piece.channels[name].r_mm.max()), held(piece).radius)
        edges = np.append(0.0, np.geomspace(far / 300, far, BINS))
        tally = simulate(medium, r_edges_mm=edges, n_photons=_photons(medium, photons), seed=SEED)
        value, error = tally.rd()
        centre = (edges[1:] + edges[:-1]) / 2
        model = _model_of(fit, channel)
        measured = _as_modelled(channel, piece, name)
        found = (channel.sigma_a_per_mm, channel.sigma_sp_per_mm)
        in_sample = partial(sample_ratio, piece, usual_light(piece.eta, piece.g), *found)
        expected = _over_rings(model, Medium(*found, fit.eta), edges, value, error, measured, in_sample)
        departure = _departure(measured, channel.window_mm, expected)
        checks.append(Check(name, measured, centre, value, error, *tally.total_r(), departure))
    return checks


def _medium(fit: Fit, channel: ChannelFit, piece: Slice) -> MonteCarloMedium:
    """Of the coefficients found, held as the sample was; what the fit left out is left out here."""
    by = held(piece)
    g = fit.g or 0.0
    return MonteCarloMedium(
        channel.sigma_a_per_mm,
        channel.sigma_sp_per_mm / (1 - g),
        g,
        fit.eta,
        thickness_mm=by.thickness if math.isfinite(by.thickness) else None,
        backing="air" if piece.backing == "air" else by.back,
        width_mm=2 * by.radius if math.isfinite(by.radius) else None,
        wall=piece.wall or "black",
    )


def _photons(medium: MonteCarloMedium, photons: int) -> int:
    """More where they are absorbed soon, so that dark media take as long and are as smooth."""
    return round(photons * max(1.0, 30 * medium.sigma_a / (medium.sigma_a + medium.sigma_s * (1 - medium.g))))


def _model_of(fit: Fit, channel: ChannelFit) -> ForwardModel:
    """The table where one ships that holds the medium, else the dipole."""
    if tabulated(fit.eta, fit.g):
        table: ForwardModel = jax.tree.map(jnp.asarray, table_model(fit.eta, fit.g or 0.0))
        if 3 * channel.sigma_a_per_mm / (channel.sigma_a_per_mm + channel.sigma_sp_per_mm) < table.q_max**2:
            return table
    return DipoleModel(jnp.asarray(fit.eta))


def _as_modelled(channel: ChannelFit, piece: Slice, name: str) -> RingData:
    """The measured values, less what spot and camera angle do by the fit's own coefficients."""
    data = bare_curve(piece, name, channel.sigma_a_per_mm, channel.sigma_sp_per_mm)
    clear = ~(data.rd_per_mm2 < _CLEAR_SD * data.sd_per_mm2)
    return RingData(data.r_lo_mm, data.r_hi_mm, data.rd_per_mm2, clear)


@scoped_x64
def _over_rings(
    model: ForwardModel,
    medium: Medium,
    edges_mm: np.ndarray,
    rd: np.ndarray,
    rd_se: np.ndarray,
    measured: RingData,
    in_sample: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """The simulated annuli as means over the measured rings.

    The model carries them there: the simulation over the model is smooth, which also takes most of its noise away.
    """
    known = slice(0, _reach(model, medium, edges_mm))
    lo, hi = edges_mm[:-1][known], edges_mm[1:][known]
    of_model = np.asarray(model.bin_average(medium, jnp.asarray(lo), jnp.asarray(hi)))
    of_model = of_model * in_sample(np.sqrt((lo * lo + hi * hi) / 2))
    lit = (rd[known] > 0) & (rd_se[known] > 0)
    log_r = np.log((lo + hi) / 2)
    ratio = np.polynomial.Polynomial.fit(
        log_r[lit], (rd[known] / of_model)[lit], _DEGREES[model.name], w=of_model[lit] / rd_se[known][lit]
    )
    rings = (jnp.asarray(np.minimum(edge, hi[-1])) for edge in (measured.r_lo_mm, measured.r_hi_mm))
    at = np.log(np.clip(measured.r_mm, np.exp(log_r[0]), np.exp(log_r[-1])))
    middle = np.sqrt((measured.r_lo_mm**2 + measured.r_hi_mm**2) / 2)
    return np.asarray(model.bin_average(medium, *rings)) * in_sample(middle) * np.asarray(ratio(at))


def _reach(model: ForwardModel, medium: Medium, edges_mm: np.ndarray) -> int:
    """How many annuli the model holds for: the dipole goes on where its window ends."""
    farthest = edges_mm * float(medium.sigma_tp)
    return len(edges_mm) - 1 if model.name == "dipole" else int(np.searchsorted(farthest, model.window_mfp[1])) - 1


def _departure(measured: RingData, window_mm: tuple[float, float], expected: np.ndarray) -> float:
    lo, hi = window_mm
    inside = (measured.r_mm >= lo) & (measured.r_mm <= hi) & (measured.rd > 0) & measured.clear & (expected > 0)
    return float(np.median(measured.rd[inside] / expected[inside] - 1)) if inside.any() else math.nan


@scoped_x64
def draw_validation(path: Path, fit: Fit, checks: list[Check]) -> None:
    """Draw the figure as PNG, one panel a channel."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5 * len(checks), 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    for number, check in enumerate(checks):
        axes = figure.add_subplot(1, len(checks), number + 1, yscale="log", xlabel="r, mm", ylabel="R_d, 1/mm²")
        channel = fit.channels[check.channel]
        axes.plot(check.measured.r_mm, check.measured.rd, ".", ms=3, color="0.5", label="measured")
        medium = Medium(channel.sigma_a_per_mm, channel.sigma_sp_per_mm, fit.eta)
        axes.plot(check.r_mm, np.asarray(dipole.rd(medium, jnp.asarray(check.r_mm))), "k--", lw=1, label="dipole")
        colour = COLOURS.get(check.channel, "tab:orange")
        axes.plot(check.r_mm, check.simulated, color=colour, lw=1, label="Monte Carlo")
        low = np.maximum(check.simulated - 2 * check.simulated_se, 1e-3 * check.simulated)
        axes.fill_between(check.r_mm, low, check.simulated + 2 * check.simulated_se, color=colour, alpha=0.3, lw=0)
        axes.axvspan(*channel.window_mm, color="0.93", zorder=0)
        axes.set_ylim(bottom=max(np.min(check.simulated[check.simulated > 0]) / 3, 1e-9))
        found = f"σa {channel.sigma_a_per_mm:.3g}, σs′ {channel.sigma_sp_per_mm:.3g}/mm"
        axes.set_title(f"{fit.material or ''} {check.channel}: {found}", fontsize=10)
        axes.legend(fontsize=8)
    figure.savefig(path, dpi=110, format="png")


def validation_text(checks: list[Check]) -> str:
    """One line per channel."""
    return "\n".join(
        f"{check.channel}: Monte Carlo R {check.total_r:.4f} ± {check.total_r_se:.4f}; measured over simulated "
        f"{100 * check.median_departure:+.2f} % (median over the window's clear points)"
        for check in checks
    )
