"""Pictures of a scene: all effects at once, any size, nothing lost."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.camera.aperture import Aperture, Rim, transmitted
from gaussray.camera.camera import Camera, with_chromatic
from gaussray.camera.film import Film, pixel_grid
from gaussray.camera.lens import KannalaBrandt
from gaussray.camera.sampling import sobol_samples
from gaussray.camera.shutter import Shutter, interlaced_row_times
from gaussray.camera.trajectory import Trajectory
from gaussray.render import parts, renderer
from gaussray.render.options import RenderOptions
from gaussray.render.parts import (
    PIXEL,
    RAY,
    RAY_OF_KERNEL,
    SAMPLE,
    interleaved_parts,
    samples_at_once,
    strip_plan,
    strip_rows,
)
from gaussray.render.renderer import Renderer
from gaussray.scene.scene import Scene, key_count
from gaussray.tracer.grid import OCCUPANCY
from gaussray.tracer.options import CPU_LEVELS, TraceOptions, grid_levels
from gaussray.tracer.traverse import Capacity


pytestmark = pytest.mark.usefixtures("known_sizes")

# Quadratic between the keys against exact rows, for motion of the third order (measured: 3e-4).
ROWS = 1e-3
# Sums of the same hits in single precision.
SAME = 1e-5
# Rays 1e-4 apart through Gaussians of 0.2.
FINE = 1e-3
ONE = RenderOptions(samples=1)


@pytest.fixture(scope="module")
def scene():
    return toy.scene()


@pytest.fixture(scope="module")
def still():
    """The same wall and bodies, which never move."""
    return toy.scene(speed=0)


@pytest.fixture(scope="module")
def render(scene):
    """Films the moving scene. The first cameras are those of a paired capture: what is compiled
    for the list sizes that they need serves all tests."""
    render = Renderer(scene, options=ONE, trace=toy.TRACE)
    for record in toy.with_effect(toy.records()):
        render(record.camera)
    return render


@pytest.fixture(scope="module")
def render_still(still):
    """Films the scene that stands still."""
    return Renderer(still, options=ONE, trace=toy.TRACE)


def everything(camera):
    """Fisheye, depth of field, rolling shutter, motion blur and a moving camera at once."""
    pose, number = camera.trajectory, toy.single
    path = Trajectory(
        number([0.0, 1.0]),
        jnp.concatenate([pose.quat, pose.quat]),
        jnp.concatenate([pose.translation, pose.translation + number([[0.2, 0, 0]])]),
    )
    size = number([camera.film.width / 2, camera.film.height / 2])
    return Camera(
        Film(camera.film.width, camera.film.height, "box", 1.0),
        KannalaBrandt(number([10, 10]), size, number([-0.02, 0, 0, 0]), number(1.3)),
        Aperture(number(0.1), number(3), number(0.2), number(1.2), blades=5, focus="sphere"),
        Shutter(number(-0.1), number(0.01), number(0.05)),
        path,
        camera.time,
    )


def test_all_effects_at_once_are_finite_and_light(scene):
    frame = Renderer(scene, options=RenderOptions(samples=2), trace=toy.TRACE)(
        everything(toy.camera(time=0.5))
    )
    for picture in (frame.color, frame.alpha, frame.depth):
        assert np.isfinite(picture).all()
    assert frame.color.max() > 0.2 and frame.alpha.max() > 0.9
    assert frame.alpha.min() >= -1e-6 and frame.alpha.max() <= 1 + 1e-6
    assert frame.compiled and frame.hits > 0


@pytest.mark.slow
def test_any_size_is_a_crop_of_what_a_larger_film_sees(render_still):
    width, height = 13, 11
    large = toy.camera()
    small = Camera(**(vars(large) | {"film": Film(width, height, "center")}))
    whole, part = render_still(large), render_still(small)
    assert part.color.shape == (height, width, 3)
    # Other bundles march other lists, in the same order.
    np.testing.assert_allclose(part.color, whole.color[:height, :width], atol=2e-3)


def test_states_at_key_times_agree_with_a_state_for_every_row(scene, render):
    camera = toy.rolling(toy.camera(time=0.5))
    every_row = RenderOptions(samples=1, chunk_rows=1)
    exact = Renderer(scene, options=every_row, trace=toy.TRACE)(camera)
    np.testing.assert_allclose(render(camera).color, exact.color, atol=ROWS)
    frozen = render(toy.camera(time=0.5))
    assert np.abs(frozen.color - exact.color).max() > 30 * ROWS


@pytest.mark.slow
def test_interlaced_rows_agree_with_a_state_for_every_row(scene):
    camera = toy.camera(time=0.5)
    table = toy.single(interlaced_row_times(toy.SIZE, 0.4))
    camera = dataclasses.replace(
        camera, shutter=dataclasses.replace(camera.shutter, row_times=table)
    )
    by_rows = RenderOptions(samples=1, chunk_rows=1)
    exact = Renderer(scene, options=by_rows, trace=toy.TRACE)(camera).color
    found = Renderer(scene, options=ONE, trace=toy.TRACE)(camera).color
    np.testing.assert_allclose(found, exact, atol=ROWS)
    fields = [Renderer(scene, options=ONE, trace=toy.TRACE)(toy.camera(time=t)) for t in (0.3, 0.7)]
    for i in (0, 1):
        np.testing.assert_allclose(found[i::2], fields[i].color[i::2], atol=ROWS)
        assert np.abs(found[i::2] - fields[1 - i].color[i::2]).max() > 30 * ROWS
    some = Renderer(scene, options=RenderOptions(samples=1, chunk_rows=4), trace=toy.TRACE)
    with pytest.raises(ValueError, match="chunk_rows must be 0 or 1 for a shutter with row_times"):
        some(camera)


def test_a_rim_darkens_by_the_share_of_the_rays_that_it_stops(still):
    """Behind an opening too small to blur, the light times the share; coverage and depth stay."""
    four = RenderOptions(samples=4)
    render = Renderer(still, options=four, trace=toy.TRACE)
    number, plain = toy.single, toy.camera()
    small = Aperture(number(1e-4), number(3), number(0), number(1))
    rim = Rim(number(1e-4), number(1e-4))
    views = [dataclasses.replace(plain, aperture=small)]
    views.append(dataclasses.replace(plain, aperture=dataclasses.replace(small, rim=rim)))
    whole, clipped = (render(view) for view in views)
    u = sobol_samples(4)[:, 2:4].astype(jnp.float32)
    pixel = pixel_grid(plain.film).astype(jnp.float32).reshape(-1, 2) + 0.5
    chief = jax.vmap(plain.lens.direction)(pixel)
    each = jax.vmap(jax.vmap(transmitted, in_axes=(None, None, 0)), in_axes=(None, 0, None))
    share = np.asarray(each(views[1].aperture, chief, u)).mean(axis=1)
    share = share.reshape(toy.SIZE, toy.SIZE, 1)
    assert 0.3 < share.min() < 0.85 and share.max() > 0.95
    # In one pixel of 256 the four rays differ by more than FINE, with or without a cut-off.
    off = np.abs(clipped.color - share * whole.color).max(axis=-1)
    assert np.mean(off > FINE) < 0.01 and off.max() < 3 * FINE
    np.testing.assert_allclose(clipped.alpha, whole.alpha, atol=FINE)
    np.testing.assert_allclose(clipped.depth, whole.depth, atol=30 * FINE)


def blurred():
    """The toy's view through a wide opening and a filter."""
    number, plain = toy.single, toy.camera()
    wide = Aperture(number(0.15), number(2), number(0), number(1))
    return dataclasses.replace(plain, aperture=wide, film=Film(toy.SIZE, toy.SIZE, "box", 1.0))


