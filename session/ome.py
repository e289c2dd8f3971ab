"""Exposure times of the planes of an OME-TIFF."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import tifffile

_SECONDS = {"s": 1.0, "ms": 1e-3, "µs": 1e-6, "us": 1e-6, "ns": 1e-9}


def plane_exposures_s(tif: tifffile.TiffFile) -> dict[int, float]:
    """Exposure [s] by the index of the page; empty where the file is no OME-TIFF or does not tell."""
    if not tif.is_ome or tif.ome_metadata is None:
        return {}
    exposures: dict[int, float] = {}
    for image in _listed(tifffile.xml2dict(tif.ome_metadata)["OME"].get("Image")):
        pixels = image["Pixels"]
        pages = _pages(pixels)
        for plane in _listed(pixels.get("Plane")):
            seconds = float(plane.get("ExposureTime", 0)) * _SECONDS.get(plane.get("ExposureTimeUnit", "s"), 0)
            if seconds > 0:
                exposures[pages[_index(pixels, plane, "The")]] = float(f"{seconds:.12g}")
    return exposures


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
