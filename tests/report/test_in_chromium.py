"""The pages in a real browser: nothing runs that should not, nothing is fetched, light, dark and on paper."""

from __future__ import annotations

import base64
import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from one_run import NASTY, one_run
from selenium import webdriver
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By

from hev_can_emu.report.page import write_index, write_page

FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--disable-dev-shm-usage", "--window-size=1200,900",
)  # fmt: skip


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[webdriver.Chrome]:
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    assert chromium, "tests need the Debian package chromium"
    assert driver, "tests need the Debian package chromium-driver"
    options = Options()
    options.binary_location = chromium
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(flag)
    with webdriver.Chrome(options=options, service=Service(driver)) as opened:
        yield opened


@pytest.fixture(scope="module", params=["run", "index"])
def page(
    request: pytest.FixtureRequest,
    browser: webdriver.Chrome,
    tmp_path_factory: pytest.TempPathFactory,
) -> webdriver.Chrome:
    folder = tmp_path_factory.mktemp("pages")
    path = folder / f"{request.param}.html"
    if request.param == "run":
        write_page(path, one_run())
    else:
        write_index(path, NASTY, [(one_run(mass=NASTY), "run.html"), (one_run(), "x.html")])
    browser.get(path.as_uri())
    return browser


def test_nothing_runs_but_the_page_s_own_script(page: webdriver.Chrome) -> None:
    assert page.find_element(By.TAG_NAME, "h1").text == " ".join(NASTY.split())
    assert page.execute_script("return window.hacked === undefined")
    assert page.execute_script("return document.querySelectorAll('img, iframe').length") == 0
    assert [line for line in page.get_log("browser") if line["level"] == "SEVERE"] == []


def test_nothing_is_fetched(page: webdriver.Chrome) -> None:
    asked = [json.loads(line["message"])["message"] for line in page.get_log("performance")]
    wanted = [
        event["params"]["request"]["url"]
        for event in asked
        if event["method"] == "Network.requestWillBeSent"
        and event["params"]["documentURL"] == page.current_url
    ]
    assert page.current_url in wanted
    assert {url for url in wanted if not url.startswith("data:")} == {page.current_url}
    assert page.execute_script("return performance.getEntriesByType('resource').length") == 0


def colours(page: webdriver.Chrome, scheme: str, media: str = "screen") -> tuple[str, str]:
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": media, "features": features})
    found = page.execute_script(
        "const s = getComputedStyle(document.body); return [s.backgroundColor, s.color]"
    )
    page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "", "features": []})
    return tuple(found)


def brightness(colour: str) -> float:
    red, green, blue = (int(part) for part in colour.strip("rgb()").split(",")[:3])
    return (0.299 * red + 0.587 * green + 0.114 * blue) / 255


@pytest.mark.parametrize(
    ("scheme", "media", "light"),
    [("light", "screen", True), ("dark", "screen", False), ("dark", "print", True)],
)
def test_ink_stands_out_from_paper(
    page: webdriver.Chrome, scheme: str, media: str, light: bool
) -> None:
    paper, ink = (brightness(colour) for colour in colours(page, scheme, media))
    assert (paper > 0.9) is light
    assert abs(paper - ink) > 0.7


def test_a_narrow_screen_needs_no_sideways_scrolling(page: webdriver.Chrome) -> None:
    size = {"width": 390, "height": 800, "deviceScaleFactor": 1, "mobile": True}
    page.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    width = page.execute_script("return document.documentElement.scrollWidth")
    page.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    assert width <= 390


def test_it_prints(page: webdriver.Chrome) -> None:
    made = page.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})
    content = base64.b64decode(made["data"])
    assert content.startswith(b"%PDF")
    assert len(content) > 10_000


def test_figures_are_drawn_and_tell_the_time(browser: webdriver.Chrome, tmp_path: Path) -> None:
    path = tmp_path / "run.html"
    write_page(path, one_run())
    browser.get(path.as_uri())
    figures = browser.find_elements(By.TAG_NAME, "svg")
    assert len(figures) == 6  # the overview and five expectations
    for figure in figures:
        box = figure.rect
        assert box["width"] > 600
        assert box["height"] > 40
    curve = browser.execute_script(
        "const p = document.querySelector('path.curve'), b = p.getBBox();"
        "return [b.width, b.height, getComputedStyle(p).stroke]"
    )
    assert curve[0] > 500
    assert curve[1] > 50
    assert curve[2].startswith("rgb")
    assert browser.execute_script(
        "const s = document.querySelector('svg').getBoundingClientRect();"
        "return [...document.querySelectorAll('svg')[0].querySelectorAll('text')]"
        ".every(t => t.getBoundingClientRect().left >= s.left - 1)"
    )
    ActionChains(browser).move_to_element(figures[0]).perform()
    told = browser.find_element(By.CSS_SELECTOR, "text.cursor-time").text
    assert told.endswith(" s")
    assert 0.0 < float(told.split()[0]) < 3.0