@pytest.mark.slow
def test_samples_are_added_until_the_error_is_that_of_the_means(still):
    """The stated standard error covers what is left against 4,096 other samples, and an error that
    is never reached stops at the most samples."""
    options = RenderOptions(samples=4, error=0.01, samples_most=4096)
    frame = Renderer(still, options=options, trace=toy.TRACE)(blurred())
    assert 16 <= frame.samples < 4096 and frame.samples % 4 == 0
    assert np.quantile(frame.error, 0.95) <= 0.01
    exact = Renderer(still, options=RenderOptions(samples=1024), trace=toy.TRACE)(blurred())
    off = np.abs(frame.color - exact.color).max(axis=-1)
    assert off.max() > 1e-3
    assert np.mean(off <= 3 * frame.error + 1e-4) > 0.9
    tight = RenderOptions(samples=4, error=1e-6, samples_most=22)
    stopped = Renderer(still, options=tight, trace=toy.TRACE).render_frames([blurred()])
    assert next(stopped).samples == 20


def test_without_an_error_to_reach_a_picture_is_what_it_was(still):
    """The means of the fixed points of `samples`, ray by ray, whatever the other key says."""
    plain = Renderer(still, options=RenderOptions(samples=2), trace=toy.TRACE)(blurred())
    other = RenderOptions(samples=2, error=0.0, samples_most=7)
    same = Renderer(still, options=other, trace=toy.TRACE)(blurred())
    for a, b in zip((plain.color, plain.alpha, plain.depth), (same.color, same.alpha, same.depth),
                    strict=True):  # fmt: skip
        assert a.tobytes() == b.tobytes()
    assert plain.error is None and plain.samples == 2


