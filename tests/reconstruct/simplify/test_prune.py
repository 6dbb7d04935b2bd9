"""A scene loses what its pictures do not show, keeps what they do, and says both."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.capture.formats.paired import read_capture
from gaussray.reconstruct.data.pictures import footage
from gaussray.reconstruct.simplify.candidate_meter import Tracing
from gaussray.reconstruct.simplify.prune import PruneOptions, pruned_scene
from gaussray.reconstruct.simplify.summary import part_counts, summary_line
from gaussray.reconstruct.simplify.tile_views import TrainingViews
from gaussray.scene.gaussians import Gaussians, concatenate
from gaussray.scene.scene import Scene
from gaussray.tracer.shard import mesh


pytestmark = pytest.mark.usefixtures("known_sizes")

TRACE = toy.SHORT.trace
# All tiles of all pictures are looked at: what adds nothing to them is seen by none.
OPTIONS = PruneOptions(loss=0.05, tiles=8, contribution_tiles=1000)
HIDDEN, IDLE = 6, 4
measured = []


def pruned(scene, seen, options=OPTIONS, **more):
    views, tracing = TrainingViews(seen, seen.camera), Tracing(TRACE, mesh(1))
    return pruned_scene(scene, views, options=options, tracing=tracing, seed=0, **more)


@pytest.fixture(scope="module")
def seen(tmp_path_factory, known_sizes):
    """Training pictures of the toy scene with noise, as cameras have it."""
    capture = read_capture(toy.write_capture(tmp_path_factory.mktemp("capture"), toy.scene()))
    views = [view for view in capture.views if view.split == "train"]
    clean = footage(views, side=TRACE.bundle)
    noise = np.random.default_rng(0).normal(0, 8, clean.pixel.shape)
    pixel = np.clip(clean.pixel + noise, 0, 255).astype(np.uint8)
    return dataclasses.replace(clean, pixel=pixel)


@pytest.fixture(scope="module")
def lavish():
    """The toy scene with Gaussians behind its wall that nobody sees, with parts of the wall
    among those that move, which leaves them where they are, and with harmonics that are zero."""
    one = toy.scene()
    dice = np.random.default_rng(1)
    behind = np.concatenate(
        [dice.uniform(-0.5, 0.5, (HIDDEN, 2)), np.full((HIDDEN, 1), 40)], axis=1
    )
    static = concatenate(one.static, toy.gaussians(behind, 0.05, [[0.5, 0.5, 0.5]]))
    # Beyond its box the field continues its border; these are all but there.
    far = jax.tree.map(lambda x: x[-IDLE:], one.static)
    moving = concatenate(one.moving, far)
    static = jax.tree.map(lambda x: jnp.delete(x, np.arange(25 - IDLE, 25), axis=0), static)
    harmonics = jnp.pad(static.harmonics, ((0, 0), (0, 3), (0, 0)))
    static = Gaussians(static.mean, static.quat, static.scale, static.opacity, harmonics)
    return Scene(static, moving, _only_near(one.deformation), one.time_range)


def _only_near(field):
    """The field's motion as that of a body which holds what is near the middle."""
    path = jnp.zeros_like(field.bodies.path).at[0, :, 0].set(toy.single([0, 0.4, 0.9]))
    bodies = eqx.tree_at(lambda b: (b.path, b.radius), field.bodies, (path, toy.single([0.6])))
    still = jax.tree.map(jnp.zeros_like, field.mean[1])
    return eqx.tree_at(lambda d: (d.bodies, d.mean[1]), field, (bodies, still))


@pytest.fixture(scope="module")
def told(seen, lavish):
    measured.clear()
    return pruned(lavish, seen, report=lambda *of: measured.append(of))


def test_the_way_is_told_to_its_end(told):
    done, total, what = zip(*measured, strict=True)
    assert len(set(total)) == 1 and list(done) == sorted(done) and done[0] == 0
    assert done[-1] == total[-1] and what[1] == "what does nothing" and what[-1] == "rounding"


def test_what_nobody_sees_goes_and_what_does_not_move_rests(told, lavish):
    scene, report = told
    assert report["before"]["gaussians"] == lavish.static.count + lavish.moving.count
    assert scene.static.mean[:, 2].max() < 40 - 1
    assert scene.moving.count == 2
    assert np.abs(np.asarray(scene.moving.mean)[:, 2]).max() < 0.2
    assert scene.static.harmonics.shape[1] == 1


def test_what_no_ray_has_met_stays_where_the_capture_has_it(seen, lavish):
    hidden = np.zeros(lavish.static.count + lavish.moving.count, bool)
    hidden[: lavish.static.count] = np.asarray(lavish.static.mean)[:, 2] > 30
    assert hidden.sum() == HIDDEN
    scene, _ = pruned(lavish, seen, unmet=hidden)
    assert (np.asarray(scene.static.mean)[:, 2] > 30).sum() == HIDDEN


