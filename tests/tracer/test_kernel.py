"""The CUDA kernels: what they see and learn is what the brute force says; where they are chosen."""

import types
from dataclasses import replace

import equinox as eqx
import extremes
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from scenes import (
    CAPACITY,
    COUNT,
    OPTIONS,
    RAYS,
    beside,
    fleeting,
    gaussians,
    look,
    moving,
    natural,
    pull,
    rays,
    relative_errors,
    resting,
    shot,
    stacked,
    tinted,
    wandering,
    weights,
)
from single import (
    COLOR,
    GRADIENT,
    SINGLE,
    errors_on_device,
    invisible,
    mixed,
    pile,
    roomy,
    samples_of,
    sheet,
)

from gaussray.runtime import cuda
from gaussray.tracer import kernel, options
from gaussray.tracer.measure import measure
from gaussray.tracer.motion import merge_rest
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.trace import trace
from gaussray.tracer.traverse import Capacity


# Sums of the same numbers in another order.
SAME = 1e-6


@pytest.fixture
def elsewhere(monkeypatch):
    """A CUDA device as far as tracing a program goes."""
    monkeypatch.setattr(cuda, "available", lambda: True)
    monkeypatch.setattr(kernel, "ptx", lambda source, macros: f"{sorted(macros)}")


@pytest.fixture
def shared_by(monkeypatch):
    """Sets how many lanes share a ray. Otherwise it is 16, as in every small picture."""

    def set_lanes(lanes):
        monkeypatch.setattr(kernel, "_LANES", {1 << 30: lanes})
        jax.clear_caches()

    yield set_lanes
    jax.clear_caches()


def test_a_program_is_three_launches_and_one_more_for_gradients(elsewhere):
    def loss(motion, lines):
        return jnp.sum(trace(motion, lines, options=OPTIONS, capacity=CAPACITY)[0].color)

    motion, lines = wandering(*moving(COUNT)), shot(rays())
    for scene in (motion, beside(motion, fleeting(COUNT))):
        for function, launches in ((loss, 3), (jax.grad(loss), 4)):
            lowered = jax.jit(function).trace(scene, lines).lower(lowering_platforms=("cuda",))
            assert lowered.as_text().count("@__gpu$xla.gpu.ptx(") == launches


def test_every_macro_of_the_source_is_given(monkeypatch):
    given = []
    monkeypatch.setattr(kernel, "ptx", lambda *words: given.append(words) or "")
    assert kernel.Program(64, 1, 64, 8, 32, 1, 3, 4, 1, 16, 16, 0.99, 1e-4).code == ""
    (source, macros), text = given[0], given[0][0].read_text()
    opening = text[: text.index("typedef")]
    named = {word.strip(",.") for word in opening.split() if word.strip(",.").isupper()}
    assert source.name == "kernel.cu"
    assert {*macros, *kernel._NUMBERS} == named - {"CUDA", "PTX"}


@pytest.mark.skipif(cuda._nvrtc() is None, reason="there is no libnvrtc")
@pytest.mark.parametrize("keys", [1, 3])
@pytest.mark.parametrize("transient", [0, 1])
def test_the_source_compiles_also_where_there_is_no_device(monkeypatch, keys, transient):
    device = types.SimpleNamespace(compute_capability="9.0")
    monkeypatch.setattr(cuda.jax, "local_devices", lambda: [device])
    program = kernel.Program(64, 1, 64, 8, 32, 1, keys, 4, 1, 16, 16, 0.99, 1e-4, transient)
    code = program.code
    assert code.count(".visible .entry") == 4 and "NUMBER_OF" not in code
    # Other sizes are other numbers of the same code.
    monkeypatch.setattr(cuda, "_ptx_of", lambda *_: pytest.fail("compiled again"))
    assert program._replace(rays=256, slots=96, supers=7).code.count("96;") > code.count("96;")


def test_single_precision_on_a_device_chooses_the_kernel(elsewhere):
    from gaussray.tracer.trace import on_kernel

    assert on_kernel(TraceOptions(), jnp.float32)
    assert not on_kernel(TraceOptions(), jnp.float64)
    assert not on_kernel(TraceOptions(backend="array"), jnp.float32)
    with pytest.raises(ValueError, match="trace.backend=kernel is for single precision"):
        on_kernel(TraceOptions(backend="kernel"), jnp.float64)


