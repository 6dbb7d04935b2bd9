"""Captures filmed with effects are learnt from, and cameras that were recorded wrong are found."""

import dataclasses
import json

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.camera.aperture import Aperture
from gaussray.camera.array import camera_set
from gaussray.camera.camera import Camera, project
from gaussray.camera.corrections import REFINABLE, fix_gauge, no_corrections
from gaussray.camera.film import Film
from gaussray.camera.lens import KannalaBrandt, pinhole
from gaussray.camera.refined_cameras import refined_frames
from gaussray.camera.shutter import Shutter
from gaussray.camera.trajectory import Trajectory
from gaussray.capture.formats.paired import read_capture
from gaussray.dataset.images import write_image
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.geometry import multiply, turning
from gaussray.reconstruct import loop, step as training, step_setup
from gaussray.reconstruct.block_sizes import BlockSizes
from gaussray.reconstruct.data.batches import gather
from gaussray.reconstruct.data.tiles import cut, tile_pixels
from gaussray.reconstruct.log import RunLog
from gaussray.reconstruct.motion import with_motion
from gaussray.reconstruct.optimize.learning_rates import OptimizerOptions
from gaussray.reconstruct.optimize.loss import LossOptions
from gaussray.reconstruct.optimize.optimizer import Parameters
from gaussray.reconstruct.optimize.state import begin_state
from gaussray.reconstruct.options import FitOptions
from gaussray.reconstruct.pipeline import reconstruct
from gaussray.reconstruct.run_progress import RunProgress
from gaussray.reconstruct.session import Session
from gaussray.reconstruct.start import initial_state
from gaussray.render.options import RenderOptions
from gaussray.render.renderer import Renderer
from gaussray.scene.gaussians import unconstrain
from gaussray.tracer.traverse import Capacity


pytestmark = pytest.mark.ci


SIDE, TIMES, READOUT = 32, (0.2, 0.5, 0.8), 0.3
ANGLES = dict(zip(toy.CAMERAS[:3], (-0.45, 0.0, 0.45), strict=True))
# The bodies as far apart as the picture is high: rows that see nothing move say nothing of time.
SCENE = toy.scene()
SCENE = eqx.tree_at(lambda s: s.moving.mean, SCENE, SCENE.moving.mean * toy.single([[1, 2, 1]]))
# Errors of the recording: factors of linear light, of the readout and of the focal lengths, delays
# of half an interval, and poses of half a degree and a hundredth of the extent.
GAIN = dict(zip(ANGLES, ([1.2, 1, 0.9], [0.8, 1, 1], [1 / 0.96, 1, 1 / 0.9]), strict=True))
MATRIX = dict(
    zip(ANGLES, np.eye(3) + np.array([1, 1, -2])[:, None, None] * 0.05 * np.array(
        [[1, -1, 0], [1, 0, -1], [0, 1, 1]]), strict=True)
)  # fmt: skip
LATE = dict(zip(ANGLES, (0.15, -0.05, -0.1), strict=True))
FOCAL = dict(zip(ANGLES, (1.02, 0.98, 1.02), strict=True))
SLOW, TURN, SHIFT = 1.3, np.radians(0.5), 0.01
# What may be left after the few steps of a test: 3 % of a gain and of a readout, and a fifth of the
# other errors.
FRACTION, LEFT = 0.03, 0.2
# Mean difference of pictures, more than half of them black: far below a step of 8 bits where the
# same rays see the same scene.
CODE = 0.5 / 255


def changed(camera, **parts):
    return Camera(**(vars(camera) | parts))


def frames():
    """Name and camera of every frame: pinholes whose rows are read one after the other."""
    return [
        (name, toy.rolling(toy.camera(angle, time, SIDE, SIDE), READOUT))
        for name, angle in ANGLES.items()
        for time in TIMES
    ]


def stack(cameras):
    return jax.tree.map(lambda *x: jnp.stack(x), *cameras)


