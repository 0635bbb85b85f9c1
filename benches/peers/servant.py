"""One of our benches as a servant of the peer that is measured beside it."""

import os
import pathlib
import subprocess
import sys

ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS", "ITK_GLOBAL_DEFAULT_NUMBER_OF_THREADS")}


class Servant:
    """Built and started with the name of the bench; its processor time is read while it waits for the next word."""

    def __init__(self, bench):
        root = pathlib.Path(__file__).resolve().parents[2]
        command = ["cargo", "bench", "--bench", bench, "--no-run", "--message-format=json"]
        built = subprocess.run(command, cwd=root, check=True, capture_output=True, text=True).stdout
        lines = [line for line in built.splitlines() if f'"name":"{bench}"' in line and '"executable":"' in line]
        binary = lines[-1].split('"executable":"')[1].split('"')[0]
        environment = {**os.environ, **ONE_THREAD, "CARDIOTWIN_PEER": "1"}
        self.process = subprocess.Popen([binary], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment)

    def seconds(self, words):
        before = self.used()
        self.process.stdin.write(words + "\n")
        self.process.stdin.flush()
        if self.process.stdout.readline().strip() != "done":
            sys.exit(f"our side gave up on: {words}")
        return self.used() - before

    def used(self):
        # Of every thread: a pool computes beside the one that reads the words.
        threads = pathlib.Path(f"/proc/{self.process.pid}/task").iterdir()
        return sum(int((thread / "schedstat").read_text().split()[0]) for thread in threads) * 1e-9