def test_without_a_device_the_kernel_is_refused_and_auto_is_the_arrays(monkeypatch):
    from gaussray.tracer.trace import on_kernel

    monkeypatch.setattr(cuda, "available", lambda: False)
    monkeypatch.setattr(options, "on_cpu_kernel", lambda *_: False)
    assert not on_kernel(TraceOptions(), jnp.float32)
    with pytest.raises(ValueError, match="trace.backend=kernel needs a CUDA device"):
        on_kernel(TraceOptions(backend="kernel"), jnp.float32)
    with pytest.raises(ValueError, match="trace.backend must be one of"):
        TraceOptions(backend="optix")


def test_resting_gaussians_are_those_repeated_at_every_key():
    motion, lines = mixed(), shot(rays())
    apart, _ = look(motion, lines, options=OPTIONS, capacity=roomy(OPTIONS))
    together, _ = look(merge_rest(motion), lines, options=OPTIONS, capacity=roomy(OPTIONS))
    np.testing.assert_allclose(stacked(apart), stacked(together), atol=SAME)


def test_samples_share_lists_and_see_what_each_would_see_alone():
    motion, lines = resting(gaussians(COUNT, size=(0.1, 0.5))), shot(rays())
    several = samples_of(lines)
    together, report = look(motion, several, options=OPTIONS, capacity=roomy(OPTIONS))
    assert int(report.dropped) == 0 and together.color.shape == (2, RAYS, 3)
    for i in range(2):
        one, alone = (jax.tree.map(lambda x: x[i], x) for x in (several, together))  # noqa: B023
        expected, _ = look(motion, one, options=OPTIONS, capacity=roomy(OPTIONS))
        np.testing.assert_allclose(stacked(alone), stacked(expected), atol=SAME)


@pytest.mark.gpu
@pytest.mark.parametrize(
    "change",
    [{"k": 1}, {"k": 4}, {"k": 16}, {"levels": 0}, {"levels": 2}, {"bundle": 8}, {"bundle": 1}],
)
def test_how_the_work_is_cut_does_not_matter(change):
    motion = resting(gaussians(COUNT, size=(0.1, 0.5)))
    color, errors = errors_on_device(motion, rays(), replace(OPTIONS, **change))
    assert color < SINGLE and max(errors.values()) < SINGLE, errors


@pytest.mark.gpu
@pytest.mark.parametrize("lanes", [4, 8])
@pytest.mark.parametrize("bundle", [4, 8])
def test_any_number_of_lanes_shares_a_ray(shared_by, lanes, bundle):
    shared_by(lanes)
    motion = beside(mixed(), fleeting(COUNT, seed=3, size=(0.1, 0.5)), (0.1, 0.8))
    color, errors = errors_on_device(motion, rays(), replace(OPTIONS, bundle=bundle))
    assert color < COLOR and max(errors.values()) < GRADIENT, errors


def test_the_fewer_rays_the_more_lanes_share_one():
    def lanes(count):
        motion, lines = mixed(), jax.tree.map(lambda x: x[None], shot(rays(count)))
        chosen, _ = kernel.kernel_inputs(
            motion, lines, jnp.asarray([0.0, 1.0]), options=TraceOptions(), slots=32
        )
        return chosen.program.lanes

    assert [lanes(side**2) for side in (256, 257, 362, 363)] == [16, 8, 8, 4]


@pytest.mark.gpu
@pytest.mark.parametrize("degree", [0, 2, 3])
def test_every_degree_of_colour(degree):
    motion = resting(gaussians(COUNT, size=(0.1, 0.5), degree=degree))
    color, errors = errors_on_device(motion, rays())
    assert color < SINGLE and max(errors.values()) < SINGLE, errors


@pytest.mark.gpu
@pytest.mark.parametrize("keys", [1, 2, 3, 5])
def test_key_states_and_tints(keys):
    if keys == 1:
        motion = resting(gaussians(COUNT, size=(0.1, 0.5)))
    else:
        motion = wandering(*moving(COUNT, keys, size=(0.1, 0.5), amount=0.02))
    color, errors = errors_on_device(tinted(motion), rays())
    # Blended axes lose some digits of single precision where a Gaussian is thin.
    assert color < COLOR and max(errors.values()) < GRADIENT, errors


@pytest.mark.gpu
def test_what_rests_beside_what_moves():
    color, errors = errors_on_device(mixed(), rays())
    assert color < COLOR and max(errors.values()) < GRADIENT, errors


