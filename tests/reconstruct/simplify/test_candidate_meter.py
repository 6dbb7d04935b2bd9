"""What Gaussians add to pictures sums to what is seen, and PSNR is that of the pictures."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.color import srgb_encode
from gaussray.evaluate.metrics import psnr
from gaussray.reconstruct.simplify.candidate import whole_candidate
from gaussray.reconstruct.simplify.candidate_meter import CandidateMeter, Tracing
from gaussray.reconstruct.simplify.tile_views import TrainingViews, tile_views
from gaussray.render.options import RenderOptions
from gaussray.render.renderer import Renderer
from gaussray.tracer.shard import mesh


TRACE = toy.SHORT.trace
# Rays end where 1 % of their light is left, and their sums are of single precision.
REST, CLOSE = 0.01, 1e-4


def test_what_all_gaussians_add_is_what_they_cover(seen, whole):
    scene = toy.scene()
    meter = CandidateMeter(whole[0], Tracing(TRACE, mesh(1)))
    candidate = whole_candidate(scene)
    weight = meter.weights(candidate, whole[1])
    assert weight.shape == (27,) and (weight >= 0).all()
    covered = 0.0
    renderer = Renderer(scene, options=RenderOptions(samples=1), trace=toy.TRACE)
    for record in toy.records(cameras=toy.CAMERAS[:3]):
        covered += renderer(record.camera).alpha.sum() / 3
    # Instants see other tiles each, and what moves covers about as much at each of them.
    assert weight.sum() == pytest.approx(covered, rel=0.05)
    alone = eqx.tree_at(lambda d: d.kept, candidate, candidate.kept & (np.arange(27) == 12))
    single = meter.weights(alone, whole[1])
    assert single[12] >= weight[12] - CLOSE and np.delete(single, 12).max() < CLOSE


def test_the_psnr_is_that_of_the_pictures(seen):
    tiles = (toy.SIZE // TRACE.bundle) ** 2
    some, _, _ = tile_views(
        TrainingViews(seen, seen.camera), tiles=400 * tiles, instants=1, weigh=1, seed=0
    )
    dark = toy.scene()
    dark = eqx.tree_at(lambda s: s.static.harmonics, dark, dark.static.harmonics - 0.3)
    found = CandidateMeter(some, Tracing(TRACE, mesh(1))).psnr(whole_candidate(dark))
    renderer = Renderer(dark, options=RenderOptions(samples=1), trace=toy.TRACE)
    first = [i for i, time in enumerate(seen.times) if time == 0]
    camera = [jax.tree.map(lambda x, i=i: x[i], seen.camera) for i in first]
    ours = [srgb_encode(renderer(one).color) for one in camera]
    truth = seen.pictures(np.array(first))
    square = [10 ** (-psnr(a, x) / 10) for a, x in zip(truth, ours, strict=True)]
    # Tiles are drawn at random, each about 400 times.
    assert found == pytest.approx(-10 * np.log10(np.mean(square)), abs=0.2)


def test_rays_that_share_a_time_other_than_their_pictures_are_measured(whole):
    """Such as those of videos whose frames are all late by the same delay."""
    candidate, late = whole_candidate(toy.scene()), 0.05
    shifted = [
        dataclasses.replace(tiles.rays, time=jnp.full_like(tiles.rays.time, tiles.time + late))
        for tiles in whole[0]
    ]
    views = [t._replace(rays=rays) for t, rays in zip(whole[0], shifted, strict=True)]
    moved = [t._replace(time=t.time + late) for t in views]
    several = CandidateMeter(views, Tracing(TRACE, mesh(1), keys=3)).psnr(candidate)
    alone = CandidateMeter(moved, Tracing(TRACE, mesh(1))).psnr(candidate)
    assert several == pytest.approx(alone, abs=0.01)


@pytest.mark.slow
def test_a_psnr_that_is_not_reached_is_not_measured_to_the_end(whole):
    meter, candidate = (
        CandidateMeter(whole[0], Tracing(TRACE, mesh(1))),
        whole_candidate(toy.scene()),
    )
    faint = eqx.tree_at(lambda d: d.kept, candidate, candidate.kept & False)
    exact, low = meter.psnr(candidate), meter.psnr(faint)
    assert meter.psnr(candidate, least=exact - 0.01) == exact
    assert (
        meter.psnr(faint, least=low + 0.01) == meter.psnr(candidate, least=exact + 0.01) == -np.inf
    )
    looked = []
    meter._run = lambda *x, run=meter._run: looked.append(x) or run(*x)
    meter.psnr(faint, least=exact)
    assert len(looked) == 1 < len(meter.views)
