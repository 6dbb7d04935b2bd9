"""Levels by table are those of the curves in double precision, on the host and on the device."""

import jax
import numpy as np
import pytest

from gaussray.dataset.levels import device_levels, encoded_table, host_levels, srgb_table


def srgb(light):
    """IEC 61966-2-1, in double precision."""
    power = np.maximum(light, 0.0031308) ** (1 / 2.4)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * power - 0.055)


CURVES = {"srgb": (srgb_table, srgb), "encoded": (encoded_table, lambda value: value)}


def light_around_every_edge(table):
    """The least single-precision number of every level, its neighbours, the ends, and others."""
    edges = np.unique(table.edge[np.isfinite(table.edge)])
    near = [np.nextafter(edges, np.float32(side)) for side in (-1, 2)]
    ends = np.float32([0, -0.0, 1e-45, -1e-45, 1e-20, 1, np.nextafter(np.float32(1), 2), 7, 1e38])
    dice = np.random.default_rng(0)
    spread = np.float32([*dice.uniform(-0.2, 1.2, 100_000), *np.exp(dice.uniform(-15, 3, 100_000))])
    return edges, np.concatenate([edges, *near, ends, -ends, spread])


@pytest.mark.parametrize("curve", CURVES)
def test_every_level_begins_where_double_precision_rounds_to_it(curve):
    table, encode = CURVES[curve]
    edges, light = light_around_every_edge(table())
    assert len(edges) == 255
    # No number in single precision is an exact tie, so that the levels are equal.
    encoded = np.clip(encode(light.astype(np.float64)), 0, 1)
    expected = np.floor(255 * encoded + 0.5)
    on_host = host_levels(light, table())
    assert on_host.dtype == np.uint8
    np.testing.assert_array_equal(on_host, expected)
    on_device = jax.jit(lambda x: device_levels(x, table()))(light)
    np.testing.assert_array_equal(on_device, expected)
    centres = np.float32([np.interp(k / 255, encode(edges), edges) for k in range(1, 255)])
    np.testing.assert_array_equal(host_levels(centres, table()), np.arange(1, 255))


def test_colours_of_an_array_with_more_channels_need_no_copy_before():
    values = np.random.default_rng(0).random((4, 6, 5)).astype(np.float32)
    expected = host_levels(values[..., :3].copy(), srgb_table())
    np.testing.assert_array_equal(host_levels(values[..., :3], srgb_table()), expected)
    strided = values.transpose(1, 0, 2)[..., :3]
    np.testing.assert_array_equal(host_levels(strided, srgb_table()), expected.swapaxes(0, 1))
