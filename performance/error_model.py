# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether the error model's standard deviations hold: ``python -m performance.error_model``.

Estimates are drawn on the posteriors of real ground truths, with known parameters and nuisances,
and fitted; and known nuisances are put into real estimates, whose fit must change by just them.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.error_model.at_samples import fit_independent
from trajeval_ros.error_model.changes import Stretch, clock_changes
from trajeval_ros.error_model.fit import fit
from trajeval_ros.error_model.model import ErrorModel
from trajeval_ros.error_model.named import named
from trajeval_ros.error_model.nuisances import NAMES, Ask, Nuisances
from trajeval_ros.error_model.process import GROUPS, Kind, steps
from trajeval_ros.error_model.recorded import Recorded
from trajeval_ros.files.tum import read_tum
from trajeval_ros.online.engine import Engine
from trajeval_ros.report import answers

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

SECOND = 1_000_000_000
# In variance: what is known so much worse than usual lies in a gap.
_GAP = 25.0
# 95 % of a Gaussian's.
_LIMIT = 1.96
# Beyond so many standard deviations a nuisance is named.
_NAMED = 4.5
PAIRS = (
    ("tum_fr1_xyz", "rgbdslam"),
    ("tum_fr2_desk", "orb"),
    ("euroc_v102", "estimate"),
    ("euroc_mh04", "pl_vio"),
    ("euroc_mh04", "vins_mono"),
    ("kitti_00", "orb"),
    ("kitti_00", "sptam"),
)


def ground_truth(path: Path) -> Engine:
    """An engine that holds all of a ground truth."""
    engine = Engine({}, whole=True)
    engine.add_ground_truth(read_tum(path).samples)
    engine.finish()
    return engine


def estimate(path: Path) -> tuple[Stamps, Array]:
    """Stamps, increasing, and poses."""
    trajectory = read_tum(path)
    later = np.concatenate([[True], np.diff(trajectory.stamps) > 0])
    poses = se3.from_position_quaternion(trajectory.positions, trajectory.quaternions)
    return trajectory.stamps[later], poses[later]


def drawn(
    rng: np.random.Generator, kind: Kind, parameters: Array, times: Array, position: Array
) -> Array:
    """Errors of a process and of jitter, in the world's axes; (N, 6).

    Where the process is free, its rotations are composed, and turn each step that follows as a
    rotation does: to first order, a heading that is off by 0.2 rad would lengthen all steps by 2 %.
    """
    groups = [steps(kind, each, np.diff(times)) for each in parameters]
    k = kind.components
    state = np.zeros((k, 2, 3))
    for g, group in enumerate(groups):
        if group.prior[-1, -1] > 0.0:
            state[-1, g] = rng.normal(size=3) / np.sqrt(group.prior[-1, -1])
    turned = se3.exp_so3(state[0, 1])
    found = np.zeros((len(times), 6))
    found[0] = state[0].ravel()
    for i in range(len(times) - 1):
        old = state.copy()
        for g, group in enumerate(groups):
            root = np.linalg.cholesky(group.noise[i])
            state[:, g] = group.transition[i] @ old[:, g] + root @ rng.normal(size=(k, 3))
        if kind is not Kind.WANDER:
            step = position[i + 1] - position[i]
            state[0, 0] += turned @ step - step
            turned = turned @ se3.exp_so3(state[0, 1] - old[0, 1])
            found[i + 1] = np.concatenate([state[0, 0], se3.log_so3(turned)])
        else:
            found[i + 1] = state[0].ravel()
    return found + rng.normal(size=found.shape) * np.repeat(np.exp(parameters[:, 0]), 3)


def erring(truth: Array, error: Array) -> Array:
    """Poses (N, 4, 4) with errors (N, 6) in the world's axes."""
    poses = truth.copy()
    poses[:, :3, :3] = se3.exp_so3(error[:, 3:]) @ truth[:, :3, :3]
    poses[:, :3, 3] += error[:, :3]
    return poses


