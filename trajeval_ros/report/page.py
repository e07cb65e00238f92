# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page: one self-contained HTML file, in the order in which a person asks."""

from __future__ import annotations

import html
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from trajeval_ros import charts
from trajeval_ros.report import answers, kinds, words
from trajeval_ros.report.glossary import CAPTIONS, HOW_TO_READ
from trajeval_ros.report.payload import payload
from trajeval_ros.report.run import Run
from trajeval_ros.report.shown import Shown, shown, source_name
from trajeval_ros.wall import shield

Say = Callable[[str], None]

_FOLDER = Path(__file__).parent
_NO_SCRIPT = (
    "<noscript><p>The figures are drawn by this page's script, which does not run here. Sentences"
    " and tables need none.</p></noscript>"
)


def page(run: Run, say: Say) -> str:
    """Return the report of one estimate. ``say`` is told, in one line, of what fails."""
    return _page({"": run}, say, ())


def page_of_several(runs: Mapping[str, Run], sentences: Sequence[str], say: Say) -> str:
    """Return the report of several estimates, by their names, against one ground truth.

    ``sentences``: how they compare.
    """
    return _page(runs, say, sentences)


def _page(runs: Mapping[str, Run], say: Say, compared: Sequence[str]) -> str:
    estimates = shown(runs)
    title = _title(estimates)
    sections = [
        _compared(estimates, compared),
        *(_answer(one, len(estimates) > 1) for one in estimates),
        *_figures(estimates, say),
        *_tables(estimates),
        _section("Parameters", _parameters(estimates[0].run)),
        _section("How to read this", _glossary()),
    ]
    style = charts.style() + _text("style.css")
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        f"<title>{html.escape(title)}</title><style>{style}</style></head><body>"
        f"<header><h1>{html.escape(title)}</h1><p class=sources>{_sources(estimates)}</p></header>"
        "<main>\n"
        + "\n".join(section for section in sections if section)
        + f"\n</main><footer>{words.when(estimates[0].run)} trajeval_ros</footer>"
        + "</body></html>\n"
    )


def _text(name: str) -> str:
    return (_FOLDER / name).read_text(encoding="utf-8")


def _title(estimates: Sequence[Shown]) -> str:
    """What a tab or a list of pages is to show: which estimate it is."""
    if len(estimates) > 1:
        return f"{', '.join(one.name for one in estimates)}: trajectory evaluation"
    source = estimates[0].run.sources.get("estimate", "")
    name = source_name(estimates[0].run) if source else ""
    return f"{name}: trajectory evaluation" if name else "Trajectory evaluation"


def _sources(estimates: Sequence[Shown]) -> str:
    named = [one.run.sources.get("estimate", "") for one in estimates]
    against = estimates[0].run.sources.get("ground truth", "")
    parts = [", ".join(html.escape(name) for name in named if name), html.escape(against)]
    return " against ".join(part for part in parts if part)


def _section(title: str, content: str) -> str:
    return f"<section><h2>{title}</h2>{content}</section>"


# The answer --------------------------------------------------------------------------------------


def _answer(one: Shown, named: bool) -> str:
    """How good it is, in words and in the figures that everybody looks for first."""
    said_first = answers.answer(one.run.summary, one.run.parameters)
    rows = "".join(
        f'<tr><th scope="row">{title}</th><td>{html.escape(text)}</td></tr>'
        for title, text in said_first
    )
    table = f"<table class=answers>{rows}</table>" if rows else ""
    title = f"<h2>{html.escape(one.name)}</h2>" if named else ""
    # Of several, the tiles are the columns of one table.
    tiles = "" if named else _tiles(words.tiles(one.run, one.series))
    # Of a whole run the table says where it is worst, and what the ground truth is known to.
    told = one.series is not None and one.run.summary.get("headline")
    said = words.not_told_apart(one.run) if told else words.verdict(one.run, one.series)
    verdict = f"<p class=verdict>{said}</p>" if said else ""
    return f"<section>{title}{verdict}{table}{tiles}{_notices(one.run)}</section>"


