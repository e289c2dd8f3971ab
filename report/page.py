"""`bssrdf report`: one HTML file that says what to believe, why, and what to do next. It needs no network."""

from __future__ import annotations

import math
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup, escape

import bssrdf
from bssrdf.errors import BssrdfError, UsageError
from bssrdf.report.curves import CurvePanel, panel
from bssrdf.report.evidence import Evidence, Piece, gather
from bssrdf.report.halves import Half, halves
from bssrdf.report.left_out import Decade, LeftOut, darks_each, left_out, merge_noise, sensor_of
from bssrdf.report.pictures import Scenes, scenes_of
from bssrdf.report.swatches import Swatch, swatch
from bssrdf.report.table import half_space_r
from bssrdf.report.text import with_error
from bssrdf.report.tiles import Tile, channel_tiles, halves_tile, left_out_tile, noise_tile, saturation_tile
from bssrdf.report.validation import Check, validate
from bssrdf.report.verdict import SOURCES, Verdict, verdict_of
from bssrdf.session import atomic_write
from bssrdf.session.flags import meaning_of
from bssrdf.session.records import ChannelFit, Fit

Progress = Callable[[str, int, int], None]
GENERATOR = "bssrdf report"
PHOTONS = 30_000
"""Of a white channel: a second, and some percent a ring."""
_PARTS = "page_parts"
_SYMBOLS = {"sigma_sp": "σs′", "sigma_a": "σa"}
_LIBRARIES = ("numpy", "scipy", "jax", "numba", "opencv-contrib-python-headless", "OpenImageIO", "rawpy")


def write_report(path: Path, out: Path | None = None, *, force: bool = False, progress: Progress | None = None) -> Path:
    """Write the report on a session folder, or on the path of a fit.json, and return where it is.

    It goes to the session's report.html, or to `out`, which a lone fit needs. A report that we wrote is replaced,
    another file only with `force`. InputError where a file is broken.
    """
    evidence = gather(path)
    return write_evidence(evidence, out or _place(evidence), force=force, progress=progress)


def write_evidence(evidence: Evidence, target: Path, *, force: bool = False, progress: Progress | None = None) -> Path:
    """Write the report on what was gathered."""
    if target.exists() and not force and not _is_ours(target):
        raise UsageError(f"{target} is not a report of this command; choose another --out, or replace it with --force")
    text = page(evidence, progress)
    with atomic_write(target) as part:
        part.write_text(text, encoding="utf-8")
    return target


def page(evidence: Evidence, progress: Progress | None = None) -> str:
    """The HTML of the report."""
    parts = {name: files("bssrdf.report").joinpath(_PARTS, name).read_text(encoding="utf-8") for name in (
        "page.html", "page.css", "page.js", "uPlot.iife.min.js", "uPlot.min.css", "uPlot.LICENSE")}  # fmt: skip
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters["code"] = _code
    return environment.from_string(parts["page.html"]).render(
        **_content(evidence, progress),
        generator=GENERATOR,
        css=Markup(parts["page.css"]),
        js=Markup(parts["page.js"]),
        uplot_js=Markup(parts["uPlot.iife.min.js"]),
        uplot_css=Markup(parts["uPlot.min.css"]),
        notice=parts["uPlot.LICENSE"],
    )


def _code(text: str) -> Markup:
    """The text, escaped, with what stands between backticks as code."""
    return Markup("").join(
        Markup("<code>{}</code>").format(part) if at % 2 else escape(part) for at, part in enumerate(text.split("`"))
    )


def _place(evidence: Evidence) -> Path:
    if evidence.session is None:
        raise UsageError(f"{evidence.path}: is a lone fit; say by --out where its report goes")
    return evidence.path / "report.html"


def _is_ours(target: Path) -> bool:
    with target.open("rb") as file:
        return f'name="generator" content="{GENERATOR}"'.encode() in file.read(2000)


