# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A trajectory as two arrays, and from files."""

from __future__ import annotations

from pathlib import PurePath

import numpy as np
import numpy.typing as npt

from trajeval_ros import se3
from trajeval_ros.files import trajectory as files
from trajeval_ros.files.text import PathLike
from trajeval_ros.online.samples import PoseSamples

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

# As far as a matrix may be from a rotation, in any entry of R^T R; as in KITTI's files.
_ORTHONORMAL_TO = 1e-2


class Trajectory:
    """Poses over time.

    ``stamps``: (N,), int64 nanoseconds; or float seconds, which resolve 0.24 us where they count
    from 1970. ``poses``: (N, 4, 4) T_world_body, m; or (N, 7), ``x y z qx qy qz qw``.
    ``covariances``: (N, 6, 6), about the fixed axes of the world, translation first, m and rad, as
    in a ROS ``PoseWithCovariance``; used where ``ground_truth_use_covariance=True`` (or
    ``estimate_use_covariance=True``) is set. ``name``: what sentences and reports call it.

    Nothing is sorted or left out: what cannot be used is counted by its reason in the result.

    Raises :class:`ValueError` for shapes that do not fit, stamps that are not finite, and matrices
    that are no rotations to 1e-2.

    >>> import numpy as np
    >>> import trajeval_ros as te
    >>> poses = np.tile(np.eye(4), (3, 1, 1))
    >>> te.Trajectory(np.array([0.0, 0.1, 0.2]), poses, name="still")
    Trajectory('still', 3 poses, 0.2 s)
    """

    def __init__(
        self,
        stamps: npt.ArrayLike,
        poses: npt.ArrayLike,
        covariances: npt.ArrayLike | None = None,
        *,
        name: str = "trajectory",
    ) -> None:
        nanoseconds = nanoseconds_of(np.asarray(stamps))
        positions, quaternions = _split(np.array(poses, dtype=np.float64))
        self.name = name
        self._data = files.Trajectory(
            stamps=nanoseconds,
            positions=positions,
            quaternions=quaternions,
            rows=np.arange(1, len(nanoseconds) + 1),
            source=name,
            covariances=None if covariances is None else np.array(covariances, dtype=np.float64),
        )

    @classmethod
    def _of_file(cls, data: files.Trajectory, name: str | None) -> Trajectory:
        made = cls.__new__(cls)
        made.name = PurePath(data.source).stem if name is None else name
        made._data = data
        return made

    def with_data(self, data: files.Trajectory) -> Trajectory:
        """Return a trajectory of the same name with other rows."""
        return self._of_file(data, self.name)

    @property
    def stamps(self) -> Stamps:
        """(N,) int64, ns."""
        return self._data.stamps

    @property
    def poses(self) -> Array:
        """(N, 4, 4) T_world_body, m.

        Raises :class:`ValueError` where a row of a file is no pose: not finite, or a quaternion of
        zero.
        """
        return se3.from_position_quaternion(self._data.positions, self._data.quaternions)

    @property
    def covariances(self) -> Array | None:
        """(N, 6, 6), about the fixed axes of the world; None where there are none."""
        return self._data.covariances

    @property
    def data(self) -> files.Trajectory:
        """The rows as they were read."""
        return self._data

    @property
    def samples(self) -> PoseSamples:
        """The rows as the engine takes them."""
        return self._data.samples

    def __len__(self) -> int:
        """Number of poses."""
        return len(self._data)

    def __repr__(self) -> str:
        seconds = float(np.ptp(self.stamps) * 1e-9) if len(self) else 0.0
        return f"Trajectory({self.name!r}, {len(self):,} poses, {seconds:.4g} s)"


def nanoseconds_of(stamps: npt.NDArray[np.generic]) -> Stamps:
    """Stamps in ns, of ns (integers) or seconds (floats)."""
    if np.issubdtype(stamps.dtype, np.integer):
        return stamps.astype(np.int64)
    seconds = stamps.astype(np.float64)
    if not (np.abs(seconds) < 9.2e9).all():
        raise ValueError("stamps must be int64 nanoseconds or finite seconds, below 9.2e9")
    return np.asarray(np.rint(seconds * 1e9).astype(np.int64))


