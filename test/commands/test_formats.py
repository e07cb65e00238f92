# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``evaluate`` and ``replay`` where no format is named, and KITTI's files without stamps."""

import json
from pathlib import Path

import numpy as np
import pytest

from trajeval_ros import se3
from trajeval_ros.commands import evaluate, inputs, replay


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same 20 s in every format: ``gt.*``, and ``est.*`` with an error of a centimetre."""
    place = tmp_path_factory.mktemp("formats")
    seconds = np.arange(200) / 10.0
    angle = 0.3 * seconds
    poses = se3.exp(
        np.stack([np.cos(angle), np.sin(angle), 0 * angle, 0 * angle, 0 * angle, angle], axis=1)
    )
    noise = np.random.default_rng(0).normal(size=(len(seconds), 6)) * 0.01
    for name, stack in (("gt", poses), ("est", se3.compose(poses, se3.exp(noise)))):
        position, quaternion = se3.to_position_quaternion(stack)
        rows = np.column_stack((seconds, position, quaternion))
        np.savetxt(place / f"{name}.tum", rows, fmt="%.17g")
        np.savetxt(place / f"{name}.kitti", stack[:, :3].reshape(-1, 12), fmt="%.17g")
        csv = [
            ",".join((str(100_000_000 * i), *map(repr, row[[1, 2, 3, 7, 4, 5, 6]].tolist())))
            for i, row in enumerate(rows)
        ]
        (place / f"{name}.csv").write_text("#stamp,p,q\n" + "\n".join(csv) + "\n")
    return place


def ate(output: Path) -> float:
    summary = json.loads((output / "summary.json").read_text(encoding="utf-8"))
    value = summary["conventional"]["ate_translation_rmse"]
    assert isinstance(value, float)
    return value


@pytest.mark.parametrize(
    ("truth", "estimate", "said"),
    [
        ("gt.tum", "est.tum", "read as tum (rows of 8 numbers): "),
        ("gt.csv", "est.tum", "read as euroc (commas, and stamps in nanoseconds): "),
        ("gt.kitti", "est.kitti", "read as kitti (rows of 12 numbers): "),
        ("gt.csv", "est.csv", "read as euroc "),
    ],
)
def test_each_file_is_read_as_what_it_is(
    folder: Path,
    truth: str,
    estimate: str,
    said: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    files = [str(folder / truth), str(folder / estimate)]
    # The option may come first.
    assert evaluate.main(["--output", str(tmp_path / "auto"), *files]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"info: {said}")
    assert files[0] in lines[0]
    assert files[1] in lines[0]
    kitti = truth.endswith("kitti")
    assert sum("0.1 s apart" in line for line in lines) == kitti
    named = [str(folder / "gt.tum"), str(folder / "est.tum")]
    assert evaluate.main(["tum", *named, "--output", str(tmp_path / "named")]) == 0
    assert "read as" not in capsys.readouterr().out
    assert ate(tmp_path / "auto") == pytest.approx(ate(tmp_path / "named"), rel=1e-9)


def test_kitti_without_stamps_is_at_ten_hertz(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [str(folder / "gt.kitti"), str(folder / "est.kitti")]
    assert evaluate.main(["kitti", *files, "--output", str(tmp_path / "without")]) == 0
    assert "info: no --times" in capsys.readouterr().out
    np.savetxt(tmp_path / "times.txt", np.arange(200) / 10.0, fmt="%.17g")
    times = ["--times", str(tmp_path / "times.txt")]
    for command in (["kitti"], []):
        assert evaluate.main([*command, *files, *times, "--output", str(tmp_path / "with")]) == 0
        assert "no --times" not in capsys.readouterr().out
        assert ate(tmp_path / "with") == ate(tmp_path / "without")


def test_wrong_usage(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth, estimate = str(folder / "gt.tum"), str(folder / "est.tum")
    for arguments, said in (
        (["tmu", truth, estimate], "neither a file nor a format 'tmu'; formats: tum, euroc"),
        ([truth], "name a ground truth and an estimate"),
        ([truth, estimate, "--estimate", "/odom"], "there is no bag"),
    ):
        assert evaluate.main(arguments) == 2
        assert said in capsys.readouterr().err
    assert replay.main([truth, estimate, estimate]) == 2
    assert "name a ground truth and an estimate" in capsys.readouterr().err
    assert evaluate.main([truth, str(folder / "absent.txt")]) == 1
    assert "absent.txt: it cannot be read" in capsys.readouterr().err


def test_a_bag_is_taken_for_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = tmp_path / "recording.data"
    bag.write_bytes(b"\x89MCAP0\r\n" + bytes(50))
    assert evaluate.main([str(bag), "--ground-truth", "/gt", "--estimate", "/odom"]) == 1
    assert str(bag) in capsys.readouterr().err
    other = tmp_path / "gt.txt"
    other.write_text("0.1 0 0 0 0 0 0 1\n")
    assert evaluate.main([str(other), str(bag)]) == 1
    assert "it is an mcap file, which does not go with other files" in capsys.readouterr().err


def test_replay_recognises_too(folder: Path) -> None:
    files = [str(folder / "gt.csv"), str(folder / "est.kitti"), "--rate", "5"]
    arguments = replay.make_parser().parse_args(inputs.with_format(files))
    data = inputs.read(inputs.recognised(arguments))
    assert len(data.ground_truth) == len(data.estimate) == 200
    assert [remark.split(" ", 3)[2] for remark in data.remarks[:1]] == ["euroc"]
