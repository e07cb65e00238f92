# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page, from a run of the engine."""

import base64
import html.parser
import json
import re
from typing import Any

import numpy as np
import pytest

from trajeval_ros import se3
from trajeval_ros.commands.simulation import simulate
from trajeval_ros.online.accounting import Reason
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import feed
from trajeval_ros.online.parameters import complete
from trajeval_ros.online.results import Evaluations, Notice, Results
from trajeval_ros.online.samples import PoseSamples
from trajeval_ros.report import Report, words
from trajeval_ros.report.page import page_of_several
from trajeval_ros.report.series import make_series, upwards, vertical_axis
from trajeval_ros.runs.session import UNDECODABLE

FIGURES = ["Where", "Error over time", "What kind of error"]
SECTIONS = [
    *FIGURES,
    "The ground truth",
    "Likelihoods",
    "Figures",
    "Every message",
    "Parameters",
    "How to read this",
]
WITHOUT_FIGURES = [title for title in SECTIONS if title not in (*FIGURES, "Likelihoods")]
HOSTS = [
    *("controls", "top", "side", "turn", "translation", "rotation"),
    *("translation-axes", "rotation-axes", "height", "rates"),
    *("likelihood", "likelihood-window", "chi2"),
]


@pytest.fixture(scope="module")
def evaluated() -> tuple[Report, dict[str, Any]]:
    """A simulated run with two dropouts, and its report."""
    run = simulate(30.0, seed=1)
    engine = Engine({})
    report = Report(complete({}), {"ground truth": "/mocap <1>", "estimate": "/odom & more"})
    samples = [
        PoseSamples(poses.stamps, *se3.to_position_quaternion(poses.poses))
        for poses in (run.ground_truth, run.estimate)
    ]
    for results in feed(engine, *samples):
        report.add(results)
    report.add_received(ground_truth=run.ground_truth.stamps, estimate=run.estimate.stamps)
    report.way = engine.way()
    report.notices = (*engine.notices(), Notice("warning", "test", "x < y & z"))
    return report, engine.summary()


@pytest.fixture(scope="module")
def page(evaluated: tuple[Report, dict[str, Any]]) -> str:
    report, summary = evaluated
    return report.render(summary)


class Reader(html.parser.HTMLParser):
    """Checks that every element is closed, and collects what is in the page."""

    EMPTY = frozenset(["meta", "br", "link", "img"])

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.tags: list[str] = []
        self.references: list[str] = []
        self.headings: list[str] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in self.EMPTY:
            self.open.append(tag)
        for name, value in attributes:
            if name == "id":
                self.ids.append(value or "")
            if name in ("src", "href", "xlink:href", "action"):
                self.references.append(value or "")

    def handle_startendtag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attributes)
        if tag not in self.EMPTY:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] in ("script", "style"):
            return
        self.text.append(data)
        if self.open and self.open[-1] == "h2":
            self.headings.append(data)


def read(page: str) -> Reader:
    reader = Reader()
    reader.feed(page)
    reader.close()
    assert reader.open == []
    return reader


def data_of(page: str) -> Any:
    """What the page's script draws."""
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    return json.loads(found[1])


def numbers(text: str) -> Any:
    return np.frombuffer(base64.b64decode(text), "<f4").astype(float)


def test_page_is_whole_and_has_every_section_and_figure(page: str) -> None:
    reader = read(page)
    assert reader.headings == SECTIONS
    assert set(HOSTS) <= set(reader.ids)
    assert len(reader.ids) == len(set(reader.ids))
    assert {"header", "main", "footer"} <= set(reader.tags)


def test_page_needs_nothing_from_elsewhere(page: str) -> None:
    reader = read(page)
    assert "link" not in reader.tags
    assert reader.references == []
    assert "@import" not in page
    # nothing but where the library comes from looks like an address
    addresses = set(re.findall(r"https?://[^\s\"'<]+", page))
    assert addresses == {"https://github.com/leeoniya/uPlot"}


def test_what_users_write_is_text(page: str) -> None:
    text = "".join(read(page).text)
    for expected in ("/mocap <1>", "/odom & more", "x < y & z"):
        assert expected in text


