"""Layouts of published datasets, read as the loaders of those datasets do."""

import itertools
import json
import os
import shutil
import struct

import numpy as np
import OpenImageIO as oiio
import pytest
import toy

from gaussray.capture.picture_file import read_stored
from gaussray.cli.main import main
from gaussray.dataset.layers import read_layers
from gaussray.dataset.layouts import check_layout, depth_levels, write_layout
from gaussray.dataset.manifest import write_manifest
from gaussray.dataset.optical_flow import write_flo, write_kitti_flow
from gaussray.dataset.sample_manifest import read_frames
from gaussray.scene.store import save_scene


pytestmark = pytest.mark.usefixtures("known_sizes")

# Levels of 255 that interpolation between states of the scene changes.
KEYS = 3
# Half a step of KITTI's levels, in pixels, and of TUM's, in units.
STEP = 0.5 / 64
DEPTH_STEP = 0.5 / 5000


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Two samples of three frames with a rolling shutter, rendered."""
    scene, out = tmp_path_factory.mktemp("scene"), tmp_path_factory.mktemp("data")
    save_scene(scene / "scene.npz", toy.scene())
    write_manifest(scene / "cameras.json", toy.records())
    main(
        [
            *("render", f"scene={scene}", f"out={out}", "dataset.count=2", "dataset.frames=3"),
            *("lens=pinhole", "shutter.readout=0.4", "render.samples=1", "trace.levels=0"),
            *("labels=[flow_forward,global_first,global_middle,z,moving]", "trace.group=2"),
            *("trace.chunk=8", "trace.k=4", "quiet=true", "report=false"),
        ]
    )
    return out


def stored(path):
    return read_stored(path, 16, 16).astype(float)


@pytest.mark.ci
def test_the_twins_of_a_rolling_shutter_agree_with_it_in_their_rows(data):
    """The first row of the picture is the first twin's; the middle row is the middle twin's, but
    for the states of the scene, between which a rolling shutter interpolates."""
    differ = 0.0
    for frame in read_frames(data):
        rolling = stored(data / frame["file_path"])
        first, middle = (
            stored(data / frame["labels"][f"global_{name}"]) for name in ("first", "middle")
        )
        np.testing.assert_allclose(rolling[0], first[0], atol=KEYS)
        np.testing.assert_allclose(rolling[8], middle[8], atol=KEYS)
        differ = max(differ, np.abs(rolling[8] - first[8]).max())
    assert differ > 20


def fastec_pairs(root, length=2):
    """Paths as the loader of Liu et al. (2020) collects them."""
    found = []
    for folder, _, files in sorted(os.walk(root)):
        if "meta.log" not in files:
            continue
        for i in range(34):
            names = [os.path.join(folder, f"{i + j:03d}") for j in range(length)]
            if not os.path.exists(f"{names[0]}_rolling.png"):
                continue
            if not os.path.exists(f"{names[-1]}_rolling.png"):
                break
            found.append([(f"{x}_rolling.png", f"{x}_global_first.png") for x in names])
    return found


def test_the_loader_of_fastec_rs_finds_every_pair(data, tmp_path, capsys):
    main(["pack", f"data={data}", f"out={tmp_path}", "layout=fastec_rs"])
    assert "6 frames in the layout fastec_rs" in capsys.readouterr().out
    pairs = fastec_pairs(tmp_path)
    assert len(pairs) == 4
    frames = list(read_frames(data))
    for pair, index in zip(pairs, (0, 1, 3, 4), strict=True):
        for (rolling, first), frame in zip(pair, frames[index:], strict=False):
            np.testing.assert_array_equal(stored(rolling), stored(data / frame["file_path"]))
            twin = data / frame["labels"]["global_first"]
            np.testing.assert_array_equal(stored(first), stored(twin))


def kitti(path):
    """Flow and validity as the development kit of KITTI defines them."""
    image = oiio.ImageInput.open(str(path))
    levels = image.read_image(oiio.UINT16).astype(float)
    image.close()
    return (levels[..., :2] - 2**15) / 64, levels[..., 2]


def flo(path):
    """Flow as Middlebury's flowIO reads it."""
    content = path.read_bytes()
    tag, width, height = struct.unpack("<fii", content[:12])
    assert tag == 202021.25 and len(content) == 12 + 8 * width * height
    return np.frombuffer(content, "<f4", offset=12).reshape(height, width, 2)


