"""The answer first: which numbers can be trusted, what limits them, and what to do next."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

from bssrdf.session.records import ChannelFit, Fit

Trust = Literal["yes", "care", "bound", "no"]
_WORD: dict[Trust, str] = {
    "yes": "can be trusted",
    "care": "can be trusted with care",
    "bound": "gives an upper bound of σa",
    "no": "cannot be trusted",
}
_WORDS: dict[Trust, str] = _WORD | {"bound": "give upper bounds of σa"}

SOURCES = {
    "noise": "noise of the frames",
    "total": "total reflectance R",
    "scale": "reference (scale of curve and R)",
    "length": "length scale (mm per pixel)",
    "spot": "radius of the beam's spot",
    "view": "view angle",
    "exit_law": "exit law across the view",
    "side": "camera's side of the oblique beam",
    "table": "Monte Carlo table's own noise",
    "eta": "index of refraction η",
    "g": "mean cosine g",
    "misfit": "misfit of curve and model",
}
REMEDY = {
    "noise": "add repeats of the longest exposures of the sample, or a brighter beam",
    "total": "film a wider field so that less light leaves the frame, and repeat the frames that hold the spot",
    "scale": "use a reference with a tighter certificate, and state its reflectance_sd",
    "length": "measure mm_per_px on a target with `bssrdf calibrate geometry`",
    "spot": "measure the spot with `bssrdf calibrate spot`, or narrow it",
    "view": "measure the view angle with `bssrdf calibrate geometry`, and state view_angle_sd_deg",
    "exit_law": "film a second view angle, or measure with --radial",
    "side": "let the beam fall in along the normal, or film along it",
    "table": "nothing on the bench helps: the Monte Carlo table itself is the limit",
    "eta": "measure η, and state eta_sd",
    "g": "measure g, or find it with `bssrdf fit --fit-g`",
    "misfit": "look where the residuals run: a wrong g or η, glare, or a broad colour channel",
}
_OF_FLAG = {
    "total_inconsistent": "R and curve contradict each other: check the reference, its exposures, and mm_per_px",
    "shape_misfit": "the curve has another shape than any such medium: check η, g and the sample's thickness",
    "g_suspect": "the curve fits another g better: give g, or run `bssrdf fit --fit-g`",
    "eta_suspect": "the curve fits another η better: check eta",
    "spot_suspect": "near the beam the curve is that of a spot: give spot_radius_mm, or narrow --window-mm",
    "few_radii": "too few radii lie in the window: film nearer, with a narrower beam",
    "noise": "the curve is lost in noise: add longer exposures or a brighter beam",
    "not_converged": "the search did not settle: fit with --model mc, or fewer radii with --window-mm",
    "sigma_a_unidentifiable": "σa has no upper end: measure the total reflectance, or film a wider field",
    "albedo_one": "R is 1 within its error: for σa a better certificate of the reference is needed",
    "total_at_limit": "R is beyond what any medium reflects: check the reference's reflectance",
    "total_unknown": "measure the total reflectance: the fit is badly conditioned without",
    "window_short": "film a wider field: the curve ends before 1/σtr",
    "light_lost": "film a wider field: light left the frame",
    "poor_fit": "the curve departs from the model beyond its errors: look where the residuals run",
    "poor_fit_runs": "residuals run on one side: look for glare, dust or a wrong g",
    "scale_suspect": "check the units: radii in mm, R_d in 1/mm²",
    "single_scattering": "fit with --model mc: the dipole does not hold where absorption outweighs scattering",
    "thin_sample": "use a thicker sample",
    "narrow_sample": "use a wider sample",
    "saturated": "add shorter exposures: the spot is saturated in all",
    "robust_advised": "fit with --robust: a few radii lie far off",
}
"""What to do about a flag, the gravest first."""
LARGE = 0.1
"""Of a coefficient: beyond such an error, statistical or of the model, a number is rough."""
_GRAVE = frozenset(_OF_FLAG) - {"robust_advised", "albedo_one", "total_at_limit"}


class Limit(NamedTuple):
    """The largest source of σa's error in a channel."""

    channel: str
    source: str
    share: float


class Verdict(NamedTuple):
    """What a reader has to know first."""

    sentence: str
    advice: tuple[str, ...]
    """What to do, the most useful first."""
    trust: Mapping[str, Trust]
    """By channel."""
    limits: tuple[Limit, ...]


