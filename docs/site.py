"""Build the documentation site: ``python docs/site.py FOLDER`` in the checkout.

The pages are those of docs/, as they are. What can be generated is: every command from its help,
every key of every file from the structs that read it, the Python API, and a gallery of reports,
which are made by the commands that it shows. Each part prints how long it took. Sphinx treats
warnings as errors. Needs ``pip install -e '.[site]'``.
"""

from __future__ import annotations

import inspect
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from html import escape
from importlib import import_module
from itertools import chain
from pathlib import Path
from runpy import run_path
from tempfile import TemporaryDirectory

import msgspec

from cosim.base.clock import stopwatch

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
COSIM = str(Path(sys.executable).with_name("cosim"))

#: The pages by what a reader wants; every page of docs/ stands in one of them.
GROUPS: Mapping[str, tuple[str, ...]] = {
    "Begin": (
        "tutorial",
        "gallery",
        "running",
        "live",
        "own-component",
        "your-own-arm",
        "requirements",
        "testing",
    ),
    "Simulate": (
        "links",
        "arm",
        "controllers",
        "fmi",
        "sandbox",
        "firmware",
        "algorithms",
        "scale",
        "sweep",
        "falsify",
        "analysis",
        "certificates",
    ),
    "Rehearse": (
        "rehearsal",
        "can",
        "bus",
        "foreign-programs",
        "network",
        "recordings",
        "hardware",
        "safety",
        "faults",
        "participants",
        "conform",
        "conform-drives",
    ),
    "Concepts": ("paper", "design", "glossary"),
    "Reference": ("commands", "keys", "api", "models"),
    "Evidence": (
        "evidence/controllers",
        "evidence/paper",
        "evidence/arms",
        "evidence/speed",
        "evidence/safety",
        "evidence/drives",
        "evidence/bus-load",
        "evidence/bus-cases",
        "evidence/openarm-reports",
        "evidence/peers",
        "evidence/compatibility",
        "evidence/tests",
        "benchmarks",
        "golden",
    ),
    "中文": ("zh/index", "zh/tutorial"),
}
#: Pages that are made here, and pages of the checkout outside docs/.
GENERATED = ("gallery", "commands", "keys", "api", "models")
OUTSIDE = {"benchmarks": "benchmarks/README.md", "golden": "tests/golden/README.md"}

#: Modules with the structs that files are read into, by kind of file.
FILES: Mapping[str, tuple[str, ...]] = {
    "Scenario": (
        "cosim.scenario.spec", "cosim.graphs.named", "cosim.scenario.bus_spec",
        "cosim.links.spec",
    ),
    "Study": ("cosim.study.spec",),
    "Deployment": (
        "bridge.deployment.spec", "bridge.deployment.motors", "bridge.deployment.signal_spec",
        "bridge.safety.limits", "bridge.drives.model",
    ),
    "Faults, campaigns, soak tests": (
        "bridge.faults.spec", "bridge.campaign.spec", "bridge.campaign.plan",
        "bridge.campaign.soak_spec",
    ),
}  # fmt: skip

_STIFF = "--set components.master.parameters.k_p=100 --set components.master.parameters.k_d=10"
#: Reports of the gallery: name, title, and the command that makes it into the folder {out}.
GALLERY = (
    ("live", "Drag the delay: a run that this page repeats",
     "run configs/teleoperation.toml --live --out {out}"),
    ("run", "A run: teleoperation over delays of 0.3 to 1.2 s",
     "run configs/teleoperation.toml --out {out}"),
    ("openarm", "Two arms of seven joints", "run configs/openarm.toml --out {out}"),
    ("rehearsal", "A rehearsal: four nodes on two CAN buses",
     "rehearse configs/teleoperation.toml --deploy can -i cosim --clock simulated "
     "--set run.stop=4 --out {out}"),
    ("comparison", "Controllers side by side",
     "compare configs/teleoperation.toml --controllers paper,pd,p+d,nuno --operators light,tight "
     "--out {out}"),
    ("sweep", "A map of 1000 runs", "sweep configs/studies/lambda_M_K.toml --out {out}"),
    ("falsified", "The smallest network that breaks a stiff grip",
     f"falsify configs/teleoperation.toml {_STIFF} --set run.stop=10 "
     "--set 'require={near={always=\"abs(master.q) < 20 rad\"}}' --out {out}"),
    ("region", "Delays for which the same grip is certified at rest",
     f"check --certify configs/teleoperation.toml {_STIFF} --map 2 "
     "--falsified {out}/../falsified --out {out}"),
    ("reproduction", "The paper, claim by claim", "reproduce --out {out}"),
)  # fmt: skip