def test_flow_is_read_as_kitti_and_sintel_do(data, tmp_path):
    assert write_layout(data, tmp_path / "kitti", "kitti_flow") == 4
    assert write_layout(data, tmp_path / "sintel", "sintel") == 4
    frames = list(read_frames(data))
    pairs = [(a, b) for a, b in itertools.pairwise(frames) if a["take"] == b["take"]]
    folders = [f"{a['take']['index']:06d}" for a, _ in pairs]
    for number, (frame, after) in enumerate(pairs):
        layers = read_layers(data / frame["labels"]["layers"])
        true = np.stack([layers["flow_forward.x"], layers["flow_forward.y"]], axis=-1)
        known = ~np.isnan(true).any(axis=-1)
        assert known.any()
        training = tmp_path / "kitti/training"
        flow, valid = kitti(training / f"flow_occ/{number:06d}_10.png")
        np.testing.assert_array_equal(valid, known)
        np.testing.assert_allclose(flow[known], true[known], atol=STEP)
        for name, one in (("10", frame), ("11", after)):
            copy = stored(training / f"image_2/{number:06d}_{name}.png")
            np.testing.assert_array_equal(copy, stored(data / one["file_path"]))
        name = f"{folders[number]}/frame_{number % 2 + 1:04d}"
        found = flo(tmp_path / f"sintel/training/flow/{name}.flo")
        np.testing.assert_array_equal(found[known], true[known])
        assert np.all(np.abs(found[~known]) > 1e9)
        assert (tmp_path / f"sintel/training/final/{name}.png").is_file()


def test_flow_that_does_not_fit_is_not_valid(tmp_path):
    flow = np.array([[[511.98, -512.0], [600.0, 0.0]], [[np.nan, 0.0], [-0.25, 1.5]]])
    write_kitti_flow(tmp_path / "a.png", flow)
    found, valid = kitti(tmp_path / "a.png")
    np.testing.assert_array_equal(valid, [[1, 0], [0, 1]])
    np.testing.assert_allclose(found[valid > 0], flow[valid > 0], atol=STEP)
    write_flo(tmp_path / "a.flo", flow)
    np.testing.assert_allclose(flo(tmp_path / "a.flo")[0], flow[0].astype(np.float32))


def test_what_a_layout_lacks_is_named(data, tmp_path):
    with pytest.raises(ValueError, match="layout must be one of webdataset, fastec_rs.*got 'none'"):
        write_layout(data, tmp_path, "none")
    manifest = (data / "manifest.jsonl").read_text()
    (tmp_path / "manifest.jsonl").write_text(manifest.replace("global_first", "other"))
    shutil.copytree(data / "takes", tmp_path / "takes")
    with pytest.raises(ValueError, match="labels=.global_first"):
        write_layout(tmp_path, tmp_path / "out", "fastec_rs")


def carla_pairs(root, length=2):
    """Motion and paths as the loader of Liu et al. (2020) collects them."""
    found = []
    for folder, _, files in sorted(os.walk(root)):
        if "gt_vel.log" not in files:
            continue
        with open(os.path.join(folder, "gt_vel.log")) as log:
            motion = [float(x) for line in log if "#" not in line for x in line.split(" ")]
        names = [os.path.join(folder, f"{i:04d}") for i in range(10)]
        names = [name for name in names if os.path.isfile(f"{name}_rs.png")]
        for i in range(len(names) - length + 1):
            found.append((motion, names[i : i + length]))
    return found