def trust_of(channel: ChannelFit) -> Trust:
    """Whether a channel's numbers can be trusted: by its status, and by the flags that leave a doubt."""
    if channel.status in ("rejected", "unidentifiable", "failed"):
        return "no"
    if channel.status == "upper_bound":
        return "bound"
    errors = [relative_sd(channel, key) for key in ("sigma_a", "sigma_sp")] + list(channel.model_error.values())
    doubted = bool(_GRAVE & set(channel.flags)) or math.isnan(channel.sigma_a_per_mm)
    return "care" if doubted or any(not error < LARGE for error in errors) else "yes"


def verdict_of(fit: Fit, warnings: Sequence[str] = ()) -> Verdict:
    """The verdict on a fit; `warnings` are of inputs that have changed."""
    trust = _trust(fit)
    limits = tuple(_limit(name, channel) for name, channel in fit.channels.items() if channel.budget.get("sigma_a"))
    parts = [_of_group(fit, [name for name in trust if trust[name] == kind], kind) for kind in _WORD]
    sentence = "; ".join(part for part in parts if part) + "."
    advice = [*warnings, *_advice(fit, trust, limits)]
    return Verdict(sentence[0].upper() + sentence[1:], tuple(dict.fromkeys(advice)), trust, limits)


def _trust(fit: Fit) -> dict[str, Trust]:
    """By channel; beside a rejected one the others are doubted, since reference, scale, η and g are theirs too."""
    own = {name: trust_of(channel) for name, channel in fit.channels.items()}
    if not any(channel.status == "rejected" for channel in fit.channels.values()):
        return own
    return {name: "care" if trust == "yes" else trust for name, trust in own.items()}


def relative_sd(channel: ChannelFit, coefficient: str) -> float:
    """sd over value; NaN where either is not stated."""
    value = getattr(channel, f"{coefficient}_per_mm")
    return getattr(channel, f"{coefficient}_sd_per_mm") / value if value > 0 else math.nan


def _of_group(fit: Fit, names: Sequence[str], kind: Trust) -> str:
    if not names:
        return ""
    who = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
    said = f"{who} {(_WORD if len(names) == 1 else _WORDS)[kind]}"
    if kind in ("yes", "care"):
        errors = [
            f"{symbol} ± {_span([100 * relative_sd(fit.channels[name], key) for name in names])} %"
            for key, symbol in (("sigma_sp", "σs′"), ("sigma_a", "σa"))
        ]
        own = [error for name in names for error in fit.channels[name].model_error.values()]
        if kind == "care" and max(own, default=0.0) > LARGE:
            errors.append(f"the model's own error is up to {100 * max(own):.2g} %")
        said += f" ({', '.join(errors)})"
    if kind == "no":
        states = dict.fromkeys(fit.channels[name].status for name in names)
        said += f" ({', '.join(states)})"
    if kind == "care" and any(channel.status == "rejected" for channel in fit.channels.values()):
        said += ", beside a channel that is rejected with the same reference, scale and η"
    return said


def _span(values: Sequence[float]) -> str:
    """The least and the largest, once where they read alike."""
    known = [value for value in values if math.isfinite(value)]
    if not known:
        return "an unknown"
    low, high = (f"{value:.2g}" for value in (min(known), max(known)))
    return low if low == high else f"{low} to {high}"


def _limit(name: str, channel: ChannelFit) -> Limit:
    shares = channel.budget["sigma_a"]
    source = max(shares, key=lambda key: shares[key])
    return Limit(name, source, shares[source])


def _advice(fit: Fit, trust: Mapping[str, Trust], limits: Sequence[Limit]) -> list[str]:
    raised = {flag for name, channel in fit.channels.items() if trust[name] != "yes" for flag in channel.flags}
    every = {flag for channel in fit.channels.values() for flag in channel.flags}
    advice = [text for flag, text in _OF_FLAG.items() if flag in raised or (flag in every and flag not in _GRAVE)]
    if any(error > LARGE for channel in fit.channels.values() for error in channel.model_error.values()):
        advice.append("fit with --model mc: the model's own error is large")
    if all(each == "yes" for each in trust.values()):
        advice.append("publish the numbers with their errors, g and η")
    weight: dict[str, float] = {}
    for limit in limits:
        weight[limit.source] = weight.get(limit.source, 0.0) + limit.share
    for source in sorted(weight, key=lambda key: -weight[key])[:2]:
        where = ", ".join(limit.channel for limit in limits if limit.source == source)
        advice.append(f"for a better σa in {where}: {REMEDY.get(source, source)}")
    if absent := dict.fromkeys(each for channel in fit.channels.values() for each in channel.not_stated):
        told = ", ".join(SOURCES.get(each, each) for each in absent)
        advice.append(f"state what counts as without error now: {told}")
    return advice
