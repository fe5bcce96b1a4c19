"""The settings of a run: one frozen class per stage, with the defaults and bounds of each field.

The defaults are those of the paper where it gives one. Only `load` reads a file: it layers a TOML file
and `--set` assignments over the defaults and names the invalid field.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)

from .columns import FARTHEST_M
from .data_files import parse_toml, read_toml
from .docstrings import split_docstring
from .errors import SettingsError, suggestion
from .metric_catalogue import BASELINE_NAMES

Box = tuple[float, float, float, float, float, float]

_COLUMNS = ["x", "y", "z", "intensity", "ring"]

#: Frames that scans are recorded in, metres and degrees: x, y and z of each. Coordinates of `carla` are left-handed.
FrameName = Literal["ros", "carla", "nuscenes", "kitti-cam"]
FRAME_AXES: dict[FrameName, str] = {
    "ros": "x forward, y left, z up",
    "carla": "x forward, y right, z up",
    "nuscenes": "x right, y forward, z up",
    "kitti-cam": "x right, y down, z forward",
}


class _Group(BaseModel):
    """Settings of a stage; the docstring has the description of each."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True
    )

    @classmethod
    def __pydantic_init_subclass__(cls, **_: Any) -> None:
        cls.__doc__, meanings = split_docstring(cls.__doc__ or "")
        for name, meaning in meanings.items():
            cls.model_fields[name].description = meaning


def _split_words(value: Any) -> Any:
    """`x,y,z,intensity` and `x y z intensity` are read as lists."""
    return value.replace(",", " ").split() if isinstance(value, str) else value


def _numbers(count: int, kind: Any) -> BeforeValidator:
    """Numbers are read from `1,2,3` or a list, which must have so many; of such a kind in the schema."""

    def split(value: Any) -> Any:
        words = _split_words(value)
        if isinstance(words, list | tuple) and len(words) != count:
            raise ValueError(f"expected {count} numbers, got {value!r}")
        return words

    return BeforeValidator(split, json_schema_input_type=kind | str)


def _choice(known: tuple[str, ...]) -> BeforeValidator:
    """Names of a list, each once and in its order, are read from `all`, `chamfer,emd` or a list of them."""

    def chosen(value: Any) -> tuple[str, ...]:
        names = known if value == "all" else _split_words(value)
        if not isinstance(names, list | tuple) or any(name not in known for name in names):
            raise ValueError(f"expected any of {', '.join(known)}")
        return tuple(name for name in known if name in names)

    names = tuple[Literal[known], ...]  # type: ignore[valid-type]
    return BeforeValidator(chosen, json_schema_input_type=names | str)


def _check_columns(value: tuple[str, ...]) -> tuple[str, ...]:
    if not {"x", "y", "z"} <= set(value) or len(set(value)) != len(value):
        raise ValueError("expected x, y and z among the names, and each name once")
    return value


def _check_box(value: Box) -> Box:
    if any(value[i] >= value[i + 3] for i in range(3)):
        raise ValueError(
            "expected each minimum below its maximum (xmin ymin zmin xmax ymax zmax)"
        )
    return value


_Columns = Annotated[
    Annotated[tuple[str, ...], AfterValidator(_check_columns)] | None,
    BeforeValidator(_split_words, json_schema_input_type=tuple[str, ...] | str),
]
_Box = Annotated[Annotated[Box, AfterValidator(_check_box)] | None, _numbers(6, Box)]
_Point = tuple[float, float, float]
_Position = Annotated[_Point | None, _numbers(3, _Point)]