def simulated(
    rng: np.random.Generator, engine: Engine, span: tuple[int, int]
) -> tuple[Stamps, Array, Kind, Array, Nuisances]:
    """An estimate, and what it was drawn with."""
    rate = rng.choice([5.0, 10.0, 20.0, 50.0])
    count = int(rng.integers(300, 700))
    duration = min(count / rate, (span[1] - span[0]) * 1e-9 - 4.0)
    start = span[0] + 2 * SECOND
    start += int(rng.uniform(0.0, 1.0) * ((span[1] - start) - duration * SECOND - 2 * SECOND))
    stamps = start + np.rint(np.arange(int(duration * rate)) / rate * SECOND).astype(np.int64)
    kind = list(Kind)[rng.integers(3)]
    parameters = random_parameters(rng, kind)
    nuisances = random_nuisances(rng)
    known = engine.truth(nuisances.stamps(stamps))
    # As evaluated runs are fitted, without the gaps of the ground truth.
    spread = np.einsum("nii->ni", known.covariances)
    sampled = known.valid & (spread < _GAP * np.median(spread[known.valid], axis=0)).all(axis=1)
    stamps, poses, covariances = stamps[sampled], known.poses[sampled], known.covariances[sampled]
    noise = np.linalg.cholesky(covariances) @ rng.normal(size=(len(stamps), 6, 1))
    poses = with_errors(rng, kind, parameters, nuisances, stamps, poses @ se3.exp(noise[..., 0]))
    return stamps, poses, kind, parameters, nuisances


def random_parameters(rng: np.random.Generator, kind: Kind) -> Array:
    """Of translation and rotation, (2, p)."""
    jitter = np.exp(rng.uniform(np.log(5e-4), np.log(5e-3), 2)) * [1.0, 0.5]
    drift = np.exp(rng.uniform(np.log(5e-3), np.log(5e-2), 2)) * [1.0, 0.2]
    time = rng.uniform(0.4, 1.5, 2)
    rows = {
        Kind.DRIFT: [jitter, drift],
        Kind.VELOCITY: [jitter, 0.3 * drift, drift / np.sqrt(time), time],
        Kind.WANDER: [jitter, drift * np.sqrt(time), time],
    }[kind]
    return np.asarray(np.log(np.array(rows).T))


def random_nuisances(rng: np.random.Generator) -> Nuisances:
    """As estimates may have."""
    return Nuisances(
        rng.uniform(-0.05, 0.05),
        rng.uniform(-2e-4, 2e-4),
        se3.exp(rng.uniform(-0.1, 0.1, 6)),
        float(np.exp(rng.uniform(-0.03, 0.03))),
    )


def with_errors(
    rng: np.random.Generator,
    kind: Kind,
    parameters: Array,
    nuisances: Nuisances,
    stamps: Stamps,
    poses: Array,
) -> Array:
    """The estimate (N, 4, 4) of the ``poses`` that a process and nuisances make."""
    error = drawn(rng, kind, parameters, stamps * 1e-9, poses[:, :3, 3])
    poses = se3.compose(erring(poses, error), nuisances.extrinsic)
    poses[:, :3, 3] /= nuisances.scale
    return poses


@dataclass(frozen=True, slots=True)
class Score:
    """What a fit says of one figure.

    off: by how many standard deviations it is off, None where it has an interval alone; covered:
    whether the truth is within the interval, or within 1.96 of them.
    """

    name: str
    off: float | None
    covered: bool


