# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What ``evaluate`` writes for other tools: a bag, a Rerun recording, the figures of a paper."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path

from trajeval_ros.commands import figures
from trajeval_ros.commands.console import CommandError
from trajeval_ros.commands.inputs import Inputs
from trajeval_ros.comparison.compare import Comparison
from trajeval_ros.comparison.words import sentences
from trajeval_ros.files.mcap import BagWriteError, message_types
from trajeval_ros.online.parameters import Value, of_estimate
from trajeval_ros.online.settings import settings_of
from trajeval_ros.report import answers
from trajeval_ros.report.curves import Curves, aligned, curves
from trajeval_ros.runs import rrd
from trajeval_ros.runs.offline import Scored, Scoring
from trajeval_ros.runs.recording import Recorded, Recording


@dataclass(frozen=True)
class Finished:
    """A run that has been scored.

    ``recorded``: of each estimate, where a bag is asked for.
    """

    data: Inputs
    parameters: Mapping[str, Value]
    scorings: Mapping[str, Scoring]
    found: Mapping[str, Scored]
    comparisons: Sequence[Comparison]
    recorded: Mapping[str, Recorded]

    def curves(self) -> dict[str, Curves]:
        """What there is to draw of each estimate that has an ATE, by its name."""
        settings = settings_of(self.parameters, self.data.names)
        drawn = {
            name: curves(
                one.evaluated,
                one.summary,
                self.scorings[name].report.track.poses(),
                settings.evaluation,
                settings.estimates[name].time_offset,
            )
            for name, one in self.found.items()
        }
        return {name: one for name, one in drawn.items() if one is not None}


@dataclass
class Exports:
    """Where each is to be written; None: not at all.

    After :meth:`write`: a line for each that is ``written``, and for each that could not be.
    """

    mcap: str | None = None
    rerun: str | None = None
    figures: str | None = None
    written: list[str] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)

    def require_libraries(self) -> None:
        """Refuse, before anything is computed, what could not be written.

        Raises
        ------
        CommandError
            If a library is not installed.
        """
        if self.mcap:
            try:
                message_types()
            except BagWriteError as error:
                raise CommandError(f"--mcap: {error}") from error
        if self.rerun:
            try:
                rrd.library()
            except rrd.RecordingError as error:
                raise CommandError(f"--rerun: {error}") from error
        if self.figures and find_spec("matplotlib") is None:
            raise CommandError(
                "--figures: drawing needs the library matplotlib: pip install matplotlib"
            )

    def recorded(self, names: Sequence[str]) -> dict[str, Recorded]:
        """Where what is to be in the bag is kept, of each estimate."""
        return {name: Recorded() for name in names} if self.mcap else {}

    def write(self, run: Finished) -> None:
        """Write what is asked for; what fails costs itself alone."""
        writers: tuple[tuple[str | None, Callable[[Finished, Path], str]], ...] = (
            (self.mcap, _write_mcap),
            (self.rerun, _write_rerun),
            (self.figures, _write_figures),
        )
        for where, write in writers:
            if where:
                path = Path(where).expanduser()
                is_new = not path.parent.is_dir()
                try:
                    line = write(run, path)
                    self.written.append(f"{line} (its folder is new)" if is_new else line)
                except (BagWriteError, rrd.RecordingError, CommandError) as error:
                    self.failures.append(str(error))


def _write_mcap(run: Finished, path: Path) -> str:
    estimates = dict(zip(run.data.names, run.data.estimates, strict=True))
    summaries = {name: one.summary for name, one in run.found.items()}
    recording = Recording(
        run.data.ground_truth, estimates, run.recorded, summaries, run.comparisons
    )
    recording.write(path)
    return f"Written: {path.absolute()}"


def _write_rerun(run: Finished, path: Path) -> str:
    shown = [
        rrd.Shown(
            drawn,
            run.found[name].evaluated.ground_truth,
            aligned(run.found[name].evaluated, run.found[name].summary),
            run.scorings[name].report.track.poses(),
        )
        for name, drawn in run.curves().items()
    ]
    if not shown:
        raise CommandError("--rerun: there is no ATE to be shown")
    way = next(iter(run.scorings.values())).report.way
    said = [f"{text}." for text in sentences(run.comparisons)]
    said += [
        rrd.markdown(name, answers.answer(one.summary, of), figures.summary_lines(one.summary, of))
        for name, one in run.found.items()
        for of in [of_estimate(run.parameters, name)]
    ]
    rrd.write_recording(path, way, shown, "\n\n".join(said))
    return f"Written: {path.absolute()}"


def _write_figures(run: Finished, folder: Path) -> str:
    # Only now: this brings in matplotlib.
    from trajeval_ros.report import paper

    drawn = list(run.curves().values())
    if not drawn:
        raise CommandError("--figures: there is no ATE to be drawn")
    try:
        names = paper.write_figures(folder, drawn)
    except OSError as error:
        raise CommandError(f"cannot write {folder}: {error.strerror or error}") from error
    return f"Written: {len(names)} files in {folder.absolute()}"