class InputSettings(_Group):
    """Reading and cleaning of scans.

    columns : names of the columns of a .bin file (default x y z intensity, and ring in .pcd.bin), or of a .csv or .npy
    real_columns : the same for the real side only
    sim_columns : the same for the simulated side only
    min_range_m : nearer points are dropped (3-D range, own frame)
    max_range_m : farther points are dropped
    exclude_box : xmin ymin zmin xmax ymax zmax, metres, own frame: points inside are dropped (the ego vehicle)
    include_box : xmin ymin zmin xmax ymax zmax, metres, real sensor's frame: points outside are dropped
    voxel_m : edge of a voxel, metres, real sensor's frame: of each voxel of either side only the first point is kept,
        which thins clouds of a million points; rays and causes of single returns are then unknown
    sim_frame : axes of the simulated scans, metres; see real_frame
    sensor_position : x y z of the sensor, metres, in the frame of the points, where that is not the sensor's own; of
        both sides
    intensity_scale : same: intensities of both sides have one scale, so that their RMSE is computed
    """

    columns: _Columns = Field(None, examples=[_COLUMNS])
    real_columns: _Columns = Field(None, examples=[_COLUMNS])
    sim_columns: _Columns = Field(None, examples=[_COLUMNS])
    min_range_m: float = Field(2.5, ge=0)
    max_range_m: float = Field(100.0, gt=0, le=FARTHEST_M)
    exclude_box: _Box = Field(None, examples=[[-1.5, -1.0, -2.0, 2.5, 1.0, 0.5]])
    include_box: _Box = Field(None, examples=[[-50.0, -20.0, -5.0, 50.0, 20.0, 10.0]])
    voxel_m: float | None = Field(None, gt=0, le=10, examples=[0.1])
    real_frame: FrameName = Field(
        "ros",
        description="axes of the real scans, metres: "
        + "; ".join(f"{name} {axes}" for name, axes in FRAME_AXES.items())
        + ". Converted to ros before T_real_sim is applied",
    )
    sim_frame: FrameName = "ros"
    sensor_position: _Position = Field(None, examples=[[1.2, 0.0, 1.8]])
    intensity_scale: Literal["unknown", "same"] = "unknown"

    @model_validator(mode="after")
    def _ranges_in_order(self) -> InputSettings:
        if self.min_range_m >= self.max_range_m:
            raise ValueError(
                f"expected min_range_m below max_range_m, got {self.min_range_m:g} and {self.max_range_m:g}"
            )
        return self

    def frame_of(self, side: str) -> FrameName:
        """The frame that the scans of a side ("real" or "sim") are recorded in."""
        return self.real_frame if side == "real" else self.sim_frame

    def columns_of(self, side: str) -> tuple[str, ...] | None:
        """The columns of a raw file of a side ("real" or "sim"), if they are not the usual ones."""
        of_side = self.real_columns if side == "real" else self.sim_columns
        return of_side or self.columns


class GroundSettings(_Group):
    """Removal of the road.

    method : PCA Z-cut, patchwork++ (needs `pip install "fidpipe[patchwork]"`), or no cut
    prior_m : a-priori threshold above the road's peak
    max_variance_loss : the threshold is lowered while the loss is above
    loss : scatter of the removed points along the axis, or relative change of the total variance
    shared : cut both sides with the real side's axis and threshold (method pca)
    peak : road of the simulated side: its own fullest window; or axis, peak and threshold of the real side, moved
        by the height of the simulated road above the real one (of no effect with shared = true)
    """

    method: Literal["pca", "patchwork", "none"] = "pca"
    prior_m: float = Field(0.30, ge=0, le=5)
    max_variance_loss: float = Field(0.01, ge=0, le=1)
    loss: Literal["removed", "total"] = "removed"
    shared: bool = False
    peak: Literal["own", "real"] = "own"

    @model_validator(mode="after")
    def _shared_needs_pca(self) -> GroundSettings:
        if self.shared and self.method != "pca":
            raise ValueError(
                f'expected method = "pca" with shared = true, got "{self.method}"; change either',
            )
        return self


