# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Makes ``docs/images/error_model.svg`` with the package itself.

    PYTHONPATH=. python -m performance.error_model DATA --injections 0 --output SCORES.json
    PYTHONPATH=. python docs/make_error_model_picture.py DATA SCORES.json

Left, how innovations of MH_04's pl_vio go together under each process; in the middle, the scores
of the simulations beside a Gaussian; right, what the likelihood of freiburg1_xyz's rgbdslam says of
the clock offset, as it is and with 20 ms put in.
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes as Panel

from performance.error_model import estimate, ground_truth
from trajeval_ros.error_model.fit import fit
from trajeval_ros.error_model.likelihood import Likelihood
from trajeval_ros.error_model.nuisances import Nuisances, Truth, prepare
from trajeval_ros.error_model.process import GROUPS, Kind
from trajeval_ros.error_model.search import Guess, search

Array = npt.NDArray[np.float64]

IMAGE = Path(__file__).parent / "images" / "error_model.svg"
COLOURS = {Kind.DRIFT: "#d1495b", Kind.VELOCITY: "#1f5fa8", Kind.WANDER: "#8a8a8a"}
LAGS = 20
OFFSETS = np.arange(-21e-3, -11.5e-3, 0.5e-3)
PUT_IN = 0.02


def whiteness(panel: Panel, data: Path) -> None:
    """Autocorrelations of the whitened innovations of translations."""
    folder = data / "euroc_mh04"
    ask = ground_truth(folder / "groundtruth.txt").truth
    stamps, poses = estimate(folder / "pl_vio.txt")
    found = fit(stamps, poses, ask)
    assert found is not None
    values, gauge = prepare(*asked(stamps, poses, ask, found.nuisances), found.nuisances)
    begin: Guess | None = None
    for kind in (Kind.DRIFT, Kind.VELOCITY, Kind.WANDER):
        guess = search(kind, values, gauge, 0.05, begin)
        begin = begin or guess
        weighted = replace(values, measured=guess.measured, moved=guess.moved)
        white = Likelihood(kind, guess.parameters, weighted, gauge).innovations()[:, :3]
        total = float((white**2).sum())
        found_lags = [float((white[k:] * white[:-k]).sum()) / total for k in range(1, LAGS + 1)]
        panel.plot(range(1, LAGS + 1), found_lags, ".-", color=COLOURS[kind], label=str(kind))
    panel.axhspan(-0.1, 0.1, color="#1f5fa8", alpha=0.12, lw=0)
    panel.set_xticks(range(0, LAGS + 1, 5))
    panel.set(xlabel="lag, poses", title="Autocorrelation of innovations")
    panel.legend(frameon=False)


def asked(
    stamps: npt.NDArray[np.int64], poses: Array, ask: object, nuisances: Nuisances
) -> tuple[npt.NDArray[np.int64], Array, Truth]:
    """Where the ground truth answers at what the nuisances make of the stamps."""
    truth = ask(nuisances.stamps(stamps))  # type: ignore[operator]
    good = truth.valid
    kept = Truth(truth.poses[good], truth.covariances[good], truth.twists[good], good[good])
    return stamps[good], poses[good], kept


def scores(panel: Panel, path: Path) -> None:
    """All that have a standard deviation, beside a Gaussian's."""
    known = json.loads(path.read_text())
    of_parameters = [name for name in known if name.split()[0] in GROUPS]
    bins = np.linspace(-4.0, 4.0, 33)
    for names, colour, label in (
        ([name for name in known if name not in of_parameters], "#1f5fa8", "nuisances"),
        (of_parameters, "#d1495b", "parameters"),
    ):
        off = [score for name in names for score, _ in known[name] if score is not None]
        panel.hist(off, bins, density=True, histtype="step", color=colour, label=label)
    x = np.linspace(-4.0, 4.0, 81)
    panel.plot(x, np.exp(-0.5 * x * x) / np.sqrt(2.0 * np.pi), "k:", lw=1, label="Gaussian")
    panel.set(xlabel="error over standard deviation", title="Scores of simulations", yticks=[])
    panel.legend(frameon=False)


def clock(panel: Panel, data: Path) -> None:
    """The likelihood at each offset, all other nuisances integrated out."""
    folder = data / "tum_fr1_xyz"
    ask = ground_truth(folder / "groundtruth.txt").truth
    stamps, poses = estimate(folder / "rgbdslam.txt")
    for shift, colour in ((0.0, "#1f5fa8"), (PUT_IN, "#d1495b")):
        shifted = stamps - round(shift * 1e9)
        found = fit(shifted, poses, ask)
        assert found is not None
        parameters = np.log(
            [[found.groups[g][name].value for name in found.kind.names] for g in GROUPS]
        )
        values = []
        for offset in OFFSETS + shift:
            there = replace(found.nuisances, clock_offset=float(offset))
            known, gauge = prepare(*asked(shifted, poses, ask, there), there)
            rest = replace(
                known, nuisances=known.nuisances[:, :, 1:], precision=known.precision[1:]
            )
            values.append(Likelihood(found.kind, parameters, rest, gauge).value)
        offset, std = 1e3 * found.nuisances.clock_offset, 1e3 * found.std[0]
        label = f"{'as it is' if shift == 0.0 else '20 ms put in'}: {offset:.1f} ± {std:.1f} ms"
        panel.plot(1e3 * (OFFSETS + shift), np.array(values) - max(values), ".-", color=colour)
        panel.axvspan(offset - std, offset + std, color=colour, alpha=0.3, lw=0, label=label)
    panel.set(xlabel="clock offset, ms", title="Log-likelihood, nats")
    panel.set(xlim=(-25.0, 15.0), ylim=(-60.0, 20.0))
    panel.legend(frameon=False, loc="upper left")


def main() -> None:
    """Draw the three."""
    data, path = map(Path, sys.argv[1:3])
    plt.rcParams.update({"font.size": 8, "svg.fonttype": "none", "svg.hashsalt": "error_model"})
    figure, panels = plt.subplots(1, 3, figsize=(10.0, 2.9), layout="constrained")
    whiteness(panels[0], data)
    scores(panels[1], path)
    clock(panels[2], data)
    for panel in panels:
        panel.spines[["top", "right"]].set_visible(False)
    figure.savefig(IMAGE, metadata={"Date": None})
    if len(sys.argv) > 3:
        figure.savefig(sys.argv[3], dpi=110)


if __name__ == "__main__":
    main()
