"""Calibration recovers cameras that are recorded wrong, as well as its standard errors say."""

import dataclasses
import json

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.calibrate.options import CalibrateOptions
from gaussray.calibrate.parameters import corrected_camera, unit_camera_set, unknowns
from gaussray.calibrate.pipeline import calibrate
from gaussray.calibrate.residuals import ResidualEvaluator
from gaussray.calibrate.results import calibrated_records
from gaussray.calibrate.solver import CameraSolver, Observation, Solution, Sums
from gaussray.camera.lens import KannalaBrandt, pinhole
from gaussray.capture.formats.paired import read_capture
from gaussray.cli.main import main
from gaussray.color import srgb_decode, srgb_encode
from gaussray.dataset.images import write_image
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.io.safe.limits import Limits, limit, limits
from gaussray.render.options import RenderOptions
from gaussray.render.renderer import Renderer
from gaussray.report.run import json_document
from gaussray.scene.segmented import Clip
from gaussray.scene.store import save_scene


pytestmark = pytest.mark.ci


SIDE, TIMES, READOUT = 32, (0.3, 0.7), 0.3
# The bodies as far apart as the picture is high: rows that see nothing move say nothing of time.
SCENE = toy.scene()
SCENE = eqx.tree_at(lambda s: s.moving.mean, SCENE, SCENE.moving.mean * toy.single([[1, 2, 1]]))
MIDDLE = toy.single([SIDE / 2] * 2)
OPENCV = pinhole(2.2 * MIDDLE, MIDDLE, toy.single([-0.15, 0.04, 0, 0, 0, 0, 0, 0]))
FISHEYE = KannalaBrandt(1.8 * MIDDLE, MIDDLE, toy.single([0.06, -0.02, 0, 0]), toy.single(1.3))
GAIN = toy.single([1.2, 1.0, 0.85])
# What is wrong with a recording: logarithms of factors, focal lengths, radians, scene units.
WRONG = {
    "focal": 0.03, "center.x": 0.01, "center.y": -0.01, "k1": 0.03, "k2": -0.02, "readout": 0.2,
    "turn.right": 0.01, "turn.down": -0.01, "turn.forward": 0.02,
    "shift.right": 0.03, "shift.down": -0.02, "shift.forward": 0.04,
}  # fmt: skip
# What 8-bit pictures leave: of their rounding a few standard errors, and a share of the start's
# error that key states at other times and cut-offs make.
ERRORS, LEFT = 5.0, 0.05
# Deviation of drawn noise, encoded; so many draws leave a deviation uncertain by 18 %, and the
# largest of ten by twice that.
NOISE, DRAWS, FACTOR = 0.02, 16, 1.6


def filmed(lens, readout=READOUT):
    """The cameras that take the pictures."""
    cameras = [toy.camera(0.15, time, SIDE, SIDE) for time in TIMES]
    if readout:
        cameras = [toy.rolling(camera, readout) for camera in cameras]
    return [dataclasses.replace(camera, lens=lens) for camera in cameras]


def recorded(cameras, kinds):
    """The same cameras with errors of these kinds."""
    told, unit = unknowns(kinds, cameras[0].lens), unit_camera_set(cameras[0])
    value = toy.single([WRONG.get(one.name, 0.0) for one in told])
    return [
        jax.jit(lambda c: corrected_camera(value, c, unit, told)[0])(camera) for camera in cameras
    ]


def pictures(cameras, gain=1.0, scene=SCENE):
    """What the cameras see, in linear light."""
    renderer = Renderer(scene, options=RenderOptions(samples=1), trace=toy.TRACE)
    return [gain * np.asarray(renderer(camera).color) for camera in cameras]


def written(folder, cameras, shots):
    """A capture of these pictures, recorded by these cameras."""
    records = []
    for i, (camera, color) in enumerate(zip(cameras, shots, strict=True)):
        records.append(FrameRecord(f"images/{i:04d}.png", camera, "cam", "train"))
        write_image(folder / records[-1].file_path, color)
    write_manifest(folder / "transforms.json", records, extra={"time_unit": "s"})
    return folder


