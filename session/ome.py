"""What OME-XML and ImageJ say of the pictures of a TIFF: the exposure of each, and whether all are of one colour."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from bssrdf.errors import InputError
from bssrdf.session.raw_frame import SECONDS


def plane_exposures_s(tif: tifffile.TiffFile) -> dict[int, float]:
    """Exposure [s] by the index of the page; empty where the file is not an OME-TIFF or does not tell."""
    exposures: dict[int, float] = {}
    for pixels in _pixels_of(tif):
        pages = _pages(pixels)
        for plane in _listed(pixels.get("Plane")):
            seconds = float(plane.get("ExposureTime", 0)) * SECONDS.get(plane.get("ExposureTimeUnit", "s"), 0)
            if seconds > 0:
                exposures[pages[_index(pixels, plane, "The")]] = float(f"{seconds:.12g}")
    return exposures


def check_one_channel(path: Path, tif: tifffile.TiffFile, exposures: Mapping[int, float]) -> None:
    """InputError where the pictures are of several colours: those of a bracket differ in exposure alone."""
    names: list[str] = []
    for pixels in _pixels_of(tif):
        channels = [each for each in _listed(pixels.get("Channel")) if _size(pixels, "C") > 1]
        waves = {tuple(each.get(f"{kind}Wavelength") for kind in ("Emission", "Excitation")) for each in channels}
        if len(waves) > 1 or (channels and len(set(exposures.values())) < 2):
            names = [str(each.get("Name", f"channel {i}")) for i, each in enumerate(channels)]
    count = (tif.imagej_metadata or {}).get("channels", 1)
    names = names or [f"channel {i}" for i in range(count if count > 1 else 0)]
    if names:
        raise InputError(
            f"{path}: holds a picture for each of {', '.join(names)}; save each channel as a file of its own"
        )


def _pixels_of(tif: tifffile.TiffFile) -> Iterator[Mapping[str, Any]]:
    """The element Pixels of each image of an OME-TIFF; nothing of another file."""
    if tif.is_ome and tif.ome_metadata is not None:
        for image in _listed(tifffile.xml2dict(tif.ome_metadata)["OME"].get("Image")):
            yield image["Pixels"]


def _pages(pixels: Mapping[str, Any]) -> dict[int, int]:
    """Page by index of the plane; planes follow each other where nothing else is said."""
    total = int(np.prod([_size(pixels, axis) for axis in "CZT"]))
    pages = {i: i for i in range(total)}
    for block in _listed(pixels.get("TiffData")):
        first, page = _index(pixels, block, "First"), int(block.get("IFD", 0))
        for i in range(int(block.get("PlaneCount", 1 if "IFD" in block else total))):
            pages[first + i] = page + i
    return pages


def _index(pixels: Mapping[str, Any], place: Mapping[str, Any], prefix: str) -> int:
    """Where a plane stands in the order of the file."""
    index, step = 0, 1
    for axis in str(pixels["DimensionOrder"])[2:]:
        index += step * int(place.get(prefix + axis, 0))
        step *= _size(pixels, axis)
    return index


def _size(pixels: Mapping[str, Any], axis: str) -> int:
    """Planes along an axis; the channels of an RGB plane are one."""
    together = int(_listed(pixels.get("Channel") or {})[0].get("SamplesPerPixel", 1)) if axis == "C" else 1
    return max(1, int(pixels["Size" + axis]) // together)


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [] if value is None else [value]
