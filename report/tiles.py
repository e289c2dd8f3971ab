"""Yes or no: what must hold before a number is used, each with its figure and the threshold it is held against."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from bssrdf.fit import FEWEST, MAX_LOST, MOST_PULL, POOR_CHI2, POOR_RUNS
from bssrdf.report.halves import AGREE, Half
from bssrdf.report.left_out import AT_BOUND, PREDICTED_WITHIN, Decade, LeftOut
from bssrdf.report.verdict import relative_sd
from bssrdf.session.records import ChannelFit, Slice


class Tile(NamedTuple):
    """One question and its answer; `holds` is None where it could not be asked."""

    question: str
    holds: bool | None
    figure: str
    threshold: str


class Saturation(NamedTuple):
    """Pixels saturated in every exposure, in one channel of one image."""

    kind: str
    channel: str
    pixels: int
    share: float


def channel_tiles(channel: ChannelFit, name: str, curve: Slice | None) -> list[Tile]:
    """What the fit of a channel is held against."""
    flags = set(channel.flags)
    stated = not math.isnan(channel.sigma_sp_per_mm)
    tiles = [
        Tile("Did the fit settle?", channel.status in ("converged", "upper_bound"), channel.status, "converged"),
        Tile(
            "Does the curve fit the model?",
            _below(channel.chi2_reduced, POOR_CHI2),
            f"χ² {_number(channel.chi2_reduced)}",
            f"below {POOR_CHI2:g}",
        ),
        Tile(
            "Are residuals free of runs?",
            None if math.isnan(channel.chi2_reduced) else "poor_fit_runs" not in flags,
            "flagged" if "poor_fit_runs" in flags else "no long run",
            f"runs test below {POOR_RUNS:g} sd",
        ),
        Tile(
            "Do R and the curve agree?",
            None if "total_unknown" in flags else "total_inconsistent" not in flags,
            "R not measured" if "total_unknown" in flags else f"R {_number(channel.total_r_measured, 3)} measured",
            f"within {MOST_PULL:g} sd",
        ),
        Tile("Are there enough radii?", channel.n >= FEWEST, f"{channel.n} data", f"at least {FEWEST}"),
    ]
    if stated:
        tiles += [_reach(channel), _model(channel)]
    lost = None if curve is None or curve.lost_fraction is None else curve.lost_fraction.get(name)
    figure = "not stated" if lost is None else f"{100 * lost:.2g} % lost"
    tiles.append(Tile("Did the frame catch the light?", None if lost is None else lost <= MAX_LOST, figure,
                      f"at most {100 * MAX_LOST:g} %"))  # fmt: skip
    assumed = [flag for flag in channel.flags if flag.endswith("_assumed")] + list(channel.not_stated)
    tiles.append(
        Tile("Are all errors stated?", not assumed, ", ".join(assumed).replace("_", " ") or "all", "none assumed")
    )
    return tiles


def _reach(channel: ChannelFit) -> Tile:
    sigma_a, sigma_sp = channel.sigma_a_per_mm, channel.sigma_sp_per_mm
    figure = channel.window_mm[1] * math.sqrt(3 * sigma_a * (sigma_a + sigma_sp)) if sigma_a > 0 else math.nan
    return Tile("Does the curve reach far enough?", _above(figure, 1), f"{_number(figure)}/σtr", "beyond 1/σtr")


def _model(channel: ChannelFit) -> Tile:
    own, sd = channel.model_error.get("sigma_a", math.nan), relative_sd(channel, "sigma_a")
    holds = None if math.isnan(own) or math.isnan(sd) else own <= sd
    return Tile(
        f"Is the model ({channel.model}) good enough?",
        holds,
        f"{_number(100 * own)} % in σa",
        f"at most its ± of {_number(100 * sd)} %",
    )


def halves_tile(found: Sequence[Half] | str) -> Tile:
    """Whether each half of the slice predicts the other."""
    question, threshold = "Does each half predict the other?", f"within {100 * AGREE:g} %, or 3 sd"
    if isinstance(found, str):
        return Tile(question, None, found, threshold)
    if lost := [half for half in found if half.n == 0]:
        return Tile(question, False, f"the {lost[0].fitted_on} half alone is {lost[0].status}", threshold)
    worst = max(found, key=lambda half: abs(half.departure))
    return Tile(question, all(half.agrees for half in found), f"{100 * worst.departure:+.2g} % at most", threshold)


def left_out_tile(found: Sequence[LeftOut] | str) -> Tile:
    """Whether the other exposures predict each one."""
    question = "Do the exposures predict each other?"
    threshold = f"within {100 * PREDICTED_WITHIN:g} %, or 3 sd"
    if isinstance(found, str):
        return Tile(question, None, found, threshold)
    worst = max(found, key=lambda each: abs(each.departure))
    figure = f"{100 * worst.departure:+.2g} % at most ({worst.kind}, {worst.exposure_s:g} s)"
    return Tile(question, all(each.holds for each in found), figure, threshold)


def noise_tile(found: Mapping[tuple[str, str], Sequence[Decade]], why_not: str = "") -> Tile:
    """Whether the merge's noise is that of the best possible merge, by its own map and by the pixels' scatter."""
    question, threshold = "Is the merge as quiet as can be?", f"at most {AT_BOUND:g} × its bound"
    ratios = [
        max(decade.stated, 0.0 if math.isnan(decade.seen) else decade.seen) / decade.bound
        for decades in found.values()
        for decade in decades
        if decade.bound > 0
    ]
    if not ratios:
        return Tile(question, None, why_not or "no pixel tells", threshold)
    middle = sorted(ratios)[len(ratios) // 2]
    return Tile(question, middle <= AT_BOUND, f"{middle:.2f} × its bound (median)", threshold)


def saturation_tile(found: Sequence[Saturation], flagged: bool, known: bool) -> Tile:
    """Whether every pixel is below saturation in some exposure."""
    question, threshold = "Is every pixel unsaturated somewhere?", "no pixel saturated in every exposure"
    if not known:
        return Tile(question, False if flagged else None, "flagged" if flagged else "no image to look at", threshold)
    clipped = [each for each in found if each.pixels]
    figure = ", ".join(f"{each.kind} {each.channel}: {each.pixels} px" for each in clipped) or "none saturated"
    return Tile(question, not clipped, figure, threshold)


def _below(value: float, limit: float) -> bool | None:
    return None if math.isnan(value) else value < limit


def _above(value: float, limit: float) -> bool | None:
    return None if math.isnan(value) else value > limit


def _number(value: float, digits: int = 2) -> str:
    return "–" if math.isnan(value) else f"{value:.{digits}g}" if abs(value) < 100 else f"{value:.0f}"
