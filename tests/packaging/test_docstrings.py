"""Docstrings of public functions give shapes, units and errors; modules of laws their source."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = sorted(
    str(path.relative_to(ROOT))
    for package in ("cosim", "bridge", "fmus")
    for path in (ROOT / package, *(ROOT / package).iterdir())
    if path.is_dir() and any(path.glob("*.py"))
)
#: A unit, or words that say that there is none.
UNIT = re.compile(
    # A symbol: behind a comma, a bracket, a number or a quoted name, or after "in" or "of".
    r"(?:(?<=[,()\[`\d\]] )|(?<=[(\[/·*\d])|(?<=\bin )|(?<=\bof ))"
    r"(?:s|ms|us|µs|ns|h|rad|m|kg|J|W|V|A|N|Hz|kHz|N[.·]m|N·?[.]?s|1/s)(?![\w'])"
    r"|\b(?:bits?|bytes?|slots?|ticks?|frames|samples|seconds?|nanoseconds|milliseconds|hours|"
    r"share|ratio|fraction|percent|probability|factor|dimensionless|units?)\b|%|°|1/s|rad/s|N\.m"
)
#: A shape: (n,), (rows, 2), n × n; or words that say it in full.
DIMENSION = r"\w+(?: ?[·*+/-] ?\w+)*"
SHAPE = re.compile(
    rf"\({DIMENSION},(?: ?{DIMENSION},?)*\)|\w+ × \w+|\bshapes?\b|\bscalar\b"
    r"|\bper (row|sample|tick)\b"
)
ARRAY = re.compile(r"(?<!c\.)\b(NDArray|ndarray|ArrayLike|Array)\b")  # c.Array is of ctypes
#: Names of array types, such as ``FloatArray``, and a type with float64 entries.
ALIAS = re.compile(r"^(\w+)(?:: TypeAlias)? = (\S*(?:NDArray|ndarray)\[.*)$", re.MULTILINE)
FLOATS = re.compile(r"\bfloat\b|np\.float64")
#: Errors that the type or the framework explains.
PLAIN = {"NotImplementedError", "AssertionError", "StopIteration", "SystemExit"}

Function = ast.FunctionDef | ast.AsyncFunctionDef


def public(tree: ast.Module) -> Iterator[tuple[Function, str]]:
    """The public functions and methods of a module; the docstring of each, with its class's."""
    for owner in ast.walk(tree):
        if not isinstance(owner, ast.Module | ast.ClassDef) or (
            isinstance(owner, ast.ClassDef) and owner.name.startswith("_")
        ):
            continue
        above = ast.get_docstring(owner) or "" if isinstance(owner, ast.ClassDef) else ""
        for function in owner.body:
            if isinstance(function, Function) and not function.name.startswith("_"):
                yield function, f"{ast.get_docstring(function) or ''}\n{above}"


def raises(node: ast.AST) -> Iterator[str]:
    """Names of the errors raised in a node and not caught there; not in functions inside it."""
    if isinstance(node, Function | ast.ClassDef | ast.Lambda):
        return
    if isinstance(node, ast.Raise):
        error = node.exc.func if isinstance(node.exc, ast.Call) else node.exc
        if isinstance(error, ast.Name) and error.id[0].isupper():
            yield error.id
    body = node.body if isinstance(node, ast.Try) else []
    for child in ast.iter_child_nodes(node):
        if child not in body:
            yield from raises(child)
    if isinstance(node, ast.Try):
        caught = {
            name.id
            for handler in node.handlers
            if handler.type is not None
            for name in ast.walk(handler.type)
            if isinstance(name, ast.Name)
        }
        yield from (error for part in body for error in raises(part) if error not in caught)


def raised(function: Function) -> set[str]:
    """The names of the errors that leave a function and that it raises itself."""
    return {error for part in function.body for error in raises(part)} - PLAIN


def annotations(function: Function) -> str:
    """The types of the arguments and of the result."""
    given = (*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs)
    types = [a.annotation for a in given if a.annotation]
    return " ".join(ast.unparse(x) for x in (*types, *filter(None, [function.returns])))