def test_no_text_of_a_user_ends_the_script(evaluated: tuple[Report, dict[str, Any]]) -> None:
    report, summary = evaluated
    run = report.run(summary)
    page = page_of_several({"a</script><b>": run, "b": run}, ["c</script>"], print)
    reader = read(page)
    assert reader.tags.count("script") == 3
    assert "b" not in reader.tags[: reader.tags.index("main")]
    assert [one["name"] for one in data_of(page)["estimates"]] == ["a</script><b>", "b"]


def test_a_name_that_begins_a_sentence_is_as_it_is(
    evaluated: tuple[Report, dict[str, Any]],
) -> None:
    report, summary = evaluated
    run = report.run(summary)
    said = ["vins's ATE is smaller.", "translation ATE no difference to be told."]
    text = "".join(read(page_of_several({"vins": run, "orb": run}, said, print)).text)
    assert "vins's ATE is smaller." in text
    assert "Translation ATE no difference to be told." in text


def test_what_is_drawn_is_the_run(page: str, evaluated: tuple[Report, dict[str, Any]]) -> None:
    report, summary = evaluated
    series = make_series(report.run(summary))
    data = data_of(page)
    (one,) = data["estimates"]
    seconds = numbers(one["times"])
    rows = np.searchsorted(series.seconds, seconds - 1e-4)
    truth, off = (numbers(one[name]).reshape(-1, 3) for name in ("truth", "off"))
    aligned = truth + off
    np.testing.assert_allclose(truth, series.ground_truth[rows], rtol=1e-6, atol=1e-6)
    errors = np.linalg.norm(off, axis=1)
    np.testing.assert_allclose(errors, series.translation_error[rows], rtol=1e-6)
    turned = np.linalg.norm(numbers(one["rotationAxes"]).reshape(-1, 3), axis=1)
    np.testing.assert_allclose(turned, np.degrees(series.rotation_error[rows]), rtol=1e-5)
    assert errors.max() == pytest.approx(series.translation_error.max(), rel=1e-4)
    assert turned.max() == pytest.approx(np.degrees(series.rotation_error).max(), rel=1e-5)
    # Unaligned it is where the estimate itself says.
    alignment = one["alignment"]
    rotation = np.array(alignment["rotation"]).reshape(3, 3)
    raw = (aligned - alignment["translation"]) @ rotation / alignment["scale"]
    poses = report.run(summary).poses
    np.testing.assert_allclose(raw, poses["estimate"][rows, :3, 3], atol=1e-5)
    # A line is broken in the dropout, which is a gap, and one goes there and to the worst moment.
    assert len(one["breaks"]) == len(series.breaks)
    kinds = [moment["kind"] for moment in data["moments"]]
    assert kinds[0] == "worst"
    assert kinds.count("gap") == len(data["gaps"]) >= 1
    worst = data["moments"][0]["begin"]
    assert worst == pytest.approx(series.seconds[series.worst], abs=1e-3)


def broken(*arguments: Any, **named: Any) -> Any:
    raise ZeroDivisionError("a defect")


@pytest.mark.parametrize(
    ("where", "what", "headings"),
    [
        ("trajeval_ros.report.report.likely_causes", "the search for likely causes", SECTIONS),
        ("trajeval_ros.report.page.payload", "the figures", WITHOUT_FIGURES),
        ("trajeval_ros.report.page.shown", "the report", []),
    ],
)
def test_a_defect_costs_itself_alone_and_is_said_once(
    evaluated: tuple[Report, dict[str, Any]],
    monkeypatch: pytest.MonkeyPatch,
    where: str,
    what: str,
    headings: list[str],
) -> None:
    report, summary = evaluated
    monkeypatch.setattr(report, "defects", ())
    monkeypatch.setattr(where, broken)
    for _ in range(2):
        page = report.render(summary)
    (line,) = report.defects
    assert line.startswith(f"{what} failed: ZeroDivisionError: a defect (")
    assert "\n" not in line
    reader = read(page)
    assert reader.headings == headings
    text = " ".join("".join(reader.text).split())
    assert line in text
    assert "chi2" in text or "χ²" in text


def test_page_of_a_run_without_any_evaluated_pose() -> None:
    reader = read(Report(complete({}), {}).render(Engine({}).summary()))
    assert "No estimate has been evaluated." in "".join(reader.text)


