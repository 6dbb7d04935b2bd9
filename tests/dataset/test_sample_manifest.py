"""What is produced is read back: by lines, by frames, by both readers, and out of tar files."""

import json
import tarfile

import jax
import numpy as np
import pytest

from experiments.reading.jax_reader import batches
from gaussray.capture.frames import read_image
from gaussray.dataset.images import write_image
from gaussray.dataset.pack import pack
from gaussray.dataset.sample_manifest import read_frames, read_samples


POSE = np.eye(4, dtype=np.float32).tolist()


@pytest.fixture
def data(tmp_path):
    """Two samples of two and three frames, brighter from frame to frame."""
    lines, light = [], iter(np.linspace(0.1, 0.9, 5, dtype=np.float32))
    for index, count in enumerate((2, 3)):
        folder, frames = f"takes/{index:06d}", []
        for i in range(count):
            path = f"images/{i:04d}.exr"
            write_image(tmp_path / folder / path, np.full((4, 6, 3), next(light)))
            times = [0.5] if index else [0.1, 0.2, 0.3, 0.4]
            frames.append({"file_path": path, "w": 6, "h": 4, "transform_matrix": POSE, "time": 0.5,
                           "row_times": times, "labels": {"moving": path}})  # fmt: skip
        lines.append({"version": 1, "index": index, "folder": folder, "frames": frames})
    text = "".join(json.dumps(line) + "\n" for line in lines)
    (tmp_path / "manifest.jsonl").write_text(text)
    return tmp_path


def brightness(frame, data):
    return float(read_image(data / frame["file_path"], 6, 4).mean())


def test_frames_know_their_sample_and_their_files(data):
    frames = list(read_frames(data))
    assert [frame["take"]["index"] for frame in frames] == [0, 0, 1, 1, 1]
    assert frames[3]["labels"] == {"moving": "takes/000001/images/0001.exr"}
    found = [brightness(frame, data) for frame in frames]
    # Half floats.
    np.testing.assert_allclose(found, np.linspace(0.1, 0.9, 5), rtol=2**-11)


def test_a_manifest_that_cannot_be_read_says_why(data):
    with pytest.raises(
        OSError, match="nowhere/manifest.jsonl: cannot be read.*sample=cameras dataset.count"
    ):
        list(read_samples(data / "nowhere"))
    path = data / "manifest.jsonl"
    path.write_text(path.read_text().replace('"version": 1', '"version": 2'))
    with pytest.raises(ValueError, match="line 1 is of version 2, this gaussray reads version 1"):
        list(read_samples(data))
    path.write_text("{\n")
    with pytest.raises(ValueError, match="line 1: malformed JSON"):
        list(read_samples(data))


def test_jax_reads_every_frame_once_in_an_order_of_the_key(data):
    seen = list(batches(data, 2, jax.random.key(0)))
    assert [len(batch["sample"]) for batch in seen] == [2, 2]
    assert seen[0]["light"].shape == (2, 4, 6, 3) and seen[0]["row_times"].shape == (2, 4)
    light = np.concatenate([batch["light"].mean(axis=(1, 2, 3)) for batch in seen])
    assert len(set(light.tolist())) == 4
    for batch in seen:
        for sample, times in zip(batch["sample"], batch["row_times"], strict=True):
            expected = [0.5] * 4 if sample else [0.1, 0.2, 0.3, 0.4]
            np.testing.assert_allclose(times, expected, rtol=1e-6)


def test_torch_reads_what_the_manifest_lists(data):
    torch = pytest.importorskip("torch", reason="an extra")

    from gaussray.torch import SavedFrames

    (batch,) = torch.utils.data.DataLoader(SavedFrames(data), batch_size=5)
    assert batch["light"].shape == (5, 3, 4, 6) and batch["sample"].tolist() == [0, 0, 1, 1, 1]
    np.testing.assert_allclose(batch["pixel_times"][2:], 0.5)
    np.testing.assert_allclose(batch["pixel_times"][0, :, 5], [0.1, 0.2, 0.3, 0.4], rtol=1e-6)


def test_tar_files_hold_every_frame_and_are_the_same_bytes(data, tmp_path):
    first, second = (pack(data, tmp_path / name, frames_per_tar=3) for name in "ab")
    assert [path.name for path in first] == ["000000.tar", "000001.tar"]
    assert [p.read_bytes() for p in first] == [p.read_bytes() for p in second]
    names = []
    for path in first:
        with tarfile.open(path) as tar:
            names += tar.getnames()
    keys = list(dict.fromkeys(name.split(".")[0] for name in names))
    assert keys == ["000000_0000", "000000_0001", "000001_0000", "000001_0001", "000001_0002"]
    with tarfile.open(first[0]) as tar:
        frame = json.load(tar.extractfile("000001_0000.json"))
        assert frame["take"] == {"version": 1, "index": 1, "folder": "takes/000001"}
        picture = tar.extractfile("000001_0000.exr").read()
        assert picture == (data / frame["file_path"]).read_bytes()
    with pytest.raises(ValueError, match="frames_per_tar must be at least 1, got 0"):
        pack(data, tmp_path / "c", frames_per_tar=0)


# The library leaves its files to be closed by themselves.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_webdataset_reads_the_tar_files(data, tmp_path):
    webdataset = pytest.importorskip("webdataset")
    (path,) = pack(data, tmp_path / "tars")
    samples = list(webdataset.WebDataset(str(path), shardshuffle=False))
    assert len(samples) == 5 and set(samples[0]) >= {"exr", "json", "moving.exr"}
