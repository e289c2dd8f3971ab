"""What is exported: a published material or a fit, as coefficients of three channels, with what must be said of it.

Coefficients in 1/mm.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from bssrdf.errors import InputError
from bssrdf.export.spread import WalkMedium
from bssrdf.export.text import identifier
from bssrdf.session import fits_in, read_fit
from bssrdf.session.records import ChannelFit, Fit
from bssrdf.transport import CHANNELS, find_material, load_materials, table_source

Rgb = tuple[float, float, float]
Names = tuple[str, str, str]

CAMERA = "camera"
"""The space of what was measured without a colour matrix: the camera's own R, G, B."""
UNTRUSTED = {
    "rejected": "its curve and the model contradict each other",
    "unidentifiable": "its curve does not determine it",
    "upper_bound": "its σa is an upper bound only",
}
"""Statuses of a fit that is exported only where the user says so."""


@dataclass(frozen=True)
class ExportMaterial:
    """A homogeneous medium in red, green and blue."""

    name: str
    source: str
    """The file it comes from, or the publication."""
    sigma_a: Rgb
    sigma_sp: Rgb
    eta: float
    g: float
    space: str
    remarks: tuple[str, ...] = ()
    """What the user must know of it, a line each."""

    @property
    def media(self) -> tuple[WalkMedium, WalkMedium, WalkMedium]:
        """A medium for each channel."""
        r, g, b = (WalkMedium(a, sp, self.eta, self.g) for a, sp in zip(self.sigma_a, self.sigma_sp, strict=True))
        return r, g, b


def find_materials(
    given: str, *, channels: Names = ("R", "G", "B"), space: str | None = None, untrusted: bool = False
) -> list[ExportMaterial]:
    """The material of a published name, of a fit.json, of a session, or all those of a folder of them.

    `channels` stand for red, green and blue; `space`, where given, must be theirs; `untrusted` lets pass what a fit
    itself does not vouch for. A path wins over a name. Raises InputError, one line, where there is no such material.
    """
    path = Path(given)
    if not path.exists():
        if path.suffix == ".json" or len(path.parts) > 1:
            raise InputError(f"{given}: does not exist; give a fit.json, a session, a folder of fits, or a name")
        return [_published(given, space)]
    fits = [each / "fit.json" if each.is_dir() else each for each in fits_in(path)]
    said = _also_published(given)
    return _told_apart([_material(each, read_fit(each), channels, space, untrusted, said) for each in fits])


def _told_apart(materials: list[ExportMaterial]) -> list[ExportMaterial]:
    """The same with a number behind a name that another has already, so that none replaces another."""
    names: set[str] = set()
    for i, material in enumerate(materials):
        name = material.name
        for number in itertools.count(2):
            if identifier(name).lower() not in names:
                break
            name = f"{material.name} {number}"
        names.add(identifier(name).lower())
        materials[i] = replace(material, name=name)
    return materials


def _also_published(given: str) -> tuple[str, ...]:
    names = {name.lower() for name in load_materials()}
    if given.lower() not in names:
        return ()
    return (f'"{given}" is a path here and a published material: the path was taken',)


def _published(name: str, space: str | None) -> ExportMaterial:
    line = find_material(name)
    if space not in (None, CAMERA):
        raise InputError(
            f"{line.name}: the published values are in the R, G, B of the paper's camera, not in {space}; "
            "leave out --space"
        )
    return ExportMaterial(
        line.name,
        table_source(),
        line.sigma_a_per_mm,
        line.sigma_sp_per_mm,
        line.eta,
        0.0,
        CAMERA,
        ("published values are fits of the dipole with g = 0: docs/materials.md", *_white(line.sigma_a_per_mm)),
    )


def _material(
    path: Path, fit: Fit, names: Names, space: str | None, untrusted: bool, said: tuple[str, ...]
) -> ExportMaterial:
    channels = [_channel(path, fit, name, untrusted) for name in names]
    own = fit.about.get("space")
    if space is not None and space != (own or CAMERA):
        raise InputError(
            f"{path}: is in {own or CAMERA} RGB, not in {space}; run `bssrdf measure --space {space}` and fit again"
        )
    sigma_a = _rgb(max(channel.sigma_a_per_mm, 0.0) for channel in channels)
    return ExportMaterial(
        fit.material or path.parent.name or path.stem,
        str(path),
        sigma_a,
        _rgb(channel.sigma_sp_per_mm for channel in channels),
        fit.eta,
        fit.g or 0.0,
        own or CAMERA,
        (*said, *_remarks(fit, names, channels, own), *_white(sigma_a)),
    )


def _channel(path: Path, fit: Fit, name: str, untrusted: bool) -> ChannelFit:
    if name not in fit.channels:
        raise InputError(
            f"{path}: has no channel {name}, but {', '.join(fit.channels) or 'none'}; say which stand for red, green "
            "and blue by --rgb, such as --rgb 633nm,532nm,473nm"
        )
    channel = fit.channels[name]
    if channel.status in UNTRUSTED and not untrusted:
        raise InputError(
            f"{path}: {name} is {channel.status}: {UNTRUSTED[channel.status]}; measure it again, or export it as it is "
            "with --untrusted"
        )
    if not (math.isfinite(channel.sigma_sp_per_mm) and math.isfinite(channel.sigma_a_per_mm)):
        raise InputError(f"{path}: {name} is {channel.status} and has no value; measure it again")
    return channel


def _remarks(fit: Fit, names: Names, channels: Sequence[ChannelFit], space: str | None) -> list[str]:
    told = [
        f"NOT TRUSTED: {name} is {channel.status}: {UNTRUSTED[channel.status]}"
        for name, channel in zip(names, channels, strict=True)
        if channel.status in UNTRUSTED
    ]
    if any(channel.model == "dipole" for channel in channels):
        told.append("fitted with the dipole: its values belong to dipole renderers, and are 10 to 40 % off elsewhere")
    if fit.g is None:
        told.append("g was not given: 0 was taken")
    elif fit.g < 0:
        told.append(f"g {fit.g:g} is below 0: where a walk stands for it, 0 was taken at the same σs′")
    if space is None:
        told.append("colour space not stated: the camera's R, G, B pass for the renderer's, at a ΔE of 5 to 8")
    return told


def _white(sigma_a: Rgb) -> list[str]:
    white = [name for name, value in zip(CHANNELS, sigma_a, strict=True) if value == 0]
    return [f"σa is 0 in {', '.join(white)}: no light is lost, and it spreads without end"] if white else []


def _rgb(values: Iterable[float]) -> Rgb:
    red, green, blue = values
    return (red, green, blue)
