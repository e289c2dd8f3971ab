"""Linear floating-point pictures: our multi-part EXR, and EXR or Radiance files of others."""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.session.atomic import atomic_write
from bssrdf.session.checks import shown
from bssrdf.session.raw_frame import RawFrame, card_of_attributes, exposure_of_tags, positive, real

if TYPE_CHECKING:
    from bssrdf.session.oiio_file import StoredImage


Plane = NDArray[np.float32]

OUR_PARTS = ("radiance", "variance", "count", "mask")
"""Of the EXR that `bssrdf measure` writes; the first is the picture."""
_RADIANCE_PRIMARIES = ((0.640, 0.330), (0.290, 0.600), (0.150, 0.060), (1 / 3, 1 / 3))
"""Red, green, blue and white, as x and y, of the RGB that Radiance turns XYZE into (color.h)."""


def read_parts(path: Path) -> RawFrame:
    """The one picture of an EXR or Radiance file; InputError where it has several or none."""
    from bssrdf.session.oiio_file import read_images

    if path.suffix.lower() == ".hdr":
        return _read_radiance(path)
    images = read_images(path)
    return _frame(_picture(path, images), images[0].attributes)


def _picture(path: Path, images: Sequence[StoredImage]) -> Plane:
    if [image.name for image in images] == list(OUR_PARTS):
        images = images[:1]
    names = [image.channel_names for image in images]
    if sorted(names) == [("B",), ("G",), ("R",)] and len({image.data.shape for image in images}) == 1:
        by_name = {image.channel_names[0]: image.data[:, :, 0] for image in images}
        return np.stack([by_name[colour] for colour in "RGB"], -1)
    found = {
        ".".join(filter(None, (image.name, layer))): (layer, data)
        for image in images
        for layer, data in _layers(image).items()
    }
    plain = [data for layer, data in found.values() if not layer]
    if len(found) == 1 or (len(images) == 1 and len(plain) == 1):
        return plain[0] if plain else next(iter(found.values()))[1]
    if not found:
        channels = names[0] if len(names) == 1 else names
        raise InputError(f"{path}: has the channels {shown(channels)}; save one channel, or R, G and B")
    raise InputError(f"{path}: holds several pictures ({', '.join(found)}); save the one to be measured by itself")


def _layers(image: StoredImage) -> dict[str, Plane]:
    """The pictures of a part by the name of their layer: its R, G and B, or the only channel that there is."""
    if len(image.channel_names) == 1:
        return {"": image.data[:, :, 0]}
    layers: dict[str, dict[str, int]] = {}
    for index, name in enumerate(image.channel_names):
        layer, _, channel = name.rpartition(".")
        layers.setdefault(layer, {})[channel.upper()] = index
    pictures = {}
    for layer, channels in layers.items():
        if set("RGB") <= channels.keys():
            pictures[layer] = np.ascontiguousarray(image.data[:, :, [channels[colour] for colour in "RGB"]])
        elif channels.keys() <= {"Y", "A"} and "Y" in channels:
            pictures[layer] = np.ascontiguousarray(image.data[:, :, channels["Y"]])
    return pictures


def _frame(data: NDArray[Any], tags: dict[str, Any]) -> RawFrame:
    return RawFrame(data, card_of_attributes(data, tags), exposure_of_tags(tags))


def _read_radiance(path: Path) -> RawFrame:
    """The picture over the product of the EXPOSURE lines; XYZE turned into RGB."""
    from bssrdf.session.oiio_file import read_image

    header = _radiance_header(path)
    encoded_xyz = b"32-bit_rle_xyze" in header
    image = read_image(path) if not encoded_xyz else _read_as_rgbe(path)
    if image.attributes.get("Orientation", 1) != 1:
        raise InputError(f"{path}: its rows do not run down and to the right; save it with -Y +X")
    data = image.data + _half_step(image.data)
    data = data @ _rgb_of_xyz().astype(np.float32).T if encoded_xyz else data
    exposure = np.prod([_factor(path, text) for text in re.findall(rb"^EXPOSURE=(.*)$", header, re.MULTILINE)])
    corrections = [text.split() for text in re.findall(rb"^COLORCORR=(.*)$", header, re.MULTILINE)]
    factors = np.prod([[_factor(path, each) for each in text] for text in corrections], axis=0) if corrections else 1.0
    return _frame(np.asarray(data / (exposure * factors), np.float32), {})


def _half_step(data: Plane) -> Plane:
    """Half of what a pixel's numbers are cut off at, 1/256 of a power of two: a value stands for the middle of its step
    (Ward, Real Pixels, Graphics Gems II, 1991), which OpenImageIO leaves out."""
    top = data.max(axis=-1, keepdims=True)
    return np.where(top > 0, np.ldexp(np.float32(0.5), np.frexp(top)[1] - 8), np.float32(0)).astype(np.float32)


