"""Kernels of the ordering: in which order the nodes are eliminated.

All of them work on the quotient graph: one vertex for each node that moves, which stands for its three unknowns. A
node's *place* is its position in the order of elimination.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.kernel_cache import kernel

Int = NDArray[np.int64]


@kernel
def adjacency(ends: Int, count: int) -> tuple[Int, Int]:
    """The neighbours of each of ``count`` vertices, once each: ``neighbours[starts[v] : starts[v + 1]]``.

    ``ends``: the vertices that each edge joins, shape (m, 2); an edge with a negative end is left out.
    """
    starts = np.zeros(count + 2, np.int64)
    for k in range(len(ends)):
        i, j = ends[k, 0], ends[k, 1]
        if i >= 0 and j >= 0:
            starts[i + 2] += 1
            starts[j + 2] += 1
    for v in range(count):
        starts[v + 2] += starts[v + 1]
    repeated = np.empty(starts[count + 1], np.int64)
    for k in range(len(ends)):
        i, j = ends[k, 0], ends[k, 1]
        if i >= 0 and j >= 0:
            repeated[starts[i + 1]] = j
            repeated[starts[j + 1]] = i
            starts[i + 1] += 1
            starts[j + 1] += 1
    seen_by = np.empty(count, np.int64)
    seen_by.fill(-1)
    free = 0
    for v in range(count):
        first, end = starts[v], starts[v + 1]
        starts[v] = free
        for p in range(first, end):
            other = repeated[p]
            if seen_by[other] != v:
                seen_by[other] = v
                repeated[free] = other
                free += 1
    starts[count] = free
    return starts[: count + 1], repeated[:free]


@kernel
def minimum_degree(starts: Int, neighbours: Int) -> Int:
    """An order of elimination that keeps the factor sparse, shape (count,): the approximate minimum degree.

    Amestoy, Davis and Duff (1996), "An approximate minimum degree ordering algorithm": the quotient graph of variables
    and elements (eliminated vertices, each standing for the clique it leaves), the bound of its section 4 on the
    degree, mass elimination, indistinguishable variables by hashing, aggressive absorption. A vertex with very many
    neighbours is eliminated at the end; otherwise each elimination next to it would read all of them.

    The list of a variable holds its elements, then its variables; that of an element its variables. ``weight`` of a
    variable: how many it stands for; negative while it is in the pivot's clique, zero after it was eliminated.
    """
    count = len(starts) - 1
    lists = np.empty(3 * len(neighbours) // 2 + count, np.int64)
    free = len(neighbours)
    for p in range(free):
        lists[p] = neighbours[p]
    begin, length, elements = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count, np.int64)
    degree, weight, stamp = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count, np.int64)
    heads, after, before = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count, np.int64)
    buckets, bucket_of = np.empty(count, np.int64), np.empty(count, np.int64)
    members, last_member = np.empty(count, np.int64), np.empty(count, np.int64)
    order = np.empty(count, np.int64)
    for v in range(count):
        begin[v], length[v], elements[v] = starts[v], starts[v + 1] - starts[v], 0
        degree[v], weight[v], stamp[v] = length[v], 1, 1
        heads[v] = after[v] = before[v] = buckets[v] = members[v] = -1
        last_member[v] = v
    flag = 2
    ordered, left = 0, count
    most = max(16, int(10.0 * np.sqrt(count)))
    for v in range(count - 1, -1, -1):
        if degree[v] > most:
            left -= 1
            order[left] = v
            weight[v] = 0
        else:
            after[v] = heads[degree[v]]
            if after[v] >= 0:
                before[after[v]] = v
            heads[degree[v]] = v

    least = 0
    while ordered < left:
        while heads[least] < 0:
            least += 1
        pivot = heads[least]
        heads[least] = after[pivot]
        if after[pivot] >= 0:
            before[after[pivot]] = -1
        weight[pivot] = 0

        # The pivot's clique: its variables, and those of its elements, which it absorbs.
        if free + degree[pivot] > len(lists):
            longer = np.empty(2 * len(lists) + degree[pivot], np.int64)
            for p in range(free):
                longer[p] = lists[p]
            lists = longer
        first, clique = free, 0
        for k in range(elements[pivot] + 1):
            if k < elements[pivot]:
                e = lists[begin[pivot] + k]
                p, end = begin[e], begin[e] + length[e]
                stamp[e] = 0
            else:
                p, end = begin[pivot] + elements[pivot], begin[pivot] + length[pivot]
            for q in range(p, end):
                v = lists[q]
                if weight[v] > 0:
                    clique += weight[v]
                    weight[v] = -weight[v]
                    lists[free] = v
                    free += 1
                    if after[v] >= 0:
                        before[after[v]] = before[v]
                    if before[v] >= 0:
                        after[before[v]] = after[v]
                    else:
                        heads[degree[v]] = after[v]
        begin[pivot] = first

        # How much of each element lies outside the clique.
        for q in range(first, free):
            v = lists[q]
            for p in range(begin[v], begin[v] + elements[v]):
                e = lists[p]
                if stamp[e] >= flag:
                    stamp[e] += weight[v]
                elif stamp[e] != 0:
                    stamp[e] = degree[e] + flag + weight[v]

        for q in range(first, free):
            v = lists[q]
            kept, outside, digest = begin[v], 0, 0
            for p in range(begin[v], begin[v] + elements[v]):
                e = lists[p]
                if stamp[e] > flag:
                    outside += stamp[e] - flag
                    lists[kept] = e
                    kept += 1
                    digest += e
                else:
                    stamp[e] = 0
            kept_elements = kept
            for p in range(begin[v] + elements[v], begin[v] + length[v]):
                other = lists[p]
                if weight[other] > 0:
                    outside += weight[other]
                    lists[kept] = other
                    kept += 1
                    digest += other
            if kept == begin[v]:  # no neighbours outside the clique: it is eliminated together with the pivot
                clique += weight[v]
                weight[v] = 0
                members[last_member[pivot]] = v
                last_member[pivot] = last_member[v]
                continue
            degree[v] = min(degree[v], outside)
            lists[kept] = lists[kept_elements]
            lists[kept_elements] = lists[begin[v]]
            lists[begin[v]] = pivot
            elements[v] = kept_elements - begin[v] + 1
            length[v] = kept - begin[v] + 1
            bucket_of[v] = digest % count
            after[v] = buckets[bucket_of[v]]
            buckets[bucket_of[v]] = v
        degree[pivot] = clique
        flag += count + 1

        # Variables of the clique with the same neighbours are merged from now on.
        for q in range(first, free):
            one = lists[q]
            if weight[one] == 0 or buckets[bucket_of[one]] < 0:
                continue
            one, buckets[bucket_of[one]] = buckets[bucket_of[one]], -1
            while one >= 0 and after[one] >= 0:
                for p in range(begin[one] + 1, begin[one] + length[one]):
                    stamp[lists[p]] = flag
                behind, two = one, after[one]
                while two >= 0:
                    same = length[two] == length[one] and elements[two] == elements[one]
                    p = begin[two] + 1
                    while same and p < begin[two] + length[two]:
                        same = stamp[lists[p]] == flag
                        p += 1
                    if same:
                        weight[one] += weight[two]
                        weight[two] = 0
                        members[last_member[one]] = two
                        last_member[one] = last_member[two]
                        after[behind] = after[two]
                    else:
                        behind = two
                    two = after[two]
                flag += 1
                one = after[one]

        v = pivot
        while v >= 0:
            order[ordered] = v
            ordered += 1
            v = members[v]
        kept = first
        for q in range(first, free):
            v = lists[q]
            if weight[v] == 0:
                continue
            weight[v] = -weight[v]
            degree[v] = min(degree[v] + clique, left - ordered) - weight[v]
            least = min(least, degree[v])
            before[v], after[v] = -1, heads[degree[v]]
            if after[v] >= 0:
                before[after[v]] = v
            heads[degree[v]] = v
            lists[kept] = v
            kept += 1
        length[pivot] = kept - first
        free = kept
    return order


@kernel
def elimination_tree(starts: Int, neighbours: Int, order: Int) -> tuple[Int, Int]:
    """By place: the place of the parent (-1 at a root), and how many blocks the column has in L, with the diagonal
    block.

    Liu (1990), "The role of elimination trees in sparse factorization".
    """
    count = len(order)
    place, parents, roots = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count, np.int64)
    for row in range(count):
        place[order[row]] = row
        parents[row] = roots[row] = -1
    for row in range(count):
        vertex = order[row]
        for p in range(starts[vertex], starts[vertex + 1]):
            column = place[neighbours[p]]
            while column < row and column >= 0:
                above = roots[column]
                roots[column] = row
                if above < 0:
                    parents[column] = row
                column = above if above != row else -1
    blocks, seen_by = np.empty(count, np.int64), roots
    for row in range(count):
        vertex = order[row]
        blocks[row], seen_by[row] = 1, row
        for p in range(starts[vertex], starts[vertex + 1]):
            column = place[neighbours[p]]
            while column < row and seen_by[column] != row:
                seen_by[column] = row
                blocks[column] += 1
                column = parents[column]
    return parents, blocks


@kernel
def postorder(order: Int, parents: Int, blocks: Int) -> tuple[Int, Int, Int]:
    """The same three arrays in postorder: each place directly after its descendants, the branch of most blocks last."""
    count = len(parents)
    first_child, next_child, fullest = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count, np.int64)
    for v in range(count):
        first_child[v] = next_child[v] = fullest[v] = -1
    for v in range(count):
        parent = parents[v]
        if parent >= 0 and (fullest[parent] < 0 or blocks[v] > blocks[fullest[parent]]):
            fullest[parent] = v
    for v in range(count - 1, -1, -1):
        parent = parents[v]
        if parent >= 0 and fullest[parent] != v:
            next_child[v] = first_child[parent]
            first_child[parent] = v
    sequence, stack = np.empty(count, np.int64), np.empty(count, np.int64)
    done = 0
    for root in range(count):
        if parents[root] >= 0:
            continue
        stack[0], depth = root, 1
        while depth:
            v = stack[depth - 1]
            child = first_child[v]
            if child >= 0:
                first_child[v] = next_child[child]
            else:
                child = fullest[v]
                fullest[v] = -1
            if child >= 0:
                stack[depth] = child
                depth += 1
            else:
                sequence[done] = v
                done += 1
                depth -= 1
    place = stack
    for k in range(count):
        place[sequence[k]] = k
    for k in range(count):
        v = sequence[k]
        first_child[k] = order[v]
        next_child[k] = place[parents[v]] if parents[v] >= 0 else -1
        fullest[k] = blocks[v]
    return first_child, next_child, fullest
