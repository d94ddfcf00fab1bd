"""The tests that are asked about a change, in order: as many as a budget of time allows.

Asked are the files of tests that execute the block of C code in which the change lies, every file
of the group where it lies in none (Python code, a constant). Of these the tests come first that
execute the block themselves; among them those that noticed changes of the same source before, then
those in the folder that mirrors the source's, then those of the files that execute little else,
then the fastest ones.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from tests.mutants.blocks import Block, block_of
from tests.mutants.changes import Mutant
from tests.mutants.trial import Outcome

#: Tests that take more processor time or wall time than this, s, are left out.
CPU, WALL = 3.0, 20.0
#: So many files of tests, which fit a source best, are asked before the others.
FIRST = 3
#: A test that takes this many times its processor time, and 0.5 s more, waits for a clock.
WAITS = 3.0


class Choice:
    """Chooses the tests for changes; learns from what they noticed.

    `measured`: of each file of tests what it does in the unchanged program; `budget`: processor
    time of the tests of one change, s.
    """

    def __init__(
        self, measured: Mapping[str, Outcome], blocks: Sequence[Block], budget: float
    ) -> None:
        self._measured, self._blocks, self._budget = measured, blocks, budget
        self._noticed: Counter[tuple[str, str]] = Counter()
        self.seconds = {test: s for known in measured.values() for test, s in known.seconds.items()}
        failed = {test for known in measured.values() for test in known.failures}
        slow = {test for test, (wall, cpu) in self.seconds.items() if cpu > CPU or wall > WALL}
        self._left_out = {test: "fails without a change" for test in failed}
        self._left_out |= {test: "takes too long" for test in slow - failed}

    def said(self) -> str:
        """The number of tests, their time, and those that are left out, in words."""
        kept = [s for test, s in self.seconds.items() if test not in self._left_out]
        cpu = sum(s for _, s in kept)
        names = "".join(f"\n    {why}: {test}" for test, why in sorted(self._left_out.items()))
        return f"{len(kept)} tests, {cpu:.0f} s of processor time{names}"

    def executing(self, mutant: Mutant) -> list[str]:
        """The files of tests that execute the block of a change, in the order of their fitness."""
        number = block_of(self._blocks, mutant.file, mutant.at)
        source, room = str(mutant.file), f"tests/{mutant.file.parent}/"
        own = {block.number for block in self._blocks if block.file == mutant.file}
        ranks: dict[str, tuple[float, ...]] = {}
        for name, known in self._measured.items():
            executed = known.blocks()
            if number is None or number in executed or not known.executed:
                share = len(executed & own) / max(1, len(executed))
                cost = sum(cpu for _, cpu in known.seconds.values())
                far = not name.startswith(room)
                ranks[name] = (-self._noticed[source, name], far, -share, cost)
        return sorted(ranks, key=lambda name: (ranks[name], name))

    def tests(self, mutant: Mutant) -> tuple[list[str], int]:
        """The tests to ask about a change, in order, and how many there are without a budget."""
        number = block_of(self._blocks, mutant.file, mutant.at)
        source = str(mutant.file)
        ranks: dict[str, tuple[float, ...]] = {}
        for place, name in enumerate(self.executing(mutant)):
            known = self._measured[name]
            for test, (_, cpu) in known.seconds.items():
                if test not in self._left_out:
                    own = known.executed.get(test, [])
                    indirect = number is not None and bool(known.executed) and number not in own
                    noticed = self._noticed[source, test]
                    ranks[test] = (indirect, -noticed, place >= FIRST, cpu)
        chosen, left = [], self._budget
        for test in sorted(ranks, key=lambda test: ranks[test]):
            left -= self.seconds[test][1]
            if left < 0 and chosen:
                break
            chosen.append(test)
        return chosen, len(ranks)

    def rounds(self, mutant: Mutant, tests: Sequence[str]) -> Iterator[list[str]]:
        """The files of these tests, in order: first the best few, then the others."""
        there = {file_of(test) for test in tests}
        files = [name for name in self.executing(mutant) if name in there]
        yield from (part for part in (files[:FIRST], files[FIRST:]) if part)

    def waits(self, test: str) -> bool:
        """True if a busy machine can make this fail: a test that waits, or no test at all."""
        wall, cpu = self.seconds.get(test, (1.0, 0.0))
        return wall > 0.5 + WAITS * cpu

    def noticed(self, source: Path, test: str) -> None:
        """Remember which test noticed a change of a source."""
        self._noticed[str(source), test] += 1
        self._noticed[str(source), file_of(test)] += 1


def file_of(test: str) -> str:
    """The file of a test."""
    return test.partition("::")[0]
