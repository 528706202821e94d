"""The page to draw on: who may use it, what it refuses, and that what is drawn in a browser is what
is saved.
"""

from __future__ import annotations

import http.client
import json
import math
import os
import re
import shlex
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from http.server import ThreadingHTTPServer
from pathlib import Path

import pytest
import torch

from tests.helpers.run_script import ROOT, run_command
from torch_pmil.cli.draw import LARGEST_BODY, DrawingServer
from torch_pmil.demonstrations import load_demonstrations, load_recordings
from torch_pmil.demonstrations.preparation.drawing import SIDE, DrawingError

STROKE = [[10 * k, 0.2 + 0.01 * k, 0.5 + 0.2 * math.sin(k / 8)] for k in range(51)]
BODY = json.dumps(5 * [STROKE]).encode()
Answer = tuple[int, str]


@pytest.fixture
def server(tmp_path: Path) -> Iterator[object]:
    with DrawingServer(tmp_path / "wave.npz", 0.1) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def ask(
    server: object, method: str, name: str, body: bytes | None = None, **headers: str
) -> Answer:
    """The answer to a request for a name below the page's address, or for an absolute path."""
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=10)
    try:
        path = name if name.startswith("/") else server.root + name
        connection.request(
            method, path, body, {name.replace("_", "-"): value for name, value in headers.items()}
        )
        response = connection.getresponse()
        return response.status, response.read().decode()
    finally:
        connection.close()


def test_page_is_whole_and_asks_for_nothing_from_elsewhere(server: object) -> None:
    page = ask(server, "GET", "")[1]
    assert re.findall(r"(?:src|href)=\"(.*?)\"", page) == ["data:,", "page.css", "page.js"]
    assert "$" not in page and 'data-wanted="5"' in page
    files = [ask(server, "GET", name) for name in ("page.css", "page.js")]
    assert all(status == 200 and "http" not in text for status, text in files)


def test_drawing_is_saved_once_and_ends_the_server(server: object, tmp_path: Path) -> None:
    assert ask(server, "POST", "save", BODY) == (
        200,
        "Saved 5 strokes in wave.npz: see the terminal for how to train.",
    )
    assert server.saved is not None and torch.equal(
        load_demonstrations(tmp_path / "wave.npz").positions, server.saved.positions
    )
    with pytest.raises(DrawingError, match=r"wave.npz is saved already"):
        server.save(BODY)


@pytest.mark.parametrize("method", ["GET", "POST"])
def test_other_hosts_origins_and_tokens_are_refused(
    server: object, tmp_path: Path, method: str
) -> None:
    port, refused = server.server_port, (403, "open the address that pmil draw printed")
    for host in (f"evil.example:{port}", f"localhost:{port}", "127.0.0.1", ""):
        assert ask(server, method, "save", BODY, Host=host) == refused
    for origin in ("http://evil.example", f"https://127.0.0.1:{port}", "null"):
        assert ask(server, method, "save", BODY, Origin=origin) == refused
    for path in ("/save", "/", "/page.js", f"/{'a' * 43}/save", server.root[:-2]):
        assert ask(server, method, path, BODY) == refused
    assert not os.listdir(tmp_path)


def test_server_is_not_reached_from_other_machines(server: object) -> None:
    assert server.server_address[0] == "127.0.0.1"


def test_other_names_are_not_files(server: object) -> None:
    assert (
        ask(server, "GET", "../draw.py")[0]
        == ask(server, "GET", "%2e%2e/draw.py")[0]
        == ask(server, "POST", "page.js", BODY)[0]
        == 404
    )


