# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The figures in a browser, of two estimates that are made up."""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from chromium import chromium, opened

from trajeval_ros import charts

SECONDS = np.arange(0.0, 100.0, 0.1)
TRUTH = np.stack(
    [10.0 * np.cos(SECONDS / 8.0), 6.0 * np.sin(SECONDS / 5.0), 0.5 * np.sin(SECONDS / 3.0)], axis=1
)
ERRORS = {"a": 0.5 + 0.004 * SECONDS, "b": 1.0 - 0.002 * SECONDS}
BREAK = 500

SCRIPT = """
const data = DATA;
const times = charts.floats(data.seconds);
const truth = charts.floats(data.truth);
const names = Object.keys(data.errors);
window.board = new charts.Board({
  start: 0, end: 100, estimates: names.map((name, k) => ({ name, colour: `e${k}` })),
});
const tracks = names.map((name, k) => {
  const error = charts.floats(data.errors[name]);
  const aligned = truth.map((value, place) => value + (place % 3 === 0 ? error[place / 3] : 0));
  return {
    estimate: name, label: name, colour: `e${k}`, times, truth, aligned, error,
    raw: aligned.map((value) => value + 2), largest: 1, breaks: [data.broken],
  };
});
const axes = { across: 0, along: 1, up: 2, sign: 1 };
window.figures = {};
for (const view of ["top", "side", "turn"]) {
  const host = document.getElementById(view);
  figures[view] = new charts.MapView(board, host, {
    title: view, view, height: 300, axes, way: { times, positions: truth }, tracks,
    marks: [{ time: 70, text: "jump", kind: "event" }],
    ellipsoids: [{ time: 0, place: [10, 0, 0], axes: [1, 0, 0, 0, 0.5, 0, 0, 0, 0.2] }],
  });
}
figures.error = new charts.TimeChart(board, document.getElementById("error"), {
  title: "Error", unit: "m", zero: true, log: false, shades: [[50, 55]],
  marks: [{ time: 70, text: "jump" }],
  lines: tracks.map((track) => ({
    label: track.label, estimate: track.label, colour: track.colour, times,
    values: track.error, raw: track.error.map((value) => 5 * value), breaks: track.breaks,
  })),
  bands: [{
    label: "known to", estimate: null, colour: "band", times, low: null,
    high: times.map(() => 0.2), breaks: [],
  }],
});
figures.offset = new charts.TimeChart(board, document.getElementById("offset"), {
  title: "Offset", unit: "ms", levels: [{ value: 0 }],
  lines: [
    {
      label: "offset", estimate: null, colour: "e2", kind: "dots", times: [10, 30], values: [1, 2],
    },
    { label: "rate", estimate: null, colour: "e3", times: [0, 50], values: [1, 3], kind: "step" },
  ],
  whiskers: [{ estimate: null, colour: "e2", times: [10, 30], low: [0, 1], high: [2, 4] }],
});
charts.controls(board, document.getElementById("bar"), {
  raw: true,
  moments: [
    { begin: 50, end: 55, text: "gap of 5 s", kind: "gap" },
    { times: [20, 60], text: "learned", kind: "learned" },
  ],
});
charts.printable(board);
"""


def _page() -> str:
    data = {
        "seconds": charts.numbers(SECONDS),
        "truth": charts.numbers(TRUTH),
        "errors": {name: charts.numbers(errors) for name, errors in ERRORS.items()},
        "broken": BREAK,
    }
    hosts = "".join(
        f"<div id={name}></div>" for name in ("bar", "top", "side", "turn", "error", "offset")
    )
    script = SCRIPT.replace("DATA", json.dumps(data))
    return (
        f"<!doctype html><html lang=en><title>t</title><style>{charts.style()}</style>"
        f"<body>{hosts}<script>{charts.script()}</script><script>{script}</script></body></html>"
    )


@pytest.fixture(scope="module")
def shared_tab() -> Iterator[Any]:
    with (
        chromium() as browser,
        opened(browser, _page(), viewport={"width": 1100, "height": 1600}) as page,
    ):
        yield page


@pytest.fixture
def tab(shared_tab: Any) -> Any:
    """The page as it was opened."""
    shared_tab.mouse.move(1, 1)
    shared_tab.emulate_media(color_scheme="light")
    shared_tab.evaluate(
        "board.hidden.clear(); board.setRaw(false); board.setRange(); board.setCursor(null);"
        "figures.error.log = false; figures.error.rebuild()"
    )
    return shared_tab


def place_of(tab: Any, time: float) -> tuple[float, float]:
    """Where a moment is in the chart of the error."""
    box = tab.locator("#error .over").bounding_box()
    left = tab.evaluate(f"figures.error.u.valToPos({time}, 'x')")
    return box["x"] + left, box["y"] + 0.5 * box["height"]