def misplaced():
    """Turns and shifts (in extents) of the cameras that no similarity of all of them explains."""
    camera = stack([c for _, c in frames()])
    eye = np.asarray(camera.trajectory.translation[:, 0])
    extent = float(np.linalg.norm(np.ptp(eye, axis=0))) / 2
    owner = np.repeat(np.arange(3), len(TIMES))
    free = np.asarray(camera_set(owner, camera, extent=extent).pose_projector, np.float64)
    drawn = np.random.default_rng(1).choice([-1.0, 1.0], (3, 6)) * np.repeat([TURN, SHIFT], 3)
    pose = (free @ drawn.reshape(-1)).reshape(3, 2, 3) * [[[1.0], [extent]]]
    return dict(zip(ANGLES, pose, strict=True))


def wrong(kinds, name, camera):
    """A camera as it is recorded with errors of these kinds."""
    if "shutter" in kinds:
        camera = toy.rolling(camera, SLOW * READOUT)
    if "offset" in kinds:
        scale, s = SLOW if "shutter" in kinds else 1.0, camera.shutter
        early = s.row_offset - toy.single(scale * LATE[name])
        camera = changed(camera, shutter=Shutter(early, s.row_step, s.exposure))
    if "pose" in kinds:
        path, (turn, shift) = camera.trajectory, misplaced()[name]
        quat = multiply(turning(toy.single(turn)), path.quat[0])[None]
        place = path.translation + toy.single(shift)[None]
        camera = changed(camera, trajectory=Trajectory(path.time, quat, place))
    if "lens" in kinds:
        focal = toy.single(FOCAL[name]) * camera.lens.focal
        camera = changed(camera, lens=pinhole(focal, camera.lens.center))
    return camera


def written(folder, listed, pictures):
    """The capture of these frames and pictures."""
    records = []
    for i, ((name, camera), color) in enumerate(zip(listed, pictures, strict=True)):
        records.append(FrameRecord(f"images/{name}/{i:04d}.png", camera, name, "train"))
        write_image(folder / records[-1].file_path, color)
    write_manifest(folder / "transforms.json", records, extra={"ply_file_path": "points3d.ply"})
    toy.write_points(folder / "points3d.ply", SCENE)
    return read_capture(folder)


@pytest.fixture(scope="module")
def pictures():
    """What the cameras see of the toy, in linear light."""
    renderer = Renderer(SCENE, options=RenderOptions(samples=1), trace=toy.TRACE)
    return [renderer(camera).color for _, camera in frames()]


def recorded(folder, pictures, kinds):
    """The capture that the pictures are when it is recorded with errors of these kinds."""
    listed = [(name, wrong(kinds, name, camera)) for name, camera in frames()]
    if "exposure" in kinds:
        pictures = [
            color * np.float32(GAIN[name])
            for (name, _), color in zip(listed, pictures, strict=True)
        ]
    if "color_matrix" in kinds:
        pictures = [
            np.clip(color @ MATRIX[name].T.astype(np.float32), 0, None)
            for (name, _), color in zip(listed, pictures, strict=True)
        ]
    return written(folder, listed, pictures)


def options(*refine, steps=100):
    """Nothing learns but what is refined, which is kept without a trial."""
    known = OptimizerOptions.__dataclass_fields__
    still = {name: 0.0 for name in known if name not in ("decay", *REFINABLE)}
    fast = {"pose": 2e-3, "lens": 2e-3, "shutter": 4e-2, "exposure": 4e-2, "offset": 4e-2}
    fast |= {"color_matrix": 2e-2}
    return dataclasses.replace(
        toy.SHORT,
        fit=FitOptions(
            auto=False,
            fine=steps,
            tiles=12,
            block=25,
            moving_share=0.8,
            refine=refine,
            refine_gain=-1.0,
            points=1,
            surround=0.0,
        ),
        optimizer=OptimizerOptions(**(still | fast | {"decay": 0.05})),
        loss=LossOptions(plane_variation=0.0, time_smoothness=0.0, time_planes_from_one=0.0),
    )


