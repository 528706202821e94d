"""Draw demonstrations by hand, in the browser of this machine, and save them for training.

Example:
    pmil draw heart.npz

Open the printed address and draw with a mouse, a pen or a finger. The page is a square of 0.3 m; x
points right and y up from its lower left corner. The strokes are aligned to one length and timing.
heart.csv holds them as they were recorded.
"""

from __future__ import annotations

import math
import secrets
import shlex
import sys
import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from string import Template

from torch_pmil.cli import check_new, check_out, errors_in_one_line, parser_of, print_written
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.demonstrations.preparation import drawing
from torch_pmil.demonstrations.preparation.alignment import AlignmentError
from torch_pmil.files import in_words
from torch_pmil.runs.settings import word_of
from torch_pmil.tasks.strokes import TIME_STEP

LIMITS = {  # of strokes, which the page shows
    "wanted": 5,
    "most": drawing.MOST_STROKES,
    "samples": drawing.LEAST_SAMPLES,
    "shortest": drawing.SHORTEST,
    "longest": drawing.LONGEST,
    "extent": drawing.LEAST_EXTENT,
}
PAGE = Path(__file__).parent / "drawing_page"
FILES = {"": "text/html", "page.css": "text/css", "page.js": "text/javascript"}
LARGEST_BODY = 16 * 2**20  # bytes; enough for the most and longest strokes at 1 kHz
PATIENCE = 10  # s, with a browser that opens a connection and sends nothing
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
    """Serves the page on the loopback interface until a drawing is saved to an NPZ file.

    It answers only requests with the secret in its address. The time step is in s.
    """

    daemon_threads = True

    def __init__(self, path: Path, time_step: float) -> None:
        super().__init__(("127.0.0.1", 0), DrawingHandler)
        self.path, self.time_step = path, time_step
        self.saved: Demonstrations | None = None
        self.host = f"127.0.0.1:{self.server_port}"
        self.root = f"/{secrets.token_urlsafe()}/"
        self.address = f"http://{self.host}{self.root}"
        self.saving = threading.Lock()

    def save(self, body: bytes) -> Demonstrations:
        """Write what a page sent, once.

        Raises:
            DrawingError, AlignmentError: the strokes are invalid, or were saved already.
            OSError: the file cannot be written.
        """
        with self.saving:
            if self.saved is not None:
                raise drawing.DrawingError(f"{self.path} is saved already")
            self.saved = drawing.save_drawing(self.path, drawing.read_strokes(body), self.time_step)
            return self.saved


class DrawingHandler(BaseHTTPRequestHandler):
    """Answers the page's requests with a file of the page, or a line of text."""

    server: DrawingServer
    timeout = PATIENCE

    def do_GET(self) -> None:
        """Send a file of the page."""
        if not self._allowed():
            return
        name = self.path.removeprefix(self.server.root)
        if name not in FILES:
            return self._answer(HTTPStatus.NOT_FOUND, "there is no such file")
        content = (PAGE / (name or "index.html")).read_text(encoding="utf-8")
        if not name:
            content = Template(content).substitute(LIMITS)
        self._answer(HTTPStatus.OK, content, FILES[name])

    def do_POST(self) -> None:
        """Save the strokes, or answer what is wrong with them."""
        if not self._allowed():
            return
        if self.path != f"{self.server.root}save":
            return self._answer(HTTPStatus.NOT_FOUND, "strokes are sent to save")
        length = self.headers.get("Content-Length", "")
        if not length.isascii() or not length.isdigit():
            number = "Not saved: Content-Length must be a number of bytes."
            return self._answer(HTTPStatus.LENGTH_REQUIRED, number)
        if int(length) > LARGEST_BODY:
            return self._answer(
                HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
                f"Not saved: strokes must be {LARGEST_BODY} bytes at most, got {length}.",
            )
        try:
            saved = self.server.save(self.rfile.read(int(length)))
        except (AlignmentError, drawing.DrawingError, OSError) as error:
            print(f"not saved: {in_words(error)}", file=sys.stderr, flush=True)
            return self._answer(HTTPStatus.UNPROCESSABLE_ENTITY, f"Not saved: {in_words(error)}.")
        said = f"Saved {len(saved.positions)} strokes in {self.server.path.name}"
        self._answer(HTTPStatus.OK, f"{said}: see the terminal for how to train.")
        self.server.shutdown()

    def log_message(self, *arguments: object) -> None:
        """Print nothing."""

    def _allowed(self) -> bool:
        """Check that a request is the page's own, and answer it with an error if not.

        Another site may send one through this browser, or use another name of this address.
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


def main() -> None:
    """Serve the page until a drawing is saved, then print how to train with it."""
    parser = parser_of(__doc__)
    parser.add_argument("out", type=Path, metavar="OUT.npz")
    period = "of the demonstrations, the robot's control period, in s (default 0.1)"
    parser.add_argument("--time-step", type=float, default=0.1, metavar="S", help=period)
    arguments = parser.parse_args()
    out, time_step = arguments.out, arguments.time_step
    recorded = out.with_suffix(".csv")
    try:
        with errors_in_one_line(drawing.DrawingError, OSError):
            drawing.check_time_step(time_step)
            check_out(out)
            for file in (out, recorded):
                check_new(file)
            with DrawingServer(out, time_step) as server:
                print(f"draw at {server.address} (Ctrl-C ends without saving)", flush=True)
                server.serve_forever()
    except KeyboardInterrupt:
        sys.exit("\nended, nothing was saved")
    assert server.saved is not None  # the server ends by itself when a drawing is saved
    print_written(out, server.saved)
    print(f"as they were recorded: {recorded}")
    if math.isclose(time_step, TIME_STEP):
        train = ("pmil", "train", "experiment=handwriting", word_of("demonstrations", str(out)))
        print(f"train with: {shlex.join(train)}")
    else:
        print(
            f"they are for PMIL(..., control_period={time_step:g}): handwriting takes {TIME_STEP} s"
        )