def test_the_loader_of_carla_rs_finds_every_pair(data, tmp_path):
    assert write_layout(data, tmp_path, "carla_rs") == 6
    pairs, frames = carla_pairs(tmp_path), list(read_frames(data))
    assert len(pairs) == 4
    for (motion, names), index in zip(pairs, (0, 1, 3, 4), strict=True):
        # The cameras of this scene stand still.
        assert motion == [0] * 6
        for name, frame in zip(names, frames[index:], strict=False):
            for end, label in (("gs_f", "global_first"), ("gs_m", "global_middle")):
                true = stored(data / frame["labels"][label])
                np.testing.assert_array_equal(stored(f"{name}_{end}.png"), true)
            true = stored(data / frame["file_path"])
            np.testing.assert_array_equal(stored(f"{name}_rs.png"), true)


def bs_rsc_triples(root):
    """Three neighbouring rolling shutters and the global shutter of the middle one, as the loader
    of Cao et al. (2022) collects them (dataset/bsrsc.py of github.com/ljzycmd/BSRSC, `n_c`): each
    entry of the root is a video, each of its GS/ a frame NUMBER.SUFFIX that RS/ has as well."""
    found = []
    for video in sorted(os.listdir(root)):
        for name in sorted(os.listdir(os.path.join(root, video, "GS")))[1:-1]:
            number, suffix = name.split(".")
            near = [f"{int(number) + i:0{len(number)}d}.{suffix}" for i in (-1, 0, 1)]
            rolling = [stored(os.path.join(root, video, "RS", one)) for one in near]
            found.append((rolling, stored(os.path.join(root, video, "GS", near[1]))))
    return found


def test_the_loader_of_bs_rsc_finds_every_frame(data, tmp_path):
    """The middle row of a rolling shutter is that of its global shutter."""
    assert write_layout(data, tmp_path, "bs_rsc") == 6
    triples, frames = bs_rsc_triples(tmp_path), list(read_frames(data))
    assert len(triples) == 2
    for (rolling, twin), index in zip(triples, (0, 3), strict=True):
        for one, frame in zip(rolling, frames[index : index + 3], strict=True):
            np.testing.assert_array_equal(one, stored(data / frame["file_path"]))
        true = stored(data / frames[index + 1]["labels"]["global_middle"])
        np.testing.assert_array_equal(twin, true)
        np.testing.assert_allclose(rolling[1][8], twin[8], atol=KEYS)


def test_one_key_renders_the_labels_of_a_layout_and_writes_it(data, tmp_path, capsys):
    scene = tmp_path / "scene"
    save_scene(scene / "scene.npz", toy.scene())
    write_manifest(scene / "cameras.json", toy.records())
    words = ["render", f"scene={scene}", f"out={tmp_path}/out", "lens=pinhole", "quiet=true"]
    words += ["report=false", "shutter.readout=0.4", "render.samples=1", "trace.levels=0"]
    words += ["trace.group=2", "trace.chunk=8", "trace.k=4", "dataset.layout=fastec_rs"]
    with pytest.raises(SystemExit):
        main(words)
    assert "needs dataset.count" in capsys.readouterr().err
    main([*words, "dataset.count=1", "dataset.frames=2"])
    assert "2 frames in the layout fastec_rs" in capsys.readouterr().out
    assert len(fastec_pairs(tmp_path / "out/fastec_rs")) == 1
    with pytest.raises(SystemExit):
        main([*words[:-1], "dataset.layout=other", "dataset.count=1"])
    assert "dataset.layout must be empty or one of fastec_rs" in capsys.readouterr().err


def gray(path):
    """Levels of a picture of one channel."""
    image = oiio.ImageInput.open(str(path))
    assert image.spec().nchannels == 1 and image.spec().format == oiio.UINT16
    levels = image.read_image(oiio.UINT16).astype(float)[..., 0]
    image.close()
    return levels


def tum_files(path):
    """Times and file names, as TUM's associate.py reads them."""
    lines = [line.split() for line in path.read_text().splitlines() if line[0] != "#"]
    return {float(time): name for time, name in lines}


