"""Points inside silhouettes: within the visual hull, and near what casts it."""

import jax.numpy as jnp
import numpy as np
from textured_plane import SIZE, perspective, rig

from gaussray.reconstruct.initialize.stereo.silhouette import silhouette_points
from gaussray.reconstruct.initialize.stereo.views import seen_at, stereo_views


# Cameras a quarter turn apart: no patch looks alike in two of them.
AROUND = [(0.0, 0.0, -3.0), (3.0, 0.0, 0.0), (0.0, 0.0, 3.0), (-3.0, 0.0, 0.0)]
RADIUS = 0.4


def balls_view():
    """Four views of a ball at the origin, each side of another colour, on black, and its pixels."""
    cameras = rig(perspective(), AROUND)
    row, column = np.mgrid[:SIZE, :SIZE] + 0.5
    away = np.hypot(row - SIZE / 2, column - SIZE / 2) / (1.1 * SIZE)
    # The silhouette of a ball at 3 is a cone of this half angle.
    ball = away < np.tan(np.arcsin(RADIUS / 3))
    moved = np.stack([ball] * len(AROUND))
    paint = np.array([[200, 40, 40], [40, 200, 40], [40, 40, 200], [200, 200, 40]], np.uint8)
    pictures = moved[..., None] * paint[:, None, None]
    return stereo_views(pictures, cameras, moved, factor=1), moved


def test_points_lie_in_all_silhouettes_and_near_the_ball():
    views, moved = balls_view()
    found = silhouette_points(views, moved)
    assert len(found.position) > 0.9 * moved.sum()
    x, y, inside = (np.asarray(v) for v in seen_at(views, jnp.asarray(found.position.T)))
    for k, mask in enumerate(moved):
        # Of the four pixels around a place one is enough.
        near = np.stack(
            [
                mask[
                    np.clip((y[k] + dy).astype(int), 0, SIZE - 1),
                    np.clip((x[k] + dx).astype(int), 0, SIZE - 1),
                ]
                for dx in (-0.5, 0.5)
                for dy in (-0.5, 0.5)
            ]
        )
        assert (near.any(axis=0) | ~inside[k]).all()
    # The hull of four cameras is a square with rounded corners, seen from above.
    assert np.linalg.norm(found.position, axis=1).max() < 1.6 * RADIUS
    np.testing.assert_allclose(np.linalg.norm(found.normal, axis=1), 1, rtol=1e-6)


def test_no_points_where_another_view_shows_that_nothing_is_there():
    views, moved = balls_view()
    none = np.zeros_like(moved)
    none[0] = moved[0]
    blind = stereo_views(
        np.zeros((*moved.shape, 3), np.uint8),
        rig(perspective(), AROUND),
        none,
        factor=1,
    )
    assert len(silhouette_points(blind, none).position) == 0