@pytest.mark.gpu
@pytest.mark.parametrize("when", ["own", "same"])
@pytest.mark.parametrize("scene", ["resting", "moving", "tinted", "mixed"])
def test_transient_gaussians_at_times_of_rays(scene, when):
    lines, kind = rays(), {"size": (0.1, 0.5)}
    if when == "same":
        lines = lines._replace(time=np.full(RAYS, 0.4))
    motion = {
        "resting": lambda: resting(gaussians(COUNT, **kind)),
        "moving": lambda: wandering(*moving(COUNT, 3, amount=0.02, **kind)),
        "tinted": lambda: tinted(resting(gaussians(COUNT, **kind))),
        "mixed": mixed,
    }[scene]()
    motion = beside(motion, fleeting(COUNT, seed=3, **kind), (0.1, 0.8))
    color, errors = errors_on_device(motion, lines)
    assert color < COLOR and max(errors.values()) < GRADIENT, errors


@pytest.mark.gpu
def test_transient_gaussians_alone_are_those_of_the_arrays():
    nothing = invisible()
    motion = beside(nothing, fleeting(COUNT, seed=3, size=(0.1, 0.5)))
    lines, capacity = shot(rays()), roomy(OPTIONS)
    weight = weights(dtype=np.float32)
    kernels, arrays = (
        pull(motion, lines, weight, options=replace(OPTIONS, backend=b), capacity=capacity)
        for b in ("kernel", "array")
    )
    assert int(kernels[1].hits) == int(arrays[1].hits) > 0
    np.testing.assert_allclose(stacked(kernels[0]), stacked(arrays[0]), atol=SINGLE)
    errors = relative_errors(natural(kernels[2], motion), natural(arrays[2], motion))
    assert max(errors.values()) < GRADIENT, errors


@pytest.mark.gpu
def test_on_a_device_too_what_is_not_alive_enters_no_list():
    lines = replace(shot(rays()), time=jnp.full(RAYS, 0.5, jnp.float32))
    few = fleeting(COUNT, seed=3, size=(0.05, 0.4), lifetime=(0.01, 0.02), speed=0.0)
    few = replace(few, instant=jnp.where(jnp.arange(COUNT) % 4, 10.0, 0.5))
    nothing = invisible()
    every, living = beside(nothing, few), beside(nothing, jax.tree.map(lambda x: x[::4], few))
    pixels, report = look(every, lines, options=OPTIONS, capacity=roomy(OPTIONS))
    expected, least = look(living, lines, options=OPTIONS, capacity=roomy(OPTIONS))
    np.testing.assert_array_equal(report.needed, least.needed)
    np.testing.assert_array_equal(stacked(pixels), stacked(expected))


@pytest.mark.gpu
@pytest.mark.parametrize("name", sorted(set(extremes.SCENES) - {"anisotropy", "upright"}))
def test_the_ends_of_what_numbers_can_express(name):
    crowd, lines = extremes.scene(name)
    color, errors = errors_on_device(resting(crowd), lines)
    assert color < COLOR and max(errors.values()) < GRADIENT, errors


@pytest.mark.gpu
@pytest.mark.parametrize("lanes", [4, 16])
def test_thousands_on_one_ray_are_all_met_in_their_order(shared_by, lanes):
    shared_by(lanes)
    count = 10_000
    motion, lines = pile(count)
    options = replace(OPTIONS, k=16)
    capacity = measure(motion, lines, options=options)
    pixels, report = look(motion, lines, options=options, capacity=capacity)
    assert int(report.dropped) == 0 and int(report.hits) > 0.99 * count * RAYS
    assert np.mean(np.abs(stacked(pixels) - stacked(reference.trace(motion, lines)))) < COLOR


@pytest.mark.gpu
@pytest.mark.parametrize("jitter", [0.0, 0.05])
@pytest.mark.parametrize("size", [(0.3, 0.6), (0.003, 0.6)])
@pytest.mark.parametrize("fading", [False, True])
def test_in_deep_fog_bounds_of_peaks_keep_the_order(jitter, size, fading):
    fog = gaussians(COUNT, seed=4, size=size)
    motion = resting(fog._replace(opacity=np.full(COUNT, 0.05)))
    if fading:
        motion = beside(motion, fleeting(COUNT, seed=3, size=size))
    lines = rays(jitter=jitter, spread=0.02)._replace(time=np.full(RAYS, 0.4))
    color, errors = errors_on_device(motion, lines, replace(OPTIONS, k=2, bundle=8))
    assert color < COLOR and max(errors.values()) < GRADIENT, errors


