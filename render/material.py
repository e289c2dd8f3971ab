"""The medium of a scene: a line of the published table or a fit, as coefficients in red, green and blue.

Lengths in mm, coefficients in 1/mm; scenes are in mm too.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from bssrdf.errors import InputError
from bssrdf.session import read_fit
from bssrdf.session.records import Fit
from bssrdf.transport import CHANNELS, Rgb, find_material

HALF_ALBEDO = "Marble-half"
"""The hard case of the paper's section 5: marble with absorption raised to a reduced albedo of 0.5."""
_USABLE = ("converged", "upper_bound")


@dataclass(frozen=True)
class RenderMaterial:
    """A homogeneous medium, one value per channel, and its Henyey-Greenstein mean cosine."""

    name: str
    sigma_a: Rgb
    sigma_sp: Rgb
    eta: float
    g: float = 0.0

    @property
    def sigma_s(self) -> Rgb:
        """σs = σs′/(1 − g)."""
        return _rgb(sp / (1 - self.g) for sp in self.sigma_sp)

    @property
    def mean_free_path(self) -> Rgb:
        """1/σt′."""
        return _rgb(1 / (a + sp) for a, sp in zip(self.sigma_a, self.sigma_sp, strict=True))

    @property
    def albedo(self) -> Rgb:
        """α′."""
        return _rgb(sp / (a + sp) for a, sp in zip(self.sigma_a, self.sigma_sp, strict=True))

    @property
    def diffuse_mean_free_path(self) -> Rgb:
        """1/σtr; infinite without absorption."""
        return _rgb(
            1 / math.sqrt(3 * a * (a + sp)) if a > 0 else math.inf
            for a, sp in zip(self.sigma_a, self.sigma_sp, strict=True)
        )


def find_medium(name: str, *, g: float | None = None) -> RenderMaterial:
    """The medium of a published name, `Marble-half`, or the path of a fit.json or of a session that holds one.

    `g` replaces the medium's own at the same σs′. Raises InputError where there is no such medium.
    """
    if g is not None and not -1 < g < 1:
        raise InputError(f"g {g:g} is not a mean cosine; give a value between -1 and 1")
    path = Path(name)
    if path.suffix == ".json" or path.is_dir():
        return medium_of_fit(read_fit(path / "fit.json" if path.is_dir() else path), g=g)
    if name.lower() == HALF_ALBEDO.lower():
        marble = find_medium("Marble")
        half = _rgb((a + sp) / 2 for a, sp in zip(marble.sigma_a, marble.sigma_sp, strict=True))
        return RenderMaterial(HALF_ALBEDO, half, half, marble.eta, g or 0.0)
    try:
        line = find_material(name)
    except InputError as error:
        raise InputError(f"{error}, {HALF_ALBEDO}, or the path of a fit.json") from error
    return RenderMaterial(line.name, line.sigma_a_per_mm, line.sigma_sp_per_mm, line.eta, g or 0.0)


def medium_of_fit(fit: Fit, *, g: float | None = None) -> RenderMaterial:
    """The medium of a fit with the channels R, G and B; InputError where one is missing or was not found."""
    name = fit.material or fit.input_path
    missing = [channel for channel in CHANNELS if channel not in fit.channels]
    if missing:
        raise InputError(
            f"the fit of {name} lacks the channel {missing[0]}: it has {', '.join(fit.channels)}; "
            "a picture needs R, G and B"
        )
    for channel in CHANNELS:
        if fit.channels[channel].status not in _USABLE:
            raise InputError(f"the fit of {name} is {fit.channels[channel].status} in {channel}; measure it again")
    channels = [fit.channels[channel] for channel in CHANNELS]
    return RenderMaterial(
        name,
        _rgb(max(channel.sigma_a_per_mm, 0.0) for channel in channels),
        _rgb(channel.sigma_sp_per_mm for channel in channels),
        fit.eta,
        g if g is not None else fit.g or 0.0,
    )


def _rgb(values: Iterable[float]) -> Rgb:
    red, green, blue = values
    return (red, green, blue)