def fit_of(capture, folder, chosen):
    return Session(capture, RunLog(folder, resume=False, interval=1e9), chosen, True)


def known_scene(fit):
    """The state of a fit that knows the scene and takes the cameras as they are recorded."""
    refine = fit.options.fit.refine
    corrections = no_corrections(refine, len(fit.names), fit.footage.camera)
    scene = unconstrain(SCENE.static), unconstrain(SCENE.moving), SCENE.deformation
    return begin_state(Parameters(*scene, corrections))


def off(fit, corrections=None):
    """How far the fit's cameras, corrected or not, see the scene's points from where they are:
    root mean square, in pixels."""
    points = jnp.concatenate([SCENE.static.mean, SCENE.moving.mean])
    seen = jax.jit(jax.vmap(project, in_axes=(None, 0)))
    views = [(view.camera_name, view.camera) for view in fit.capture.views]
    cameras = refined_frames(corrections, fit.cameras, fit.names, views)
    error = [
        seen(ours, points) - seen(c, points) for ours, (_, c) in zip(cameras, frames(), strict=True)
    ]
    return float(np.sqrt(np.mean(np.square(error))))


def assert_found(folder, pictures, kinds, steps=100):
    """What is recorded wrong is found in the pictures of a scene that is known."""
    fit = fit_of(
        recorded(folder / "capture", pictures, kinds), folder, options(*kinds, steps=steps)
    )
    state, _ = loop.run_stage(fit, "fine", known_scene(fit), RunProgress())
    corrections = state.parameters.corrections
    found = fix_gauge(corrections, fit.cameras)
    if "exposure" in kinds:
        np.testing.assert_allclose(np.exp(found.exposure), list(GAIN.values()), rtol=FRACTION)
    if "color_matrix" in kinds:
        # What the scene's colours say: not all of them fill the room of colours.
        light = np.concatenate([color.reshape(-1, 3) for color in pictures])
        for own, true in zip(found.color_matrix, MATRIX.values(), strict=True):
            left = light @ (np.eye(3) + np.asarray(own) - true).T
            assert np.abs(left).mean() < LEFT * np.abs(light @ (np.eye(3) - true).T).mean()
    if "shutter" in kinds:
        np.testing.assert_allclose(SLOW * np.exp(found.shutter), 1, rtol=FRACTION)
    if "offset" in kinds:
        late = np.asarray(found.offset) * float(fit.cameras.interval)
        np.testing.assert_allclose(late, list(LATE.values()), atol=LEFT * max(LATE.values()))
    if "pose" in kinds or "lens" in kinds:
        assert off(fit, corrections) < LEFT * off(fit)


@pytest.mark.slow
def test_a_wrong_readout_and_wrong_exposures_are_found_together(tmp_path, pictures):
    assert_found(tmp_path, pictures, ("shutter", "exposure"), steps=60)


@pytest.mark.slow
@pytest.mark.parametrize("kind", REFINABLE)
def test_each_kind_of_error_is_found_alone(tmp_path, pictures, kind):
    assert_found(tmp_path, pictures, (kind,))


def effects(camera):
    """The camera with everything on: a fisheye whose corners are black, a soft aperture, a wide
    film filter, an exposure and rows read one after the other."""
    middle, one = toy.single([SIDE / 2, SIDE / 2]), toy.single(1)
    return changed(
        camera,
        film=Film(SIDE, SIDE, "box", 1.0),
        lens=KannalaBrandt(0.7 * middle, middle, toy.single([0.02, 0, 0, 0]), toy.single(1.3)),
        aperture=Aperture(toy.single(0.05), toy.single(2.5), 0 * one, one),
        shutter=Shutter(camera.shutter.row_offset, camera.shutter.row_step, toy.single(0.1)),
    )


