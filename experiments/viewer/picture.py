"""Photographs the page in headless Chromium, and tells how fast it follows the mouse.

`python -m experiments.viewer.picture SCENE OUT [key=value ...]`, after
`pip install -e '.[browser]'`, with chromium and chromedriver on the path. Keys are those of
`gaussray view`.
"""

import shutil
import statistics
import sys
import time as clock
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By

from gaussray.config.compose import compose_config
from gaussray.viewer.serve import serve
from gaussray.viewer.timing import RenderStatus


FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--hide-scrollbars"),
    *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    "--window-size=1400,950",
)
PATIENCE, TURN = 900, 20.0


def main(scene: str, out: Path, words: list[str]) -> None:
    told = [f"scene={scene}", f"out={out}/presets", "view.port=8912", *words]
    server = serve(compose_config("view", told), told)
    browser = chromium()
    began = clock.monotonic()
    browser.get(server.url)
    until(lambda: bool(server.pages))
    (page,) = server.pages.values()
    readings: list[RenderStatus] = []
    tell = page.session._report

    def listen(said: Any) -> None:
        if isinstance(said, RenderStatus) and said.stages:
            readings.append(said)
        tell(said)

    page.session._report = listen
    until(lambda: bool(readings))
    print(f"first preview after {clock.monotonic() - began:.1f} s")
    for button in browser.find_elements(By.CSS_SELECTOR, ".mantine-Notification-closeButton"):
        button.click()
    page.handles["layout"].value = "side by side"
    settled(page, {"pinhole", "camera"})
    photograph(browser, out / "page.png")
    page.handles["dark"].value = False
    page.handles["layout"].value = "split"
    settled(page, {"pinhole", "camera"})
    photograph(browser, out / "light.png")
    page.handles["layout"].value = "pinhole"
    page.handles["cameras"].value = True
    settled(page, {"pinhole"})
    photograph(browser, out / "cameras.png")
    page.handles["cameras"].value = False
    follow(page, readings, server)
    browser.quit()
    server.stop()


def follow(page: Any, readings: list[RenderStatus], server: Any) -> None:
    """Turn around what is looked at, for as long as sizes take to settle, and tell of the end."""
    camera = page.client.camera
    middle, place = np.array(camera.look_at), np.array(camera.position)
    up = np.array(camera.up_direction) / np.linalg.norm(camera.up_direction)
    begin = clock.monotonic()
    while (gone := clock.monotonic() - begin) < TURN or (
        server.previewer.compiling and gone < PATIENCE
    ):
        angle, way = 0.3 * np.sin(gone), place - middle
        turned = way * np.cos(angle) + np.cross(up, way) * np.sin(angle)
        turned += up * (up @ way) * (1 - np.cos(angle))
        camera.position = middle + turned
        camera.look_at = middle
        page.refresh()
        clock.sleep(0.02)
    moving = [r for r in readings if not r.final and r.rate][-20:]
    for stage in ("tracing", "developing", "encoding"):
        print(f"{stage}: {statistics.median(r.stages[stage] for r in moving):.1f} ms")
    rate = statistics.median(r.rate for r in moving)
    sizes = sorted({r.size for r in moving})
    print(f"{rate:.1f} frames/s at {sizes}, dropped {sum(r.dropped for r in moving)}")


def settled(page: Any, names: set[str]) -> None:
    """Until these pictures are there as rendered."""
    until(lambda: set(page.session.pictures) == names)


def photograph(browser: Any, path: Path) -> None:
    clock.sleep(2)
    path.parent.mkdir(parents=True, exist_ok=True)
    browser.save_screenshot(str(path))
    print(path)


def chromium() -> Any:
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or ""
    for flag in FLAGS:
        options.add_argument(flag)
    return webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))


def until(holds: Callable[[], bool]) -> None:
    end = clock.monotonic() + PATIENCE
    while not holds():
        if clock.monotonic() > end:
            raise TimeoutError("the page did not get there in time")
        clock.sleep(0.05)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), sys.argv[3:])
