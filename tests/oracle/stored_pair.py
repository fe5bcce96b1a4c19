"""The stored tables of one pair of a finished run, as the literal implementation reads them."""

from functools import cached_property
from typing import NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa
from scipy import sparse

import literal_method
from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.schemas.columns import SIDES
from fidpipe.schemas.tables import TABLES


class Recomputed(NamedTuple):
    """Stored and recomputed columns of a table, both indexed by the keys of its rows."""

    table: str
    stored: pd.DataFrame
    recomputed: pd.DataFrame


class StoredPair:
    """The tables of a pair, its settings, and both sides.

    Parameters
    ----------
    run : FinishedRun
    pair : ScanPair of the dataset
    settings : of the run
    label_names : names of the classes by number
    """

    def __init__(self, run, pair, settings, label_names):
        self.run = run
        self.pair = pair
        self.pair_id = pair.pair_id
        self.settings = settings
        self.label_names = label_names
        self.jobs = run.store.ledger.jobs(pair.pair_id)
        self.row = run.row(pair.pair_id)
        self._tables = {}

    def table(self, name, side=""):
        """A stored table as a frame; null keys are -1."""
        if (name, side) not in self._tables:
            rows = self.run.store.read_table(name, self.pair_id, side)
            frame = rows.to_pandas()
            for key in TABLES[name].keys:
                if pa.types.is_integer(rows.schema.field(key).type):
                    frame[key] = frame[key].fillna(-1).astype(int)
            self._tables[name, side] = frame
        return self._tables[name, side]

    def scan(self, side):
        """The scan of a side, as it is in its file."""
        columns = self.settings.input.columns_of(side)
        return read_scan(self.pair.scans[side], columns, self.label_names)

    def metadata(self, stage, side=""):
        """The stored metadata of a job."""
        return self.jobs[stage, side].metadata

    @cached_property
    def sides(self):
        """Both sides by name."""
        return {side: StoredSide(self, side) for side in SIDES}

    @cached_property
    def matches(self):
        """Rows of `matching` with an object of each side."""
        rows = self.table("matching")
        return rows[rows["status"] == "matched"].to_dict("records")

    def members(self, match):
        """Indices of the points of a matched object on both sides."""
        return [self.sides[side].members(match[f"{side}_id"]) for side in SIDES]

    def kept(self, match):
        """Indices of the aligned nodes of a matched object on both sides."""
        table = self.table("selection")
        rows = table[table["real_id"] == match["real_id"]]
        return [self.sides[side].index(rows[f"{side}_point_id"]) for side in SIDES]

    def points(self, nodes):
        """Coordinates of some points of both sides."""
        real, sim = nodes
        return [self.sides["real"].points[real], self.sides["sim"].points[sim]]

    def laplacians(self, nodes):
        """Dense Laplacians of the graphs among some points of both sides."""
        real, sim = nodes
        return [self.sides["real"].laplacian(real), self.sides["sim"].laplacian(sim)]

    def rows(self, table, recomputed, side=""):
        """All rows of a table, recomputed, next to the stored ones."""
        keys = list(TABLES[table].keys)
        frame = pd.DataFrame(recomputed, columns=None if len(recomputed) else keys)
        # nulls last
        frame = frame.sort_values(keys, key=lambda column: column.replace(-1, np.inf))
        return Recomputed(table, self.table(table, side).set_index(keys), frame.set_index(keys))

    def values(self, table, stored, recomputed):
        """Single values by name."""
        names = list(recomputed)
        stored_frame = pd.DataFrame([stored], columns=names)
        return Recomputed(table, stored_frame, pd.DataFrame([recomputed]))

    def summary(self, recomputed):
        """Some columns of the pair's row of `pairs`."""
        return self.values("pairs", self.row, recomputed)


class StoredSide:
    """Points, objects and graph of one side; indices count the object points.

    all_points : (n, 3) clean points, metres
    is_object : (n,) False for ground
    points, point_ids : object points, and their rows in the scan
    """

    def __init__(self, pair, side):
        ground = pair.table("ground", side)
        self._pair = pair
        self.side = side
        self.all_points = ground[["x", "y", "z"]].to_numpy()
        self.is_object = ~ground["is_ground"].to_numpy()
        self.points = self.all_points[self.is_object]
        self.point_ids = ground["point_id"].to_numpy()[self.is_object]

    @cached_property
    def labels(self):
        """Object of each point, -1 for none."""
        return self._pair.table("communities", self.side)["community_id"].to_numpy().astype(int)

    def members(self, community):
        """Indices of the points of an object."""
        return np.flatnonzero(self.labels == community)

    def index(self, point_ids):
        """Indices of points by their ids; `KeyError` for a point that is no object point."""
        places = pd.Series(np.arange(len(self.point_ids)), index=self.point_ids)
        return places.loc[point_ids].to_numpy()

    @cached_property
    def edges(self):
        """Indices of both ends of each edge, and the lengths."""
        graph = self._pair.table("graph", self.side)
        length_m = graph["length_m"].to_numpy().astype(float)
        return self.index(graph["src"]), self.index(graph["dst"]), length_m

    @cached_property
    def adjacency(self):
        """(n, n) edge lengths."""
        src, dst, length_m = self.edges
        rows = np.concatenate([src, dst])
        columns = np.concatenate([dst, src])
        n_points = len(self.points)
        return sparse.csr_array(
            (np.tile(length_m, 2), (rows, columns)), shape=(n_points, n_points)
        )

    def laplacian(self, nodes):
        """Dense Laplacian of the graph among some points."""
        return literal_method.laplacian(self.adjacency[nodes][:, nodes].toarray())