class GraphSettings(_Group):
    """Edges between points.

    k : nearest neighbours of each point
    tau_m : all points within this distance are connected
    edges : kNN or tau pairs, or kNN pairs within tau
    ties : of equally near points: the smaller id, or by coordinates, independent of row order
    """

    k: int = Field(90, ge=1, le=2000)
    tau_m: float = Field(0.2, ge=0, le=10)
    edges: Literal["union", "intersection"] = "union"
    ties: Literal["point_id", "coordinates"] = "point_id"


class CommunitySettings(_Group):
    """Partition of the graph into objects.

    backend : Louvain implementation
    seed : seed of the node order
    objects : each side partitioned independently, or the simulated one by the real objects
    reference : objects of the real side: communities, connected components of a label, or input instances
    leave_out : reference labels or instances: classes of the real side whose points belong to no object, by name in
        any case (by number if labels.toml has no name); unlabelled also stands for points without a label
    reach_m : largest distance of a simulated point to its object; longest edge in a labelled component
    min_points : fewest points of a simulated object, or of a component of one label
    """

    backend: Literal["scikit-network", "python-louvain"] = "scikit-network"
    seed: int = Field(0, ge=0, lt=2**31 - 1000)  # stability.seeds follow it
    objects: Literal["independent", "reference"] = "independent"
    reference: Literal["louvain", "labels", "instances"] = "louvain"
    leave_out: tuple[str, ...] = Field(
        ("0", "unlabelled", "unlabeled", "void"),
        examples=[["0", "unlabelled", "road"]],
    )
    reach_m: float = Field(1.0, gt=0)
    min_points: int = Field(8, ge=1)

    @field_validator("leave_out", mode="before", json_schema_input_type=tuple[str, ...] | str)
    @classmethod
    def _split_classes(cls, value: Any) -> Any:
        """`0,road` is read as a list, and numbers are read as text."""
        if isinstance(value, str):
            value = value.split(",")
        elif isinstance(value, int):
            value = [value]
        if not isinstance(value, list | tuple):
            return value
        return [str(name).strip().lower() for name in value if str(name).strip()]

    @model_validator(mode="after")
    def _annotations_need_reference(self) -> CommunitySettings:
        if self.reference != "louvain" and self.objects != "reference":
            raise ValueError(
                f'expected objects = "reference" with reference = "{self.reference}", got "{self.objects}"; add '
                "--preset reference"
            )
        return self


class MatchingSettings(_Group):
    """Matching of real and simulated objects.

    delta_m : centroids at this distance or farther do not match
    method : Algorithm 1, or most matches at least total distance
    """

    delta_m: float = Field(5.0, gt=0)
    method: Literal["greedy", "optimal"] = "greedy"


class PieceSettings(_Group):
    """Definition of a missing or invented piece of surface.

    reach_m : object points with no point of the other side within this distance form pieces
    link_m : points within this distance belong to the same piece, or to the same extra object
    min_points : fewest points of a piece
    """

    reach_m: float = Field(1.0, gt=0)
    link_m: float = Field(0.6, gt=0)
    min_points: int = Field(10, ge=1)


#: Tasks of a perception stack that both scans can be given to.
TASK_NAMES = ("objects", "ground", "occupancy", "free_space")


class SelectionSettings(_Group):
    """Selection of the nodes that represent an object.

    t : diffusion time of the heat kernel
    """

    t: float = Field(1.0, gt=0, le=100)


if TYPE_CHECKING:
    from pydantic_core import ErrorDetails


class MetricsSettings(_Group):
    """Baseline metrics to compute in addition to the scores, and their parameters.

    f_score_distance_m : F-score: nearer points count as found
    dcd_alpha : DCD: weight of the squared distance, objects of unit size
    emd_max_points : EMD of all points: larger objects are left out, one may take over a minute
    histogram_points : histogram: points sampled per side, all pairs of which are measured
    histogram_bins : histogram: equal bins from 0 to 1
    histogram_order : histogram: order of the Minkowski distance
    """

    baselines: Annotated[tuple[str, ...], _choice(BASELINE_NAMES)] = Field(
        (),
        description=f'any of {", ".join(BASELINE_NAMES)}; "all" for all of them; by default none',
    )
    f_score_distance_m: float = Field(0.2, gt=0)
    dcd_alpha: float = Field(1000.0, gt=0)
    emd_max_points: int = Field(8000, ge=2)
    histogram_points: int = Field(2000, ge=2, le=10_000)
    histogram_bins: int = Field(100, ge=2, le=10_000)
    histogram_order: float = Field(2.0, ge=1)