def aliases(text: str) -> dict[str, str]:
    """The array types that a module names, by their names."""
    return {name: type_ for name, type_ in ALIAS.findall(text) if name != "Values"}


def shared_aliases() -> dict[str, str]:
    """The array types that modules of the packages name, for those that import them."""
    found: dict[str, str] = {}
    for folder in FOLDERS:
        for path in (ROOT / folder).glob("*.py"):
            for name, type_ in aliases(path.read_text(encoding="utf-8")).items():
                found[name] = type_ if found.get(name, type_) == type_ else "NDArray[Any]"
    return found


SHARED = shared_aliases()


def missing(function: Function, text: str, own: Mapping[str, str] = {}) -> list[str]:
    """What the docstring does not say; `own`: the array types of its module."""
    types = annotations(function)
    named = {**SHARED, **own}
    types = re.sub(r"(?<![.\w])\w+", lambda word: named.get(word[0], word[0]), types)
    said = []
    if "typer." in types:  # a command: its docstring is its --help, whose options have texts
        text = f"{text}\n{types}"
    if FLOATS.search(types) and not UNIT.search(text):
        said.append("a unit (or that a number has none)")
    if ARRAY.search(types) and not SHAPE.search(text):
        said.append("the shape of an array")
    if "typer." not in types:
        absent = (error for error in sorted(raised(function)) if error not in text)
        said += [f"when {error} is raised" for error in absent]
    return said


def findings(folder: str) -> list[str]:
    """One line for each public function of a folder whose docstring lacks something."""
    return [
        f"{path.relative_to(ROOT)}:{function.lineno}: {function.name} does not say {what}"
        for path in sorted((ROOT / folder).glob("*.py"))
        for code in (path.read_text(encoding="utf-8"),)
        for function, text in public(ast.parse(code))
        for what in missing(function, text, aliases(code))
    ]


@pytest.mark.parametrize("folder", FOLDERS)
def test_docstrings_give_units_shapes_and_errors(folder: str) -> None:
    found = findings(folder)
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("text", "lacks"),
    [
        ("def f(x: float): 'Double x.'", "a unit"),
        ("def f(x: float): 'Double x, in seconds.'", ""),
        ("def f(x: float): 'Double x, s.'", ""),
        ("def f(x: float): 'The factor of x.'", ""),
        ('def f(x: float): "The caller\'s m, as it is."', "a unit"),
        ("def f(x: NDArray[np.int32]): 'Sum.'", "the shape"),
        ("def f(x: FloatArray): 'Sum (n,).'", "a unit"),
        ("def f(x: IntArray): 'Sum.'", "the shape"),
        ("def f(x: IntArray): 'Sum of x (n,).'", ""),
        ("def f(x: NDArray[np.int32]): 'Sum of x, of shape (n,).'", ""),
        ("def f(x: NDArray[np.int32]): 'Sum of x (n, m).'", ""),
        ("def f(x: NDArray[np.int32]): 'Sum (of all, if any).'", "the shape"),
        ("def f(x):\n 'Check.'\n raise ConfigError('no')", "when ConfigError"),
        ("def f(x):\n 'Check.\\n\\nRaises:\\n ConfigError: always.'\n raise ConfigError('no')", ""),
        ("def f(x):\n 'Try.'\n try:\n  raise ValueError('no')\n except ValueError:\n  pass", ""),
        ("def f(x: Annotated[float, typer.Option(help='Time, s.')]): 'Run.'", ""),
        ("def f(x):\n 'Give g.'\n def g():\n  raise ConfigError('no')\n return g", ""),
        ("def _f(x: float): 'Double x.'", ""),
        ("class C:\n def f(self, x: float): 'Double.'", "a unit"),
    ],
)
def test_the_check_finds_what_is_missing(text: str, lacks: str) -> None:
    found = [what for function, doc in public(ast.parse(text)) for what in missing(function, doc)]
    assert (found == []) if not lacks else (len(found) == 1 and found[0].startswith(lacks))


