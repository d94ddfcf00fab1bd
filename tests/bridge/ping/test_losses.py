"""Losses each way of paths whose truth is known: deaths, duplicates, restarts, strangers."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest

from bridge.ping import measure
from bridge.ping.as_link import laws, traces
from bridge.ping.exchanges import Arrival, Exchanges
from bridge.ping.figures import PathResult, evaluate
from bridge.ping.measure import PacketCodec, PingResponder
from bridge.ping.packet import PingPacket, decode
from bridge.ping.report import text, values
from cosim.base.copies import replace
from cosim.links.losses import GilbertElliott, Independent

PERIOD, DELAY = 5_000_000, 2_000_000


@dataclass
class Mail:
    """A path of the responder without any time: what it answers is kept."""

    questions: list[Arrival] = field(default_factory=list)
    answers: list[PingPacket] = field(default_factory=list)

    def send(self, data: bytes, to: object = None) -> None:
        found = decode(data)
        assert found is not None
        self.answers.append(found)

    def receive(self, until_ns: int) -> Sequence[Arrival]:
        found, self.questions = self.questions, []
        return found

    def close(self) -> None:
        """Nothing to close."""


@dataclass
class Relay:
    """A path with a real responder behind it: how often each question (n,) and each answer (n,)
    arrives; `restarts`: questions before which the responder is started again.
    """

    there: np.ndarray
    back: np.ndarray
    restarts: tuple[int, ...] = ()
    strangers: dict[int, int] = field(default_factory=dict)

    def measured(self) -> PathResult:
        n = self.there.size
        record = Exchanges("relay", n, 128, PERIOD)
        codec, mail = PacketCodec(128), Mail()
        responder = PingResponder(mail)
        for k in range(n):
            t1 = 1_000_000_000 + k * PERIOD
            record.asked(t1, t1, 1000)
            if k in self.restarts:
                responder = PingResponder(mail)
            for i in range(self.strangers.get(k, 0)):
                other = PingPacket(False, i + 1, 0, t1).encode(128)
                mail.questions.append(Arrival(other, t1, 0, ("stranger", i)))
            responder.serve(0)
            mail.answers.clear()
            mail.questions = [Arrival(codec.question(k, t1), t1, 0, "us")] * int(self.there[k])
            responder.serve(0)
            for answer in mail.answers * int(self.back[k]):
                t2 = t1 + DELAY
                found = codec.answer(replace(answer, t2=t2, t3=t2, host=1).encode(), k + 1)
                assert found is not None
                record.answered(found, Arrival(b"", t2 + DELAY))
            mail.answers.clear()
        return evaluate(record)


def drawn(n: int, lost: float, rng: np.random.Generator, doubled: float = 0.0) -> np.ndarray:
    times = np.where(rng.random(n) < doubled, 2, 1)
    return np.where(rng.random(n) < lost, 0, times)


def test_a_path_that_dies_before_the_end_is_an_outage_and_lost() -> None:
    n, dies = 1000, 596
    found = Relay(np.arange(n) < dies, np.ones(n)).measured()
    loss = found.loss
    assert (loss.share, loss.there, loss.back) == (0.404, 0.404, 0.0)
    assert (loss.undecided, loss.outages) == (0.404, 1)
    assert loss.longest_outage == pytest.approx(405 * PERIOD * 1e-9)
    assert any("40.400% of the questions count as lost there although" in x for x in text(found))
    assert all(np.isnan(way[dies:]).all() for way in traces(found).values())


def test_a_path_that_lives_late_is_an_outage_and_lost_there() -> None:
    n, lives = 1000, 404
    loss = Relay(np.arange(n) >= lives, np.ones(n)).measured().loss
    assert (loss.share, loss.there, loss.back, loss.undecided) == (0.404, 0.404, 0.0, 0.0)
    assert loss.outages == 1
    # what was heard before the first answer came back is counted, too
    loss = Relay(np.ones(n), np.arange(n) >= lives).measured().loss
    assert (loss.there, loss.back, loss.outages) == (0.0, 0.404, 1)


@pytest.mark.parametrize(("there", "back"), [(0.047, 0.0), (0.0, 0.111), (0.1, 0.2)])
def test_duplicates_hide_no_losses(there: float, back: float) -> None:
    rng = np.random.default_rng(3)
    sent, answered = drawn(4000, there, rng, 0.3), drawn(4000, back, rng, 0.3)
    found = Relay(sent, answered).measured()
    truth = (sent == 0).mean(), (answered[sent > 0] == 0).mean()
    assert (found.loss.there, found.loss.back) == pytest.approx(truth, abs=2 / 4000)
    assert found.record.duplicates > 500


def test_a_responder_started_again_is_no_loss() -> None:
    rng = np.random.default_rng(5)
    sent, answered = drawn(4000, 0.04, rng), drawn(4000, 0.1, rng)
    sent[1900:1950] = 0  # nobody was there
    loss = Relay(sent, answered, restarts=(1950, 3000)).measured().loss
    truth = (sent == 0).mean(), (answered[sent > 0] == 0).mean()
    assert (loss.there, loss.back) == pytest.approx(truth, abs=6 / 4000)
    assert 50 / 4000 <= loss.undecided <= 56 / 4000


@pytest.mark.parametrize("kind", ["one by one", "bursts", "both ways"])
def test_a_law_of_one_way_has_the_losses_of_this_way_only(kind: str) -> None:
    rng = np.random.default_rng(7)
    n = 6000
    sent, answered = drawn(n, 0.12, rng), drawn(n, 0.05 if kind == "both ways" else 0.0, rng)
    if kind == "bursts":
        sent = np.repeat(drawn(n // 8, 0.12, rng), 8)
    fits = laws(Relay(sent, answered).measured())
    there, back = fits["there"].loss, fits["back"].loss
    assert isinstance(there, GilbertElliott if kind == "bursts" else Independent)
    assert there.share == pytest.approx((sent == 0).mean(), abs=2e-3)
    truth = (answered[sent > 0] == 0).mean()
    assert (0.0 if back is None else back.share) == pytest.approx(truth, abs=2e-3)


def test_strangers_do_not_end_the_count_of_who_asks_now(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measure, "SENDERS", 8)
    n = 200
    rng = np.random.default_rng(2)
    sent = drawn(n, 0.1, rng)
    few = Relay(sent, np.ones(n), strangers=dict.fromkeys(range(n), 2)).measured().loss
    assert few.there == pytest.approx((sent == 0).mean(), abs=1e-9)
    # more of them between two questions than are remembered: known to be unknown, not 0.8 lost
    many = Relay(sent, np.ones(n), strangers=dict.fromkeys(range(n), 9)).measured().loss
    assert many.there == pytest.approx((sent == 0).mean(), abs=1e-9)
    assert many.undecided == pytest.approx(many.there, abs=2 / n)


def test_figures_of_a_window_do_not_need_the_questions_before_it() -> None:
    rng = np.random.default_rng(4)
    sent, answered = drawn(2000, 0.05, rng), drawn(2000, 0.1, rng)
    window = evaluate(Relay(sent, answered).measured().record.between(1000, 1500)).loss
    part = slice(1000, 1500)
    assert window.there == pytest.approx((sent[part] == 0).mean(), abs=4 / 500)
    lost_back = (answered[part][sent[part] > 0] == 0).mean()
    assert window.back == pytest.approx(lost_back, abs=4 / 500)


def test_two_responders_at_once_leave_the_ways_unknown() -> None:
    record = Exchanges("two", 100, 128, PERIOD)
    mails = [Mail(), Mail()]
    ends = [PingResponder(mail) for mail in mails]
    ends[1]._counts += 7
    codec = PacketCodec(128)
    for k in range(100):
        t1 = k * PERIOD
        record.asked(t1, t1, 0)
        for mail, end in zip(mails, ends, strict=True):
            mail.questions = [Arrival(codec.question(k, t1), t1, 0, "us")]
            end.serve(0)
        answer = codec.answer(mails[k % 3 % 2].answers[-1].encode(), k + 1)
        assert answer is not None
        if k % 10:
            record.answered(answer, Arrival(b"", t1 + 2 * DELAY))
    found = evaluate(record)
    assert np.isnan(found.loss.there) and found.loss.share == 0.1
    assert values(found)["loss"]["there"] is None
    there, back = (np.isnan(way) for way in traces(found).values())
    assert there.sum() + back.sum() == 10 and not (there & back).any()


def test_numbers_far_apart_cost_neither_time_nor_memory() -> None:
    mail = Mail()
    responder = PingResponder(mail)
    for k in (0, 1, 2**63, 2**63 - 5000, 2**63 - 4095, 2**63 - 4095, 2**63 + 1):
        mail.questions.append(Arrival(PingPacket(False, 7, k, 1).encode(), 1, 0, "x"))
    responder.serve(0)
    assert [answer.heard for answer in mail.answers] == [1, 2, 3, 3, 4, 4, 5]


@pytest.mark.parametrize("late", [0, 3, 40])
def test_questions_and_answers_that_overtake_each_other_are_counted(late: int) -> None:
    """Each is up to `late` questions behind, as where a delay varies by many periods."""
    rng = np.random.default_rng(11)
    n = 1000
    sent, answered = drawn(n, 0.05, rng), drawn(n, 0.1, rng)
    record = Exchanges("overtaking", n, 128, PERIOD)
    codec, mail = PacketCodec(128), Mail()
    responder = PingResponder(mail)
    for k in range(n):
        record.asked(k * PERIOD, k * PERIOD, 0)
    for k in np.argsort(np.arange(n) + late * rng.random(n), kind="stable").tolist():
        mail.questions = [Arrival(codec.question(k, k * PERIOD), 0, 0, "us")] * int(sent[k])
        responder.serve(0)
    order = np.argsort(np.arange(len(mail.answers)) + late * rng.random(len(mail.answers)))
    for i in order.tolist():
        answer = codec.answer(mail.answers[i].encode(), n)
        assert answer is not None
        if answered[answer.k]:
            record.answered(answer, Arrival(b"", (answer.k + late) * PERIOD + DELAY))
    loss = evaluate(record).loss
    truth = (sent == 0).mean(), (answered[sent > 0] == 0).mean()
    assert (loss.there, loss.back) == pytest.approx(truth, abs=5 / n)