def scores(
    found: ErrorModel, kind: Kind, parameters: Array, nuisances: Nuisances
) -> Iterator[Score]:
    """Of the nuisances; and of the parameters' logarithms, where the process is right."""
    off = found.nuisances.vector - nuisances.vector
    off[2:8] = se3.log(found.nuisances.extrinsic @ se3.inverse(nuisances.extrinsic))
    for name, score in zip(NAMES, (off / found.std).tolist(), strict=True):
        yield Score(name, score, abs(score) < _LIMIT)
    if found.kind is not kind:
        return
    for group, values in zip(GROUPS, np.exp(parameters), strict=True):
        for name, value in zip(kind.names, values.tolist(), strict=True):
            figure = found.groups[group][name]
            if figure.interval is not None:
                inside = figure.interval[0] <= value <= figure.interval[1]
                yield Score(f"{group} {name}", None, inside)
            else:
                score = float(np.log(figure.value / value)) * figure.value / figure.std
                yield Score(f"{group} {name}", score, abs(score) < _LIMIT)


def simulations(data: Path, count: int, seed: int, output: Path | None = None) -> None:
    """Print mean and standard deviation of every figure's score, and the coverage.

    output: where the scores go, by figure, as JSON.
    """
    names = ("euroc_mh04", "euroc_v102", "tum_fr1_xyz", "tum_vi_room1")
    engines = {name: ground_truth(data / name / "groundtruth.txt") for name in names}
    spans = {name: read_tum(data / name / "groundtruth.txt").stamps for name in names}
    known: dict[str, list[Score]] = {}
    right = changes = 0
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        name = names[number % len(names)]
        span = int(spans[name][0]), int(spans[name][-1])
        drawn_stamps, poses, kind, parameters, nuisances = simulated(rng, engines[name], span)
        found = fit(drawn_stamps, poses, engines[name].truth)
        if found is None:
            print(f"{number}: no fit")
            continue
        right += found.kind is kind
        changes += bool(found.clock_changes)
        each = list(scores(found, kind, parameters, nuisances))
        for score in each:
            known.setdefault(score.name, []).append(score)
        worst = max(each, key=lambda score: abs(score.off or 0.0))
        missed = ", ".join(score.name for score in each if score.off is None and not score.covered)
        print(
            f"{number} {name} {kind} as {found.kind}: worst {worst.name} {worst.off:.1f} {missed}",
            flush=True,
        )
    if output is not None:
        plain = {
            name: [[score.off, score.covered] for score in all_] for name, all_ in known.items()
        }
        output.write_text(json.dumps(plain))
    print(f"\n{count} simulations, the right process in {right}, a clock change in {changes}")
    for figure, all_scores in known.items():
        off = np.array([score.off for score in all_scores if score.off is not None])
        covered = np.mean([score.covered for score in all_scores])
        told = f"mean {off.mean():+.2f}  std {off.std():.2f}" if len(off) else ""
        print(
            f"{figure:28} n {len(all_scores):4}  with a std {len(off):4}  {told}"
            f"  covered: {100.0 * covered:.0f} %"
        )


def rare(data: Path, count: int, seed: int) -> None:
    """Print the scores of the nuisances where the ground truth is sampled rarely.

    The motion is that of a dense ground truth, of which few samples are left; every second estimate
    of ``count`` a motion and rate, at 20 Hz, has no nuisances at all.
    """
    for name in ("euroc_v102", "euroc_mh04", "tum_vi_room1"):
        path = data / name / "groundtruth.txt"
        samples, motion = read_tum(path).samples, _motion(path)
        since = (samples.stamps - samples.stamps[0]) * 1e-9
        for rate in (0.5, 1.0, 2.0, 5.0):
            left = samples[np.flatnonzero(np.diff(np.floor(since * rate + 1e-6), prepend=-1.0))]
            engine = Engine({}, whole=True)
            engine.add_ground_truth(left)
            engine.finish()
            found = [
                score
                for number in range(count)
                if (score := _rare_score(seed, number, left.stamps, motion, engine.truth))
            ]
            off = np.array([[score.off for score in each] for each in found])
            print(
                f"{name} at {rate:g} Hz: {len(off)} fits, mean {off.mean(axis=0).round(2).tolist()}"
                f" std {off.std(axis=0).round(2).tolist()} all {off.std():.2f}, beyond 2.5:"
                f" {100.0 * (np.abs(off) > 2.5).mean():.1f} %, beyond 4.5:"
                f" {(np.abs(off) > _NAMED).sum()}",
                flush=True,
            )


