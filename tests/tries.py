"""Start the command in a real process, harm it, run it again, and compare with an undisturbed run."""

import os
import re
import subprocess
import time

import psutil

from runs import FIDPIPE, assert_same_tables, command, tables, temporary_files


class Started:
    """The command in a separate session, so that its processes can be found after it has ended."""

    def __init__(self, *words, **environment):
        self.process = subprocess.Popen(
            [FIDPIPE, *map(str, words)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            env={**os.environ, **environment},
        )

    def workers(self):
        """The worker processes, as they are now."""
        try:
            family = psutil.Process(self.process.pid).children(recursive=True)
            return [member for member in family if member.ppid() != self.process.pid]
        except psutil.NoSuchProcess:
            return []

    def family(self):
        """All processes of the session that have not ended."""
        found = []
        for process in psutil.process_iter():
            try:
                if (
                    os.getsid(process.pid) == self.process.pid
                    and process.status() != psutil.STATUS_ZOMBIE
                ):
                    found.append(process)
            except (ProcessLookupError, psutil.NoSuchProcess):
                continue
        return found

    def wait_for(self, is_so, timeout=120):
        """True if a condition became true before the command ended."""
        end = time.monotonic() + timeout
        while not is_so():
            if self.process.poll() is not None:
                return False
            if time.monotonic() > end:
                raise TimeoutError
            time.sleep(0.005)
        return True

    def ends_within(self, seconds):
        """True if the command ends within this time."""
        try:
            self.process.wait(seconds)
        except subprocess.TimeoutExpired:
            return False
        return True

    def end(self, timeout=300):
        """Wait for the end; returns exit code and standard error. No process may be left."""
        _, errors = self.process.communicate(timeout=timeout)
        wait_until(lambda: not self.family())
        return self.process.returncode, errors


def wait_until(is_so, timeout=60):
    end = time.monotonic() + timeout
    while not is_so():
        if time.monotonic() > end:
            raise TimeoutError(is_so)
        time.sleep(0.005)


def n_lost(out, undisturbed):
    """Pairs whose rows are not those of an undisturbed run."""
    rows = {row["pair_id"]: row for row in tables(out)["pairs.parquet"].to_pylist()}
    expected = tables(undisturbed)["pairs.parquet"].to_pylist()
    return sum(rows.get(row["pair_id"]) != row for row in expected)


def assert_resumes(dataset, out, undisturbed, workers=1, code=0, start=command):
    """The next run ends with this code and the tables of an undisturbed one; gives what it said."""
    again = start("run", dataset, "--out", out, "--workers", workers, code=code)
    assert "Traceback" not in again.stderr
    assert_same_tables(out, undisturbed)
    assert temporary_files(out) == []
    return again.stdout + again.stderr


def lines_of(errors):
    """Lines of standard error without those of progress."""
    return [
        line
        for line in errors.splitlines()
        if line.strip() and not re.search(r"\d+ pairs?, \d+ failed", line)
    ]
