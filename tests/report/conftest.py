"""RUN folders to report on, a right one and a wrong one, and a browser that opens what was written."""

import os
import shutil
from dataclasses import dataclass, replace

import numpy as np
import pytest

from mapmend.config import Config
from mapmend.grid.occupancy import occupancy_map
from mapmend.run_folder import write_run
from mapmend.slam import MapResult
from mapmend.trajectory import Trajectory
from tests.consistency.scenes import graph_of, room_graph

NODES = 80
CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip
WINDOW = (1280, 860)


def room_run(folder, shift_m=0.0, log="room.clf"):
    """A RUN of a robot in a room; from its middle on everything lies ``shift_m`` off, and its loop edge says so too."""
    graph = room_graph(NODES)
    poses = graph.poses.copy()
    poses[NODES // 2 :, 0] += shift_m
    graph = replace(graph_of(poses, graph.scans, [(0, NODES - 1), (10, 60)]), stamps_s=100.0 + 0.5 * np.arange(NODES))
    graph.measurements[-1, 0] += 0.05  # one loop edge is strained: chi2 = 25
    config = Config()
    result = MapResult(
        method="go",
        config=config,
        trajectory=Trajectory(graph.stamps_s, graph.poses),
        graph=graph,
        occupancy=occupancy_map(graph.scans, graph.poses, config.scan, config.grid),
        key_nodes=np.array([0, 20, 40, 60]),
        counts={"scans": NODES, "nodes": NODES, "key_nodes": 4, "odometry_edges": NODES - 1, "loop_edges": 2},
        chi2_initial=30.0,
        chi2_final=25.0,
        seconds={"match": 1.25, "map": 0.5},
    )
    write_run(result, folder, source=log)
    return folder, graph


@pytest.fixture(scope="session")
def runs(tmp_path_factory):
    """``right`` and ``wrong``: folders with their graphs."""
    place = tmp_path_factory.mktemp("runs")
    return {"right": room_run(place / "right"), "wrong": room_run(place / "wrong", 0.4)}


@dataclass
class Page:
    """A report in the browser."""

    driver: object

    def open(self, path):
        from selenium.webdriver.support.ui import WebDriverWait

        self.driver.get(path.resolve().as_uri())
        WebDriverWait(self.driver, 10, 0.02).until(lambda d: self.js("return document.documentElement.dataset.ready"))
        return self

    def js(self, text, *arguments):
        return self.driver.execute_script(text, *arguments)

    def all(self, selector):
        from selenium.webdriver.common.by import By

        return self.driver.find_elements(By.CSS_SELECTOR, selector)

    def one(self, selector):
        return self.all(selector)[0]

    def settled(self):
        """After the next frame, for drawing waits for it."""
        self.driver.execute_async_script("requestAnimationFrame(() => requestAnimationFrame(arguments[0]))")

    def camera(self, number=0):
        """x, y in metres and pixels a metre."""
        self.settled()
        text = self.js("return document.querySelectorAll('canvas')[arguments[0]].dataset.camera", number)
        return np.array([float(word) for word in text.split()])

    def glided(self, number=0):
        """The camera once it has come to rest."""
        last = self.camera(number)
        for _ in range(100):
            now = self.camera(number)
            if np.array_equal(now, last) and self.js("return performance.now()") > self.rests_after:
                return now
            last = now
        raise AssertionError("the camera does not come to rest")

    @property
    def rests_after(self):
        return self.js("return (window.__rest ||= performance.now() + 600)")

    def count(self, colour, number=0):
        """How many pixels of a canvas have just this colour, red, green, blue."""
        self.settled()
        return self.js(
            "const c = document.querySelectorAll('canvas')[arguments[0]];"
            "const p = c.getContext('2d').getImageData(0, 0, c.width, c.height).data; let n = 0;"
            "for (let k = 0; k < p.length; k += 4)"
            " if (p[k] === arguments[1] && p[k + 1] === arguments[2] && p[k + 2] === arguments[3]) n += 1; return n",
            number,
            *colour,
        )

    def mouse(self):
        from selenium.webdriver.common.action_chains import ActionChains

        return ActionChains(self.driver, duration=20)

    def complaints(self):
        """Errors of the program, and what the policy kept from running or being fetched."""
        return [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] == "SEVERE"]


@pytest.fixture(scope="session")
def browser(tmp_path_factory):
    """Headless Chromium; skips, and says what is not there."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
    if not (CHROMIUM and DRIVER):
        pytest.skip("no chromium and chromedriver on this machine")
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('chromium')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    os.environ["SE_OFFLINE"] = "true"  # with the driver's path it looks for none; this makes sure
    driver = webdriver.Chrome(options=options, service=Service(DRIVER))
    metrics = {"width": WINDOW[0], "height": WINDOW[1], "deviceScaleFactor": 1, "mobile": False}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    yield Page(driver)
    driver.quit()
