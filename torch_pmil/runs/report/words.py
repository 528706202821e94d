"""The result of a run in words, and how to go on."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path

from torch_pmil.runs.diagnosis.measures import LEARNED
from torch_pmil.runs.summaries import judged_alone, words_of
from torch_pmil.trainer.ending import LIMIT


def headline(summary: dict) -> tuple[str, str]:
    """A class, "good", "part" or "bad", and the result of the run in words.

    Example:
        >>> headline({"saved_success_rate": 1.0, "saved_n_eval": 20, "experience_s": 17.5})
        ('good', 'It learned: 20 of 20 fresh starts succeed, after 17.5 s of experience.')
        >>> alone = {"saved_success_rate": 1.0, "saved_n_eval": 0, "experience_s": 17.5}
        >>> headline(alone | {"promised_success_rate": 0.979})[1].partition(". ")[2]
        'The model predicts success from 97.9 % of the starts at least.'
    """
    rate, count = summary["saved_success_rate"], summary["saved_n_eval"]
    succeeded = f"{round(rate * count) or 'none'} of {count} fresh starts succeed"
    if judged_alone(summary):
        succeeded = f"the saved policy's own rollout {'succeeded' if rate else 'failed'}"
    succeeded = f"{succeeded}, after {summary['experience_s']:g} s of experience."
    least = summary.get("promised_success_rate")
    if least is not None:
        succeeded += f" The model predicts success from {100 * least:.1f} % of the starts at least."
    if "unmet" in summary:
        succeeded += f" It did not end before its limit of trials: {summary['unmet']}."
    if rate >= LEARNED:
        return "good", f"It learned: {succeeded}"
    if rate > 0:
        return "part", f"It learned in part: {succeeded}"
    return "bad", f"It did not learn: {succeeded}"


def say(value: object) -> str:
    """A value as tables show it.

    Example:
        >>> values = (None, True, 0.123456, [1.0, 2.5], "text", {"a": 1, "b": None})
        >>> [say(value) for value in values]
        ['–', 'yes', '0.1235', '1, 2.5', 'text', 'a = 1, b = –']
    """
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return ", ".join(
            f"({say(item)})" if isinstance(item, list) else say(item) for item in value
        )
    if isinstance(value, dict):
        return ", ".join(f"{name} = {say(item)}" for name, item in value.items())
    return str(value)


def percent(fraction: float) -> str:
    """A fraction from 0 to 1 in per cent.

    Example:
        >>> percent(0.95)
        '95 %'
    """
    return f"{100 * fraction:.0f} %"


def next_steps(summary: dict, folder: Path) -> Iterator[tuple[str, str]]:
    """Next steps with a run, each with its command or lines of Python."""
    words = _words(summary["command"])
    if words[:2] == ["pmil", "train"]:
        if summary["stop_reason"] == LIMIT:
            changed = [f"trials={2 * len(summary['trials'])}", "resume=true"]
            further = [*_without(words, "trials=", "resume=", "overwrite="), *changed]
            yield "Continue where it stopped, with twice as many trials:", shlex.join(further)
        same = _without(words, "resume=", "overwrite=")
        anew = [*_without(same, "seed=", "out="), f"seed={summary['seed'] + 1}"]
        yield "Learn again, from another random motion:", shlex.join(anew)
        yield "Repeat this run in its place:", shlex.join([*same, "overwrite=true"])
    else:
        yield "Repeat this run:", shlex.join(words)
    if (folder / "policy.pt").exists():
        lines = (
            "from torch_pmil import load_policy",
            f"policy = load_policy({str(folder / 'policy.pt')!r})",
            "action = policy(state)",
        )
        yield "Use the policy:", "\n".join(lines)


def _words(command: str) -> list[str]:
    """The words of a command line; a single word if no shell would take it."""
    try:
        return words_of(command)
    except ValueError:
        return [command]


def _without(words: list[str], *beginnings: str) -> list[str]:
    """The words of a command that begin with none of these."""
    return [word for word in words if not word.startswith(beginnings)]
