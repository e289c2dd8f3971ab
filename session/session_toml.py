"""session.toml and calibration.toml: what is measured, and with what. The tables and their checks live here only."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.resources import files
from pathlib import Path
from typing import Any

from bssrdf.errors import InputError, UsageError
from bssrdf.session.atomic import atomic_write, inside, make_folder
from bssrdf.session.checks import (
    Check,
    boolean,
    checked,
    choice,
    known_keys,
    list_of,
    matrix3,
    number,
    shown,
    text,
    unique,
)
from bssrdf.session.frames_csv import write_frames
from bssrdf.session.records import Beam, Camera, Colour, Distortion, Geometry, Material, Reference, Session
from bssrdf.session.text_file import FORMAT, check_format, parse_toml, read_text, toml_table

Tables = dict[str, dict[str, Any]]


def _layout(value: Any) -> str:
    if value not in ("mono", "rgb") and not (isinstance(value, str) and re.fullmatch("[RGBCMYEW]{4}", value)):
        raise ValueError('must be a 2x2 colour filter pattern such as "RGGB", or "mono", or "rgb"')
    return str(value)


_POSITIVE = number(above=0)
_NOT_NEGATIVE = number(at_least=0)
_ANGLE = number(at_least=0, below=90)

TABLES: dict[str, tuple[type, dict[str, Check]]] = {
    "material": (
        Material,
        {
            "name": text,
            "eta": _POSITIVE,
            "g": number(above=-1, below=1),
            "thickness_mm": _POSITIVE,
            "width_mm": _POSITIVE,
            "backing": text,
            "cover": choice("none", "glass"),
            "finish": choice("polished", "rough"),
        },
    ),
    "camera": (
        Camera,
        {
            "layout": _layout,
            "black": _NOT_NEGATIVE,
            "white": _POSITIVE,
            "gain_e_per_dn": _POSITIVE,
            "read_noise_e": _NOT_NEGATIVE,
            "exposure_rel_sd": _POSITIVE,
            "aperture_mm": _POSITIVE,
            "response": choice("debevec"),
        },
    ),
    "geometry": (
        Geometry,
        {
            "mm_per_px": _POSITIVE,
            "homography": matrix3,
            "mm_per_px_rel_sd": number(at_least=0, below=1),
            "distance_mm": _POSITIVE,
            "view_angle_deg": _ANGLE,
            "view_angle_sd_deg": _NOT_NEGATIVE,
            "view_axis": choice("x", "y"),
        },
    ),
    "beam": (
        Beam,
        {
            "kind": choice("white", "led", "laser"),
            "polarised": boolean,
            "incidence_deg": _ANGLE,
            "spot_radius_mm": _POSITIVE,
            "channels": unique(list_of(text)),
        },
    ),
    "reference": (
        Reference,
        {
            "name": text,
            "reflectance": list_of(number(above=0, at_most=1.2)),
            "reflectance_sd": list_of(_NOT_NEGATIVE),
            "coplanar": boolean,
        },
    ),
    "distortion": (Distortion, {"camera_matrix": matrix3, "coefficients": list_of(number())}),
    "colour": (Colour, {"matrix": matrix3}),
}
_REQUIRED = {
    "camera": {},
    "material": {"name": '"marble"', "eta": "1.5"},
    "geometry": {"mm_per_px": "0.05"},
    "reference": {"name": '"Spectralon"', "reflectance": "[0.99, 0.99, 0.99]"},
    "distortion": {"camera_matrix": "[[…], […], […]]", "coefficients": "[…]"},
    "colour": {"matrix": "[[…], […], […]]"},
}
"""Keys without which a table is nothing, each with an example."""
_TO_MEASURE = ("camera", "material", "geometry", "reference")
UNNAMED = "unnamed"
"""Name of the material in the template: whoever leaves it may have left the example values too."""


def read_session(path: Path, *, complete: bool = False) -> Session:
    """The session in the folder `path`, with its calibration merged in; InputError names file, key and value.

    With `complete` the tables must be there without which no slice can be measured; else [camera] is enough.
    """
    file = path / "session.toml"
    top, own = _read_tables(file, {"calibration": text})
    tables = own
    if "calibration" in top:
        tables = _merged(read_calibration(inside(path, top["calibration"], named_in=file.name)), own)
    _check_required(file, tables, _TO_MEASURE if complete else ("camera",))
    parts = {name: _record(file, name, values) for name, values in tables.items()}
    return Session(path=path, calibration=top.get("calibration"), **parts)


def read_calibration(file: Path) -> Tables:
    """The tables of a calibration.toml, each value checked."""
    return _read_tables(file, {})[1]


def write_session(path: Path, session: Session) -> None:
    """Write session.toml in the folder `path`, so that `read_session` gives `session` back."""
    tables = {name: asdict(table) for name in TABLES if (table := getattr(session, name)) is not None}
    _write_tables(path / "session.toml", {"calibration": session.calibration}, tables)


def write_calibration(path: Path, tables: Mapping[str, Mapping[str, Any]]) -> None:
    """Write a calibration.toml of tables of session.toml; InputError for a value that could not be read back."""
    checked_tables = {name: checked(path, f"[{name}] ", values, TABLES[name][1]) for name, values in tables.items()}
    _write_tables(path, {}, checked_tables)


def write_template(path: Path, *, force: bool = False) -> None:
    """An empty session in the folder `path`: a commented session.toml, frames.csv and frames/."""
    file = path / "session.toml"
    if file.exists() and not force:
        raise UsageError(f"{file}: exists already; choose another folder, or --force to start it anew")
    make_folder(path / "frames")
    with atomic_write(file) as part:
        part.write_text(_template(), encoding="utf-8")
    if not (path / "frames.csv").exists():
        write_frames(path, [])


def write_started(path: Path, camera: Camera) -> None:
    """The template with the keys of `camera` that differ from what is taken without them, to be filled in."""
    document, plain = _template(), asdict(Camera())
    for key, value in asdict(camera).items():
        if value != plain[key]:
            line = toml_table({key: value}).rstrip()
            document = re.sub(rf"^# {key} = \S+ *(?=#|$)", f"{line:40}", document, flags=re.MULTILINE)
    with atomic_write(path / "session.toml") as part:
        part.write_text(document, encoding="utf-8")


def camera_of_keys(file: Path, keys: Mapping[str, Any]) -> Camera:
    """[camera] of keys that are not None; InputError naming `file`, for which they are meant."""
    given = {key: value for key, value in keys.items() if value is not None}
    camera: Camera = _record(file, "camera", checked(file, "[camera] ", given, TABLES["camera"][1]))
    return camera


def _template() -> str:
    return files("bssrdf.session").joinpath("template.toml").read_text(encoding="utf-8")


def _read_tables(file: Path, top_checks: dict[str, Check]) -> tuple[dict[str, Any], Tables]:
    document = parse_toml(file, read_text(file))
    check_format(file, document.pop("format", FORMAT))
    known_keys(file, "", document, [*top_checks, *TABLES])
    top = {key: value for key, value in document.items() if key in top_checks}
    tables: Tables = {}
    for name, raw in document.items():
        if name not in TABLES:
            continue
        if not isinstance(raw, Mapping):
            raise InputError(f"{file}: {name} = {shown(raw)} must be a table; write [{name}] and its keys below")
        tables[name] = checked(file, f"[{name}] ", raw, TABLES[name][1])
    _one_scale(file, tables.get("geometry", {}))
    return checked(file, "", top, top_checks), tables


def _merged(calibration: Tables, own: Tables) -> Tables:
    """Both; a key of `own` wins, and a scale of its own in either form replaces the calibrated one."""
    if {"mm_per_px", "homography"} & own.get("geometry", {}).keys():
        scaleless = {k: v for k, v in calibration.get("geometry", {}).items() if k not in ("mm_per_px", "homography")}
        calibration = {**calibration, "geometry": scaleless}
    return {name: calibration.get(name, {}) | own.get(name, {}) for name in calibration | own}


def _one_scale(file: Path, geometry: dict[str, Any]) -> None:
    if {"mm_per_px", "homography"} <= geometry.keys():
        raise InputError(f"{file}: [geometry] has both mm_per_px and homography; keep one of them")


def _check_required(file: Path, tables: Tables, names: Sequence[str]) -> None:
    """InputError that names every key that is missing, with the lines that would give them."""
    missing, lines = [], []
    for name in dict.fromkeys((*names, *tables)):
        keys = [key for key in _REQUIRED.get(name, {}) if key not in tables.get(name, {})]
        if name == "geometry" and "homography" in tables.get(name, {}):
            keys = []
        if name not in tables:
            missing.append(f"[{name}]" + (f" with {' and '.join(keys)}" if keys else ""))
        elif keys:
            missing.append(f"[{name}] {' and '.join(keys)}")
        if name not in tables or keys:
            lines.append(" ".join([f"[{name}]", *(f"{key} = {_REQUIRED[name][key]}" for key in keys)]))
    if missing:
        raise InputError(f"{file}: lacks {', '.join(missing)}; add lines such as `{'`, `'.join(lines)}`")


def _record(file: Path, name: str, values: dict[str, Any]) -> Any:
    record = TABLES[name][0](**values)
    if isinstance(record, Camera):
        _black_below_white(file, record)
    if isinstance(record, Reference) and record.reflectance_sd is not None:
        _one_sd_each(file, record)
    return record


def _black_below_white(file: Path, camera: Camera) -> None:
    if camera.black is not None and camera.white is not None and not camera.black < camera.white:
        raise InputError(f"{file}: [camera] black = {camera.black:g} must be below white = {camera.white:g}")


def _one_sd_each(file: Path, reference: Reference) -> None:
    assert reference.reflectance_sd is not None
    if len(reference.reflectance_sd) != len(reference.reflectance):
        raise InputError(
            f"{file}: [reference] reflectance_sd has {len(reference.reflectance_sd)} values for "
            f"{len(reference.reflectance)} of reflectance; give one for each"
        )


def _write_tables(file: Path, top: Mapping[str, Any], tables: Mapping[str, Mapping[str, Any]]) -> None:
    sections = [toml_table({"format": FORMAT, **top})]
    sections += [f"[{name}]\n{toml_table(values)}" for name, values in tables.items()]
    with atomic_write(file) as part:
        part.write_text("\n".join(sections), encoding="utf-8")