#: Introduction at the top of the first report of the gallery.
INTRODUCTION = (
    "<p>An operator's hand moves the <b>master</b> (blue); the <b>slave</b> (orange) follows over "
    "a network that delays each value by 0.3 to 1.2 s. Drag “greatest delay”: the arms find each "
    "other later. Loosen the operator's grip (k_p of the master) and they do so too late; tighten "
    "it and the torques are too large. Everything is computed in this page, and the command below "
    "the sliders gives the same run on your desk, bit for bit.</p>"
)

#: A report of 1280 by 960 pixels, a quarter as wide.
CARDS = """
.gallery { display: grid; grid-template-columns: repeat(auto-fill, 320px); gap: 28px 24px; }
.gallery figure { margin: 0; width: 320px; }
.gallery span { display: block; width: 320px; height: 240px; overflow: hidden;
  border: 1px solid #8884; border-radius: 6px; margin-bottom: 6px; }
.gallery iframe { width: 1280px; height: 960px; border: 0; transform: scale(0.25);
  transform-origin: 0 0; pointer-events: none; }
.gallery code { display: block; margin-top: 4px; font-size: 75%; overflow-wrap: anywhere; }
"""

CONF = """
project = "cosim-bridge"
author = "the maintainers"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence"]
suppress_warnings = ["myst.header", "misc.highlighting_failure"]
html_theme = "furo"
html_title = "cosim-bridge"
html_extra_path = ["extra"]
copybutton_prompt_text = "$ "
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
"""


def main() -> None:
    """Build the site into the folder that is named."""
    if len(sys.argv) != 2:
        sys.exit("expected one folder: python docs/site.py FOLDER")
    out = Path(sys.argv[1])
    with TemporaryDirectory() as scratch:
        source = Path(scratch) / "source"
        with timed("pages"):
            write_sources(source)
        write_gallery(source / "extra" / "gallery")
        sphinx = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html"]
        with timed("sphinx"):
            subprocess.run([*sphinx, str(source), str(out)], check=True, cwd=ROOT)
    print(f"site: {out / 'index.html'}")


@contextmanager
def timed(what: str) -> Iterator[None]:
    """Print how long the block took."""
    watch = stopwatch()
    yield
    print(f"{what:<14} {watch():6.1f} s", flush=True)


def written_pages() -> dict[str, Path]:
    """The files of the pages that are not generated, by name."""
    pages = {str(p.relative_to(DOCS).with_suffix("")): p for p in DOCS.rglob("*.md")}
    return pages | {name: ROOT / path for name, path in OUTSIDE.items()}


def misplaced(pages: Iterable[str]) -> set[str]:
    """Pages that stand in no group, and those of a group that are not there."""
    grouped = set(chain.from_iterable(GROUPS.values()))
    return (set(pages) - {"index"}) ^ (grouped - set(GENERATED))


