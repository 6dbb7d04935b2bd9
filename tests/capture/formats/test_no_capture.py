"""Folders that are no capture: what is in them decides what the message says to do."""

import json
import time

import pytest

from gaussray.capture.errors import CaptureError
from gaussray.capture.formats import no_capture
from gaussray.capture.open import open_capture


def lay(folder, *files):
    for name, content in files:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
    return folder


TOML = "[cam_0]\nmatrix = [[1.0]]\nrotation = [0.0, 0.0, 0.0]\n"
QUALISYS = '<cameras><camera serial="1"><transform x="1"/><intrinsic x="1"/></camera></cameras>'
KALIBR = "cam0:\n  camera_model: pinhole\n"
PANOPTIC = json.dumps({"cameras": [{"name": name, "K": [], "R": []} for name in "ab"]})
NAMES = '%YAML:1.0\n---\nnames:\n  - "1"\n  - "11"\nK_1: !!opencv-matrix\n'
# Pictures that no camera took, in a folder that comes first.
TEXTURES = [("mesh/rock/2.jpg", ""), ("mesh/rock/a.obj", "")]
POINTER = "version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 772721\n"
STEREO = "%YAML:1.0\nR: !!opencv-matrix\n   rows: 3\nT: !!opencv-matrix\n"
RUN = json.dumps({"command": "gaussray prepare videos=a out=b"})


