"""Damaged surfaces and lines along fibers."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from myork.reference.faults import Fault, spoilt

__all__ = ["mesh_faults"]

# An octahedron: corners [mm] and triangles
_CORNERS = np.array(
    [[20, 0, 0], [0, 20, 0], [-20, 0, 0], [0, -20, 0], [0, 0, 30], [0, 0, -30]], float
)
_TRIANGLES = [[a, (a + 1) % 4, 4] for a in range(4)] + [[(a + 1) % 4, a, 5] for a in range(4)]


def mesh_faults(folder: Path) -> list[Fault]:
    """Write damaged archives of lines and damaged surfaces into a folder."""
    return [*_archives(folder), *_surfaces(folder)]


def _deck(surface: Path, **other: Any) -> dict[str, Any]:
    build = {"surface": str(surface), "surface_unit": "mm", "voxel": [8.0, 8.0, 8.0], **other}
    return {"scene": {"dimension": 3}, "build": build}


def _lines() -> dict[str, NDArray[Any]]:
    """Nine lines along z through the octahedron."""
    x, y, z = np.meshgrid(
        [-6.0, 0.0, 6.0], [-6.0, 0.0, 6.0], np.linspace(-30, 30, 7), indexing="ij"
    )
    points = np.stack([x, y, z], -1).reshape(-1, 3)
    return {"points": points, "offsets": np.arange(10) * 7}


def _archive(**arrays: Any) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def _archives(folder: Path) -> Iterator[Fault]:
    surface = folder / "sound.obj"
    surface.write_text(_obj(_CORNERS, _TRIANGLES))
    lines = _lines()
    points, offsets = lines["points"], lines["offsets"]
    sound = _archive(**lines)

    def fault(name: str, content: bytes, message: str | None, huge: bool = False) -> Fault:
        path = folder / f"{name}.npz"
        path.write_bytes(content)
        return Fault(
            f"tracts-{name}", path, "build", _deck(surface, tracts=str(path)), message, huge
        )

    def changed(**arrays: NDArray[Any]) -> bytes:
        return _archive(**{**lines, **arrays})

    yield fault("nothing", b"", "the archive is damaged")
    yield fault("text", b"no archive", "the archive is damaged")
    yield fault("empty-archive", _archive(), "points is not there")
    yield fault("no-offsets", _archive(points=points), "offsets is not there")
    yield fault("objects", changed(points=np.array([{}, []], object)), "no numbers")
    yield fault("complex", changed(points=points * 1j), "values are complex")
    yield fault("texts", changed(offsets=np.array(["a", "b"])), "no numbers")
    yield fault("flat", changed(points=points.ravel()), r"points must be \(n, 3\)")
    yield fault("square", changed(offsets=offsets.reshape(2, 5)), r"points must be \(n, 3\)")
    yield fault("halves", changed(offsets=offsets + 0.5), "must be integers")
    yield fault("nan-offsets", changed(offsets=offsets * np.nan), "must be integers")
    yield fault("no-lines", changed(offsets=offsets[:0]), "offsets must rise")
    yield fault("falling", changed(offsets=offsets[::-1].copy()), "offsets must rise")
    yield fault("beyond", changed(offsets=offsets * 2), "offsets must rise")
    yield fault("no-points", changed(points=points[:0], offsets=offsets[:1]), "holds no line")
    yield fault("nan", changed(points=points * np.nan), "not finite")
    yield fault("far", changed(points=points * 1e12), "km away")
    yield fault("elsewhere", changed(points=points + 1000.0), "outside of the body")
    yield fault("one-place", changed(points=np.zeros_like(points)), "no line has a length")
    yield fault("huge", _promising(points, 10**11), "the header promises", huge=True)
    yield fault("negative", _promising(points, -63), "the archive is damaged|header")
    for name, content in spoilt(sound, 6, 16, seed=9):
        yield fault(name, content, None if "flip" in name else "the archive is damaged")


def _promising(points: NDArray[Any], rows: int) -> bytes:
    """An archive whose array says that it has another number of rows."""
    stream, member = io.BytesIO(), io.BytesIO()
    head = {"descr": "<f8", "fortran_order": False, "shape": (rows, 3)}
    np.lib.format.write_array_header_1_0(member, head)
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("points.npy", member.getvalue() + points.tobytes())
        offsets = io.BytesIO()
        np.save(offsets, np.arange(10) * 7)
        archive.writestr("offsets.npy", offsets.getvalue())
    return stream.getvalue()


def _surfaces(folder: Path) -> Iterator[Fault]:
    """Surfaces; the readers of VTK end the process that calls them on some of these."""

    def fault(name: str, content: bytes | str, message: str | None) -> Fault:
        path = folder / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return Fault(f"surface-{name}", path, "build", _deck(path), message)

    broken = "cannot be read|holds no surface"
    vtk, ply, vtp = _vtk(), _ply(), _vtp()
    infinite, far = _CORNERS.copy(), _CORNERS * 1e6
    infinite[0, 0] = np.nan
    yield fault("nothing.stl", b"", broken)
    yield fault("text.ply", "no surface", broken)
    yield fault("open.obj", _obj(_CORNERS, _TRIANGLES[1:]), "not closed")
    yield fault("nan.obj", _obj(infinite, _TRIANGLES), "not finite")
    yield fault("far.obj", _obj(far, _TRIANGLES), "check build.surface_unit")
    yield fault("flat.obj", _obj(_CORNERS * [1, 1, 0], _TRIANGLES), "not closed|no voxel")
    yield fault("strange.xyzzy", "no surface", "cannot be read")
    yield fault("no-corner.obj", _obj(_CORNERS, [*_TRIANGLES, [0, 1, 77]]), None)
    yield fault("no-corner.vtk", vtk.replace("3 0 1 4", "3 0 1 99999999"), "cannot be read|corner")
    many = '<Piece NumberOfPoints="6000000000000"'
    yield fault("many.vtk", vtk.replace("POINTS 6", "POINTS 4000000000"), broken)
    yield fault("negative.vtk", vtk.replace("POINTS 6", "POINTS -6"), broken)
    yield fault("many-cells.vtk", vtk.replace("POLYGONS 8", "POLYGONS 999999999"), None)
    yield fault("many.ply", ply.replace("vertex 6", "vertex 2000000000"), broken)
    yield fault("many.vtp", vtp.replace('<Piece NumberOfPoints="6"', many), broken)
    yield fault("open-tag.vtp", vtp[:300], broken)
    yield fault("count.stl", bytes(80) + (4_000_000_000).to_bytes(4, "little") + bytes(50), None)
    for name, content in spoilt(vtk.encode(), 2, 4, seed=10):
        yield fault(f"{name}.vtk", content, None)


def _obj(corners: NDArray[np.float64], triangles: list[list[int]]) -> str:
    rows = [f"v {x} {y} {z}" for x, y, z in corners.tolist()]
    return "\n".join(rows + ["f " + " ".join(str(n + 1) for n in row) for row in triangles]) + "\n"


def _numbers(rows: Any, before: str = "") -> str:
    return "".join(before + " ".join(f"{n:g}" for n in row) + "\n" for row in rows)


def _vtk() -> str:
    return (
        "# vtk DataFile Version 3.0\noctahedron\nASCII\nDATASET POLYDATA\nPOINTS 6 float\n"
        + _numbers(_CORNERS)
        + "POLYGONS 8 32\n"
        + _numbers(_TRIANGLES, "3 ")
    )


def _ply() -> str:
    return (
        "ply\nformat ascii 1.0\nelement vertex 6\nproperty float x\nproperty float y\n"
        "property float z\nelement face 8\nproperty list uchar int vertex_indices\nend_header\n"
        + _numbers(_CORNERS)
        + _numbers(_TRIANGLES, "3 ")
    )


def _vtp() -> str:
    return (
        '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian"><PolyData>\n'
        '<Piece NumberOfPoints="6" NumberOfPolys="8"><Points>\n'
        '<DataArray type="Float32" NumberOfComponents="3" format="ascii">\n'
        + _numbers(_CORNERS)
        + "</DataArray></Points><Polys>\n"
        + '<DataArray type="Int64" Name="connectivity" format="ascii">\n'
        + _numbers(_TRIANGLES)
        + '</DataArray><DataArray type="Int64" Name="offsets" format="ascii">\n'
        + "3 6 9 12 15 18 21 24\n</DataArray></Polys></Piece></PolyData></VTKFile>\n"
    )
