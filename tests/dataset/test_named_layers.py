"""Layers and codes come back as they were written."""

import numpy as np
import OpenImageIO as oiio
import pytest

from gaussray.dataset.layers import read_integers, read_layers, write_integers, write_layers


def test_layers_come_back_by_name_to_the_last_bit(tmp_path):
    rng = np.random.default_rng(0)
    flow = rng.normal(size=(3, 4, 2)).astype(np.float32)
    flow[0, 0] = np.nan
    index = np.full((3, 4), (1 << 24) - 1)
    index[1, 1] = -1
    write_layers(
        tmp_path / "a.exr", {"flow": flow, "gaussian": index, "depth": flow[..., 0] * 1e30}
    )
    found = read_layers(tmp_path / "a.exr")
    assert set(found) == {"flow.x", "flow.y", "gaussian", "depth"}
    np.testing.assert_array_equal(found["flow.y"], flow[..., 1])
    np.testing.assert_array_equal(found["depth"], flow[..., 0] * np.float32(1e30))
    np.testing.assert_array_equal(found["gaussian"], index)


@pytest.mark.parametrize(("largest", "kind"), [(255, "uint8"), (256, "uint16")])
def test_codes_take_as_many_bits_as_they_need(tmp_path, largest, kind):
    codes = np.array([[0, 1, largest]])
    write_integers(tmp_path / "a.png", codes)
    image = oiio.ImageInput.open(str(tmp_path / "a.png"))
    found = image.read_image("uint16" if kind == "uint16" else "uint8")
    assert str(image.spec().format) == kind
    np.testing.assert_array_equal(found[..., 0], codes)
    np.testing.assert_array_equal(read_integers(tmp_path / "a.png"), codes)


def test_what_does_not_fit_is_refused(tmp_path):
    with pytest.raises(ValueError, match="gaussian must be below 2"):
        write_layers(tmp_path / "a.exr", {"gaussian": np.full((1, 1), 1 << 24)})
    with pytest.raises(ValueError, match="codes must be from 0 to 65535"):
        write_integers(tmp_path / "a.png", np.array([[-1]]))
    with pytest.raises(OSError, match="the layers cannot be read"):
        read_layers(tmp_path / "none.exr")
