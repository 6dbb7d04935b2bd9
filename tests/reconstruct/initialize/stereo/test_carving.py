"""Points that pictures contradict: those in the air go, those on the surface stay, whatever the
exposure, and whoever hides others is judged before them."""

import jax
import numpy as np
from textured_plane import NORMAL, OFFSET, PLACES, SIZE, perspective, rig

from gaussray.reconstruct.initialize.stereo.carving import contradicted
from gaussray.reconstruct.initialize.stereo.views import rays, stereo_views, unpacked


VIEWS = 5
# Half way to the cameras: another view sees another colour behind a point.
HIGH = 1.5
# Shares of what is wrong that is found, and of what is right that is lost. A point in the air may
# lie before its own colour in most pictures, and one on the surface at the border of two colours.
FOUND, LOST = 0.7, 0.05


def shown(brighter=(0.0,) * VIEWS):
    cameras = rig(perspective(), PLACES[:VIEWS])
    blank = stereo_views(np.zeros((VIEWS, SIZE, SIZE, 3)), cameras, None, factor=1)
    pictures = np.stack([painted(blank[i]) for i in range(VIEWS)])
    pictures += np.reshape(brighter, (-1, 1, 1, 1))
    return stereo_views(np.clip(pictures, 0, 1).astype(np.float32), cameras, None, factor=1)


def on_plane(view, behind=0.0):
    """Where the rays of a view meet the plane that lies so far behind the one in the pictures."""
    ray = np.asarray(rays(view.lens, view.world_from_camera, view.size, view.factor))
    origin = np.asarray(view.origin)
    along = (OFFSET + behind - NORMAL @ origin) / np.einsum("i,ihw->hw", NORMAL, ray)
    return origin + np.moveaxis(along * ray, 0, -1)


def painted(view):
    """A picture of the plane in a pattern that is wide beside a pixel."""
    return 0.5 + 0.3 * np.sin(on_plane(view) @ np.array([[3.0, 2, 1], [-2, 3, 2.5], [0, 0, 0]]))


def points(views, behind, *, step=1):
    """Points on every `step`th ray of the first view, so far behind the plane, in the colours that
    it shows."""
    place = on_plane(views[0], behind)[::step, ::step].reshape(-1, 3)
    channels, _ = unpacked(views.pixel[0, ::step, ::step].reshape(-1), np.float32)
    return place.astype(np.float32), np.stack([np.asarray(c) for c in channels], axis=1)


def test_points_in_the_air_go_and_those_on_the_surface_stay():
    views = shown()
    right, wrong = points(views, 0.0), points(views, -HIGH, step=3)
    place, color = (np.concatenate(x) for x in zip(right, wrong, strict=True))
    gone = contradicted(views, place, color)
    assert gone.shape == (len(place),)
    assert gone[len(right[0]) :].mean() > FOUND
    assert gone[: len(right[0])].mean() < LOST


def test_other_exposures_contradict_nothing():
    views = shown(brighter=(0, 0.15, -0.1, 0.1, 0.2))
    assert contradicted(views, *points(views, 0.0)).mean() < LOST


def test_what_stays_hides_what_is_behind_it():
    views = shown()
    # Behind the plane, in the colours that the first view shows in front of them.
    place, color = points(views, 4 * HIGH, step=3)
    surface = points(views, 0.0)[0]
    assert contradicted(views, place, color).mean() > FOUND
    assert contradicted(views, place, color, fixed=surface).mean() < LOST


def test_colours_that_tell_nothing_and_views_alone_remove_nothing():
    views = shown()
    place, color = points(views, 0.0)
    dice = np.random.default_rng(0)
    assert not contradicted(views, place, np.round(dice.random(color.shape))).any()
    assert not contradicted(jax.tree.map(lambda x: x[:1], views), place, color).any()
    assert contradicted(views, place[:0], color[:0]).shape == (0,)
