"""fit.json, and each line of `bssrdf fit --json`. NaN and infinity are null in the file, NaN again when read."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bssrdf.errors import BssrdfError, InputError
from bssrdf.session.atomic import atomic_write
from bssrdf.session.checks import shown
from bssrdf.session.plain import from_plain, to_plain
from bssrdf.session.records import ChannelFit, Fit
from bssrdf.session.text_file import FORMAT, check_format, read_text

_COEFFICIENTS = ("sigma_a", "sigma_sp")
_MAY_LACK: dict[str, Any] = {
    **{"model_error": {}, "sensitivity": {}, "budget": {}},
    **{"total_r_half_space": None, "tau_p": None, "sample_effect": [None, None]},
}
"""What fits of earlier versions come without."""


def fit_to_dict(fit: Fit) -> dict[str, Any]:
    """The fit in the layout of fit.json, with None for NaN and infinity."""
    document = {
        "format": FORMAT,
        "version": fit.version,
        "input": {"path": fit.input_path, "sha256": fit.input_sha256},
        "options": fit.options,
        "material": fit.material,
        "eta": fit.eta,
        "g": fit.g,
        **({"about": fit.about} if fit.about else {}),
        "channels": {name: _channel_to_dict(channel) for name, channel in fit.channels.items()},
    }
    finite: dict[str, Any] = _finite(document)
    return finite


def fit_line(fit: Fit) -> str:
    """The fit as one compact line of JSON."""
    return json.dumps(fit_to_dict(fit), ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def failure_line(path: Path, error: BssrdfError) -> str:
    """What stands in the place of a fit whose input failed."""
    document = {
        "format": FORMAT,
        "input": {"path": str(path)},
        "error": {"code": error.exit_code, "message": str(error)},
    }
    return json.dumps(document, ensure_ascii=False, separators=(",", ":"))


def write_fit(path: Path, fit: Fit) -> None:
    """Write fit.json."""
    with atomic_write(path) as part:
        text = json.dumps(fit_to_dict(fit), ensure_ascii=False, allow_nan=False, indent=1)
        part.write_text(text + "\n", encoding="utf-8")


def fits_in(path: Path) -> list[Path]:
    """The fits that a path stands for: itself if it is a file or a session, else all in a folder of either."""
    if not path.is_dir() or (path / "fit.json").is_file():
        return [path]
    found = sorted([*path.glob("*.json"), *(fit.parent for fit in path.glob("*/fit.json"))])
    if not found:
        raise InputError(f"{path}: holds no fit.json, nor does a folder in it; run `bssrdf fit {path}` first")
    return found


def read_fit(path: Path) -> Fit:
    """The fit in `path`; InputError where it is not a fit.json of a known format."""
    try:
        document = json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is not JSON ({error}); run the fit again") from error
    if not isinstance(document, dict):
        raise InputError(f"{path}: {shown(document)} is not a fit; run the fit again")
    check_format(path, document.get("format", FORMAT))
    try:
        return _fit(document)
    except KeyError as error:
        raise InputError(f"{path}: lacks {error.args[0]}; run the fit again") from error
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(f"{path}: is not laid out as a fit.json ({error}); run the fit again") from error


def _channel_to_dict(channel: ChannelFit) -> dict[str, Any]:
    values: dict[str, Any] = to_plain(channel)
    shares: dict[str, Any] = {key: channel.budget.get(key) for key in _COEFFICIENTS}
    values["budget"] = shares | {"not_stated": values.pop("not_stated")}
    return values if channel.sensitivity else {key: each for key, each in values.items() if key != "sensitivity"}


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _finite(each) for key, each in value.items()}
    return [_finite(each) for each in value] if isinstance(value, list | tuple) else value


def _fit(document: dict[str, Any]) -> Fit:
    return Fit(
        version=str(document["version"]),
        input_path=str(document["input"]["path"]),
        input_sha256=str(document["input"]["sha256"]),
        options=dict(document["options"]),
        material=document["material"],
        eta=_number(document["eta"]),
        g=None if document["g"] is None else _number(document["g"]),
        channels={name: _channel(values) for name, values in document["channels"].items()},
        about=dict(document.get("about", {})),
    )


def _channel(values: dict[str, Any]) -> ChannelFit:
    shares = dict(values.get("budget", {}))
    values = {**_MAY_LACK, **values, "not_stated": shares.pop("not_stated", ())}
    return from_plain(ChannelFit, {**values, "budget": {key: each for key, each in shares.items() if each is not None}})


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)