class StabilitySettings(_Group):
    """Repetition of each pair with other seeds.

    seeds : number of seeds of the communities: the configured seed and those that follow it
    """

    seeds: int = Field(1, ge=1, le=1000)


class TaskSettings(_Group):
    """What a perception stack would do with both scans.

    range_m : places farther away (horizontal) are left out
    height_m : points higher above the road are no obstacles: crowns, bridges
    link_m : objects: points within this distance are one obstacle; at the sensor, it grows with range
    min_points : objects: fewest points of an obstacle
    min_iou : objects: least overlap of the boxes of an obstacle that is found
    cell_m : occupancy: width of the cells
    """

    names: Annotated[tuple[str, ...], _choice(TASK_NAMES)] = Field(
        (),
        description=f'any of {", ".join(TASK_NAMES)}; "all" for all of them; by default none',
    )
    range_m: float = Field(50.0, gt=0, le=200)
    height_m: float = Field(2.5, gt=0)
    link_m: float = Field(0.4, gt=0, le=10)
    min_points: int = Field(10, ge=1)
    min_iou: float = Field(0.3, gt=0, le=1)
    cell_m: float = Field(0.2, ge=0.05)


class MachineSettings(_Group):
    """Limits on the machine's resources; no result depends on them.

    memory_gib : most memory of all worker processes together; by default four fifths of the machine's
    """

    memory_gib: float | None = Field(None, gt=0, examples=[8.0])


class Settings(_Group):
    """All settings of a run; `fidpipe run --set graph.k=60` changes one."""

    input: InputSettings = InputSettings()
    ground: GroundSettings = GroundSettings()
    graph: GraphSettings = GraphSettings()
    communities: CommunitySettings = CommunitySettings()
    matching: MatchingSettings = MatchingSettings()
    pieces: PieceSettings = PieceSettings()
    selection: SelectionSettings = SelectionSettings()
    metrics: MetricsSettings = MetricsSettings()
    stability: StabilitySettings = StabilitySettings()
    tasks: TaskSettings = TaskSettings()

    machine: MachineSettings = MachineSettings()


#: Settings that belong together, as departures from the defaults. `paper` reproduces the paper; `reference` fixes the
#: objects on the real side, for comparing simulators.
PRESETS: dict[str, dict[str, dict[str, Any]]] = {
    "paper": {},
    "reference": {
        "ground": {"peak": "real"},
        "graph": {"ties": "coordinates"},
        "communities": {"objects": "reference"},
    },
}

#: What the objects of each preset are.
PRESET_OBJECTS = {
    "paper": "each side partitioned independently, objects matched by their centroids",
    "reference": "objects of the real side, simulated points assigned to the nearest",
}


def preset_of(settings: Settings) -> str:
    """The preset that settings belong to: the one whose objects they have."""
    return "reference" if settings.communities.objects == "reference" else "paper"


def overrides(settings: Settings) -> list[str]:
    """The settings that differ from those of their preset, as `graph.k=60`, except those that no result depends on.

    Examples
    --------
    >>> overrides(load(None, ["graph.k=60"], preset="reference"))
    ['graph.k=60']
    """
    preset = type(settings).model_validate(PRESETS[preset_of(settings)])
    words = []
    for group, values in settings:
        if group == "machine":
            continue
        for name, value in values:
            if value != getattr(getattr(preset, group), name):
                words.append(f"{group}.{name}={_toml_word(value)}")
    return words


