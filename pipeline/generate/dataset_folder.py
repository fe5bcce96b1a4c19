"""The folder of a generated dataset: `real/`, `sim/`, its recipe, and a manifest that is written last.

Each file is written atomically and depends on the recipe alone, so that an interrupted command
resumes with the missing files.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from ...schemas.columns import SIDES
from ...schemas.data_files import parse_toml
from ..datasets.pairs import LABEL_NAMES, MANIFEST
from ..storage.files import refuse_link, write_whole
from ..storage.folder import refuse_other_content, refuse_overwrite

Recipe = dict[str, Any]
#: Entries of a recipe that do not affect any file.
_IGNORED = ("recording",)


def prepare_folder(
    out: Path,
    recipe_name: str,
    recipe: Recipe,
    own_files: Callable[[Path, Recipe], set[Path] | None],
    files: set[Path],
    label_names: Mapping[int, str],
    *,
    replace: bool,
) -> None:
    """Create the folder, write recipe and label names, and remove files of an earlier dataset that this one lacks.

    Parameters
    ----------
    recipe_name : file name of the recipe
    recipe : everything that the files depend on
    own_files : returns the existing files of an earlier dataset from `out` and its recipe; None if
        another command wrote that
    files : scans and labels of the new dataset
    replace : allow files of a finished dataset to be removed

    Raises
    ------
    FidpipeError
        The folder holds something else, or a finished dataset whose files would be removed; nothing
        is written then.
    """
    import tomli_w

    for side in SIDES:
        refuse_link(out / side)
    earlier = None
    with suppress(OSError, ValueError):  # TOML and unicode errors are ValueErrors
        earlier = parse_toml((out / recipe_name).read_text(encoding="utf-8"))
    existing = None if earlier is None else own_files(out, earlier)
    kind = f"a dataset of fidpipe {recipe_name.removesuffix('.toml')}"
    refuse_other_content(f"dataset {out}", out, kind, is_own=existing is not None, other="folder")
    out.mkdir(parents=True, exist_ok=True)
    text = tomli_w.dumps(recipe)
    if earlier is not None and existing is not None:
        changes = _changes(earlier, tomllib.loads(text))
        lost = existing if changes else existing - files
        n_lost = len(_stems(lost))
        n_existing = len(_stems(existing))
        if n_lost and not replace and (out / MANIFEST).exists():
            why = changes or [f"pairs was {n_existing}, is {len(_stems(files))}"]
            refuse_overwrite(f"dataset {out}", f"{n_lost} of its {n_existing} pairs", why, "folder")
        (out / MANIFEST).unlink(missing_ok=True)
        for path in {*lost, *([out / LABEL_NAMES] if changes else [])}:
            path.unlink(missing_ok=True)
    write_whole(out / recipe_name, text.encode())
    if label_names:
        names = tomli_w.dumps({str(number): name for number, name in label_names.items()})
        write_whole(out / LABEL_NAMES, names.encode())


def _changes(before: Recipe, now: Recipe) -> list[str]:
    """Human-readable differences between two recipes; only the names of lists and tables."""
    changes = []
    for name in dict.fromkeys([*before, *now]):
        old = before.get(name, "not given")
        new = now.get(name, "not given")
        if old != new and name not in _IGNORED:
            is_long = isinstance(old, list | dict) or isinstance(new, list | dict)
            changes.append(name if is_long else f"{name} was {old}, is {new}")
    return changes


def _stems(files: Iterable[Path]) -> set[str]:
    """Names of the pairs that files belong to."""
    return {path.stem for path in files if not path.name.startswith(".")}
