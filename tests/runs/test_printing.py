"""What is made after a run never fails the run."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from torch_pmil.runs.printing import making_the_rest, success_rates, tell, warn_incomplete
from torch_pmil.runs.run_folder import write_origin
from torch_pmil.search.promise import Promise


def failing(error: BaseException):
    def step() -> None:
        raise error

    return step


def test_every_step_is_taken_whatever_became_of_those_before_and_may_depend_on_them() -> None:
    made: list[str] = []

    def steps():
        yield "figures", failing(ValueError("two\nlines"))
        yield "video", failing(RuntimeError())
        yield "poses", lambda: made.append("poses")
        if made:
            yield "report", lambda: made.append("report")

    assert tell(steps()) == ["figures: two lines", "video: RuntimeError"]
    assert made == ["poses", "report"]


def test_after_ctrl_c_nothing_more_is_made() -> None:
    steps = [("video", failing(KeyboardInterrupt())), ("report", failing(AssertionError()))]
    assert tell(steps) == ["video: stopped", "report: stopped"]


def test_what_is_missing_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    warn_incomplete("", [], "pmil resume run")
    assert capsys.readouterr() == ("", "")
    warn_incomplete("a: ", tell([("video", failing(OSError("x\n" * 10_000)))]), "pmil resume run")
    printed, complained = capsys.readouterr()
    assert (printed, complained.count("\n")) == ("", 1) and len(complained) < 1200
    assert complained.startswith("a: the report is incomplete: video: x x ")
    assert complained.endswith(
        " x x; pmil resume run makes the rest later, pmil report the page alone\n"
    )
    warn_incomplete("", ["video: none"], making_the_rest(Path("-a b")))
    assert "; pmil resume './-a b' makes" in capsys.readouterr().err


def test_command_that_makes_the_rest_names_the_task_if_it_is_ones_own(tmp_path: Path) -> None:
    for name, words in (("biorob", ""), ("own.py:make", " experiment=own.py:make")):
        write_origin(tmp_path, {"command": f"pmil train seed=1 experiment={name}"})
        assert making_the_rest(tmp_path) == f"pmil resume {tmp_path}{words}"


@pytest.mark.parametrize(
    ("rates", "rate", "line"),
    [
        ((0.3, 0.354, 0.312), 0.95, "measured 30%, predicted 35%, promised 31.2%, asked 97.5%"),
        ((None, 0.1, None), 0.9, "predicted 10%, asked 95.0%"),
        ((1.0, None, None), None, "measured 100%"),
        ((None, None, None), None, ""),
    ],
)
def test_trial_shows_its_success_rates_and_the_one_that_ends_a_run(
    rates: tuple[float | None, ...], rate: float | None, line: str
) -> None:
    names = ("success_rate", "predicted_success_rate", "promised_success_rate")
    trial = SimpleNamespace(**dict(zip(names, rates, strict=True)))
    promise = None if rate is None else Promise(rate, lambda states: states, 0.1)
    assert ", ".join(success_rates(trial, promise)) == line
