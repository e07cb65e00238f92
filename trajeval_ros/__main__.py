# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``python -m trajeval_ros COMMAND ...``: the commands, where their scripts are not on the path."""

import importlib
import sys

from trajeval_ros import __version__

COMMANDS = {
    "evaluate": "commands.evaluate",
    "replay": "commands.replay",
    "simulate": "commands.simulate",
    "demo": "commands.demo",
    "benchmark": "commands.benchmark",
    "watch": "commands.watch",
    "evaluator": "node.main",
}

USAGE = f"usage: python -m trajeval_ros [--version] {{{','.join(COMMANDS)}}} ..."


def main() -> int:
    """Run a command; return its exit code."""
    name, *rest = sys.argv[1:] or ["--help"]
    if name == "--version":
        sys.stdout.write(f"trajeval_ros {__version__}\n")
        return 0
    if name in ("-h", "--help"):
        sys.stdout.write(USAGE + "\n")
        return 0
    if name not in COMMANDS:
        sys.stderr.write(f"{USAGE}\ntrajeval_ros: error: there is no command {name!r}\n")
        return 2
    command = importlib.import_module(f"trajeval_ros.{COMMANDS[name]}")
    sys.argv = [name, *rest]
    code: int = command.main()
    return code


if __name__ == "__main__":
    sys.exit(main())
