"""Rigid bodies among what moves, tracked through the pictures before the first step of the fine
stage."""

import numpy as np

from gaussray.geometry import rotation_matrix
from gaussray.reconstruct.initialize.body_groups import body_groups
from gaussray.reconstruct.initialize.body_tracking import track
from gaussray.reconstruct.initialize.from_points import on_points
from gaussray.reconstruct.initialize.regrouping import MovingGaussians
from gaussray.reconstruct.optimize.rows import take_rows
from gaussray.reconstruct.run_progress import KnownBodies, RunProgress
from gaussray.reconstruct.session import Session
from gaussray.reconstruct.start import may_move
from gaussray.scene.bodies import Bodies, body_of
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import C0


def tracked_bodies(session: Session, moving: Gaussians, progress: RunProgress) -> Bodies:
    """The rigid bodies among what moves, with their poses at all times.

    There are none where points do not lie on surfaces, nor where every camera took one picture.

    Args:
        session: the segment.
        moving: the moving Gaussians.
        progress: the progress so far, with the rigid bodies of the segment before.
    """
    given, start = session.capture.points is not None, session.options.fit.start
    matched = start in ("auto", "stereo") and sum(progress.initial) > 0
    on_surfaces = matched or (given and start != "random")
    if not (on_surfaces and session.has_videos):
        return _surface_bodies(session, take_rows(moving, np.zeros(0, int)), progress.bodies)
    if session.is_continuation:
        return _surface_bodies(session, moving, progress.bodies)
    options = session.options
    return session.shared.once(
        ("bodies", options.track, options.fit.moving_threshold, *session.points_key),
        lambda: _surface_bodies(session, _initial_surface(session), progress.bodies),
    )


def _surface_bodies(session: Session, surface: Gaussians, known: KnownBodies | None) -> Bodies:
    """The rigid bodies among the Gaussians of a surface, with their poses at all times; those
    known from the segment before first."""
    times, position = session.times, np.asarray(surface.mean)
    balls = None if known is None else (known.pivot, known.radius)
    groups = body_groups(position, times, known=balls)
    return track(
        groups,
        MovingGaussians(
            np.asarray(body_of(groups, surface.mean)),
            position,
            np.asarray(rotation_matrix(surface.quat))[:, :, 2],
            np.asarray(surface.harmonics[:, 0] * C0 + 0.5),
        ),
        session.shown,
        session.footage.camera,
        options=session.options.track,
        seed=session.options.fit.seed,
        report=lambda work: session.progress_bar(work, len(times) - 1).report,
    )


def _initial_surface(session: Session) -> Gaussians:
    """Discs on the initial points that move. They have the colours of the surface; those of fitted
    Gaussians, which overlap, make up for one another."""
    position, color, on_surfaces = session.initial_points
    moves = may_move(session, position, on_surfaces=on_surfaces)
    return on_points(position[moves], color[moves], degree=0, opacity=1.0)
