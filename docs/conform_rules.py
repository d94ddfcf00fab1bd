"""Write the rules of `cosim conform` into its pages: ``python docs/conform_rules.py``."""

from __future__ import annotations

from pathlib import Path

from bridge.conform.drives.cia402 import CIA402
from bridge.conform.drives.damiao import DAMIAO
from bridge.conform.drives.odrive import ODRIVE
from bridge.conform.participant import PARTICIPANT_RULES
from bridge.conform.rules import RuleBook

HERE = Path(__file__).resolve().parent
PAGE, DRIVES = HERE / "conform.md", HERE / "conform-drives.md"
#: Rule books by the name in the marks of their page.
BOOKS = {
    PAGE: {"participants": PARTICIPANT_RULES},
    DRIVES: {protocol.name: protocol.book for protocol in (DAMIAO, ODRIVE, CIA402)},
}


def table(book: RuleBook) -> str:
    """The rules as a table; each clause is a link to the section that demands it."""
    parts = any(rule.part for rule in book.rules)
    head = ["rule", "expected", "clause", *(["part"] if parts else [])]
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for rule in book.rules:
        page, _, section = rule.clause.partition("#")
        name = (
            section.removeprefix(section.split("-")[0] + "-") if section[:1].isdigit() else section
        )
        link = f"[{page.removesuffix('.md')}: {name.replace('-', ' ')}]({rule.clause})"
        link = link if section else rule.clause  # a vendor's document
        cells = [
            f"{rule.number} {rule.title}",
            rule.expected,
            link,
            *([rule.part] if parts else []),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def page(path: Path = PAGE) -> str:
    """A page with its tables as they have to be."""
    text = path.read_text(encoding="utf-8")
    for name, book in BOOKS[path].items():
        begin, end = f"<!-- rules of {name}: python docs/conform_rules.py -->", "<!-- end -->"
        before, _, rest = text.partition(begin)
        text = f"{before}{begin}\n{table(book)}\n{end}{rest.partition(end)[2]}"
    return text


if __name__ == "__main__":
    for path in BOOKS:
        path.write_text(page(path), encoding="utf-8")
        print(path.name)