def test_wrong_strokes_are_one_line_and_drawing_goes_on(
    server: object, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ask(server, "POST", "save", b"[[")[0] == 422
    status, text = ask(server, "POST", "save", json.dumps([STROKE]).encode())
    assert (status, text) == (422, "Not saved: the strokes must be a list of 2 to 20, got 1.")
    assert [line.partition(":")[0] for line in capsys.readouterr().err.splitlines()] == [
        "not saved"
    ] * 2
    assert not os.listdir(tmp_path)
    assert ask(server, "POST", "save", BODY)[0] == 200


def test_file_that_cannot_be_written_is_told_and_drawing_goes_on(
    server: object, tmp_path: Path
) -> None:
    server.path = tmp_path / "folder" / "wave.npz"
    status, text = ask(server, "POST", "save", BODY)
    assert status == 422 and re.match(r"Not saved: there is no folder", text)
    server.path.parent.mkdir()
    assert ask(server, "POST", "save", BODY)[0] == 200


def test_bodies_too_large_or_of_no_length_are_refused(server: object) -> None:
    assert ask(server, "POST", "save", b"", Content_Length=str(LARGEST_BODY + 1)) == (
        413,
        "Not saved: strokes must be 16777216 bytes at most, got 16777217.",
    )
    assert [
        ask(server, "POST", "save", b"", Content_Length=length)[0] for length in ("-1", "ten")
    ] == [411, 411]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["wave.csv"], "wave.csv: demonstrations are written to a .npz file"),
        (["none/wave.npz"], "none/wave.npz: there is no folder none"),
        (["there.npz"], "there.npz is there already; say another name"),
        (["beside.npz"], "beside.csv is there already; say another name"),
        (["wave.npz", "--time-step", "1"], "the time step must be from 0.01 to 0.3 s, got 1 s"),
    ],
)
def test_what_could_not_be_saved_is_told_before_anybody_draws(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, arguments: list[str], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("there.npz", "beside.csv"):
        (tmp_path / name).touch()
    with pytest.raises(SystemExit) as stop:
        run_command(monkeypatch, "draw", *arguments)
    assert stop.value.code == f"error: {message}"


def test_script_tells_where_to_draw_and_how_to_train(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(ThreadingHTTPServer, "serve_forever", lambda server: server.save(BODY))
    run_command(monkeypatch, "draw", "my wave.npz", "--time-step", "0.05")
    told, *saved = capsys.readouterr().out.splitlines()
    assert re.fullmatch(
        r"draw at http://127\.0\.0\.1:\d+/[\w-]{43}/ \(Ctrl-C ends without saving\)", told
    )
    assert saved == [
        "wrote my wave.npz: 5 demonstrations of 11 samples, 0.5 s",
        "as they were recorded: my wave.csv",
        "train with: pmil train experiment=handwriting robot=double_pendulum 'demonstrations=my "
        "wave.npz'",
    ]
    assert load_demonstrations("my wave.npz").time_step == 0.05


def test_interrupt_ends_in_one_line_and_writes_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def interrupt(_: ThreadingHTTPServer) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(ThreadingHTTPServer, "serve_forever", interrupt)
    with pytest.raises(SystemExit, match="\nended, nothing was saved"):
        run_command(monkeypatch, "draw", tmp_path / "wave.npz")
    assert not os.listdir(tmp_path)


def place(s: float, variation: int) -> tuple[float, float]:
    """Of an arc, fractions (right, down) of the square."""
    return 0.2 + 0.6 * s, 0.7 - (0.4 + 0.01 * variation) * math.sin(math.pi * s)


def draw_arc(page: object, variation: int, duration: float, end: float = 1.0) -> list[list[float]]:
    """Draws an arc, or a part of it, with the mouse in real time; what was drawn, [s, m, m]."""
    box, drawn = page.locator("#paper").bounding_box(), []
    go = partial(_go, page, box, variation)
    go(0.0)
    page.mouse.down()
    start = time.monotonic()
    while (moment := (time.monotonic() - start) / duration) < 1:
        drawn.append([moment * duration, *go(end * moment**2 * (3 - 2 * moment))])
    drawn.append([duration, *go(end)])
    page.mouse.up()
    return drawn


def _go(page: object, box: dict[str, float], variation: int, s: float) -> tuple[float, float]:
    right, down = place(s, variation)
    page.mouse.move(box["x"] + right * box["width"], box["y"] + down * box["height"])
    return SIDE * right, SIDE * (1 - down)


def off_the_line(points: torch.Tensor, line: torch.Tensor) -> float:
    """Largest distance of points (K, 2) from a line of corners (L, 2)."""
    start, along = line[:-1], line.diff(dim=0)
    share = (
        ((points[:, None] - start) * along).sum(-1) / along.square().sum(-1).clamp_min(1e-12)
    ).clamp(0, 1)
    return (points[:, None] - start - share[..., None] * along).norm(dim=-1).amin(1).amax().item()


def test_what_is_drawn_in_a_browser_is_what_is_saved(
    browser: object, server: object, tmp_path: Path
) -> None:
    page = browser.new_page(viewport={"width": 900, "height": 800})
    page.goto(server.address)
    counter, save = page.locator("#counter"), page.locator("#save")
    assert counter.inner_text() == "0 of 5" and save.is_disabled()
    drawn = [draw_arc(page, variation, 0.6 + 0.1 * variation) for variation in range(5)]
    assert counter.inner_text() == "5 of 5"
    save.click()
    page.get_by_text("Saved 5 strokes in wave.npz: see the terminal for how to train.").wait_for()
    assert save.is_disabled()
    saved, recorded = (
        load_demonstrations(tmp_path / "wave.npz", time_step=0.1),
        load_recordings(tmp_path / "wave.csv"),
    )
    assert (
        saved.positions.shape[0] == 5 and 0.5 < saved.duration <= 0.9 and saved.names == ("x", "y")
    )
    for demonstration, times, values, stroke in zip(
        saved.positions, recorded.times, recorded.values, map(torch.tensor, drawn), strict=True
    ):
        line, pixel = stroke[:, 1:].double(), SIDE / page.locator("#paper").bounding_box()["width"]
        assert off_the_line(values, line) < 2 * pixel and len(values) > 20
        assert abs(times[-1] - stroke[-1, 0]) < 0.1
        assert (values[[0, -1]] - line[[0, -1]]).abs().max() < 2 * pixel
        assert off_the_line(demonstration, values) < 5 * pixel
        assert (demonstration[[0, -1]] - line[[0, -1]]).abs().max() < 15 * pixel


def test_page_undoes_starts_anew_and_tells_what_is_wrong(
    browser: object, server: object, tmp_path: Path
) -> None:
    page = browser.new_page(viewport={"width": 375, "height": 667})
    page.goto(server.address)
    counter, status = page.locator("#counter"), page.locator("#status")
    layout = page.locator("#buttons").bounding_box()
    for variation in range(5):
        draw_arc(page, variation, 0.4)
    for button, count in (("undo", 4), ("anew", 0), ("undo", 4)):
        page.focus(f"#{button}")
        page.keyboard.press("Enter")
        assert counter.inner_text() == f"{count} of 5"
    draw_arc(page, 0, 0.4, end=1.6)
    assert status.inner_text() == "Not kept: it left the square. Please draw it again."
    draw_arc(page, 0, 0.4, end=0.02)
    assert status.inner_text() == "Not kept: it was too small. Please draw it again."
    draw_arc(page, 0, 0.1)
    assert (
        status.inner_text()
        == "Not kept: it was too short a time; draw calmly. Please draw it again."
    )
    assert counter.inner_text() == "4 of 5" and page.locator("#save").is_disabled()
    draw_arc(page, 4, 0.4)
    server.path = tmp_path / "none" / "wave.npz"
    page.locator("#save").click()
    page.wait_for_selector("#status.bad")
    assert (
        re.match(r"Not saved: there is no folder", status.inner_text())
        and counter.inner_text() == "5 of 5"
    )
    assert page.locator("#buttons").bounding_box() == layout
    server.path = tmp_path / "wave.npz"
    page.locator("#save").click()
    page.get_by_text("Saved 5 strokes").wait_for()
    assert load_demonstrations(tmp_path / "wave.npz").positions.shape[0] == 5


def touch(devices: object, phase: int, x: float, y: float) -> None:
    """Puts down (0), moves (1) or lifts (2) a finger."""
    kind = ("touchStart", "touchMove", "touchEnd")[phase]
    devices.send(
        "Input.dispatchTouchEvent",
        {"type": kind, "touchPoints": [] if phase == 2 else [{"x": x, "y": y}]},
    )


def pen(devices: object, phase: int, x: float, y: float) -> None:
    """Puts down (0), moves (1) or lifts (2) a pen."""
    kind = ("mousePressed", "mouseMoved", "mouseReleased")[phase]
    event = {
        "type": kind,
        "x": x,
        "y": y,
        "button": "left",
        "buttons": int(phase != 2),
        "clickCount": 1,
        "pointerType": "pen",
    }
    devices.send("Input.dispatchMouseEvent", event)


@pytest.mark.slow
@pytest.mark.parametrize("device", [touch, pen])
def test_finger_and_pen_draw_as_a_mouse_does(
    browser: object, server: object, tmp_path: Path, device: Callable[..., None]
) -> None:
    context = browser.new_context(
        viewport={"width": 375, "height": 667}, has_touch=True, color_scheme="dark"
    )
    page = context.new_page()
    page.goto(server.address)
    page.evaluate(
        "addEventListener('pointermove', (event) => (document.body.dataset.kind = "
        "event.pointerType))"
    )
    box, devices = page.locator("#paper").bounding_box(), context.new_cdp_session(page)
    for variation in range(5):
        for step in range(31):
            right, down = place(step / 30, variation)
            at = box["x"] + right * box["width"], box["y"] + down * box["height"]
            device(devices, int(step > 0), *at)
            time.sleep(0.015)
        time.sleep(
            0.2
        )  # at rest: a browser does not take a tap right after a finger that left while it moved
        device(devices, 2, *at)
    assert (
        page.locator("#counter").inner_text() == "5 of 5"
        and page.evaluate("document.body.dataset.kind") == device.__name__
    )
    page.locator("#save").tap()
    page.get_by_text("Saved 5 strokes").wait_for()
    arc = SIDE * torch.tensor(
        [[place(k / 200, 2)[0], 1 - place(k / 200, 2)[1]] for k in range(201)], dtype=torch.float64
    )
    assert (
        off_the_line(load_demonstrations(tmp_path / "wave.npz").positions.reshape(-1, 2), arc)
        < 0.03 * SIDE
    )
    context.close()


@pytest.mark.slow
def test_what_is_drawn_trains_with_the_command_that_was_printed(
    browser: object, tmp_path: Path
) -> None:
    out, environment = (
        tmp_path / "arc.npz",
        os.environ | {"PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"},
    )
    draw = subprocess.Popen(
        [sys.executable, "-m", "torch_pmil", "draw", out],
        cwd=ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
    )
    with draw, browser.new_page(viewport={"width": 900, "height": 800}) as page:
        page.goto(re.search(r"http\S+", draw.stdout.readline())[0])
        for variation in range(5):
            draw_arc(page, variation, 2.0 + 0.1 * variation)
        page.locator("#save").click()
        printed = draw.stdout.read()
    command = shlex.split(re.search(r"train with: (.*)", printed)[1])
    arguments = [sys.executable, *command[1:], "trials=3", f"out={tmp_path / 'run'}"]
    told = subprocess.run(
        arguments, cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    ).stdout
    summary = json.loads((tmp_path / "run/summary.json").read_text())
    assert "warning" not in told and summary["experiment"] == "handwriting_own_double_pendulum"
    assert math.hypot(*summary["rms_error"].values()) < 0.2 * SIDE  # as large as it was drawn
