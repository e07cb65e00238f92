# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What every reader of trajectories returns, and the one error they raise."""

import dataclasses

import numpy as np
import numpy.typing as npt

from trajeval_ros.files.fixes import FixCounts
from trajeval_ros.online.samples import PoseSamples

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


class TrajectoryFileError(Exception):
    """A file cannot be read as a trajectory. One line, naming the file and, if any, the row.

    Args:
        source: the file, as the user named it.
        reason: what is wrong with it.
        row: the line in the file, from 1; for a bag, the message in its topic.

    >>> import trajeval_ros as te
    >>> try:
    ...     te.read_tum("not_there.txt")
    ... except te.TrajectoryFileError as error:
    ...     print(error.source, "-", error.reason)
    not_there.txt - it cannot be read: no such file or directory
    """

    def __init__(self, source: str, reason: str, row: int | None = None) -> None:
        where = source if row is None else f"{source}, row {row}"
        super().__init__(f"{where}: {reason}")
        self.source = source
        self.reason = reason
        self.row = row


@dataclasses.dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses as they stand in a file, in the order of their stamps; nothing is judged.

    Values that are not finite and quaternions of any norm are kept: the engine counts them by
    reason. Only a row whose stamp is not finite cannot be kept, because a stamp is an integer, and
    of rows with one stamp only the last is; the others are listed for the caller to count as
    received and rejected.

    Attributes:
        stamps: (N,) int64 ns, as exact as the file has them.
        positions: (N, 3), m.
        quaternions: (N, 4), x y z w, as in the file: not normalised.
        rows: (N,) int64, each pose's line in the file from 1, or message in its topic from 1.
        source: the file, and the topic, as the user named them.
        covariances: (N, 6, 6) about fixed axes as in ROS messages, or None where there are none.
        non_finite_stamp_rows: (K,) int64, rows left out.
        cut: how many rows were left out because they lie outside the span that was asked for.
        superseded_rows: (L,) int64, rows left out because a later one has the same stamp.
        has_orientation: False where the file has none: the quaternions are 0 0 0 1 then.
        latest_path: of whole trajectories that are published again and again, the latest: the poses
            are those of each stamp as they came first.
        fixes: of what modes, where they are a GNSS receiver's.
        remarks: what was read differently from the plain format, a clause each.
    """

    stamps: Integers
    positions: Array
    quaternions: Array
    rows: Integers
    source: str
    covariances: Array | None = None
    non_finite_stamp_rows: Integers = dataclasses.field(
        default_factory=lambda: np.zeros(0, dtype=np.int64)
    )
    cut: int = 0
    superseded_rows: Integers = dataclasses.field(
        default_factory=lambda: np.zeros(0, dtype=np.int64)
    )
    has_orientation: bool = True
    remarks: tuple[str, ...] = ()
    latest_path: PoseSamples | None = None
    fixes: FixCounts | None = None

    def __post_init__(self) -> None:
        count = len(self.stamps)
        shapes = {"stamps": (), "positions": (3,), "quaternions": (4,), "rows": ()}
        if self.covariances is not None:
            shapes["covariances"] = (6, 6)
        for name, shape in shapes.items():
            array = getattr(self, name)
            if array.shape != (count, *shape):
                raise ValueError(f"{name} must be {(count, *shape)}, got {array.shape}")
            array.flags.writeable = False
        if self.stamps.dtype != np.int64:
            raise ValueError(f"stamps must be int64 nanoseconds, got {self.stamps.dtype}")

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def samples(self) -> PoseSamples:
        """The poses as the engine takes them."""
        return PoseSamples(self.stamps, self.positions, self.quaternions, self.covariances)

    def where(self, row: int) -> str:
        """File and row, one of `rows` or of those left out, as in the errors."""
        return f"{self.source}, row {row}"
