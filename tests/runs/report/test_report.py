"""The page of a run: it holds all of it, needs nothing else, and is whole or not there."""

from __future__ import annotations

import json
import re
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
from matplotlib.figure import Figure

import torch_pmil
from tests.helpers.finished_run import SUMMARY, TRIAL
from torch_pmil.plotting import save_figure
from torch_pmil.plotting.video import write_video
from torch_pmil.runs.report import write_report
from torch_pmil.runs.report.tables import _flat, unit_of
from torch_pmil.runs.summaries import RunError
from torch_pmil.tasks.registry import EXPERIMENTS, load_experiment
from torch_pmil.tasks.strokes import lasa_strokes

MEASURED = TRIAL | {"own_error": 0.3}
LEARNED = MEASURED | {"loss": None, "stop_reason": "iterations"}
COMMAND = "pmil train experiment=double_pendulum"
OLD = SUMMARY | {"command": f"{COMMAND} seed=3 out=runs/a", "trials": [LEARNED]}
HOSTILE = "<script>alert('&')</script>\"><img src=x onerror=alert(1)>"


def run_of(folder: Path, summary: dict, *figures: str) -> Path:
    """A run's folder with that summary and small figures of those names."""
    (folder / "figures").mkdir(parents=True)
    (folder / "summary.json").write_text(json.dumps(summary))
    for name in figures:
        save_figure(Figure(figsize=(2, 1)), folder / "figures" / f"{name}.png")
    return folder


def page_of(folder: Path) -> str:
    return write_report(folder).read_text()


def headings(page: str) -> list[str]:
    return re.findall(r"<h2>(.*?)</h2>", page)


def test_page_that_is_there_before_the_pictures_shows_none_and_says_that_they_follow(
    tmp_path: Path,
) -> None:
    folder = run_of(tmp_path / "my run", OLD, "poses")  # of an earlier end of this run
    page = write_report(folder, drawn=False).read_text()
    assert "<img" not in page and "Figures and video" in headings(page)
    assert f"pmil resume &#39;{folder}&#39;" in page
    assert "Figures and video" not in headings(page_of(folder))


def test_page_asks_for_nothing_from_elsewhere(tmp_path: Path) -> None:
    folder = run_of(tmp_path / "run", OLD, "poses")
    write_video(folder / "video.mp4", [np.zeros((16, 16, 3), dtype=np.uint8)] * 5, fps=5)
    page = page_of(folder)
    loaded = re.sub(r"<a [^>]*>", "", page)  # a link is followed only when it is chosen
    assert re.findall(r"(?:src|href|action|poster)=\"(.{5})", loaded) == 3 * ["data:"]
    assert not re.search(r"<script|url\(|@import", page)


def test_all_that_comes_from_data_is_escaped(tmp_path: Path) -> None:
    summary = OLD | {
        "experiment": HOSTILE,
        "seed": 1,
        "command": HOSTILE,
        "stop_reason": HOSTILE,
        "trials": [LEARNED | {"stop_reason": HOSTILE}],
        "settings": {HOSTILE: {"a": HOSTILE}},
        "versions": {HOSTILE: HOSTILE},
        "diagnosis": [{"cause": HOSTILE, "message": HOSTILE}],
        "saved_success_rate_by_target": {HOSTILE: 0.5, "b": 0.5},
    }
    page = page_of(run_of(tmp_path / "run", summary, "policy_target_0", "<b>own"))
    assert "<script" not in page and "onerror=alert(1)>" not in page and "<b>" not in page
    assert page.count("&lt;script&gt;") >= 12


