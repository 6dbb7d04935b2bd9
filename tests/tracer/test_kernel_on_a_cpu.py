"""The CUDA kernels without a GPU: their tests, with the threads of a block one after another."""

import jax
import one_thread
import pytest
import test_kernel

from gaussray.tracer import kernel


pytestmark = [
    pytest.mark.ci,
    pytest.mark.skipif(one_thread.COMPILER is None, reason="there is no g++"),
]
# Each takes a function that sets how many lanes share a ray. No two compile the same program.
CASES = {
    "one hit at a time": lambda _: test_kernel.test_how_the_work_is_cut_does_not_matter({"k": 1}),
    "bundles of 8 x 8": lambda _: test_kernel.test_how_the_work_is_cut_does_not_matter(
        {"bundle": 8}
    ),
    "four lanes": lambda share: test_kernel.test_any_number_of_lanes_shares_a_ray(share, 4, 8),
    "eight lanes": lambda share: test_kernel.test_any_number_of_lanes_shares_a_ray(share, 8, 4),
    "harmonics": lambda _: test_kernel.test_every_degree_of_colour(3),
    "motion": lambda _: test_kernel.test_key_states_and_tints(3),
    "rest beside motion": lambda _: test_kernel.test_what_rests_beside_what_moves(),
    "transient": lambda _: test_kernel.test_transient_gaussians_at_times_of_rays("mixed", "own"),
    "transient at one time": lambda _: test_kernel.test_transient_gaussians_at_times_of_rays(
        "resting", "same"
    ),
    "fog": lambda _: test_kernel.test_in_deep_fog_bounds_of_peaks_keep_the_order(
        0.05, (0.003, 0.6), True
    ),
    "equal distances": lambda share: (
        test_kernel.test_equal_distances_are_taken_in_the_order_of_the_gaussians(share, 16)
    ),
    "short lists": lambda _: test_kernel.test_lists_that_are_too_short_are_counted(),
    "samples": lambda _: test_kernel.test_samples_share_lists_on_the_device(),
}


@pytest.fixture(scope="module")
def emulated(tmp_path_factory):
    """What is compiled here is not for other tests, nor theirs for these."""
    with pytest.MonkeyPatch.context() as patch:
        one_thread.run_on_a_cpu(patch, tmp_path_factory.mktemp("kernels"))
        jax.clear_caches()
        yield
    jax.clear_caches()


@pytest.mark.parametrize("name", CASES)
def test_on_a_cpu_the_kernels_do_what_they_do_on_a_gpu(name, emulated, monkeypatch):
    CASES[name](lambda lanes: monkeypatch.setattr(kernel, "_LANES", {1 << 30: lanes}))
