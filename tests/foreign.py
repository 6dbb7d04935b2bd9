"""A small model of 4DGaussians on disk, written without torch, and what its authors mean by it.

`forward` is their recipe once more, in NumPy and double precision; `torch_forward` with torch's own
`grid_sample` and layers, in the single precision that they run in.
"""

import pickle
import struct
import zipfile
from pathlib import Path

import numpy as np


PAIRS = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))
HEADS = {"pos": 3, "scales": 3, "rotations": 4, "opacity": 1, "shs": 48}
FLAGS = dict.fromkeys(("no_dx", "no_ds", "no_dr", "no_do", "no_dshs"), False)
ARGUMENTS = {
    "sh_degree": 3,
    "source_path": "/data/x",
    "white_background": True,
    "net_width": 8,
    "defor_depth": 1,
    "kplanes_config": {"output_coordinate_dim": 4, "resolution": [5, 5, 5, 6]},
    "multires": [1, 2],
    "no_grid": False,
    "grid_pe": 0,
    "static_mlp": False,
    "empty_voxel": False,
    "apply_rotation": False,
    **FLAGS,
}
STORAGES = {"f8": "Double", "f4": "Float", "f2": "Half", "i8": "Long", "b1": "Bool"}


def cloud(count=12, seed=0, coefficients=16):
    """Stored values of Gaussians in and around the box, by the names of the PLY file."""
    draw = np.random.default_rng(seed)
    table = {name: 1.2 * draw.uniform(-1, 1, count) for name in "xyz"}
    table |= {f"f_dc_{i}": draw.normal(size=count) for i in range(3)}
    table |= {f"f_rest_{i}": 0.2 * draw.normal(size=count) for i in range(3 * (coefficients - 1))}
    # Opacities up to where single precision has lost how near to 1 they are.
    table |= {"opacity": draw.uniform(-5, 18, count)}
    table |= {f"scale_{i}": draw.uniform(-4, -2, count) for i in range(3)}
    return table | {f"rot_{i}": draw.normal(size=count) for i in range(4)}


def state(seed=0, side=5, rows=6, width=8, channels=4, scales=(1, 2), layers=1):
    """The tensors of a deformation.pth: all five heads, and what the forward does not use."""
    draw = np.random.default_rng(seed)
    tensors = {"time_poc": np.float32([1, 2, 4, 8]), "timenet.0.bias": np.ones(64, np.float32)}
    tensors["deformation_net.grid.aabb"] = np.array([[1.0, 1.1, 0.9], [-1.0, -0.8, -1.3]])
    for s, times in enumerate(scales):
        size = 3 * [times * side] + [rows]
        for p, (i, j) in enumerate(PAIRS):
            name = f"deformation_net.grid.grids.{s}.{p}"
            tensors[name] = draw.uniform(0.5, 1.5, (1, channels, size[j], size[i]))

    def linear(name, inputs, outputs):
        tensors[f"{name}.weight"] = draw.normal(size=(outputs, inputs)) / np.sqrt(inputs)
        tensors[f"{name}.bias"] = 0.1 * draw.normal(size=outputs)

    for i in range(layers):
        inputs = width if i else channels * len(scales)
        linear(f"deformation_net.feature_out.{2 * i}", inputs, width)
    for head, outputs in HEADS.items():
        linear(f"deformation_net.{head}_deform.1", width, width)
        linear(f"deformation_net.{head}_deform.3", width, outputs)
    return {name: x.astype(np.float32) for name, x in tensors.items()}


def write_model(folder: Path, tensors=None, table=None, iteration=20, **changes) -> Path:
    """A model's folder with an iteration, and its arguments with changes (None: left out)."""
    cloud_folder = folder / "point_cloud" / f"iteration_{iteration}"
    write_ply(cloud_folder / "point_cloud.ply", table or cloud())
    write_pth(cloud_folder / "deformation.pth", tensors or state())
    told = {k: v for k, v in (ARGUMENTS | changes).items() if v is not None}
    words = ", ".join(f"{k}={v!r}" for k, v in told.items())
    (folder / "cfg_args").write_text(f"Namespace({words})")
    return folder


def write_ply(path: Path, table) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table['x'])}"]
    head += [*(f"property float {name}" for name in table), "end_header", ""]
    rows = np.stack(list(table.values()), axis=1).astype("<f4")
    path.write_bytes("\n".join(head).encode() + rows.tobytes())