def write_sources(source: Path) -> None:
    """Write everything that Sphinx reads into `source`; a page in no group ends the program."""
    source.mkdir(parents=True)
    pages = written_pages()
    if wrong := misplaced(pages):
        sys.exit(f"docs/site.py: GROUPS and docs/ differ in {', '.join(sorted(wrong))}")
    for name, path in pages.items():
        place = source / f"{name}.md"
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(_linked(path, name), encoding="utf-8")
    for picture in chain(DOCS.rglob("*.png"), DOCS.rglob("*.gif"), DOCS.rglob("*.svg")):
        copy = source / picture.relative_to(DOCS)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(picture, copy)
    generated = {"gallery": gallery(), "keys": keys(), "api": api(), "models": models()}
    (source / "commands").mkdir()
    for name, text in {**generated, **dict(commands())}.items():
        (source / f"{name}.md").write_text(text, encoding="utf-8")
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    (source / "index.md").write_text(f"{index}\n{_trees()}", encoding="utf-8")
    (source / "conf.py").write_text(CONF, encoding="utf-8")


def _linked(path: Path, name: str) -> str:
    """The text of a page; links to files of the checkout that are no pages become text."""
    pages = {place.resolve(): page for page, place in written_pages().items()}
    pages[ROOT / "README.md"] = "index"
    pages |= {DOCS / f"{page}.md": page for page in GENERATED}

    def link(found: re.Match[str]) -> str:
        mark, text, target, part = found.groups()
        place = (path.parent / target).resolve()
        if place == ROOT / "README.md":
            part = ""
        if place in pages:
            to = os.path.relpath(f"{pages[place]}.md", Path(name).parent)
            return f"{mark}[{text}]({to}{part or ''})"
        return found[0] if place.is_relative_to(DOCS) else text

    pattern = r"(!?)\[((?:[^\]\[]|\[[^\]]*\])+)\]\((?!\w+:)([^)#\s]+)(#[^)]*)?\)"
    return re.sub(pattern, link, path.read_text(encoding="utf-8"))


def _trees() -> str:
    return "\n".join(
        f"```{{toctree}}\n:hidden:\n:caption: {title}\n\n" + "\n".join(names) + "\n```\n"
        for title, names in GROUPS.items()
    )


# ---- generated pages ----------------------------------------------------------------------------


def commands() -> Iterator[tuple[str, str]]:
    """Names and texts of pages: one of all commands, and one for each group with their help."""
    from cosim.cli.overview import GROUPS as FIRST
    from cosim.cli.overview import MORE

    parts, entries = ["# Commands\n"], []
    for title, found in (*FIRST.items(), *MORE.items()):
        name = f"commands/{title.lower().replace(' ', '-')}"
        entries.append(f"{title} <{name}>")
        yield name, f"# Commands: {title}\n\n" + "\n".join(map(_help, found))
        rows = [f"| [cosim\u00a0{c}]({name}.md#cosim-{c}) | {line} |" for c, line in found.items()]
        parts.append("\n".join([f"## {title}\n", "| | |", "|---|---|", *rows, ""]))
    tree = "\n".join(["```{toctree}", ":hidden:", "", *entries, "```", ""])
    yield "commands", "\n".join([*parts, tree])


def _help(name: str) -> str:
    """A section of a page: the help of a command."""
    help_ = subprocess.run(
        [COSIM, name, "--help"], capture_output=True, text=True, check=True, cwd=ROOT,
        env={"COLUMNS": "88", "PATH": "", "NO_COLOR": "1", "TERM": "dumb"},
    )  # fmt: skip
    return f"## cosim {name}\n\n```text\n{help_.stdout.rstrip()}\n```\n"


def keys() -> str:
    """Every key of every file, from the structs; what they mean is on the pages of the files."""
    parts = [
        "# Keys\n\nThe tables of each file with their keys: type, and default where there is one. "
        'Values with a unit may be written as text, such as `"5 ms"`.\n'
    ]
    for title, modules in FILES.items():
        parts.append(f"## {title}\n")
        for module in modules:
            for struct in _structs(module):
                parts.append(f"### {struct.__name__}\n\n{_first(struct)}\n\n{_table(struct)}\n")
    return "\n".join(parts)


def _structs(module: str) -> Iterator[type[msgspec.Struct]]:
    """Structs whose fields are keys, in the order of the file."""
    found = vars(import_module(module)).values()
    mine = [
        x for x in found
        if inspect.isclass(x) and issubclass(x, msgspec.Struct) and x.__module__ == module
        and x.__struct_fields__
    ]  # fmt: skip
    yield from sorted(mine, key=lambda x: inspect.getsourcelines(x)[1])


