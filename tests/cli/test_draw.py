"""The page to draw on: who may use it, what it refuses, and what of a drawing is saved."""

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
from contextlib import closing
from http.server import ThreadingHTTPServer
from pathlib import Path
from statistics import fmean

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
    address = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=10)
    with closing(address) as connection:
        path = name if name.startswith("/") else server.root + name
        given = {name.replace("_", "-"): value for name, value in headers.items()}
        connection.request(method, path, body, given)
        response = connection.getresponse()
        return response.status, response.read().decode()


def test_page_is_whole_asks_for_nothing_from_elsewhere_and_is_all_there_is(server: object) -> None:
    assert server.server_address[0] == "127.0.0.1"
    page = ask(server, "GET", "")[1]
    assert re.findall(r"(?:src|href)=\"(.*?)\"", page) == ["data:,", "page.css", "page.js"]
    assert "$" not in page and 'data-wanted="5"' in page
    files = [ask(server, "GET", name) for name in ("page.css", "page.js")]
    assert all(status == 200 and "http" not in text for status, text in files)
    for method, name in (("GET", "../draw.py"), ("GET", "%2e%2e/draw.py"), ("POST", "page.js")):
        assert ask(server, method, name, BODY)[0] == 404


def test_drawing_is_saved_once_and_ends_the_server(server: object, tmp_path: Path) -> None:
    said = "Saved 5 strokes in wave.npz: see the terminal for how to train."
    assert ask(server, "POST", "save", BODY) == (200, said)
    saved = load_demonstrations(tmp_path / "wave.npz").positions
    assert server.saved is not None and torch.equal(saved, server.saved.positions)
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