def load(
    path: Path | None = None,
    assignments: Iterable[str] = (),
    *,
    preset: str | None = None,
) -> Settings:
    """Settings from a preset, a TOML file (which may have a line `preset = "reference"`), and `graph.k=60`-like words.

    Raises
    ------
    SettingsError
        The preset or a name is unknown, the file cannot be read or has other objects than the requested preset, an
        assignment has no `=`, or a value is out of bounds.
    """
    values = {} if path is None else read_toml(path, "settings file")
    if preset is not None:
        values["preset"] = preset
    if path is not None:
        try:
            settings = parse(values)
        except SettingsError as error:
            raise SettingsError(f"settings file {path}: {error}") from error
        if preset not in (None, preset_of(settings)):
            objects = settings.communities.objects
            raise SettingsError(
                f"settings file {path}: has communities.objects = {objects!r}, unlike the preset {preset}; "
                "remove --preset, or that line of the file"
            )
    for word in assignments:
        assignment = re.fullmatch(r"\s*(\w+)\.(\w+)\s*=(.*)", word, re.DOTALL)
        if not assignment:
            raise SettingsError(
                f"--set {word!r}: expected GROUP.NAME=VALUE, such as graph.k=60"
            )
        group, setting, text = assignment.groups()
        table = values.setdefault(group, {})
        if not isinstance(table, dict):
            raise SettingsError(f"--set {word!r}: {group} is not a group of settings")
        table[setting] = _toml_value(text.strip())
    return parse(values)


def parse(values: Mapping[str, Any]) -> Settings:
    """Settings from nested dictionaries by group; "preset" may name the preset that they depart from.

    Raises
    ------
    SettingsError
        Names the first field that is wrong.
    """
    values = dict(values)
    preset = values.pop("preset", "paper")
    if not isinstance(preset, str) or preset not in PRESETS:
        raise SettingsError(
            f"preset {preset!r}: no such preset; {suggestion(str(preset), PRESETS)}"
        )
    for group, departures in PRESETS[preset].items():
        given = values.get(group, {})
        values[group] = departures | given if isinstance(given, dict) else given
    try:
        return Settings.model_validate(values)
    except ValidationError as error:
        raise SettingsError(_first_problem(error)) from error


def _toml_value(text: str) -> Any:
    """A TOML value if it is one, else the text itself: `greedy` needs no quotes."""
    try:
        return parse_toml(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _toml_word(value: Any) -> str:
    """A value as `--set` takes it."""
    if isinstance(value, tuple):
        return ",".join(map(str, value))
    return str(value).lower() if isinstance(value, bool) else str(value)


def _first_problem(error: ValidationError) -> str:
    problem = error.errors()[0]
    name = ".".join(part for part in problem["loc"] if isinstance(part, str))
    if problem["type"] == "extra_forbidden":
        known = [other for other in _names() if other.count(".") == name.count(".")]
        return f"setting {name}: no such setting; {suggestion(name, known)}"
    text = f"setting {name}: {expected_and_got(problem)}"
    if problem["type"] == "value_error":
        return text
    return f"{text}; fidpipe settings lists the allowed values"


def expected_and_got(problem: ErrorDetails) -> str:
    """Text of an error of pydantic: expected and found value.

    Examples
    --------
    >>> try:
    ...     Settings.model_validate({"graph": {"k": 0}})
    ... except ValidationError as error:
    ...     print(expected_and_got(error.errors()[0]))
    expected greater than or equal to 1, got 0
    """
    if problem["type"] == "missing":
        return "a value is missing"
    if problem["type"] == "extra_forbidden":
        return "unknown field"
    text = problem["msg"].removeprefix("Value error, ").replace("Input should be", "expected")
    if problem["type"] == "value_error" and " got " in text:
        return text
    return f"{text.partition(', got ')[0]}, got {problem['input']!r}"


def _names() -> list[str]:
    """Names of all groups and settings."""
    names = []
    for group, values in Settings():
        names += [group, *(f"{group}.{name}" for name, _ in values)]
    return names
