"""The command: its entry, and the one place where known errors become exit codes.

Each file holds a family of commands. A command parses, calls and prints: no arithmetic, and heavy
imports only after the options are checked, so that `fidpipe --help` answers at once.
"""

from __future__ import annotations

import errno
import gc
import os
import re
import signal
import sys
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from time import monotonic
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption

from ...schemas.docstrings import split_docstring
from ...schemas.errors import FidpipeError
from .datasets import pair, synth, twin
from .diagnosing import diagnose, tasks
from .experiments import ablate, perturb
from .judging import compare, gate
from .options import EXIT_INTERRUPTED, EXIT_WRONG_INPUT
from .running import best_case, check, run, settings, status
from .show_report_export import export, report, show

#: Python's 700 cost the imports of a small command 5 % of its time.
_OBJECTS_BETWEEN_COLLECTIONS = 100_000
_SECONDS_TO_STOP = 10.0
_SECONDS_UNTIL_AGAIN = 0.01
#: A batch system that ends a job means what Ctrl-C means; the alarm is of `_stop_again`.
_STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)
#: By the system, not our bugs.
_REFUSALS = (
    *(errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.EFBIG),
    *(errno.ENAMETOOLONG, errno.ELOOP, errno.ENOTDIR, errno.EIO, errno.ESTALE),
)


class _ShortTypes:
    """Help in which flags have no type, and ranges a short one."""

    def get_params(self, ctx: Any) -> Any:
        """The parameters."""
        params = super().get_params(ctx)  # type: ignore[misc]
        for param in params:
            if not isinstance(param, TyperOption) or param.metavar is not None:
                continue
            if param.is_flag:
                param.metavar = ""
            elif param.type_descriptor.is_ranged:
                param.metavar = "NUMBER"
        return params


class _Command(_ShortTypes, TyperCommand):
    """A command whose docstring describes its parameters; no empty lines between examples."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        text, meanings = split_docstring(self.help or "")
        self.help = re.sub(
            r"^(fidpipe .*)\n\n(?=fidpipe )", r"\1  \n", text, flags=re.MULTILINE
        )
        param: Any
        for param in self.params:
            param.help = meanings.get(param.name, param.help)
            param.secondary_opts = []  # flags have no --no-flag


class _Group(_ShortTypes, TyperGroup):
    """All commands."""


def main() -> None:
    """Run the command and exit with its code."""
    gc.set_threshold(_OBJECTS_BETWEEN_COLLECTIONS)
    _open_streams()
    from ..storage.scratch import scratch_folder

    for number in _STOPPING:
        signal.signal(number, _Stop())
    sys.unraisablehook = _stop_again
    try:
        with scratch_folder(), _local_arguments():
            code = _application(*sys.argv[1:2])(standalone_mode=False)
        _ignore_interrupts()
    except (KeyboardInterrupt, typer.Abort):
        code = EXIT_INTERRUPTED
    except Exception as error:
        text = _explained(error)
        if not text:
            raise
        _complain(text)
        code = getattr(error, "exit_code", EXIT_WRONG_INPUT)
    _ignore_interrupts()
    if code == EXIT_INTERRUPTED:  # typer turns Ctrl-C into this code
        _complain("interrupted; run the same command again to resume")
    if "velodyne_decoder" not in sys.modules:  # it complains about what is not collected
        gc.freeze()  # or Python searches all modules for garbage
    sys.exit(_flushed(code))


def _local_arguments() -> AbstractContextManager[None]:
    """Replaces the URLs among the arguments by local paths while the command runs."""
    if not any("://" in word for word in sys.argv):
        return nullcontext()
    from ..storage.remote_run import local_arguments

    return local_arguments(sys.argv)


def _open_streams() -> None:
    """Redirect closed standard streams to the null device; files would get their descriptors."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            null = Path(os.devnull)
            stream = null.open(mode, encoding="utf-8")
            os.set_inheritable(stream.fileno(), True)
            setattr(sys, name, stream)


def _flushed(code: int | None) -> int | None:
    """Exit code after all output is flushed; 1 if that fails and there was no other error."""
    try:
        sys.stdout.flush()
        return code
    except OSError as error:
        if error.errno != errno.EPIPE and not code:
            # who reads from a pipe may stop at any time
            _complain(f"error: {_refusal(error) or error}")
        # or Python tries again, and complains
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return code or EXIT_WRONG_INPUT


