# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page: one self-contained HTML file."""

from __future__ import annotations

import html
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path, PurePath

from trajeval_ros.report import answers, words
from trajeval_ros.report.run import Run
from trajeval_ros.report.series import Series, make_series
from trajeval_ros.wall import shield

_STYLE = Path(__file__).with_name("style.css")

_PICTURES_MISSING = (
    "The pictures are left out: this Python has no matplotlib. Get it with"
    " <code>python3 -m pip install matplotlib</code> (on ROS machines:"
    " <code>apt install python3-matplotlib</code>) and write the report again."
)

_TRAJECTORY_CAPTION = (
    "Grey: ground truth, dotted where there is no estimate. Coloured: the estimate, moved into the"
    " ground truth's world by the alignment that ATE is under; bright is far off. Green: where the"
    " ground truth itself is known to, two standard deviations, where that is large enough to be"
    " seen. Shaded in the right-hand picture: no ground truth."
)
_TIME_CAPTION = (
    "An error inside the green band cannot be told from the ground truth's own uncertainty; above"
    " it, it is the estimate's. In a gap of the ground truth the band opens up, and the same error"
    " says less. The log-likelihoods fall where the estimate is bad; the relative and the absolute"
    " one lie on one another as long as first order holds. What was gained within some seconds is"
    " what they added to the run's totals, given all before: the tables take the last ones alone."
)
_BOXES_CAPTION = (
    "Relative errors from every pose to the one a tenth, a fifth, ... half of the path further on:"
    " the box holds the middle half, the line in it is the median, nine in ten lie between the ends"
    " of the whiskers. Neither alignment nor where the run began matters. Errors that grow with the"
    " length are drift; as large over any length, they are not."
)

_HOW_TO_READ = (
    (
        "Relative likelihood",
        "How the motion between neighbouring estimates differs from the true one, weighed by how"
        " well the true one is known. It needs no alignment.",
    ),
    (
        "Absolute likelihood",
        "How the aligned estimate differs from the ground truth at each instant, integrated over"
        " all alignments. To first order, under the gauge se3, it carries the same information as"
        " the relative one; the two figures then agree.",
    ),
    (
        "Log-likelihood",
        "In nats, of the errors under the ground truth's own uncertainty: higher is better. With"
        " millimetre ground truth and centimetre errors, -10,000 nats a pose are right. Totals of"
        " runs of different length do not compare, nor do those under different gauges; the"
        " figures of the sliding window do compare.",
    ),
    (
        "χ² and log-determinant",
        "The log-likelihood is minus half of χ² + log-determinant + degrees of freedom times"
        " log 2π. A gap in the ground truth makes χ² small and the log-determinant large: look at"
        " both before you call an estimate good.",
    ),
    (
        "χ² per degree of freedom",
        "1: the estimate is as good as the ground truth. Its square root says how many standard"
        " deviations of the ground truth the error is worth.",
    ),
    (
        "p-value",
        "How often an estimate as good as the ground truth would have a χ² as far out as this, on"
        " either side. Near 0: the error is the estimate's own, or the uncertainty is wrong.",
    ),
    (
        "Noise-equivalent error",
        "The white noise which, added to the ground truth's uncertainty, explains the errors best:"
        " an accuracy from which the ground truth's share is taken out.",
    ),
    (
        "ATE and RE, conventional",
        "Root mean square error after alignment of positions (Umeyama), and of the motion over a"
        " fixed step, as other tools print them. They take the ground truth for exact.",
    ),
)


def page(run: Run, say: Callable[[str], None]) -> str:
    """Return ``report.html``. ``say`` is told, in one line, of a picture that fails."""
    series = make_series(run) if len(run.buckets) else None
    sections = [
        f"<p class=verdict>{words.verdict(run, series)}</p>",
        _tiles(words.tiles(run, series)),
        _answers(run),
        _notices(run),
        *_pictures(run, series, say),
        _section("Figures", _table(words.figures(run), ("", "", "what it says"))),
        _section("Every message", _table(words.accounts(run), ("", "", ""))),
        _section("The ground truth's model", _table(words.model(run), ("", "", ""))),
        _section("How to read this", _glossary()),
        _section("Parameters", _parameters(run)),
    ]
    title = _title(run)
    sources = " against ".join(
        html.escape(run.sources[key]) for key in ("estimate", "ground truth") if key in run.sources
    )
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{_STYLE.read_text(encoding='utf-8')}</style></head><body>"
        f"<h1>{html.escape(title)}</h1><p class=sources>{sources}</p>\n"
        + "\n".join(section for section in sections if section)
        + f"\n<footer>{words.when(run)} trajeval_ros</footer></body></html>\n"
    )


def _title(run: Run) -> str:
    """What a tab or a list of pages is to show: which estimate it is."""
    source = run.sources.get("estimate", "")
    path, _, topic = source.partition(", topic ")
    name = topic or PurePath(path).name or path
    return f"{name}: trajectory evaluation" if name else "Trajectory evaluation"


