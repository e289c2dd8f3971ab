"""What a camera's own settings must be for frames that can be compared, by the names that libgphoto2 gives them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple


class _Rule(NamedTuple):
    """Settings that speak for one thing; `fits` tells whether a value, in small letters, is as it must be."""

    names: tuple[str, ...]
    fits: Callable[[str], bool]
    what: str
    remedy: str
    every: bool = False
    """Whether each must fit; else one is enough, as the mode M beside a dial on C1 that stands for it."""


def _is_off(value: str) -> bool:
    return value in ("off", "0", "no")


def _is_raw(value: str) -> bool:
    """RAW by itself or beside a JPEG; and what does not name a format that is none."""
    processed = ("jpeg", "jpg", "heif", "fine", "normal", "basic", "standard", "tiff")
    return "raw" in value or "nef" in value or not any(name in value for name in processed)


def _is_manual(value: str) -> bool:
    return value in ("m", "mf", "manual") or value.startswith(("manual ", "mf ", "unknown"))


_RULES = (
    _Rule(("longexpnr", "d06b"), _is_off, "long-exposure noise reduction", "switch it off in the camera", every=True),
    _Rule(("isoauto", "autoiso"), _is_off, "automatic ISO", "switch it off in the camera", every=True),
    _Rule(
        ("expprogram", "autoexposuremode", "autoexposuremodedial"), _is_manual, "exposure mode", "turn its dial to M"
    ),
    _Rule(("focusmode", "focusmode2"), _is_manual, "focus mode", "set lens and camera to manual focus"),
    _Rule(("imageformat", "imagequality"), _is_raw, "image format", "set it to RAW, or RAW + JPEG"),
)
NAMES = ("iso", *(name for rule in _RULES for name in rule.names))
"""Every setting that is looked at."""


def unfit(settings: Mapping[str, str], *, iso_given: bool) -> str:
    """What is wrong with the settings of a camera, with a remedy; empty where nothing is."""
    for rule in _RULES:
        told = [name for name in rule.names if name in settings]
        wrong = [name for name in told if not rule.fits(settings[name].strip().lower())]
        if wrong and (rule.every or wrong == told):
            return f"{rule.what} is {settings[wrong[0]]} ({wrong[0]}); {rule.remedy}"
    if not iso_given and "auto" in settings.get("iso", "").lower():
        return f"ISO is {settings['iso']}; set iso in [camera] of rig.toml"
    return ""
