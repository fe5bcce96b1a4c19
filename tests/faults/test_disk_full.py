"""A disk that is full ends a run once, and no finished batch is lost."""

import errno
import os
import re

import pytest

from fidpipe.pipeline.storage.scratch import temporary_space
from fidpipe.schemas.errors import DiskFullError, ScanError
from runs import JOBS_PER_PAIR, assert_same_tables, run

N_PAIRS = 3


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_a_full_disk_stops_a_run_once_with_its_path(dataset, tmp_path, monkeypatch, number):
    rename = os.replace
    written = []

    def fill(*names):
        written.append(names)
        if len(written) > 12:
            raise OSError(number, os.strerror(number))
        rename(*names)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", fill)
        with pytest.raises(DiskFullError) as error:
            run(dataset, tmp_path / "run")
    told = str(error.value)
    assert re.search(rf"run/\w+/00\d\S*\.parquet: {os.strerror(number)}; make room", told)
    assert "\n" not in told
    assert not (tmp_path / "run" / "pairs.parquet").exists()
    assert run(dataset, tmp_path / "run").n_made == 3 * JOBS_PER_PAIR
    run(dataset, tmp_path / "fresh")
    assert_same_tables(tmp_path / "run", tmp_path / "fresh")


def test_a_reader_that_is_out_of_temporary_space_is_a_full_folder_and_not_a_broken_file():
    def read():
        try:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            raise ScanError("000.bag: cannot be read") from error

    with pytest.raises(DiskFullError, match="TMPDIR: no space left in"), temporary_space():
        read()
    with pytest.raises(ScanError), temporary_space():
        raise ScanError("000.bag: cannot be read")
