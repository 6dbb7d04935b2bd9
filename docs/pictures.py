"""The pictures of the pages, filmed from the sample's scene: `python -m docs.pictures`."""

import dataclasses
from pathlib import Path

import numpy as np

from gaussray.camera.aperture import Aperture
from gaussray.camera.camera import Camera
from gaussray.camera.shutter import Shutter
from gaussray.dataset.images import contact_sheet, write_image
from gaussray.io.sample_data import sample
from gaussray.render import Renderer, RenderOptions
from gaussray.render.rig.view_files import load_views
from gaussray.scene.store import load_scene


OUT = Path(__file__).parent / "pictures"
number = np.float32


def opened(camera: Camera, focus: float) -> Camera:
    """The camera with a wide opening, focused so far away."""
    aperture = Aperture(number(0.12), number(focus), number(0), number(1))
    return dataclasses.replace(camera, aperture=aperture)


def read_out(camera: Camera, readout: float, exposure: float) -> Camera:
    """The camera with rows that are read one after another, each of them exposed."""
    step = readout / (camera.film.height - 1)
    shutter = Shutter(number(-readout / 2), number(step), number(exposure))
    return dataclasses.replace(camera, shutter=shutter)


def main() -> None:
    """Write a strip for each effect."""
    views = [view for view in load_views(sample("scene"), None) if view.camera_name == "cam13"]
    camera = views[6].camera
    render = Renderer(load_scene(sample("scene")), options=RenderOptions(samples=32))
    strips = {
        "aperture": {f"focus at {f}": opened(camera, f) for f in (1.5, 2.5, 4.5)},
        "shutter": {
            "no readout": read_out(camera, 0, 0),
            "readout 0.3": read_out(camera, 0.3, 0),
            "and exposure 0.1": read_out(camera, 0.3, 0.1),
        },
    }
    for name, cameras in strips.items():
        shown = [render(one).color for one in cameras.values()]
        write_image(OUT / f"{name}.png", contact_sheet([("", shown)], titles=list(cameras)))


if __name__ == "__main__":
    main()
