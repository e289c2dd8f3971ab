"""What a capture writes beside its frames: plan.toml, session.toml and capture.toml; and whether it may be resumed."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bssrdf
from bssrdf.errors import InputError, UsageError
from bssrdf.rig.plan_toml import CapturePlan, Subject, read_plan
from bssrdf.rig.ports import Identity
from bssrdf.rig.rig_toml import Rig
from bssrdf.session import atomic_write, recover_frames, sha256_of, write_session
from bssrdf.session.records import Frame, Session
from bssrdf.session.text_file import FORMAT, parse_toml, read_text, toml_table

EXPOSURES = "exposures_s"


@dataclass(frozen=True)
class Record:
    """capture.toml."""

    devices: dict[str, Identity]
    camera_settings: dict[str, str]
    exposures_s: dict[Subject, tuple[float, ...]]
    started: str
    finished: str | None = None
    drift: dict[str, float] = field(default_factory=dict)
    """Relative change of the light from the first frame of each subject to the same one at the end."""


def begin(session: Path, plan_file: Path, plan: CapturePlan, rig: Rig, record: Record) -> None:
    """Write all that is known before the first frame."""
    (session / "frames").mkdir(exist_ok=True)
    write_session(session, Session(session, material=plan.material, **rig.session_tables))
    with atomic_write(session / "plan.toml") as part:
        shutil.copyfile(plan_file, part)
    write_record(session, record)


def write_record(session: Path, record: Record) -> None:
    """Write capture.toml as a whole."""
    tables: dict[str, Any] = {
        f"devices.{name}": {"driver": device.driver, "port": device.port, "version": device.version}
        for name, device in record.devices.items()
    }
    tables["camera_settings"] = record.camera_settings
    tables[EXPOSURES] = dict(record.exposures_s)
    tables["drift"] = record.drift
    top = {"format": FORMAT, "version": bssrdf.__version__, "started": record.started, "finished": record.finished}
    sections = [toml_table(top)] + [f"[{name}]\n{toml_table(table)}" for name, table in tables.items()]
    with atomic_write(session / "capture.toml") as part:
        part.write_text("\n".join(sections), encoding="utf-8")


def read_record(session: Path) -> Record:
    """capture.toml as this program wrote it."""
    file = session / "capture.toml"
    document = parse_toml(file, read_text(file))
    try:
        return Record(
            {name: Identity(**device) for name, device in document["devices"].items()},
            dict(document["camera_settings"]),
            {subject: tuple(times) for subject, times in document[EXPOSURES].items()},
            document["started"],
            document.get("finished"),
            dict(document["drift"]),
        )
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{file}: is not what capture wrote ({error}); start a new session") from error


def resumed(session: Path, plan: CapturePlan, devices: dict[str, Identity], settings: dict[str, str]) -> Record:
    """The record of the session to go on with; UsageError where plan, a device or a camera setting is another now."""
    if read_plan(session / "plan.toml") != plan:
        raise UsageError(f"{session}: was begun with another plan; resume with its own plan.toml, or start anew")
    record = read_record(session)
    for name, device in devices.items():
        was = record.devices.get(name)
        if was is None or (was.driver, was.version) != (device.driver, device.version):
            raise UsageError(f"{session}: {name} was {was}, now it is {device}; put the old one back, or start anew")
    if settings != record.camera_settings:
        raise UsageError(
            f"{session}: the camera was set to {record.camera_settings}, now to {settings}; set it back, or start anew"
        )
    return record


def frames_there(session: Path) -> list[Frame]:
    """The journalled frames, each hashed again; files that no line names are of a frame in flight and are removed."""
    frames = recover_frames(session)
    for frame in frames:
        file = session / frame.file
        if not file.is_file() or sha256_of(file) != frame.sha256:
            raise InputError(f"{file}: is missing or changed since its capture; put it back, or start anew")
    journalled = {frame.file for frame in frames}
    for file in (session / "frames").glob("*"):
        if file.is_dir():
            shutil.rmtree(file)
        elif f"frames/{file.name}" not in journalled:
            file.unlink()
    return frames