def _tiles(tiles: Iterable[tuple[str, str, str]]) -> str:
    cells = "".join(
        f"<div class=tile><span class=name>{name}</span><b>{value}</b><span>{remark}</span></div>"
        for name, value, remark in tiles
    )
    return f"<div class=tiles>{cells}</div>"


def _notices(run: Run) -> str:
    """Likely causes first: they are what to act on."""
    said = [
        ("warning", "Likely cause", f"{cause.text}. To try: {cause.advice}.")
        for cause in run.causes
    ]
    said += [(each.level, each.level, each.text) for each in run.notices if each.level != "info"]
    said += [("error", "error", line) for line in run.defects]
    return _list(said)


def _list(said: Iterable[tuple[str, str, str]]) -> str:
    items = "".join(
        f'<li class="{html.escape(level)}"><b>{html.escape(title)}</b>: {html.escape(text)}</li>'
        for level, title, text in said
    )
    return f"<ul class=notices>{items}</ul>" if items else ""


def _compared(estimates: Sequence[Shown], sentences: Sequence[str]) -> str:
    if len(estimates) < 2:
        return ""
    said = "".join(
        f"<p class=verdict>{html.escape(_begun(sentence, estimates))}</p>" for sentence in sentences
    )
    heads = "".join(f'<th scope="col" class=n>{html.escape(one.name)}</th>' for one in estimates)
    tiles = [
        {name: (value, what) for name, value, what in words.tiles(one.run, one.series)}
        for one in estimates
    ]
    rows = "".join(
        f'<tr><th scope="row">{name}</th>'
        + "".join(
            f"<td class=n>{value}<br><small>{what}</small></td>"
            for value, what in (each.get(name, ("–", "")) for each in tiles)
        )
        + "</tr>"
        for name in dict.fromkeys(name for each in tiles for name in each)
    )
    table = (
        f'<div class=scroll><table><thead><tr><th scope="col">Figure</th>{heads}</tr></thead>'
        f"<tbody>{rows}</tbody></table></div>"
    )
    return _section("Which is better", said + table)


def _begun(sentence: str, estimates: Sequence[Shown]) -> str:
    """A sentence with a capital, unless it begins with a name, which is as it is."""
    if any(one.name and sentence.startswith(one.name) for one in estimates):
        return sentence
    return sentence[:1].upper() + sentence[1:]


# The figures -------------------------------------------------------------------------------------


def _figures(estimates: Sequence[Shown], say: Say) -> list[str]:
    """The sections with figures, and the script that draws them; none where there is no pose."""
    if not any(one.series is not None for one in estimates):
        return [_section("The ground truth", _model(estimates[0].run))]
    lines: list[str] = []

    def drawn() -> list[str]:
        data = json.dumps(payload(estimates), separators=(",", ":"), allow_nan=False)
        return [
            _NO_SCRIPT + '<div id="controls" class="bar" role="region" aria-label="Controls of the'
            ' figures"></div>',
            _section("Where", _maps(len(estimates) == 1)),
            _section("Error over time", _over_time(estimates)),
            _section("What kind of error", kinds.section(estimates)),
            _clock(estimates),
            _section("The ground truth", _truth(estimates[0].run)),
            _section("Likelihoods", _likelihoods()),
            # No text of a user's may end the script.
            f'<script type="application/json" id="data">{data.replace("<", chr(92) + "u003c")}'
            f"</script><script>{charts.script()}</script>"
            f"<script>{charts.compact(_text('report.js'))}</script>",
        ]

    nothing: list[str] = []
    found = shield("the figures", drawn, nothing, lines.append)
    for line in lines:
        say(line)
    failed = [f"<p>{html.escape(line)}</p>" for line in lines]
    return found or [*failed, _section("The ground truth", _model(estimates[0].run))]