def _section(title: str, content: str) -> str:
    return f"<section><h2>{title}</h2>{content}</section>"


def _tiles(tiles: Iterable[tuple[str, str, str]]) -> str:
    cells = "".join(
        f"<div class=tile><span class=name>{name}</span><b>{value}</b><span>{remark}</span></div>"
        for name, value, remark in tiles
    )
    return f"<div class=tiles>{cells}</div>"


def _answers(run: Run) -> str:
    """What kind of error it is, and what is not the estimator's fault."""
    rows = "".join(
        f"<tr><td>{title}</td><td>{html.escape(text)}</td></tr>"
        for title, text in answers.sentences(run.summary.get("error_model"))
    )
    return _section("What kind of error", f"<table>{rows}</table>") if rows else ""


def _notices(run: Run) -> str:
    """Likely causes first: they are what to act on."""
    said = [
        ("warning", "Likely cause", f"{cause.text}. To try: {cause.advice}.")
        for cause in run.causes
    ]
    said += [(notice.level, notice.level, notice.text) for notice in run.notices]
    said += [("error", "error", line) for line in run.defects]
    items = "".join(
        f'<li class="{html.escape(level)}"><b>{html.escape(title)}</b>: {html.escape(text)}</li>'
        for level, title, text in said
    )
    return f"<ul class=notices>{items}</ul>" if items else ""


def _pictures(run: Run, series: Series | None, say: Callable[[str], None]) -> list[str]:
    if series is None:
        return []
    drawn: list[str] = []
    pictures: list[tuple[str, Callable[[Run, Series], str], str]] = [
        ("Trajectory", _trajectory, _TRAJECTORY_CAPTION),
        ("Over time", _over_time, _TIME_CAPTION),
    ]
    if (run.summary.get("drift") or {}).get("sub_trajectories"):
        pictures.append(("Over sub-trajectories", _boxes, _BOXES_CAPTION))
    for title, draw, caption in pictures:
        try:
            drawn.append(_picture(title, partial(draw, run, series), caption, say))
        except ImportError:
            return [f"<p>{_PICTURES_MISSING}</p>"]
    return drawn


def _trajectory(run: Run, series: Series) -> str:
    # Only now: matplotlib may be absent, or broken.
    from trajeval_ros.report import plots

    return plots.trajectory(run, series)


def _over_time(run: Run, series: Series) -> str:
    from trajeval_ros.report import plots

    return plots.over_time(run, series)


def _boxes(run: Run, series: Series) -> str:
    from trajeval_ros.report import boxes

    return boxes.sub_trajectories(run.summary["drift"]["sub_trajectories"])


def _picture(title: str, draw: Callable[[], str], caption: str, say: Callable[[str], None]) -> str:
    """The picture's section, or why there is no picture. Raises ImportError without matplotlib."""
    missing: list[ImportError] = []

    def section() -> str:
        try:
            return _section(title, _figure(draw(), caption))
        except ImportError as error:
            missing.append(error)
            return ""

    lines: list[str] = []
    drawn = shield(f"the picture {title!r}", section, "", lines.append)
    if missing:
        raise missing[0]
    for line in lines:
        say(line)
    return drawn + "".join(f"<p>{html.escape(line)}</p>" for line in lines)


def _figure(svg: str, caption: str) -> str:
    return f"<figure>{svg}<figcaption>{caption}</figcaption></figure>"


def _table(rows: Iterable[tuple[str, str, str]], heads: tuple[str, str, str]) -> str:
    head = ""
    if any(heads):
        cells = "".join(
            f"<th{' class=n' if column == 1 else ''}>{title}</th>"
            for column, title in enumerate(heads)
        )
        head = f"<thead><tr>{cells}</tr></thead>"
    body = "".join(
        f"<tr><td>{name}</td><td class=n>{value}</td><td class=what>{what}</td></tr>"
        for name, value, what in rows
    )
    return f"<div class=scroll><table>{head}<tbody>{body}</tbody></table></div>"


def _glossary() -> str:
    entries = "".join(f"<dt>{term}</dt><dd>{text}</dd>" for term, text in _HOW_TO_READ)
    return f"<dl>{entries}</dl>"


def _parameters(run: Run) -> str:
    """All of them; those that are not at their default stand out."""
    rows = "".join(
        f"<tr{' class=changed' if changed else ''}><td><code>{html.escape(name)}</code></td>"
        f"<td class=n>{html.escape(value)}</td><td class=what>{html.escape(what)}</td></tr>"
        for name, value, what, changed in words.parameters(run)
    )
    return (
        "<p class=what>Bold: not at its default.</p>"
        f"<div class=scroll><table><tbody>{rows}</tbody></table></div>"
    )