def _explained(error: Exception) -> str:
    """One line on an error that is not our bug, with the next step; else ""."""
    if isinstance(error, FidpipeError):
        return f"error: {error}"
    if isinstance(error, OSError) and _refusal(error):
        return f"error: {_refusal(error)}"
    if isinstance(error, UnicodeEncodeError):
        # Python reads bytes that are not UTF-8 as surrogates
        name = error.object[: error.end].split()[-1].strip("'\"")
        return f"error: the name {name!a} is not UTF-8; rename the file or folder"
    if isinstance(error, MemoryError):
        reason = str(error) or "none left"
        return f"error: not enough memory ({reason}); free some, or raise ulimit -v"
    return _usage_words(error) if hasattr(error, "format_message") else ""


def _usage_words(error: Any) -> str:
    """One line on wrong usage, as typer raises it; without a command, the help."""
    text: str = error.format_message()
    context = getattr(error, "ctx", None)
    if context is None or not sys.argv[1:]:
        return text
    return f"error: {text.rstrip('.')}; see {context.command_path} --help"


def _refusal(error: OSError) -> str:
    """Message of an error of the system with the next step; "" if the error has another cause."""
    if error.errno == errno.ENOENT and error.filename is None:
        return "the folder in which the command was started is gone; change to another one"
    if error.errno in (errno.EMFILE, errno.ENFILE):
        return f"{error.strerror}; raise ulimit -n, or take fewer --workers"
    if error.errno not in _REFUSALS:
        return ""
    if error.filename is None:
        return f"standard output: {error.strerror}; files that were written are intact"
    return f"{error.filename}: {error.strerror}; allow it there, or name another place"


class _Stop:
    """Ends the command at the first Ctrl-C; for some seconds, more of them do nothing."""

    last = -_SECONDS_TO_STOP

    def __call__(self, *_: object) -> None:
        """Called by Python in the main thread; raises KeyboardInterrupt."""
        if monotonic() - _Stop.last >= _SECONDS_TO_STOP:
            _Stop.last = monotonic()
            raise KeyboardInterrupt


def _stop_again(unraisable: Any) -> None:
    """Raise Ctrl-C again if it came in a garbage collection, where Python only prints it."""
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        _Stop.last = -_SECONDS_TO_STOP
        signal.setitimer(signal.ITIMER_REAL, _SECONDS_UNTIL_AGAIN)
    else:
        sys.__unraisablehook__(unraisable)


def _ignore_interrupts() -> None:
    """Ignore signals until the process ends: Python removes our handlers before, but not these."""
    for number in _STOPPING:
        signal.signal(number, signal.SIG_IGN)


def _complain(text: str) -> None:
    from ..terminal import Terminal, shown

    Terminal(stderr=True, soft_wrap=True).print(shown(text), markup=False, style="red")


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        print(f"fidpipe {version('fidpipe')}")
        raise typer.Exit


def _root(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Print the version."),
    ] = False,
) -> None:
    """Measure how faithful simulated LiDAR is, and where it fails.

    fidpipe compares real and simulated scans object by object: what is missing, what is invented,
    and how far the geometry (CDC) and the structure (r_lambda, r_gap) of each common object have
    drifted.

    Begin with check, run, show and compare.

    Example: fidpipe run dataset/ --preset reference, where dataset/real and dataset/sim hold files
    of the same names
    """


_COMMANDS = {
    "Evaluate": (check, run, show, report, diagnose, tasks),
    "Compare": (compare, gate, best_case),
    "Data": (pair, synth, twin),
    "Research": (perturb, ablate),
    "Other": (status, export, settings),
}


def _application(name: str = "") -> typer.Typer:
    """The command of this name, or all if there is none: each takes milliseconds to set up."""
    application = typer.Typer(
        name="fidpipe",
        cls=_Group,
        rich_markup_mode="markdown",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    application.callback()(_root)
    commands = []
    for heading, of_heading in _COMMANDS.items():
        commands += [(command, heading) for command in of_heading]
    wanted = [entry for entry in commands if entry[0].__name__ == name.replace("-", "_")]
    for command, heading in wanted or commands:
        application.command(cls=_Command, rich_help_panel=heading)(command)
    return application


app = _application()
