"""The cell magic `%%bash` of the tutorial: what commands print, without their progress."""

from __future__ import annotations

import os
import subprocess
from typing import Any


def bash(_: str, commands: str) -> None:
    """Print the output of commands; a command that fails fails the page."""
    done = subprocess.run(
        ["bash", "-e", "-c", commands], capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(done.stdout + done.stderr)
    print(done.stdout.rstrip())  # noqa: T201


def load_ipython_extension(shell: Any) -> None:
    """Register the magic; commands print as into a file."""
    os.environ.pop("FORCE_COLOR", None)  # set by Jupyter
    shell.register_magic_function(bash, "cell")