def _first(struct: type) -> str:
    """The documentation of a struct, as text of a page."""
    text = inspect.getdoc(struct) or ""
    return re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text).replace("``", "`").replace("<", "&lt;")


def _table(struct: type[msgspec.Struct]) -> str:
    """The keys of a struct, also those that it inherits."""
    bases = [x for x in reversed(struct.__mro__) if issubclass(x, msgspec.Struct)]
    types = {name: str(kind) for base in bases for name, kind in base.__annotations__.items()}
    rows = ["| key | type | default |", "|---|---|---|"]
    for field in msgspec.structs.fields(struct):
        kind = types.get(field.name, "").replace("|", "\\|")
        rows.append(f"| `{field.encode_name}` | `{kind}` | {_default(field)} |")
    return "\n".join(rows) + "\n"


def _default(field: msgspec.structs.FieldInfo) -> str:
    if field.required:
        return "needed"
    if field.default is msgspec.NODEFAULT:
        return "empty"
    return f"`{field.default!r}`" if field.default not in (None, "", ()) else ""


def models() -> str:
    """Every model with its ports, parameters and equations."""
    return str(run_path(str(DOCS / "models.py"))["page"]())


def api() -> str:
    """The names that ``import cosim`` offers."""
    stub = (ROOT / "cosim" / "__init__.pyi").read_text(encoding="utf-8")
    parts = ["# Python API\n\nExamples: [running.md](running.md#from-python).\n\n```{eval-rst}"]
    for module, name in re.findall(r"from (\S+) import \S+ as (\S+)", stub):
        found = getattr(import_module(module), name)
        kind = "autoclass" if inspect.isclass(found) else "autofunction"
        parts.append(
            f".. {kind}:: cosim.{name}" + ("\n   :members:\n" if kind == "autoclass" else "\n")
        )
    return "\n".join([*parts, "```\n"])


# ---- gallery ------------------------------------------------------------------------------------


def gallery() -> str:
    """The reports of the gallery, small, with the commands that make them."""
    cards = "\n".join(_card(*entry) for entry in GALLERY)
    return (
        "# Gallery\n\nReports that these commands made; each is one file that any browser opens."
        f"\n\n<style>{CARDS}</style>\n<div class='gallery'>\n{cards}\n</div>\n"
    )


def _card(name: str, title: str, command: str) -> str:
    """A report as a small picture of itself, which leads to it."""
    page, text = f"gallery/{name}.html", command.replace(" --out {out}", "")
    text = escape(text.replace("{out}/../falsified", "runs/teleoperation-falsified"))
    return (
        f"<figure><a href='{page}'><span><iframe src='{page}' title='{escape(title)}' "
        f"loading='lazy' scrolling='no' tabindex='-1'></iframe></span>{escape(title)}</a>"
        f"<code>cosim {text}</code></figure>"
    )


def write_gallery(folder: Path) -> None:
    """Run the commands of the gallery, and keep their reports. Raises CalledProcessError.

    A command that has found what it searched ends with 1.
    """
    folder.mkdir(parents=True)
    with TemporaryDirectory() as scratch:
        for name, _, command in GALLERY:
            out = Path(scratch) / name
            call = shlex.split(command.replace("{out}", str(out)))
            with timed(f"gallery/{name}"):
                done = subprocess.run([COSIM, *call], cwd=ROOT, stdout=subprocess.DEVNULL)
            if done.returncode != (name == "falsified"):
                raise subprocess.CalledProcessError(done.returncode, done.args)
            page = "region" if name == "region" else "report"
            text = (out / f"{page}.html").read_text(encoding="utf-8")
            if name == "live":
                text = text.replace("</header>", f"</header>{INTRODUCTION}", 1)
            text = re.sub(r'<a href="[\w/.-]+report\.html">(.*?)</a>', r"\1", text)  # not there
            (folder / f"{name}.html").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