def _content(evidence: Evidence, progress: Progress | None) -> dict[str, Any]:
    fit = evidence.fit
    verdict = verdict_of(fit, evidence.warnings) if fit else None
    scenes = scenes_of(evidence)
    half = _halves(evidence)
    out = _left_out(evidence, progress)
    noise = _noise(evidence)
    simulated = _simulated(evidence, progress)
    tiles = {
        name: channel_tiles(channel, name, evidence.pieces[0].curve if evidence.pieces else None)
        for name, channel in (fit.channels.items() if fit else ())
    }
    for name, found in half.items():
        if name in tiles:
            tiles[name].append(halves_tile(found))
    flags = _flags(evidence)
    return {
        "name": evidence.name,
        "path": str(evidence.path),
        "version": bssrdf.__version__,
        "fit": fit,
        "missing": dict.fromkeys(("fit", "slice", "images", "frames"), "") | dict(evidence.missing)
        | ({"images": scenes} if isinstance(scenes, str) else {}),
        "verdict": verdict,
        "tone": _tone(verdict),
        "sources": {**dict.fromkeys(_sources(fit), ""), **SOURCES},
        "laid": _laid(evidence, scenes),
        "saturated": _saturated(evidence, scenes),
        "rows": [coefficient_row(name, channel, verdict) for name, channel in (fit.channels.items() if fit else ())],
        "tiles": [*_session_tiles(evidence, scenes, out, noise)],
        "channel_tiles": {name: {tile.question: tile for tile in each} for name, each in tiles.items()},
        "questions": [{"text": text} for text in dict.fromkeys(t.question for each in tiles.values() for t in each)],
        "scenes": scenes.pictures if isinstance(scenes, Scenes) else [],
        "panels": _panels(evidence, simulated),
        "budgets": list(_budgets(fit)),
        "not_stated": ", ".join(dict.fromkeys(each for c in _channels(fit) for each in c.not_stated)),
        "halves": [(name, each) for name, found in half.items() if not isinstance(found, str) for each in found],
        "halves_notes": [f"{name}: {found}" for name, found in half.items() if isinstance(found, str)]
        or ([] if half else [evidence.missing.get("slice") or evidence.missing.get("fit") or "no slice"]),
        "left_out": out,
        "noise": noise,
        "noise_note": evidence.missing.get("images", "the images were merged elsewhere"),
        **_colour(evidence),
        "flag_text": flags,
        "origins": [(title, list(table)) for title, table in _origins(evidence)],
    }  # fmt: skip


def _channels(fit: Fit | None) -> Sequence[ChannelFit]:
    return list(fit.channels.values()) if fit else []


def _sources(fit: Fit | None) -> set[str]:
    return {source for channel in _channels(fit) for shares in channel.budget.values() for source in shares}


def _tone(verdict: Verdict | None) -> str:
    if verdict is None:
        return "care"
    kinds = set(verdict.trust.values())
    return "yes" if kinds <= {"yes", "bound"} else "no" if "no" in kinds else "care"


def _laid(evidence: Evidence, scenes: Scenes | str) -> str:
    if isinstance(scenes, Scenes) and scenes.laid:
        return scenes.laid
    return f"{evidence.missing.get('images', scenes)}."


def _saturated(evidence: Evidence, scenes: Scenes | str) -> str:
    if isinstance(scenes, Scenes):
        clipped = [f"{each.pixels} px of {each.channel} in the {each.kind} ({100 * each.share:.2g} %)"
                   for each in scenes.saturation if each.pixels]  # fmt: skip
        return f"{', '.join(clipped) or 'nothing: every pixel is below saturation in some exposure'}."
    if "saturated" in evidence.measured_flags():
        return "some pixels, by the flag that measuring raised."
    return f"nothing by the flags; the images are not at hand ({scenes})."


def _session_tiles(
    evidence: Evidence, scenes: Scenes | str, out: list[LeftOut] | str, noise: Mapping[tuple[str, str], list[Decade]]
) -> Iterator[Tile]:
    known = isinstance(scenes, Scenes)
    found = scenes.saturation if isinstance(scenes, Scenes) else []
    yield saturation_tile(found, "saturated" in evidence.measured_flags(), known)
    yield left_out_tile(out)
    yield noise_tile(noise, evidence.missing.get("images", "the images were merged elsewhere"))


def _halves(evidence: Evidence) -> dict[str, list[Half] | str]:
    if evidence.fit is None or not evidence.pieces:
        return {}
    return {
        name: halves(evidence.pieces[0].curve, name, channel, evidence.fit.options)
        for name, channel in evidence.fit.channels.items()
        if name in evidence.pieces[0].curve.channels
    }


def _left_out(evidence: Evidence, progress: Progress | None) -> list[LeftOut] | str:
    if evidence.session is None or "frames" in evidence.missing:
        return evidence.missing.get("frames", "there are no frames")
    if evidence.merged is None:
        return evidence.missing.get("images", "there is no image")
    try:
        return left_out(evidence.session, evidence.frames, evidence.merged.provenance, progress)
    except BssrdfError as error:
        return str(error)


def _noise(evidence: Evidence) -> dict[tuple[str, str], list[Decade]]:
    merged = evidence.merged
    sensor = sensor_of(merged.provenance) if merged else None
    if merged is None or sensor is None:
        return {}
    found = {}
    for kind, hdr in merged.images.items():
        if kind in merged.told.timing:
            layout = merged.told.layouts[kind]
            for name in evidence.channels:
                if name in layout or layout in ("rgb", "mono"):
                    seconds = merged.told.timing[kind].seconds
                    decades = merge_noise(hdr, layout, name, seconds, sensor, darks_each(evidence.frames, kind))
                    found[kind, name] = decades
    return {key: decades for key, decades in found.items() if decades}


def _simulated(evidence: Evidence, progress: Progress | None) -> dict[str, Check]:
    if evidence.fit is None or not evidence.pieces:
        return {}
    checks = validate(evidence.fit, evidence.pieces[0].curve, progress=progress, photons=PHOTONS)
    return {check.channel: check for check in checks}


