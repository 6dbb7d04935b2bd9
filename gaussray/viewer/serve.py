"""The viewer's web server: one scene, one page per connected browser."""

import contextlib
import io
import time as clock
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gaussray.config.compose import Configuration
from gaussray.viewer.model import ViewerModel
from gaussray.viewer.overlay import Overlay, camera_markers, overlay_points
from gaussray.viewer.preview import PreviewRenderer
from gaussray.viewer.viewpoint import subject_distance, up_direction, viewing_direction
from gaussray.viewer.window import window_fov


def serve(cfg: Configuration, words: Sequence[str]) -> "Server":
    """Start the viewer.

    Args:
        cfg: a configuration of `gaussray view`.
        words: words of the command line that it was composed from.

    Raises:
        ValueError: no camera can have these values, or viser is not installed.
    """
    try:
        import viser  # type: ignore[import-not-found]  # noqa: F401
    except ImportError as error:
        raise ValueError(
            "gaussray view needs viser, which is not installed: pip install -e '.[viewer]'"
        ) from error
    return Server(ViewerModel(cfg, words), Path(cfg.out))


class Server:
    """The running server at `url`; `stop` ends it."""

    def __init__(self, model: ViewerModel, out: Path):
        import viser  # type: ignore[import-not-found]

        from gaussray.viewer.page import Page

        job = model.job(model.initial_values, model.initial_viewpoint, model.size)
        options = model.options
        self.previewer = PreviewRenderer(
            model.scene, options=job.options, trace=job.trace, keys=options.keys
        )
        position, color = overlay_points(model.scene, model.cameras)
        scale = subject_distance(model.scene, model.initial_viewpoint)
        overlay = Overlay(camera_markers(model.views), position, color, scale)
        self.pages: dict[int, Page] = {}
        with contextlib.redirect_stdout(io.StringIO()):  # hide its banner
            self._server = viser.ViserServer(options.host, options.port, label="gaussray")
        self.url = f"http://{_address(options.host)}:{self._server.get_port()}"
        _set_initial_camera(self._server, model, scale)

        @self._server.on_client_connect
        def _(client: viser.ClientHandle) -> None:
            self.pages[client.client_id] = Page(client, model, self.previewer, out, overlay)

        @self._server.on_client_disconnect
        def _(client: viser.ClientHandle) -> None:
            with contextlib.suppress(KeyError):
                self.pages.pop(client.client_id).close()

    def wait(self) -> None:
        """Serve until the process is interrupted."""
        with contextlib.suppress(KeyboardInterrupt):
            while True:
                clock.sleep(3600)
        self.stop()

    def stop(self) -> None:
        """Close every page and stop the server."""
        for page in list(self.pages.values()):
            page.close()
        self.previewer.close()
        self._server.stop()


def _set_initial_camera(server, model: ViewerModel, scale: float) -> None:
    """Set the viewpoint at which every browser starts."""
    viewpoint, (width, height) = model.initial_viewpoint, model.size
    up = up_direction(model.views)
    server.scene.set_up_direction(up)
    camera, position = server.initial_camera, np.asarray(viewpoint.position)
    camera.position, camera.up = position, up
    camera.look_at = position + scale * viewing_direction(viewpoint)
    camera.fov = window_fov(model.fov, 1.5, width / height)
    camera.near = scale / 200


def _address(host: str) -> str:
    return "localhost" if host in ("0.0.0.0", "127.0.0.1") else host
