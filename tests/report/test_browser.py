"""The report in headless Chromium: one pans, zooms, switches, hovers, clicks and compares, as a reader does."""

import json

import numpy as np
import pytest

from mapmend.config import Config
from mapmend.consistency.check import check
from mapmend.report.page import report_page
from mapmend.report.run_data import read_checked
from tests.report.conftest import room_run

POINT_RED = (224, 49, 49)
WALL = (33, 37, 41)


@pytest.fixture(scope="module")
def pages(runs, tmp_path_factory):
    place = tmp_path_factory.mktemp("pages")
    read = {name: read_checked(folder, Config()) for name, (folder, _) in runs.items()}
    for name, shown in (("one", ["wrong"]), ("good", ["right"]), ("two", ["wrong", "right"])):
        (place / f"{name}.html").write_text(report_page([read[one] for one in shown]))
    (place / "three.html").write_text(report_page([read["wrong"], read["right"], read["right"]]))
    return place


@pytest.fixture
def one(browser, pages):
    yield browser.open(pages / "one.html")
    assert browser.complaints() == []


def place_of(page, x, y, number=0):
    """Where a place of the map lies on a canvas, pixels from its middle."""
    cx, cy, scale = page.camera(number)
    return round((x - cx) * scale), round((cy - y) * scale)


def test_it_opens_on_the_whole_map_and_asks_for_nothing(one, runs):
    cx, cy, scale = one.camera()
    canvas = one.one("canvas").rect
    x, y = runs["wrong"][1].poses[:, :2].T
    assert np.all(np.abs(x - cx) * scale < canvas["width"] / 2)
    assert np.all(np.abs(y - cy) * scale < canvas["height"] / 2)
    assert one.count(WALL) > 300
    assert (
        one.js("return performance.getEntriesByType('resource').filter(e => !e.name.startsWith('data:')).length") == 0
    )
    assert one.one(".verdict strong").text == "Inconsistent"
    # The first screen holds the map whole, and nothing runs out of the page sideways.
    assert canvas["y"] + canvas["height"] <= one.js("return innerHeight") + 1
    assert one.js("return document.documentElement.scrollWidth <= innerWidth")


def test_dragging_pans_by_as_much(one):
    before = one.camera()
    one.mouse().move_to_element(one.one("canvas")).click_and_hold().move_by_offset(60, -35).release().perform()
    moved = (one.camera() - before)[:2] * before[2]
    np.testing.assert_allclose(moved, (-60.0, -35.0), atol=1.0)


def test_the_wheel_zooms_about_the_pointer(one):
    from selenium.webdriver.common.actions.wheel_input import ScrollOrigin

    cx, cy, scale = one.camera()
    under = cx + 120.0 / scale, cy - 80.0 / scale
    one.mouse().scroll_from_origin(ScrollOrigin.from_element(one.one("canvas"), 120, 80), 0, -400).perform()
    after = one.camera()
    assert after[2] > 1.5 * scale
    np.testing.assert_allclose(after[:2] + np.array((120.0, -80.0)) / after[2], under, atol=0.02)


def test_keys_pan_zoom_step_and_let_go(one, runs):
    one.one("canvas").send_keys("+")
    first = one.camera()
    one.one("canvas").send_keys("\ue014\ue014")  # arrow to the right, twice
    assert one.camera()[0] == pytest.approx(first[0] + 120.0 / first[2], abs=0.01)
    one.one("canvas").send_keys("]]")
    assert one.one("#selected h3").text.startswith(f"Node {runs['wrong'][1].ids[1]}")
    one.one("canvas").send_keys("\ue00c")
    assert not one.all("#selected h3")
    one.one("canvas").send_keys("0")
    assert one.camera()[2] == pytest.approx(first[2] / 1.5, rel=1e-3)


def test_layers_are_switched(one):
    assert one.count(POINT_RED) > 50
    one.one("#layer-points").click()
    one.one("#layer-flagged").click()
    assert one.count(POINT_RED) == 0
    one.one("label[for=layer-points]").click()
    assert one.count(POINT_RED) > 50
    for box in one.all("#layers input:checked"):
        box.click()
    colours = one.js(
        "const c = document.querySelector('canvas'); const p = c.getContext('2d').getImageData(60, 0, c.width - 60,"
        " c.height - 60).data; let n = 0;"
        "for (let k = 0; k < p.length; k += 4) if (Math.abs(p[k] - p[k + 2]) > 40) n += 1; return n"
    )
    assert colours == 0  # the map alone is grey


def test_layers_at_first_follow_the_verdict(browser, pages):
    page = browser.open(pages / "good.html")
    assert page.one(".verdict strong").text == "Consistent"
    assert not page.one("#layer-points").is_selected()
    assert page.one("#layer-trajectory").is_selected()


