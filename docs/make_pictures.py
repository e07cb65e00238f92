# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Makes the pictures in ``docs/images`` with the package itself.

    PYTHONPATH=. .venv/bin/python docs/make_pictures.py gap GROUND_TRUTH ESTIMATE
    PYTHONPATH=. .venv/bin/python docs/make_pictures.py report REPORT.html report

``gap`` wants TUM's freiburg2_desk, which has a gap of 12 s in its ground truth. ``report`` takes a
picture of a report with chromium, from its maps on: report of KITTI 00's ORB-SLAM, report_gap of
freiburg2_desk's (``--dark``), report_compared of both of MH_04. The other pictures are made by
``docs/make_joint_picture.py`` and ``performance/calibration.py``.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from PIL import Image

from trajeval_ros.files.tum import read_tum
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import feed

Array = npt.NDArray[np.float64]

IMAGES = Path(__file__).parent / "images"
TRUTH, ESTIMATE, SAMPLES = "#1f5fa8", "#d1495b", "#5b6770"


@dataclass(frozen=True)
class Evaluated:
    """Poses of a run: seconds (M,), aligned estimate and ground truth (M, 4, 4), its std (M, 2)."""

    seconds: Array
    sampled: Array
    estimate: Array
    ground_truth: Array
    covariance: Array


def evaluated(ground_truth: str, estimate: str, **parameters: object) -> Evaluated:
    """Evaluate two TUM files."""
    truth, guess = read_tum(ground_truth), read_tum(estimate)
    engine = Engine(parameters)
    parts = list(feed(engine, truth.samples, guess.samples))
    alignment = parts[-1].alignment
    assert alignment is not None
    found = [part.evaluations for part in parts if len(part.evaluations)]
    stamps = np.concatenate([part.stamps for part in found])
    start = truth.stamps[0]
    return Evaluated(
        (stamps - start) * 1e-9,
        (truth.stamps - start) * 1e-9,
        alignment.apply(np.concatenate([part.estimate for part in found])),
        np.concatenate([part.ground_truth for part in found]),
        np.concatenate([part.covariance for part in found]),
    )


def deviations(covariance: Array) -> tuple[Array, Array]:
    """Standard deviations of translation (m) and rotation (rad), root mean square of the axes."""
    variance = np.einsum("mii->mi", covariance)
    return np.sqrt(variance[:, :3].mean(axis=1)), np.sqrt(variance[:, 3:].mean(axis=1))


def gap(run: Evaluated) -> None:
    """The ground truth's uncertainty across its longest gap, and the estimate within it."""
    longest = int(np.argmax(np.diff(run.sampled)))
    begin, end = run.sampled[longest], run.sampled[longest + 1]
    shown = (run.seconds > begin - 6.0) & (run.seconds < end + 6.0)
    seconds, covariance = run.seconds[shown], run.covariance[shown]
    rotation = run.ground_truth[shown][:, :3, :3]
    spread = rotation @ covariance[:, :3, :3] @ np.swapaxes(rotation, -1, -2)
    position, axis = run.ground_truth[shown][:, :3, 3], 0
    sigma = np.sqrt(spread[:, axis, axis])

    figure, (above, below) = plt.subplots(
        2, 1, figsize=(8.0, 5.0), sharex=True, height_ratios=(3, 2), layout="constrained"
    )
    above.fill_between(
        seconds,
        position[:, axis] - 2 * sigma,
        position[:, axis] + 2 * sigma,
        color=TRUTH,
        alpha=0.25,
        linewidth=0,
        label="its two standard deviations",
    )
    above.plot(seconds, position[:, axis], color=TRUTH, label="ground truth, mean")
    above.plot(
        seconds,
        run.estimate[shown][:, axis, 3],
        color=ESTIMATE,
        linewidth=1.2,
        label="estimate, aligned",
    )
    near = (run.sampled > begin - 6.0) & (run.sampled < end + 6.0)
    low, high = above.get_ylim()
    above.plot(
        run.sampled[near],
        np.full(near.sum(), low),
        "|",
        color=SAMPLES,
        markersize=7,
        label="ground-truth samples",
    )
    above.set_ylim(low - 0.03 * (high - low), high)
    above.set_ylabel("x (m)")
    above.legend(frameon=False, fontsize=9, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    translation, angle = deviations(covariance)
    below.semilogy(seconds, translation * 1e3, color=TRUTH, label="position (mm)")
    below.semilogy(seconds, np.degrees(angle), color=ESTIMATE, label="rotation (deg)")
    below.set_ylabel("standard deviation")
    below.set_xlabel("time (s)")
    below.legend(frameon=False, fontsize=9)
    _save(figure, (above, below), "gap.png")


def _save(figure: Any, axes: tuple[Any, ...], name: str) -> None:
    for axis in axes:
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(alpha=0.25)
    IMAGES.mkdir(exist_ok=True)
    figure.savefig(IMAGES / name, dpi=120)
    plt.close(figure)


def report(page: str, name: str, share: float, dark: bool) -> None:
    """A report from its maps on, as a browser shows it, looking at a moment of the run."""
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        shot = Path(folder) / "report.png"
        program = shutil.which("chromium")
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        tab = browser.new_page(
            viewport={"width": 1100, "height": 1090},
            color_scheme="dark" if dark else "light",
        )
        tab.goto(Path(page).absolute().as_uri())
        tab.evaluate(
            f"board.setCursor(board.whole[0] + {share} * (board.whole[1] - board.whole[0]));"
            "document.getElementById('controls').scrollIntoView()"
        )
        # The maps are drawn with the next frames.
        tab.evaluate("new Promise((done) => setTimeout(done, 300))")
        tab.screenshot(path=shot)
        browser.close()
        # The quantised picture is a third as large, and looks the same.
        with Image.open(shot) as image:
            image.convert("RGB").quantize(255).save(IMAGES / f"{name}.png", optimize=True)


def main() -> None:
    """Make one picture."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    pictures = parser.add_subparsers(dest="picture", required=True)
    of_gap = pictures.add_parser("gap")
    of_gap.add_argument("ground_truth")
    of_gap.add_argument("estimate")
    of_report = pictures.add_parser("report")
    of_report.add_argument("page")
    of_report.add_argument("name")
    of_report.add_argument("--share", type=float, default=0.62, help="of the run, looked at")
    of_report.add_argument("--dark", action="store_true")
    arguments = parser.parse_args()
    match arguments.picture:
        case "gap":
            parameters = {"ground_truth.max_gap": 20.0}
            gap(evaluated(arguments.ground_truth, arguments.estimate, **parameters))
        case "report":
            report(arguments.page, arguments.name, arguments.share, arguments.dark)


if __name__ == "__main__":
    main()