def _motion(path: Path) -> Recorded:
    """The mean of a dense ground truth, between which it is asked."""
    stamps = read_tum(path).stamps
    grid = np.arange(int(stamps[0]) + SECOND, int(stamps[-1]) - SECOND, SECOND // 50)
    truth = ground_truth(path).truth(grid)
    good = truth.valid
    return Recorded(grid[good], truth.poses[good], truth.covariances[good], truth.twists[good])


def _rare_score(
    seed: int, number: int, samples: Stamps, motion: Recorded, ask: Ask
) -> list[Score] | None:
    rng = np.random.default_rng([seed, number])
    kind = list(Kind)[number // 2 % 3]
    nuisances = random_nuisances(rng) if number % 2 else Nuisances.none()
    begin, end = max(samples[0], motion.stamps[0]), min(samples[-1], motion.stamps[-1])
    step = SECOND // 20
    stamps = np.arange(begin + SECOND + rng.integers(step), end - SECOND, step)
    truth = motion.at(nuisances.stamps(stamps))
    stamps, poses = stamps[truth.valid], truth.poses[truth.valid]
    parameters = random_parameters(rng, kind)
    estimated = with_errors(rng, kind, parameters, nuisances, stamps, poses)
    after = np.searchsorted(samples, stamps)
    sides = samples[[after - 1, after]]
    nearest = np.where(stamps - sides[0] <= sides[1] - stamps, *sides)
    found = fit_independent(stamps, estimated, nearest, ask)
    if found is None:
        return None
    return list(scores(found, kind, parameters, nuisances))[: len(NAMES)]


def injections() -> Iterator[Nuisances]:
    """What is put in."""
    none = np.eye(4)
    for offset in (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.2):
        yield Nuisances(offset, 0.0, none, 1.0)
        yield Nuisances(-offset, 0.0, none, 1.0)
    axis = np.array([0.6, -0.48, 0.64])
    for arm in (0.01, 0.03, 0.1, 0.3):
        yield Nuisances(0.0, 0.0, se3.exp(np.concatenate([arm * axis, np.zeros(3)])), 1.0)
    for turn in np.radians([0.5, 1.0, 5.0, 90.0]):
        yield Nuisances(0.0, 0.0, se3.exp(np.concatenate([np.zeros(3), turn * axis])), 1.0)
    for scale in (0.98, 1.02, 1.1):
        yield Nuisances(0.0, 0.0, none, scale)
    for rate in (5e-5, 2e-4, 1e-3):
        yield Nuisances(0.0, rate, none, 1.0)


def put_in(stamps: Stamps, poses: Array, nuisances: Nuisances) -> tuple[Stamps, Array]:
    """An estimate that needs these corrections besides its own."""
    middle = (int(stamps[0]) + int(stamps[-1])) // 2
    shift = nuisances.clock_offset * 1e9 + nuisances.clock_rate * (stamps - middle)
    changed = poses.copy()
    changed = se3.compose(changed, nuisances.extrinsic)
    changed[:, :3, 3] /= nuisances.scale
    return stamps - np.rint(shift).astype(np.int64), changed


def injected(data: Path, pairs: tuple[tuple[str, str], ...]) -> None:
    """Print by how many standard deviations each fit's change is off what was put in."""
    for dataset, name in pairs:
        ask: Ask = ground_truth(data / dataset / "groundtruth.txt").truth
        stamps, poses = estimate(data / dataset / f"{name}.txt")
        before = fit(stamps, poses, ask)
        if before is None:
            continue
        found = []
        for nuisances in injections():
            after = fit(*put_in(stamps, poses, nuisances), ask)
            if after is None:
                continue
            # The injected body frame is applied after the estimate's own.
            back = se3.inverse(nuisances.extrinsic) @ se3.inverse(before.nuisances.extrinsic)
            off = after.nuisances.vector - before.nuisances.vector - nuisances.vector
            off[2:8] = se3.log(after.nuisances.extrinsic @ back)
            scale = np.maximum(after.std, before.std)
            found.append(np.abs(off / scale).max())
            print(f"  {nuisances.vector.round(4).tolist()} worst {found[-1]:.2f}", flush=True)
        share = float((np.array(found) < 2.5).mean())
        print(
            f"{dataset} {name}: {len(found)} injections, {100 * share:.0f} % within 2.5", flush=True
        )


def false_alarms(seed: int, runs: int = 20_000) -> None:
    """Print how often the clock of stretches that only scatter is said to change."""
    rng = np.random.default_rng(seed)
    for count in (3, 5, 10, 20, 40, 100):
        for excess in (1.0, 2.0):
            found = 0
            for _ in range(runs):
                # Five seconds each, of unequal certainty, that scatter as much as they say or more.
                std = 0.01 * np.exp(0.5 * rng.normal(size=count))
                offsets = excess * std * rng.normal(size=count)
                found += bool(
                    clock_changes(
                        [
                            Stretch(5 * SECOND * i, 5 * SECOND * (i + 1), offset, deviation)
                            for i, (offset, deviation) in enumerate(
                                zip(offsets.tolist(), std.tolist(), strict=True)
                            )
                        ]
                    )
                )
            print(f"{count} stretches that scatter {excess} times: {found} of {runs}", flush=True)


def table(data: Path, pairs: tuple[tuple[str, str], ...]) -> None:
    """Print the rows of the table in ``docs/error_model.md``."""
    for dataset, name in pairs:
        ask: Ask = ground_truth(data / dataset / "groundtruth.txt").truth
        found = fit(*estimate(data / dataset / f"{name}.txt"), ask)
        if found is None:
            continue
        model = named(found)
        said = dict(answers.leading(model))
        jitter, kind = said["Kind of error"].removeprefix("jitter ").split(";\n", 1)
        kind = kind.replace("\n", " ")
        nats = ", ".join(f"{found.alternatives[each]:.2f}" for each in Kind)
        white = ", ".join(f"{part:.2f}" for part in np.abs(found.whiteness).max(axis=1))
        gain = found.nats_per_pose - found.uncorrected / found.poses
        cells = [f"{dataset}, {name}", str(found.poses), jitter, kind]
        for i, (factor, unit) in enumerate(((1e3, " ms"), (1e6, " ppm"))):
            value, std = factor * found.nuisances.vector[i], factor * found.std[i]
            cells.append(f"{value:.2f} ± {std:.2f}{unit}")
        arm = model["extrinsic"]["length"]
        cells.append(f"{1e3 * arm['value']:.0f} ± {1e3 * arm['std']:.0f} mm")
        scale = found.nuisances.scale
        cells.append(f"{scale:.4f} ± {scale * found.std[8]:.4f}")
        cells += [nats, f"{gain:.2f}", white, str(len(found.jumps))]
        print("| " + " | ".join(cells) + " |", flush=True)


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, help="the folder of recordings")
    parser.add_argument("--simulations", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--injections", type=int, default=len(PAIRS), help="pairs to inject into")
    parser.add_argument("--table", action="store_true", help="print the fits of all pairs instead")
    parser.add_argument("--clock", action="store_true", help="false alarms of clock changes")
    parser.add_argument(
        "--rare", type=int, help="estimates a cell, the ground truth at 0.5 to 5 Hz"
    )
    parser.add_argument("--output", type=Path, help="a file for the simulations' scores")
    arguments = parser.parse_args()
    if arguments.clock:
        false_alarms(arguments.seed)
        return
    if arguments.rare:
        rare(arguments.data, arguments.rare, arguments.seed)
        return
    if arguments.table:
        table(arguments.data, PAIRS)
        return
    if arguments.simulations:
        simulations(arguments.data, arguments.simulations, arguments.seed, arguments.output)
    injected(arguments.data, PAIRS[: arguments.injections])


if __name__ == "__main__":
    main()
