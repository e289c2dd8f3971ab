"""session.toml and calibration.toml: what is measured, and with what. The tables and their checks live here only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import Any

from bssrdf.errors import InputError, UsageError
from bssrdf.session.atomic import atomic_write, inside, make_folder
from bssrdf.session.checks import Check, checked, known_keys, shown, text
from bssrdf.session.frames_csv import write_frames
from bssrdf.session.keys import checked_keys, keys_of, missing_keys
from bssrdf.session.records import Beam, Camera, Colour, Distortion, Geometry, Material, Reference, Session
from bssrdf.session.text_file import FORMAT, check_format, parse_toml, read_text, toml_table

Tables = dict[str, dict[str, Any]]

TABLES: dict[str, type] = {
    "material": Material,
    "camera": Camera,
    "geometry": Geometry,
    "beam": Beam,
    "reference": Reference,
    "distortion": Distortion,
    "colour": Colour,
}
"""What session.toml and calibration.toml hold; each table's keys are the declared fields of its record."""
_TO_MEASURE = ("camera", "material", "geometry", "reference")
_BY_CALIBRATE = ("distortion", "colour")
"""Tables that `bssrdf calibrate` writes and nobody by hand."""
UNNAMED = "unnamed"
"""Name of the material in the template: whoever leaves it may have left the example values too."""
_TEMPLATE_HEAD = """\
# A session: what is measured, and with what. Lengths in mm, angles in degrees, DN are a frame's own numbers.
# Take the `#` away from a line to use it. The frames are listed in frames.csv: file,kind,exposure_s
format = 1
# calibration = "calibration.toml"      # tables written by `bssrdf calibrate`; the keys below win
"""


def read_session(path: Path, *, complete: bool = False) -> Session:
    """The session in the folder `path`, with its calibration merged in; InputError names file, key and value.

    With `complete` the tables must be there without which no slice can be measured; else [camera] is enough.
    """
    file = path / "session.toml"
    top, own = _read_tables(file, {"calibration": text})
    tables = own
    if "calibration" in top:
        tables = _merged(read_calibration(inside(path, top["calibration"], named_in=file.name)), own)
    parts = records_of(file, tables, _TO_MEASURE if complete else ("camera",))
    return Session(path=path, calibration=top.get("calibration"), **parts)


def checked_table(file: Path, name: str, raw: Any) -> dict[str, Any]:
    """The values of one table as they are written, each checked; InputError names file, key and value."""
    if not isinstance(raw, Mapping):
        raise InputError(f"{file}: {name} = {shown(raw)} must be a table; write [{name}] and its keys below")
    values = checked_keys(file, f"[{name}] ", raw, TABLES[name])
    for key, declared in keys_of(TABLES[name]).items():
        if declared.key.unless and {key, declared.key.unless} <= values.keys():
            raise InputError(f"{file}: [{name}] has both {key} and {declared.key.unless}; keep one of them")
    return values


def records_of(file: Path, tables: Tables, needed: Sequence[str]) -> dict[str, Any]:
    """The record of each table; InputError names all keys at once that the tables, and those needed, lack."""
    _check_required(file, tables, needed)
    return {name: _record(file, name, values) for name, values in tables.items()}


def read_calibration(file: Path) -> Tables:
    """The tables of a calibration.toml, each value checked."""
    return _read_tables(file, {})[1]


def write_session(path: Path, session: Session) -> None:
    """Write session.toml in the folder `path`, so that `read_session` gives `session` back."""
    tables = {name: asdict(table) for name in TABLES if (table := getattr(session, name)) is not None}
    _write_tables(path / "session.toml", {"calibration": session.calibration}, tables)


def write_calibration(path: Path, tables: Mapping[str, Mapping[str, Any]]) -> None:
    """Write a calibration.toml of tables of session.toml; InputError for a value that could not be read back."""
    checked_tables = {name: checked_table(path, name, values) for name, values in tables.items()}
    _write_tables(path, {}, checked_tables)


def write_template(path: Path, *, force: bool = False) -> None:
    """An empty session in the folder `path`: a commented session.toml, frames.csv and frames/."""
    file = path / "session.toml"
    if file.exists() and not force:
        raise UsageError(f"{file}: exists already; choose another folder, or --force to start it anew")
    make_folder(path / "frames")
    write_started(path, Camera())
    if not (path / "frames.csv").exists():
        write_frames(path, [])


