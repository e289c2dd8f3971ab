"""Drivers by name: entry points of any installed package, the project's own among them.

A package adds one by `[project.entry-points."bssrdf.shutter"]` (or `bssrdf.beam`, `bssrdf.camera`) in its
pyproject.toml: `name = "module:DRIVER"`, where DRIVER is a `Driver`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Literal

import bssrdf
from bssrdf.errors import InputError
from bssrdf.rig.operators import Operator
from bssrdf.rig.ports import Clock
from bssrdf.session.checks import Check

PartName = Literal["shutter", "beam", "camera"]
PARTS: tuple[PartName, ...] = ("shutter", "beam", "camera")


@dataclass(frozen=True)
class Bench:
    """What every driver may use."""

    clock: Clock
    operator: Operator
    shared: dict[str, Any] = field(default_factory=dict)
    """What parts of one bench have in common: its rig.toml under "file", the tables of its parts under "parts", the
    controller behind a port."""


@dataclass(frozen=True)
class Driver:
    """How one kind of shutter, beam or camera is made from its table in rig.toml."""

    keys: Mapping[str, Check]
    make: Callable[[Bench, dict[str, Any]], Any]
    """From the bench and the checked keys to a `ports.ShutterPort`, `BeamPort` or `CameraPort`, not yet connected."""
    required: tuple[str, ...] = ()
    by_hand: bool = False
    """Of a shutter: whether a person moves it, so that it stays as it is until the next frame wants it otherwise."""
    kept_alive: bool = True
    """Of a shutter: whether it is asked for its state a few times per second while the camera works, for a watchdog."""
    ping: Callable[[Any], object] | None = None
    """Of a beam whose controller has a watchdog: what to call on it likewise."""


def names(part: PartName) -> list[str]:
    """Names of the drivers that are installed."""
    return sorted(_points(part))


def find(part: PartName, name: str) -> Driver:
    """The driver of an installed name; InputError where its package does not give one."""
    point = _points(part)[name]
    try:
        driver = point.load()
    except Exception as error:  # somebody else's module may raise anything
        raise InputError(
            f"[{part}] driver {name!r} of {point.value} cannot be loaded ({error!r}); install its package again"
        ) from error
    if not isinstance(driver, Driver):
        raise InputError(f"[{part}] driver {name!r} of {point.value} is not a bssrdf.rig.drivers.Driver; mend it")
    return driver


def _points(part: PartName) -> dict[str, EntryPoint]:
    """By name; where two packages use one name, the project's own is meant."""
    group = f"bssrdf.{part}"
    installed = sorted(entry_points(group=group), key=lambda point: point.value.startswith("bssrdf."))
    return {point.name: point for point in installed} | _in_source_tree(group)


def _in_source_tree(group: str) -> dict[str, EntryPoint]:
    """The project's own as its source tree declares them, which may be newer than what was installed from it."""
    file = Path(bssrdf.__file__).parent / "pyproject.toml"
    if not file.is_file():
        return {}
    declared = tomllib.loads(file.read_text(encoding="utf-8"))["project"]["entry-points"][group]
    return {name: EntryPoint(name, value, group) for name, value in declared.items()}