def test_pictures_come_in_reading_order_and_say_of_which_target_they_are(tmp_path: Path) -> None:
    names = ("my_own", "model", "trajectories_target_1", "trajectories_target_0", "learning_curve")
    rates = {"y = 0": 0.4, "y = 1": 0.6}
    page = page_of(run_of(tmp_path / "run", OLD | {"saved_success_rate_by_target": rates}, *names))
    titles = [f"Demonstrated, predicted and executed, y = {y}" for y in (0, 1)]
    titles += ["Learning curve", "Slices through the model", "my own"]
    assert headings(page)[:5] == titles
    assert re.findall(r'width="(\d+)" height="(\d+)"', page) == 5 * [("200", "100")]


def test_headline_says_in_words_whether_it_learned(tmp_path: Path) -> None:
    of = {1.0: "It learned: 20", 0.5: "It learned in part: 10", 0.0: "It did not learn: none"}
    for rate, said in of.items():
        page = page_of(run_of(tmp_path / said, OLD | {"saved_success_rate": rate}))
        assert f">{said} of 20 fresh starts succeed, after 5 s of experience.</h1>" in page


ALONE = MEASURED | {"success_rate": None, "n_eval": 0, "cut_short": "", "own_success": True}


@pytest.mark.parametrize(
    ("rate", "said"), [(1.0, "It learned: the saved"), (0.0, "It did not learn: the saved")]
)
def test_page_says_where_own_rollouts_alone_judge(tmp_path: Path, rate: float, said: str) -> None:
    stopped = ALONE | {"trial": 2, "own_success": False, "own_error": None, "cut_short": "too fast"}
    trials = [ALONE | {"loss": 1.0}, stopped | {"loss": 1.0}]
    summary = OLD | {"saved_success_rate": rate, "saved_n_eval": 0, "trials": trials}
    page = page_of(run_of(tmp_path / "run", summary, "calibration", "learning_curve"))
    assert f">{said} policy&#39;s own rollout " in page
    assert page.count("judged by the robot's own rollouts alone") == 1
    assert "<dd>1 of 2</dd>" in page and "<td>too fast</td>" in page
    assert "judged by the robot&#39;s own rollouts alone" in page  # below the trials
    assert "from fresh starts" not in page and "success rate" not in page


def test_diagnosis_and_a_failed_prediction_are_said_if_there_is_one(tmp_path: Path) -> None:
    page = page_of(run_of(tmp_path / "run", OLD | {"prediction_error": "it diverged at step 7"}))
    assert "cannot predict the saved policy (it diverged at step 7)" in page
    reason = {"cause": "search stuck", "message": "at step 7"}
    page = page_of(run_of(tmp_path / "a", OLD | {"diagnosis": [reason]}))
    assert "<li><strong>search stuck</strong>: at step 7</li>" in page
    assert headings(page)[0] == "The likely reason"
    page = page_of(run_of(tmp_path / "two", OLD | {"diagnosis": 2 * [reason]}))
    assert headings(page)[0] == "Likely reasons, the most likely first"
    for name, summary in (("none", OLD | {"diagnosis": []}), ("old", OLD)):
        assert "ikely reason" not in page_of(run_of(tmp_path / name, summary))


def test_run_at_its_limit_can_go_on_and_any_can_be_repeated_or_begin_anew(tmp_path: Path) -> None:
    page = page_of(run_of(tmp_path / "limit", OLD))
    same = "seed=3 out=runs/a"
    for changed in (f"{same} trials=2 resume=true", "seed=4", f"{same} overwrite=true"):
        assert f"{COMMAND} {changed}</pre>" in page
    ended = {"stop_reason": "succeeded", "command": f"{COMMAND} resume=true"}
    done = page_of(run_of(tmp_path / "done", OLD | ended))
    assert "trials=2" not in done and f"{COMMAND} overwrite=true</pre>" in done


def rows_of(page: str) -> list[list[str]]:
    rows = re.findall(r"<tr>(.*?)</tr>", page)
    return [re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row) for row in rows]