def test_each_colour_is_seen_through_a_lens_of_its_own(still, render_still):
    plain, sizes = toy.camera(0.2), (1.1, 1.0, 0.9)
    fringed = render_still(with_chromatic(plain, sizes))
    alone = [render_still(with_chromatic(plain, (m, m, m))) for m in sizes]
    for channel, frame in enumerate(alone):
        # The same rays, over lists of other lengths.
        np.testing.assert_allclose(
            fringed.color[..., channel], frame.color[..., channel], atol=SAME
        )
    usual = render_still(plain)
    np.testing.assert_allclose(fringed.color[..., 1], usual.color[..., 1], atol=SAME)
    assert np.abs(fringed.color - usual.color).max() > 0.01
    np.testing.assert_allclose(fringed.alpha, np.mean([f.alpha for f in alone], axis=0), atol=SAME)
    assert render_still(with_chromatic(plain, (1.0, 1.0, 1.0))).compiled is False


def test_a_time_outside_the_clip_is_its_border(render):
    for inside, outside in ((0.0, -3.0), (1.0, 50.0)):
        near, far = render(toy.camera(time=inside)), render(toy.camera(time=outside))
        np.testing.assert_array_equal(near.color, far.color)


def test_lists_that_are_too_short_are_repaired(still, render_still, monkeypatch):
    expected = render_still(toy.camera())
    again = render_still(toy.camera(0.1))
    assert not again.compiled
    short = Capacity((1,) * grid_levels(toy.TRACE, jnp.float32), 2, 2)
    monkeypatch.setattr(renderer, "staged_capacity", lambda *_: short)
    frame = Renderer(still, options=ONE, trace=toy.TRACE)(toy.camera())
    assert frame.compiled
    np.testing.assert_allclose(frame.color, expected.color, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("part", ["static", "moving"])
def test_a_scene_of_which_one_kind_is_absent(still, part):
    none = jax.tree.map(lambda x: x[:0], getattr(still, part))
    parts = vars(still) | {part: none}
    frame = Renderer(Scene(**parts), options=ONE, trace=toy.TRACE)(toy.camera())
    kind = getattr(still, part)
    unseen = dataclasses.replace(kind, opacity=jnp.zeros_like(kind.opacity))
    expected = Renderer(Scene(**(vars(still) | {part: unseen})), options=ONE, trace=toy.TRACE)(
        toy.camera()
    )
    np.testing.assert_allclose(frame.color, expected.color, atol=SAME)
    np.testing.assert_allclose(frame.alpha, expected.alpha, atol=SAME)
    assert frame.alpha.max() > 0.5


def test_a_frame_takes_three_states_for_every_interval_it_touches(scene):
    counts = [key_count(scene, span) for span in (0.01, 0.5, 0.51, 1.0, 9.0)]
    assert counts == [3, 3, 5, 5, 5]  # of a clip with instants at 0, 0.5 and 1
    assert key_count(toy.scene(speed=0), 0.5) == 1


def test_chunks_of_rows_are_refused_where_columns_are_read(scene):
    camera = toy.rolling(toy.camera(time=0.5), direction="left_to_right")
    render = Renderer(scene, options=RenderOptions(chunk_rows=4), trace=toy.TRACE)
    with pytest.raises(ValueError, match="chunk_rows must be 0 for a shutter that reads columns"):
        render(camera)


@pytest.mark.parametrize(
    ("key", "value"),
    [("samples", 0), ("keys", 1), ("chunk_rows", -1), ("error", -1.0), ("memory", 0.0)],
)
def test_an_option_that_cannot_be_is_named(key, value):
    with pytest.raises(ValueError, match=f"render.{key} must be"):
        RenderOptions(**{key: value})


def test_an_error_needs_room_for_four_batches():
    with pytest.raises(ValueError, match="render.samples_most must be at least 64"):
        RenderOptions(samples=16, error=0.1, samples_most=63)


@pytest.mark.parametrize(
    "turn", [None, "top_to_bottom", pytest.param("left_to_right", marks=pytest.mark.slow)]
)
def test_a_frame_in_strips_is_the_frame(scene, render, turn):
    filmed = toy.camera() if turn is None else toy.rolling(toy.camera(), direction=turn)
    # Eight of sixteen rows at a time.
    some = dataclasses.replace(ONE, memory=8 * toy.SIZE * (RAY + SAMPLE + PIXEL) / 1e9)
    strips = Renderer(scene, options=some, trace=toy.TRACE)(filmed)
    for name in ("color", "alpha", "depth"):
        whole, joined = getattr(render(filmed), name), getattr(strips, name)
        np.testing.assert_allclose(joined, whole, rtol=0, atol=SAME)


def test_strips_are_whole_tiles_that_fit_and_at_least_one():
    film, trace = Film(4096, 4096, "center"), TraceOptions(levels=1)
    rows = [strip_rows(film, RenderOptions(samples=64, memory=m), trace) for m in (1e3, 2.0, 1e-6)]
    assert rows[0] == 4096 and rows[2] == 8
    assert rows[1] % 32 == 0
    assert 1.5 < rows[1] * 4096 * (RAY + 64 * SAMPLE + PIXEL) / 1e9 <= 2


@pytest.mark.parametrize("devices", [1, 2, 3])
def test_every_pixel_of_a_dealt_picture_has_one_place(devices):
    film, trace = Film(44, 20, "center"), TraceOptions(bundle=4, levels=1)
    part, how, place = interleaved_parts(film, trace, devices)
    assert part.pixel.shape[0] == len(part.row) == devices and how.levels == 0
    y, x = np.mgrid[:20, :44]
    there = np.asarray(part.pixel).reshape(-1, 2)[np.asarray(place)]
    np.testing.assert_array_equal(there, np.stack([x, y], axis=-1).reshape(-1, 2))
    # Blocks of sixteen tiles, six of them, go round; no device has two more than another.
    own = np.bincount(np.asarray(place) // part.pixel.shape[1], minlength=devices)
    assert np.all(own > 0) and part.pixel.shape[1] == -(-6 // devices) * 16 * 16


@pytest.mark.parametrize("machine_code", [False, True])
def test_many_gaussians_are_met_by_coarser_bundles_first(monkeypatch, machine_code):
    monkeypatch.setattr(parts, "on_cpu_kernel", lambda *_: machine_code)
    film, options, trace = Film(4096, 4096, "center"), RenderOptions(samples=64), TraceOptions()
    few, plain = strip_plan(film, options, trace, 1000)
    assert few == strip_rows(film, options, trace) and plain == trace
    rows, coarse = strip_plan(film, options, trace, 5_000_000)
    side = 8 * 4**coarse.levels
    assert few - side < rows <= few and rows % side == 0
    tested = 5_000_000 if machine_code else 5_000_000 // OCCUPANCY
    at_most = 2**23 if machine_code else 2**26
    assert rows // side * (4096 // side) * tested <= at_most or coarse.levels == CPU_LEVELS
    # Bundles as high as a strip are as coarse as can be.
    low = dataclasses.replace(options, memory=0.1)
    assert strip_plan(film, low, trace, 5_000_000) == (strip_rows(film, low, trace), trace)


def test_strips_of_a_kernel_are_larger_also_where_samples_are_traced_one_by_one(monkeypatch):
    film, options, trace = Film(4096, 4096, "center"), RenderOptions(memory=2.0), TraceOptions()
    options = dataclasses.replace(options, samples=5)
    arrays = strip_rows(film, options, trace)
    monkeypatch.setattr(parts, "on_kernel", lambda *_: True)
    assert samples_at_once(options, trace) == 1
    kernel = strip_rows(film, options, trace)
    assert kernel > 1.5 * arrays and kernel * 4096 * (RAY_OF_KERNEL + 5 * SAMPLE + PIXEL) <= 2e9


def test_a_renderer_inside_of_grad_names_the_pure_function(still):
    render = Renderer(still, options=ONE)

    def mean(time):
        return render(dataclasses.replace(toy.camera(), time=time)).color.mean()

    with pytest.raises(ValueError, match=r"not inside of jit, grad .* gaussray\.render\(scene"):
        jax.grad(mean)(toy.single(0.5))
