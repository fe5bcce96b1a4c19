"""The folder of a generated dataset: `real/`, `sim/`, its recipe, and a manifest that is written last.

Each file is written atomically and depends on the recipe alone, so that an interrupted command
resumes with the missing files.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from ...schemas.columns import SIDES
from ...schemas.data_files import parse_toml
from ..datasets.pairs import LABEL_NAMES, MANIFEST
from ..engine.progress import Reporter
from ..engine.tasks import map_tasks
from ..storage.files import csv_bytes, named_errors, path_exists, refuse_link, write_whole
from ..storage.folder import refuse_other_content, refuse_overwrite

Recipe = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class GeneratedPair:
    """A pair to be written.

    real, sim : names of the scans in `real/` and `sim/`
    task : argument of the function that writes the scans, each after its labels
    timestamp_s, T_world_sensor : entries of the manifest; None if unknown
    """

    pair_id: str
    real: str
    sim: str
    task: Any
    timestamp_s: float | None = None
    T_world_sensor: tuple[float, ...] | None = None

    def files(self) -> set[str]:
        """Names of its scans and label files."""
        return {self.real, self.sim, Path(self.sim).with_suffix(".label").name}

    def is_in(self, folder: Path) -> bool:
        """True if both scans exist."""
        return (folder / "real" / self.real).exists() and (folder / "sim" / self.sim).exists()

    def row(self) -> tuple[str | float | None, ...]:
        """The row of the manifest."""
        pose = " ".join(map(repr, self.T_world_sensor or ()))
        return self.pair_id, f"real/{self.real}", f"sim/{self.sim}", self.timestamp_s, pose


def generate_dataset(
    out: Path,
    recipe_name: str,
    recipe: Recipe,
    pairs: Sequence[GeneratedPair],
    label_names: Mapping[int, str],
    write_pair: Callable[[Any], None],
    reporter: Reporter,
    *,
    workers: int,
    replace: bool,
) -> tuple[int, dict[str, str]]:
    """Write recipe, label names, the pairs that are missing, and the manifest.

    The result is the number of pairs in the dataset, and the reasons for missing pairs by name.

    Parameters
    ----------
    recipe_name : file name of the recipe
    recipe : everything that the files depend on
    write_pair : called with the task of a pair, in one of several processes
    replace : allow files of a finished dataset to be removed

    Raises
    ------
    FidpipeError
        The folder holds something else, or a finished dataset whose files would be removed; nothing
        is written then.
    """
    names = set()
    for pair in pairs:
        names |= pair.files()
    with named_errors(out):
        _prepare(
            out, recipe_name, recipe | {"files": sorted(names)}, label_names, replace=replace
        )
        missing = {pair.pair_id: pair.task for pair in pairs if not pair.is_in(out)}
        _, failures = map_tasks(write_pair, missing, reporter, n_workers=workers)
        done = [pair for pair in pairs if pair.is_in(out)]
        columns = ["pair_id", "real", "sim", "timestamp_s", "T_world_sensor"]
        write_whole(out / MANIFEST, csv_bytes(columns, [pair.row() for pair in done]))
    return len(done), failures


def _prepare(
    out: Path,
    recipe_name: str,
    recipe: Recipe,
    label_names: Mapping[int, str],
    *,
    replace: bool,
) -> None:
    """Create the folder, and remove files of an earlier dataset that this one lacks."""
    import tomli_w

    for side in SIDES:
        refuse_link(out / side)
    earlier = _earlier_recipe(out / recipe_name)
    kind = f"a dataset of fidpipe {recipe_name.removesuffix('.toml')}"
    refuse_other_content(f"dataset {out}", out, kind, is_own=bool(earlier))
    text = tomli_w.dumps(recipe)
    now = tomllib.loads(text)
    changed = [name for name in earlier | now if earlier.get(name) != now.get(name)]
    # The other entries affect the content of the files.
    kept = recipe["files"] if {"recording", "files"}.issuperset(changed) else ()
    lost = []
    for side, name in product(SIDES, earlier.get("files", ())):
        path = out / side / name
        if name not in kept and path_exists(path) and not path.is_dir():
            lost.append(path)
    if lost and not replace and (out / MANIFEST).exists():
        why = [f"other {name}" for name in changed]
        refuse_overwrite(f"dataset {out}", f"{len(lost)} of its files", why)
    for path in [out / MANIFEST, *lost]:
        path.unlink(missing_ok=True)
    write_whole(out / recipe_name, text.encode())
    write_label_names(out, label_names)


def write_label_names(folder: Path, names: Mapping[int, str]) -> None:
    """Write `labels.toml`; remove it if there are no names."""
    import tomli_w

    (folder / LABEL_NAMES).unlink(missing_ok=True)
    if names:
        text = tomli_w.dumps({str(number): name for number, name in names.items()})
        write_whole(folder / LABEL_NAMES, text.encode())


def _earlier_recipe(path: Path) -> Recipe:
    """The recipe in a file; {} if it is not one of a generated dataset."""
    try:
        recipe = parse_toml(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):  # TOML and unicode errors are ValueErrors
        return {}
    names = recipe.get("files")
    if not isinstance(names, list):
        return {}
    is_own = all(Path(str(name)).name == name for name in names)
    return recipe if is_own else {}
