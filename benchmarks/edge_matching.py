"""Match edge points one-to-one, with the maximum number of pairs within reach (maximum-cardinality matching)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from p2o.arrays import Bool, Float, Int
from scipy.spatial import cKDTree


@dataclass(frozen=True, eq=False)
class Pairs:
    """Which of `rows` found points may be matched with which of `columns` true points.

    `row` (E,) and `column` (E,) number the points of a pair, `distance_px` (E,) is how far apart they are.
    """

    rows: int
    columns: int
    row: Int
    column: Int
    distance_px: Float

    def select(self, keep: Bool) -> Pairs:
        """Return the pairs of a mask (E,)."""
        return Pairs(self.rows, self.columns, self.row[keep], self.column[keep], self.distance_px[keep])


def pairs_within(found: Float, true: Float, reach_px: float) -> Pairs:
    """Return all pairs of points (N, 2) and (M, 2) that are at most `reach_px` apart."""
    if not len(found) or not len(true):
        nothing = np.zeros(0, np.int64)
        return Pairs(len(found), len(true), nothing, nothing, np.zeros(0))
    # The record array keeps pairs at distance 0, which a sparse matrix may drop.
    table = cKDTree(found).sparse_distance_matrix(cKDTree(true), reach_px, output_type="ndarray")
    row, column = table["i"].astype(np.int64), table["j"].astype(np.int64)
    return Pairs(len(found), len(true), row, column, np.asarray(table["v"], np.float64))


def matched_rows(pairs: Pairs, group: Int) -> Bool:
    """Return which found points (rows,) are matched one-to-one; those of higher `group` (rows,) come first.

    For every g the rows of group >= g that are matched reach the maximum of all one-to-one matchings of these rows:
    a matching that is largest for the first rows grows to one for more rows by augmenting paths, which never free a
    row (the matched sets of rows are a matroid). So one run gives the counts of all thresholds at once.

    This is the count of a minimum-cost assignment in which staying alone costs more than any pair, as BSDS has it.
    That assignment itself takes seconds for each of 99 thresholds (scipy's `min_weight_full_bipartite_matching`, 5000
    points in reach of 25 others each), and scipy's `maximum_bipartite_matching` can take minutes on such graphs.
    """
    order = np.lexsort((pairs.distance_px, pairs.row))
    column = pairs.column[order]
    first = np.searchsorted(pairs.row[order], np.arange(pairs.rows + 1))
    column_of, row_of = np.full(pairs.rows, -1, np.int64), np.full(pairs.columns, -1, np.int64)
    for number in np.unique(group)[::-1]:
        member = (group == number) & (first[1:] > first[:-1])
        near = pairs.select(member[pairs.row] & (row_of[pairs.column] < 0))
        _match_nearest(near, column_of, row_of)
        _augment(np.flatnonzero(member & (column_of < 0)), first, column, column_of, row_of)
    return np.asarray(column_of >= 0)


def _match_nearest(pairs: Pairs, column_of: Int, row_of: Int) -> None:
    """Match, in place, the nearest pair, then the nearest of what is left, and so on."""
    order = np.argsort(pairs.distance_px, kind="stable")
    row, column = pairs.row[order], pairs.column[order]
    while len(row):
        # Pairs that are the nearest of both their points do not compete: all of them are taken at once.
        place = np.arange(len(row))
        best_of_row, best_of_column = np.full(pairs.rows, len(row)), np.full(pairs.columns, len(row))
        best_of_row[row[::-1]] = best_of_column[column[::-1]] = place[::-1]
        best = (best_of_row[row] == place) & (best_of_column[column] == place)
        column_of[row[best]], row_of[column[best]] = column[best], row[best]
        left = (column_of[row] < 0) & (row_of[column] < 0)
        row, column = row[left], column[left]


def _augment(free: Int, first: Int, column: Int, column_of: Int, row_of: Int) -> None:
    """Lengthen the matching, in place, by augmenting paths from the `free` rows until there are none.

    Row r may be matched with column[first[r] : first[r + 1]]. A forest of alternating paths grows from all free rows
    at once, each column in one tree only, so the paths that are found share no point.
    """
    parent, root = np.full(len(row_of), -1, np.int64), np.full(len(column_of), -1, np.int64)
    while len(free):
        parent[:] = -1
        root[free] = free
        done = np.zeros(len(column_of), bool)
        ends: list[Int] = []
        frontier = free
        while len(frontier):
            count = first[frontier + 1] - first[frontier]
            source = np.repeat(frontier, count)
            edge = np.arange(len(source)) + np.repeat(first[frontier] - np.cumsum(count) + count, count)
            target = column[edge]
            fresh = parent[target] < 0
            target, place = np.unique(target[fresh], return_index=True)
            source = source[fresh][place]
            parent[target] = source
            open_end = row_of[target] < 0
            # A tree ends with its first free column.
            tree, place = np.unique(root[source[open_end]], return_index=True)
            ends.append(target[open_end][place])
            done[tree] = True
            source, target = source[~open_end], target[~open_end]
            frontier = row_of[target]
            root[frontier] = root[source]
            frontier = frontier[~done[root[frontier]]]
        last = np.concatenate(ends)
        if not len(last):
            return
        while len(last):
            row = parent[last]
            before = column_of[row]
            column_of[row], row_of[last] = last, row
            last = before[before >= 0]
        free = free[column_of[free] < 0]
