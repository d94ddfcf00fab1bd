"""Write the rules of `cosim conform` into ``docs/conform.md``: ``python docs/conform_rules.py``."""

from __future__ import annotations

from pathlib import Path

from bridge.conform.participant import PARTICIPANT_RULES
from bridge.conform.rules import RuleBook

PAGE = Path(__file__).resolve().parent / "conform.md"
#: Rule books by the name in the marks of the page.
BOOKS = {"participants": PARTICIPANT_RULES}


def table(book: RuleBook) -> str:
    """The rules as a table; each clause is a link to the section that demands it."""
    lines = ["| rule | expected | clause | part |", "|---|---|---|---|"]
    for rule in book.rules:
        page, _, section = rule.clause.partition("#")
        name = (
            section.removeprefix(section.split("-")[0] + "-") if section[0].isdigit() else section
        )
        link = f"[{page.removesuffix('.md')}: {name.replace('-', ' ')}]({rule.clause})"
        lines.append(f"| {rule.number} {rule.title} | {rule.expected} | {link} | {rule.part} |")
    return "\n".join(lines)


def page() -> str:
    """The page with its tables as they have to be."""
    text = PAGE.read_text(encoding="utf-8")
    for name, book in BOOKS.items():
        begin, end = f"<!-- rules of {name}: python docs/conform_rules.py -->", "<!-- end -->"
        before, _, rest = text.partition(begin)
        text = f"{before}{begin}\n{table(book)}\n{end}{rest.partition(end)[2]}"
    return text


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    print(PAGE.name)
