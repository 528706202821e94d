"""The page of a real run in a real browser, without a network."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.helpers.run_script import run_command
from tests.helpers.short_run import quick_fits, replace_task, short_experiment

pytestmark = pytest.mark.slow
WIDTHS = {"phone": 375, "desktop": 1200}


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a run of the first steps of the double pendulum."""
    folder = tmp_path_factory.mktemp("run")
    with pytest.MonkeyPatch.context() as patch:
        replace_task(patch, short_experiment(6))
        quick_fits(patch)
        run_command(patch, "train", "trials=2", "seed=2", "logger=null", f"out={folder}")
    return folder / "report.html"


class Visit:
    """A page that was opened in a context without a network, and what went wrong with it."""

    def __init__(self, context: object, path: Path) -> None:
        self.said: list[str] = []
        self.asked: list[str] = []
        context.set_offline(True)
        self.page = context.new_page()
        self.page.on("console", lambda message: self.said.append(f"{message.type}: {message.text}"))
        self.page.on("pageerror", lambda error: self.said.append(str(error)))
        self.page.on(
            "requestfailed", lambda request: self.said.append(f"failed: {request.url[:80]}")
        )
        self.page.on("request", lambda request: self.asked.append(request.url[:5]))
        self.page.goto(path.as_uri())
        self.page.wait_for_load_state("load")


@pytest.fixture(
    params=[(width, scheme) for width in WIDTHS for scheme in ("light", "dark")], ids="-".join
)
def visit(request: pytest.FixtureRequest, browser: object, report: Path) -> Iterator[Visit]:
    width, scheme = request.param
    viewport = {"width": WIDTHS[width], "height": 700}
    context = browser.new_context(viewport=viewport, color_scheme=scheme)
    yield Visit(context, report)
    context.close()


def test_nothing_is_said_in_the_console_and_nothing_is_asked_for(visit: Visit) -> None:
    assert visit.said == []
    assert visit.asked == ["file:"]


def test_all_pictures_are_shown_and_the_video_plays(visit: Visit) -> None:
    pictures = visit.page.evaluate(
        "Promise.all([...document.images].map(async (i) => (await i.decode(), [i.naturalWidth, "
        "i.complete])))"
    )
    assert len(pictures) == 7 and all(width > 0 and complete for width, complete in pictures)
    video = visit.page.locator("video")
    visit.page.wait_for_function("document.querySelector('video').readyState >= 2")
    assert video.evaluate("v => v.error") is None
    assert 0.5 < video.evaluate("v => v.duration") < 0.8
    video.evaluate("v => v.play()")
    visit.page.wait_for_function("document.querySelector('video').currentTime > 0")


def test_page_is_no_wider_than_the_screen_and_tables_scroll(visit: Visit) -> None:
    page, width = visit.page, visit.page.viewport_size["width"]
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    boxes = page.evaluate(
        "[...document.querySelectorAll('main > *, main > * > *')].map((e) => "
        "e.getBoundingClientRect().right)"
    )
    assert max(boxes) <= width
    trials = page.locator(".table").first
    assert trials.evaluate("e => e.scrollWidth > e.clientWidth") == (width == WIDTHS["phone"])


@pytest.mark.parametrize("kind", [".picture", ".table"])
def test_what_scrolls_has_a_shade_where_there_is_more(visit: Visit, kind: str) -> None:
    box = visit.page.locator(kind).first
    scrolls = visit.page.viewport_size["width"] == WIDTHS["phone"]
    assert shades(box) == (False, scrolls)
    box.evaluate("e => e.scrollTo(e.scrollWidth, 0)")
    assert shades(box) == (scrolls, False)


def shades(box: object) -> tuple[bool, bool]:
    """Whether there are shades at the left and the right edge of a box."""
    picture = np.asarray(Image.open(io.BytesIO(box.screenshot())).convert("L"), dtype=float)
    bottom = picture[-12]  # below what is drawn or written
    ground = np.median(bottom[30:-30])
    return tuple(abs(bottom[at] - ground) > 20 for at in (3, -4))


def test_text_can_be_told_from_its_ground(visit: Visit) -> None:
    ratios = visit.page.evaluate(CONTRASTS)
    assert len(ratios) > 20 and min(ratios) >= 4.5  # WCAG 2, level AA


CONTRASTS = """() => {
  const canvas = document.createElement('canvas').getContext('2d', { willReadFrequently: true });
  const linear = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
  const light = (colour) => {
    canvas.fillStyle = colour;
    canvas.fillRect(0, 0, 1, 1);
    const [r, g, b] = [...canvas.getImageData(0, 0, 1, 1).data].map((v) => linear(v / 255));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const ground = (e) => {
    const colour = getComputedStyle(e).backgroundColor;
    return colour === 'rgba(0, 0, 0, 0)' ? ground(e.parentElement) : colour;
  };
  return [...document.querySelectorAll('h1, h2, p, dd, dt, td, th, pre, li')].map((e) => {
    const [a, b] = [light(getComputedStyle(e).color), light(ground(e))];
    return (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
  });
}"""
