"""What newcomers hand over: by kind, how many cases come out right, named in one line, or wrong.

A case is right if the task that is made holds the demonstrated motion and nothing is complained of.
It is named if one line, an error or a warning, says what is the matter. Anything else is wrong: a
silent error, a refusal of what is right, and an error that has several lines or is not a sentence
of this package.

Example:
    python -m benchmarks.front_door
"""

from __future__ import annotations

import argparse
import re
import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from benchmarks.command_line import add_json, source_of, write_summary
from torch_pmil import PMIL, DemonstrationError
from torch_pmil.runs.diagnosis.before_a_run import check
from torch_pmil.tasks.rehearsal import rehearse

ERRORS = (DemonstrationError, TypeError, ValueError, OSError)
LONGEST = 400  # letters of a clear line
DEGREES = 180 / np.pi
NEAR = 0.02  # largest error of a demonstrated mean, in its largest value

Array = np.ndarray


class Joint(gymnasium.Env):
    """A hanging joint: angle and velocity, torque within 6 N·m, 1 kHz inside."""

    dt: float | None = 0.1

    def __init__(
        self,
        scale: float = 1.0,
        turned: bool = False,
        order: tuple[int, int] = (0, 1),
        rates: float = 1.0,
        start: float = 0.0,
        wraps: bool = False,
    ) -> None:
        self.observation_space = Box(-np.inf, np.inf, (3 if turned else 2,), np.float64)
        self.action_space = Box(-6.0, 6.0, (1,), np.float64)
        self.scale, self.turned, self.order = scale, turned, list(order)
        self.rates, self.start, self.wraps = rates, start, wraps

    def _shown(self) -> Array:
        q, dq = self.state
        if self.turned:
            return np.array([np.cos(q), np.sin(q), dq])
        q = np.remainder(q + np.pi, 2 * np.pi) - np.pi if self.wraps else q
        return (self.scale * np.array([q, self.rates * dq]))[self.order]

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Array, dict]:
        super().reset(seed=seed)
        self.state = np.array([self.start, 0.0]) + 0.02 * self.np_random.standard_normal(2)
        return self._shown(), {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict]:
        q, dq = self.state
        for _ in range(round(1000 * (self.dt or 0.1))):
            dq += 0.001 * (action[0] - 3.0 * np.sin(q) - 0.5 * dq)
            q += 0.001 * dq
        self.state = np.array([q, dq])
        return self._shown(), 0.0, False, False, {}


class Clockless(Joint):
    """The same without a word on the length of its step."""

    dt = None


def reach(times: Array, number: int = 0, start: float = 0.0, end: float = 1.0) -> Array:
    """A smooth reach of 1.5 s, then rest."""
    s = np.clip(times / 1.5, 0, 1)
    return start + (end + 0.02 * number - start) * (10 * s**3 - 15 * s**4 + 6 * s**5)


def wrapped(angles: Array, half: float = np.pi) -> Array:
    return np.remainder(angles + half, 2 * half) - half


Columns = Callable[[Array, int], dict[str, Array]]


def write(
    path: Path,
    columns: Columns,
    rate: float = 10.0,
    stamps: Callable[[Array, int], Array] = lambda times, _: times,
    keep: Callable[[Array, int], Array] | None = None,
    form: str = "%.12g",
) -> Path:
    """Five recordings of 2 s in a CSV file."""
    lines = []
    for number in range(5):
        times = np.arange(round(2 * rate) + 1) / rate
        if keep is not None:
            times = times[keep(times, number)]
        shown = columns(times, number)
        for row in zip(stamps(times, number), *shown.values(), strict=True):
            lines.append(",".join([str(number), *(form % each for each in row)]))
    path.write_text("\n".join([",".join(["demonstration", "time", *shown]), *lines]) + "\n")
    return path


@dataclass(frozen=True)
class Case:
    """What is handed over, and what should come of it."""

    kind: str
    name: str
    make: Callable[[Path], tuple[Any, Any, float, dict[str, Any]]]  # robot, file, period, said
    right: Callable[[Array], Array] | None = None  # demonstrated mean at times of the robot
    named: str = ""  # words of the line that says what is the matter


