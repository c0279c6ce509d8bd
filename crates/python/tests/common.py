"""What the tests share: the program, its built-in clip, folders."""

import os
import subprocess
import tempfile
import unittest
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
DEMO = ROOT / "fixtures" / "demo.avi"


def program() -> str:
    """The program `handcast`, which HANDCAST_PROGRAM names."""
    return os.environ["HANDCAST_PROGRAM"]


def done(*words: object) -> str:
    """What the program prints; it has to succeed."""
    environment = {**os.environ, "HANDCAST_NET": "none"}
    run = subprocess.run([program(), *map(str, words)], env=environment, capture_output=True, text=True)
    assert run.returncode == 0, f"{words}: {run.stderr}"
    return run.stdout


class InFolder(unittest.TestCase):
    """A test with a folder of its own."""

    def setUp(self) -> None:
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)