def test_hovering_tells_the_nodes_and_edges_figures(one, runs):
    graph = runs["wrong"][1]
    result = check(graph)
    row = 20
    one.mouse().move_to_element_with_offset(one.one("canvas"), *place_of(one, *graph.poses[row, :2])).perform()
    tip = one.one("#tip")
    assert tip.is_displayed()
    told = int(np.flatnonzero(graph.ids == int(tip.text.split()[1]))[0])
    assert np.hypot(*(graph.poses[told] - graph.poses[row])[:2]) < 0.2
    x, y, _ = graph.poses[told]
    assert f"x {x:.2f} m, y {y:.2f} m" in tip.text
    assert f"{result.scans.failures[told]} of {result.scans.tested[told]}" in tip.text
    one.mouse().move_to_element_with_offset(one.one("canvas"), 0, -one.one("canvas").rect["height"] // 2 + 5).perform()
    assert not tip.is_displayed()


def test_a_click_selects_and_shows_the_scan(one, runs):
    graph = runs["wrong"][1]
    teal = (11, 114, 133)
    assert one.count(teal) == 0
    one.mouse().move_to_element_with_offset(one.one("canvas"), *place_of(one, *graph.poses[20, :2])).click().perform()
    assert one.one("#selected h3").text.startswith("Node ")
    assert one.count(teal) > 300


def test_a_row_of_the_worst_places_goes_there(one, runs):
    region = check(runs["wrong"][1]).regions[0]
    one.one("#list-regions .go").click()
    assert one.one("#selected h3").text == "Region 1"
    np.testing.assert_allclose(one.glided()[:2], region.place_m, atol=0.01)
    one.one("#tab-strained").click()
    one.one("#list-strained .go").click()
    assert "600" in one.one("#selected h3").text
    assert "chi²\n25" in one.one("#selected dl").text


def test_two_runs_stand_side_by_side(browser, pages):
    page = browser.open(pages / "two.html")
    left, right = page.all("canvas")
    assert left.rect["y"] == right.rect["y"]
    assert left.rect["width"] == pytest.approx(right.rect["width"], abs=1.5)
    assert [badge.text for badge in page.all("figure .badge")] == ["Inconsistent", "Consistent"]
    page.mouse().move_to_element(left).click_and_hold().move_by_offset(40, 0).release().perform()
    np.testing.assert_array_equal(page.camera(0), page.camera(1))
    page.one("#together").click()
    before = page.camera(1)
    page.mouse().move_to_element(left).click_and_hold().move_by_offset(40, 0).release().perform()
    np.testing.assert_array_equal(page.camera(1), before)
    assert page.camera(0)[0] < before[0]
    heads = [cell.text for cell in page.all("#figures th")]
    assert heads == ["", "wrong", "right"]
    page.all("#places .which input")[1].click()
    page.one("#tab-regions").click()
    assert "No scans contradict each other" in page.one("#places").text
    assert page.complaints() == []


def test_of_three_runs_one_chooses_two(browser, pages):
    page = browser.open(pages / "three.html")
    choices = page.all("figure select")
    assert len(choices) == 2
    page.js("arguments[0].selectedIndex = 0; arguments[0].dispatchEvent(new Event('change'))", choices[1])
    assert [badge.text for badge in page.all("figure .badge")] == ["Inconsistent"] * 2


def test_what_igo_and_tune_found_stands_below_and_leads_to_the_map(browser, tmp_path):
    folder, _ = room_run(tmp_path / "run")
    page = json.loads((folder / "run.json").read_text())
    biased = {"nodes": [20, 21], "is_loop": False, "before": [0.2, 0.0, 0.0], "after": [0.5, 0.4, 0.1]}
    page["mended"] = {"chi2": [9.0, 4.0], "rounds": [{"matched": 79, "dropped": 1, "biased": [biased]}]}
    (folder / "run.json").write_text(json.dumps(page))
    off = {"edge": 79, "from": 0, "to": 790, "chi2": 25.0, "weight": 0.01}
    curve = [[0.1, 0.02], [1.0, 0.01], [10.0, 0.03]]
    tuned = {"kernel": "dcs", "phi": 1.0, "measure": 0.01, "p_value": 0.2, "consistent": True, "switched_off": [off]}
    (folder / "tune.json").write_text(json.dumps(tuned | {"curve": curve}))
    (tmp_path / "page.html").write_text(report_page([read_checked(folder, Config())]))
    shown = browser.open(tmp_path / "page.html")
    text = shown.one("#results").text
    assert "chi² before the first round: 9\n" in text
    assert "1 79 1 4" in text
    assert len(shown.all("#results .curve circle")) == 4
    for details in shown.all("#results summary"):
        details.click()
    assert "200 → 210 odometry 1 0.500 5.73" in shown.one("#results").text
    shown.all("#results .go")[1].click()
    assert shown.one("#selected h3").text.startswith("Loop edge 0 → 790")
    assert shown.one("canvas").rect["y"] >= shown.js("return scrollY - 1")
    assert shown.complaints() == []


@pytest.mark.parametrize("phi", [0.0, 1.0])
def test_a_kernel_parameter_of_zero_has_its_place_on_the_curve(browser, tmp_path, phi):
    folder, _ = room_run(tmp_path / "run")
    tuned = {"kernel": "dcs", "phi": phi, "measure": 0.01, "p_value": 0.2, "consistent": True, "switched_off": []}
    curve = [[0.0, 0.01 + 0.02 * phi], [0.1, 0.02], [1.0, 0.03 - 0.02 * phi]]
    (folder / "tune.json").write_text(json.dumps(tuned | {"curve": curve}))
    (tmp_path / "page.html").write_text(report_page([read_checked(folder, Config())]))
    shown = browser.open(tmp_path / "page.html")
    assert len(shown.all("#results .curve circle")) == 4
    drawn = shown.js("return document.querySelector('#results .curve').outerHTML")
    assert "NaN" not in drawn
    assert "Infinity" not in drawn
    assert shown.complaints() == []


def test_names_are_never_markup(browser, tmp_path):
    room_run(tmp_path / "<img src=x onerror=alert(1)>", log="</script><script>document.title='broken'<!--")
    path = tmp_path / "page.html"
    path.write_text(report_page([read_checked(tmp_path / "<img src=x onerror=alert(1)>", Config())]))
    page = browser.open(path)
    assert page.one("h1").text == "<img src=x onerror=alert(1)>"
    assert page.driver.title == "mapmend: <img src=x onerror=alert(1)>"
    assert not page.all("img")
    assert page.complaints() == []