def test_what_masks_hide_almost_wholly_goes(seen, told):
    """Of four tiles of each picture one counts: what only the others show goes before anything."""
    mask = np.zeros((*seen.pixel.shape[:2], seen.side**2 // 8), np.uint8)
    mask[:, 0] = 255
    scene, report = pruned(toy.scene(), dataclasses.replace(seen, mask=mask))
    first = report["steps"][1]
    assert first["step"] == "Gaussians that masks hide" and first["loss"] <= OPTIONS.loss
    before, after = first["gaussians"]
    assert scene.static.count + scene.moving.count <= after < before
    assert all(step["step"] != first["step"] for step in told[1]["steps"])


@pytest.mark.ci
def test_what_was_not_looked_at_stays(seen, lavish):
    few = dataclasses.replace(OPTIONS, contribution_tiles=1, tiles=1, instants=1)
    scene, _ = pruned(lavish, seen, options=few)
    behind = np.asarray(scene.static.mean)[:, 2] > 30
    assert behind.sum() == HIDDEN
    assert len(scene.static.mean) + len(scene.moving.mean) > 0.8 * (
        lavish.static.count + lavish.moving.count
    )


def test_the_field_goes_and_the_body_stays(told):
    scene, _ = told
    field = scene.deformation
    assert field.planes.space == () and field.mean is None and len(field.bodies.pivot) == 1


def test_every_step_is_told_and_costs_at_most_what_it_may(told, lavish):
    scene, report = told
    now = {name: value for name, value in report["after"].items() if name != "psnr"}
    assert now == part_counts(scene)
    was = part_counts(lavish)
    for step in report["steps"]:
        assert step["taken"] == (step["loss"] <= OPTIONS.loss)
        for name in was.keys() & step.keys():
            assert step[name][0] == was[name]
            if step["taken"]:
                was[name] = step[name][1]
    assert was == now
    lost = sum(step["loss"] for step in report["steps"] if step["taken"])
    # Reports keep four digits.
    assert report["before"]["psnr"] - report["after"]["psnr"] == pytest.approx(lost, abs=1e-3)


@pytest.mark.slow
def test_a_scene_that_needs_everything_keeps_it(seen):
    """Two instants' difference of a body's size is not given up, nor the wall behind it."""
    one = toy.scene()
    scene, report = pruned(one, seen)
    assert scene.moving.count == 2 and scene.deformation.mean is not None
    assert scene.static.count > 20
    refused = [step for step in report["steps"] if not step["taken"]]
    assert "head mean" in [step["step"] for step in refused]


@pytest.mark.slow
def test_where_nothing_moves_there_is_no_field(seen):
    one = toy.scene()
    frozen = dataclasses.replace(one, deformation=toy.deformation())
    scene, _ = pruned(frozen, seen)
    assert scene.deformation is None and scene.moving.count == 0


def test_a_loss_of_nothing_keeps_everything(seen, lavish):
    options = PruneOptions(loss=0.0, precision="full")
    scene, report = pruned(lavish, seen, options)
    assert report["precision"] == "full" and report["psnr"] > report["one_color"]
    for a, b in zip(jax.tree.leaves(scene), jax.tree.leaves(lavish), strict=True):
        np.testing.assert_array_equal(a, b)


def test_the_line_says_how_much_of_what_is_needed():
    before = {"gaussians": 12000, "moving": 3065, "bodies": 5, "heads": 4, "scales": 2}
    before |= {"degree": 1, "bytes": 1_100_000, "psnr": 25.53}
    after = {"gaussians": 8214, "moving": 1903, "bodies": 1, "heads": 3, "scales": 1}
    after |= {"degree": 0, "psnr": 25.5}
    assert summary_line({"before": before, "after": after, "file": 401_000}) == (
        "the scene needs 8,214 of 12,000 Gaussians (1,903 of 3,065 move, 1 body), 3 of 4 heads, "
        "1 of 2 scales of the field, harmonics of degree 0: 1.1 -> 0.4 MB, -0.03 dB"
    )
    kinds = {"before": before | {"transient": 4000}, "after": after | {"transient": 3100}}
    line = summary_line({**kinds, "file": 401_000})
    assert "(1,903 of 3,065 move, 3,100 of 4,000 are transient, 1 body)" in line


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"loss": -0.1}, "prune.loss must be at least 0, got -0.1"),
        ({"tiles": 0}, "prune.tiles must be at least 1, got 0"),
        ({"precision": "half"}, "prune.precision must be one of full, compact, got 'half'"),
    ],
)
def test_options_that_mean_nothing_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        PruneOptions(**changes)
