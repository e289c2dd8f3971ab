"""What measuring and fitting found, in words and numbers, for a person at a terminal."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from bssrdf.session.flags import meaning_of
from bssrdf.session.records import ChannelFit, Fit

if TYPE_CHECKING:
    from bssrdf.measure import Measured


WIDTH = 80
"""Columns of a terminal that has not been made wider."""


def wrapped(lines: Iterable[str], indent: str = "    ") -> str:
    """The lines, those that are too long for a terminal broken between words."""
    return "\n".join(
        part
        for line in lines
        for part in textwrap.wrap(
            line, WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False, drop_whitespace=True
        )
        or [line]
    )


def fit_text(fit: Fit) -> str:
    """Two lines per channel, then each flag once with what it means."""
    head = f"{fit.material or fit.input_path}  (η {fit.eta:g}{'' if fit.g is None else f', g {fit.g:g}'})"
    told = [f"  {key} {_told(value)}" for key, value in fit.about.items()]
    lines = [head, *told]
    for name, channel in fit.channels.items():
        first, *more = _channel(channel)
        lines += [f"  {name:<6} {first}", *(f"  {'':<6} {line}" for line in more)]
    raised = {flag: None for channel in fit.channels.values() for flag in channel.flags}
    for flag in raised:
        names = [name for name, channel in fit.channels.items() if flag in channel.flags]
        lines.append(f"  {', '.join(names)}: {flag}: {meaning_of(flag)}")
    return wrapped(lines)


def _told(value: Any) -> str:
    """As given, by channel too."""
    if isinstance(value, dict):
        return ", ".join(f"{name} {_told(each)}" for name, each in value.items())
    return f"{value:g}" if isinstance(value, float) else str(value)


def _channel(channel: ChannelFit) -> list[str]:
    """The coefficients and the reflectance that they make; then what they rest on."""
    if channel.status in ("rejected", "unidentifiable", "failed"):
        chi2 = "" if math.isnan(channel.chi2_reduced) else f", χ² {channel.chi2_reduced:.2f}"
        return [f"{channel.status}: no number is stated ({channel.model}, {channel.n} radii{chi2})"]
    sigma_sp = f"σs′ {with_error(channel.sigma_sp_per_mm, channel.sigma_sp_sd_per_mm)}/mm"
    if math.isnan(channel.sigma_a_per_mm):
        sigma_a = "σa –"
    elif channel.status == "upper_bound":
        sigma_a = f"σa < {channel.sigma_a_interval95_per_mm[1]:.2g}/mm (95 %)"
    else:
        sigma_a = f"σa {with_error(channel.sigma_a_per_mm, channel.sigma_a_sd_per_mm)}/mm"
    chi2 = "" if math.isnan(channel.chi2_reduced) else f", χ² {channel.chi2_reduced:.2f}"
    lo, hi = channel.window_mm
    return [
        f"{sigma_sp}  {sigma_a}  reflectance {channel.total_r_model:.3f}",
        f"{lo:.2g}–{hi:.3g} mm{chi2}, {_model(channel)}",
    ]


def _model(channel: ChannelFit) -> str:
    """The model, and its own relative error in each coefficient."""
    symbols = {"sigma_sp": "σs′", "sigma_a": "σa"}
    errors = [
        f"{100 * channel.model_error[key]:.2g} % in {symbols[key]}" for key in symbols if key in channel.model_error
    ]
    return f"{channel.model}, model error {' and '.join(errors)}" if errors else channel.model


def with_error(value: float, sd: float) -> str:
    """Value and standard deviation to the digits that the deviation carries."""
    if not (math.isfinite(sd) and sd > 0):
        return f"{value:.3g}"
    digits = max(1 - math.floor(math.log10(sd)), 0)
    return f"{value:.{digits}f} ± {sd:.{digits}f}"


def measured_text(measured: Measured) -> str:
    """The images made; with a slice, R and the extent of the curve by channel, and the flags."""
    lines = [f"merged {kind}: {' × '.join(map(str, hdr.shape))}" for kind, hdr in measured.images.items()]
    if measured.slice is not None:
        for name, channel in measured.slice.channels.items():
            total = "no total reflectance, saturated"
            if name in measured.slice.total_r:
                sd = measured.slice.total_r_sd[name]
                total = f"reflectance {measured.slice.total_r[name]:.4f} ± {sd:.4f} as the camera saw it"
            reach = f"{channel.r_mm[0]:.2g}–{channel.r_mm[-1]:.3g} mm"
            lines.append(f"{name}: {total}, {len(channel.r_mm)} radii, {reach}")
        found = measured.provenance.get("found", {})
        for image, seen in measured.slice.provenance.get("isophotes", {}).items():
            angle = f"view angle {seen['view_angle_deg']:.1f}°" if "view_angle_deg" in seen else "no view angle"
            lines.append(
                f"isophotes of the {image}: {seen['aspect']:.3f} to 1 along the view, ± {seen['aspect_rel_sd']:.3f}: "
                f"{angle} would make circles of them"
            )
        lines += [f"{flag}: {meaning_of(flag)}{_value(found.get(flag))}" for flag in measured.slice.flags]
    return wrapped(lines)


def _value(found: str | None) -> str:
    """What was found of a flag, in figures, where it has any."""
    return f" ({found})" if found else ""