def test_depth_is_read_as_tum_does(data, tmp_path):
    """5,000 levels a unit along the camera's axis, 0 for none, at the times of the pictures."""
    assert write_layout(data, tmp_path, "tum") == 6
    frames = list(read_frames(data))
    for sample in ("000000", "000001"):
        pictures, depths = (tum_files(tmp_path / sample / f"{x}.txt") for x in ("rgb", "depth"))
        mine = [frame for frame in frames if f"{frame['take']['index']:06d}" == sample]
        assert list(pictures) == list(depths) and len(depths) == len(mine) == 3
        for name, frame in zip(depths.values(), mine, strict=True):
            true = read_layers(data / frame["labels"]["layers"])["z"]
            levels = gray(tmp_path / sample / name)
            seen = np.isfinite(true)
            assert seen.any() and not seen.all()
            np.testing.assert_allclose(levels[seen] / 5000, true[seen], atol=DEPTH_STEP)
            np.testing.assert_array_equal(levels[~seen], 0)


@pytest.mark.parametrize(("layout", "most"), [("carla_rs", 10), ("fastec_rs", 34)])
def test_frames_that_a_layout_leaves_out_are_told(layout, most):
    (record,) = toy.records(toy.TIMES[:1], toy.CAMERAS[:1])
    line = f"dataset.layout={layout} takes {most} frames of a sample; {most + 1} are rendered."
    told = []
    for name, count in ((layout, most + 1), (layout, most), ("tum", 40), ("", 40)):
        check_layout(name, [record] * count, told.append)
    assert told == [line]


def test_layouts_with_a_path_take_one_camera_in_a_sample():
    several = toy.records(toy.TIMES[:2], toy.CAMERAS[:2])
    for layout in ("euroc", "carla_rs", "tum"):
        with pytest.raises(ValueError, match=f"layout={layout} takes .* of one camera, got .*,"):
            check_layout(layout, several, print)
    check_layout("sintel", several, print)


def test_depth_that_does_not_fit_is_none():
    depth = np.array([[13.107, 13.2, np.nan], [np.inf, 0.0, 1.0]])
    np.testing.assert_array_equal(depth_levels(depth), [[65535, 0, 0], [0, 0, 5000]])


def image_folder(root):
    """Rows as Hugging Face's image folders define them: lines of metadata.jsonl, whose columns
    `file_name` and `*_file_name` are pictures beside it; all lines have the same columns."""
    folder, rows = root / "train", []
    for line in (folder / "metadata.jsonl").read_text().splitlines():
        entry = json.loads(line)
        pictures = {k: folder / v for k, v in entry.items() if k.endswith("file_name")}
        opened = {k.removesuffix("_file_name"): stored(path) for k, path in pictures.items()}
        rows.append(entry | opened)
    assert all(list(row) == list(rows[0]) for row in rows)
    return rows


def test_an_image_folder_has_pictures_labels_and_cameras(data, tmp_path, capsys):
    main(["pack", f"data={data}", f"out={tmp_path}", "layout=imagefolder"])
    assert "6 frames in the layout imagefolder" in capsys.readouterr().out
    rows = image_folder(tmp_path)
    for row, frame in zip(rows, read_frames(data), strict=True):
        assert row["sample"] == frame["take"]["index"] and row["time"] == frame["time"]
        assert row["transform_matrix"] == frame["transform_matrix"]
        entry = json.loads(row["entry"])
        assert entry == {k: v for k, v in frame.items() if k != "take"}
        np.testing.assert_array_equal(row["file_name"], stored(data / frame["file_path"]))
        for label in ("global_first", "global_middle", "moving"):
            np.testing.assert_array_equal(row[label], stored(data / frame["labels"][label]))
        layers = read_layers(tmp_path / "train" / row["layers"])
        np.testing.assert_array_equal(
            layers["z"], read_layers(data / frame["labels"]["layers"])["z"]
        )