def test_what_a_loop_closure_gained_is_told(evaluated: tuple[Report, dict[str, Any]]) -> None:
    report, summary = evaluated
    path: dict[str, Any] = {"scored": 9, "poses": 10, "ate_translation_rmse": 0.1}
    path["online"] = {"ate_translation_rmse": 0.2}
    text = "".join(read(report.render({**summary, "latest_path": path})).text)
    assert "online ATE 0.2 m, after closure 0.1 m (9 of the latest path's 10 poses)" in text


def test_every_reason_has_a_text() -> None:
    reasons = [*map(str, Reason), UNDECODABLE]
    summary: Any = Engine({}).summary()
    for topic in ("estimate", "ground_truth"):
        summary[topic]["rejected"] = dict.fromkeys(reasons, 2)
    rows = words.accounts(Report(complete({}), {}).run(summary))
    texts = {name: text for name, count, text in rows if count == "2"}
    assert list(texts) == [f"{t}, {r}" for t in ("Estimate", "Ground truth") for r in reasons]
    assert all(texts.values())
    assert texts["Estimate, too_late"] == Reason.TOO_LATE.explanation


@pytest.mark.parametrize("evaluated_poses", [1, 2, 3])
def test_page_of_the_very_first_poses(evaluated_poses: int) -> None:
    run = simulate(30.0, seed=1)
    engine = Engine({"gp.hyperparameters": "fixed"})
    report = Report(complete({"gp.hyperparameters": "fixed"}), {})
    for count, poses, add in (
        (100, run.ground_truth, engine.add_ground_truth),
        (evaluated_poses, run.estimate, engine.add_estimate),
    ):
        add(PoseSamples(poses.stamps[:count], *se3.to_position_quaternion(poses.poses[:count])))
    report.add(engine.finish())
    summary = engine.summary()
    assert summary["estimate"]["evaluated"] == evaluated_poses
    page = report.render(summary)
    assert read(page).headings == SECTIONS
    # One alone is aligned to no error, and has none to be told.
    told = evaluated_poses > 1
    assert ("nineteen in twenty" in page) == told
    assert ("furthest off" in page) == told
    assert any(moment["kind"] == "worst" for moment in data_of(page)["moments"]) == told


def test_page_of_a_long_run_is_bounded() -> None:
    count = 200_000
    generator = np.random.default_rng(0)
    seconds = np.arange(count) * 0.05
    xi = np.stack([np.sin(seconds / 7), np.cos(seconds / 11), seconds / 1e4] + 3 * [0 * seconds])
    poses = se3.exp(xi.T)
    error = generator.normal(size=(count, 6)) * 0.01
    report = Report(complete({}), {})
    ones = np.ones(count)
    report.add(
        Results(
            Evaluations(
                (seconds * 1e9).astype(np.int64),
                poses,
                np.broadcast_to(np.eye(6) * 1e-6, (count, 6, 6)),
                se3.compose(poses, se3.exp(error)),
                error,
                error,
                6 * ones,
                -70 * ones,
                -30 * ones,
                -30 * np.cumsum(ones),
                ones > 0,
                np.zeros((count, 6)),
                (seconds * 1e9).astype(np.int64),
            ),
            (),
            -30.0 * count,
            None,
        )
    )
    summary = Engine({}).summary()
    summary["absolute"]["alignment"] = {"pose": [0, 0, 0, 0, 0, 0, 1], "scale": 1.0}
    page = report.render(summary)
    assert report.defects == ()
    assert len(page) < 400_000
    drawn, of = data_of(page)["estimates"][0]["poses"]
    assert 1000 < drawn <= 2000
    assert of == 200_000 or of == 0


def test_series_are_those_of_the_run(evaluated: tuple[Report, dict[str, Any]]) -> None:
    report, summary = evaluated
    run = report.run(summary)
    series = make_series(run)
    assert series.seconds[0] > 0
    assert series.seconds[-1] <= series.end
    # The curve is what ATE is of, but for the poses in the dropouts.
    conventional = summary["conventional"]
    assert series.is_ate
    known = series.translation_band < 0.01
    parts = {"translation": series.translation_error, "rotation": series.rotation_error}
    for part, errors in parts.items():
        rms = float(np.sqrt(np.mean(errors[known] ** 2)))
        assert rms == pytest.approx(conventional[f"ate_{part}_rmse"], rel=0.01)
    np.testing.assert_allclose(
        np.linalg.norm(series.translation_axes, axis=1), series.translation_error
    )
    np.testing.assert_allclose(np.linalg.norm(series.rotation_axes, axis=1), series.rotation_error)
    # the whole run lies within the window at first, so both totals are the same there
    early = series.seconds < 25.0
    np.testing.assert_allclose(
        series.window_relative[early], series.relative_log_likelihood[early], rtol=1e-12
    )
    assert np.all(series.window_dof[early] == 6 * np.arange(1, early.sum() + 1))
    # nothing is scored in the middle of the longer dropout, 21 s to 25 s
    assert not np.any((series.seconds > 22.1) & (series.seconds < 23.9))
    assert len(series.breaks) >= 1


