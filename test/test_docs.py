# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The documentation says what the code does: tables, links, sections, topics, commands."""

from __future__ import annotations

import argparse
import ast
import contextlib
import importlib.util
import io
import itertools
import re
import shlex
import shutil
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import pytest
import yaml

from trajeval_ros.commands import benchmark, demo, evaluate, replay, settings, simulate, watch
from trajeval_ros.commands.inputs import names_of, with_format
from trajeval_ros.online.accounting import Reason
from trajeval_ros.online.parameters import ONE, PARAMETERS, complete, table

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
SOURCES = [
    path
    for folder in ("trajeval_ros", "test", "performance", "launch", "config")
    for path in sorted((ROOT / folder).rglob("*"))
    if path.suffix in {".py", ".yaml"} and path != Path(__file__)
]
PARSERS = {
    "watch": watch.make_parser,
    "evaluate": evaluate.make_parser,
    "replay": replay.make_parser,
    "simulate": simulate.make_parser,
    "demo": demo.make_parser,
    "benchmark": benchmark.make_parser,
}
MAINS = {"evaluate": evaluate.main, "simulate": simulate.main}


def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def make_tables() -> ModuleType:
    path = ROOT / "docs" / "make_tables.py"
    spec = importlib.util.spec_from_file_location("make_tables", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


# Tables


@pytest.mark.parametrize("name", ["parameters.md"])
def test_tables_are_those_of_the_code(name: str) -> None:
    tables = make_tables()
    text = text_of(ROOT / "docs" / name)
    remedy = "run: PYTHONPATH=. .venv/bin/python docs/make_tables.py"
    assert tables.page(text, tables.TABLES[name]()) == text, remedy


def test_every_reason_has_its_remedy() -> None:
    page = text_of(ROOT / "docs" / "troubleshooting.md")
    assert [reason for reason in Reason if f"`{reason}`" not in page] == []


# A name in code quotes that looks like a parameter's.
FAMILIES = {name.split(".")[0] for name in PARAMETERS if "." in name} - {"relative"}
PARAMETER = re.compile(r"`((?:" + "|".join(FAMILIES) + r")\.[a-z_.]+)(?::|`|=)")
OF_THE_SUMMARY = {"ground_truth.hyperparameters"}


@pytest.mark.parametrize("path", PAGES, ids=name_of)
def test_parameters_named_exist(path: Path) -> None:
    named = {name.rstrip(".") for name in PARAMETER.findall(text_of(path))} - OF_THE_SUMMARY
    assert sorted(named - set(PARAMETERS)) == []


# Links


def slug(heading: str) -> str:
    """The anchor that GitHub gives a heading."""
    kept = re.sub(r"[^\w\- ]", "", heading.strip().lower())
    return kept.replace(" ", "-")


def without_code(text: str) -> str:
    return re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)


def headings(path: Path) -> list[str]:
    return re.findall(r"^#+ (.+)$", without_code(text_of(path)), flags=re.MULTILINE)


@pytest.mark.parametrize("path", PAGES, ids=name_of)
def test_relative_links_resolve(path: Path) -> None:
    links = re.findall(r"\]\(([^)\s]+)\)", without_code(text_of(path)))
    broken = []
    for link in links:
        if re.match(r"[a-z]+:", link):
            continue
        file, _, anchor = link.partition("#")
        target = path.parent / file if file else path
        if not target.exists() or (
            anchor and anchor not in {slug(heading) for heading in headings(target)}
        ):
            broken.append(link)
    assert broken == []


def test_every_page_is_linked_from_the_readme() -> None:
    readme = text_of(ROOT / "README.md")
    pages = [path.name for path in (ROOT / "docs").glob("*.md")]
    assert [page for page in pages if f"(docs/{page})" not in readme] == []


def test_pictures_are_small() -> None:
    pictures = list((ROOT / "docs" / "images").iterdir())
    assert pictures
    assert [picture.name for picture in pictures if picture.stat().st_size > 200_000] == []


# Sections that the code cites

CITATION = re.compile(r"docs/(\w+\.md)``(?:, (?:section )?([0-9.]+|[A-Z][\w ]*))?")


def test_sections_cited_by_the_code_exist() -> None:
    cited = {
        (page, section.strip().rstrip("."))
        for path in SOURCES
        for page, section in CITATION.findall(text_of(path))
    }
    assert ("method.md", "3") in cited
    missing = []
    for page, section in cited:
        file = ROOT / "docs" / page
        titles = headings(file) if file.exists() else []
        known = {part for title in titles for part in (title.split(".")[0], title.split(". ")[-1])}
        if not file.exists() or (section and section not in known):
            missing.append(f"{page}, {section}")
    assert missing == []


# Topics and services


NAME = re.compile(r"~/[a-z_/]*[a-z_]")


