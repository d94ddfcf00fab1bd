"""Many of a kind: components with a number, links along the edges of a graph, values for each.

A document with these is expanded to one without them before it is read: ``[components.robot]`` with
``count = 3`` becomes ``robot1``, ``robot2`` and ``robot3``. In the texts of a component, ``{i}`` is
its number, ``{n}`` how many there are, and ``{degree}`` from how many others it receives by its
graph. A link with a ``graph`` becomes one for each edge: ``{i}`` receives from ``{j}``, its sender
``{k}``, from 0. Elsewhere, ``robot{i}.q`` stands for those of all robots.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base import toml
from cosim.base.convert import convert
from cosim.base.errors import ScenarioError
from cosim.base.names import unknown
from cosim.base.random_numbers import generator
from cosim.graphs.named import MOST_ROBOTS, Edges, GraphSpec, graph_edges
from cosim.scenario.placeholders import Each, Words, filled

Document = dict[str, Any]
_NUMBERED = re.compile(r"(\w+)\{i\}")
#: Laws of a value that each component has its own of.
LAWS = ("uniform", "normal", "list", "file")
#: Keys of a link with a graph: into how many regions its robots are divided, and what links between
#: two of them have in place of the others'.
ACROSS = ("regions", "between")


@dataclass(frozen=True, slots=True)
class ScenarioGraph:
    """A graph of a scenario: `n` robots, `edges` (m, 2): receiver and sender, in order."""

    n: int
    edges: Edges

    def degrees(self) -> list[int]:
        """The number of robots that each one receives from, (n,)."""
        found: list[int] = np.bincount(self.edges[:, 0], minlength=self.n + 1)[1:].tolist()
        return found


def expand(document: Mapping[str, Any], path: Path) -> Document:
    """The document without counts and graphs; itself where there are none. Raises ScenarioError."""
    found = dict(document)
    given = found.pop("graphs", {})
    components, links = found.get("components", {}), found.get("links", [])
    if not isinstance(given, dict):
        raise ScenarioError("expected a table [graphs.NAME]", f"{path} at graphs")
    if not isinstance(components, dict) or not isinstance(links, list):
        return found  # refused where they are read
    graphs = {name: _graph(spec, path, name) for name, spec in given.items()}
    counts: dict[str, int] = {}
    if "components" in found:
        found["components"] = dict(_components(components, graphs, counts, _seed(document), path))
    if "links" in found:
        found["links"] = list(_links(links, graphs, path))
    if "topology" in found:
        found["topology"] = _topology(found["topology"], graphs, path)
    if counts:
        for key in ("run", "metrics", "figures"):
            if key in found:
                found[key] = _listed(found[key], counts, f"{path} at {key}")
    return found


def _graph(given: Any, path: Path, name: str) -> ScenarioGraph:
    place = f"graphs.{name}"
    spec = convert(given, GraphSpec, path, place)
    return ScenarioGraph(*graph_edges(spec, path.parent, f"{path} at {place}"))


def _named(name: Any, graphs: Mapping[str, ScenarioGraph], place: str) -> ScenarioGraph:
    if name not in graphs:
        raise ScenarioError(unknown(str(name), graphs, "graph"), place)
    return graphs[name]


def _seed(document: Mapping[str, Any]) -> int:
    """The seed of the run; 0 where it has none or a wrong one, which is refused later."""
    run = document.get("run", {})
    seed = run.get("seed", 0) if isinstance(run, dict) else 0
    return seed if isinstance(seed, int) and seed >= 0 else 0


# ---- components ----------------------------------------------------------------------------------


def _components(
    given: Mapping[str, Any], graphs: Mapping[str, ScenarioGraph], counts: dict[str, int],
    seed: int, path: Path,
) -> Iterator[tuple[str, Any]]:  # fmt: skip
    """Each with its name; `counts` gets those that were expanded."""
    for name, spec in given.items():
        if not isinstance(spec, dict) or not {"count", "graph"} & spec.keys():
            yield name, spec
            continue
        place = f"{path} at components.{name}"
        counts[name] = _count(spec, graphs, place)
        for i, one in enumerate(_each(name, spec, counts[name], graphs, seed, path), 1):
            if f"{name}{i}" in given:
                raise ScenarioError(
                    f"found components.{name}{i}; expected components.{name}.each.{i} with what"
                    f" is different, because {name} is counted",
                    f"{path} at components",
                )
            yield f"{name}{i}", one


def _count(spec: Document, graphs: Mapping[str, ScenarioGraph], place: str) -> int:
    if "graph" in spec:
        if "count" in spec:
            raise ScenarioError("found count and graph; expected one of them", place)
        return _named(spec["graph"], graphs, f"{place}.graph").n
    count = spec["count"]
    if not isinstance(count, int) or isinstance(count, bool) or not 1 <= count <= MOST_ROBOTS:
        raise ScenarioError(f"count {count!r}; expected 1 to {MOST_ROBOTS}", f"{place}.count")
    return count


def _each(
    name: str, spec: Document, n: int, graphs: Mapping[str, ScenarioGraph], seed: int, path: Path
) -> Iterator[Document]:
    place = f"{path} at components.{name}"
    common = {k: v for k, v in spec.items() if k not in ("count", "graph", "each")}
    different = _different(spec.get("each", {}), n, f"{place}.each")
    for table in ("parameters", "start"):
        if isinstance(common.get(table), dict):
            common[table] = {
                key: Each(_values(law, n, f"components.{name}.{table}.{key}", seed, path)[:n])
                if isinstance(law, dict)
                else law
                for key, law in common[table].items()
            }
    words: dict[str, Sequence[int]] = {"i": range(1, n + 1), "n": [n] * n}
    if "graph" in spec:
        words["degree"] = graphs[spec["graph"]].degrees()
    for i, one in enumerate(filled(common, words, n, place), 1):
        if i in different:
            mine = {word: numbers[i - 1 : i] for word, numbers in words.items()}
            one = _merged(one, *filled(different[i], mine, 1, f"{place}.each.{i}"))
        yield one


def _different(each: Any, n: int, place: str) -> dict[int, Document]:
    """The keys in which components differ, by number."""
    if not isinstance(each, dict) or not all(isinstance(v, dict) for v in each.values()):
        raise ScenarioError("expected tables by number: each.3.parameters", place)
    for key in each:
        if not key.isdigit() or not 1 <= int(key) <= n:
            raise ScenarioError(f"found {key!r}; expected a number from 1 to {n}", place)
    return {int(key): value for key, value in each.items()}


def _merged(base: Document, other: Document) -> Document:
    """`base` with the values of `other`; tables are merged."""
    found = {**base, **other}
    for key, value in other.items():
        if isinstance(mine := base.get(key), dict) and isinstance(value, dict):
            found[key] = _merged(mine, value)
    return found


# ---- values --------------------------------------------------------------------------------------


def _values(law: Document, n: int, name: str, seed: int, path: Path) -> Sequence[Any]:
    """The values of n components by a law; those of the first do not depend on n."""
    place = f"{path} at {name}"
    kind = next((k for k in LAWS if k in law), "")
    extra = set(law) - {kind} - ({"columns"} if kind == "file" else set())
    if not kind or extra:
        raise ScenarioError(
            f"found {', '.join(law) or 'nothing'}; expected a value, or one law for all:"
            f" {', '.join(LAWS)}",
            place,
        )
    given = law[kind]
    if kind == "list":
        return _enough(given, n, "values", place)
    if kind == "file":
        return _enough(_rows(path.parent / str(given), law.get("columns"), place), n, "rows", place)
    return _drawn(kind, given, n, generator(seed, name), place)


def _enough(found: Any, n: int, what: str, place: str) -> Sequence[Any]:
    if not isinstance(found, list) or len(found) < n:
        there = f"{len(found)} {what}" if isinstance(found, list) else repr(found)
        raise ScenarioError(f"found {there}; expected {n} {what}", place)
    return found


def _drawn(kind: str, given: Any, n: int, rng: np.random.Generator, place: str) -> list[Any]:
    """Between two values, or about a mean with a standard deviation, for each entry."""
    names = "[low, high]" if kind == "uniform" else "[mean, standard deviation]"
    try:
        a, b = (np.asarray(x, dtype=np.float64) for x in given)
        shape = np.broadcast_shapes(a.shape, b.shape)
    except (TypeError, ValueError):
        raise ScenarioError(f"{kind} {given!r}; expected {names}, numbers", place) from None
    if (kind == "uniform" and (a > b).any()) or (kind == "normal" and (b < 0).any()):
        raise ScenarioError(f"{kind} {given!r}; expected {names}", place)
    draw = rng.random((n, *shape)) if kind == "uniform" else rng.standard_normal((n, *shape))
    found: list[Any] = (a + draw * (b - a if kind == "uniform" else b)).tolist()
    return found


def _rows(path: Path, columns: Any, place: str) -> list[Any]:
    """Numbers of a CSV file with a heading: those of `columns`, or of all columns."""
    rows = list(csv.reader(toml.read_text(path, "a table (.csv)").splitlines()))
    heading = [cell.strip() for cell in rows[0]] if rows else []
    chosen = heading if columns is None else columns
    if not isinstance(chosen, list) or any(c not in heading for c in chosen) or not chosen:
        raise ScenarioError(f"columns {chosen!r}; {path} has {', '.join(heading)}", place)
    at = [heading.index(c) for c in chosen]
    try:
        found = [[float(row[k]) for k in at] for row in rows[1:] if row]
    except (ValueError, IndexError):
        raise ScenarioError(
            f"{path}: not all cells of {', '.join(chosen)} are numbers", place
        ) from None
    return [row[0] for row in found] if len(at) == 1 else found


# ---- links, topology, signals --------------------------------------------------------------------


def _links(given: Sequence[Any], graphs: Mapping[str, ScenarioGraph], path: Path) -> Iterator[Any]:
    for number, spec in enumerate(given):
        if not isinstance(spec, dict) or "graph" not in spec:
            yield spec
            continue
        place = f"{path} at links.{number}"
        common = {k: v for k, v in spec.items() if k not in ("graph", *ACROSS)}
        graph = _named(spec["graph"], graphs, f"{place}.graph")
        regions, across = _across(spec, common, graph.n, place)
        region = (graph.edges - 1) * regions // graph.n
        same = region[:, 0] == region[:, 1]
        found: list[Any] = [None] * len(same)
        for what, chosen in ((common, same), (across, ~same)):
            words = _edge_words(graph, chosen)
            places = np.flatnonzero(chosen).tolist()
            for at, one in zip(places, filled(what, words, len(places), place), strict=True):
                found[at] = one
        yield from found


def _across(spec: Document, common: Document, n: int, place: str) -> tuple[int, Document]:
    """Into how many regions n robots are divided by number, and what a link between two is."""
    if not set(ACROSS) & spec.keys():
        return 1, common
    regions, between = (spec.get(key) for key in ACROSS)
    if not isinstance(between, dict) or {"graph", *ACROSS, "from", "to"} & between.keys():
        raise ScenarioError(
            ("found no between" if between is None else f"found between = {between!r}")
            + "; expected a table of what differs in links from one region to another, such as"
            " { delay = ... }, with the number of regions",
            f"{place}.between",
        )
    if not isinstance(regions, int) or isinstance(regions, bool) or not 1 <= regions <= n:
        found = "no regions" if regions is None else f"regions {regions!r}"
        raise ScenarioError(f"found {found}; expected 1 to {n}, the robots", f"{place}.regions")
    return regions, {**common, **between}


def _edge_words(graph: ScenarioGraph, chosen: Any = slice(None)) -> Words:
    """The words of the `chosen` edges: receiver i, sender j, and the place of j among the senders
    of i, from 0.
    """
    i, j = graph.edges.T
    k = np.arange(len(i)) - np.searchsorted(i, i)
    return {word: column[chosen].tolist() for word, column in (("i", i), ("j", j), ("k", k))}


def _topology(given: Any, graphs: Mapping[str, ScenarioGraph], path: Path) -> Any:
    """`graph`: its edges in as many graphs as `parts`, each edge in one of them by chance;
    ``weights`` as a text stands for that of every edge.
    """
    if not isinstance(given, dict) or "graph" not in given:
        return given
    place = f"{path} at topology"
    found = {k: v for k, v in given.items() if k not in ("graph", "parts")}
    graph = _named(given["graph"], graphs, f"{place}.graph")
    weights, parts = found.get("weights"), given.get("parts", 1)
    if not isinstance(weights, str) or "graphs" in found:
        raise ScenarioError('expected graph with weights = "control{i}.w[{k}]", no graphs', place)
    if not isinstance(parts, int) or not 1 <= parts <= len(graph.edges):
        raise ScenarioError(
            f"parts {parts!r}; expected 1 to {len(graph.edges)}, the edges", f"{place}.parts"
        )
    chosen = generator(0, f"parts of {given['graph']}").permutation(len(graph.edges)) % parts
    found["graphs"] = [graph.edges[chosen == k].tolist() for k in range(parts)]
    inputs = filled(weights, _edge_words(graph), len(graph.edges), place)
    found["weights"] = dict(zip(inputs, graph.edges.tolist(), strict=True))
    return found


def _listed(value: Any, counts: Mapping[str, int], place: str) -> Any:
    """Lists with ``robot{i}.q`` have those of all robots in its place."""
    if isinstance(value, dict):
        return {k: _listed(v, counts, place) for k, v in value.items()}
    if not isinstance(value, list):
        return value
    found: list[Any] = []
    for item in value:
        numbered = _NUMBERED.search(item) if isinstance(item, str) else None
        if numbered is None:
            found.append(_listed(item, counts, place))
            continue
        if numbered[1] not in counts:
            raise ScenarioError(unknown(numbered[1], counts, "counted component"), place)
        found += [item.replace("{i}", str(i)) for i in range(1, counts[numbered[1]] + 1)]
    return found
