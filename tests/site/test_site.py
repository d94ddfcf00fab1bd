"""The site is built without a warning, with every command, every page and the reports."""

from __future__ import annotations

import re
import subprocess
import sys
from html import unescape
from pathlib import Path

import pytest

from cosim.cli.overview import GROUPS, MORE

pytestmark = [pytest.mark.slow, pytest.mark.site]
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out: Path = tmp_path_factory.mktemp("site") / "out"
    done = subprocess.run(
        [sys.executable, "docs/site.py", str(out)], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return out


def test_every_page_is_there_and_leads_to_pages_that_are(site: Path) -> None:
    sources = [p.relative_to(ROOT / "docs") for p in (ROOT / "docs").rglob("*.md")]
    assert all((site / p.with_suffix(".html")).is_file() for p in sources)
    for page in site.rglob("*.html"):
        if page.parent.name == "gallery":
            continue
        text = page.read_text(encoding="utf-8")
        for link in re.findall(r'(?:href|src)="([^"#:?]+)[^":]*"', text):
            assert (page.parent / unescape(link)).exists(), f"{page.name}: {link}"


def test_the_reference_has_every_command_and_key(site: Path) -> None:
    commands = (site / "commands.html").read_text(encoding="utf-8")
    for title, group in (*GROUPS.items(), *MORE.items()):
        page = f"commands/{title.lower().replace(' ', '-')}.html"
        text = (site / page).read_text(encoding="utf-8")
        for name in group:
            assert f'<section id="cosim-{name}">' in text and f"Usage: cosim {name}" in text
            assert f'href="{page}#cosim-{name}"' in commands
    keys = (site / "keys.html").read_text(encoding="utf-8")
    for key in ("lambda_M", "extrapolate", "q_jump", "record", "probability", "keep"):
        assert (f">{key}<" in keys) == (key != "lambda_M")  # a parameter of models is no key
    api = (site / "api.html").read_text(encoding="utf-8")
    assert all(f'id="cosim.{name}"' in api for name in ("run", "open", "sweep", "RunResult"))


def test_the_reports_of_the_gallery_are_pages_by_themselves(site: Path) -> None:
    reports = sorted(p.name for p in (site / "gallery").iterdir())
    assert len(reports) == 9
    for name in reports:
        text = (site / "gallery" / name).read_text(encoding="utf-8")
        assert "default-src 'none'" in text and 'class="verdict' in text
        assert f"<iframe src='gallery/{name}'" in (site / "gallery.html").read_text("utf-8")
    assert 'href="gallery.html"' in (site / "index.html").read_text(encoding="utf-8")
