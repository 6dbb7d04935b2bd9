"""Pictures of the capture beside renderings."""

import json

import numpy as np
import pytest
import toy

from gaussray.capture.formats.paired import read_capture
from gaussray.dataset.images import write_image
from gaussray.evaluate.found_cameras import FoundCapture
from gaussray.report.cameras import rendered_samples


@pytest.mark.parametrize("hidden", [toy.SIZE // 2, toy.SIZE])
def test_a_picture_that_its_mask_hides_has_no_figure(tmp_path, hidden):
    toy.write_capture(tmp_path, toy.scene(speed=0), times=(0.0,))
    content = json.loads((tmp_path / "transforms.json").read_text())
    white = np.where(np.arange(toy.SIZE) < hidden, 0, 255).astype(np.uint8)
    write_image(tmp_path / "mask.png", np.tile(white, (toy.SIZE, 1)))
    first = content["frames"][0]
    first["mask_path"] = "mask.png"
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    section = rendered_samples(toy.scene(speed=0), FoundCapture(read_capture(tmp_path)))
    captions = "".join(map(str, section.body)).split("<figcaption>")[1:]
    own = [text.split("</figcaption>")[0] for text in captions]
    assert len(own) > 1 and not any("nan" in text for text in own)
    for text in own:
        shown = hidden < toy.SIZE or first["camera"] not in text
        assert ("time 0, " in text and " dB" in text) == shown
        assert shown or text.endswith("time 0")
