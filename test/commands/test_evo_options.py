# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whoever comes from evo is told what to write instead."""

from __future__ import annotations

from pathlib import Path

import pytest

from trajeval_ros.commands import evaluate, inputs
from trajeval_ros.commands.console import UsageError
from trajeval_ros.commands.simulate import write_files


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["-as"], "-as of evo: --set gauge=sim3"),
        (["-a", "-p"], "-a of evo: that is done by default (gauge=se3); -p of evo: --output DIR"),
        (["--delta", "1", "--delta_unit", "m"], "--delta_unit of evo: --set relative.unit=m"),
        (["--save_results=x.zip"], "--save_results of evo: --output DIR"),
        (["--nonsense"], "unrecognized arguments: --nonsense\n"),
    ],
)
def test_an_option_of_evo_is_answered(
    given: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate.main(["tum", "truth.txt", "estimate.txt", *given]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("named", [["bag"], []])
def test_topics_stand_behind_a_bag_as_in_evo(named: list[str], tmp_path: Path) -> None:
    bag = f"{tmp_path}/run.mcap"
    with open(bag, "wb") as file:
        file.write(b"\x89MCAP0\r\n")
    parse = evaluate.make_parser().parse_args

    def read(*given: str) -> tuple[str, str, list[str]]:
        found = inputs.recognised(parse(inputs.with_format([*named, bag, *given])))
        return found.bag, found.ground_truth, found.estimate

    assert read("/gt", "/vio", "/lio") == (bag, "/gt", ["/vio", "/lio"])
    assert read("--ground-truth", "/gt", "--estimate", "/vio") == (bag, "/gt", ["/vio"])
    with pytest.raises(UsageError, match="name two topics"):
        read("/gt")
    with pytest.raises(UsageError, match="or by --ground-truth"):
        read("/gt", "/vio", "--estimate", "/lio")


def test_files_in_the_wrong_order_are_asked_about(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth, estimate = map(str, write_files(tmp_path, 10.0, 3))
    assert evaluate.main([estimate, truth]) == 0
    assert "have the two been swapped?" in capsys.readouterr().out
    assert evaluate.main([truth, estimate]) == 0
    assert "swapped" not in capsys.readouterr().out