def write_started(path: Path, camera: Camera, told: Mapping[str, Mapping[str, Any]] = MappingProxyType({})) -> None:
    """The template with the keys of `camera` that differ from what is taken without them, and those of further tables
    that are `told` already, to be filled in."""
    plain = asdict(Camera())
    known = {key: value for key, value in asdict(camera).items() if value != plain[key]}
    given: Tables = {**{name: dict(values) for name, values in told.items()}, "camera": known}
    given["material"] = {"name": UNNAMED} | given.get("material", {})
    tables = [f"[{name}]\n{_lines(name, given.get(name, {}))}" for name in TABLES if name not in _BY_CALIBRATE]
    with atomic_write(path / "session.toml") as part:
        part.write_text("\n".join([_TEMPLATE_HEAD, *tables]), encoding="utf-8")


def _lines(name: str, given: Mapping[str, Any]) -> str:
    """Each key of a table with what it means, behind a `#` where it has neither a value nor to be given one."""
    lines = ""
    for key, declared in keys_of(TABLES[name]).items():
        on = key in given or declared.needed or declared.key.ask
        line = f"{'' if on else '# '}{toml_table({key: given.get(key, declared.example)}).rstrip()}"
        lines += f"{line:39} # {declared.meaning}\n"
    return lines


def told_tables(file: Path, tables: Mapping[str, Mapping[str, Any]]) -> Tables:
    """The values that are not None, each checked; InputError naming `file`, for which they are meant."""
    known = {
        name: {key: value for key, value in values.items() if value is not None} for name, values in tables.items()
    }
    checked = {name: checked_table(file, name, values) for name, values in known.items() if values}
    for name, values in checked.items():
        if name == "reference" and "reflectance" in values:
            _record(file, name, {"name": "", **values})
    return checked


def camera_of_keys(file: Path, keys: Mapping[str, Any]) -> Camera:
    """[camera] of keys that are not None; InputError naming `file`, for which they are meant."""
    given = {key: value for key, value in keys.items() if value is not None}
    camera: Camera = _record(file, "camera", checked_table(file, "camera", given))
    return camera


def _read_tables(file: Path, top_checks: dict[str, Check]) -> tuple[dict[str, Any], Tables]:
    document = parse_toml(file, read_text(file))
    check_format(file, document.pop("format", FORMAT))
    known_keys(file, "", document, [*top_checks, *TABLES])
    top = {key: value for key, value in document.items() if key in top_checks}
    tables = {name: checked_table(file, name, raw) for name, raw in document.items() if name in TABLES}
    return checked(file, "", top, top_checks), tables


def _merged(calibration: Tables, own: Tables) -> Tables:
    """Both; a key of `own` wins, and a scale of its own in either form replaces the calibrated one."""
    if {"mm_per_px", "homography"} & own.get("geometry", {}).keys():
        scaleless = {k: v for k, v in calibration.get("geometry", {}).items() if k not in ("mm_per_px", "homography")}
        calibration = {**calibration, "geometry": scaleless}
    return {name: calibration.get(name, {}) | own.get(name, {}) for name in calibration | own}


def _check_required(file: Path, tables: Tables, names: Sequence[str]) -> None:
    """InputError that names every key that is missing, with the lines that would give them."""
    missing, lines = [], []
    for name in dict.fromkeys((*names, *tables)):
        examples = missing_keys(keys_of(TABLES[name]), tables.get(name, {}))
        if name not in tables:
            missing.append(f"[{name}]" + (f" with {' and '.join(examples)}" if examples else ""))
        elif examples:
            missing.append(f"[{name}] {' and '.join(examples)}")
        if name not in tables or examples:
            lines.append(f"[{name}] {toml_table(examples).replace(chr(10), ' ')}".rstrip())
    if missing:
        raise InputError(f"{file}: lacks {', '.join(missing)}; add lines such as `{'`, `'.join(lines)}`")


def _record(file: Path, name: str, values: dict[str, Any]) -> Any:
    record = TABLES[name](**values)
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
