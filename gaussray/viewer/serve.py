"""The server of the page: one scene, a page for every visitor."""

import contextlib
import io
import time as clock
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gaussray.config.compose import Configuration
from gaussray.viewer.model import Studio
from gaussray.viewer.overlay import Around, marks, points
from gaussray.viewer.preview import Sketcher
from gaussray.viewer.viewpoint import distance_of, forwards, upwards
from gaussray.viewer.window import field_of_window


def serve(cfg: Configuration, words: Sequence[str]) -> "Server":
    """Start the page; ValueError where its camera is impossible, ImportError text without viser."""
    try:
        import viser  # type: ignore[import-not-found]  # noqa: F401
    except ImportError as error:
        raise ValueError(
            "gaussray view needs viser, which is not installed: pip install -e '.[viewer]'"
        ) from error
    return Server(Studio(cfg, words), Path(cfg.out))


class Server:
    """The page at `url`, until `stop`."""

    def __init__(self, studio: Studio, out: Path):
        import viser  # type: ignore[import-not-found]

        from gaussray.viewer.page import Page

        shot = studio.shot(studio.begin, studio.stance, studio.size)
        chosen = studio.options
        self.sketcher = Sketcher(
            studio.scene, options=shot.options, trace=shot.trace, keys=chosen.keys
        )
        place, color = points(studio.scene, studio.cameras)
        scale = distance_of(studio.scene, studio.stance)
        around = Around(marks(studio.views), place, color, scale)
        self.pages: dict[int, Page] = {}
        with contextlib.redirect_stdout(io.StringIO()):  # its banner
            self._server = viser.ViserServer(chosen.host, chosen.port, label="gaussray")
        self.url = f"http://{_address(chosen.host)}:{self._server.get_port()}"
        _look(self._server, studio, scale)

        @self._server.on_client_connect
        def _(client: viser.ClientHandle) -> None:
            self.pages[client.client_id] = Page(client, studio, self.sketcher, out, around)

        @self._server.on_client_disconnect
        def _(client: viser.ClientHandle) -> None:
            with contextlib.suppress(KeyError):
                self.pages.pop(client.client_id).close()

    def wait(self) -> None:
        """Until the process is interrupted."""
        with contextlib.suppress(KeyboardInterrupt):
            while True:
                clock.sleep(3600)
        self.stop()

    def stop(self) -> None:
        """Close every page."""
        for page in list(self.pages.values()):
            page.close()
        self.sketcher.close()
        self._server.stop()


def _look(server, studio: Studio, scale: float) -> None:
    """Where every visitor looks from first."""
    stance, (width, height) = studio.stance, studio.size
    up = upwards(studio.views)
    server.scene.set_up_direction(up)
    camera, place = server.initial_camera, np.asarray(stance.place)
    camera.position, camera.up = place, up
    camera.look_at = place + scale * forwards(stance)
    camera.fov = field_of_window(studio.field, 1.5, width / height)
    camera.near = scale / 200


def _address(host: str) -> str:
    return "localhost" if host in ("0.0.0.0", "127.0.0.1") else host
