"""The paper's Fig. 6: measured points, the dipole, and a Monte Carlo simulation, all with the fitted coefficients."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from bssrdf.fit.curves import convention_of
from bssrdf.session.records import Fit, Slice
from bssrdf.transport import dipole
from bssrdf.transport.dipole import Medium
from bssrdf.transport.engine import MonteCarloMedium, simulate
from bssrdf.transport.precision import scoped_x64

PHOTONS = 100_000
BINS = 40
SEED = 6
COLOURS = {"R": "tab:red", "G": "tab:green", "B": "tab:blue"}


@dataclass(frozen=True)
class Check:
    """One channel: the simulation of its fitted coefficients, beside the data over the fit's window."""

    channel: str
    r_mm: np.ndarray
    """Centres of the annuli."""
    simulated: np.ndarray
    simulated_se: np.ndarray
    total_r: float
    total_r_se: float
    median_departure: float
    """Median of measured/simulated − 1 over the window."""


def validate(fit: Fit, piece: Slice, *, progress: Callable[[str, int, int], None] | None = None) -> list[Check]:
    """Simulate every channel that converged, with the absorbing walk and no table; g is the fit's, 0 if unknown."""
    sound = {name: channel for name, channel in fit.channels.items() if channel.status in ("converged", "upper_bound")}
    checks = []
    for number, (name, channel) in enumerate(sound.items()):
        if progress is not None:
            progress(f"simulate {name}", number, len(sound))
        medium = MonteCarloMedium.reduced(channel.sigma_a_per_mm, channel.sigma_sp_per_mm, fit.g or 0.0, fit.eta)
        far = float(piece.channels[name].r_mm.max())
        edges = np.append(0.0, np.geomspace(far / 300, far, BINS))
        tally = simulate(medium, r_edges_mm=edges, n_photons=PHOTONS, seed=SEED)
        value, error = tally.rd()
        centre = (edges[1:] + edges[:-1]) / 2
        checks.append(
            Check(
                name, centre, value, error, *tally.total_r(), _departure(piece, name, channel.window_mm, centre, value)
            )
        )
    return checks


def _departure(piece: Slice, name: str, window_mm: tuple[float, float], r_mm: np.ndarray, rd: np.ndarray) -> float:
    data = piece.channels[name]
    inside = (data.r_mm >= window_mm[0]) & (data.r_mm <= window_mm[1]) & (data.rd_per_mm2 > 0)
    positive = rd > 0
    expected = np.exp(np.interp(np.log(data.r_mm[inside]), np.log(r_mm[positive]), np.log(rd[positive])))
    return float(np.median(data.rd_per_mm2[inside] / convention_of(piece).factor / expected - 1))


@scoped_x64
def draw_validation(path: Path, fit: Fit, piece: Slice, checks: list[Check]) -> None:
    """Draw the figure as PNG, one panel a channel."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5 * len(checks), 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    factor = convention_of(piece).factor
    for number, check in enumerate(checks):
        axes = figure.add_subplot(1, len(checks), number + 1, yscale="log", xlabel="r, mm", ylabel="R_d, 1/mm²")
        data, channel = piece.channels[check.channel], fit.channels[check.channel]
        axes.plot(data.r_mm, data.rd_per_mm2 / factor, ".", ms=3, color="0.5", label="measured")
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
    """One line a channel."""
    return "\n".join(
        f"{check.channel}: Monte Carlo R {check.total_r:.4f} ± {check.total_r_se:.4f}; measured over simulated "
        f"{100 * check.median_departure:+.2f} % (median over the window)"
        for check in checks
    )
