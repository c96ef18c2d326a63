"""Takes the picture of docs/view.md: the page of `talkingeyes view`, truth and two samples, in headless Chromium.

Run     PYTHONPATH=. python docs/pictures/view.py [DATA]     (the data folder of a finished chain; needs Chromium)
Writes  view.png
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from tests.browser import open_browser

from talkingeyes.corpus.samples import Samples
from talkingeyes.corpus.store import Corpus, shard_path

MOMENT_S, SAMPLES, SIZE = 4.4, 2, (1500, 1010)


def main(data: Path) -> None:
    """The first clip of the test split."""
    clip = Corpus(data / "synthesize").select("test", take=0)[0].id
    drawn = Samples.load(shard_path(data / "sample" / "talkingeyes_events", clip, ".npz"))
    with tempfile.TemporaryDirectory() as folder:
        few = Path(folder, f"{clip}.npz")
        Samples(drawn.fps, drawn.head[:SAMPLES], drawn.gaze[:SAMPLES]).save(few)
        command = [sys.executable, "-m", "talkingeyes.cli.main", "view", str(few), "--corpus", str(data / "synthesize")]
        server = subprocess.Popen([*command, "--port", "0"], stdout=subprocess.PIPE, text=True)
        assert server.stdout is not None
        with server, open_browser(Path(folder, "profile"), *SIZE) as browser:
            browser.open(f"{server.stdout.readline().split(' ')[0]}#at={MOMENT_S}&rays=1")
            browser.wait_for("document.body.dataset.state == 'paused'", seconds=120)
            browser.screenshot(Path(__file__).with_name("view.png"))
            server.terminate()


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "data"))