def painted(tab: Any) -> list[int]:
    """A sum of the pixels of each map."""
    tab.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return tab.evaluate(
        "Object.values(figures).filter((f) => f.base).map((f) => f.base.getContext('2d')"
        ".getImageData(0, 0, f.base.width, f.base.height).data.reduce((sum, v) => sum + v, 0))"
    )


def test_hover_in_a_chart_looks_at_a_moment_everywhere(tab: Any) -> None:
    tab.mouse.move(*place_of(tab, 40.0))
    assert tab.evaluate("board.cursor") == pytest.approx(40.0, abs=0.2)
    text = tab.locator("#error .legend").inner_text()
    assert "0.66 m" in text
    assert "0.92 m" in text
    assert "0.2 m" in text
    assert "2 ms" in tab.locator("#offset .legend").inner_text()
    assert "40.0" in tab.locator("#bar output").inner_text()
    assert tab.evaluate(
        "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done("
        "figures.top.top.getContext('2d').getImageData(0, 0, 900, 300).data.some(Boolean)))))"
    )


def test_hover_on_the_map_looks_at_the_moment_there(tab: Any) -> None:
    painted(tab)
    x, y = tab.evaluate("figures.top.place(figures.top.spec.tracks[1].aligned, 123)")
    box = tab.locator("#top .plot").bounding_box()
    tab.mouse.move(box["x"] + x, box["y"] + y)
    assert tab.evaluate("board.cursor") == pytest.approx(SECONDS[123], abs=0.2)


def test_a_drag_shows_a_stretch_in_all_and_a_double_click_all_of_it(tab: Any) -> None:
    before = painted(tab)
    tab.mouse.move(*place_of(tab, 20.0))
    tab.mouse.down()
    tab.mouse.move(*place_of(tab, 60.0), steps=3)
    tab.mouse.up()
    assert tab.evaluate("board.range") == pytest.approx([20.0, 60.0], abs=0.3)
    assert tab.evaluate("figures.offset.u.scales.x.max") == pytest.approx(60.0, abs=0.3)
    assert all(a != b for a, b in zip(before, painted(tab), strict=True))
    tab.mouse.dblclick(*place_of(tab, 40.0))
    assert tab.evaluate("board.range") == [0, 100]


def test_a_drag_along_the_path_shows_that_stretch(tab: Any) -> None:
    painted(tab)
    box = tab.locator("#top .plot").bounding_box()
    places = tab.evaluate(
        "[50, 150].map((k) => figures.top.place(figures.top.spec.tracks[0].aligned, k))"
    )
    tab.mouse.move(box["x"] + places[0][0], box["y"] + places[0][1])
    tab.mouse.down()
    tab.mouse.move(box["x"] + places[1][0], box["y"] + places[1][1], steps=8)
    tab.mouse.up()
    assert tab.evaluate("board.range") == pytest.approx([5.0, 15.0], abs=0.3)


def test_an_estimate_is_switched_off_and_on(tab: Any) -> None:
    assert tab.evaluate("figures.error.u.series.length") == 3
    before = painted(tab)
    tab.locator("#bar input").first.uncheck()
    assert tab.evaluate("figures.error.u.series.length") == 2
    assert all(a != b for a, b in zip(before, painted(tab), strict=True))
    tab.locator("#bar input").first.check()
    assert painted(tab) == before


def test_raw_shows_what_is_not_aligned(tab: Any) -> None:
    before = painted(tab)
    assert tab.evaluate("figures.error.u.data[1][0]") == pytest.approx(0.5)
    tab.get_by_role("button", name="Poses: raw").click()
    assert tab.evaluate("figures.error.u.data[1][0]") == pytest.approx(2.5)
    assert all(a != b for a, b in zip(before, painted(tab), strict=True))


def test_a_line_is_broken_where_there_is_nothing(tab: Any) -> None:
    assert tab.evaluate(f"figures.error.u.data[1][{BREAK}]") is None
    assert tab.evaluate("figures.error.u.data[1].filter((v) => v === null).length") == 1


def test_a_logarithmic_axis(tab: Any) -> None:
    tab.locator("#error .scale").click()
    assert tab.evaluate("figures.error.u.scales.y.distr") == 3
    assert tab.evaluate("figures.error.u.scales.y.min") > 0.0
    assert tab.locator("#error .scale").get_attribute("aria-pressed") == "true"


def test_the_space_is_turned_by_a_drag_and_by_keys(tab: Any) -> None:
    before = painted(tab)
    box = tab.locator("#turn .plot").bounding_box()
    tab.mouse.move(box["x"] + 300, box["y"] + 100)
    tab.mouse.down()
    tab.mouse.move(box["x"] + 400, box["y"] + 120, steps=3)
    tab.mouse.up()
    after = painted(tab)
    assert before[:2] == after[:2]
    assert before[2] != after[2]
    assert tab.evaluate("board.range") == [0, 100]
    tab.locator("#turn .plot").focus()
    tab.keyboard.press("d")
    assert painted(tab)[2] != after[2]


