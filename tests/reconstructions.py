"""Reconstructions of COLMAP, of points that a camera sees from known places."""

import numpy as np
import pytest
from quads import looking


colmap = pytest.importorskip("pycolmap")

WIDTH, HEIGHT, FOCAL = 320, 240, 300.0
# Pixels of noise of a feature.
NOISE = 0.3


def reconstruction(poses, focal=FOCAL, bend=0.0):
    """What structure from motion finds of 200 points of a room, with a focal length and one
    coefficient of distortion that may be wrong."""
    draw = np.random.default_rng(0)
    points = draw.uniform([-1.5, 0.5, 0.3], [1.5, 2.5, 2.5], (200, 3))
    made = colmap.Reconstruction()
    true = colmap.Camera(
        model="SIMPLE_RADIAL", width=WIDTH, height=HEIGHT, params=[FOCAL, WIDTH / 2, HEIGHT / 2, 0]
    )
    found = colmap.Camera(
        model="SIMPLE_RADIAL",
        width=WIDTH,
        height=HEIGHT,
        params=[focal, WIDTH / 2, HEIGHT / 2, bend],
        camera_id=1,
    )
    made.add_camera_with_trivial_rig(found)
    for number, pose in enumerate(poses, 1):
        pixels = np.array(true.img_from_cam(points @ pose[:, :3].T + pose[:, 3]))
        noisy = pixels + draw.normal(0, NOISE, pixels.shape)
        image = colmap.Image(name=f"{number}.png", keypoints=noisy, camera_id=1, image_id=number)
        turn = colmap.Rotation3d(np.ascontiguousarray(pose[:, :3]))
        made.add_image_with_trivial_frame(image, colmap.Rigid3d(turn, pose[:, 3]))
    for k, point in enumerate(points):
        track = colmap.Track()
        for number in range(1, len(poses) + 1):
            track.add_element(number, k)
        made.add_point3D(point, track)
    return made


def around(count=6):
    angles = np.radians(np.linspace(-40, 40, count))
    return [looking((5 * np.sin(a), 1.5 - 5 * np.cos(a), 1.8)) for a in angles]
