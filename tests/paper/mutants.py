"""Wrong laws that the claims have to notice, and ``python -m tests.paper.mutants [TOPIC ...]``.

Each changes one line of the C code of the controllers, or what they are wired to; the command runs
the claims about the topics (default: all) with each of them and prints how many fail. With all
claims that takes some minutes.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fmus.build import shipped, source
from fmus.paper.claim import Claim, judge
from fmus.paper.claims import cases, select
from fmus.paper.experiments import PERIOD, Document
from fmus.paper.reproduction import open_case, run_case

CODE = Path(source.__file__).parents[1] / "c"


@dataclass(frozen=True)
class WrongLaw:
    """`old` becomes `new` in a C file, or `change` makes another document of each.

    `noticed`: claims that have to fail.
    """

    name: str
    noticed: tuple[str, ...]
    file: str = ""
    old: str = ""
    new: str = ""
    change: Callable[[Document], Document] = lambda document: document


def later(document: Document) -> Document:
    """The document with every delay a sample longer."""
    return {**document, "links": [_later(link) for link in document.get("links", [])]}


def _later(link: dict[str, Any]) -> dict[str, Any]:
    delay = link["delay"]
    longer = {key: delay[key] + PERIOD for key in ("delay", "low", "high") if key in delay}
    return {**link, "delay": {**delay, **longer}}


def stale(document: Document) -> Document:
    """The document whose controllers see the motion of their arms a sample late."""
    components, links = dict(document["components"]), list(document.get("links", []))
    for name, component in document["components"].items():
        if component["model"].endswith((".adaptive", ".teleoperation")):
            inputs = dict(component["inputs"])
            delay = {"law": "constant", "delay": component["period"]}
            for port in ("q", "dq"):
                links.append({"from": inputs.pop(port), "to": f"{name}.{port}", "delay": delay})
            components[name] = {**component, "inputs": inputs}
    return {**document, "components": components, "links": links}


_LAW, _REGRESSOR = "teleoperation.c", "regressor.h"
WRONG = (
    WrongLaw("K[1] := K[0]", ("eq31", "unequal-push-2", "unequal-rest"), _LAW,
             "0.0, x->K[i]);", "0.0, x->K[0]);"),
    WrongLaw("K without its off-diagonal entry", ("eq31-full", "full-push-2"), _LAW,
             "0.0, x->K_off);", "0.0, 0.0 * x->K_off);"),
    WrongLaw("Gamma[i] := Gamma[0]", ("eq32",), _LAW,
             "Real rate = x->Gamma[i] * Ys[i];", "Real rate = x->Gamma[0] * Ys[i];"),
    WrongLaw("Gamma without its off-diagonal entries", ("eq32-full",), _LAW,
             "rate += gamma_entry(x, i, j) * Ys[j];", "rate += 0.0 * Ys[j];"),
    WrongLaw("no anti-windup", ("limit-windup",), _LAW,
             "PICK(y.saturated, 0.0, h);", "PICK(y.saturated, h, h);"),
    WrongLaw("the estimate and z a sample late", ("eq29-30",), _LAW,
             "law(x, x->z_next, x->theta_hat_next, &y);", "law(x, x->z, x->theta_hat, &y);"),
    WrongLaw("C not of Christoffel's symbols", ("eq31", "eq32"), _REGRESSOR,
             "(dq[1] * z[0] + (dq[0] + dq[1]) * z[1])", "(2.0 * dq[1] * z[0] + dq[1] * z[1])"),
    WrongLaw("Remark 3 without its feedback", ("remark3-rate",), _LAW,
             "PICK(inertial, y->dz[i] - x->lambda_c * y->s[i],", "PICK(inertial, y->dz[i],"),
    WrongLaw("gravity adapts by the second joint only", ("upright-one-energy",), _LAW,
             "Ys[4] = c12 * (s[0] + s[1]);", "Ys[4] = c12 * s[1];"),
    WrongLaw("no s in the reference", ("eq29-30", "eq33-1"), _LAW,
             "x->lambda_M * (dq[i] - z[i])", "x->lambda_M * dq[i]"),
    WrongLaw("delays a sample longer", ("eq80", "first-motion"), change=later),
    WrongLaw("the motion a sample late", ("eq29-30", "sampled-decay"), change=stale),
)  # fmt: skip


def changed(law: WrongLaw) -> str:
    """The text of its C file. Raises LookupError if the code is no longer what it changes."""
    text = (CODE / law.file).read_text(encoding="utf-8")
    if text.count(law.old) != 1:
        raise LookupError(f"{law.name}: {law.old!r} stands {text.count(law.old)} times in the code")
    return text.replace(law.old, law.new)


@contextmanager
def wrong(law: WrongLaw, folder: Path) -> Iterator[None]:
    """Build models from the changed code, into a cache in `folder`."""
    if not law.file:
        yield
        return
    copy = folder / "fmus" / "c"
    shutil.copytree(CODE, copy)
    for room in ("build", "model"):  # the generator
        shutil.copytree(CODE.parent / room, copy.parent / room)
    (copy / law.file).write_text(changed(law), encoding="utf-8")
    kept, cache = (source._FOLDER, shipped.FOLDER), os.environ.get("XDG_CACHE_HOME")
    source._FOLDER, os.environ["XDG_CACHE_HOME"] = copy, str(folder / "cache")
    shipped.FOLDER = folder / "none"  # the FMUs of the installation are of the right law
    _forget()
    try:
        yield
    finally:
        source._FOLDER, shipped.FOLDER = kept
        os.environ.pop("XDG_CACHE_HOME")
        os.environ |= {"XDG_CACHE_HOME": cache} if cache else {}
        _forget()


def _forget() -> None:
    for cached in (source.sources, source._written, source.token):
        cached.cache_clear()


def failing(law: WrongLaw, claims: Sequence[Claim], folder: Path) -> list[str]:
    """Names of the claims that fail with the wrong law."""
    documents = cases(0)
    names = sorted({case for claim in claims for case in claim.cases})
    with wrong(law, folder):
        found = {}
        for name in names:
            document = law.change(documents[name])
            stop = run_case(name, {k: v for k, v in document.items() if v}, folder)
            found[name] = open_case(name, folder, stop)
        return [claim.name for claim in claims if not judge(claim, found).passed]


def main(topics: Sequence[str]) -> int:
    """Print how many claims notice each wrong law; 1 where one goes unnoticed."""
    claims, unnoticed = select(topics).claims, 0
    for law in WRONG:
        with tempfile.TemporaryDirectory() as folder:
            names = failing(law, claims, Path(folder))
        unnoticed += not names
        print(f"{law.name}: {len(names)} of {len(claims)}: {', '.join(names[:6])}", flush=True)
    return int(unnoticed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