def test_a_moment_of_note_is_gone_to(tab: Any) -> None:
    tab.get_by_role("button", name="Go to: gap of 5 s").click()
    assert tab.evaluate("board.cursor") == 52.5
    assert tab.evaluate("board.range") == [35, 70]
    tab.get_by_role("button", name="Show all of the run").click()
    assert tab.evaluate("board.range") == [0, 100]


def test_each_click_goes_to_the_next_of_several(tab: Any) -> None:
    button = tab.get_by_role("button", name="Go to: learned")
    for time in (20, 60, 20):
        button.click()
        assert tab.evaluate("board.cursor") == time


def test_a_triangle_is_gone_to_when_it_is_clicked(tab: Any) -> None:
    x, _ = place_of(tab, 70.0)
    top = tab.locator("#error .over").bounding_box()["y"]
    tab.mouse.click(x + 2, top - 4)
    assert tab.evaluate("board.cursor") == 70
    assert tab.evaluate("board.isZoomed")


def test_keys_move_the_moment_and_a_reader_hears_it(tab: Any) -> None:
    plot = tab.locator("#error .plot")
    plot.focus()
    tab.keyboard.press("End")
    assert tab.evaluate("board.cursor") == 100
    tab.keyboard.press("Home")
    tab.keyboard.press("ArrowRight")
    assert tab.evaluate("board.cursor") == pytest.approx(0.5)
    assert "a 0.502 m" in plot.get_attribute("aria-valuetext")
    assert plot.get_attribute("aria-valuenow") == "0.500"
    tab.keyboard.press("+")
    assert tab.evaluate("board.span") == pytest.approx(50.0)
    tab.keyboard.press("Escape")
    assert tab.evaluate("board.span") == 100


def test_dark_is_another_set_of_colours(tab: Any) -> None:
    before = painted(tab)
    tab.emulate_media(color_scheme="dark")
    assert all(a != b for a, b in zip(before, painted(tab), strict=True))
    assert tab.evaluate("board.theme.colour('paper')") == "#14191f"


def test_on_paper_each_figure_is_vectors(tab: Any) -> None:
    tab.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert tab.locator(".printed svg").count() == 5
    drawn = tab.evaluate("figures.error.printed.querySelectorAll('path').length")
    # Two estimates in two pieces each, besides the grid.
    assert drawn >= 4
    tab.evaluate("dispatchEvent(new Event('afterprint'))")
    assert tab.locator(".printed svg").count() == 0
    pdf = tab.pdf()
    assert b"/Subtype /Image" not in pdf


def test_labels_of_marks_that_lie_near_do_not_overlap(tab: Any) -> None:
    names = ["start", "end", "worst, 256 mm", "a jump", "another jump"]
    tab.evaluate(
        "window.before = figures.top.spec.marks; figures.top.update({marks: ["
        + ", ".join(
            f"{{time: {6 + 0.9 * k}, text: '{n}', kind: 'event'}}" for k, n in enumerate(names)
        )
        + "]}); dispatchEvent(new Event('beforeprint'))"
    )
    tab.emulate_media(media="print")
    boxes = tab.evaluate(
        "[...document.querySelectorAll('#top .printed text[style*=paint-order]')].map((text) => {"
        " const { x, y, width, height } = text.getBBox();"
        " return [text.textContent, x, y, x + width, y + height]; })"
    )
    tab.emulate_media(media="screen")
    tab.evaluate("dispatchEvent(new Event('afterprint')); figures.top.update({marks: before})")
    assert sorted(", ".join(box[0] for box in boxes).split(", ")) == sorted(
        ", ".join(names).split(", ")
    )
    assert len(boxes) > 2
    assert all(left < right for _, left, _, right, _ in boxes)
    for k, (_, left, top, right, bottom) in enumerate(boxes):
        for _, *other in boxes[:k]:
            apart = (
                right <= other[0]
                or other[2] <= left
                or bottom <= other[1] + 2
                or other[3] <= top + 2
            )
            assert apart, boxes


def test_other_data_and_a_longer_run_are_shown(tab: Any) -> None:
    tab.evaluate(
        "board.setWhole(0, 200); figures.error.update({lines: [{label: 'c', estimate: null,"
        " colour: 'e0', times: [0, 200], values: [0, 7]}]})"
    )
    assert tab.evaluate("figures.error.u.scales.x.max") == 200
    assert tab.evaluate("figures.error.u.scales.y.max") == pytest.approx(7.56)
