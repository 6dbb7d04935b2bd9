"""The page in a real browser: `pip install -e ".[browser,test]"`, a chromium and its driver, then
`pytest -m slow -n 0 tests/viewer/test_browser.py`. GAUSSRAY_SCREENSHOTS is a folder for pictures.
"""

import importlib.util
import os
import pathlib
import shutil
import time as clock

import pytest
import rooms

from gaussray.cli.main import main
from gaussray.config.compose import compose_config


CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
DRIVER = shutil.which("chromedriver")
HAS = all(importlib.util.find_spec(name) for name in ("viser", "selenium"))
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (CHROMIUM and DRIVER and HAS), reason="no browser to drive"),
    # Sockets of viser's server and selenium's end with the process.
    pytest.mark.filterwarnings("ignore"),
]
FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--hide-scrollbars"),
    *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    "--window-size=1400,950",
)
PATIENCE = 240


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return rooms.write_scene(tmp_path_factory.mktemp("run"))


@pytest.fixture(scope="module")
def server(run):
    from gaussray.viewer.serve import serve

    words = [f"scene={run}", f"out={run}/presets", "view.port=8911", *rooms.WORDS]
    server = serve(compose_config("view", words), words)
    yield server
    server.stop()


@pytest.fixture(scope="module")
def browser(server, tmp_path_factory):
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(flag)
    browser = webdriver.Chrome(options=options, service=Service(DRIVER))
    browser.get(server.url)
    until(lambda: server.pages)
    until(lambda: "Final picture" in text(browser))
    yield browser
    browser.quit()


@pytest.fixture
def page(server, browser):
    """The server's side of the visitor, at rest."""
    (page,) = server.pages.values()
    until(lambda: page.session.pictures)
    return page


def until(holds):
    end = clock.monotonic() + PATIENCE
    while not holds():
        assert clock.monotonic() < end, "the page did not get there in time"
        clock.sleep(0.1)


def text(browser):
    return browser.execute_script("return document.body.innerText")


def screenshot(browser, name):
    folder = os.environ.get("GAUSSRAY_SCREENSHOTS")
    if folder:
        clock.sleep(1)
        path = pathlib.Path(folder) / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        browser.save_screenshot(str(path))


def mouse(browser, *places, drag=False):
    """Press at the first place (pixels of the canvas from its middle), release at the last."""
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.by import By

    canvas = max(browser.find_elements(By.TAG_NAME, "canvas"), key=lambda c: c.size["width"])
    chain = ActionChains(browser, duration=60)
    chain.move_to_element_with_offset(canvas, *places[0])
    if not drag:
        chain.click()
    else:
        chain.click_and_hold()
        for place in places[1:]:
            chain.move_to_element_with_offset(canvas, *place).pause(0.05)
        chain.release()
    chain.perform()


def test_the_page_loads_with_all_controls(page, browser):
    shown = text(browser)
    for word in (
        "Lens",
        "Aperture",
        "Shutter",
        "Sensor",
        "Presets",
        "Camera path",
        "Final picture",
        "field of view",
        "radius",
    ):
        assert word in shown
    assert "Gaussians hit per ray" in shown and "ms" in shown
    screenshot(browser, "dark")


def test_dragging_orbits(page, browser):
    before = page.viewpoint
    mouse(browser, (0, 0), (60, 10), (120, 20), drag=True)
    until(lambda: page.viewpoint.position != before.position)
    way = sum((a - b) ** 2 for a, b in zip(page.viewpoint.position, before.position, strict=True))
    assert way > 1e-3
    until(lambda: page.session.pictures)


def test_the_time_slider_moves_time(page, browser):
    from selenium.webdriver.common.by import By
    from selenium.webdriver.common.keys import Keys

    slider = browser.find_elements(By.CSS_SELECTOR, "[role=slider]")[0]
    before = page.time
    slider.send_keys(Keys.ARROW_RIGHT * 20)
    until(lambda: page.time > before)
    until(lambda: page.session.pictures)


def test_a_click_focuses(page, browser):
    page.handles["aperture"].value = "wide"
    until(lambda: page.values["aperture.radius"] > 0)
    page.values["aperture.focus_distance"] = before = 0.123
    mouse(browser, (0, 0))
    until(lambda: page.values["aperture.focus_distance"] != before)
    assert 0.5 < page.values["aperture.focus_distance"] < 10
    until(lambda: page.session.pictures)
    screenshot(browser, "focus")


def test_pictures_beside_each_other_and_light_colours(page, browser):
    page.handles["lens"].value = "fisheye"
    page.handles["layout"].value = "side by side"
    until(lambda: set(page.session.pictures) == {"pinhole", "camera"})
    screenshot(browser, "side_by_side")
    page.handles["dark"].value = False
    page.handles["layout"].value = "split"
    until(lambda: set(page.session.pictures) == {"pinhole", "camera"})
    screenshot(browser, "light")
    page.handles["layout"].value = "camera"


def test_a_saved_camera_can_be_rendered(page, browser, run):
    from selenium.webdriver.common.by import By

    until(lambda: set(page.session.pictures) == {"camera"})
    for label in browser.find_elements(By.XPATH, "//*[text()='Presets']"):
        label.click()
    clock.sleep(1)
    browser.find_element(By.XPATH, "//*[text()='Save this camera']").click()
    file = run / "presets" / "mine" / "preset.yaml"
    until(file.is_file)
    until(lambda: "gaussray render" in text(browser))
    screenshot(browser, "preset")
    main(["render", f"preset={file}", f"out={run}/film", "quiet=true"])
    assert list((run / "film").rglob("view/*.png"))
