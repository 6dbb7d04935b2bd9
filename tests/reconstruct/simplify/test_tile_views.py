"""Tiles to measure on are spread over times and cameras, and together show all that there is."""

import jax
import numpy as np
import toy

from gaussray.reconstruct.simplify.tile_views import TrainingViews, tile_views


TRACE = toy.SHORT.trace


def test_together_the_further_views_see_every_tile_of_every_camera_once(seen, whole):
    some, further, complete = whole
    assert len(some) == len(further) == 3 and not complete
    assert [float(look.time) for look in some] == list(toy.TIMES)
    # Rays of static cameras are as many as their pixels, each another one.
    origin, direction = (
        np.concatenate([np.asarray(getattr(x.rays, name)) for x in further])
        for name in ("origin", "direction")
    )
    assert len(np.unique(np.concatenate([origin, direction], axis=1), axis=0)) == 3 * toy.SIZE**2


def test_tiles_depend_on_the_seed_alone(seen, whole):
    again = tile_views(TrainingViews(seen, seen.camera), tiles=4, instants=3, weigh=12, seed=0)
    other = tile_views(TrainingViews(seen, seen.camera), tiles=4, instants=3, weigh=12, seed=1)
    for a, b in zip(jax.tree.leaves(whole), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(a, b)
    assert any(np.any(a.truth != b.truth) for a, b in zip(whole[0], other[0], strict=True))


def test_psnr_and_contributions_are_measured_on_tiles_chosen_independently(seen):
    views = TrainingViews(seen, seen.camera)
    measured, weighed, complete = tile_views(views, tiles=4, instants=1, weigh=4, seed=0)
    first, second = (np.asarray(tiles[0].rays.direction) for tiles in (measured, weighed))
    assert not complete and first.shape == second.shape and np.any(first != second)


def test_all_tiles_are_complete(seen):
    bundles = seen.pixel.shape[1] * len(seen.times)
    views = TrainingViews(seen, seen.camera)
    assert tile_views(views, tiles=4, instants=99, weigh=2 * bundles, seed=0).complete


def test_fewer_instants_and_tiles_are_spread_evenly(seen):
    some, further, _ = tile_views(
        TrainingViews(seen, seen.camera), tiles=2, instants=2, weigh=4, seed=0
    )
    assert [float(look.time) for look in some] == [0.0, 1.0]
    assert len(further) == 2 and further[0].truth.shape == (2 * TRACE.bundle**2, 3)


def test_fewer_times_than_instants_are_measured_on_as_many_tiles(seen):
    views = TrainingViews(seen, seen.camera)
    measured = tile_views(views, tiles=2, instants=6, weigh=1, seed=0).measured
    assert [float(look.time) for look in measured] == [t for t in toy.TIMES for _ in range(2)]
    first, second = (np.asarray(look.rays.direction) for look in measured[:2])
    assert np.any(first != second)