def _radiance_header(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(65536).partition(b"\n\n")[0]
    except FileNotFoundError as error:
        raise InputError(f"{path}: is not there; check the path") from error


def _factor(path: Path, text: bytes) -> float:
    factor = positive(real(text.decode(errors="replace").strip()))
    if factor is None:
        raise InputError(f"{path}: its EXPOSURE or COLORCORR {shown(text)} is not a number above 0; save it anew")
    return factor


def _read_as_rgbe(path: Path) -> StoredImage:
    """The same bytes under the name of the format that OpenImageIO knows: the code of the numbers is one."""
    from bssrdf.session.oiio_file import read_image

    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / path.name
        copy.write_bytes(path.read_bytes().replace(b"32-bit_rle_xyze", b"32-bit_rle_rgbe", 1))
        try:
            return read_image(copy)
        except InputError as error:
            raise InputError(str(error).replace(str(copy), str(path))) from error


def _rgb_of_xyz() -> NDArray[np.float64]:
    """3×3 matrix from XYZ to the RGB of Radiance's primaries, white at 1."""
    xyz = np.array([(x / y, 1.0, (1 - x - y) / y) for x, y in _RADIANCE_PRIMARIES])
    primaries, white = xyz[:3].T, xyz[3]
    return np.asarray(np.linalg.inv(primaries * np.linalg.solve(primaries, white)))


_PROVENANCE = "bssrdf:provenance"
_TILE_PX = 128


def write_hdr_exr(path: Path, parts: Mapping[str, NDArray[Any]], provenance: Mapping[str, Any]) -> None:
    """Write `parts`, radiance, variance, count and mask, each (h, w) or (h, w, 3): floats, or unsigned integers."""
    from bssrdf.session.oiio_file import write_exr

    planes = [(name, np.atleast_3d(parts[name])) for name in OUR_PARTS]
    with atomic_write(path) as unfinished:
        write_exr(unfinished, planes, {_PROVENANCE: json.dumps(provenance, default=float)}, _TILE_PX)


def is_ours(path: Path) -> bool:
    """Whether a file is an EXR that `bssrdf measure` wrote, in DN/s of the camera."""
    from bssrdf.session.oiio_file import read_images

    return path.suffix.lower() == ".exr" and [image.name for image in read_images(path)] == list(OUR_PARTS)


class HdrExr:
    """An EXR that `bssrdf measure` wrote, of which windows are read when they are asked for."""

    def __init__(self, path: Path) -> None:
        """InputError where the file cannot be read or a part is missing."""
        from bssrdf.session.oiio_file import ImageWindows

        self._images = ImageWindows(path)
        names = self._images.names
        for name in OUR_PARTS:
            if name not in names:
                raise InputError(f"{path}: lacks the part {name}; run `bssrdf measure` again")
        self._index = {name: names.index(name) for name in OUR_PARTS}
        height, width, channels = self._images.shape(self._index[OUR_PARTS[0]])
        self.shape: tuple[int, ...] = (height, width) if channels == 1 else (height, width, channels)
        """(h, w), or (h, w, 3)."""
        for name, index in self._index.items():
            if self._images.shape(index)[:2] != (height, width):
                raise InputError(f"{path}: the part {name} has another size; run `bssrdf measure` again")
        try:
            own = self._images.attributes[self._index[OUR_PARTS[0]]]
            self.provenance: dict[str, Any] = json.loads(own.get(_PROVENANCE, "{}"))
        except (TypeError, ValueError) as error:
            raise InputError(f"{path}: its provenance is not JSON ({error}); run `bssrdf measure` again") from error

    def window(self, part: str, rows: slice, columns: slice) -> NDArray[Any]:
        """A window of a part, (rows, columns) or (rows, columns, 3); InputError where it cannot be read."""
        return _flat(self._images.read(self._index[part], rows, columns))

    def whole(self, part: str) -> NDArray[Any]:
        """The same of the whole part."""
        return self.window(part, slice(0, self.shape[0]), slice(0, self.shape[1]))


def read_hdr_exr(path: Path) -> tuple[dict[str, Plane], dict[str, Any]]:
    """The parts by name, each (h, w) or (h, w, 3), and the provenance; InputError where a part is missing."""
    stored = HdrExr(path)
    return {name: stored.whole(name).astype(np.float32) for name in OUR_PARTS}, stored.provenance


def _flat(data: NDArray[Any]) -> NDArray[Any]:
    return data[:, :, 0] if data.shape[2] == 1 else data
