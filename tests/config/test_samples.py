"""Distributions of keys that do not exist are refused before anything is drawn."""

import pytest
import toy

from gaussray.config.compose import compose_config
from gaussray.config.samples import sample_source
from gaussray.dataset.manifest import write_manifest
from gaussray.scene.store import save_scene


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


def test_frames_that_a_layout_leaves_out_are_told_once_before_they_are_rendered(tmp_path, capsys):
    save_scene(tmp_path / "scene.npz", toy.scene())
    write_manifest(tmp_path / "cameras.json", toy.records())
    words = [f"scene={tmp_path}", "out=x", "dataset.count=2", "dataset.layout=carla_rs"]
    words += ["dataset.frames=0", "dataset.clearance=0", "camera.split=train"]
    words += ["trajectory=between", "trajectory.steps=12"]
    made = sample_source(compose_config("render", words), words)
    jobs = [made.make_job({})[1] for _ in range(2)]
    assert [len(job.records) for job in jobs] == [12, 12]
    told = "".join(capsys.readouterr())
    assert told.count("dataset.layout=carla_rs takes 10 frames of a sample; 12 are rendered.") == 1
