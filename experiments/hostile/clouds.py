"""Points and Gaussians in PLY files."""

import struct
from pathlib import Path

from experiments.hostile.reader import Files, Reader


def ply(names: tuple[str, ...] = ()) -> list[Files]:
    columns = names or ("x", "y", "z", "red", "green", "blue")
    kinds = ["uchar" if x in ("red", "green", "blue") else "float" for x in columns]
    head = [f"property {kind} {name}" for kind, name in zip(kinds, columns, strict=True)]
    other = ["element face 1", "property list char int i", "property float q"]
    files = []
    for form in ("ascii", "binary_little_endian", "binary_big_endian"):
        lines = ["ply", f"format {form} 1.0", *other, "element vertex 2", *head, "end_header", ""]
        order = ">" if "big" in form else "<"
        row = [200 if kind == "uchar" else 0.5 for kind in kinds]
        packed = "".join("B" if kind == "uchar" else "f" for kind in kinds)
        body = struct.pack(order + "b2if", 2, 1, 2, 0.5) + 2 * struct.pack(order + packed, *row)
        if form == "ascii":
            body = ("2 1 2 0.5\n" + 2 * (" ".join(map(str, row)) + "\n")).encode()
        files.append({"p.ply": "\n".join(lines).encode() + body})
    return files


def _gaussian_ply() -> list[Files]:
    return ply((*"xyz", *(f"f_dc_{i}" for i in range(3)), "opacity",
                 *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))))  # fmt: skip


def _points(folder: Path) -> object:
    from gaussray.capture.points import read_points

    return read_points(folder / "p.ply")


def _gaussians(folder: Path) -> object:
    from gaussray.scene.formats.gaussian_ply import read_gaussians

    return read_gaussians(folder / "p.ply")


READERS = {
    "points-ply": Reader(ply, _points, {"p.ply": "bytes"}),
    "gaussian-ply": Reader(_gaussian_ply, _gaussians, {"p.ply": "bytes"}),
}