@pytest.fixture(scope="module")
def soft(tmp_path_factory):
    """A fit to what cameras with all effects see, and its loss for the known scene as a function of
    the footage."""
    listed = [(name, effects(camera)) for name, camera in frames()]
    renderer = Renderer(SCENE, options=RenderOptions(samples=8), trace=toy.TRACE)
    folder = tmp_path_factory.mktemp("soft")
    capture = written(folder / "capture", listed, [renderer(c).color for _, c in listed])
    chosen = dataclasses.replace(
        options(),
        fit=FitOptions(auto=False, tiles=48, samples=8, moving_share=0.0, points=1, surround=0.0),
    )
    fit = fit_of(capture, folder, chosen)
    state = known_scene(fit)
    drawn = fit.loader.batches("fine", 0, 1)
    sizes = loop.first_sizes(fit, state, drawn)

    @eqx.filter_jit
    def loss(views, batches, step):
        value, details = training.loss_of(
            state.parameters,
            views,
            jax.tree.map(lambda x: x[0], batches),
            fit.cameras,
            step,
            options=step_setup.step_options(fit, "fine"),
            sizes=sizes,
        )
        return value, details.report.dropped

    def whole(views=fit.footage.camera, batches=drawn, step=0):
        value, dropped = loss(views, batches, jnp.asarray(step))
        assert int(dropped) == 0
        return float(value)

    return fit, sizes, whole


def test_a_step_sees_what_rendering_shows_through_every_effect(soft):
    fit, sizes, loss = soft
    assert sizes.keys > 1
    # The first step takes the very samples of rendering, others take their own.
    assert loss() < CODE / 8
    assert CODE / 8 < loss(step=5) < CODE
    views = fit.footage.camera
    still = jnp.zeros_like(views.shutter.row_step)
    assert loss(eqx.tree_at(lambda c: c.shutter.row_step, views, still)) > CODE / 4


def test_where_the_lens_forms_no_ray_nothing_is_learnt(soft):
    fit, _, loss = soft
    y, x = np.mgrid[:SIDE, :SIDE]
    lens = fit.capture.views[0].camera.lens
    pixel = toy.single(np.stack([x, y], axis=-1).reshape(-1, 2) + 0.5)
    # A pixel's box must lie outside as a whole for no sample to see anything.
    corners = [jax.vmap(lens.sees)(pixel + toy.single(d)[None]) for d in
               ((-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5))]  # fmt: skip
    black = ~np.any(corners, axis=0).reshape(SIDE, SIDE)
    assert 20 < black.sum() < SIDE**2 / 2
    seen, drawn = fit.footage, fit.loader.batches("fine", 0, 1)
    tiles = cut(black, tile_pixels(seen.film, seen.side))
    assert not seen.pixel[:, tiles].any()
    pixel = np.where(tiles[None, ..., None], np.uint8(255), seen.pixel)
    spoilt = dataclasses.replace(seen, pixel=pixel)
    where = (np.asarray(x) for x in (drawn.frame, drawn.tile, drawn.time))
    assert loss(batches=gather(spoilt, *where)) == loss()


def test_sharp_pictures_taken_at_once_cost_what_they_did(tmp_path, pictures):
    listed = [(n, toy.camera(ANGLES[n], float(c.time), SIDE, SIDE)) for n, c in frames()]
    fit = fit_of(written(tmp_path / "capture", listed, pictures), tmp_path, options())
    state, batches = known_scene(fit), fit.loader.batches("fine", 0, 1)
    assert step_setup.step_options(fit, "fine").samples == 1
    assert loop.first_sizes(fit, state, batches).keys == 1
    assert state.parameters.corrections is None


def test_before_the_scene_moves_only_colours_are_refined(tmp_path, pictures):
    fit = fit_of(recorded(tmp_path / "capture", pictures, ()), tmp_path, options(*REFINABLE))
    assert step_setup.step_options(fit, "coarse").refine == ("exposure", "color_matrix")
    assert step_setup.step_options(fit, "fine").refine == REFINABLE