#: Folders of laws and controllers, and what a module of them defines.
LAWS = {"fmus/models": r"^def (?:model|law)\(", "cosim/links": r"^    def stream\(.*\brng: "}
#: Modules of laws in folders of other modules, or without these functions.
LAW_MODULES = [
    *("cosim/predict/closed_form.py", "cosim/measure/energy.py", "cosim/predict/finite_gain.py"),
    *("cosim/measure/felt_impedance.py", "cosim/predict/network.py"),
    *("cosim/predict/frequency.py", "cosim/measure/manipulability.py"),
    *("cosim/bus/arbitration.py", "cosim/bus/response.py", "cosim/bus/simulation.py"),
    *("cosim/bus/stuffing.py", "cosim/bus/timing.py", "cosim/links/frozen.py"),
    *("cosim/graphs/graph.py", "cosim/links/presets.py", "cosim/links/semantics.py"),
    *("fmus/arms/dynamics.py", "fmus/models/replay.py", "fmus/arms/static_feedback.py"),
    *("fmus/paper/components.py", "fmus/paper/oracles.py"),
]
#: A paragraph that names an equation, a publication, a clause of a standard or our own work.
SOURCE = re.compile(
    r"^Source: [^\n]*(?:(?:\n(?!\n)[^\n]*)*?)"
    r"(?:the paper, |own construction|ISO \d|arXiv \d|th(?:at|ose) of ``|\b(?:19|20)\d\d\b)",
    re.MULTILINE,
)


def law_modules() -> list[str]:
    """The modules of laws, by their paths in the checkout."""
    found = [
        str(path.relative_to(ROOT))
        for folder, pattern in LAWS.items()
        for path in (ROOT / folder).glob("*.py")
        if re.search(pattern, path.read_text(encoding="utf-8"), re.MULTILINE)
    ]
    return sorted({*found, *LAW_MODULES})


def test_modules_of_laws_are_found() -> None:
    assert {"fmus/models/pd.py", "cosim/links/losses.py"} <= set(law_modules()) - set(LAW_MODULES)


@pytest.mark.parametrize("file", law_modules())
def test_a_law_gives_its_source(file: str) -> None:
    text = ast.get_docstring(ast.parse((ROOT / file).read_text(encoding="utf-8"))) or ""
    assert SOURCE.search(text), f"{file}: expected a paragraph 'Source: ...' in its docstring"


@pytest.mark.parametrize(
    ("text", "given"),
    [
        ("A law.\n\nSource: the paper, eq. (24).", True),
        ('A law.\n\nSource: D. Lee, M. W. Spong, "Passive\nteleoperation", 22(2), 2006.', True),
        ("A law.\n\nSource: own construction.", True),
        ("A law.", False),
        ("A law.\n\nSource: unknown.", False),
        ("A law.\n\nSource: unknown.\n\nSampled, since 1999.", False),
        ("A law, see the paper, eq. (24).", False),
    ],
)
def test_a_source_is_a_paragraph_that_names_one(text: str, given: bool) -> None:
    assert bool(SOURCE.search(text)) == given


#: Words with which a docstring begins that is no sentence and no noun phrase.
FRAGMENT = {
    *("What", "Whether", "How", "Of", "Those", "As", "Where", "Which", "From", "Why", "When"),
}


def fragments(tree: ast.Module) -> Iterator[str]:
    """The docstrings of a module, its classes and functions that begin as a fragment."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | Function):
            words = (ast.get_docstring(node) or "").split()
            if words and words[0].strip(".,:;") in FRAGMENT:
                yield " ".join(words)[:60]


@pytest.mark.parametrize("package", ["cosim", "bridge", "fmus", "build_backend"])
def test_docstrings_are_sentences_or_noun_phrases(package: str) -> None:
    found = {
        f"{path.relative_to(ROOT)}: {text}"
        for path in sorted((ROOT / package).rglob("*.py"))
        for text in fragments(ast.parse(path.read_text(encoding="utf-8")))
    }
    assert found == set()


@pytest.mark.parametrize(
    ("text", "found"),
    [('"""Of a command."""', 1), ('def f():\n "What is drawn."', 1), ('"""True if drawn."""', 0)],
)
def test_a_fragment_is_told_from_a_sentence(text: str, found: int) -> None:
    assert len(list(fragments(ast.parse(text)))) == found