def handed_over(case: Case, folder: Path) -> str:
    """What comes of a case: "right", "named: LINE" or "wrong: WHY"."""
    robot, recordings, period, said = case.make(folder)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            task = PMIL(robot, recordings, period, **said).task
            rehearse(task)
            said_of_it = [finding.message for finding in check(task)]
        except ERRORS as error:
            return _judged(case, [str(error)], None)
        except Exception as error:  # whatever else it is: a riddle to a newcomer
            return f"wrong: {type(error).__name__}: {error}"
    said_of_it += [str(one.message) for one in caught]
    mean = task.demonstrations.positions.mean(0).numpy()
    return _judged(case, said_of_it, mean)


def _judged(case: Case, lines: list[str], mean: Array | None) -> str:
    unclear = [line for line in lines if "\n" in line or len(line) > LONGEST]
    if unclear:
        return f"wrong: {unclear[0]!r:.200}"
    if case.named:
        found = [line for line in lines if re.search(case.named, line)]
        return f"named: {found[0]}" if found else f"wrong: {lines or 'nothing'} was said"
    if mean is None or lines:
        return f"wrong: {lines[0]}"
    if case.right is not None:
        expected = case.right(mean)
        if (
            mean.shape != expected.shape
            or np.abs(mean - expected).max() > NEAR * np.abs(expected).max()
        ):
            return (
                f"wrong: {mean[:, 0].round(3).tolist()} of {len(mean)} for {len(expected)} samples"
            )
    return "right"


def shown(
    start: float = 0.0, end: float = 1.0, scale: float = 1.0, half: float | None = None
) -> Columns:
    """A reach of q, times a scale, within half a turn on each side if that is given."""

    def columns(times: Array, number: int) -> dict[str, Array]:
        q = scale * reach(times, number, start, end)
        return {"q": q if half is None else wrapped(q, half)}

    return columns


def expected(period: float = 0.1, start: float = 0.0, end: float = 1.0, scale: float = 1.0) -> Any:
    """The mean of five recordings at times of the robot."""
    times = np.arange(round(2.0 / period) + 1) * period
    mean = scale * reach(times, 2, start, end)[:, None]
    return lambda _: mean


def case(
    kind: str,
    name: str,
    robot: Callable[[], Any] = Joint,
    columns: Columns | None = None,
    named: str = "",
    right: Any = None,
    period: float = 0.1,
    said: dict[str, Any] | None = None,
    edit: Callable[[str], str] = lambda text: text,
    **written: Any,
) -> Case:
    said = {"state": ("q", "dq"), **(said or {})}

    def make(folder: Path) -> tuple[Any, Any, float, dict[str, Any]]:
        path = write(folder / "recorded.csv", columns or shown(), **written)
        path.write_text(edit(path.read_text()))
        return robot(), path, period, said

    return Case(kind, name, make, right if named == "" else None, named)


def angles() -> Iterator[Case]:
    kind, turns, over = "wrapped angles", {"said": {"angles": ("q",)}}, (2.5, 4.0)
    there, truth, through = (
        partial(Joint, start=2.5),
        expected(0.1, *over),
        shown(*over, half=np.pi),
    )
    below, lower = (
        partial(Joint, start=2.5 - 2 * np.pi),
        expected(0.1, 2.5 - 2 * np.pi, 4.0 - 2 * np.pi),
    )
    degrees = shown(*np.degrees(over), half=180.0)
    for rate in (10.0, 100.0):
        given = {"rate": rate, **turns}
        yield case(kind, f"through pi at {rate:g} Hz", there, through, right=truth, **given)
        yield case(kind, f"robot a turn below, {rate:g} Hz", below, through, right=lower, **given)
        robot = partial(Joint, start=2.5, wraps=True)
        yield case(kind, f"robot wraps too, {rate:g} Hz", robot, through, right=truth, **given)
        yield case(kind, f"undeclared, {rate:g} Hz", there, through, "q.*(turn|wrap)", rate=rate)
        yield case(kind, f"degrees, {rate:g} Hz", there, degrees, "degrees|turn", **given)

    def each_further(times: Array, number: int) -> dict[str, Array]:
        return {"q": reach(times, number, *over) + 2 * np.pi * number}

    far = expected(end=9.0)
    yield case(kind, "each a turn further", there, each_further, right=truth, **turns)
    yield case(kind, "beyond a turn, continuous", Joint, shown(end=9.0), right=far, **turns)
    arctangent = {"right": far, "rate": 50.0, **turns}
    yield case(kind, "arctangent beyond a turn", Joint, shown(end=9.0, half=np.pi), **arctangent)