def _split(poses: Array) -> tuple[Array, Array]:
    """Positions (N, 3) and quaternions (N, 4)."""
    if poses.ndim == 2 and poses.shape[1] == 7:
        return poses[:, :3].copy(), poses[:, 3:].copy()
    if poses.ndim != 3 or poses.shape[1:] != (4, 4):
        raise ValueError(f"poses must be (N, 4, 4) or (N, 7), got {poses.shape}")
    rotations = poses[:, :3, :3]
    if not np.isfinite(poses).all():
        raise ValueError("poses must be finite")
    products = np.swapaxes(rotations, 1, 2) @ rotations
    bad = np.abs(products - np.eye(3)).max(axis=(1, 2), initial=0.0) > _ORTHONORMAL_TO
    bad |= np.linalg.det(rotations) < 0.0
    if bad.any():
        raise ValueError(f"poses[{int(np.argmax(bad))}] holds no rotation")
    return se3.to_position_quaternion(poses)


def read_tum(path: PathLike, *, name: str | None = None) -> Trajectory:
    r"""Read rows of ``stamp[s] tx ty tz qx qy qz qw``; stamps exact to the nanosecond.

    ``name``: the file's, without its ending, where None. Raises
    :class:`~trajeval_ros.TrajectoryFileError`, which names file and row.

    >>> import pathlib, tempfile
    >>> import trajeval_ros as te
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "odometry.txt")
    ...     _ = path.write_text("0.1 0 0 0 0 0 0 1\n0.2 1 0 0 0 0 0 1\n")
    ...     te.read_tum(path)
    Trajectory('odometry', 2 poses, 0.1 s)
    """
    from trajeval_ros.files.tum import read_tum as read

    return Trajectory._of_file(read(path), name)


def read_euroc(path: PathLike, *, name: str | None = None) -> Trajectory:
    r"""Read EuRoC's csv: ``stamp[ns] px py pz qw qx qy qz`` and maybe nine columns more.

    As :func:`read_tum`.

    >>> import pathlib, tempfile
    >>> import trajeval_ros as te
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "data.csv")
    ...     _ = path.write_text("100,0,0,0,1,0,0,0\n200,1,0,0,1,0,0,0\n")
    ...     te.read_euroc(path).stamps.tolist()
    [100, 200]
    """
    from trajeval_ros.files.euroc import read_euroc as read

    return Trajectory._of_file(read(path), name)


def read_kitti(
    path: PathLike, times: PathLike | None = None, *, name: str | None = None
) -> Trajectory:
    r"""Read KITTI's rows of twelve numbers, and their stamps [s] from the file ``times``.

    Without it they are 0.1 s apart, as the benchmark's are.

    As :func:`read_tum`.

    >>> import pathlib, tempfile
    >>> import trajeval_ros as te
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path, times = pathlib.Path(folder, "00.txt"), pathlib.Path(folder, "times.txt")
    ...     _ = path.write_text("1 0 0 5 0 1 0 0 0 0 1 0\n"), times.write_text("0.0\n")
    ...     te.read_kitti(path, times).poses[0, :3, 3].tolist()
    [5.0, 0.0, 0.0]
    """
    from trajeval_ros.files.kitti import read_kitti as read

    return Trajectory._of_file(read(path, times), name)


def read_bag(path: PathLike, topic: str, *, name: str | None = None) -> Trajectory:
    """Read a topic of a bag: ROS 1, or ROS 2 (sqlite3, mcap); by the header's stamps.

    ``topic``: of poses, odometry or transforms, or ``/tf:PARENT.CHILD``. ``name``: the topic
    where None. Needs the extra ``bags``, not ROS. Raises
    :class:`~trajeval_ros.TrajectoryFileError`, also where that is missing.

    >>> import trajeval_ros as te
    >>> te.read_bag("absent.mcap", "/odom")
    Traceback (most recent call last):
    ...
    trajeval_ros.files.trajectory.TrajectoryFileError: absent.mcap: ...
    """
    from trajeval_ros.files.bag import read_bag as read

    (data,) = read(path, [topic])
    return Trajectory._of_file(data, topic if name is None else name)
