# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The package as colcon (ament_python) and pip build it."""

import zlib
from glob import glob
from pathlib import Path

from setuptools import Extension, find_packages, setup
from setuptools.command.build_ext import build_ext

PACKAGE = "trajeval_ros"
SHARE = f"share/{PACKAGE}"

EXTRAS = {
    # ROS 2 Jazzy for a machine without it; apt's packages serve a machine with it.
    "ros": ["ros-jazzy-rclpy[fastrtps]", "ros-jazzy-common-interfaces"],
    # evaluate bag, replay bag
    "bags": ["rosbags>=0.10"],
    # NavSatFix
    "gnss": ["pyproj>=3.4"],
    # evaluate --figures
    "report": ["matplotlib>=3.6"],
    # watch: the page of the running figures
    "watch": ["aiohttp>=3.9"],
    # evaluate --rerun; half a gigabyte, and NumPy 2
    "rerun": ["rerun-sdk>=0.41"],
    # Intervals by the stationary bootstrap where two estimates are compared
    "comparison": ["arch>=6.2"],
    # Result.poses.to_pandas()
    "tables": ["pandas>=2"],
    # benchmark, te.benchmark: many runs, on a cluster
    "benchmark": ["dask>=2024.8", "distributed>=2024.8", "pandas>=2", "pyarrow>=15"],
    # Completion of the command line: docs/files.md
    "completion": ["argcomplete>=3"],
    # The live view of demo
    "terminal": ["rich>=13"],
    "test": [
        "pytest>=7.4",
        "pytest-xdist>=3",
        "hypothesis>=6.98",
        "catkin-pkg",
        "mcap",
        "evo",
        "mpmath",
        "nbclient",
        "ipykernel",
        "playwright",
    ],
    "bench": ["evo", "scikit-learn"],
    "check": ["import-linter", "mypy", "pre-commit", "ruff", "types-PyYAML"],
}
WARNINGS = ["-Wall", "-Wextra"]
# Loops in C, without which NumPy does the same, slower: no compiler is no reason to fail. They know
# nothing of Python. No contraction to fused operations, so that every machine has the same digits.
SOURCES = sorted(glob(f"{PACKAGE}/loops/*.[ch]"))
CHECKSUM = zlib.crc32(b"".join(Path(path).read_bytes() for path in SOURCES))
LOOPS = Extension(
    f"{PACKAGE}.loops._loops",
    sources=[path for path in SOURCES if path.endswith(".c")],
    depends=SOURCES,
    define_macros=[("LOOPS_SOURCES", f"{CHECKSUM}u")],
    extra_compile_args=["-std=c11", "-O3", "-ffp-contract=off", "-fno-math-errno", *WARNINGS],
    libraries=["m"],
    optional=True,
)


class Build(build_ext):
    """Leaves no library of earlier sources to be installed where these cannot be compiled."""

    def build_extension(self, ext):
        try:
            super().build_extension(ext)
        except Exception:
            Path(self.get_ext_fullpath(ext.name)).unlink(missing_ok=True)
            raise


EXTRAS["demo"] = EXTRAS["ros"] + EXTRAS["terminal"] + EXTRAS["watch"]

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Live evaluation of an estimated trajectory against ground truth on SE(3)",
    author="The trajeval_ros authors",
    maintainer="The trajeval_ros authors",
    maintainer_email="maintainers@trajeval-ros.example",
    license="Apache-2.0",
    python_requires=">=3.11",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    ext_modules=[LOOPS],
    cmdclass={"build_ext": Build},
    package_data={"": ["py.typed", "*.css", "*.html", "*.js", "*.LICENSE"]},
    zip_safe=False,
    # PyYAML comes with rclpy; evaluate --params needs it on a machine without ROS too.
    install_requires=["numpy>=1.26", "scipy>=1.11", "PyYAML>=6.0", "setuptools"],
    extras_require=EXTRAS,
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (SHARE, ["package.xml"]),
        (f"{SHARE}/config", sorted(glob("config/*.yaml") + glob("config/*.rviz"))),
        (f"{SHARE}/launch", sorted(glob("launch/*.py"))),
        (f"{SHARE}/dashboards", sorted(glob("dashboards/*"))),
    ],
    entry_points={
        "console_scripts": [
            "evaluator = trajeval_ros.node.main:main",
            "evaluate = trajeval_ros.commands.evaluate:main",
            "replay = trajeval_ros.commands.replay:main",
            "demo = trajeval_ros.commands.demo:main",
            "simulate = trajeval_ros.commands.simulate:main",
            "benchmark = trajeval_ros.commands.benchmark:main",
            "watch = trajeval_ros.commands.watch:main",
        ],
    },
)