@pytest.mark.parametrize("formed", [[3], range(40, 48), range(0, 256, 17)])
def test_rays_that_no_lens_forms_stop_none_of_their_neighbours(formed):
    # Warps in which some lanes bound rays and others have none: a fisheye's corners.
    lines, none = rays(256, spread=0.1), np.ones(256, bool)
    none[list(formed)] = False
    lines.direction[none] = 0
    options = replace(OPTIONS, bundle=8)
    motion = resting(gaussians(COUNT, size=(0.1, 0.5)))
    pixels, report = look(motion, shot(lines), options=options, capacity=roomy(options))
    seen = lines._replace(**{k: v[~none] for k, v in lines._asdict().items()})
    expected = stacked(reference.trace(motion, shot(seen)))
    assert int(report.dropped) == 0 and np.all(stacked(pixels)[none, :3] == 0)
    assert np.mean(np.abs(stacked(pixels)[~none] - expected)[:, :3]) < COLOR


@pytest.mark.gpu
@pytest.mark.parametrize("lanes", [4, 16])
def test_equal_distances_are_taken_in_the_order_of_the_gaussians(shared_by, lanes):
    shared_by(lanes)
    lines = shot(rays(jitter=0.0))
    capacity = Capacity((512, 512), 8192, 1024)
    pictures = [
        look(resting(sheet(1000)), lines, options=replace(OPTIONS, k=k), capacity=capacity)[0]
        for k in (4, 4, 16)
    ]
    expected = stacked(reference.trace(resting(sheet(1000)), lines))
    for picture in pictures:
        np.testing.assert_array_equal(stacked(picture), stacked(pictures[0]))
        np.testing.assert_allclose(stacked(picture)[:, :3], expected[:, :3], atol=COLOR)


@pytest.mark.gpu
def test_lists_that_are_too_short_are_counted():
    motion, lines = resting(gaussians(COUNT, size=(0.1, 0.5))), shot(rays())
    _, report = look(motion, lines, options=OPTIONS, capacity=Capacity((1, 1), 1, 8))
    whole_list = int(measure(motion, lines, options=OPTIONS, headroom=1.0).slots)
    assert int(report.dropped) > 0 and 8 < int(report.needed[-1]) <= whole_list


@pytest.mark.gpu
def test_cameras_and_parameters_do_not_compile_again():
    @eqx.debug.assert_max_traces(max_traces=1)
    def seen(motion, lines):
        return trace(motion, lines, options=OPTIONS, capacity=CAPACITY)[0].color

    compiled = eqx.filter_jit(seen)
    for seed in range(3):
        motion = resting(gaussians(COUNT, seed=seed, size=(0.1, 0.5)))
        assert np.all(np.isfinite(compiled(motion, shot(rays(seed=seed)))))


@pytest.mark.gpu
def test_strips_see_and_learn_what_the_whole_does(monkeypatch):
    motion, lines = mixed(), shot(rays())
    options = replace(OPTIONS, levels=0)
    weight = weights(dtype=np.float32)
    whole_picture = pull(motion, lines, weight, options=options, capacity=roomy(options))
    # Another size of the lists, so that this is compiled anew: a strip for every few groups.
    monkeypatch.setattr(kernel, "_MEMORY", 16_384)
    capacity = Capacity((512,), 8192, 256)
    strips = pull(motion, lines, weight, options=options, capacity=capacity)
    np.testing.assert_array_equal(stacked(strips[0]), stacked(whole_picture[0]))
    assert int(strips[1].hits) == int(whole_picture[1].hits)
    for a, b in zip(jax.tree.leaves(strips[2]), jax.tree.leaves(whole_picture[2]), strict=True):
        np.testing.assert_allclose(a, b, atol=SINGLE * max(np.abs(b).max(), 1e-30))


@pytest.mark.gpu
def test_samples_share_lists_on_the_device():
    motion, several = mixed(), samples_of(shot(rays()))
    together, _ = look(motion, several, options=OPTIONS, capacity=roomy(OPTIONS))
    for i in range(2):
        one, alone = (jax.tree.map(lambda x: x[i], x) for x in (several, together))  # noqa: B023
        expected, _ = look(motion, one, options=OPTIONS, capacity=roomy(OPTIONS))
        np.testing.assert_allclose(stacked(alone), stacked(expected), atol=SAME)