def assert_found(report, truth, *, left=LEFT):
    """Every number that is told is as near to the truth as it says, or all but there."""
    for row in report["parameters"]:
        if row["name"] in truth:
            error = abs(row["value"] - truth[row["name"]])
            begun = abs(row["start"] - truth[row["name"]])
            assert error < max(left * begun, ERRORS * row["standard_error"]["independent"]), row


def assert_at(found, truth, *, left=0.2):
    """Each camera stands where the truth's does, but for a share of how far off it was recorded:
    distance and focal length can hardly be told apart."""
    for view, start, camera in zip(found, *truth, strict=True):
        away, begun = (
            float(jnp.linalg.norm(c.trajectory.translation - camera.trajectory.translation))
            for c in (view.camera, start)
        )
        assert away < left * begun


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A scene that stands still, a capture whose camera is recorded wrong, and what came of it."""
    folder, truth = (
        tmp_path_factory.mktemp("calibrate"),
        filmed(pinhole(2.2 * MIDDLE, MIDDLE), 0)[:1],
    )
    still, begun = toy.scene(speed=0), recorded(truth, ("focal", "pose"))
    save_scene(folder / "scene.npz", still)
    written(folder / "capture", begun, pictures(truth, np.asarray(GAIN), still))
    main(
        ["calibrate", f"scene={folder}/scene.npz", f"capture.path={folder}/capture",
         f"out={folder}/found", "calibrate.parameters=[focal,pose,exposure]",
         "quiet=true"]
    )  # fmt: skip
    return folder, begun, truth


def test_what_is_recorded_wrong_is_found(run):
    report = json.loads((run[0] / "found" / "report.json").read_text())
    truth = dict(zip(("gain.red", "gain.green", "gain.blue"), map(float, GAIN), strict=True))
    assert_found(report, truth | {"focal": float(run[2][0].lens.focal[0])})
    assert report["psnr"]["after"] > report["psnr"]["before"] + 10
    assert [level["pixels"] for level in report["levels"]] == [2, 1]


def test_a_page_says_what_was_found(run):
    page, report = run[0] / "found" / "report.html", json_document(run[0] / "found" / "report.json")
    text = page.read_text()
    assert text.endswith("</html>\n") and "NaN" not in text and "gaussray calibrate" in text
    for row in report["parameters"]:
        assert f">{row['name']}<" in text and f">{row['value']:.6g}<" in text
    assert text.count("<svg") == 3 and "The camera" in text and "Cameras" in text


@pytest.fixture
def elsewhere():
    """Pictures may lie beside the list that names them, as those do that were calibrated."""
    before = limits()
    limit(Limits(folders=("/",)))
    yield
    limit(before)


def test_the_list_that_is_left_is_a_capture_with_the_camera_as_found(run, elsewhere):
    folder, begun, truth = run
    found = read_capture(folder / "found").views
    assert [view.image for view in found] == [(folder / "capture/images/0000.png").resolve()]
    assert_at(found, (begun, truth))


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("calibrate.parameters=[zoom]", "calibrate.parameters must be some of focal"),
        (
            "calibrate.coefficients=[k9]",
            "calibrate.coefficients must be empty unless",
        ),
        ("calibrate.cameras=[cam9]", "calibrate.cameras must be among cam, got 'cam9'"),
        ("calibrate.effect=blur", "calibrate.effect must be among pinhole"),
        ("calibrate.parameters=[shutter]", "got a shutter.row_step of 0. Write an estimate"),
        ("capture.scale=0.5", "capture.crop and capture.scale must be left alone"),
    ],
)
def test_what_cannot_be_calibrated_is_refused_by_its_key(run, capsys, word, message):
    with pytest.raises(SystemExit) as stop:
        main(
            ["calibrate", f"scene={run[0]}/scene.npz", f"capture.path={run[0]}/capture",
             f"out={run[0]}/refused", "quiet=true", word]
        )  # fmt: skip
    assert stop.value.code == 2
    assert message in capsys.readouterr().err


def test_a_frame_across_two_segments_is_refused(tmp_path):
    clip = Clip((toy.carried(0.0, 0.5), toy.carried(0.5, 1.0)))
    camera = toy.rolling(toy.camera(0.15, 0.5, SIDE, SIDE), READOUT)
    grey = np.full((SIDE, SIDE, 3), 128, np.uint8)
    capture = read_capture(written(tmp_path, [camera], [grey]))
    with pytest.raises(
        ValueError,
        match="0000.png: must show one segment of the scene, got a readout across the time 0.5",
    ):
        calibrate(clip, capture, tmp_path, options=CalibrateOptions(), quiet=True)


def test_coefficients_that_make_no_lens_are_refused(tmp_path):
    cameras = filmed(FISHEYE, 0)[:1]
    grey = np.full((SIDE, SIDE, 3), 128, np.uint8)
    views = read_capture(written(tmp_path, cameras, [grey])).views
    camera = views[0].camera
    parameters = unknowns(("lens",), camera.lens)
    shot = Observation(np.zeros(()), np.zeros(()), camera, 0, SCENE, 1)
    evaluator = ResidualEvaluator(samples=1, trace=toy.TRACE, bend=1.0)
    solver = CameraSolver([shot], parameters, unit_camera_set(camera), evaluator)
    # r(theta) turns back before the rim.
    value = np.array([-1e6 * (one.name == "k2") for one in parameters])
    sums = Sums(*(np.zeros(1),) * 5)
    solution = Solution(value, sums, sums, [])
    with pytest.raises(ValueError, match=r"no valid lens: lens.k .*more calibrate.coarsest blocks"):
        calibrated_records(solver, solution, views, "pinhole", ["cam"])


@pytest.mark.slow
@pytest.mark.parametrize("lens", [OPENCV, FISHEYE], ids=["opencv", "kannala_brandt"])
def test_everything_is_found_at_once(tmp_path, lens, elsewhere):
    truth, kinds = filmed(lens), ("focal", "lens", "shutter", "pose")
    begun = recorded(truth, kinds)
    capture = read_capture(written(tmp_path, begun, pictures(truth, np.asarray(GAIN))))
    chosen = CalibrateOptions(parameters=(*kinds, "exposure"), coarsest=8)
    report = calibrate(SCENE, capture, tmp_path / "out", options=chosen, quiet=True)
    bent = lens.distortion if lens is OPENCV else lens.coefficients
    real = {"focal": float(lens.focal[0]), "center.x": SIDE / 2, "center.y": SIDE / 2}
    real |= {"k1": float(bent[0]), "k2": float(bent[1]), "readout": READOUT}
    real |= dict(zip(("gain.red", "gain.green", "gain.blue"), map(float, GAIN), strict=True))
    assert_found(report, real)
    assert_at(read_capture(tmp_path / "out").views, (begun, truth))


@pytest.mark.slow
def test_a_readout_that_no_picture_shows_is_refused_by_name(tmp_path):
    still, cameras = toy.scene(speed=0), filmed(OPENCV)
    capture = read_capture(written(tmp_path, cameras, pictures(cameras, scene=still)))
    with pytest.raises(ValueError, match="readout has no effect on these pictures .*moves"):
        chosen = CalibrateOptions(parameters=("shutter",), coarsest=32)
        calibrate(still, capture, tmp_path, options=chosen, trace=toy.TRACE, quiet=True)


@pytest.mark.slow
def test_values_scatter_as_their_standard_errors_say(tmp_path):
    truth, still, values, errors = filmed(OPENCV, 0)[:1], toy.scene(speed=0), [], []
    light = pictures(truth, scene=still)[0].astype(np.float64)
    for seed in range(DRAWS):
        noise = NOISE * np.random.default_rng(seed).standard_normal(light.shape)
        noisy = srgb_decode(srgb_encode(light) + noise)
        folder = tmp_path / str(seed)
        capture = read_capture(written(folder, truth, [noisy]))
        chosen = CalibrateOptions(parameters=("focal", "pose", "exposure"), coarsest=32)
        report = calibrate(still, capture, folder / "out", options=chosen, quiet=True)
        values.append([row["value"] for row in report["parameters"]])
        errors.append([row["standard_error"]["independent"] for row in report["parameters"]])
    ratio = np.std(values, axis=0) / np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.all(np.abs(np.log(ratio)) < np.log(FACTOR)), ratio