def clocks() -> Iterator[Case]:
    kind, jitter = "stamps of floats", np.random.default_rng(0)
    stamps = {
        "epoch": lambda t, n: t + 1.7e9 + 37.3 * n,
        "float32": lambda t, n: t.astype(np.float32).astype(float) + 0.1,
        "three decimals": lambda t, n: np.round(t + 0.0123, 3),
        "jitter of 1 us": lambda t, n: t + 1e-6 * jitter.standard_normal(len(t)),
        "jitter of 5 %": lambda t, n: t + (t[1] - t[0]) * 0.05 * jitter.uniform(-1, 1, len(t)),
        "one third": lambda t, n: np.floor(t * 1000) / 1000,
    }
    for name, stamp in stamps.items():
        for rate in (10.0, 30.0, 50.0, 100.0):
            written = {"rate": rate, "stamps": stamp, "form": "%.17g"}
            yield case(kind, f"{name}, {rate:g} Hz", right=expected(), **written)


def holes() -> Iterator[Case]:
    kind = "holes"

    def but_for(start: float, times: Array, number: int) -> Array:
        return (number != 1) | (times <= start) | (times >= start + 0.6)

    def but_for_one_each(times: Array, number: int) -> Array:
        return (times <= 0.3 + 0.1 * number) | (times >= 0.7 + 0.1 * number)

    for start in (0.1, 0.5, 0.9):
        said = {"rate": 100.0, "keep": partial(but_for, start)}
        yield case(kind, f"0.6 s from {start:g} s on", named=r"demonstration 1.*0\.6", **said)
    said = {"rate": 100.0, "keep": but_for_one_each}
    yield case(kind, "one in each", named=r"demonstration \d.*0\.4", **said)


def units() -> Iterator[Case]:
    kind, rad = "units", {"said": {"units": ("rad", "rad/s")}}
    degrees, mm = shown(scale=DEGREES), shown(scale=1000.0)
    yield case(kind, "degrees", columns=degrees, named="q looks like degrees", **rad)
    yield case(kind, "degrees, nothing said", columns=degrees, named="q (looks like|may be in)")
    an_angle = {"said": {"angles": ("q",)}}
    yield case(kind, "degrees of an angle", columns=degrees, named="degrees", **an_angle)
    metres = {"said": {"units": ("m", "m/s")}}
    yield case(kind, "millimetres", columns=mm, named="q looks like milli", **metres)
    yield case(kind, "thousandths, nothing said", columns=mm, named="q (looks like|may be in)")
    from_there = shown(1.0, 1.5, DEGREES)
    there = partial(Joint, start=1.0)
    yield case(kind, "degrees, start", there, from_there, "q looks like degrees", **rad)
    for scale in (1e3, 1e6, 1e-3, 1e4):
        robot, truth = partial(Joint, scale), expected(scale=scale)
        name = f"robot and recordings in {1 / scale:g}"
        yield case(kind, name, robot, shown(scale=scale), right=truth)

    def counted(factor: float, times: Array, _number: int) -> Array:
        return np.round(factor * times)

    for name, factor in (("milliseconds", 1e3), ("nanoseconds", 1e9), ("frames", 10.0)):
        stamps = partial(counted, factor)
        yield case(kind, f"time in {name}", named="time.*(second|frame)", stamps=stamps)


def names() -> Iterator[Case]:
    kind = "names and steps"
    swapped = partial(Joint, order=(1, 0))
    yield case(kind, "swapped", swapped, named="dq must be the velocity of q.*swap")
    yield case(kind, "velocity in degrees", partial(Joint, rates=57.3), named="dq must be.*57")
    yield case(
        kind, "velocity of another sign", partial(Joint, rates=-1), named="dq must be.*-(1|0.99)"
    )
    yield case(kind, "order said", swapped, right=expected(), said={"state": ("dq", "q")})
    yield case(kind, "no dt", Clockless, named="steps_per_action")
    yield case(kind, "no dt, steps said", Clockless, right=expected(), said={"steps_per_action": 1})
    yield case(kind, "half a step", named="control_period", period=0.05)
    yield case(kind, "two steps", right=expected(0.2), period=0.2)
    yield case(kind, "a keyword misspelt", named="did you mean tolerance", said={"tolerence": 1.0})
    yield case(kind, "text for names", named="state must", said={"state": "qd"})
    yield case(kind, "period of text", named="control_period must", period="0.1")  # type: ignore[arg-type]
    yield case(kind, "a name with folders", named="name must", said={"name": "../../x"})
    yield case(kind, "no error", named="error must", said={"error": None})
    yield case(
        kind, "a thousand past actions", named="past_actions must", said={"past_actions": 1000}
    )
    yield case(kind, "match of a number", named="match must", said={"match": 3})
    circle = {"state": ("cos q", "sin q", "dq")}
    yield case(kind, "cosine and sine", partial(Joint, turned=True), right=expected(), said=circle)


