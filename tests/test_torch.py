"""PyTorch reads what was written, and renders the same frames while it reads."""

import subprocess
import sys

import jax
import numpy as np
import pytest
import toy

import gaussray
from gaussray.capture.frames import read_image
from gaussray.cli.main import main
from gaussray.dataset.layers import read_layers
from gaussray.dataset.manifest import write_manifest
from gaussray.scene.store import save_scene


torch = pytest.importorskip("torch", reason="an extra")
from gaussray.torch import RenderedFrames, SavedFrames, picture_tensors  # noqa: E402
from gaussray.torch.tensors import pixel_times  # noqa: E402


pytestmark = [pytest.mark.ci, pytest.mark.usefixtures("known_sizes")]

# Half floats of EXR files: 11 bits.
HALF = 2**-11
# Programs of a single frame and of many round differently.
ROUNDING = 1e-5
LABELS = ("depth", "normal", "moving", "sharp")
WORDS = (
    *(
        "lens=pinhole",
        "sample.lens.fov.uniform=[40,60]",
        "shutter.readout=0.2",
        "camera.kind=capture",
    ),
    *("render.samples=1", f"labels=[{','.join(LABELS)}]", "trace.levels=0", "trace.group=2"),
    *("trace.chunk=8", "trace.k=4", "dataset.seed=5", "sensor.exposure=0.5"),
)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A scene file with its cameras."""
    folder = tmp_path_factory.mktemp("scene")
    save_scene(folder / "scene.npz", toy.scene())
    write_manifest(folder / "cameras.json", toy.records())
    return folder


@pytest.fixture(scope="module")
def data(scene, tmp_path_factory):
    """Three samples, written."""
    out = tmp_path_factory.mktemp("data")
    main(
        [
            *("render", f"scene={scene}", f"out={out}", *WORDS, "format=exr", "dataset.count=3"),
            *("quiet=true", "report=false"),
        ]
    )
    return out


def test_a_saved_frame_is_its_files_and_its_entry_of_the_manifest(data):
    frames = SavedFrames(data, labels=LABELS)
    assert len(frames) == 3
    item, entry = frames[1], frames.frames[1]
    light = read_image(data / entry["file_path"], 16, 16)
    np.testing.assert_array_equal(item["light"], light.transpose(2, 0, 1))
    np.testing.assert_allclose(item["pose"], entry["transform_matrix"], rtol=1e-6)
    np.testing.assert_allclose(item["pixel_times"][:, 7], entry["row_times"], rtol=1e-6)
    assert item["sample"] == 1
    assert float(item["drawn"]["lens.fov"]) == entry["take"]["drawn"]["lens.fov"]
    layers = read_layers(data / entry["labels"]["layers"])
    np.testing.assert_array_equal(item["depth"], layers["depth"])
    np.testing.assert_array_equal(item["normal"][2], layers["normal.z"])
    assert set(np.unique(item["moving"])) == {0, 1}


def test_a_loader_batches_the_frames(data):
    (batch,) = torch.utils.data.DataLoader(SavedFrames(data, labels=LABELS), batch_size=3)
    assert batch["light"].shape == batch["sharp"].shape == batch["normal"].shape == (3, 3, 16, 16)
    assert batch["pixel_times"].shape == (3, 16, 16) and batch["drawn"]["lens.fov"].shape == (3,)


@pytest.mark.parametrize("on_device", [False, True])
def test_what_is_rendered_is_what_the_command_writes(scene, data, on_device):
    saved = SavedFrames(data, labels=LABELS)
    rendered = RenderedFrames([f"scene={scene}", *WORDS], count=3, on_device=on_device)
    items = list(rendered)
    assert [int(item["sample"]) for item in items] == [0, 1, 2]
    for expected, item in zip(saved, items, strict=True):
        assert item.keys() == expected.keys()
        for name in ("light", "sharp"):
            np.testing.assert_allclose(item[name], expected[name], rtol=HALF, atol=ROUNDING)
        for name in ("pose", "time", "pixel_times", "depth", "normal", "moving"):
            assert item[name].dtype == expected[name].dtype
            np.testing.assert_allclose(item[name], expected[name], rtol=ROUNDING, atol=ROUNDING)
        assert item["drawn"] == expected["drawn"]


def test_a_shutter_that_reads_sideways_gives_every_column_its_time():
    times = pixel_times([1.0, 2.0, 3.0], "left_to_right", (3, 2))
    np.testing.assert_array_equal(times, [[1, 2, 3], [1, 2, 3]])
    times = pixel_times([1.0, 2.0], "bottom_to_top", (3, 2))
    np.testing.assert_array_equal(times, [[1, 1, 1], [2, 2, 2]])
    np.testing.assert_array_equal(pixel_times([4.0], "left_to_right", (3, 2)), np.full((2, 3), 4.0))


def test_a_stream_begins_anywhere_and_has_no_end(scene):
    stream = iter(RenderedFrames([f"scene={scene}", *WORDS[:-4], "labels=[]"], begin=7))
    assert [int(next(stream)["sample"]) for _ in range(3)] == [7, 8, 9]


def test_a_worker_takes_every_third_sample_of_three(scene, monkeypatch):
    class Worker:
        id, num_workers = 1, 3

    words = [f"scene={scene}", *WORDS[:-4], "labels=[]"]
    rendered = RenderedFrames(words, begin=10, count=8)
    monkeypatch.setattr("gaussray.torch.rendered.get_worker_info", lambda: Worker)
    assert [int(frame["sample"]) for frame in rendered] == [11, 14, 17]


def test_a_picture_is_shared_with_pytorch_without_a_copy():
    scene = jax.tree.map(lambda x: x, toy.scene(speed=0))
    options = gaussray.RenderOptions(samples=1)
    picture = gaussray.render(scene, toy.camera(), options=options, trace=toy.TRACE)
    tensors = picture_tensors(picture)
    for name, tensor in tensors.items():
        array = getattr(picture, name)
        assert tensor.data_ptr() == array.unsafe_buffer_pointer(), name
        np.testing.assert_array_equal(tensor, array)


def test_what_is_impossible_is_refused(scene, data):
    with pytest.raises(
        ValueError, match="labels must be among those that were rendered, got group"
    ):
        SavedFrames(data, labels=["depth", "group"])
    with pytest.raises(ValueError, match="0000.exr: must hold the label confusion, got depth"):
        SavedFrames(data, labels=["confusion"])[0]
    with pytest.raises(ValueError, match="count must be at least 0, got -1"):
        RenderedFrames([f"scene={scene}"], count=-1)
    with pytest.raises(ValueError, match="lens.fow"):
        RenderedFrames([f"scene={scene}", "lens.fow=3"])


def test_the_package_alone_does_not_import_pytorch():
    code = "import gaussray, gaussray.render, sys; print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
