"""Tables of directions from disk, and what is none."""

import numpy as np
import pytest

from gaussray.dataset.images import write_image
from gaussray.io.ray_map import read_ray_map


def table():
    rays = np.random.default_rng(0).normal(size=(5, 6, 3)).astype(np.float32)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    rays[0, 0] = 0
    return rays


def test_an_npz_is_read_bit_by_bit_and_an_exr_to_its_precision(tmp_path):
    rays = table()
    np.savez(tmp_path / "a.npz", rays=rays)
    write_image(tmp_path / "a.exr", rays, depth="float")
    write_image(tmp_path / "half.exr", rays, depth="half")
    for name in ("a.npz", "a.exr"):
        np.testing.assert_array_equal(read_ray_map(tmp_path / name), rays)
    half = read_ray_map(tmp_path / "half.exr")
    # Eleven bits of each component; lengths are made 1 again.
    np.testing.assert_allclose(half, rays, atol=1e-3)
    lengths = np.linalg.norm(half, axis=-1)
    assert lengths[0, 0] == 0
    np.testing.assert_allclose(lengths.ravel()[1:], 1, atol=1e-6)


def test_what_is_no_table_is_named(tmp_path):
    np.savez(tmp_path / "other.npz", directions=table())
    np.savez(tmp_path / "flat.npz", rays=table()[0])
    np.savez(tmp_path / "whole.npz", rays=np.ones((4, 4, 3), int))
    np.savez(tmp_path / "nan.npz", rays=np.full((4, 4, 3), np.nan))
    np.savez(tmp_path / "object.npz", rays=np.array([{}]))
    (tmp_path / "text.npz").write_text("no")
    (tmp_path / "text.exr").write_text("no")
    (tmp_path / "a.txt").write_text("no")
    cases = {
        "other.npz": "must hold an array `rays`, got .'directions'.",
        "flat.npz": r"must hold numbers \[rows, columns, 3\], got float32 \[6, 3\]",
        "whole.npz": r"must hold numbers \[rows, columns, 3\], got int64",
        "nan.npz": "must be finite. Write zeros where there is no ray",
        "object.npz": "is no .npz file",
        "text.npz": "is no .npz file",
        "a.txt": "must be an .npz or .exr file",
    }
    for name, message in cases.items():
        with pytest.raises(ValueError, match=f"{name}: lens.file {message}"):
            read_ray_map(tmp_path / name)
    with pytest.raises(OSError, match="text.exr: lens.file cannot be read"):
        read_ray_map(tmp_path / "text.exr")
    with pytest.raises(FileNotFoundError, match="none.npz: lens.file does not exist"):
        read_ray_map(tmp_path / "none.npz")