def write_pth(path: Path, tensors) -> None:
    """A state dictionary as torch.save writes it: contiguous tensors, a storage each."""
    stored = {str(i): np.ascontiguousarray(x) for i, x in enumerate(tensors.values())}
    items = []
    for name, (key, x) in zip(tensors, stored.items(), strict=True):
        strides = [step // x.itemsize for step in x.strides]
        own = storage(key, x.dtype.str[1:], x.size)
        items.append(text(name) + described(own, x.shape, strides))
    write_archive(path, dictionary(items), {k: x.tobytes() for k, x in stored.items()})


def write_archive(path: Path, pickled: bytes, data: dict[str, bytes], order=None, **options):
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w", **options) as archive:
        archive.writestr(f"{path.stem}/data.pkl", pickled)
        archive.writestr(f"{path.stem}/version", "3\n")
        if order is not None:
            archive.writestr(f"{path.stem}/byteorder", order)
        for key, numbers in data.items():
            archive.writestr(f"{path.stem}/data/{key}", numbers)


def text(value: str) -> bytes:
    return pickle.BINUNICODE + struct.pack("<I", len(value)) + value.encode()


def number(value: int) -> bytes:
    return pickle.LONG1 + b"\x08" + struct.pack("<q", value)


def name_of(module: str, name: str) -> bytes:
    return pickle.GLOBAL + f"{module}\n{name}\n".encode()


def series(*parts: bytes) -> bytes:
    return pickle.MARK + b"".join(parts) + pickle.TUPLE


def storage(key: str, kind: str, count: int) -> bytes:
    """The persistent name of a storage."""
    kinds = name_of("torch", f"{STORAGES[kind]}Storage")
    words = series(text("storage"), kinds, text(key), text("cuda:0"), number(count))
    return words + pickle.BINPERSID


def ordered_dict() -> bytes:
    return name_of("collections", "OrderedDict") + pickle.EMPTY_TUPLE + pickle.REDUCE


def described(storage: bytes, shape, strides, first=0) -> bytes:
    """A call that makes a tensor of a storage."""
    shape, strides = (series(*(number(n) for n in x)) for x in (shape, strides))
    rest = pickle.NEWFALSE + ordered_dict()
    arguments = series(storage, number(first), shape, strides, rest)
    return name_of("torch._utils", "_rebuild_tensor_v2") + arguments + pickle.REDUCE


def dictionary(items: list[bytes]) -> bytes:
    """An OrderedDict with the note of versions that every state dictionary carries."""
    filled = ordered_dict() + pickle.MARK + b"".join(items) + pickle.SETITEMS
    note = pickle.EMPTY_DICT + text("_metadata") + ordered_dict() + pickle.SETITEM
    return pickle.PROTO + b"\x02" + filled + note + pickle.BUILD + pickle.STOP


def columns(table):
    """Mean, log scale, raw quaternion, logit of opacity and harmonics as the network meets them, in
    the file's single precision."""
    table = {name: np.float32(x) for name, x in table.items()}
    pick = lambda names: np.stack([table[name] for name in names], axis=-1)  # noqa: E731
    per_channel = sum(name.startswith("f_rest") for name in table) // 3
    names = [
        [f"f_dc_{c}", *(f"f_rest_{per_channel * c + i}" for i in range(per_channel))]
        for c in range(3)
    ]
    return {
        "pos": pick("xyz"),
        "scales": pick([f"scale_{i}" for i in range(3)]),
        "rotations": pick([f"rot_{i}" for i in range(4)]),
        "opacity": pick(["opacity"]),
        "shs": np.stack([pick(names[c]) for c in range(3)], axis=-1),
    }


def forward(tensors, table, time, flags=FLAGS):
    """Mean, scale, unit quaternion, opacity and harmonics at a time, in double precision."""
    net = {k: np.float64(x) for k, x in tensors.items()}
    rest = {k: np.float64(x) for k, x in columns(table).items()}
    largest, smallest = net["deformation_net.grid.aabb"]
    place = (rest["pos"] - largest) * 2 / (smallest - largest) - 1
    place = np.concatenate([place, np.full((len(place), 1), time)], axis=1)
    parts, s = [], 0
    while f"deformation_net.grid.grids.{s}.0" in net:
        planes = [net[f"deformation_net.grid.grids.{s}.{p}"][0] for p in range(6)]
        where = [(place[:, i], place[:, j]) for i, j in PAIRS]
        seen = [_sample(plane, *xy) for plane, xy in zip(planes, where, strict=True)]
        parts.append(np.prod(seen, axis=0))
        s += 1

    def linear(name, x):
        return x @ net[f"deformation_net.{name}.weight"].T + net[f"deformation_net.{name}.bias"]

    hidden, i = linear("feature_out.0", np.concatenate(parts, axis=1)), 2
    while f"deformation_net.feature_out.{i}.weight" in net:
        hidden, i = linear(f"feature_out.{i}", np.maximum(hidden, 0)), i + 2
    moved = {}
    for (head, x), flag in zip(rest.items(), ("dx", "ds", "dr", "do", "dshs"), strict=True):
        inner = linear(f"{head}_deform.1", np.maximum(hidden, 0))
        residual = linear(f"{head}_deform.3", np.maximum(inner, 0)).reshape(len(x), -1)
        moved[head] = x if flags[f"no_{flag}"] else x + residual.reshape(len(x), *_shape(head))
    return _activated(moved, np)


def _shape(head):
    return (16, 3) if head == "shs" else (HEADS[head],)


def _sample(plane, x, y):
    """Bilinear samples of [channels, rows, columns] at -1 ... 1, corners aligned, borders kept."""
    _, rows, columns = plane.shape

    def place(u, count):
        u = np.clip((u + 1) / 2 * (count - 1), 0, count - 1)
        low = np.minimum(np.floor(u).astype(int), count - 2)
        return low, u - low

    (r, dy), (c, dx) = place(y, rows), place(x, columns)
    top = plane[:, r, c] * (1 - dx) + plane[:, r, c + 1] * dx
    bottom = plane[:, r + 1, c] * (1 - dx) + plane[:, r + 1, c + 1] * dx
    return (top * (1 - dy) + bottom * dy).T


def _activated(moved, xp):
    length = (moved["rotations"] ** 2).sum(-1)[:, None] ** 0.5
    return {
        "mean": moved["pos"],
        "scale": xp.exp(moved["scales"]),
        "quat": moved["rotations"] / length,
        "opacity": 1 / (1 + xp.exp(-moved["opacity"][:, 0])),
        "harmonics": moved["shs"],
    }


def torch_forward(path, table, time, flags=FLAGS):
    """The same by torch: the file read by torch.load, planes by its own grid_sample."""
    import torch
    from torch.nn import functional as F

    net = torch.load(path, map_location="cpu", weights_only=True)
    rest = {k: torch.tensor(x) for k, x in columns(table).items()}
    largest, smallest = net["deformation_net.grid.aabb"]
    place = (rest["pos"] - largest) * (2.0 / (smallest - largest)) - 1.0
    place = torch.cat([place, torch.full_like(place[:, :1], time)], dim=-1)
    parts, s = [], 0
    while f"deformation_net.grid.grids.{s}.0" in net:
        total = 1.0
        for p, pair in enumerate(PAIRS):
            where = place[:, pair].view(1, -1, 1, 2)
            plane = net[f"deformation_net.grid.grids.{s}.{p}"]
            seen = F.grid_sample(
                plane, where, mode="bilinear", padding_mode="border", align_corners=True
            )
            total = total * seen[0, :, :, 0].T
        parts.append(total)
        s += 1

    def linear(name, x):
        names = (f"deformation_net.{name}.{part}" for part in ("weight", "bias"))
        return F.linear(x, *(net[k] for k in names))

    hidden, i = linear("feature_out.0", torch.cat(parts, dim=-1)), 2
    while f"deformation_net.feature_out.{i}.weight" in net:
        hidden, i = linear(f"feature_out.{i}", F.relu(hidden)), i + 2
    moved = {}
    for (head, x), flag in zip(rest.items(), ("dx", "ds", "dr", "do", "dshs"), strict=True):
        residual = linear(f"{head}_deform.3", F.relu(linear(f"{head}_deform.1", F.relu(hidden))))
        moved[head] = x if flags[f"no_{flag}"] else x + residual.view(-1, *_shape(head))
    return {k: x.numpy() for k, x in _activated(moved, torch).items()}
