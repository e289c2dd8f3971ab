"""Meshes: files of triangles, read and scaled."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from bssrdf.errors import InputError
from bssrdf.render.surface_nets import TriangleMesh
from bssrdf.render.variant import cause, use_variant

FORMATS = {".ply": "ply", ".obj": "obj", ".serialized": "serialized"}


class MeshFile(NamedTuple):
    """A mesh, and what was found wanting in its file."""

    mesh: TriangleMesh
    remarks: tuple[str, ...]


def read_mesh(path: Path, *, height_mm: float | None = None) -> MeshFile:
    """The mesh in `path`, z up; scaled to a height where one is given, else taken to be in mm.

    Raises InputError where the file is not a mesh. Normals are taken from the faces where the file has none.
    """
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"{path}: not a mesh that can be read; convert it to {', '.join(FORMATS)}")
    if not path.is_file():
        raise InputError(f"{path}: is not there; check the path")
    if lack := _lack(path):
        raise InputError(f"{path}: {lack}; save it anew")
    if height_mm is not None and not 0 < height_mm < float("inf"):
        raise InputError(f"height {height_mm:g} mm is not above 0; give the height of the figure")
    loaded = _load(path)
    parameters = _parameters(loaded)
    vertices = np.array(parameters["vertex_positions"], np.float64).reshape(-1, 3)
    faces = np.array(parameters["faces"], np.uint32).reshape(-1, 3)
    if len(faces) == 0 or not np.isfinite(vertices).all():
        raise InputError(
            f"{path}: has {'no faces' if len(faces) == 0 else 'vertices that are not finite'}; save it anew"
        )
    extent = np.ptp(vertices, axis=0)
    if extent.min() <= 0:
        raise InputError(f"{path}: is flat; light needs a body to go into")
    remarks = []
    normals = np.array(parameters["vertex_normals"], np.float64).reshape(-1, 3)
    if not _names_normals(path):
        remarks.append(f"{path}: has no normals; smooth ones were taken from its faces")
    if len(normals) != len(vertices):
        normals = face_normals(vertices, faces)
    if mixed := _mixed_edges(vertices, faces):
        remarks.append(f"{path}: faces look either way across {mixed} edges, where light is wrong; turn them alike")
    if _volume(vertices, faces) < 0:
        remarks.append(f"{path}: its faces look inwards; they were turned over")
        faces = faces[:, ::-1].copy()
    if not _agree(vertices, faces, normals):
        if _names_normals(path):
            remarks.append(f"{path}: its normals point into the body; smooth ones were taken from its faces")
        normals = face_normals(vertices, faces)
    scale = 1.0 if height_mm is None else height_mm / extent[2]
    return MeshFile(TriangleMesh(scale * vertices, normals, around(vertices), faces), tuple(remarks))


def face_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Normals of the vertices (n, 3): those of the faces around, by area."""
    corners = vertices[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], across)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30))


class TexturedSurface(Protocol):
    """What a mesh is made of, as `TriangleMesh` names it."""

    @property
    def vertices(self) -> np.ndarray: ...
    @property
    def normals(self) -> np.ndarray: ...
    @property
    def uv(self) -> np.ndarray: ...
    @property
    def faces(self) -> np.ndarray: ...


def mitsuba_mesh(name: str, surface: TexturedSurface, properties: Any) -> Any:
    """A mesh of Mitsuba's with those parts, in its current variant."""
    import mitsuba as mi

    n, m = len(surface.vertices), len(surface.faces)
    built = mi.Mesh(name, n, m, has_vertex_normals=True, has_vertex_texcoords=True, props=properties)
    held = mi.traverse(built)
    held["vertex_positions"] = mi.Float(surface.vertices.astype(np.float32).ravel())
    held["vertex_normals"] = mi.Float(surface.normals.astype(np.float32).ravel())
    held["vertex_texcoords"] = mi.Float(surface.uv.astype(np.float32).ravel())
    held["faces"] = mi.UInt32(surface.faces.astype(np.uint32).ravel())
    held.update()
    return built


def _volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = np.moveaxis((vertices - vertices.mean(axis=0))[faces], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def _mixed_edges(vertices: np.ndarray, faces: np.ndarray) -> int:
    """Edges along which an even number of faces do not run to and fro alike."""
    _, place = np.unique(vertices, axis=0, return_inverse=True)
    corners = place.reshape(-1)[faces].astype(np.int64)
    ahead = np.roll(corners, -1, axis=1)
    least, most = np.minimum(corners, ahead), np.maximum(corners, ahead)
    _, edge, count = np.unique((least * len(vertices) + most).ravel(), return_inverse=True, return_counts=True)
    balance = np.bincount(edge.ravel(), np.sign(ahead - corners).ravel())
    return int(np.count_nonzero((balance != 0) & (count % 2 == 0)))


def _agree(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> bool:
    """Whether normals are on the outer side of most faces."""
    return bool(np.median(np.einsum("ij,ij->i", normals, face_normals(vertices, faces))) > 0)


def _lack(path: Path) -> str:
    """What Mitsuba names by another cause."""
    content = path.read_bytes()
    if not content.strip():
        return "is empty"
    faceless = path.suffix.lower() == ".obj" and not any(line.startswith(b"f ") for line in content.splitlines())
    return "has no faces" if faceless else ""


def _load(path: Path) -> Any:
    use_variant()
    import mitsuba as mi

    try:
        return mi.load_dict({"type": FORMATS[path.suffix.lower()], "filename": str(path)})
    except RuntimeError as error:
        raise InputError(f"{path}: cannot be read as a mesh ({cause(error)}); save it anew") from error


def _parameters(loaded: Any) -> Any:
    import mitsuba as mi

    return mi.traverse(loaded)


def _names_normals(path: Path) -> bool:
    """Whether the file itself holds vertex normals."""
    if path.suffix.lower() == ".ply":
        with path.open("rb") as file:
            head = file.read(4096)
        return b"property float nx" in head.split(b"end_header")[0]
    if path.suffix.lower() == ".obj":
        return any(line.startswith(b"vn ") for line in path.read_bytes().splitlines())
    return True


def around(vertices: np.ndarray) -> np.ndarray:
    """Cylindrical texture coordinates, u around the z axis with its seam at +y, v upwards."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    x, y = (vertices[:, :2] - (low + high)[:2] / 2).T
    u = np.arctan2(x, -y) / (2 * np.pi) + 0.5
    return np.stack([u, (vertices[:, 2] - low[2]) / (high[2] - low[2])], axis=1)