def names_of_the_node() -> list[re.Pattern[str]]:
    """The node's private names; where one is put together, anything fits the part put in."""
    found = {}
    for path in (ROOT / "trajeval_ros" / "node").rglob("*.py"):
        for node in ast.walk(ast.parse(text_of(path))):
            parts = node.values if isinstance(node, ast.JoinedStr) else [node]
            text = "".join(
                str(part.value) if isinstance(part, ast.Constant) else "{}"
                for part in parts
                if isinstance(part, ast.Constant | ast.FormattedValue)
            )
            if re.fullmatch(r"~/[a-z_/{}]+", text):
                found[text] = re.compile(text.replace("{}", "[a-z_/]*"))
    return list(found.values())


@pytest.mark.parametrize("path", PAGES, ids=name_of)
def test_topics_named_exist(path: Path) -> None:
    named = set(NAME.findall(text_of(path).replace("~/ws", "")))
    known = names_of_the_node()
    unknown = [name for name in named if not any(each.fullmatch(name) for each in known)]
    assert sorted(unknown) == []


def test_every_topic_is_in_the_readme() -> None:
    documented = set(NAME.findall(text_of(ROOT / "README.md")))
    known = names_of_the_node()
    assert len(known) > 5
    silent = [each.pattern for each in known if not any(map(each.fullmatch, documented))]
    assert silent == []


# Commands


def commands(path: Path) -> Iterator[list[str]]:
    """The command lines of a page's ``sh`` blocks, split into words."""
    for block in re.findall(r"^```sh\n(.*?)^```", text_of(path), flags=re.MULTILINE | re.DOTALL):
        for line in block.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            if words:
                yield words


ALL = [(name_of(path), words) for path in PAGES for words in commands(path)]


def make_targets() -> set[str]:
    declared = re.findall(r"^\.PHONY: (.+)$", text_of(ROOT / "Makefile"), flags=re.MULTILINE)
    return {target for line in declared for target in line.split()}


def check_ros_arguments(words: list[str]) -> None:
    """Parameters and remapped names of a node's command line are known ones."""
    given = [pair for pair in itertools.pairwise(words) if pair[0] in ("-p", "-r")]
    parameters = dict(value.split(":=", 1) for option, value in given if option == "-p")
    names = yaml.safe_load(parameters.get("estimates", "[estimate]"))
    for name, setting in parameters.items():
        assert name in {*table(names), "use_sim_time"}, name
        if name != "use_sim_time":
            settings.read(None, [f"{name}={setting}"], names)
    remapped = {value.split(":=", 1)[0] for option, value in given if option == "-r"}
    assert remapped <= {*names, "ground_truth", "__node", "__ns"}


def check_ours(words: list[str]) -> None:
    """Our own command line is one that its parser takes."""
    ours, ros = replay.split_ros_arguments(words[1:])
    if words[0] in ("evaluate", "replay"):
        ours = with_format(ours)
    check_ros_arguments(ros)
    if words[0] == "evaluator":
        assert not ours
        return
    with contextlib.redirect_stderr(io.StringIO()) as complaint:
        try:
            arguments: argparse.Namespace = PARSERS[words[0]]().parse_args(ours)
        except SystemExit:
            pytest.fail(complaint.getvalue())
    names = names_of(arguments.estimate) if words[0] == "evaluate" else ONE
    settings.read(None, getattr(arguments, "assignments", []), names)


@pytest.mark.parametrize(("page", "words"), ALL, ids=lambda value: str(value)[:60])
def test_commands_exist(page: str, words: list[str]) -> None:
    del page
    if words[0] == "make":
        assert {word for word in words[1:] if "=" not in word} <= make_targets()
    elif words[:3] == ["ros2", "run", "trajeval_ros"]:
        check_ours(words[3:])
    elif words[:3] == ["ros2", "launch", "trajeval_ros"]:
        assert (ROOT / "launch" / words[3]).exists()
    elif words[0] in {*PARSERS, "evaluator"}:
        check_ours(words)


@pytest.mark.slow
def test_commands_on_files_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """``files.md`` from top to bottom, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my.yaml").write_text(
        re.findall(r"^```yaml\n(.*?)^```", text_of(ROOT / "docs/parameters.md"), flags=re.M | re.S)[
            0
        ]
    )
    ran = 0
    for words in commands(ROOT / "docs" / "files.md"):
        # "run" is the folder that the first of them makes; a bag of one's own is not there.
        if words[0] == "cp":
            shutil.copy(*words[1:])
        elif "--rerun" in words and find_spec("rerun") is None:
            continue  # not among what `make install` brings
        elif words[0] in MAINS and any(word.split("/")[0] == "run" for word in words):
            assert MAINS[words[0]](words[1:]) == 0, capsys.readouterr().err
            ran += 1
    assert ran > 4
    assert {path.name for path in (tmp_path / "run/results").iterdir()} == {
        "summary.json",
        "poses.csv",
        "report.html",
    }


def test_yaml_in_the_docs_is_valid(tmp_path: Path) -> None:
    for path in PAGES:
        for block in re.findall(r"^```yaml\n(.*?)^```", text_of(path), flags=re.M | re.S):
            file = tmp_path / "parameters.yaml"
            file.write_text(block)
            complete(settings.read_file(file))