def test_bodies_have_poses_as_far_as_the_rows_reach(tmp_path, pictures):
    fit = fit_of(recorded(tmp_path / "capture", pictures, ()), tmp_path, options())
    deformation = with_motion(fit, *initial_state(fit, RunProgress()))[0].parameters.deformation
    half = READOUT / 2
    expected = [TIMES[0] - half, *TIMES, TIMES[-1] + half]
    np.testing.assert_allclose(deformation.bodies.time, expected, atol=1e-6)
    ends = float(deformation.planes.begin), float(deformation.planes.end)
    assert ends == pytest.approx((expected[0], expected[-1]), abs=1e-6)


@pytest.mark.ci
def test_the_refined_cameras_are_written_and_what_was_found_is_said(
    tmp_path, pictures, monkeypatch, capsys
):
    def learnt(state, *_, options, schedule, sizes):
        steps = int(schedule.stage.steps)

        def where(state):
            return state.parameters.corrections.exposure, state.parameters.corrections.shutter

        found = toy.single(np.log(list(GAIN.values()))), toy.single(-np.log(SLOW))
        state = eqx.tree_at(where, state, found)
        terms = {"l1": jnp.asarray(0.1), "mse": jnp.asarray(0.1)}
        return (
            eqx.tree_at(lambda s: s.step, state, jnp.asarray(steps)),
            terms,
            jnp.zeros((steps, 12)),
            jnp.zeros(3, int),
            jnp.asarray(0),
        )

    monkeypatch.setattr(loop, "train_block", learnt)
    room = Capacity((8,), 8, 8)
    monkeypatch.setattr(loop, "first_sizes", lambda fit, *_: BlockSizes(room, fit.mesh, 1))
    capture = recorded(tmp_path / "capture", pictures, ("shutter",))
    chosen = options("exposure", "shutter")
    reconstruct(capture, tmp_path / "run", options=chosen)
    said = json.loads((tmp_path / "run" / "cameras.json").read_text())
    assert {name: pytest.approx(gain, rel=1e-5) for name, gain in GAIN.items()} == said["info"][
        "gain"
    ]
    step = said["shutter"]["row_step"]
    assert step == pytest.approx(READOUT / (SIDE - 1), rel=1e-5)
    assert f"-> {step:.4g}" in capsys.readouterr().out


def test_a_run_goes_on_with_what_it_refines(tmp_path, pictures):
    capture = recorded(tmp_path / "capture", pictures, ())
    fit = fit_of(capture, tmp_path / "run", options("pose"))
    fit.log.save(*initial_state(fit, RunProgress()))
    with pytest.raises(ValueError, match=r"fit.refine must be \['pose'\]"):
        reconstruct(capture, tmp_path / "run", options=options(), resume=True)


@pytest.mark.slow
def test_a_scene_is_learnt_through_every_effect_while_cameras_are_refined(tmp_path):
    listed = [(name, effects(camera)) for name, camera in frames()]
    renderer = Renderer(SCENE, options=RenderOptions(samples=16), trace=toy.TRACE)
    capture = written(tmp_path / "capture", listed, [renderer(c).color for _, c in listed])
    fit = FitOptions(auto=False, coarse=50, fine=150, tiles=8, block=10, points=1, refine=REFINABLE)
    fit = dataclasses.replace(fit, refine_gain=-1.0)
    reconstruct(capture, tmp_path, options=dataclasses.replace(toy.SHORT, fit=fit), quiet=True)
    lines = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    # As for sharp pictures in test_reconstruct.
    assert np.mean([line["l1"] for line in lines[-5:]]) < lines[0]["l1"] / 2
    assert {"shutter", "aperture", "lens", "info"} <= set(
        json.loads((tmp_path / "cameras.json").read_text())
        | json.loads((tmp_path / "cameras.json").read_text())["frames"][0]
    )