def _maps(single: bool) -> str:
    colours = (
        "<span>estimate: near <i class=scale></i> far off</span>"
        if single
        else "<span>estimates: coloured as above</span>"
    )
    key = (
        "<div class=key><span><i style='background:var(--truth)'></i>ground truth</span>"
        "<span><i style='background:repeating-linear-gradient(90deg,var(--way) 0 2px,transparent"
        f" 2px 5px)'></i>without an estimate</span>{colours}<span><i style='background:var(--band)"
        "'></i>ground truth's uncertainty, 2 σ, where it can be seen</span></div>"
    )
    maps = "".join(f'<div id="{name}"></div>' for name in ("top", "side", "turn"))
    return f"{key}<div class=maps>{maps}</div>{_caption('map', ' hint')}"


def _over_time(estimates: Sequence[Shown]) -> str:
    hosts = _hosts("translation", "rotation")
    said = "".join(
        f"<p class=caption>{html.escape(line)}</p>"
        for one in estimates
        if one.series is not None
        for line in words.spread(one.name if len(estimates) > 1 else "", one.series)
    )
    more = _hosts("translation-axes", "rotation-axes", "height")
    return (
        f"{hosts}{said}{_caption('time')}<details open><summary>By axes, and height</summary>"
        f"{more}</details>"
    )


def _clock(estimates: Sequence[Shown]) -> str:
    known = any(
        len((one.run.summary.get("error_model") or {}).get("clock_stretches", ())) > 1
        for one in estimates
    )
    content = _hosts("clock") + _caption("clock")
    return _section("Clock offset over time", content) if known else ""


def _truth(run: Run) -> str:
    return _hosts("rates") + _caption("rates") + _model(run)


def _model(run: Run) -> str:
    learned = [(each.level, each.level, each.text) for each in run.notices if each.level == "info"]
    table = _table(words.model(run), ("Of the ground truth", "Value", "What it says"))
    return table + _list(learned)


def _likelihoods() -> str:
    return _hosts("likelihood", "likelihood-window", "chi2") + _caption("likelihoods")


def _hosts(*names: str) -> str:
    return "<div class=charts>" + "".join(f'<div id="{name}"></div>' for name in names) + "</div>"


def _caption(name: str, more: str = "") -> str:
    return f'<p class="caption{more}">{CAPTIONS[name]}</p>'


# The tables --------------------------------------------------------------------------------------


def _tables(estimates: Sequence[Shown]) -> list[str]:
    """Every figure and every account, of each estimate."""
    found = []
    for title, rows, heads in (
        ("Figures", words.figures, ("Figure", "Value", "What it says")),
        ("Every message", words.accounts, ("Messages", "Number", "Rate or reason")),
    ):
        tables = (
            (f"<h3>{html.escape(one.name)}</h3>" if len(estimates) > 1 else "")
            + _table(rows(one.run), heads)
            for one in estimates
        )
        found.append(_section(title, "".join(tables)))
    return found


def _table(rows: Iterable[tuple[str, str, str]], heads: tuple[str, str, str]) -> str:
    columns = "".join(
        f'<th scope="col"{" class=n" if column == 1 else ""}>{title}</th>'
        for column, title in enumerate(heads)
    )
    body = "".join(
        f'<tr><th scope="row">{name}</th><td class=n>{value}</td><td class=what>{what}</td></tr>'
        for name, value, what in rows
    )
    return (
        f"<div class=scroll><table class=figures><thead><tr>{columns}</tr></thead>"
        f"<tbody>{body}</tbody></table></div>"
    )


def _glossary() -> str:
    entries = "".join(f"<dt>{term}</dt><dd>{text}</dd>" for term, text in HOW_TO_READ)
    return f"<dl>{entries}</dl>"


def _parameters(run: Run) -> str:
    """All of them; those that are not at their default stand out."""
    rows = "".join(
        f'<tr{" class=changed" if changed else ""}><th scope="row"><code>{html.escape(name)}</code>'
        f"</th><td class=n>{html.escape(value)}</td><td class=what>{html.escape(what)}</td></tr>"
        for name, value, what, changed in words.parameters(run)
    )
    return (
        "<p class=what>Bold: not at its default.</p><details><summary>All parameters</summary>"
        '<div class=scroll><table class=figures><thead><tr><th scope="col">Parameter</th>'
        '<th scope="col" class=n>Value</th><th scope="col">What it is</th></tr></thead>'
        f"<tbody>{rows}</tbody></table></div></details>"
    )
