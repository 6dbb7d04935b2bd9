"""On a CUDA device: what is seen and learnt there is what the brute force says."""

import pytest
from scenes import COUNT, against_brute_force, gaussians, moving, rays, resting, tinted, wandering
from test_trace import COLOR, GRADIENT


pytestmark = pytest.mark.gpu


@pytest.mark.parametrize("keys", [1, 3])
def test_values_and_gradients_on_the_device(keys):
    if keys == 1:
        motion = resting(gaussians(COUNT, size=(0.1, 0.5)))
    else:
        motion = wandering(*moving(COUNT, keys, size=(0.1, 0.5), amount=0.02))
    color, errors, report = against_brute_force(tinted(motion), rays())
    assert int(report.hits) > 0
    assert color < COLOR and max(errors.values()) < GRADIENT, errors