def _panels(evidence: Evidence, simulated: Mapping[str, Check]) -> list[CurvePanel]:
    many = len(evidence.pieces) > 1
    return [
        panel(_title(evidence, piece, name, many), piece.curve, name, found, evidence.fit, simulated.get(name))
        for piece in evidence.pieces
        for name in piece.curve.channels
        for found in [evidence.fit.channels.get(name) if evidence.fit else None]
    ]


def _title(evidence: Evidence, piece: Piece, name: str, many: bool) -> str:
    return f"{name}, {piece.path}" if many else f"Channel {name}"


def _budgets(fit: Fit | None) -> Iterator[dict[str, Any]]:
    for name, channel in fit.channels.items() if fit else ():
        for key, symbol in _SYMBOLS.items():
            if shares := channel.budget.get(key):
                ordered = sorted(shares.items(), key=lambda item: -item[1])
                text = ", ".join(
                    f"{source.replace('_', ' ')} {100 * share:.0f} %" for source, share in ordered if share >= 0.005
                )
                yield {"channel": name, "symbol": symbol, "shares": ordered, "text": text}


def coefficient_row(name: str, channel: ChannelFit, verdict: Verdict | None) -> dict[str, Any]:
    """What a channel's line of the table shows, as text."""
    errors = [f"{100 * channel.model_error[key]:.2g} % in {symbol}" for key, symbol in _SYMBOLS.items()
              if key in channel.model_error]  # fmt: skip
    bound = channel.status == "upper_bound"
    return {
        "name": name,
        "trust": verdict.trust[name] if verdict else "no",
        "sigma_sp": _value(channel.sigma_sp_per_mm, channel.sigma_sp_sd_per_mm),
        "sigma_sp_interval": _interval(channel.sigma_sp_interval95_per_mm),
        "sigma_a": f"< {channel.sigma_a_interval95_per_mm[1]:.2g}" if bound
        else _value(channel.sigma_a_per_mm, channel.sigma_a_sd_per_mm),
        "sigma_a_interval": _interval(channel.sigma_a_interval95_per_mm),
        "r_seen": _number(channel.total_r_measured),
        "r_model": _number(channel.total_r_model),
        "chi2": "–" if math.isnan(channel.chi2_reduced) else f"{channel.chi2_reduced:.2f}",
        "model": f"{channel.model}{', ' + ' and '.join(errors) if errors else ''}",
        "status": channel.status,
        "flags": channel.flags,
    }  # fmt: skip


def _value(value: float, sd: float) -> str:
    return "–" if math.isnan(value) else with_error(value, sd)


def _number(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.4f}"


def _interval(ends: tuple[float, float]) -> str:
    return "–" if all(map(math.isnan, ends)) else " to ".join("∞" if math.isnan(e) else f"{e:.4g}" for e in ends)


def _flags(evidence: Evidence) -> dict[str, str]:
    raised = [flag for channel in _channels(evidence.fit) for flag in channel.flags]
    return {str(flag): meaning_of(flag) for flag in dict.fromkeys([*raised, *evidence.measured_flags()])}


def _colour(evidence: Evidence) -> dict[str, Any]:
    matrix = evidence.session.colour if evidence.session else None
    fit, pieces = evidence.fit, evidence.pieces
    given = {"R as seen": pieces[0].curve.total_r if pieces else {}}
    if fit is not None:
        given["R of the medium"] = {name: half_space_r(channel) for name, channel in fit.channels.items()}
    found = {title: swatch(total, matrix) for title, total in given.items() if total}
    notes = dict.fromkeys(each for each in found.values() if isinstance(each, str))
    return {
        "swatches": [(title, each) for title, each in found.items() if isinstance(each, Swatch)],
        "swatch_notes": list(notes) or ([] if found else ["no swatch: no total reflectance is known"]),
    }


def _origins(evidence: Evidence) -> Iterator[tuple[str, Iterator[tuple[str, str]]]]:
    """Titles and rows of what was used to get here."""
    for name in ("devices", "camera_settings", "drift"):
        if table := evidence.record.get(name):
            yield name.replace("_", " ").capitalize(), _flat(table)
    if evidence.session is not None:
        tables = asdict(evidence.session)
        yield (
            "session.toml",
            _flat({key: value for key, value in tables.items() if value is not None and key != "path"}),
        )
    if evidence.fit is not None:
        fit = evidence.fit
        yield "Fit", _flat({"version": fit.version, "input": fit.input_path, "sha256": fit.input_sha256, **fit.options})
    for piece in evidence.pieces:
        header = {key: value for key, value in vars(piece.curve).items() if key not in ("channels", "provenance")}
        yield f"Slice {piece.path}", _flat({**header, **piece.curve.provenance})
    yield "Versions", _flat({"bssrdf": bssrdf.__version__, "Python": platform.python_version(), **_versions()})


def _versions() -> dict[str, str]:
    found = {}
    for name in _LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def _flat(table: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, str]]:
    """Nested tables as rows of a dotted key and its value."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{before}{key}.")
        elif value is not None:
            yield f"{before}{key}", str(value)
