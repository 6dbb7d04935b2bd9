"""Distributions of keys that do not exist are refused before anything is drawn."""

import pytest

from gaussray.config.compose import compose_config
from gaussray.config.samples import sample_source


def source(*words):
    words = ["scene=nowhere", "out=x", "dataset.count=2", "dataset.redraws=5", *words]
    return sample_source(compose_config("render", words), words)


@pytest.mark.parametrize(
    "word, message",
    [
        ("sample.lens.fovv.uniform=[40,50]", "^sample.lens.fovv: .* Did you mean lens.fov"),
        ("sample.lense.fov.uniform=[40,50]", "^sample.lense.fov: .* Did you mean lens.fov"),
        ("sample.fsp.uniform=[20,30]", "^sample.fsp: fsp is no key .* Did you mean fps"),
        (
            "sample.lens.choice=[fisheye,opencvv]",
            "^sample.lens.choice must be among .*got 'opencvv'. Did you mean opencv",
        ),
    ],
)
def test_what_is_no_key_is_refused_once_with_the_nearest_name(word, message):
    # The scene does not exist: nothing is read before.
    with pytest.raises(ValueError, match=message) as error:
        source(word)
    assert "redraws" not in str(error.value)


@pytest.mark.parametrize(
    "words",
    [
        ("sample=cameras", "dataset.frames=0"),
        ("sample.lens.choice=[fisheye,opencv]", "sample.lens.fov.uniform=[40,50]"),
        ("sample.fps.uniform=[20,30]", "sample.aperture.rim_radius.uniform=[0.1,0.2]"),
        ("sample.sensor.choice=[phone,none]",),
    ],
)
def test_keys_and_groups_of_the_configuration_are_drawn(words):
    drawn = source("dataset.frames=0", *words).distributions
    assert any(key.split(".")[0] in ("lens", "fps", "sensor") for key in drawn)