def test_what_cannot_be_saved_is_one_line_and_drawing_goes_on(
    server: object, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ask(server, "POST", "save", b"[[")[0] == 422
    status, text = ask(server, "POST", "save", json.dumps([STROKE]).encode())
    assert (status, text) == (422, "Not saved: the strokes must be a list of 2 to 20, got 1.")
    printed = capsys.readouterr().err.splitlines()
    assert [line.partition(":")[0] for line in printed] == 2 * ["not saved"]
    assert not os.listdir(tmp_path)
    server.path = tmp_path / "folder" / "wave.npz"
    status, text = ask(server, "POST", "save", BODY)
    assert status == 422 and re.match(r"Not saved: there is no folder", text)
    server.path.parent.mkdir()
    assert ask(server, "POST", "save", BODY)[0] == 200


def test_bodies_too_large_or_of_no_length_are_refused(server: object) -> None:
    said = "Not saved: strokes must be 16777216 bytes at most, got 16777217."
    length = str(LARGEST_BODY + 1)
    assert ask(server, "POST", "save", b"", Content_Length=length) == (413, said)
    for length in ("-1", "ten"):
        assert ask(server, "POST", "save", b"", Content_Length=length)[0] == 411


NAMED = "demonstrations='my wave.npz'"


@pytest.mark.parametrize(
    ("time_step", "samples", "last"),
    [
        (0.1, 6, f"train with: pmil train experiment=handwriting {shlex.quote(NAMED)}"),
        (0.05, 11, "they are for PMIL(..., control_period=0.05): handwriting takes 0.1 s"),
    ],
)
def test_command_prints_where_to_draw_and_how_to_train(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    time_step: float,
    samples: int,
    last: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(ThreadingHTTPServer, "serve_forever", lambda server: server.save(BODY))
    run_command(monkeypatch, "draw", "my wave.npz", "--time-step", str(time_step))
    first, *saved = capsys.readouterr().out.splitlines()
    address = r"http://127\.0\.0\.1:\d+/[\w-]{43}/"
    assert re.fullmatch(rf"draw at {address} \(Ctrl-C ends without saving\)", first)
    assert saved == [
        f"wrote my wave.npz: 5 demonstrations of {samples} samples, 0.5 s",
        "as they were recorded: my wave.csv",
        last,
    ]
    assert load_demonstrations("my wave.npz").time_step == time_step


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


RATE = 60  # moves of the mouse in a second: so many are made, however slow the machine is


def draw_arc(page: object, variation: int, duration: float, end: float = 1.0) -> list[list[float]]:
    """Draws an arc, or a part of it, with the mouse in real time; what was drawn, [s, m, m]."""
    box, drawn = page.locator("#paper").bounding_box(), []

    def go(s: float) -> tuple[float, float]:
        right, down = place(s, variation)
        page.mouse.move(box["x"] + right * box["width"], box["y"] + down * box["height"])
        return SIDE * right, SIDE * (1 - down)

    go(0.0)
    page.mouse.down()
    start, moves = time.monotonic(), round(RATE * duration)
    for moment in (move / moves for move in range(moves)):
        drawn.append([time.monotonic() - start, *go(end * moment**2 * (3 - 2 * moment))])
        time.sleep(max(0.0, start + duration * (moment + 1 / moves) - time.monotonic()))
    drawn.append([time.monotonic() - start, *go(end)])
    page.mouse.up()
    return drawn


def off_the_line(points: torch.Tensor, line: torch.Tensor) -> float:
    """Largest distance of points (K, 2) from a line of corners (L, 2)."""
    along, offsets = line.diff(dim=0), points[:, None] - line[:-1]
    share = (offsets * along).sum(-1) / along.square().sum(-1).clamp_min(1e-12)
    nearest = share.clamp(0, 1)[..., None] * along
    return (offsets - nearest).norm(dim=-1).amin(1).amax().item()


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
    saved = load_demonstrations(tmp_path / "wave.npz", time_step=0.1)
    recorded = load_recordings(tmp_path / "wave.csv")
    assert saved.positions.shape[0] == 5 and saved.names == ("x", "y")
    lasted = fmean(stroke[-1][0] for stroke in drawn)
    assert 0.9 * lasted - 0.1 < saved.duration < lasted + 0.1  # without the rests, in whole periods
    pixel, strokes = SIDE / page.locator("#paper").bounding_box()["width"], map(torch.tensor, drawn)
    of_strokes = saved.positions, recorded.times, recorded.values, strokes
    for demonstration, times, values, stroke in zip(*of_strokes, strict=True):
        line = stroke[:, 1:].double()
        assert off_the_line(values, line) < 2 * pixel
        assert len(values) > 0.9 * len(line)  # a browser may merge moves of one frame
        assert abs(times[-1] - stroke[-1, 0]) < 0.1
        assert (values[[0, -1]] - line[[0, -1]]).abs().max() < 2 * pixel
        assert off_the_line(demonstration, values) < 5 * pixel
        assert (demonstration[[0, -1]] - line[[0, -1]]).abs().max() < 15 * pixel


def test_page_undoes_starts_anew_and_says_what_is_wrong(
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
    for duration, end, fault in (
        (0.4, 1.6, "it left the square"),
        (0.4, 0.02, "it was too small"),
        (0.1, 1.0, "it was too short a time; draw calmly"),
    ):
        draw_arc(page, 0, duration, end)
        assert status.inner_text() == f"Not kept: {fault}. Please draw it again."
    assert counter.inner_text() == "4 of 5" and page.locator("#save").is_disabled()
    draw_arc(page, 4, 0.4)
    server.path = tmp_path / "none" / "wave.npz"
    page.locator("#save").click()
    page.wait_for_selector("#status.bad")
    assert status.inner_text().startswith("Not saved: there is no folder")
    assert counter.inner_text() == "5 of 5"
    assert page.locator("#buttons").bounding_box() == layout
    server.path = tmp_path / "wave.npz"
    page.locator("#save").click()
    page.get_by_text("Saved 5 strokes").wait_for()
    assert load_demonstrations(tmp_path / "wave.npz").positions.shape[0] == 5


def touch(devices: object, phase: int, x: float, y: float) -> None:
    """Puts down (0), moves (1) or lifts (2) a finger."""
    kind = ("touchStart", "touchMove", "touchEnd")[phase]
    points = [] if phase == 2 else [{"x": x, "y": y}]
    devices.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})


def pen(devices: object, phase: int, x: float, y: float) -> None:
    """Puts down (0), moves (1) or lifts (2) a pen."""
    kind = ("mousePressed", "mouseMoved", "mouseReleased")[phase]
    button = {"button": "left", "buttons": int(phase != 2), "clickCount": 1}
    event = {"type": kind, "x": x, "y": y, "pointerType": "pen"}
    devices.send("Input.dispatchMouseEvent", event | button)


@pytest.mark.slow
@pytest.mark.parametrize("device", [touch, pen])
def test_finger_and_pen_draw_as_a_mouse_does(
    browser: object, server: object, tmp_path: Path, device: Callable[..., None]
) -> None:
    screen = {"width": 375, "height": 667}
    context = browser.new_context(viewport=screen, has_touch=True, color_scheme="dark")
    page = context.new_page()
    page.goto(server.address)
    note = "(event) => (document.body.dataset.kind = event.pointerType)"
    page.evaluate(f"addEventListener('pointermove', {note})")
    box, devices = page.locator("#paper").bounding_box(), context.new_cdp_session(page)
    for variation in range(5):
        for step in range(31):
            right, down = place(step / 30, variation)
            at = box["x"] + right * box["width"], box["y"] + down * box["height"]
            device(devices, int(step > 0), *at)
            time.sleep(0.015)
        # at rest: a browser does not take a tap right after a finger that left while it moved
        time.sleep(0.2)
        device(devices, 2, *at)
    assert page.locator("#counter").inner_text() == "5 of 5"
    assert page.evaluate("document.body.dataset.kind") == device.__name__
    page.locator("#save").tap()
    page.get_by_text("Saved 5 strokes").wait_for()
    places = (place(k / 200, 2) for k in range(201))
    arc = SIDE * torch.tensor([[right, 1 - down] for right, down in places]).double()
    saved = load_demonstrations(tmp_path / "wave.npz").positions
    assert off_the_line(saved.reshape(-1, 2), arc) < 0.03 * SIDE
    context.close()


@pytest.mark.slow
def test_what_is_drawn_trains_with_the_command_that_was_printed(
    browser: object, tmp_path: Path
) -> None:
    given = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"}
    started = {"cwd": ROOT, "env": given, "text": True}
    pmil = [sys.executable, "-m", "torch_pmil"]
    command = [*pmil, "draw", tmp_path / "arc.npz"]
    draw = subprocess.Popen(command, stdout=subprocess.PIPE, **started)
    with draw, browser.new_page(viewport={"width": 900, "height": 800}) as page:
        page.goto(re.search(r"http\S+", draw.stdout.readline())[0])
        for variation in range(5):
            draw_arc(page, variation, 2.0 + 0.1 * variation)
        page.locator("#save").click()
        printed = draw.stdout.read()
    command = shlex.split(re.search(r"train with: (.*)", printed)[1])
    arguments = [*pmil, *command[1:], "trials=3", f"out={tmp_path / 'run'}"]
    trained = subprocess.run(arguments, capture_output=True, check=True, **started).stdout
    summary = json.loads((tmp_path / "run/summary.json").read_text())
    assert "warning" not in trained and summary["experiment"] == "handwriting"
    assert math.hypot(*summary["rms_error"].values()) < 0.2 * SIDE  # as large as it was drawn