@pytest.mark.parametrize(
    ("files", "told"),
    [
        (
            [("sfm.abc", ""), ("images/a.jpg", "")],
            "convertSfMFormat -i sfm.abc -o cameras.sfm`. Or .* videos={}/images",
        ),
        ([("sfm_data.bin", "")], "ConvertSfM_DataFormat -i sfm_data.bin -o sfm_data.json`. Or"),
        ([("sparse/0/cameras.bin", "")], "cameras.bin of COLMAP's model without images.bin"),
        ([("cameras.txt", "")], "cameras.txt of COLMAP's model without images.txt"),
        ([("a.MP4", "")], "prepare videos={} out=OUT` finds"),
        ([("x/a/1.png", ""), ("x/b/1.png", "")], "prepare videos={}/x out=OUT` finds"),
        ([("images/1.png", ""), ("other/1.png", "")], "prepare videos={}/images out=OUT"),
        ([("intri.yml", ""), ("images/a/1.png", "")], "prepare videos={}/images poses.calib"),
        (
            [("intri.yml", NAMES), *TEXTURES, ("train/1.jpg", ""), ("train/11.jpg", "")]
            + [("train/train/r_0.png", ""), ("masks/1/0.png", ""), ("masks/11/0.png", "")],
            "prepare videos={}/train poses.calibration={} out",
        ),
        (
            [("intri.yml", NAMES), *TEXTURES, ("films/1/0.png", ""), ("films/11/0.png", "")],
            "prepare videos={}/films poses.calibration={} out",
        ),
        (
            [("intri.yml", ""), *TEXTURES, ("train/1/0.png", ""), ("train/1/1.png", "")],
            "prepare videos={}/train poses.calibration={} out",
        ),
        (
            [("c.json", PANOPTIC), *TEXTURES, ("films/a.mp4", ""), ("films/b.mp4", "")],
            "prepare videos={}/films poses.calibration={}/c.json out",
        ),
        (
            [("rig.toml", TOML + TOML.replace("_0", "_1")), ("mesh/1.png", "")]
            + [("films/cam_0.mp4", ""), ("films/cam_1.mp4", "")],
            "prepare videos={}/films poses.calibration={}/rig.toml out",
        ),
        (
            [("a.nvm", "NVM_V3"), ("images/1.jpg", "")],
            "a.nvm of VisualSFM has poses that are not read.*videos={}/images out=OUT` finds",
        ),
        ([("in/transforms.json", "{}")], "name {}/in, which is one"),
        ([("rgb/1.png", ""), ("depth/1.png", "")], "prepare videos={}/rgb out=OUT`"),
        ([("masks/1.png", "")], "prepare videos={}/masks out=OUT`"),
        (
            [("poses.txt", ""), ("rgb/1.png", "")],
            r"format: `gaussray prepare videos={}/rgb out=OUT` finds .* \(poses.txt\) is of no",
        ),
        ([("camera_array.toml", TOML), ("a.mp4", "")], "videos={} poses.calibration={}/camera_arr"),
        ([("calibration.toml", TOML)], "videos=VIDEOS poses.calibration={}/calibration.toml out"),
        (
            [("x/rig.qca.txt", QUALISYS), ("x/a.mp4", "")],
            "videos={}/x poses.calibration={}/x/rig.q",
        ),
        (
            [("chain.yaml", KALIBR), ("in/a.mp4", "")],
            "videos={}/in poses.calibration={}/chain.yaml",
        ),
        ([("extrinsics.yml", STEREO), ("a.mp4", "")], "poses.calibration={}/extrinsics.yml out"),
        ([("s.xml", "<opencv_storage><R a=''><T a=''>")], "poses.calibration={}/s.xml out"),
        ([("s.npz", "PK R.npy PK T.npy"), ("a.mp4", "")], "poses.calibration={}/s.npz out"),
        ([("c0.dat", "R:\n1 0 0\nT:\n0\n"), ("a.mp4", "")], "poses.calibration={}/c0.dat out"),
        ([("c.json", PANOPTIC), ("a.mp4", "")], "videos={} poses.calibration={}/c.json out"),
        ([("Intrinsic.yml", ""), ("Extrinsic.yml", "")], "poses.calibration={} out=OUT"),
        ([("board.toml", "[board]\nsquare = 2\n"), ("a.mp4", "")], "videos={} out=OUT` finds"),
        (
            [("prepare.json", "{}"), ("report.html", ""), ("images/a/1.png", "")],
            "`gaussray prepare` failed .* {}/report.html shows why",
        ),
        ([("run.json", RUN), ("config.yaml", "")], "failed .*; its message says why"),
        (
            [("reconstruction.json", POINTER), ("images/a.jpg", "")],
            "{}/reconstruction.json: is a pointer of Git LFS, not the file itself. `git lfs pull`",
        ),
        ([("groundtruth.txt", POINTER), ("rgb/1.5.png", "")], "groundtruth.txt: is a pointer of"),
        ([("sparse/0/a.json", POINTER), ("a.txt", "")], "sparse/0/a.json: is a pointer of Git"),
        ([("opensfm/reconstruction.json", POINTER)], "opensfm/reconstruction.json: is a pointer"),
        ([("poses.txt", ""), ("rgb/1.png", "")], "see docs/captures.md#poses-of-your-own"),
        ([("notes.txt", "")], "own: docs/captures.md#poses-of-your-own"),
        ([("notes.txt", "")], "must hold the files of one format, got none of them"),
        ([("reconstruction.json", "[1]")], "must hold the files of one format, got none of them"),
    ],
)
def test_what_a_folder_holds_decides_the_remedy(tmp_path, files, told):
    with pytest.raises(CaptureError, match=told.replace("{}", str(tmp_path))) as caught:
        open_capture(lay(tmp_path, *files))
    assert len(str(caught.value)) < 600 or "must hold the files of one format" in str(caught.value)


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_names_in_a_calibration_are_in_quotes_in_lists_and_at_starts_of_lines(end):
    text = end.join(
        ['"a b": 1', "  - c1  ", "- c-2", "[cam.3]", "  cam_4 ", "cam5: 1 2", "7 8", ""]
    )
    found = [word for names in no_capture._NAMES.findall(text) for word in names if word]
    assert found == ["a b", "c1", "c-2", "cam.3", "cam_4", "cam5"]


def test_blank_lines_take_no_time(tmp_path):
    lay(tmp_path, ("a.toml", "\n" * 90_000), ("a.yaml", " \n" * 45_000), ("v/1.png", ""))
    begin = time.perf_counter()
    no_capture._NAMES.findall((tmp_path / "a.toml").read_text())
    no_capture._calibration_in(tmp_path)
    assert time.perf_counter() - begin < 1