def test_numbers_of_trials_and_settings_are_in_tables_with_their_units(tmp_path: Path) -> None:
    shares = {
        "rms_error": {"x": 0.01},
        "demonstration_spread": {"x": 0.02},
        "saturated": {"tau": 0.25},
        "units": {"objective": "nats", "demonstrations": {"x": "m"}},
    }
    settings = {"horizon": 25, "noise_std": 0.05, "search": {"trust_threshold": 3.0}}
    trial = LEARNED | {"loss": 2.0, "stop_reason": "iteration limit"}
    summary = OLD | {"settings": settings, "trials": [trial]} | shares
    rows = rows_of(page_of(run_of(tmp_path / "run", summary)))
    for row in (
        ["1", "2.5", "2", "50 %", "failed", "0.3", "all iterations"],
        ["x (m)", "0.01", "0.02"],
        ["horizon", "25", "control steps"],
        ["noise_std", "0.05", "m"],
        ["search.trust_threshold", "3", "nats a step and entry"],
        ["tau", "25 %"],
    ):
        assert row in rows
    assert "objective (nats)" in rows[0] and "own error (unit of the task)" in rows[0]
    given = OLD | {"settings": {"tolerance": 0.2}}
    rows = rows_of(page_of(run_of(tmp_path / "with a tolerance", given)))
    assert "own error, of the tolerance" in rows[0] and "150 %" in rows[1]


def test_every_setting_that_is_a_number_has_a_unit() -> None:
    for name in EXPERIMENTS:
        strokes = lasa_strokes("Angle") if name.startswith("handwriting") else None
        task = load_experiment(name, strokes)
        match_space = task.space.match_space
        known = dict(zip(match_space.names, match_space.units, strict=True))
        units = {"objective": task.objective.unit, "demonstrations": known}
        for setting, value in _flat(task.settings):
            if value not in ("–", "yes", "no", "LBFGS", "SaturatingCost"):
                assert unit_of(setting, {"units": units}), (name, setting)


def test_pages_of_the_documentation_are_links_where_they_are_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = run_of(tmp_path / "run", OLD | {"diagnosis": [{"cause": "a", "message": "b"}]})
    links = re.findall(r"<a href=\"file://([^\"]*)\">([^<]*)</a>", page_of(folder))
    names = ("diagnosis", "reading_the_plots", "diagnosis", "deploy")
    assert [path for _, path in links] == [f"docs/how_to/{name}.md" for name in names]
    assert all(Path(unquote(address)).exists() for address, _ in links)
    monkeypatch.setattr(torch_pmil, "__file__", str(tmp_path / "site-packages" / "__init__.py"))
    page = page_of(folder)
    assert "<a " not in page and "<code>docs/how_to/deploy.md</code>" in page


def test_what_is_damaged_is_said_in_one_line_and_the_old_page_stays(tmp_path: Path) -> None:
    folder = run_of(tmp_path / "run", OLD)
    page = page_of(folder)
    (folder / "figures" / "poses.png").write_text("no picture")
    with pytest.raises(RunError, match=r"poses\.png must be a PNG file, got .* with b'no pict"):
        write_report(folder)
    (folder / "summary.json").unlink()
    with pytest.raises(RunError, match=r"holds no finished run: there is no file"):
        write_report(folder)
    assert (folder / "report.html").read_text() == page
    assert {path.name for path in folder.iterdir()} == {"figures", "report.html", "run_files.json"}


def test_page_that_is_not_written_to_its_end_leaves_the_old_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = run_of(tmp_path / "run", OLD)
    page, write = page_of(folder), Path.write_text

    def full(path: Path, text: str, **kwargs: str) -> None:
        write(path, text[:100], **kwargs)
        raise OSError("No space left on device")

    with monkeypatch.context() as patch, pytest.raises(OSError, match="No space left"):
        patch.setattr(Path, "write_text", full)
        write_report(folder)
    assert (folder / "report.html").read_text() == page
    assert {path.name for path in folder.iterdir()} == {
        *("figures", "summary.json", "report.html", "run_files.json")
    }