def repeatability() -> Iterator[Case]:
    kind, wrap = "robots that do not repeat", gymnasium.wrappers
    yield case(
        kind,
        "NormalizeObservation",
        lambda: wrap.NormalizeObservation(Joint()),
        named="NormalizeObservation",
    )
    yield case(
        kind,
        "Autoreset",
        lambda: wrap.Autoreset(wrap.TimeLimit(Joint(), 7)),
        named="Autoreset",
    )
    yield case(kind, "TimeLimit", lambda: wrap.TimeLimit(Joint(), 7), right=expected())
    yield case(kind, "NormalizeReward", lambda: wrap.NormalizeReward(Joint()), right=expected())


def tables() -> Iterator[Case]:
    kind = "columns and files"

    def add(*columns: str) -> Callable[[str], str]:
        def edit(text: str) -> str:
            header, *rows = text.splitlines()
            more = ",".join("abc" if "text" in each else "1" for each in columns)
            return (
                "\n".join([f"{header},{','.join(columns)}", *(f"{row},{more}" for row in rows)])
                + "\n"
            )

        return edit

    wide = tuple(f"c{index}" for index in range(124))
    for name, edit in {
        "twice, not read": add("a", "a"),
        "text, not read": add("text", "note text"),
        "124, one twice": add(*wide, "c7"),
        "semicolons": lambda text: text.replace(",", ";"),
        "CRLF and BOM": lambda text: "\ufeff" + text.replace("\n", "\r\n"),
        "blank lines": lambda text: text.replace("\n", "\n\n"),
        "quoted header": lambda text: text.replace("time", '"time"', 1),
    }.items():
        yield case(
            kind,
            name,
            right=None if "124" in name else expected(),
            edit=edit,
            said={"state": ("q", "dq"), "match": None},
        )
    for name, text, named in (
        (
            "Git LFS pointer",
            "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n",
            "LFS",
        ),
        ("web page", "<!DOCTYPE html><html></html>", "(?i)html|web page"),
        ("nothing", "", "empty"),
        ("read column twice", "demonstration,time,q,q\n0,0,1,1\n0,1,1,1\n", "q.*(twice|once|2 of)"),
        ("not a number", "demonstration,time,q\n0,0,1\n0,0.1,nan\n", "finite"),
        (
            "time that goes back",
            "demonstration,time,q\n0,1694010000.1,1\n0,1694010000.05,2\n1,0,1\n1,1,2\n",
            r"010000\.05",
        ),
    ):
        yield case(kind, name, named=named, edit=lambda _, text=text: text)


KINDS = (angles, clocks, holes, units, names, repeatability, tables)


def main() -> None:
    """Read the command line, try all cases, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    add_json(parser, "front_door")
    arguments = parser.parse_args()
    source = source_of("front_door")
    rows = []
    for one in (each for kind in KINDS for each in kind()):
        with tempfile.TemporaryDirectory() as folder:
            came = handed_over(one, Path(folder)).replace(f"{folder}/", "")
        rows.append({"kind": one.kind, "case": one.name, "result": came})
        print(f"{one.kind}, {one.name}: {came}", flush=True)
    table = [
        {
            "kind": kind,
            **{
                word: sum(row["kind"] == kind and row["result"].startswith(word) for row in rows)
                for word in ("right", "named", "wrong")
            },
        }
        for kind in dict.fromkeys(row["kind"] for row in rows)
    ]
    for row in table:
        print(row)
    headline = {"cases": len(rows), "wrong": sum(row["wrong"] for row in table)}
    write_summary(
        arguments.json,
        {**source, "headline": headline, "table": table, "rows": rows},
    )


if __name__ == "__main__":
    main()