def test_no_two_figures_of_the_page_have_one_name(page: str) -> None:
    names = re.findall(r'<tr><th scope="row">([^<]*)</th><td class=n>', page)
    assert sorted(set(names)) == sorted(names)
    # What is in metres has these names to itself.
    text = "".join(read(page).text)
    assert not re.search(r"\bAE\b", text)
    assert not re.search(
        r"\bRE\b(?!,? \(?over 1 s|, translation,|, rotation,|, conventional)", text
    )


def cut_short(gauge: str = "se3") -> tuple[Report, dict[str, Any]]:
    """A run whose estimate dies after a third."""
    run = simulate(30.0, seed=2)
    engine = Engine({"gauge": gauge})
    report = Report(complete({"gauge": gauge}), {"estimate": "dead.txt"})
    truth, estimate = (
        PoseSamples(poses.stamps, *se3.to_position_quaternion(poses.poses))
        for poses in (run.ground_truth, run.estimate)
    )
    third = len(estimate) // 3
    estimate = PoseSamples(
        estimate.stamps[:third], estimate.positions[:third], estimate.quaternions[:third]
    )
    for results in feed(engine, truth, estimate):
        report.add(results)
    report.add_received(ground_truth=truth.stamps, estimate=estimate.stamps)
    report.way = engine.way()
    return report, engine.summary()


def test_an_estimate_that_dies_is_said_to_and_all_of_the_ground_truth_is_drawn() -> None:
    report, summary = cut_short()
    page = report.render(summary)
    assert "<title>dead.txt: trajectory evaluation</title>" in page
    text = "".join(read(page).text)
    assert re.search(r"The estimate covers 3\d\.?\d? % of 30 s: it was lost for the last", text)
    run = report.run(summary)
    assert run.way is not None
    series = make_series(run)
    gone = run.way.stamps[-1] / 1e9 - series.start / 1e9
    assert gone > series.seconds[-1] + 15.0
    lost = next(m for m in data_of(page)["moments"] if m["kind"] == "lost")
    assert lost["begin"] == pytest.approx(series.seconds[-1], abs=0.1)
    assert lost["end"] == pytest.approx(gone, abs=0.1)
    drawn = numbers(data_of(page)["way"]["times"])
    assert drawn[-1] == pytest.approx(gone, abs=1e-3)


def test_under_sim3_the_scale_is_a_headline_and_the_relative_likelihood_is_not() -> None:
    report, summary = cut_short("sim3")
    tiles = {name: value for name, value, _ in words.tiles(report.run(summary), None)}
    assert "Relative log-likelihood" not in tiles
    scale = summary["conventional"]["alignment"]["scale"]
    assert tiles["Scale correction"] == f"{scale:.5g}"
    said = words.verdict(report.run(summary), make_series(report.run(summary)))
    assert "From one estimate to the next" not in said
    names = [name for name, _, _ in words.figures(report.run(summary))]
    assert not any(name.startswith("Relative") for name in names)


def test_a_camera_has_up_where_its_y_is_least() -> None:
    assert [upwards(axis) for axis in (0, 1, 2)] == [1.0, -1.0, 1.0]


def test_vertical_axis() -> None:
    generator = np.random.default_rng(0)
    drone = generator.normal(size=(100, 3)) * [3, 3, 1]
    car_in_camera_axes = generator.normal(size=(100, 3)) * [300, 5, 300]
    planar = generator.normal(size=(100, 3)) * [10, 10, 0]
    assert [vertical_axis(p) for p in (drone, car_in_camera_axes, planar)] == [2, 1, 2]
