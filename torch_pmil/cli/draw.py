"""Draw demonstrations by hand, in the browser of this machine, and save them for training.

Example:
    pmil draw heart.npz

Open the address that is printed, with a mouse, a pen or a touch screen. The page is a square of 0.3
m; x points right and y up from its lower left corner. Strokes are brought to one length and timing;
what was recorded stays beside them in heart.csv.
"""

from __future__ import annotations

import argparse
import secrets
import shlex
import sys
import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from string import Template

from torch_pmil.cli import Parser
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.demonstrations.preparation.alignment import AlignmentError
from torch_pmil.demonstrations.preparation.drawing import (
    LEAST_EXTENT,
    LEAST_SAMPLES,
    LONGEST,
    MOST_STROKES,
    SHORTEST,
    DrawingError,
    check_time_step,
    read_strokes,
    save_drawing,
)
from torch_pmil.files import in_words

STROKES = 5  # that the page asks for
PAGE = Path(__file__).parent / "drawing_page"
FILES = {
    "": ("index.html", "text/html"),
    "page.css": ("page.css", "text/css"),
    "page.js": ("page.js", "text/javascript"),
}
LARGEST_BODY = 16 * 2**20  # bytes: the most strokes, the longest, at 1 kHz
PATIENCE = 10  # s, with a browser that opens a connection and says nothing
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
        "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Cache-Control": "no-store",
    "Referrer-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
}


class DrawingServer(ThreadingHTTPServer):
    """Serves the page on the loopback interface until a drawing is saved.

    Who does not know the secret in its address gets nothing.

    Args:
        path: of the NPZ file that is to be written.
        time_step: of the demonstrations, in s.

    Attributes:
        saved: the demonstrations, once they are.
    """

    daemon_threads = True

    def __init__(self, path: Path, time_step: float) -> None:
        super().__init__(("127.0.0.1", 0), DrawingHandler)
        self.path, self.time_step = path, time_step
        self.saved: Demonstrations | None = None
        self.host = f"127.0.0.1:{self.server_port}"
        self.root = f"/{secrets.token_urlsafe()}/"
        self.saving = threading.Lock()

    @property
    def address(self) -> str:
        """The page's URL."""
        return f"http://{self.host}{self.root}"

    def save(self, body: bytes) -> Demonstrations:
        """Write what a page sent, once.

        Raises:
            DrawingError, AlignmentError: the strokes are not as they must be, or were saved
                already.
            OSError: the file cannot be written.
        """
        with self.saving:
            if self.saved is not None:
                raise DrawingError(f"{self.path} is saved already")
            self.saved = save_drawing(self.path, read_strokes(body), self.time_step)
            return self.saved


class DrawingHandler(BaseHTTPRequestHandler):
    """Answers the page's requests: with a file of the page, or a line of text."""

    server: DrawingServer
    timeout = PATIENCE

    def do_GET(self) -> None:
        """A file of the page."""
        if not self._allowed():
            return
        name = self.path.removeprefix(self.server.root)
        if name not in FILES:
            return self._answer(HTTPStatus.NOT_FOUND, "there is no such file")
        file, kind = FILES[name]
        content = (PAGE / file).read_text(encoding="utf-8")
        self._answer(HTTPStatus.OK, _with_limits(content) if kind == "text/html" else content, kind)

    def do_POST(self) -> None:
        """The strokes: saved, or told what is wrong with them."""
        if not self._allowed():
            return
        if self.path != f"{self.server.root}save":
            return self._answer(HTTPStatus.NOT_FOUND, "strokes are sent to save")
        length = self.headers.get("Content-Length", "")
        if not length.isascii() or not length.isdigit():
            return self._answer(
                HTTPStatus.LENGTH_REQUIRED, "Not saved: the length of the strokes must be told."
            )
        if int(length) > LARGEST_BODY:
            return self._answer(
                HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
                f"Not saved: strokes must be {LARGEST_BODY} bytes at most, got {length}.",
            )
        try:
            saved = self.server.save(self.rfile.read(int(length)))
        except (AlignmentError, DrawingError, OSError) as error:
            print(f"not saved: {in_words(error)}", file=sys.stderr, flush=True)
            return self._answer(HTTPStatus.UNPROCESSABLE_ENTITY, f"Not saved: {in_words(error)}.")
        self._answer(
            HTTPStatus.OK,
            f"Saved {len(saved.positions)} strokes in {self.server.path.name}: see the terminal "
            "for how to train.",
        )
        self.server.shutdown()

    def log_message(self, *arguments: object) -> None:
        """Keeps quiet: the terminal is for the person."""

    def _allowed(self) -> bool:
        """Check that a request is the page's own, and answer it with an error if not.

        It may not come from another site through this browser, or by another name of this address.

        It may not come from another site through this browser, or by another name of this address.
        """
        host, root = self.server.host, self.server.root
        origins = (None, f"http://{host}")
        ours = self.headers.get("Host") == host and self.headers.get("Origin") in origins
        token = secrets.compare_digest(self.path[: len(root)].encode(), root.encode())
        if not (ours and token):
            self._answer(HTTPStatus.FORBIDDEN, "open the address that pmil draw printed")
        return ours and token

    def _answer(self, status: HTTPStatus, text: str, kind: str = "text/plain") -> None:
        content = text.encode()
        own = {"Content-Type": f"{kind}; charset=utf-8", "Content-Length": str(len(content))}
        self.send_response(status)
        for name, value in {**HEADERS, **own}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)


def _with_limits(page: str) -> str:
    """The page, told what a stroke must be."""
    return Template(page).substitute(
        wanted=STROKES,
        most=MOST_STROKES,
        samples=LEAST_SAMPLES,
        shortest=SHORTEST,
        longest=LONGEST,
        extent=LEAST_EXTENT,
    )


def _check(out: Path, time_step: float) -> None:
    """Raise DrawingError where nothing could be saved, or something would be overwritten."""
    check_time_step(time_step)
    if out.suffix != ".npz":
        raise DrawingError(f"{out}: demonstrations are written to a .npz file")
    if not out.parent.is_dir():
        raise DrawingError(f"{out}: there is no folder {out.parent}")
    for file in (out, out.with_suffix(".csv")):
        if file.exists():
            raise DrawingError(f"{file} is there already; say another name")


def main() -> None:
    """Serve the page until a drawing is saved, then say how to train with it."""
    parser = Parser(
        description=__doc__.partition("\n")[0],
        epilog=__doc__.partition("\n\n")[2],
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("out", type=Path, metavar="OUT.npz")
    parser.add_argument(
        "--time-step",
        type=float,
        default=0.1,
        help="of the demonstrations, the robot's control period, in s (0.1)",
    )
    arguments = parser.parse_args()
    try:
        _check(arguments.out, arguments.time_step)
        with DrawingServer(arguments.out, arguments.time_step) as server:
            print(f"draw at {server.address} (Ctrl-C ends without saving)", flush=True)
            server.serve_forever()
    except (DrawingError, OSError) as error:
        sys.exit(f"error: {in_words(error)}")
    except KeyboardInterrupt:
        sys.exit("\nended, nothing was saved")
    assert server.saved is not None  # the server ends by itself when a drawing is saved
    count, samples, _ = server.saved.positions.shape
    print(
        f"wrote {arguments.out}: {count} demonstrations of {samples} samples, "
        f"{server.saved.duration:g} s"
    )
    print(f"as they were recorded: {arguments.out.with_suffix('.csv')}")
    settings = ("experiment=handwriting", "robot=double_pendulum")
    train = ("pmil", "train", *settings, f"demonstrations={arguments.out}")
    print(f"train with: {shlex.join(train)}")
