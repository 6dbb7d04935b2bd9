"""The Gaussian that rays see most of, from a scene and rays alone."""

from dataclasses import replace

from gaussray.tracer.dominant import dominant
from gaussray.tracer.trace import find_candidates, prepare_for_rays


def dominant_of(motion, rays, *, options, capacity):
    """`dominant` with the lists of the array backend."""
    arrays = replace(options, backend="array")
    scene = prepare_for_rays(motion, rays, arrays, capacity)
    lists, _ = find_candidates(scene, rays, options=arrays, capacity=capacity)
    return dominant(scene, rays, lists, options=options, slots=capacity.slots)
